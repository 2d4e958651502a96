"""The stages of a build, in their order. A new stage is one module here, and one entry."""

from __future__ import annotations

from typing import Any

from heartcase.pipeline.stages import bundle, edit, filter, grid, map, markers, read, segment, surface, walls
from heartcase.pipeline.stages.stage import Stage, Step

__all__ = ["REPORT", "STAGES", "stage_named", "stage_names", "stage_versions", "step_named", "steps"]

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

REPORT = Step("report", "drawing the report", expected_seconds=4.0)
"""After the case is written."""


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


def steps() -> tuple[Stage[Any] | Step, ...]:
    """The stages and what follows them, in the order in which a build tells of them."""
    return (*STAGES, REPORT)


def step_named(name: str) -> Stage[Any] | Step:
    """The stage or step of a name.

    Raises
    ------
    KeyError
        There is none.
    """
    return REPORT if name == REPORT.name else stage_named(name)
