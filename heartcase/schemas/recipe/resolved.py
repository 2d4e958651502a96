"""A recipe with every setting stated that a rule finds from the scan or from other settings.

Each type narrows one of :mod:`heartcase.schemas.recipe.settings`: what may be left out there has a value here, so what
works with it asks for none. Where settings exclude each other there is one type for each choice. What makes them is
:func:`heartcase.pipeline.stages.resolve.resolve_recipe`.
"""

from __future__ import annotations

from typing import Any, Literal, Self, TypeAlias

from heartcase.schemas.base import CaseId, Model
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.settings import FilterSettings, GridSettings, SegmentSettings, WallsSettings

__all__ = [
    "DiffusionFilter",
    "DiffusionMethod",
    "GridByCellSize",
    "GridByNodeCount",
    "NoFilter",
    "ResolvedFilter",
    "ResolvedGrid",
    "ResolvedRecipe",
    "ResolvedSegment",
    "ResolvedWalls",
]

DiffusionMethod: TypeAlias = Literal["curvature_diffusion", "gradient_diffusion"]
"""Which anisotropic diffusion smooths a scan."""


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
    """No filter."""


class DiffusionFilter(FilterSettings, _Resolved):
    """Anisotropic diffusion."""

    method: DiffusionMethod
    """By curvature or by gradient."""
    conductance: float
    """Edge threshold in units of the scan's root mean square gradient."""
    time_step: float
    """Diffusion time step, mm2."""


ResolvedFilter: TypeAlias = NoFilter | DiffusionFilter
"""Smoothing with every setting that its method takes."""


class ResolvedSegment(SegmentSettings, _Resolved):
    """How each voxel gets its label."""

    shape_sigma_mm: float
    """Blur for the shape, mm; 0 leaves it out."""
    noise_floor: float
    """Least height of the landscape, in tenth percentiles of the gradient."""


class ResolvedWalls(WallsSettings, _Resolved):
    """Distance fields and walls; the band is at least a voxel more than the thickest wall."""

    smoothing_mm: float
    """Standard deviation of the blur that takes the voxel steps off a label's border."""
    band_mm: float
    """Distance up to which the fields are exact."""


class GridByCellSize(GridSettings, _Resolved):
    """Cells of a stated edge."""

    cell_mm: float
    """Edge of a cell."""
    node_count: None = None
    """Follows from the edge."""


class GridByNodeCount(GridSettings, _Resolved):
    """Cells as large as make about so many nodes."""

    cell_mm: None = None
    """Follows from the number of nodes."""
    node_count: int
    """Number of nodes to aim at."""


ResolvedGrid: TypeAlias = GridByCellSize | GridByNodeCount
"""Cells by the one of the two that is asked for."""


class ResolvedRecipe(Recipe):
    """A recipe as the stages take it.

    A setting that is None here asks for nothing: no region of interest, no bound of the surface's error.
    """

    case_id: CaseId
    """Made-up identifier that is on every output."""
    filter: ResolvedFilter
    """Smoothing."""
    segment: ResolvedSegment
    """Segmentation."""
    walls: ResolvedWalls
    """Distance fields and walls."""
    grid: ResolvedGrid
    """Cells."""

    @classmethod
    def of_recipe(
        cls,
        recipe: Recipe,
        *,
        case_id: CaseId,
        filter: ResolvedFilter,
        segment: ResolvedSegment,
        walls: ResolvedWalls,
        grid: ResolvedGrid,
    ) -> ResolvedRecipe:
        """The recipe with these parts; its label table is stated as well."""
        # nothing is validated again: a recipe that is being painted has no markers yet
        parts = {"filter": filter, "segment": segment, "walls": walls, "grid": grid}
        return cls.model_construct(**dict(recipe) | parts | {"case_id": case_id, "labels": recipe.table.labels})
