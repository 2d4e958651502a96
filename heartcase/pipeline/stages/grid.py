"""The grid stage: the tissue down-sampled to simulation cells (thesis 11.2.1)."""

from __future__ import annotations

from heartcase.pipeline.data import SimulationGrid
from heartcase.pipeline.stages.stage import Stage, Work, have, resolved_all
from heartcase.schemas.recipe.settings import resolved

__all__ = ["STAGE"]


def _compute(work: Work) -> SimulationGrid:
    from heartcase.pipeline.cells.build_grid import build_grid

    return build_grid(have(work.outputs.structures).get(), work.recipe.grid, pins=work.recipe.pins)


STAGE = Stage(
    name="grid",
    version=10,
    title="simulation grid",
    deed="divide the tissue into cells",
    subject="dividing the tissue into cells",
    output="grid",
    kind=SimulationGrid,
    settings=lambda work: resolved(work.recipe.grid) | {"pins": resolved_all(work.recipe.pins)},
    compute=_compute,
    inputs={"structures": "structures"},
    expected_seconds=4.0,
)
