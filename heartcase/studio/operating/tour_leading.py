"""The guided tours of a case that pages operate on: which there are, and the page that is led through one."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from heartcase.schemas.errors import UsageError
from heartcase.simulator.touring.case_places import CasePlaces
from heartcase.studio.messages import text_message
from heartcase.studio.operating.stage import Stage
from heartcase.studio.pages import Page
from heartcase.studio.sample_folder import sample_folder
from heartcase.studio.touring.found_tours import FoundTours, find_tours
from heartcase.studio.touring.guide import Guide, LostWayError

__all__ = ["TourLeading"]


class TourLeading:
    """Leads the session of a stage through tours, one at a time.

    Parameters
    ----------
    folders
        Tells where tours of the case of a name may stand.
    problems_of
        What a page is told of an error.
    begin
        Begins a stage's session anew.
    """

    def __init__(
        self,
        folders: Callable[[str], list[Path]],
        problems_of: Callable[[BaseException], list[dict[str, Any]]],
        begin: Callable[[Stage], Awaitable[None]],
    ) -> None:
        self._folders = folders
        self._problems_of = problems_of
        self._begin = begin
        self._stage: Stage | None = None
        self._found: FoundTours | None = None
        self._guide: Guide | None = None
        self._task: asyncio.Task[None] | None = None
        self._led: Page | None = None
        self._tell_left: Callable[[], None] = _nothing

    def listed(self, stage: Stage) -> dict[str, Any]:
        """The tours of a stage's case, read anew; what is wrong with others."""
        places = CasePlaces(stage.case)
        found = find_tours(places, self._folders(stage.case.manifest.name), sample_folder())
        if stage is not self._stage or self._found is None or found != self._found:
            self._stage, self._found, self._guide = stage, found, Guide(places)
        return {
            "tours": [one.as_data() for one in self._found.shown],
            "tour_problems": [{"place": one.place, "message": one.message} for one in self._found.problems],
        }

    def lead(self, page: Page, stage: Stage, number: int, step: int | None) -> None:
        """Begin to bring the session to where a step leaves it; the page is told how that goes.

        Raises
        ------
        UsageError
            There is no such tour, or no such step.
        """
        guide, found = self._guide, self._found
        if guide is None or found is None or stage is not self._stage or number >= len(found.shown):
            raise UsageError("there is no tour of this number: look at the list again", place="tour")
        tour = found.shown[number]
        if step is not None and step >= len(tour.tour.steps):
            raise UsageError(f"the tour has {len(tour.tour.steps)} steps", place="step")
        self.stop()
        if step is None:
            guide.leave()
            return

        def tell(state: str, **more: Any) -> None:
            page.send(text_message("tour", tour=number, step=step, state=state, **more))

        async def lead() -> None:
            try:
                try:
                    await guide.enter(stage.live, tour, step, lambda: tell("working"))
                except LostWayError:
                    await self._begin(stage)
                    await guide.enter(stage.live, tour, step)
                tell("ready")
            except Exception as error:
                tell("failed", problems=self._problems_of(error))

        self._task, self._led = asyncio.create_task(lead()), page
        self._tell_left = lambda: tell("left")

    def forget(self, page: Page) -> None:
        """A page is gone: nobody looks at what it asked for."""
        if page is self._led:
            self.stop()
            self._led = None

    def forget_stage(self) -> None:
        """The stage is left: what is under way ends, and nothing of its case stays in memory."""
        self.stop()
        self._stage = self._found = self._guide = self._led = None

    def stop(self) -> None:
        """Leave what is under way; the page that asked for it is told."""
        task, tell_left = self._task, self._tell_left
        self._task, self._tell_left = None, _nothing
        if task is not None and not task.done():
            task.cancel()
            # at once: what is asked for next has more to tell of the same step
            tell_left()


def _nothing() -> None:
    """Nothing is under way."""
