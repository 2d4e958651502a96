"""Slices of the scan for pages: the scan is read when the first one is asked for, beside all else."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from heartcase.studio.messages import text_message
from heartcase.studio.operating.requests import Slice
from heartcase.studio.operating.scene.packing import packed
from heartcase.studio.operating.scene.scan_slices import ScanSlices, open_scan
from heartcase.studio.operating.stage import Stage
from heartcase.studio.pages import Page

__all__ = ["SliceServing"]


class SliceServing:
    """Sends pages the slices that they ask for.

    Parameters
    ----------
    case
        The case's folder.
    problems_of
        What a page is told of an error.
    """

    def __init__(self, case: Path, problems_of: Callable[[BaseException], list[dict[str, Any]]]) -> None:
        self._case = case
        self._problems_of = problems_of
        self._scan: tuple[Stage, Path | None, ScanSlices] | None = None
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="theatre-slices")
        self._tasks: set[asyncio.Task[None]] = set()

    def ask(self, page: Page, request: Slice, stage: Stage, recipe: Path | None) -> None:
        """Send a slice when it is there; what is done meanwhile does not wait for it.

        Parameters
        ----------
        page
            Who asks.
        request
            Which slice.
        stage
            The case that the page looks at.
        recipe
            The recipe that it was opened from, whose scan is shown.
        """
        task = asyncio.create_task(self._send(page, request, stage, recipe))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def forget_stage(self) -> None:
        """The stage is left: neither it nor its scan stays in memory, once what was asked for before is sent."""
        self._thread.submit(self._forget)

    def close(self) -> None:
        """Read no more."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _forget(self) -> None:
        self._scan = None

    async def _send(self, page: Page, request: Slice, stage: Stage, recipe: Path | None) -> None:
        try:
            found = await asyncio.get_running_loop().run_in_executor(
                self._thread, lambda: self._slice(request, stage, recipe)
            )
        except Exception as error:
            page.send(text_message("refused", id=request.id, problems=self._problems_of(error)))
            return
        page.send(found)
        page.send(text_message("done", id=request.id, tool="", size=None, line_mm=[]))

    def _slice(self, request: Slice, stage: Stage, recipe: Path | None) -> bytes:
        if self._scan is None or self._scan[:2] != (stage, recipe):
            self._scan = None
            self._scan = stage, recipe, open_scan(self._case, recipe)
        scan = self._scan[2]
        shown = scan.through(request.point_mm, request.right, request.down, request.window)
        header = {
            "kind": "slice",
            "name": request.name,
            "origin_mm": shown.origin_mm.tolist(),
            "right": request.right,
            "down": request.down,
            "width_mm": shown.width_mm,
            "height_mm": shown.height_mm,
            "window": request.window or scan.window,
            "range": scan.range,
        }
        return packed(header, {"greys": shown.greys})
