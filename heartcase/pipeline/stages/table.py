"""The stages of a build, in their order. A new stage is one module here, and one entry."""

from __future__ import annotations

from typing import Any

from heartcase.pipeline.stages import bundle, edit, filter, grid, map, markers, read, segment, surface, walls
from heartcase.pipeline.stages.stage import Stage

__all__ = ["STAGES", "stage_named", "stage_names", "stage_versions"]

STAGES: tuple[Stage[Any], ...] = (
    read.STAGE,
    markers.STAGE,
    filter.STAGE,
    segment.STAGE,
    walls.STAGE,
    edit.STAGE,
    grid.STAGE,
    surface.STAGE,
    map.STAGE,
    bundle.STAGE,
)
"""The last one writes the case, and takes all that the others made."""


def stage_names() -> tuple[str, ...]:
    """Names of the stages in their order."""
    return tuple(stage.name for stage in STAGES)


def stage_versions() -> dict[str, int]:
    """Version of each stage by its name, in their order."""
    return {stage.name: stage.version for stage in STAGES}


def stage_named(name: str) -> Stage[Any]:
    """The stage of a name.

    Raises
    ------
    KeyError
        There is none.
    """
    for stage in STAGES:
        if stage.name == name:
            return stage
    raise KeyError(name)
