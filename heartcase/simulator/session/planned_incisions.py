"""Plans of incisions run on a case, each in a session of its own, and what each comes to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import Problem, ScriptError, SimulationError
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.migrate import PLANS
from heartcase.schemas.recording.commands import Mark
from heartcase.schemas.scripts.incision_plans import IncisionPlans, PlannedIncision
from heartcase.schemas.scripts.script import CutAction, SimulationScript
from heartcase.schemas.scripts.toml_text import checked_toml, text_of
from heartcase.simulator.incisions.cut_tissue import CellTissues
from heartcase.simulator.incisions.figures import CRITERIA, IncisionFigures, RankedPlan, ranked
from heartcase.simulator.incisions.held_open import Incision, ShownHeart, seen_through
from heartcase.simulator.incisions.planned import (
    blade_poses,
    drawn_line,
    lip_hands,
    lip_retractors,
    problems_of_cut,
)
from heartcase.simulator.incisions.rim import defect_rim
from heartcase.simulator.incisions.strain import Strain, cell_strain, values_at_nodes, values_at_vertices
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.load import Case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.script import run_script, with_positions
from heartcase.simulator.simulation import Simulation

__all__ = [
    "HeldOpen",
    "PlansOnCase",
    "at_vertices",
    "load_plans",
    "on_case",
    "parse_plans",
    "ranked_by_defect",
    "run_plan",
]


def load_plans(path: Path | str) -> IncisionPlans:
    """Read a file of incision plans.

    Raises
    ------
    ScriptError
        It cannot be read, or with every problem that was found in it.
    """
    return parse_plans(text_of(path, "plans"))


def parse_plans(text: str) -> IncisionPlans:
    """Read incision plans from TOML text.

    Raises
    ------
    ScriptError
        With every problem that was found.
    """
    return checked_toml(text, IncisionPlans, PLANS, "plans", _no_plans)


def _no_plans(data: dict[str, Any]) -> str | None:
    """Why data are no plans."""
    for key, what in (("heartcase_recipe", "a recipe"), ("heartcase_script", "a simulation script")):
        if key in data:
            return f"this is {what}, not a file of plans: sample_cases/incision_plans.toml is one"
    if not {"plans", "heartcase_plans"} & data.keys():
        return "this is no file of plans, as it has no [[plans]]: sample_cases/incision_plans.toml is one"
    return None


@dataclass(frozen=True)
class PlansOnCase:
    """What of a file of plans is meant for a case."""

    plans: IncisionPlans
    """The file."""
    runs: tuple[PlannedIncision, ...]
    """Plans that are run."""
    left_out: tuple[str, ...]
    """Names of those that need a landmark which the case does not have."""
    defects: tuple[Landmark, ...]
    """Rings that are looked at."""

    @property
    def seconds(self) -> float:
        """Simulated time of all plans, s."""
        return sum(plan.seconds for plan in self.runs)


@dataclass(frozen=True)
class HeldOpen:
    """A plan as it was run, at its end."""

    plan: PlannedIncision
    """The plan."""
    figures: dict[str, IncisionFigures]
    """Name of each defect -> figures, under the plan's name."""
    rim_found: dict[str, float]
    """Name of each defect -> part of its rim that was found on the surface [1]."""
    looks_from: dict[str, tuple[float, float, float]]
    """Name of each defect -> from it to the best eye, LPS axes, unit length."""
    rims_mm: dict[str, Float64]
    """Name of each defect -> its rim now, LPS mm, shape (count, 3)."""
    rims_at_rest_mm: dict[str, Float64]
    """The same at rest."""
    hand_force_n: dict[str, float]
    """Name of each hand -> force on it at the end, N."""
    inverted_cell_count: int
    """Cells that are inside out at the end."""
    opening_mm: Float64 | None
    """Both lips, one closed curve, LPS mm, shape (count, 3); None where the cut has no line."""
    strain: Strain
    """Stretch and stress of the cells at the end."""


def on_case(plans: IncisionPlans, landmarks: tuple[Landmark, ...]) -> PlansOnCase:
    """What is to be run on a case.

    Raises
    ------
    ScriptError
        The case lacks what a plan needs, none of the plans or of the defects is for it: all problems at once.
    """
    problems: list[Problem] = []
    runs, left_out = [], []
    known = {one.name.lower() for one in landmarks}
    for number, plan in enumerate(plans.plans, start=1):
        named = [*(cut.landmark for cut in plan.cuts), *(action.landmark for action in plan.actions)]
        wanted = {name.lower() for name in named if name is not None}
        if plan.only_with_landmarks and wanted - known:
            left_out.append(plan.name)
            continue
        runs.append(plan)
        for place, cut in enumerate(plan.cuts, start=1):
            problems += problems_of_cut(cut, landmarks, f"plans[{number}].cuts[{place}]")
        for place, action in enumerate(plan.actions, start=1):
            if action.landmark is not None and action.landmark.lower() not in known:
                words = ", ".join(one.name for one in landmarks) or "none"
                message = f"the case has no landmark {action.landmark!r}; it has: {words}"
                problems.append(Problem(f"plans[{number}].actions[{place}].landmark", message))
    if not runs:
        problems.append(Problem("plans", "the case lacks landmarks of every plan: give it a plan of its own"))
    rings = [one for one in landmarks if one.kind == "ring"]
    names = {name.lower() for name in plans.defects}
    defects = tuple(one for one in rings if not names or one.name.lower() in names)
    if not defects:
        words = ", ".join(one.name for one in rings) or "none"
        problems.append(Problem("defects", f"the case has none of these; its rings: {words}"))
    if problems:
        raise ScriptError(problems)
    return PlansOnCase(plans, tuple(runs), tuple(left_out), defects)


def run_plan(
    plan: PlannedIncision,
    on: PlansOnCase,
    case: Case,
    session: OperatingSession,
    *,
    on_time: Callable[[float], None] | None = None,
) -> HeldOpen:
    """Cut, hold open, and measure.

    Parameters
    ----------
    plan
        One of the plans that are run.
    on
        All of them, on the case.
    case
        The case, loaded with its surface and tissue; with the labels of its cells it is said what was cut.
    session
        A new session on it, whose history then holds what was done; its moments are marked ``closed``, ``cut`` and
        ``held open``.
    on_time
        Told the simulated time of the plan, s, at each frame.

    Raises
    ------
    SimulationError
        A cut or a hand meets no tissue, a defect is not there, or the simulation broke down.
    """
    simulation = session.simulation
    surface = case.surface
    assert surface is not None
    landmarks = case.manifest.landmarks
    whole = _shown(simulation)
    lines = [drawn_line(cut, landmarks, whole.tree, surface.rest_mm, whole.normals) for cut in plan.cuts]
    cell_mm = simulation.model.cell_mm
    poses = [blade_poses(cut, line, landmarks, cell_mm=cell_mm) for cut, line in zip(plan.cuts, lines, strict=True)]
    entry = lines[0].at(0.5)[0] if lines[0] is not None else np.mean(poses[0], axis=(0, 1))
    rims = tuple(defect_rim(whole.tree, one, entry) for one in on.defects)
    session.do(Mark(name="closed"))

    def tell(before_s: float) -> Callable[[Simulation, float], None]:
        return lambda _, time_s: None if on_time is None else on_time(before_s + time_s)

    cuts = tuple(
        CutAction(name=cut.name, poses_mm=poses_mm, at_rest=True)
        for cut, poses_mm in zip(plan.cuts, poses, strict=True)
    )
    run_script(session, SimulationScript(seconds=plan.settle_s, cuts=cuts), on_frame=tell(0.0))
    if simulation.model.cell_count == case.model.cell_count and simulation.model.node_count == case.model.node_count:
        raise SimulationError(
            "there is no tissue in its way: look where the line lies and how deep it goes", place=cuts[0].name
        )
    session.do(Mark(name="cut"))
    cut_open = _shown(simulation)
    script = SimulationScript(seconds=plan.open_s + plan.hold_s, actions=plan.actions)
    held_by = plan.retraction
    if held_by is not None and lines[0] is not None:
        if held_by.kind == "grabs":
            hands = lip_hands(held_by, lines[0], surface.rest_mm, cell_mm=cell_mm, open_s=plan.open_s)
            script = script.model_copy(update={"actions": (*hands, *plan.actions)})
        else:
            sides = cut_open.lips(lines[0], len(whole.rest_mm))
            retractors = lip_retractors(held_by, lines[0], sides, cell_mm=cell_mm, open_s=plan.open_s)
            script = script.model_copy(update={"retractors": retractors})
    script = with_positions(script, landmarks)
    run_script(session, script, on_frame=tell(plan.settle_s))
    session.do(Mark(name="held open"))
    if on_time is not None:
        on_time(plan.seconds)
    curve = lines[0].points_mm if lines[0] is not None else np.asarray(plan.cuts[0].poses_mm, float)[:, -1]
    incision = Incision(plan.name, curve, lines[0], entry, rims, len(whole.rest_mm))
    return _measured(plan, on, case, session, (whole, cut_open, _shown(simulation)), incision)


def _shown(simulation: Simulation) -> ShownHeart:
    assert simulation.surface is not None
    is_cut_face = None if simulation.split is None else simulation.split.triangle_is_cut_face
    return ShownHeart.of(simulation.surface, simulation.surface_now(), is_cut_face)


def _measured(
    plan: PlannedIncision,
    on: PlansOnCase,
    case: Case,
    session: OperatingSession,
    moments: tuple[ShownHeart, ShownHeart, ShownHeart],
    incision: Incision,
) -> HeldOpen:
    simulation = session.simulation
    closed, cut, held = moments
    forces = {
        one.name: float(np.linalg.norm(simulation.force_on(one)))
        for one in simulation.instruments
        if isinstance(one, Grab)
    }
    found, opening = seen_through(
        incision,
        simulation.model,
        simulation.state.displacement,
        held,
        closed=closed,
        cut=cut,
        landmarks=case.manifest.landmarks,
        looking=on.plans.view,
        shaft=on.plans.shaft,
        looks_from=plan.looks_from,
        # What nobody holds takes no force.
        retraction_n=max(forces.values(), default=0.0),
        tissues=_tissues(case),
    )
    return HeldOpen(
        plan=plan,
        figures={name: one.figures for name, one in found.items()},
        rim_found={rim.name: rim.part_found for rim in incision.rims},
        looks_from={name: one.looks_from for name, one in found.items() if one.looks_from is not None},
        rims_mm={name: one.rim_mm for name, one in found.items() if one.rim_mm is not None},
        rims_at_rest_mm={rim.name: rim.points_mm for rim in incision.rims},
        hand_force_n=forces,
        inverted_cell_count=simulation.inverted_cell_count(),
        opening_mm=opening,
        strain=cell_strain(simulation.model, simulation.state.displacement),
    )


def _tissues(case: Case) -> CellTissues | None:
    """What fills the cells of a case, where its labels were loaded."""
    if case.cell_labels is None:
        return None
    names = {one.value: one.name for one in case.manifest.labels}
    return CellTissues(case.model.geometry, case.model.cells, case.cell_labels, names)


def ranked_by_defect(
    held: tuple[HeldOpen, ...], *, nearest_least_mm: float, inverted_cells_most: int
) -> dict[str, tuple[RankedPlan, ...]]:
    """The plans of a case in the order of their worth, for each defect.

    Parameters
    ----------
    held
        Each plan as it was run on the same case.
    nearest_least_mm
        Nearest that a plan may come to a vessel, mm.
    inverted_cells_most
        Most cells that a plan may leave inside out.
    """
    return {
        name: ranked(
            [one.figures[name] for one in held],
            CRITERIA,
            nearest_least_mm=nearest_least_mm,
            inverted_cells_most=inverted_cells_most,
        )
        for name in (held[0].figures if held else ())
    }


def at_vertices(values: Float64, held: HeldOpen, simulation: Simulation) -> Float64:
    """What the surface's vertices have of what cells have, in a session that has just run a plan, (vertex_count,).

    Parameters
    ----------
    values
        One for each cell, such as a column of ``held.strain``, shape (cell_count,).
    held
        The plan, just run.
    simulation
        The simulation that ran it.

    Raises
    ------
    SimulationError
        It has no surface.
    """
    if simulation.surface is None:
        raise SimulationError("there is no surface: load the case with one", place="surface")
    at_nodes = values_at_nodes(simulation.model, values, held.strain.is_known)
    return values_at_vertices(simulation.surface.triangle_nodes, simulation.surface.weights, at_nodes)
