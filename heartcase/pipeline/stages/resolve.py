"""A recipe with every setting stated, as the stages take it."""

from __future__ import annotations

from heartcase.pipeline.bundle.case_id import made_up_case_id
from heartcase.pipeline.data import Scan
from heartcase.schemas.recipe.recipe import Recipe

__all__ = ["resolve_recipe"]


def resolve_recipe(recipe: Recipe, scan: Scan) -> Recipe:
    """The recipe with every setting filled in that a rule finds from the scan or from other settings.

    Parameters
    ----------
    recipe
        Any recipe; a resolved one comes back the same.
    scan
        The scan's region of interest: see :func:`heartcase.pipeline.stages.read.region_of_scan`.
    """
    from heartcase.pipeline.cells.build_grid import resolve_grid
    from heartcase.pipeline.image.filter_scan import resolve_filter
    from heartcase.pipeline.walls.grow_walls import resolve_walls

    return recipe.model_copy(
        update={
            "case_id": recipe.case_id or made_up_case_id(recipe.name, scan.whole_sha256 or scan.values_sha256),
            "labels": recipe.table.labels,
            "filter": resolve_filter(recipe.filter, scan),
            "walls": resolve_walls(recipe.walls, scan.geometry, recipe.table),
            "grid": resolve_grid(recipe.grid),
        }
    )
