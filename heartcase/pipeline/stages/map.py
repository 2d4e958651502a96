"""The map stage: the surface tied to the grid (thesis 9.3 and 11.2.4)."""

from __future__ import annotations

from heartcase.pipeline.data import GridMap
from heartcase.pipeline.stages.stage import Stage, Work, have
from heartcase.schemas.recipe.recipe import Part
from heartcase.schemas.recipe.settings import resolved

__all__ = ["STAGE"]


def _compute(work: Work) -> GridMap:
    from heartcase.pipeline.cells.map_surface import map_surface

    outputs = work.outputs
    surface, grid, structures = have(outputs.surface), have(outputs.grid), have(outputs.structures)
    return map_surface(surface.get(), grid.get(), structures.get(), work.recipe.map)


STAGE = Stage(
    name="map",
    version=9,
    title="tying surface to grid",
    deed="tie the surface to the cells",
    subject="tie between surface and cells",
    output="grid_map",
    kind=GridMap,
    settings=lambda work: resolved(work.recipe.map),
    compute=_compute,
    inputs={"surface": "surface", "grid": "grid", "structures": "structures"},
    expected_seconds=2.0,
    is_part=lambda recipe: Part.SURFACE in recipe.parts,
)
