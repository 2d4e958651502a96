"""What is wrong with a guided tour: its text, what it names of its case, and what it does there."""

from __future__ import annotations

import re
from pathlib import Path

from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.bundle.manifest import nothing_there, read_manifest
from heartcase.schemas.errors import HeartcaseError, MissingPathError, Problem, UsageError
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.schemas.touring.names import tour_problems
from heartcase.schemas.touring.reading import TOUR_ENDING, load_tour, read_tour
from heartcase.schemas.touring.tour import Tour, TourHead

__all__ = ["tour_findings"]

_NAME = re.compile(r"^name\s*=\s*[\"']([^\"'\n]*)[\"']", re.M)


def tour_findings(path: Path, case: Path | None, *, run: bool) -> tuple[tuple[Problem, ...], tuple[CaseWarning, ...]]:
    """Problems and warnings of a tour.

    Parameters
    ----------
    path
        The tour's file.
    case
        The case or the recipe that it is for; the recipe beside it when left out.
    run
        Whether all that it does is done, which needs a case.

    Raises
    ------
    UsageError
        ``run`` without a built case, or there is nothing at a path.
    """
    if run and (case is None or not case.is_dir()):
        raise UsageError("--run needs a built case: give --case NAME.case", place="--run")
    if case is not None and not case.exists():
        raise MissingPathError(nothing_there(case), place="--case")
    try:
        read = read_tour(path)
    except HeartcaseError as error:
        return error.problems, ()
    problems = list(read.problems)
    found = case if case is not None or read.head is None else _recipe_beside(path, read.head)
    if found is None:
        why, mend = "no recipe of this case lies beside it", "give --case"
        if read.head is None:
            why, mend = "which case it is for cannot be read", "mend its head, or give --case"
        words = f"{why}, so it was not checked whether the case has what it names: {mend}"
        return tuple(problems), (CaseWarning(words),)
    try:
        stated = read_manifest(found) if found.is_dir() else load_recipe(found)
    except HeartcaseError as error:
        return (*problems, *error.problems), ()
    if read.head is not None and stated.name.lower() != read.head.case.lower():
        problems.append(Problem("case", f"the tour is for {read.head.case}, and this is {stated.name}"))
        return tuple(problems), ()
    problems += tour_problems(read, stated.landmarks, stated.labels)
    if problems or not run:
        return tuple(problems), ()
    return _done_on(load_tour(path), found)


def _recipe_beside(path: Path, head: TourHead) -> Path | None:
    """The recipe of a tour's case, in the tour's folder."""
    same = path.with_name(path.name[: -len(TOUR_ENDING)] + ".toml")
    for one in (same, *sorted(path.parent.glob("*.toml"))):
        try:
            text = one.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            continue
        name = _NAME.search(text)
        if "heartcase_recipe" in text and name is not None and name[1].lower() == head.case.lower():
            return one
    return None


def _done_on(tour: Tour, case: Path) -> tuple[tuple[Problem, ...], tuple[CaseWarning, ...]]:
    """What comes of all that a tour does on its case."""
    from heartcase.simulator.case_simulation import simulation_of_case
    from heartcase.simulator.load import load_case
    from heartcase.simulator.session.operating_session import OperatingSession
    from heartcase.simulator.touring.case_places import CasePlaces
    from heartcase.simulator.touring.running import run_timed
    from heartcase.simulator.touring.staging import staged_scenes, timed_commands

    loaded = load_case(case, needs=("surface", "structures", "tissue"))
    warnings: list[CaseWarning] = []
    problems: list[Problem] = []
    places = CasePlaces(loaded)
    try:
        staged_scenes(tour, places)
    except HeartcaseError as error:
        problems += error.problems
    session = OperatingSession(simulation_of_case(loaded))
    failed: list[str] = []
    for number, step in enumerate(tour.steps):
        where = f"line {step.line} (step {number + 1})"
        try:
            run_timed(session, timed_commands(tour, number, places))
        except HeartcaseError as error:
            said = (f"{one.place}: {one.message}" if one.place else one.message for one in error.problems)
            problems += [Problem(where, words) for words in said]
            failed.append(where)
        inverted = session.simulation.inverted_cell_count()
        if inverted:
            warnings.append(CaseWarning(f"{where}: {inverted} cells are inside out at its end: do less at a time"))
    if len(failed) > 1:
        first = f"what steps after {failed[0]} could not do may follow from what that one left undone: mend it first"
        warnings.append(CaseWarning(first))
    return tuple(problems), tuple(warnings)
