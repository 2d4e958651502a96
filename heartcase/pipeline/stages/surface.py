"""The surface stage: what the surgeon sees (thesis 11.2.2)."""

from __future__ import annotations

from heartcase.pipeline.data import Surface
from heartcase.pipeline.stages.stage import Stage, Work, have
from heartcase.schemas.recipe.recipe import Part
from heartcase.schemas.recipe.settings import resolved

__all__ = ["STAGE"]


def _compute(work: Work) -> Surface:
    from heartcase.pipeline.mesh.build_surface import build_surface

    recipe = work.recipe
    return build_surface(have(work.outputs.structures).get(), recipe.surface, render=Part.RENDER in recipe.parts)


STAGE = Stage(
    name="surface",
    version=14,
    title="surface and normal map",
    deed="make the visible surface",
    subject="visible surface",
    output="surface",
    kind=Surface,
    settings=lambda work: resolved(work.recipe.surface) | {"render": Part.RENDER in work.recipe.parts},
    compute=_compute,
    inputs={"structures": "structures"},
    expected_seconds=12.0,
    is_part=lambda recipe: Part.SURFACE in recipe.parts,
    beside="grid",  # which waits for one core where this one does not
)
