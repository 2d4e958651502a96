"""The place of the build tab: one build at a time of a recipe, what it tells, and what came of it."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter

from heartcase.library.progress import MAKING_THE_SCAN
from heartcase.pipeline.stages.table import steps
from heartcase.schemas.base import Model, PointMm
from heartcase.schemas.bundle.approval import approve_case, bundle_sha256, report_beside
from heartcase.schemas.bundle.format import MANIFEST_NAME
from heartcase.schemas.errors import BundleError, HeartcaseError, UsageError
from heartcase.schemas.files import atomic_write, remove_leftovers
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text
from heartcase.studio.asking import parsed, request_id
from heartcase.studio.building.outcome import Outcome, outcome_of
from heartcase.studio.building.process import BuildProcess
from heartcase.studio.building.requests import Approve, BuildRequest, Order
from heartcase.studio.building.times import StageTimes
from heartcase.studio.messages import problems_of, text_message, told
from heartcase.studio.pages import Page

__all__ = ["Building"]

T = TypeVar("T")
_REQUEST: TypeAdapter[Order | Approve] = TypeAdapter(BuildRequest)
_LOOK_EVERY_S = 1.0
"""How often it is looked whether the recipe changed."""
_NOTE_ENDING = ".built.json"


class _Note(Model):
    """What is remembered of a build beside the cache."""

    bundle_sha256: str
    recipe_sha256: str | None
    places_mm: dict[str, tuple[PointMm, ...]]
    """Places that warnings are about, by their text."""
    recipe: str | None = None
    """Hash of where the recipe lies, seen from the folder of its case; None in notes of earlier versions."""


class Building:
    """What is built of a recipe. All methods belong to one event loop.

    Parameters
    ----------
    recipe
        The recipe's file.
    out
        Directory that the case is built in, with the build's cache.
    operate
        Opens a case; gives the address of its page.
    """

    def __init__(self, recipe: Path, *, out: Path, operate: Callable[[Path], str]) -> None:
        self._recipe = recipe
        self._out = out
        self._operate = operate
        self._pages: set[Page] = set()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="studio-build")
        self._process: BuildProcess | None = None
        self._running: asyncio.Task[None] | None = None
        self._watching: asyncio.Task[None] | None = None
        self._steps: list[dict[str, Any]] = []
        self._expected: tuple[float, float | None, float | None] | None = None
        self._voxel_count: int | None = None
        self._took_s: dict[str, float] = {}
        self._times = StageTimes(out / ".heartcase-cache" / "studio" / "times.json")
        self._compiling: tuple[int, int] | None = None
        self._problems: list[dict[str, Any]] = []
        self._is_cancelled = False
        self._changed: bool | None = None
        self._outcome: Outcome | None = None
        self._last_case: Path | None = None
        self._before_ml: dict[str, float] = {}
        self._built_from: str | None = None
        self._recipe_sha256: str | None = None
        self._is_known = False

    @property
    def report(self) -> Path | None:
        """The report about the case that is shown; None where there is none."""
        if self._outcome is None:
            return None
        try:
            return report_beside(self._outcome.case, self._outcome.sha256)
        except BundleError:
            return None

    async def join(self, page: Page) -> None:
        """Show a page how the case stands, and then all that changes."""
        if not self._is_known:
            self._is_known = True
            await self._run(self._look_at_case)
        self._pages.add(page)
        if self._watching is None:
            self._watching = asyncio.create_task(self._watch())
        page.send(self._state())

    async def leave(self, page: Page) -> None:
        """Forget a page; a build goes on without it."""
        self._pages.discard(page)
        if not self._pages and self._watching is not None:
            self._watching.cancel()
            self._watching = None

    async def ask(self, page: Page, text: str) -> None:
        """Do what a page asks for, and tell it and the others."""
        try:
            request = parsed(text, _REQUEST)
            more: dict[str, Any] = {}
            if isinstance(request, Approve):
                await self._run(lambda: self._approve(request))
            elif request.do == "build":
                self._begin()
            elif request.do == "cancel":
                self._cancel()
            else:
                more["address"] = self._operate(self._whole_case())
            page.send(text_message("done", id=request.id, **more))
            self._tell()
        except Exception as error:
            page.send(text_message("refused", id=request_id(text), problems=problems_of(told(error))))

    async def close(self) -> None:
        """End a build that runs; the case that was there stays whole."""
        if self._process is not None:
            self._process.end()
        if self._watching is not None:
            self._watching.cancel()
        if self._running is not None:
            await self._running
        for page in self._pages:
            page.close()
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _begin(self) -> None:
        if self._process is not None:
            raise UsageError("a build runs already: wait for it, or cancel it", place="build")
        names = [MAKING_THE_SCAN, *(step.name for step in steps())]
        self._steps = [{"stage": name, "state": "waiting", "seconds": 0.0} for name in names]
        self._expected = self._compiling = self._changed = self._voxel_count = None
        self._took_s = {}
        self._problems, self._is_cancelled = [], False
        self._before_ml = dict(self._outcome.figures["volumes_ml"]) if self._outcome is not None else {}
        self._process = BuildProcess(self._recipe, self._out)
        self._running = asyncio.create_task(self._follow(self._process))

    def _cancel(self) -> None:
        if self._process is None:
            raise UsageError("no build runs", place="build")
        self._is_cancelled = True
        self._process.end()

    async def _follow(self, process: BuildProcess) -> None:
        """Hear a build to its end."""
        sha256, built = None, None
        try:
            async for news in process.news():
                match news.pop("news"):
                    case "recipe":
                        sha256 = news["sha256"]
                    case "built":
                        built = news
                    case "failed":
                        self._problems = news["problems"]
                    case "size":
                        self._voxel_count = news["voxel_count"]
                    case "compiling":
                        self._compiling = news["done"], news["total"]
                    case kind:
                        self._note_stage(kind, news)
                self._tell()
            if built is not None:
                self._changed = built["changed"]
                self._learn()
                places = {one["text"]: tuple(map(tuple, one["places_mm"])) for one in built["warnings"]}
                await self._run(lambda: self._remember(Path(built["case"]), sha256, places))
            else:
                await self._run(lambda: remove_leftovers(self._out))
                if not self._problems and not self._is_cancelled:
                    raise HeartcaseError(
                        "the build ended without a word: the machine may have too little memory; the case that was "
                        "there before is whole",
                        place="build",
                    )
        except Exception as error:
            self._problems = problems_of(told(error))
        for step in self._steps:
            if step["state"] == "running":
                step["state"] = "waiting"
        self._expected = self._compiling = self._process = None
        self._tell()

    def _note_stage(self, kind: str, news: dict[str, Any]) -> None:
        step = next((one for one in self._steps if one["stage"] == news["stage"]), None)
        if step is None:
            return
        if kind == "started":
            step["state"] = "running"
            names = [one["stage"] for one in self._steps]
            later = names[names.index(news["stage"]) + 1 :]
            own, after = (self._times.expected(self._voxel_count, one) for one in ([news["stage"]], later))
            self._expected = time.monotonic(), own, after
        else:
            step["state"] = "reused" if news["reused"] else "computed"
            step["seconds"] = round(news["seconds"], 2)
            if not news["reused"] and self._expected is not None:
                # by the clock, with all that belongs to it
                self._took_s[news["stage"]] = time.monotonic() - self._expected[0]
            self._expected = None

    def _learn(self) -> None:
        """Remember how long the stages took, unless kernels were compiled beside them."""
        if self._voxel_count is not None and not (self._compiling and self._compiling[1]):
            idle = {one["stage"]: 0.0 for one in self._steps if one["state"] == "waiting"}
            self._times.learn(self._voxel_count, idle | self._took_s)

    def _approve(self, request: Approve) -> None:
        case = self._whole_case()
        is_withdrawal = request.do == "withdraw"
        if not is_withdrawal:
            if not request.has_looked:
                raise UsageError("read the report and look at every warning first", place="approve")
            # what was looked at must be about these bytes
            report_beside(case, request.sha256)
        approve_case(case, role=request.role, note=request.note, withdraw=is_withdrawal, expected_sha256=request.sha256)
        self._outcome = outcome_of(case, self._outcome.places_mm if self._outcome else None)

    def _whole_case(self) -> Path:
        """The case that is shown: also after the recipe was given another name."""
        if self._outcome is None or not self._outcome.case.is_dir():
            raise UsageError("there is no case yet: build it", place="case")
        return self._outcome.case

    def _case(self) -> Path | None:
        """Where the recipe's case goes, or where it went when it could last be read; None where it never could."""
        with contextlib.suppress(HeartcaseError):
            name = parse_recipe(read_recipe_text(self._recipe), needs_markers=False).name
            self._last_case = self._out / f"{name}.case"
        return self._last_case

    def _look_at_case(self, case: Path | None = None) -> None:
        """What was built before, by whom ever; of the recipe's own case unless another is named."""
        self._recipe_sha256 = self._recipe_hash()
        own = self._case()
        case = self._built_before(own) if case is None else case
        if case is None:
            return
        noted = self._noted(case)
        self._outcome = outcome_of(case, noted.places_mm if noted else None)
        if self._outcome is not None and noted is not None and noted.bundle_sha256 == self._outcome.sha256:
            self._built_from = noted.recipe_sha256

    def _built_before(self, own: Path | None) -> Path | None:
        """The case to begin with: under its earlier name where the recipe was given another one since it was built."""
        mine = [case for case, note in self._notes() if note.recipe == self._recipe_key()]
        stamps = {case: stamp[0] for case in {own, *mine} if case is not None and (stamp := _stamp(case)) is not None}
        built = [case for case in mine if case in stamps]
        if not built or own in built:
            return own
        newest = max(built, key=lambda case: (stamps[case], case.name))
        # what was built at the new name since then, by whom ever, is what the recipe says now
        return own if own is not None and stamps.get(own, 0) > stamps[newest] else newest

    def _remember(self, case: Path, sha256: str | None, places: dict[str, tuple[PointMm, ...]]) -> None:
        """Which recipe a case was built from, and the places of its warnings: for the next start too."""
        noted = self._noted(case)
        if noted is not None and not any(places.values()):
            # of a case that was there already, the build knows no places
            places = noted.places_mm
        self._outcome, self._built_from = outcome_of(case, places), sha256
        if self._outcome is None:
            return
        built, recipe = self._outcome.sha256, self._recipe_key()
        note = _Note(bundle_sha256=built, recipe_sha256=sha256, places_mm=places, recipe=recipe)
        with contextlib.suppress(OSError):
            file = self._note_file(case)
            file.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(file, note.model_dump_json().encode())

    def _recipe_key(self) -> str:
        """What tells recipes apart whose cases are built in one folder, also after all of it was moved."""
        try:
            place = os.path.relpath(self._recipe.resolve(), self._out.resolve())
        except ValueError:
            # on another drive
            place = str(self._recipe.resolve())
        return hashlib.sha256(place.encode("utf-8", "surrogateescape")).hexdigest()

    def _notes(self) -> Iterator[tuple[Path, _Note]]:
        """All cases of which something is remembered."""
        for file in sorted(self._note_file(self._out / "any.case").parent.glob(f"*{_NOTE_ENDING}")):
            case = self._out / f"{file.name.removesuffix(_NOTE_ENDING)}.case"
            if (note := self._noted(case)) is not None:
                yield case, note

    def _noted(self, case: Path) -> _Note | None:
        try:
            return _Note.model_validate_json(self._note_file(case).read_bytes())
        except (OSError, ValueError):
            return None

    def _note_file(self, case: Path) -> Path:
        return self._out / ".heartcase-cache" / "studio" / f"{case.stem}{_NOTE_ENDING}"

    def _recipe_hash(self) -> str | None:
        try:
            return hashlib.sha256(read_recipe_text(self._recipe).encode()).hexdigest()
        except HeartcaseError:
            return None

    def _case_stamps(self) -> dict[Path, tuple[int, int] | None]:
        """Where the recipe's case goes, and the case that is shown -> when it was replaced last, and its size there."""
        cases = (self._last_case, None if self._outcome is None else self._outcome.case)
        stamps: dict[Path, tuple[int, int] | None] = {}
        for case in cases:
            if case is not None:
                stamps[case] = _stamp(case)
        return stamps

    def _is_case_new(self, case: Path) -> bool:
        """Whether a case is another one than that whose figures are shown."""
        try:
            return self._outcome is None or bundle_sha256(case) != self._outcome.sha256
        except HeartcaseError:
            return False

    async def _watch(self) -> None:
        """Tell when the case is older than the recipe, or no longer so, and of a case that was built elsewhere."""
        seen, seen_cases = None, self._case_stamps()
        while True:
            with contextlib.suppress(OSError):
                found = self._recipe.stat()
                stamp = found.st_mtime_ns, found.st_size
                if stamp != seen:
                    seen = stamp
                    sha256 = await self._run(self._recipe_hash)
                    if sha256 != self._recipe_sha256:
                        self._recipe_sha256 = sha256
                        await self._run(self._case)
                        self._tell()
            stamps = self._case_stamps()
            if stamps != seen_cases and self._process is None:
                # what lay at the place of a new name before is another heart's, or nothing is shown yet
                is_shown = self._outcome is not None
                changed = [
                    case for case, one in stamps.items() if seen_cases.get(case, one if is_shown else None) != one
                ]
                seen_cases = stamps
                is_new = bool(changed) and await self._run(partial(self._is_case_new, changed[0]))
                if is_new:
                    self._built_from = None
                    await self._run(partial(self._look_at_case, changed[0]))
                    self._tell()
            await asyncio.sleep(_LOOK_EVERY_S)

    def _state(self) -> str:
        expected = None
        if self._expected is not None:
            start, seconds, after = self._expected
            left = None if seconds is None or after is None else {"seconds": seconds, "after": after}
            expected = {"elapsed": time.monotonic() - start, "left": left}
        age = "unknown"
        is_renamed = self._outcome is not None and self._last_case not in (None, self._outcome.case)
        if is_renamed or self._built_from is not None:
            age = "current" if self._built_from == self._recipe_sha256 and not is_renamed else "older"
        return text_message(
            "build",
            is_running=self._process is not None,
            is_cancelled=self._is_cancelled,
            steps=self._steps,
            expected=expected,
            compiling=self._compiling,
            problems=self._problems,
            changed=self._changed,
            age=age,
            case=None if self._outcome is None else self._outcome.figures,
            before_ml=self._before_ml,
        )

    def _tell(self) -> None:
        message = self._state()
        for page in self._pages:
            page.send(message)

    async def _run(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)


def _stamp(case: Path) -> tuple[int, int] | None:
    """When a case was replaced last, and its size; None where there is none."""
    try:
        found = (case / MANIFEST_NAME).stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
