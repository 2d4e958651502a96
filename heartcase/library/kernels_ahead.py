"""The kernels that a library's build will call, compiled ahead once for all of its workers on this machine."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager

from heartcase.compiling.compile_ahead import Progress, compiled_ahead
from heartcase.library.plan import LibraryCase
from heartcase.library.scans import scan_is_made
from heartcase.pipeline.building.kernels_ahead import PROCESSES_MOST, SCAN, kernels_of, stages_taken
from heartcase.pipeline.stages.table import steps
from heartcase.schemas.errors import HeartcaseError
from heartcase.schemas.recipe.recipe import load_recipe

__all__ = ["library_kernels_ahead"]


def library_kernels_ahead(
    cases: Iterable[LibraryCase], *, processes: int, told: Callable[[Progress], None] = lambda _: None
) -> AbstractContextManager[None]:
    """Compile what building these cases calls while the body builds them.

    Workers wait for a kernel that is being compiled, and take it from numba's cache: see
    :func:`heartcase.compiling.compile_ahead.compiled_ahead`.

    Parameters
    ----------
    cases
        What is to be built.
    processes
        How many processes, at most PROCESSES_MOST of them are started; 0 for none.
    told
        Called as kernels are done, from other threads.
    """
    all_stages = {SCAN, *(step.name for step in steps())}
    taken: set[str] = set()
    for case in cases:
        # A recipe that cannot be read any more is its worker's to report.
        with contextlib.suppress(HeartcaseError, OSError):
            recipe = load_recipe(case.recipe)
            taken |= stages_taken(recipe, makes_scan=not scan_is_made(recipe.scan, case.recipe.parent))
        if taken == all_stages:
            break
    return compiled_ahead(kernels_of(taken), processes=min(processes, PROCESSES_MOST), told=told)
