"""One case of a library, built in a worker process: whatever goes wrong ends in its record."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import time
import traceback
from pathlib import Path

from heartcase.library.plan import CaseRecord, LibraryCase, files_written, write_record
from heartcase.library.progress import MAKING_THE_SCAN
from heartcase.library.scans import ensure_scan
from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.building.runner import BuildListener, SilentListener
from heartcase.pipeline.stages.table import steps
from heartcase.schemas.errors import HeartcaseError
from heartcase.schemas.recipe.recipe import load_recipe

__all__ = ["build_one"]

_SCAN_S = 15.0
"""How long making a scan may take, s: only a guess for the progress."""


def build_one(case: LibraryCase, out: str, cache: str | None, listener: BuildListener | None = None) -> CaseRecord:
    """Build a case and write its record.

    Parameters
    ----------
    case
        What to build.
    out, cache
        Folders of the cases and of the cache, as the worker reaches them.
    listener
        Told of progress.
    """
    start = time.perf_counter()
    _give_memory_back()
    _forget_memory_peak()
    folder = Path(out)
    try:
        record = _built(case, folder, Path(cache) if cache else None, listener or SilentListener())
    except HeartcaseError as error:
        record = CaseRecord(case.name, case.stamp, tuple((one.place, one.message) for one in error.problems))
    except Exception as error:  # one case must not stop the others, whatever it is
        last = traceback.extract_tb(error.__traceback__)[-1]
        message = f"something unforeseen happened ({type(error).__name__} in {Path(last.filename).stem}:{last.lineno})"
        record = CaseRecord(
            case.name, case.stamp, (("", f"{message}: build it alone with HEARTCASE_DEBUG=1 and report it"),)
        )
    record = record.timed(time.perf_counter() - start, _memory_peak_mb())
    write_record(record, folder)
    return record


def _built(case: LibraryCase, out: Path, cache: Path | None, listener: BuildListener) -> CaseRecord:
    recipe = load_recipe(case.recipe)
    made_s: dict[str, float] = {}
    if recipe.scan.phantom is not None:
        start = time.perf_counter()
        after = sum(step.expected_seconds for step in steps())
        listener.stage_started(MAKING_THE_SCAN, seconds_expected=_SCAN_S, seconds_after=after)
        is_new = ensure_scan(recipe.scan, case.recipe.parent)
        seconds = time.perf_counter() - start
        listener.stage_finished(MAKING_THE_SCAN, seconds=seconds, reused=not is_new)
        if is_new:
            made_s[MAKING_THE_SCAN] = round(seconds, 3)
    # A scan that is made follows its recipe: a case from the scan before is an older one of the same heart.
    replace = recipe.scan.phantom is not None
    result = build_case(recipe, directory=case.recipe.parent, out=out, cache=cache, replace=replace, listener=listener)
    assert result.case is not None
    assert result.report is not None
    written = [*(path for path in sorted(result.case.rglob("*")) if path.is_file()), result.report]
    return CaseRecord(
        name=case.name,
        stamp=case.stamp,
        stage_seconds=made_s | {stage: round(seconds, 3) for stage, seconds in result.seconds.items()},
        reused=result.reused,
        warnings=tuple(warning.text for warning in result.warnings),
        warning_grades=tuple(warning.grade for warning in result.warnings),
        files=files_written(out, [path.relative_to(out).as_posix() for path in written]),
    )


def _give_memory_back() -> None:
    """Let go of what the case before left: cycles that nobody has collected, and pages that the C library keeps."""
    gc.collect()
    # Only glibc has it, and only there is it needed: a worker's trim threshold is high, which is faster within a case.
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def _forget_memory_peak() -> None:
    # Linux: 5 sets the peak of this process to what it holds now.
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _memory_peak_mb() -> float | None:
    """Most memory that this process held since then, 10^6 bytes; None where the system does not say."""
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return round(int(line.split()[1]) * 1024 / 1e6, 1)
    return None
