"""A guided tour in a page without a server: what its steps do was done when the page was made, and is played there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from heartcase.schemas.errors import HeartcaseError, Problem
from heartcase.simulator.case_simulation import simulation_of_case
from heartcase.simulator.live.live_frame import LiveFrame, moment_of
from heartcase.simulator.load import Case
from heartcase.simulator.session.frame import Frame
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.touring.case_places import CasePlaces
from heartcase.simulator.touring.running import run_timed
from heartcase.simulator.touring.staging import timed_commands
from heartcase.studio.sample_folder import sample_folder
from heartcase.studio.touring.found_tours import ShownTour, find_tours, tour_folders

__all__ = ["Toured", "tours_of"]

_EVERY_S = 0.04
"""Simulated time from picture to picture, s: played slower than it is, so that it can be followed."""


@dataclass
class Toured:
    """A tour, done on its case.

    Parameters
    ----------
    tour
        The tour.
    case
        The case, loaded with surface, structures and tissue.
    does_acts
        Whether what its steps do is done; else the page shows what they show, and says so.
    told
        Is told how far it is.
    """

    tour: ShownTour
    """The tour."""
    case: Case
    """The case."""
    does_acts: bool = True
    """Whether what its steps do is done."""
    ends: list[int] = field(default_factory=list)
    """For each step, how many of the moments are over at its end; shorter where a step could not be done."""
    problems: list[Problem] = field(default_factory=list)
    """Why the rest could not be done."""
    told: Callable[[float], None] = lambda _: None
    """Told after each step which part of them is done, 0 to 1."""

    @property
    def has_acts(self) -> bool:
        """Whether any step does something that is done."""
        return self.does_acts and any(step.acts for step in self.tour.tour.steps)

    def moments(self) -> Iterator[LiveFrame]:
        """All moments, from the start on; ``ends`` and ``problems`` are known when they have been taken."""
        if not self.has_acts:
            return
        case = self.case
        session, places = OperatingSession(simulation_of_case(case)), CasePlaces(case)
        yield moment_of(session)
        count = 1
        for number, step in enumerate(self.tour.tour.steps):
            taken: list[LiveFrame] = []

            def take(frame: Frame, taken: list[LiveFrame] = taken) -> None:
                if not taken or frame.time_s - taken[-1].frame.time_s >= _EVERY_S:
                    taken.append(moment_of(session, frame))

            try:
                run_timed(session, timed_commands(self.tour.tour, number, places), on_frame=take)
            except HeartcaseError as error:
                self.problems += [Problem(f"line {step.line} (step {number + 1})", str(one)) for one in error.problems]
                return
            if step.acts:
                taken.append(moment_of(session))
            yield from taken
            count += len(taken)
            self.ends.append(count)
            self.told((number + 1) / len(self.tour.tour.steps))

    def as_data(self) -> dict[str, Any]:
        """What the page is told of it, beside its moments."""
        return self.tour.as_data() | {"ends": self.ends}


def tours_of(case: Case, path: Path, *, does_acts: bool = True) -> tuple[list[Toured], tuple[Problem, ...]]:
    """The tours of a case, beside it and of those that come with heartcase, and what is wrong with others beside it.

    Parameters
    ----------
    case
        The case, loaded with surface, structures and tissue.
    path
        Its folder.
    does_acts
        As of :class:`Toured`.
    """
    found = find_tours(CasePlaces(case), tour_folders(path, case.manifest.name), sample_folder())
    return [Toured(one, case, does_acts) for one in found.shown], found.problems
