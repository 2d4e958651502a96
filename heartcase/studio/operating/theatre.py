"""A case that moves, and the pages that operate on it: all see the same session, each with a hand of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from heartcase.schemas.errors import HeartcaseError, UsageError
from heartcase.simulator.live.live import Live
from heartcase.studio.asking import request_id
from heartcase.studio.idle import FREE_AFTER_S, Idle
from heartcase.studio.message_words import problem_facts
from heartcase.studio.messages import text_message
from heartcase.studio.operating.acts import OwnAct, act, met
from heartcase.studio.operating.approved import WatchedApproval
from heartcase.studio.operating.ending import ended, problems_at
from heartcase.studio.operating.plans import ComparedPlans
from heartcase.studio.operating.requests import (
    Begin,
    Coarser,
    Compare,
    Device,
    Figures,
    LeavePage,
    Replay,
    SavePage,
    Seen,
    Slice,
    Strain,
    Tours,
    TourTo,
    parse_request,
)
from heartcase.studio.operating.saved_page import PageOf, SavedPage
from heartcase.studio.operating.scene.scan_slices import has_scan
from heartcase.studio.operating.slices import SliceServing
from heartcase.studio.operating.stage import Stage, open_stage
from heartcase.studio.operating.tour_leading import TourLeading
from heartcase.studio.operating.viewer import Viewer
from heartcase.studio.pages import Page
from heartcase.studio.touring.found_tours import tour_folders

__all__ = ["Origin", "Theatre"]

T = TypeVar("T")
_InTurn = (
    OwnAct | Tours | TourTo | Replay | Begin | Strain | Coarser | Figures | Compare | SavePage | LeavePage | Device
)
"""Requests that are carried out one after the other."""

_SOFTLY_S = 20.0
"""How long a session goes on at most when nobody looks any more, so that instruments let go, s."""
_LOOK_S = 0.05
_LOOK_EVERY_S = 1.0
"""How often it is looked whether the case was built anew."""
_OLDER = "the case was built anew, and what is shown is the one before: begin anew to see the new one"
_FREED = "no page had this case open for {minutes:.0f} minutes, and it was closed: this is its beginning"
_KEPT = _FREED + "; what was done is kept in the recording {name}: replay it to go on"
_BUILT_ANEW = "the case was built anew: this is the new one, and the session on the one before has ended"


@dataclass(frozen=True)
class Origin:
    """The recipe that a case was built from."""

    recipe: Path
    """Its file; never told to a page."""
    address: str
    """Path of its page in this server's addresses."""


class Theatre:
    """A case that is operated on, and the pages that show it.

    All methods belong to one event loop. What takes long runs in a thread of its own, one thing after the other; the
    session steps in another.

    Parameters
    ----------
    case
        The case's folder.
    out
        Folder that recordings are put into.
    page_of
        Makes the file that it is saved as, for browsers without a server.
    origin
        The recipe that it was built from, where it was opened from one: tours may stand beside it.
    """

    def __init__(self, case: Path, *, out: Path, page_of: PageOf, origin: Origin | None = None) -> None:
        self._case = case
        self._out = out
        self.origin = origin
        self._tours = TourLeading(self._tour_folders, self._problems, self._begin)
        self._slices = SliceServing(case, self._problems)
        self._stage: Stage | None = None
        self._viewers: dict[Page, Viewer] = {}
        self._waiting: set[Page] = set()
        self._letting: set[asyncio.Task[None]] = set()
        self._turn = asyncio.Lock()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="theatre")
        self._news = asyncio.Event()
        self._work: asyncio.Task[None] | None = None
        self._watching: asyncio.Task[None] | None = None
        self._resting: asyncio.Task[None] | None = None
        self._rests = False
        self._idle = Idle(self._free)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._plans = ComparedPlans(case, out, lambda: self._hear(self._plans.message))
        self.saved = SavedPage(case, out, page_of, lambda: self._hear(self._saved_message))
        self._freed: str | None = None
        self._approval = WatchedApproval(case)
        self._is_approved = False
        self._device_page: Page | None = None

    def _tour_folders(self, name: str) -> list[Path]:
        return tour_folders(self._case, name) + ([] if self.origin is None else [self.origin.recipe.parent])

    async def join(self, page: Page) -> None:
        """Show a page the case, and then each moment."""
        page.send(text_message("progress", text="open_case", fraction=None))
        self._waiting.add(page)
        # A page that goes meanwhile leaves the case open for the next: nothing that was begun is lost.
        task = asyncio.create_task(self._let_in(page))
        self._letting.add(task)
        task.add_done_callback(self._letting.discard)
        await asyncio.shield(task)

    async def _let_in(self, page: Page) -> None:
        async with self._turn:
            if page not in self._waiting:
                return
            try:
                stage, _ = await self._newest_stage()
                if page not in self._waiting:
                    self._rest_if_alone(stage)
                    return
                self._greet(page, stage)
                self._idle.end()
            except Exception as error:
                page.send(text_message("failed", problems=self._problems(error)))
                return
            finally:
                self._waiting.discard(page)
            if self._resting is not None:
                self._resting.cancel()
                self._resting = None
            if self._rests:
                self._rests = False
                stage.live.pause(False)
            if self._freed is not None:
                self._tell(text_message("message", **problem_facts("", self._freed)))
                self._freed = None
            self._news.set()

    async def _newest_stage(self) -> tuple[Stage, bool]:
        """The stage of the case as it lies there now, opened where there is none; whether it took another's place."""
        before = self._stage
        self._is_approved = await self._run(self._approval.is_approved)
        if before is not None and await self._run(lambda: before.is_of(self._case)):
            return before, False
        stage = self._stage = await self._run(self._open())
        if before is None:
            self._work = asyncio.create_task(self._show_on())
            if self._watching is None or self._watching.done():
                self._watching = asyncio.create_task(self._watch())
            return stage, False
        self._forget_stage()
        for page in self._viewers:
            self._greet(page, stage)
        self._tell(text_message("message", **problem_facts("", _BUILT_ANEW)))
        self._news.set()
        old = before.live
        if (words := await self._ended(before)) is not None:
            # a page shows one notice: the later one says both
            self._tell_or_keep(f"{_BUILT_ANEW}; {words}")
        self._tell_all_of(old)
        return stage, True

    def _greet(self, page: Page, stage: Stage) -> None:
        """Let a page look at a stage, from its beginning."""
        origin = self.origin
        more = {
            "is_approved": self._is_approved,
            "recipe": None if origin is None else origin.address,
            "scan": has_scan(self._case, None if origin is None else origin.recipe),
        }
        page.send(text_message("opened", **stage.greeting(), **more))
        if (picture := stage.picture_message()) is not None:
            page.send(picture)
        if self._plans.is_comparing:
            page.send(self._plans.message())
        if self.saved.facts:
            page.send(self._saved_message())
        self._viewers[page] = Viewer(stage)

    async def leave(self, page: Page) -> None:
        """Forget a page. What it led stays where it is, and then lets go softly; with the last page time stands."""
        self._waiting.discard(page)
        viewer = self._viewers.pop(page, None)
        if viewer is None:
            return
        viewer.hands.abandon()
        self._tours.forget(page)
        async with self._turn:
            if self._stage is None:
                return
            await self._update_seen()
            if self._device_page is page:
                self._device_page = None
                await self._run(self._stage.detach)
            self._rest_if_alone(self._stage)

    async def ask(self, page: Page, text: str) -> None:
        """Do what a page asks for."""
        try:
            request = parse_request(text)
            viewer, stage = self._viewers.get(page), self._stage
            if viewer is None or stage is None:
                raise UsageError("the case is not open", place="case")
            if isinstance(request, Seen):
                viewer.seen(request.frame)
                self._news.set()
                return
            if isinstance(request, Slice):
                recipe = None if self.origin is None else self.origin.recipe
                self._slices.ask(page, request, stage, recipe)
                return
            async with self._turn:
                # What it looked at when it asked may be closed by now.
                viewer, stage = self._viewers.get(page), self._stage
                if viewer is None or stage is None:
                    raise UsageError("the case is not open", place="case")
                answer = await self._do(request, viewer, stage, page)
                viewer = self._viewers.get(page, viewer)
        except Exception as error:
            page.send(text_message("refused", id=request_id(text), problems=self._problems(error)))
            return
        tool = viewer.hands.tool
        own = {
            "tool": "" if tool is None else tool.key,
            "size": None if tool is None else tool.size,
            "line_mm": [] if tool is None else tool.line_mm.tolist(),
        }
        page.send(text_message("done", id=request.id, **own, **answer))

    async def close(self) -> None:
        """End the session: what was begun is made, and what was done is kept in a recording."""
        self._waiting.clear()
        self._idle.close()
        for page in tuple(self._viewers):
            await self.leave(page)
            page.close()
        self._tours.stop()
        async with self._turn:
            for task in (self._resting, self._work, self._watching):
                if task is not None:
                    task.cancel()
            stage, self._stage = self._stage, None
            if stage is not None:
                await self._ended(stage)
        await self._run(self._plans.close)
        await self._run(self.saved.close)
        self._thread.shutdown()
        self._slices.close()

    def _open(self) -> Callable[[], Stage]:
        loop = self._loop = asyncio.get_running_loop()

        def heard() -> None:
            # The session's thread may end after the loop did.
            if not loop.is_closed():
                loop.call_soon_threadsafe(self._news.set)

        return lambda: open_stage(self._case, out=self._out, heard=heard)

    async def _do(self, request: _InTurn, viewer: Viewer, stage: Stage, page: Page) -> dict[str, Any]:
        """Carry a request out; what else its answer says."""
        live = stage.live
        match request:
            case Tours():
                return await self._run(lambda: self._tours.listed(stage))
            case TourTo():
                self._tours.lead(page, stage, request.tour, request.step)
            case Replay() | Begin():
                self._tours.stop()
                replayed = request if isinstance(request, Replay) else None
                newest, is_another = await self._newest_stage()
                if replayed is None and is_another:
                    return {}
                live = newest.live
                if replayed is None:
                    await self._run(newest.begin)
                else:
                    name, speed, skips = replayed.name, replayed.speed, replayed.skips
                    shown_s = await self._run(lambda: newest.replay(name, speed, skips=skips))
                    self._show_begun(live)
                    return {} if shown_s is None else {"shown_s": shown_s}
                self._show_begun(live)
            case Strain():
                viewer.wants_strain = request.shown
                await self._update_seen()
                self._news.set()
            case Coarser():
                viewer.wants_coarser = True
                await self._update_seen()
                self._news.set()
            case Figures():
                viewer.wants_figures = request.shown
                await self._update_seen()
                stage.figures.incision = request.incision
                if request.shown and request.reach:
                    live.pause(True)
                    stage.figures.ask_for_reach()
                self._news.set()
            case Compare():
                names = await self._run(lambda: [stage.finished(name) for name in request.names])
                # it takes seconds for each of them: the processors are for that
                live.pause(True)
                await self._run(lambda: self._plans.compare(names))
            case SavePage():
                names = await self._run(lambda: [stage.finished(name) for name in request.names])
                await self._run(lambda: self.saved.save(names))
            case LeavePage():
                await self._run(self.saved.leave)
            case Device():
                if request.name is None:
                    await self._run(stage.detach)
                else:
                    name, place = request.name, await self._run(lambda: met(viewer, request.pointer))
                    await self._run(lambda: stage.attach(name, place))
                self._device_page = page if request.name is not None else None
            case _:
                return await act(request, viewer, stage, self._run)
        return {}

    async def _begin(self, stage: Stage) -> None:
        """Begin anew with the case that is open, for a tour that lost its way."""
        async with self._turn:
            if self._stage is stage:
                live = stage.live
                await self._run(stage.begin)
                self._show_begun(live)

    def _show_begun(self, before: Live) -> None:
        """Pages look at another session than before."""
        self._tell_all_of(before)
        for one in self._viewers.values():
            one.begin_anew()
        self._news.set()

    async def _update_seen(self) -> None:
        """Work out what any page wants to see beside the heart, and leave what none does."""
        stage, viewers = self._stage, tuple(self._viewers.values())
        if stage is not None:
            await self._run(lambda: stage.show_strain(any(one.wants_strain for one in viewers)))
            await self._run(lambda: stage.show_coarser(any(one.wants_coarser for one in viewers)))
            await self._run(lambda: stage.figures.show(any(one.wants_figures for one in viewers)))

    async def _show_on(self) -> None:
        """Show each page what is new, again and again."""
        while True:
            await self._news.wait()
            self._news.clear()
            stage = self._stage
            if stage is None:
                return
            live = stage.live
            self._tell_all_of(live)
            if live.error is not None:
                if await self._fail(live.error, stage):
                    return
                continue
            newest = live.newest
            for page, viewer in tuple(self._viewers.items()):
                try:
                    messages = await asyncio.get_running_loop().run_in_executor(None, viewer.messages, newest)
                    # Meanwhile it may have been shown another stage.
                    if self._viewers.get(page) is not viewer:
                        continue
                    for message in messages:
                        page.send(message)
                    if (figures := viewer.figures(newest)) is not None:
                        page.send(figures)
                except Exception as error:
                    if live.error is not None:
                        # told, to all pages, with the next look
                        self._news.set()
                        break
                    self._let_go(page, viewer, error)

    def _let_go(self, page: Page, viewer: Viewer, error: BaseException) -> None:
        """What one page is to be shown cannot be told: it is let go, and the session goes on for all others."""
        if self._viewers.get(page) is viewer:
            page.send(text_message("failed", problems=self._problems(error)))
            task = asyncio.create_task(self.leave(page))
            self._letting.add(task)
            task.add_done_callback(self._letting.discard)

    async def _watch(self) -> None:
        """Tell pages once that the case they look at is no longer the one that lies there, and when it is approved."""
        told = stage = None
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            stage = self._stage
            if stage is None:
                told = None
            if stage is None or stage is told or not self._viewers:
                continue
            is_approved = await self._run(self._approval.is_approved)
            if is_approved != self._is_approved:
                self._is_approved = is_approved
                self._tell(text_message("approval", is_approved=is_approved))
            if not await self._run(partial(stage.is_of, self._case)) and self._stage is stage:
                told = stage
                self._tell(text_message("message", **problem_facts("", _OLDER)))

    async def _fail(self, error: BaseException, stage: Stage) -> bool:
        """The session cannot go on: it is told, what was done is kept, and who comes next begins anew.

        Where another stage took its place meanwhile nothing is done; whether something was.
        """
        async with self._turn:
            if self._stage is not stage:
                return self._stage is None
            self._stage = None
            self._forget_stage()
            words = await self._ended(stage)
            problems = self._problems(error)
            if words is not None:
                problems.append(problem_facts("recording", words))
                if not self._viewers:
                    self._freed = words
            self._tell(text_message("failed", problems=problems))
            self._viewers.clear()
            return True

    async def _ended(self, stage: Stage) -> str | None:
        """End a stage's session; what is to be read of what was done in it, None where a recording had it."""
        return await self._run(lambda: ended(stage, self._problems))

    def _tell_or_keep(self, words: str) -> None:
        """Tell all pages; where there is none, the next that comes."""
        if self._viewers:
            self._tell(text_message("message", **problem_facts("", words)))
        else:
            self._freed = words

    def _rest_if_alone(self, stage: Stage) -> None:
        if not self._viewers and self._resting is None:
            self._resting = asyncio.create_task(self._rest(stage))
            self._idle.begin()

    async def _free(self) -> None:
        """Nobody had it open for long: leave it, unless it is recorded, or what was done cannot be kept."""
        async with self._turn:
            stage = self._stage
            if stage is None or self._viewers or self._waiting or stage.live.newest.recording is not None:
                return
            try:
                name = await self._run(stage.keep)
            except HeartcaseError:
                return
            if self._stage is not stage:
                return
            words = _FREED if name is None else _KEPT
            shown = None if name is None else name.removesuffix(".recording")
            self._freed = words.format(minutes=FREE_AFTER_S / 60.0, name=shown)
            if self._work is not None:
                self._work.cancel()
            # an ended task would hold on to what it worked on
            self._stage = self._work = self._resting = None
            self._forget_stage()
            await self._run(self._plans.close)
            await self._run(stage.close)

    def _forget_stage(self) -> None:
        """Nothing holds on to a stage that is left."""
        self._tours.forget_stage()
        self._slices.forget_stage()

    async def _rest(self, stage: Stage) -> None:
        """Nobody looks: when instruments have let go, time stands until somebody does."""
        live = stage.live
        for _ in range(int(_SOFTLY_S / _LOOK_S)):
            await asyncio.sleep(_LOOK_S)
            if not live.is_leaving:
                break
        if live.newest.mode == "running":
            live.pause(True)
            self._rests = True

    async def _run(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def _tell_all_of(self, live: Live) -> None:
        """Tell what a session has to say."""
        for said in live.take_messages():
            self._tell(text_message("message", **problem_facts(said.place, said.message)))

    def _tell(self, message: str) -> None:
        for page in self._viewers:
            page.send(message)

    def _hear(self, message: Callable[[], str]) -> None:
        """Called by any thread: what was worked out beside is told to all pages."""
        loop = self._loop
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(lambda: self._tell(message()))

    def _saved_message(self) -> str:
        return text_message("saved_page", **self.saved.facts)

    def _problems(self, error: BaseException) -> list[dict[str, Any]]:
        """What a page is told of an error; not where on this machine the case lies."""
        return problems_at(self._case, error)
