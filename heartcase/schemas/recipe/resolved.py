"""A recipe with every setting stated that a rule finds from the scan or from other settings.

Each type narrows one of :mod:`heartcase.schemas.recipe.settings`: what may be left out there has a value here, so what
works with it asks for none. Where settings exclude each other there is one type for each choice. What makes them is
:func:`heartcase.pipeline.stages.resolve.resolve_recipe`.
"""

from __future__ import annotations

from typing import Any, Literal, Self, TypeAlias

from heartcase.schemas.base import CaseId, Model
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.settings import FilterSettings, GridSettings, WallsSettings

__all__ = [
    "DiffusionFilter",
    "DiffusionMethod",
    "GridByCellSize",
    "GridByNodeCount",
    "NoFilter",
    "ResolvedFilter",
    "ResolvedGrid",
    "ResolvedRecipe",
    "ResolvedWalls",
]

DiffusionMethod: TypeAlias = Literal["curvature_diffusion", "gradient_diffusion"]


class _Resolved(Model):
    """What the types share."""

    @classmethod
    def of(cls, settings: Model, **found: Any) -> Self:
        """Settings with what was found filled in.

        Raises
        ------
        ValidationError
            One is still without a value.
        """
        return cls.model_validate(dict(settings) | found)


class NoFilter(FilterSettings, _Resolved):
    """The scan is taken as it is, whatever the other settings say."""

    method: Literal["none"]


class DiffusionFilter(FilterSettings, _Resolved):
    """Anisotropic diffusion."""

    method: DiffusionMethod
    conductance: float
    time_step: float


ResolvedFilter: TypeAlias = NoFilter | DiffusionFilter


class ResolvedWalls(WallsSettings, _Resolved):
    """Distance fields and walls; the band is at least a voxel more than the thickest wall."""

    smoothing_mm: float
    band_mm: float


class GridByCellSize(GridSettings, _Resolved):
    """Cells of a stated edge."""

    cell_mm: float
    node_count: None = None


class GridByNodeCount(GridSettings, _Resolved):
    """Cells as large as make about so many nodes."""

    cell_mm: None = None
    node_count: int


ResolvedGrid: TypeAlias = GridByCellSize | GridByNodeCount


class ResolvedRecipe(Recipe):
    """A recipe as the stages take it.

    A setting that is None here asks for nothing: no region of interest, no bound of the surface's error.
    """

    case_id: CaseId
    filter: ResolvedFilter
    walls: ResolvedWalls
    grid: ResolvedGrid

    @classmethod
    def of_recipe(
        cls, recipe: Recipe, *, case_id: CaseId, filter: ResolvedFilter, walls: ResolvedWalls, grid: ResolvedGrid
    ) -> ResolvedRecipe:
        """The recipe with these parts; its label table is stated as well."""
        # nothing is validated again: a recipe that is being painted has no markers yet
        parts = {"case_id": case_id, "labels": recipe.table.labels, "filter": filter, "walls": walls, "grid": grid}
        return cls.model_construct(**dict(recipe) | parts)
