"""A build in a process of its own: the recipe's path comes on standard input, news go out as JSON, one object a line.

    python -m heartcase.studio.building.work

The process ends when its standard input ends, so that a server that is killed leaves none behind. A build that is
killed leaves the case that was there whole: see :func:`heartcase.pipeline.building.run.build_case`.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
import sys
import threading
import traceback
from pathlib import Path
from typing import Any, TextIO

from heartcase.compiling.compile_ahead import Progress
from heartcase.library.progress import MAKING_THE_SCAN
from heartcase.library.scans import ensure_scan, scan_is_made
from heartcase.pipeline.building.kernels_ahead import kernels_ahead
from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.stages.table import steps
from heartcase.schemas.errors import HeartcaseError
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text

__all__ = ["main"]

_SCAN_S = 15.0
"""How long making a scan may take, s: only a guess for the progress."""


class _Teller:
    """A listener of a build that writes what it hears."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._turn = threading.Lock()

    def tell(self, news: str, **more: Any) -> None:
        """Write a line; threads that compile tell as well."""
        with self._turn:
            self._stream.write(json.dumps({"news": news} | more) + "\n")
            self._stream.flush()

    def stage_started(self, stage: str, *, seconds_expected: float, seconds_after: float) -> None:
        """Tell that a stage begins to compute."""
        self.tell("started", stage=stage, seconds_expected=seconds_expected, seconds_after=seconds_after)

    def stage_finished(self, stage: str, *, seconds: float, reused: bool) -> None:
        """Tell that a stage has its output."""
        self.tell("finished", stage=stage, seconds=seconds, reused=reused)

    def scan_read(self, voxel_count: int) -> None:
        """Tell how large the scan is."""
        self.tell("size", voxel_count=voxel_count)

    def compiled(self, state: Progress) -> None:
        """Tell how many kernels are compiled."""
        self.tell("compiling", done=state.done + state.failed, total=state.total)


def main() -> None:
    """Build what standard input names."""
    order = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_input, daemon=True).start()
    stream, sys.stdout = sys.stdout, sys.stderr  # what a library prints is no news
    teller = _Teller(stream)
    try:
        _build(Path(order["recipe"]), Path(order["out"]), teller)
    except HeartcaseError as error:
        teller.tell("failed", problems=[{"place": one.place, "message": one.message} for one in error.problems])
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        message = (
            f"something unforeseen happened ({type(error).__name__} in {Path(last.filename).stem}:{last.lineno}): "
            "build it with heartcase build and HEARTCASE_DEBUG=1, and report it"
        )
        teller.tell("failed", problems=[{"place": "", "message": message}])


def _build(path: Path, out: Path, teller: _Teller) -> None:
    text = read_recipe_text(path)
    recipe = parse_recipe(text)
    teller.tell("recipe", sha256=hashlib.sha256(text.encode()).hexdigest())
    makes_scan = not scan_is_made(recipe.scan, path.parent)
    with kernels_ahead(recipe, makes_scan=makes_scan, told=teller.compiled):
        if makes_scan:
            after = sum(step.expected_seconds for step in steps())
            teller.stage_started(MAKING_THE_SCAN, seconds_expected=_SCAN_S, seconds_after=after)
            ensure_scan(recipe.scan, path.parent)
            teller.stage_finished(MAKING_THE_SCAN, seconds=0.0, reused=False)
        # A case from the scan that was made before is an older one of the same heart.
        replace = recipe.scan.phantom is not None
        result = build_case(recipe, directory=path.parent, out=out, listener=teller, replace=replace)
    assert result.case is not None
    # with the places that the case itself does not hold
    warnings = [{"text": one.text, "places_mm": one.places_mm} for one in result.warnings]
    teller.tell("built", case=str(result.case), changed=result.changed, warnings=warnings)


def _end_with_input() -> None:
    with contextlib.suppress(OSError):
        # not through sys.stdin: a thread that waits in it would stop Python from ending
        while os.read(0, 4096):
            pass
    if os.name == "posix":
        # those who compile ahead too
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(1)


if __name__ == "__main__":
    main()
