"""The kernels that a build will call, compiled ahead in several processes.

``kernels.json`` lists them with the types that they are called with, by the stage that calls them first. A test builds
the sample case and fails where the list and what was called differ;
``python -m tests.pipeline.building.test_kernels_ahead --write`` writes it anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path

from heartcase.compiling.compile_ahead import Called, Progress, compiled_ahead, core_count
from heartcase.pipeline.stages import table
from heartcase.schemas.recipe.recipe import Recipe

__all__ = [
    "LIST",
    "PROCESSES_MOST",
    "SCAN",
    "kernels_ahead",
    "kernels_in",
    "kernels_needed",
    "kernels_of",
    "stages_taken",
]

LIST = Path(__file__).with_name("kernels.json")
PROCESSES_MOST = 8
"""Each holds numba and the pipeline's libraries; the longest kernels take as long as all others then."""
SCAN = "scan"
"""Stands for making the scan of a phantom, which comes before the stages."""


def kernels_ahead(
    recipe: Recipe,
    *,
    makes_scan: bool = False,
    until: str | None = None,
    processes: int | None = None,
    told: Callable[[Progress], None] = lambda _: None,
) -> AbstractContextManager[None]:
    """Compile what a build calls while the body runs it: see :func:`heartcase.compiling.compile_ahead.compiled_ahead`.

    Parameters
    ----------
    recipe
        What is built.
    makes_scan
        Whether the scan of a phantom is made before.
    until
        Name of the last stage; all when left out.
    processes
        How many processes; one for each core, at most PROCESSES_MOST, when left out; 0 for none.
    told
        Called as kernels are done, from other threads.
    """
    wanted = kernels_needed(recipe, makes_scan=makes_scan, until=until)
    return compiled_ahead(
        wanted, processes=min(core_count(), PROCESSES_MOST) if processes is None else processes, told=told
    )


def kernels_needed(recipe: Recipe, *, makes_scan: bool = False, until: str | None = None) -> tuple[Called, ...]:
    """Kernels of the stages that a build takes, in the order in which they are called first."""
    return kernels_of(stages_taken(recipe, makes_scan=makes_scan, until=until))


def stages_taken(recipe: Recipe, *, makes_scan: bool = False, until: str | None = None) -> frozenset[str]:
    """Stages whose listed kernels a build calls, SCAN among them where the scan is made."""
    stages = [SCAN] if makes_scan else []
    for step in table.steps():
        is_taken = step is table.REPORT or (step.is_part(recipe) and step.has_work(recipe))  # type: ignore[union-attr]
        stages += [step.name] if is_taken else []
        if step.name == until:
            break
    if recipe.segment.method != "watershed":
        stages = [name for name in stages if name != "segment"]  # its kernels are the watershed's
    return frozenset(stages)


def kernels_of(stages: Collection[str]) -> tuple[Called, ...]:
    """Listed kernels of these stages, in the order in which they are called first."""
    return tuple(one for stage, kernels in _listed().items() if stage in stages for one in kernels)


def _listed() -> dict[str, tuple[Called, ...]]:
    """Stage -> its kernels."""
    return kernels_in(LIST)


@cache
def kernels_in(path: Path) -> dict[str, tuple[Called, ...]]:
    """Kernels of a list, by who calls them first."""
    data = json.loads(path.read_text(encoding="utf-8"))
    return {
        stage: tuple(Called(one["module"], one["name"], tuple(one["types"]), one["seconds"]) for one in kernels)
        for stage, kernels in data.items()
    }
