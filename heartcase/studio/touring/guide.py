"""Leads a live session through the steps of a tour: on, back, and again after a learner took over.

What a step does are commands of the session. Going back is going to the moment at which the step before ended, of what
the session knows; so a step's commands are undone with all that was done since.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import Act, Cut, Done, GoTo, Halt, LeadGrab, Mark, MoveProbe
from heartcase.schemas.touring.tour import Wait
from heartcase.simulator.live.live import Live
from heartcase.simulator.touring.case_places import CasePlaces
from heartcase.simulator.touring.staging import timed_commands
from heartcase.studio.touring.found_tours import ShownTour

__all__ = ["Guide", "LostWayError"]

_LOOK_S = 0.01
_PATIENCE_S = 120.0
"""How long a command, or time that goes by, may take at most, s."""
_OWN = (*get_args(Act), LeadGrab, MoveProbe)


class LostWayError(Exception):
    """The moment at which the tour began is no longer known: the session has to begin anew."""


@dataclass(frozen=True)
class _Reached:
    """A moment of the session: the tour's beginning, or the end of what a step does."""

    tour: ShownTour
    step: int
    """Number of the step, from 0; -1 for the beginning."""
    mark: str
    """Name of the mark that stands there."""


class Guide:
    """Leads a session through tours.

    Parameters
    ----------
    places
        Places of the case.
    """

    def __init__(self, places: CasePlaces) -> None:
        self._places = places
        self._live: Live | None = None
        self._reached: list[_Reached] = []
        self._count = 0

    async def enter(self, live: Live, tour: ShownTour, step: int, doing: Callable[[], None] = lambda: None) -> None:
        """Bring the session to the end of what a step does, and of what those before it did.

        Parameters
        ----------
        live
            The session.
        tour
            The tour.
        step
            Number of the step, from 0.
        doing
            Called when there is something to be done.

        Raises
        ------
        LostWayError
            The tour's beginning is no longer known: begin anew, and enter again.
        HeartcaseError
            A command was refused, or the case lacks what it names.
        """
        if live is not self._live:
            self._live, self._reached = live, []
        wanted = [number for number in range(step + 1) if tour.tour.steps[number].acts]
        if self._reached:
            # What a step that was left on the way had asked for is done by now, or never.
            shown = live.newest
            await self._asked(live, None)
            await self._until(live, lambda: live.newest is not shown or live.newest.mode == "paused")
        if not self._reached or self._reached[0].tour is not tour:
            if not wanted:
                return
            if self._reached:
                # another tour's commands are taken back first
                doing()
                await self._return(live, 1)
            self._reached = [_Reached(tour, -1, await self._marked(live, "tour begins"))]
        kept = 1
        for reached, number in zip(self._reached[1:], wanted, strict=False):
            if reached.step != number:
                break
            kept += 1
        rest = wanted[kept - 1 :]
        if kept < len(self._reached) or not self._is_there(live):
            doing()
            await self._return(live, kept)
        if not rest:
            return
        doing()
        live.pause(False)
        for number in rest:
            await self._do(live, tour, number)

    def leave(self) -> None:
        """The tour is left: what is done stays, and another begins where the session is."""
        self._reached = []

    def _is_there(self, live: Live) -> bool:
        """Whether the session is where the last step left it, but for time that went by."""
        entries, position = live.session.entries, live.session.position
        found = self._found(live, self._reached[-1].mark)
        if found is None or found[0] >= position or live.newest.frame.coming_cuts:
            return False
        return not entries.has_any((*_OWN, Halt), found[0] + 1, position)

    def _found(self, live: Live, mark: str) -> tuple[int, int] | None:
        """Place of a mark in what the session knows, and its step."""
        found = live.session.entries.last_of(
            Mark, lambda entry: isinstance(entry.command, Mark) and entry.command.name == mark
        )
        return None if found is None else (found[0], found[1].step)

    async def _return(self, live: Live, kept: int) -> None:
        """Go to where so many of the moments that were reached are, or further back where those are not known."""
        found = None
        while kept > 0 and found is None:
            found = self._found(live, self._reached[kept - 1].mark)
            kept -= found is None
        if found is None:
            self._reached = []
            raise LostWayError
        del self._reached[kept:]
        _, step = found
        await self._asked(live, GoTo(step=step))
        await self._until(live, lambda: live.newest.frame.step == step and live.newest.mode == "paused")
        # what a tour does comes again by itself
        live.forget_ahead()
        live.pause(False)

    async def _do(self, live: Live, tour: ShownTour, number: int) -> None:
        """Give a step's commands, each in its time."""
        timed = await asyncio.get_running_loop().run_in_executor(None, timed_commands, tour.tour, number, self._places)
        due = live.newest.frame.step
        for one in timed:
            if isinstance(one, Wait):
                due = max(due, live.newest.frame.step) + max(1, round(one.seconds / live.session.simulation.step_s))
                await self._until_step(live, due)
                continue
            await self._asked(live, one)
            if isinstance(one, Cut):
                await self._until(live, lambda: not live.newest.frame.coming_cuts and not live.is_leaving)
                due = live.newest.frame.step
        self._reached.append(_Reached(tour, number, await self._marked(live, f"tour step {number + 1}")))

    async def _marked(self, live: Live, words: str) -> str:
        """Mark this moment, and let time go on from it."""
        self._count += 1
        name = f"{words} ({self._count})"
        live.pause(False)
        await self._asked(live, Mark(name=name))
        found = self._found(live, name)
        step = live.newest.frame.step if found is None else found[1]
        # What comes next is given at a later step: going to this one leaves it out.
        await self._until_step(live, step + 1)
        return name

    async def _asked(self, live: Live, command: Done | GoTo | None) -> None:
        try:
            # not wait_for: in Python 3.11 it goes on where it is cancelled at the moment of the answer
            async with asyncio.timeout(_PATIENCE_S):
                await asyncio.wrap_future(live.asked(command))
        except TimeoutError:
            raise SimulationError("the session does not answer: begin anew", place="tour") from None

    async def _until_step(self, live: Live, step: int) -> None:
        before = live.newest.frame.step

        def is_there() -> bool:
            nonlocal before
            now = live.newest.frame.step
            if now < before:
                raise SimulationError("time went back while the tour was at work: show the step again", place="tour")
            before = now
            return now >= step

        await self._until(live, is_there)

    async def _until(self, live: Live, is_so: Callable[[], bool]) -> None:
        loop = asyncio.get_running_loop()
        end = loop.time() + _PATIENCE_S
        while not is_so():
            if live.error is not None or loop.time() > end:
                raise SimulationError("the session does not go on: show the step again, or begin anew", place="tour")
            if live.newest.mode == "paused":
                # a learner lets time stand: nothing is late by that
                end = loop.time() + _PATIENCE_S
            await asyncio.sleep(_LOOK_S)
