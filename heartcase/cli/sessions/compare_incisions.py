"""``heartcase compare-incisions``: several plans of incisions on one or several cases, measured and ranked."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path

import click

from heartcase.cli.shared.film import write_animation, write_picture
from heartcase.cli.shared.incision_pictures import film_of_defect, stretch_colours, view_of_defect
from heartcase.cli.shared.incision_results import CaseResult, markdown, page
from heartcase.cli.shared.output import echo_json, json_ready, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.sessions import check_numbers, law_options, require_folder, session_bar, with_law
from heartcase.schemas.errors import Problem, ScriptError, SimulationError, UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.scripts.incision_plans import PlannedIncision
from heartcase.simulator.engine.backends import Backend
from heartcase.simulator.lattice.moduli import LawName
from heartcase.simulator.load import Case, Need, load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.planned_incisions import (
    HeldOpen,
    PlansOnCase,
    load_plans,
    on_case,
    run_plan,
)
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.write_surface import write_surface

__all__ = ["command"]

_PATH = click.Path(path_type=Path, readable=False)
_FOLDER = OutputPath(is_folder=True)

_FRAMES_PER_SECOND, _FILM_FRAMES_PER_SECOND = 25.0, 10.0
"""Frames of an animation in a second of simulated time, and in one of those who look at it."""

COMPARISON_VERSION = 1
"""Version of what --json and --out give."""


@click.command()
@click.argument("cases", metavar="CASE...", type=_PATH, nargs=-1, required=True)
@click.argument("plans", metavar="PLANS", type=_PATH)
@click.option("-o", "--out", type=OutputPath(), help="Write the result here as JSON.")
@click.option(
    "--table", "table_out", type=OutputPath(), help="Write a table in Markdown here, a row for each plan and defect."
)
@click.option("--page", "page_out", type=OutputPath(), help="Write a page here (.html), with figures and pictures.")
@click.option(
    "--pictures",
    type=_FOLDER,
    help="A folder for pictures of each plan and defect (.png), stretch and stress as colours.",
)
@click.option(
    "--animations",
    type=_FOLDER,
    help="A folder for animations of each plan and defect (.gif), from the best eye.",
)
@click.option(
    "--surfaces",
    type=_FOLDER,
    help="A folder for surfaces as they are held open (.ply), stretch as colours.",
)
@click.option("--recordings", type=_FOLDER, help="A folder for a recording of each plan (NAME.recording).")
@law_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.pass_context
def command(
    ctx: click.Context,
    cases: tuple[Path, ...],
    plans: Path,
    out: Path | None,
    table_out: Path | None,
    page_out: Path | None,
    pictures: Path | None,
    animations: Path | None,
    surfaces: Path | None,
    recordings: Path | None,
    backend: Backend,
    law: LawName,
    poissons_ratio: float,
    sleep_mm: float,
    as_json: bool,
) -> None:
    """Run each plan of PLANS on each CASE: cut, hold open, measure; then rank the plans for each defect.

    PLANS is a file of incision plans (TOML), or a folder that holds one for each case: NAME.toml, by the case's name.
    Exits with 1 where a plan could not be run to its end; the others are told all the same.
    """
    check_numbers(poissons_ratio=poissons_ratio, sleep_mm=sleep_mm)
    for path in (out, table_out, page_out, pictures, animations, surfaces, recordings):
        if path is not None:
            require_folder(path)
    with working("reading the cases"):
        needs: tuple[Need, ...] = ("surface", "colours", "tissue", "cell_labels")
        loaded = [with_law(load_case(one, needs=needs), law, poissons_ratio) for one in cases]
    planned = _planned(loaded, plans)
    wanted = _Wanted(pictures, animations, surfaces, recordings, page_out is not None, backend, sleep_mm)
    wanted.make_folders(loaded, planned)
    results = [CaseResult(case, on, law, poissons_ratio) for case, on in zip(loaded, planned, strict=True)]
    with session_bar("comparing", sum(on.seconds for on in planned)) as tell:
        done_s = 0.0
        for result in results:
            for plan in result.on.runs:
                _run(result, plan, wanted, _after(tell, done_s))
                done_s += plan.seconds
    told = {"heartcase_comparison": COMPARISON_VERSION, "cases": [one.facts() for one in results]}
    if out is not None:
        atomic_write(out, (json.dumps(json_ready(told), indent=2, allow_nan=False) + "\n").encode())
    if table_out is not None:
        atomic_write(table_out, markdown(results).encode())
    if page_out is not None:
        atomic_write(page_out, page(results).encode())
    if as_json:
        echo_json(told)
    else:
        for one in results:
            click.echo(one.words())
    problems = [problem for one in results for problem in one.problems]
    for problem in problems:
        click.echo(f"heartcase: {problem}", err=True)
    if problems:
        ctx.exit(1)


@dataclass(frozen=True)
class _Wanted:
    """What is written beside the tables, and how tissue is stepped."""

    pictures: Path | None
    animations: Path | None
    surfaces: Path | None
    recordings: Path | None
    has_page: bool
    backend: Backend
    sleep_mm: float

    def make_folders(self, cases: Sequence[Case], planned: Sequence[PlansOnCase]) -> None:
        """Make the folders; UsageError where a recording is there already, or two cases' files have one name."""
        folders = [one for one in (self.pictures, self.animations, self.surfaces, self.recordings) if one is not None]
        count = Counter(_plain(case.manifest.name) for case in cases)
        same = sorted({case.manifest.name for case in cases if count[_plain(case.manifest.name)] > 1})
        if folders and same:
            words = f"the files of several cases would have one name ({', '.join(same)}): compare them one at a time"
            raise UsageError(words, place="CASE")
        for folder in folders:
            folder.mkdir(exist_ok=True)
        if self.recordings is not None:
            names = [
                f"{_file_name(case, plan.name)}.recording"
                for case, on in zip(cases, planned, strict=True)
                for plan in on.runs
            ]
            there = [name for name in names if (self.recordings / name).exists()]
            if there:
                message = (
                    f"there is a recording already: take it away first, or give another folder: {', '.join(there)}"
                )
                raise UsageError(message, place="--recordings")


def _after(tell: Callable[[float], None], done_s: float) -> Callable[[float], None]:
    """Tells the simulated time of all plans, told that of one."""
    return lambda time_s: tell(done_s + time_s)


def _planned(cases: Sequence[Case], plans: Path) -> list[PlansOnCase]:
    """The plans of each case; ScriptError with all problems of all of them."""
    problems: list[Problem] = []
    found = []
    shared = None if plans.is_dir() else load_plans(plans)
    for case in cases:
        name = case.manifest.name
        try:
            own = shared or load_plans(plans / f"{name}.toml")
            found.append(on_case(own, case.manifest.landmarks))
        except ScriptError as error:
            if len(cases) == 1:
                raise
            problems += [Problem(f"{name}: {one.place}" if one.place else name, one.message) for one in error.problems]
    if problems:
        raise ScriptError(problems)
    return found


def _run(result: CaseResult, plan: PlannedIncision, wanted: _Wanted, on_time: Callable[[float], None]) -> None:
    """Run a plan, and keep what it came to, or why it did not."""
    case, on = result.case, result.on
    session = OperatingSession(
        Simulation(
            case.model,
            surface=case.surface,
            tissue=case.tissue,
            step_s=on.plans.step_s,
            damping_per_s=on.plans.damping_per_s,
            backend=wanted.backend,
            sleep_mm=wanted.sleep_mm,
        ),
        snapshot_every_s=inf,
    )
    name = _file_name(case, plan.name)
    recorder = None
    if wanted.recordings is not None:
        recorder = Recorder(session, wanted.recordings / f"{name}.recording", case=case.manifest)
    try:
        held = run_plan(plan, on, case, session, on_time=on_time)
        if recorder is not None:
            recorder.finish()
    except SimulationError as error:
        if recorder is not None:
            recorder.discard()
        result.problems += [Problem(f"{case.manifest.name}, {plan.name}", str(one)) for one in error.problems]
        return
    except BaseException:
        if recorder is not None:
            recorder.discard()
        raise
    result.held.append(held)
    _show(result, held, session, wanted, name)


def _show(result: CaseResult, held: HeldOpen, session: OperatingSession, wanted: _Wanted, name: str) -> None:
    """Pictures and the surface of what a session came to, and films of how."""
    case, simulation = result.case, session.simulation
    assert case.triangle_colours is not None
    assert simulation.surface is not None
    case_id = case.manifest.case_id
    comment = f"heartcase {case_id}" if case_id else "heartcase"
    if wanted.pictures is not None or wanted.has_page:
        for defect in held.figures:
            picture = view_of_defect(held, defect, simulation, case.triangle_colours)
            if wanted.has_page:
                result.pictures[held.plan.name, defect] = picture
            if wanted.pictures is not None:
                path = wanted.pictures / f"{name}-{_plain(defect)}.png"
                write_picture(path, picture, comment=comment)
    if wanted.surfaces is not None:
        shown = simulation.surface_now()
        write_surface(
            wanted.surfaces / f"{name}.ply",
            shown.vertices_mm,
            shown.normals,
            simulation.surface.triangles,
            colours=stretch_colours(held, simulation),
            case_id=case_id,
        )
    if wanted.animations is not None:
        for defect in held.figures:
            path = wanted.animations / f"{name}-{_plain(defect)}.gif"
            film = film_of_defect(held, defect, session, case.triangle_colours, frames_per_second=_FRAMES_PER_SECOND)
            write_animation(path, film, frames_per_second=_FILM_FRAMES_PER_SECOND, comment=comment)


def _file_name(case: Case, plan: str) -> str:
    """Name of a plan's files."""
    return f"{_plain(case.manifest.name)}-{_plain(plan)}"


def _plain(words: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", words.lower()).strip("-")
