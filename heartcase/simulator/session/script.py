"""Scripted sessions: a TOML file says what the instruments do, a summary says what came of it."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import Problem, ScriptError, SimulationError
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.migrate import SCRIPT
from heartcase.schemas.recording.commands import (
    Advance,
    LeadGrab,
    MoveProbe,
    SqueezeForceps,
)
from heartcase.schemas.scripts.script import GrabAction, ProbeAction, SimulationScript, Waypoint
from heartcase.schemas.scripts.toml_text import checked_toml, text_of
from heartcase.schemas.scripts.tool_actions import ForcepsAction
from heartcase.simulator.dynamics.integrate import Energy
from heartcase.simulator.instruments.forceps import Forceps
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.wrench import Instrument
from heartcase.simulator.lattice.loose_nodes import tissue_displacement
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.perform_tools import withdrawal_of
from heartcase.simulator.session.script_sutures import Threads
from heartcase.simulator.session.script_tools import Action, Blades, Snips, bringing_in, jaw_gap_mm
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.deform import SurfaceModel

__all__ = ["SessionSummary", "default_script", "load_script", "parse_script", "run_script", "with_positions"]


PULL_MM = 10.0
"""How far the default script pulls."""
GRIP_CELLS = 3.0
"""Radius of the default script's grab, in cells."""


STEP_COUNT_MAX = 100_000_000
"""Steps that a session may take: hours on any machine."""


@dataclass(frozen=True)
class SessionSummary:
    """What a session was, and what it came to."""

    node_count: int
    """Nodes of the lattice."""
    spring_count: int
    """Springs."""
    cell_mm: float
    """Edge of a cell, mm."""
    triangle_count: int
    """Triangles of the surface; 0 without one."""
    step_s: float
    """Time step, s."""
    step_limit_s: float
    """Largest stable step at rest, s."""
    pace: float
    """How many times as long as ``step_s`` steps may be."""
    step_count: int
    """Steps taken."""
    seconds: float
    """Simulated time, s."""
    wall_seconds: float
    """Time that it took, without loading and compiling, s."""
    real_time_factor: float
    """Simulated over wall time."""
    displacement_max_mm: float
    """Furthest that any node was from its rest position in any frame, mm."""
    displacement_end_mm: float
    """Furthest that any node is from its rest position at the end, mm."""
    inverted_cell_count_max: int
    """Most cells that were turned inside out in any frame."""
    inverted_cell_count_end: int
    """Cells that are turned inside out at the end."""
    peak_force_n: dict[str, float]
    """Action or probe -> highest force on the hand in any frame, N."""
    held_node_count: dict[str, int]
    """Action -> nodes that it held."""
    stitch_peak_force_n: dict[str, float]
    """Stitch -> highest force in it in any frame, N."""
    stitch_end_force_n: dict[str, float]
    """Stitch -> force in it at the end, or when it was taken out, N."""
    patch_peak_force_n: dict[str, float]
    """Patch -> highest force in a stitch of its rim in any frame, N."""
    cut_mm2: dict[str, float]
    """Cut -> area of tissue that it cut, mm2: 0 where it met none, or only what was cut before. Cuts of one name count
    together; without a surface it is empty."""
    excised_ml: dict[str, float]
    """Excision -> volume of what was taken out, ml."""
    stitch_tied_n: dict[str, tuple[float, float]]
    """Stitch or row that was drawn with a tension -> tension of its thread when it was tied, the largest of a row, and
    what was asked for, N: it is less where its ends met first, or the time step allows no stiffer thread."""
    patch_end_force_n: dict[str, tuple[float, ...]]
    """Patch -> force in each stitch of its rim at the end, or when it was taken out, N."""
    frame_time_s: tuple[float, ...]
    """Simulated time of each frame, s."""
    frame_energy: tuple[Energy, ...]
    """Energies in each frame."""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, ready for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class _Timeline:
    """A grab, forceps, a retractor or a probe in steps instead of seconds."""

    action: Action
    start: int
    end: int
    """Step at which it lets go; past the last step when it holds to the end."""
    steps: tuple[int, ...]
    offsets_mm: Float64
    """Offset at each of ``steps``, shape (len(steps), 3)."""
    closed: int
    """Step at which jaws are closed; ``start`` where there are none."""

    def offset_at(self, step: int) -> Float64:
        """Offset of the hand from where it closed, mm."""
        return np.array([np.interp(step, self.steps, self.offsets_mm[:, axis]) for axis in range(3)])


def load_script(path: Path | str) -> SimulationScript:
    """Read a simulation script.

    Raises
    ------
    ScriptError
        It cannot be read, or with every problem that was found in it.
    """
    return parse_script(text_of(path, "script"))


def parse_script(text: str) -> SimulationScript:
    """Read a simulation script from TOML text.

    Raises
    ------
    ScriptError
        With every problem that was found.
    """
    return checked_toml(text, SimulationScript, SCRIPT, "script", _no_script)


def _no_script(data: dict[str, Any]) -> str | None:
    """Why data are no script."""
    if "heartcase_recipe" in data:
        return "this is a recipe, not a script: sample_cases/pull.toml is a script"
    return None


def with_positions(script: SimulationScript, landmarks: tuple[Landmark, ...]) -> SimulationScript:
    """The script with landmarks replaced by their positions (of a ring or a line: the mean of its points).

    Raises
    ------
    ScriptError
        The case has no landmark of a name; all of them at once.
    """
    places = {mark.name.lower(): np.mean(mark.points_mm, axis=0).tolist() for mark in landmarks}
    known = ", ".join(mark.name for mark in landmarks) or "none"
    problems = []
    placed: dict[str, list[GrabAction | ProbeAction]] = {"actions": [], "probes": []}
    listed: dict[str, tuple[GrabAction | ProbeAction, ...]] = {"actions": script.actions, "probes": script.probes}
    for key, actions in listed.items():
        for number, action in enumerate(actions, start=1):
            if action.landmark is None:
                placed[key].append(action)
            elif action.landmark.lower() in places:
                place = tuple(places[action.landmark.lower()])
                placed[key].append(action.model_copy(update={"position_mm": place, "landmark": None}))
            else:
                message = f"the case has no landmark {action.landmark!r}; it has: {known}"
                problems.append(Problem(f"{key}[{number}].landmark", message))
    if problems:
        raise ScriptError(problems)
    return script.model_copy(update={key: tuple(actions) for key, actions in placed.items()})


def default_script(
    model: LatticeModel, surface: SurfaceModel | None = None, *, seconds: float = 2.0
) -> SimulationScript:
    """A pull outward by 10 mm and a release, at the surface vertex (or node) farthest from the fixed nodes.

    It pulls in the first 0.35 of the time, holds until 0.6 and lets go. Without fixed nodes it pulls at the one
    farthest from the middle.

    Parameters
    ----------
    model
        The lattice.
    surface
        The visible surface; nodes are looked at where left out.
    seconds
        Simulated time, s.
    """
    rest = model.rest_positions_mm()
    middle = rest.mean(axis=0)
    anchors = rest[model.node_is_fixed] if model.node_is_fixed.any() else middle[None]
    points = rest if surface is None else surface.rest_mm.astype(float)
    # The way to the nearest anchor is wanted for the farthest point only: a thousand of each are enough.
    points = points[:: max(1, len(points) // 1000)]
    anchors = anchors[:: max(1, len(anchors) // 1000)]
    gap = np.linalg.norm(points[:, None] - anchors[None], axis=2).min(axis=1)
    position = points[gap.argmax()]
    outward = (position - middle) / max(float(np.linalg.norm(position - middle)), 1e-9)
    pull = tuple(float(v) for v in PULL_MM * outward)
    grab = GrabAction(
        name="pull",
        position_mm=(float(position[0]), float(position[1]), float(position[2])),
        radius_mm=GRIP_CELLS * model.cell_mm,
        release_s=0.6 * seconds,
        path=(Waypoint(time_s=0.35 * seconds, offset_mm=(pull[0], pull[1], pull[2])),),
    )
    return SimulationScript(seconds=seconds, actions=(grab,))


def run_script(
    simulation: Simulation | OperatingSession,
    script: SimulationScript,
    *,
    on_frame: Callable[[Simulation, float], None] | None = None,
) -> SessionSummary:
    """Run a script from the simulation's state on.

    Parameters
    ----------
    simulation
        Made with the script's step, damping and gravity; or the session that operates on it, whose history then holds
        what the script did. Instruments that are in the tissue already stay where they are.
    script
        Its actions have positions (see :func:`with_positions`). A hand goes in straight lines from where it closed
        through the waypoints.
    on_frame
        Called after every frame, and before the first, with the simulation and the simulated time since then in s. What
        it takes is not counted as the session's wall time.

    Raises
    ------
    SimulationError
        A grab finds no tissue, or the simulation broke down.
    """
    if isinstance(simulation, OperatingSession):
        session, simulation = simulation, simulation.simulation
    else:
        session = OperatingSession(simulation, snapshot_every_s=inf)
    step_s = simulation.step_s
    step_total = max(1, round(script.seconds / step_s))
    if step_total > STEP_COUNT_MAX:
        raise SimulationError(
            f"{script.seconds:g} s at {step_s:.3g} s a step are {step_total:.3g} steps, too many to take: "
            "take a longer step or fewer seconds",
            place="step_s",
        )
    frame_count = max(1, round(script.seconds * script.frames_per_second))
    frames = {round(number * step_total / frame_count) for number in range(1, frame_count + 1)}
    actions: list[Action] = [*script.actions, *script.probes, *script.forceps, *script.retractors]
    timelines = [_timeline(action, step_s, step_total) for action in actions]
    cuts = [(min(round(cut.time_s / step_s), step_total - 1), cut) for cut in script.cuts]
    excisions = [(min(round(one.time_s / step_s), step_total - 1), one) for one in script.excisions]
    snips = [Snips(one, step_s, step_total) for one in script.scissors]
    threads = Threads(session, script, step_total)
    stops = sorted(
        frames
        | {stop for one in snips for stop in one.stops}
        | set(threads.stops())
        | {stop for timeline in timelines for stop in _stops(timeline, step_total)}
        | {step for step, _ in (*cuts, *excisions) if 0 < step < step_total}
    )

    hands, blades = _Hands(session, timelines), Blades(session)
    furthest, inverted = 0.0, 0
    times, energies = [0.0], [simulation.energy()]
    wall = 0.0
    simulation.prepare()
    if script.cuts or script.scissors:
        simulation.prepare_cuts()
    if on_frame:
        on_frame(simulation, 0.0)
    now = 0
    for stop in stops:
        started = time.perf_counter()
        for step, cut in cuts:
            if step == now:
                blades.cut(cut)
        for one in snips:
            one.go_on(session, now)
        threads.change(now)
        for step, excision in excisions:
            if step == now:
                blades.excise(excision)
        hands.change(now)
        hands.lead(stop)
        threads.draw(stop)
        session.do(Advance(steps=stop - now))
        now = stop
        if stop in frames:
            hands.feel()
            threads.feel()
            if simulation.surface is not None:
                simulation.surface_now()
        wall += time.perf_counter() - started
        if stop in frames:
            furthest = max(furthest, _furthest(simulation))
            inverted = max(inverted, simulation.inverted_cell_count())
            times.append(now * step_s)
            energies.append(simulation.energy())
            if on_frame:
                on_frame(simulation, now * step_s)
    model = simulation.model
    return SessionSummary(
        node_count=model.node_count,
        spring_count=model.spring_count,
        cell_mm=model.cell_mm,
        triangle_count=0 if simulation.surface is None else len(simulation.surface.triangles),
        step_s=step_s,
        step_limit_s=simulation.step_limit_s,
        pace=simulation.pace,
        step_count=step_total,
        seconds=step_total * step_s,
        wall_seconds=wall,
        real_time_factor=step_total * step_s / wall,
        displacement_max_mm=furthest,
        displacement_end_mm=_furthest(simulation),
        inverted_cell_count_max=inverted,
        inverted_cell_count_end=simulation.inverted_cell_count(),
        peak_force_n=hands.peak_force_n,
        held_node_count=hands.held_node_count,
        stitch_peak_force_n=threads.peak_force_n,
        stitch_end_force_n=threads.end_force_n,
        patch_peak_force_n=threads.patch_peak_force_n,
        cut_mm2=blades.cut_mm2,
        excised_ml=blades.excised_ml,
        stitch_tied_n=threads.tied_n,
        patch_end_force_n=threads.patch_force_n,
        frame_time_s=tuple(times),
        frame_energy=tuple(energies),
    )


class _Hands:
    """The hands and probes of a script: what they are told, and what they felt."""

    def __init__(self, session: OperatingSession, timelines: list[_Timeline]) -> None:
        self.session = session
        self.timelines = timelines
        self.names: dict[int, str] = {}
        """Number of each action whose instrument is in the tissue -> its own name in the session."""
        self.peak_force_n = dict.fromkeys((timeline.action.name for timeline in timelines), 0.0)
        holding = (timeline.action.name for timeline in timelines if not isinstance(timeline.action, ProbeAction))
        self.held_node_count = dict.fromkeys(holding, 0)
        self._gap_mm: dict[int, tuple[float, float]] = {}
        self._offset: dict[int, tuple[float, ...]] = {}

    def change(self, now: int) -> None:
        """Let go and close what is due at this step; first let go, so that one hand can take over from another."""
        for number, timeline in enumerate(self.timelines):
            if number in self.names and now >= timeline.end:
                self.session.do(withdrawal_of(self._instrument(number)))
                del self.names[number]
        for number, timeline in enumerate(self.timelines):
            if now == timeline.start and now < timeline.end:
                self._bring_in(number, timeline.action)

    def _bring_in(self, number: int, action: Action) -> None:
        name = self._free_name(action.name)
        self.session.do(bringing_in(action, name))
        self.names[number] = name
        self._offset[number] = (0.0, 0.0, 0.0)
        instrument = self._instrument(number)
        if isinstance(instrument, Grab):
            self.held_node_count[action.name] += len(instrument.nodes)
        if isinstance(instrument, Forceps):
            self._gap_mm[number] = jaw_gap_mm(action, instrument, self.session.simulation.model.cell_mm)

    def lead(self, stop: int) -> None:
        """Lead each to where it shall be at a step; one that is led there already is left alone."""
        for number, name in self.names.items():
            timeline = self.timelines[number]
            if isinstance(timeline.action, ForcepsAction) and number in self._gap_mm:
                gap_mm = np.interp(stop, (timeline.start, timeline.closed), self._gap_mm[number])
                self.session.do(SqueezeForceps(name=name, gap_mm=float(gap_mm)))
                if stop >= timeline.closed:
                    del self._gap_mm[number]
            x, y, z = timeline.offset_at(stop).tolist()
            if (x, y, z) == self._offset[number]:
                continue
            self._offset[number] = (x, y, z)
            if not isinstance(timeline.action, ProbeAction):
                self.session.do(LeadGrab(name=name, offset_mm=(x, y, z)))
            elif timeline.action.position_mm is not None:
                at_x, at_y, at_z = timeline.action.position_mm
                self.session.do(MoveProbe(name=name, center_mm=(at_x + x, at_y + y, at_z + z)))

    def feel(self) -> None:
        """Keep the highest force on each."""
        for number in self.names:
            name = self.timelines[number].action.name
            force = float(np.linalg.norm(self.session.simulation.force_on(self._instrument(number))))
            self.peak_force_n[name] = max(self.peak_force_n[name], force)

    def _instrument(self, number: int) -> Instrument:
        return next(one for one in self.session.simulation.instruments if one.name == self.names[number])

    def _free_name(self, name: str) -> str:
        """The name, or with a number where another instrument of it is in the tissue."""
        taken = {instrument.name for instrument in self.session.simulation.instruments}
        candidates = (name if count == 1 else f"{name[:56]} {count}" for count in itertools.count(1))
        return next(candidate for candidate in candidates if candidate not in taken)


def _timeline(action: Action, step_s: float, step_total: int) -> _Timeline:
    """Seconds to steps; two moments never share a step, so that no hand jumps."""
    steps, offsets = [round(action.start_s / step_s)], [(0.0, 0.0, 0.0)]
    for waypoint in action.path:
        if waypoint.time_s == action.start_s and not any(waypoint.offset_mm):
            continue
        steps.append(max(steps[-1] + 1, round(waypoint.time_s / step_s)))
        offsets.append(waypoint.offset_mm)
    release = step_total + 1 if action.release_s is None else max(steps[0] + 1, round(action.release_s / step_s))
    closed = steps[0]
    if isinstance(action, ForcepsAction):
        closed = max(closed + 1, round((action.start_s + action.close_s) / step_s))
    return _Timeline(action, steps[0], release, tuple(steps), np.array(offsets), closed)


def _stops(timeline: _Timeline, step_total: int) -> Iterator[int]:
    """Steps at which a hand closes, turns or lets go."""
    yield from (stop for stop in (*timeline.steps, timeline.closed, timeline.end) if 0 < stop < step_total)


def _furthest(simulation: Simulation) -> float:
    displacement = tissue_displacement(simulation.model, simulation.state.displacement)
    return float(np.linalg.norm(displacement, axis=1).max()) * simulation.model.cell_mm
