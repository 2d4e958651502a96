"""What is open in the studio, and the pages that look at it: one thing after the other, in the order of asking."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from heartcase.pipeline.markers.states import StillSegmentation
from heartcase.schemas.errors import RecipeError, UsageError
from heartcase.studio.asking import request_id
from heartcase.studio.idle import Idle
from heartcase.studio.messages import problems_of, text_message, told
from heartcase.studio.pages import Page
from heartcase.studio.painting.drafts import receive_draft
from heartcase.studio.painting.painting import Painting, open_painting
from heartcase.studio.painting.requests import End, History, Lock, Look, Paint, parse_request
from heartcase.studio.painting.states import States
from heartcase.studio.shaping.requests import Act

__all__ = ["Workplace"]

T = TypeVar("T")

_ACTS = Paint | End | History | Lock | Act
"""Requests that change the recipe, or save a stroke that is not in it yet."""
_CHANGED = "another program changed the recipe: it was opened again, so look before you go on"
_CHANGED_AND_LOST = (
    "another program changed the recipe: it was opened again, and the last stroke, which was not saved yet, is lost; "
    "look before you go on"
)
_SPOILT = "another program changed the recipe, and it cannot be opened any more: mend it, then load this page again"
_SPOILT_AND_LOST = (
    "another program changed the recipe, and it cannot be opened any more; the last stroke, which was not saved yet, "
    "is lost: mend the recipe, then load this page again"
)
_WRITING_S = 0.25
"""How long to wait for a program that may still be writing the recipe."""
_TRIES = 20


class Workplace:
    """A recipe that is open, and the pages that show it.

    All methods belong to one event loop. What takes long runs in one thread of its own, one thing after the other.

    Parameters
    ----------
    recipe
        The recipe's file.
    out
        Directory that the case is built in, with the build's cache.
    """

    def __init__(self, recipe: Path, *, out: Path) -> None:
        self._recipe = recipe
        self._out = out
        self._painting: Painting | None = None
        self._has_lost = False
        self._is_closed = False
        self._pages: set[Page] = set()
        self._waiting: set[Page] = set()
        self._turn = asyncio.Lock()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="studio")
        self._receives = False
        self._aside = ThreadPoolExecutor(1, thread_name_prefix="studio-aside")
        self._tasks: set[asyncio.Task[None]] = set()
        self._states = States(self._copied, self._tell)
        self._idle = Idle(self._free)

    async def join(self, page: Page) -> None:
        """Show a page everything, and then all that changes."""
        page.send(text_message("progress", text="open", fraction=None))
        self._waiting.add(page)
        # A page that goes meanwhile leaves the recipe open for the next: it is opened once.
        task = asyncio.create_task(self._let_in(page))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        await asyncio.shield(task)

    async def _let_in(self, page: Page) -> None:
        async with self._turn:
            if page in self._waiting:
                self._waiting.discard(page)
                # Progress of opening is for all who wait for it.
                self._pages.add(page)
                self._idle.end()
                if self._painting is None or await self._reopened(self._painting, joins=page) is None:
                    await self._show_all((page,))
                if self._has_lost:
                    page.send(text_message("refused", id=None, problems=problems_of(_changed(is_lost=True))))
                    self._has_lost = False

    async def leave(self, page: Page) -> None:
        """Forget a page; its stroke ends where it is."""
        self._waiting.discard(page)
        self._pages.discard(page)
        async with self._turn:
            painting = self._painting
            if painting is not None:
                is_last = not self._pages
                if is_last or painting.is_saved or await self._reopened(painting) is None:
                    await self._refusing(lambda: painting.leave(page, is_last=is_last))
                if is_last:
                    self._idle.begin()

    async def _free(self) -> None:
        """Nobody had it open for long: all of it is in the recipe, which is opened again for who comes."""
        async with self._turn:
            painting = self._painting
            if painting is None or self._pages or self._waiting:
                return
            try:
                await self._run(painting.save)
            except Exception:
                # what cannot be saved stays, unless it never can
                if not await self._run(lambda: painting.is_stale):
                    return
                self._has_lost = not painting.is_saved
            self._painting = None

    async def ask(self, page: Page, text: str) -> None:
        """Do what a page asks for, and tell it and the others."""
        async with self._turn:
            try:
                request = parse_request(text)
                if self._painting is None:
                    raise RecipeError("it is not open", place="recipe")
                painting = self._painting
                is_act = isinstance(request, _ACTS)
                if is_act and (changed := await self._reopened(painting, but=page)) is not None:
                    raise changed
                try:
                    answer = await self._run(lambda: painting.do(request, page, self._pages))
                except RecipeError:
                    # it was changed since it was looked at
                    if is_act and (changed := await self._reopened(painting, but=page)) is not None:
                        raise changed from None
                    raise
            except Exception as error:
                page.send(text_message("refused", id=request_id(text), problems=problems_of(told(error))))
                return
            for one in self._pages & answer.for_each.keys():
                for labels in answer.for_each[one]:
                    one.send(labels)
            for message in answer.for_all:
                is_done = isinstance(message, str) and answer.done is not None and message.startswith('{"kind": "done"')
                for one in self._pages:
                    # who asked is told so by the answer itself
                    if not (is_done and one is page):
                        one.send(message)
            if answer.done is not None:
                page.send(answer.done)
            if isinstance(request, History) and painting.is_outdated:
                await self._open_again()
            # while the rest comes, and whoever scrolls on changes nothing
            if not isinstance(request, Look):
                self._states.later()
        if answer.later is not None:
            self._start(page, text, answer.later)

    def _start(self, page: Page, text: str, work: Callable[[], tuple[str | bytes, ...]]) -> None:
        """Do what takes long beside all else, and tell who asked."""

        async def answer() -> None:
            try:
                for message in await asyncio.get_running_loop().run_in_executor(self._aside, work):
                    page.send(message)
            except Exception as error:
                page.send(text_message("refused", id=request_id(text), problems=problems_of(told(error))))

        task = asyncio.create_task(answer())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def add_draft(self, stream: AsyncIterator[bytes]) -> None:
        """Take a draft in that a page sends, and show all pages what comes of it.

        Parameters
        ----------
        stream
            What is sent: see :mod:`heartcase.studio.painting.drafts`.

        Raises
        ------
        HeartcaseError
            It cannot be taken, and nothing has changed.
        """
        if self._receives:
            raise UsageError("another draft is being taken in: wait for it", place="draft")
        self._receives = True
        try:
            draft = await receive_draft(stream, self._recipe.resolve().parent)
            try:
                async with self._turn:
                    lattices = (await self._for_draft()).lattices
                # others go on meanwhile
                ready = await asyncio.get_running_loop().run_in_executor(self._aside, draft.checked, *lattices)
                async with self._turn:
                    painting = await self._for_draft()
                    if painting.lattices != lattices:
                        raise RecipeError("it was changed while the draft was read: drop it again", place="recipe")
                    await self._run(lambda: painting.add(draft, ready))
                    await self._open_again()
            finally:
                draft.discard()
        finally:
            self._receives = False

    async def _for_draft(self) -> Painting:
        painting = self._painting
        if painting is None or self._is_closed:
            raise RecipeError("it is not open", place="recipe")
        if (changed := await self._reopened(painting)) is not None:
            raise changed
        return painting

    async def close(self) -> None:
        """End: a stroke that is not saved yet is saved."""
        self._is_closed = True
        self._waiting.clear()
        self._idle.close()
        async with self._turn:
            # What is being opened is open first.
            self._states.close()
            if self._painting is not None:
                await self._refusing(self._painting.save)
        for page in tuple(self._pages):
            await self.leave(page)
            page.close()
        self._thread.shutdown()
        # a draft that is being read holds nothing else up
        await asyncio.to_thread(self._aside.shutdown, cancel_futures=True)

    async def _show_all(self, pages: tuple[Page, ...], *, if_spoilt: RecipeError | None = None) -> None:
        """Show pages everything; where it cannot be opened, why, after what is to be said of it first."""
        try:
            painting = self._painting or await self._opened()
            messages = await self._run(painting.greeting)
        except Exception as error:
            before = [] if if_spoilt is None else problems_of(if_spoilt)
            messages = (text_message("failed", problems=[*before, *problems_of(told(error))]),)
        for page in pages:
            for message in messages:
                page.send(message)
        self._states.later()

    async def _opened(self) -> Painting:
        """Open the recipe; one that another program is writing is waited for."""
        loop = asyncio.get_running_loop()
        listener = _Progress(lambda message: loop.call_soon_threadsafe(self._tell, message))
        for _ in range(_TRIES):
            before = await self._run(self._text)
            try:
                painting = await self._run(lambda: open_painting(self._recipe, out=self._out, listener=listener))
            except Exception:
                await asyncio.sleep(_WRITING_S)
                if await self._run(self._text) == before:
                    raise
                continue
            # What is shown and what can be taken back must be of one text.
            if await self._run(self._text) == before:
                self._painting = painting
                return painting
        raise RecipeError(
            "another program goes on changing it: let that end, then load this page again", place="recipe"
        )

    def _text(self) -> bytes | None:
        try:
            return self._recipe.read_bytes()
        except OSError:
            return None

    async def _reopened(
        self, painting: Painting, *, but: Page | None = None, joins: Page | None = None
    ) -> RecipeError | None:
        """Open a recipe again that another program changed; all pages are told, also of a stroke that is lost by it.

        Parameters
        ----------
        painting
            The recipe, as it is open.
        but
            A page that is told what is returned.
        joins
            A page that has not shown it yet: it is told of a lost stroke alone.

        Returns
        -------
        RecipeError or None
            What is to be said of it; None where nobody changed it.
        """
        if not await self._run(lambda: painting.is_stale):
            return None
        is_lost = not painting.is_saved
        spoilt = RecipeError(_SPOILT_AND_LOST if is_lost else _SPOILT, place="recipe")
        if not await self._open_again(if_spoilt=spoilt):
            # all pages have been told
            return spoilt
        error = _changed(is_lost=is_lost)
        for page in self._pages - ({but} if is_lost else {but, joins}):
            page.send(text_message("refused", id=None, problems=problems_of(error)))
        return error

    async def _open_again(self, *, if_spoilt: RecipeError | None = None) -> bool:
        """Open it again for all pages; whether it can be opened."""
        self._painting = None
        await self._show_all(tuple(self._pages), if_spoilt=if_spoilt)
        return self._painting is not None

    async def _refusing(self, work: Callable[[], tuple[str, ...]]) -> None:
        """Do something for nobody in particular: what comes of it is told to all, also what is refused."""
        try:
            for message in await self._run(work):
                self._tell(message)
        except Exception as error:
            self._tell(text_message("refused", id=None, problems=problems_of(told(error))))

    async def _copied(self) -> StillSegmentation | None:
        async with self._turn:
            painting = self._painting
            if painting is not None and painting.is_dividing:
                # a copy would hold up the next stroke until all is divided
                self._states.later()
                return None
            return None if painting is None else await self._run(painting.still)

    async def _run(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def _tell(self, message: str) -> None:
        for page in self._pages:
            page.send(message)


def _changed(*, is_lost: bool) -> RecipeError:
    return RecipeError(_CHANGED_AND_LOST if is_lost else _CHANGED, place="recipe")


class _Progress:
    """Tells the pages how opening a recipe goes on."""

    def __init__(self, tell: Callable[[str], object]) -> None:
        self._tell = tell

    def stage_started(self, stage: str, *, seconds_expected: float, seconds_after: float) -> None:
        """Name the stage that begins."""
        self._tell(text_message("progress", text=stage, fraction=None))

    def stage_finished(self, stage: str, *, seconds: float, reused: bool) -> None:
        """Say nothing: the next one, or the recipe itself, follows at once."""
