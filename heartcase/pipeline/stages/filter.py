"""The filter stage: edge-preserving smoothing of the scan (thesis 11.1.2)."""

from __future__ import annotations

from heartcase.pipeline.data import Scan
from heartcase.pipeline.stages.stage import Stage, Work, have
from heartcase.schemas.recipe.settings import resolved

__all__ = ["STAGE"]


def _compute(work: Work) -> Scan:
    from heartcase.pipeline.image.filter_scan import filter_scan

    return filter_scan(have(work.outputs.scan).get(), work.recipe.filter)


STAGE = Stage(
    name="filter",
    version=4,
    title="smoothing the scan",
    deed="smooth it, keeping edges",
    subject="smoothing the scan",
    output="filtered",
    kind=Scan,
    settings=lambda work: resolved(work.recipe.filter),
    compute=_compute,
    inputs={"scan": "scan"},
    expected_seconds=2.0,
)
