"""The start page's place: what it asks for, one thing after the other, in a thread of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import TypeAdapter

from heartcase.pipeline.building.starter_recipe import write_recipe
from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text
from heartcase.studio.asking import parsed, request_id
from heartcase.studio.messages import problems_of, text_message, told
from heartcase.studio.pages import Page
from heartcase.studio.starting.compiling import Compiling
from heartcase.studio.starting.recent import Recent, state_folder
from heartcase.studio.starting.registry import Registry
from heartcase.studio.starting.requests import Begin, List, Look, Open, Reopen, Sample, StartRequest
from heartcase.studio.starting.roots import Roots
from heartcase.studio.starting.samples import copy_sample, shown_samples
from heartcase.studio.starting.shown_series import shown_series
from heartcase.studio.starting.whereabouts import building_folder, left_elsewhere

__all__ = ["Start"]

T = TypeVar("T")
_REQUEST: TypeAdapter[List | Look | Begin | Open | Reopen | Sample] = TypeAdapter(StartRequest)


class _ToOpen(NamedTuple):
    """A recipe or a case that can be read."""

    path: Path
    name: str
    out: Path | None
    """Where the recipe's case is built; None for a case."""


class Start:
    """What the start page is connected to.

    Parameters
    ----------
    registry
        Where recipes and cases are opened.
    roots
        Folders that may be looked into; the user's own and the present one when left out.
    begin
        Where the page begins, unless nothing in it can be opened: then, and when left out, in the first of ``roots``,
        or the present folder where these are left out.
    state
        Folder of the list of recent work; the user's when left out.
    looks
        Whether the page lists the series of the first folder at once.
    """

    def __init__(
        self,
        registry: Registry,
        *,
        roots: Sequence[Path] = (),
        begin: Path | None = None,
        state: Path | None = None,
        looks: bool = False,
    ) -> None:
        self._registry = registry
        begin = begin or (roots[0] if roots else Path.cwd())
        self._roots = Roots.of(roots or (Path.home(), Path.cwd())).beginning_in(begin)
        self._looks = looks
        self._recent = Recent(state or state_folder())
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="studio-start")
        self._pages: set[Page] = set()
        self._compiling: Compiling | None = None
        self._following: set[Page] = set()
        self._loop: asyncio.AbstractEventLoop | None = None

    def open_recipe(self, path: Path, *, out: Path | None = None) -> str:
        """Open a recipe and remember it; the address of its page.

        Parameters
        ----------
        path
            The recipe's file.
        out
            Directory that its case is built in; when left out, as
            :func:`heartcase.studio.starting.whereabouts.building_folder` says.

        Raises
        ------
        HeartcaseError
            It cannot be read.
        """
        return self._open(self._recipe_to_open(path, out))

    def left_elsewhere(self, path: Path, *, out: Path | None = None) -> str | None:
        """What is to be said of a recipe's work in another folder than it would be opened in; None for nothing.

        Arguments and errors are those of :meth:`open_recipe`, before which it is asked.
        """
        found = self._recipe_to_open(path, out)
        others = [self._recent.out_of(path), path.parent, Path.cwd()]
        return left_elsewhere(path, found.name, found.out or path.parent, [one for one in others if one is not None])

    def open_case(self, path: Path) -> str:
        """Open a case and remember it; the address of its page.

        Raises
        ------
        HeartcaseError
            It cannot be read.
        """
        return self._open(_case_to_open(path))

    def begin_to_compile(self) -> None:
        """Compile, behind the pages, what the studio will call and is not compiled yet on this machine."""
        self._compiling = Compiling(self._tell_of_compiling)
        self._compiling.begin()

    async def join(self, page: Page) -> None:
        """Show a page what can be opened."""
        self._loop = asyncio.get_running_loop()
        self._pages.add(page)
        page.send(await self._run(self._greeting))
        page.send(self._compiling_message())
        # reading them takes a second, once
        page.send(await self._run(lambda: text_message("samples", samples=list(shown_samples()))))

    def follow(self, page: Page) -> None:
        """Tell a page of a recipe or case how far compiling is, until :meth:`unfollow`: it waits for that too."""
        self._loop = asyncio.get_running_loop()
        self._following.add(page)
        if self._compiling is not None and self._compiling.progress is not None:
            page.send(self._compiling_message())

    def unfollow(self, page: Page) -> None:
        """Tell a page no more of it."""
        self._following.discard(page)

    async def leave(self, page: Page) -> None:
        """Forget a page."""
        self._pages.discard(page)

    async def ask(self, page: Page, text: str) -> None:
        """Do what a page asks for, and tell it."""
        try:
            request = parsed(text, _REQUEST)
            found = await self._run(lambda: self._prepared(request))
            if isinstance(found, _ToOpen):
                found = {"kind": "go", "address": self._open(found)}
            page.send(text_message(found.pop("kind"), id=request.id, **found))
            if isinstance(request, Reopen) and request.do == "forget":
                greeting = await self._run(self._greeting)
                for one in self._pages:
                    one.send(greeting)
        except Exception as error:
            page.send(text_message("refused", id=request_id(text), problems=problems_of(told(error))))

    async def close(self) -> None:
        """End."""
        for page in self._pages:
            page.close()
        if self._compiling is not None:
            await asyncio.get_running_loop().run_in_executor(None, self._compiling.close)
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _compiling_message(self) -> str:
        progress = None if self._compiling is None else self._compiling.progress
        if progress is None:
            return text_message("compiling", fraction=None, seconds_left=None)
        fraction = (progress.done + progress.failed) / progress.total
        # what this machine has not shown yet would grow from one look to the next
        seconds_left = progress.seconds_left if progress.is_measured else None
        return text_message("compiling", fraction=fraction, seconds_left=seconds_left)

    def _tell_of_compiling(self) -> None:
        loop = self._loop
        if loop is None or loop.is_closed():
            return

        def tell() -> None:
            message = self._compiling_message()
            for page in self._pages | self._following:
                page.send(message)

        loop.call_soon_threadsafe(tell)

    def _prepared(self, request: List | Look | Begin | Open | Reopen | Sample) -> dict[str, Any] | _ToOpen:
        """The answer, or what is to be opened in the server's loop."""
        match request:
            case List():
                return {"kind": "folder"} | self._roots.listing(request.path)
            case Look():
                return {"kind": "series", "series": shown_series(self._roots.inside(request.path))}
            case Begin():
                return self._new_recipe(self._begun(request))
            case Open():
                path = self._roots.inside(request.path)
                return _case_to_open(path) if path.is_dir() else self._recipe_to_open(path)
            case Sample():
                return self._new_recipe(copy_sample(request.name, self._folder(request.folder)))
            case Reopen(do="forget"):
                self._recent.forget(request.key)
                return {"kind": "done"}
            case Reopen():
                work = self._recent.entry(request.key)
                path = Path(work.path)
                if not path.exists():
                    raise UsageError(
                        "it is no longer where it was: look for it, or take it off the list", place="recent"
                    )
                return _case_to_open(path) if work.kind == "case" else self._recipe_to_open(path)

    def _open(self, found: _ToOpen) -> str:
        if found.out is None:
            address = self._registry.open_case(found.path).address
            self._recent.note("case", found.path, name=found.name)
        else:
            address = self._registry.open_recipe(found.path, out=found.out).address
            self._recent.note("recipe", found.path, name=found.name, out=found.out)
        return address

    def _recipe_to_open(self, path: Path, out: Path | None = None) -> _ToOpen:
        # What is done to it is saved in it, and its case is built there.
        refuse_inside_case(path, place="recipe")
        out = building_folder(path, self._recent) if out is None else out
        refuse_inside_case(out, place="folder")
        return _ToOpen(path, parse_recipe(read_recipe_text(path), needs_markers=False).name, out)

    def _new_recipe(self, path: Path) -> _ToOpen:
        # another one may have had its name
        return self._recipe_to_open(path, path.parent)

    def _begun(self, request: Begin) -> Path:
        """A recipe for a scan, written where it is asked for."""
        scan, folder = self._roots.inside(request.path), self._folder(request.folder)
        file = request.file if request.file.lower().endswith(".toml") else f"{request.file}.toml"
        recipe = folder / file
        if recipe.exists():
            raise UsageError("there is already a recipe of this name: open it, or choose another name", place="file")
        choice = request.model_dump(include={"series", "trigger_time_ms", "echo_time_ms", "frame"}, exclude_none=True)
        try:
            write_recipe(scan, recipe, name=request.name, choice=choice, with_examples=False)
        except OSError as error:
            reason = (error.strerror or "the system gives no reason").lower()
            raise UsageError(f"the recipe cannot be written there: {reason}", place="folder") from None
        return recipe

    def _folder(self, path: str) -> Path:
        folder = self._roots.inside(path)
        if not folder.is_dir():
            raise UsageError("this is a file: choose a folder", place="folder")
        refuse_inside_case(folder, place="folder")
        return folder

    def _greeting(self) -> str:
        return text_message("start", recent=self._recent.shown(self._roots.named), looks=self._looks)

    async def _run(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)


def _case_to_open(path: Path) -> _ToOpen:
    return _ToOpen(path, open_bundle(path).manifest.name, None)
