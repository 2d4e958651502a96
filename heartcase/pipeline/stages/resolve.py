"""A recipe with every setting stated, as the stages take it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from heartcase.pipeline.bundle.case_id import made_up_case_id
from heartcase.pipeline.data import Scan
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.resolved import ResolvedRecipe

if TYPE_CHECKING:
    from heartcase.pipeline.image.filter_scan import FilterRules

__all__ = ["SettingRules", "case_id_of", "resolve_recipe"]


@dataclass(frozen=True)
class SettingRules:
    """What a recipe's settings are where it leaves them to a scan; what they need of the scan is found once."""

    scan: Scan
    """The scan's region of interest: see :func:`heartcase.pipeline.stages.read.region_of_scan`."""

    @cached_property
    def filter(self) -> FilterRules:
        """Those of the filter, the only ones that look at every voxel."""
        from heartcase.pipeline.image.filter_scan import FilterRules

        return FilterRules(self.scan)

    def resolve(self, recipe: Recipe) -> ResolvedRecipe:
        """The recipe with every setting filled in that a rule finds; what is resolved stays as it is."""
        from heartcase.pipeline.cells.build_grid import resolve_grid
        from heartcase.pipeline.image.landscape import resolve_segment
        from heartcase.pipeline.walls.grow_walls import resolve_walls

        return ResolvedRecipe.of_recipe(
            recipe,
            case_id=case_id_of(recipe, self.scan),
            filter=self.filter.resolve(recipe.filter),
            segment=resolve_segment(recipe.segment, self.scan.modality),
            walls=resolve_walls(recipe.walls, self.scan.geometry, recipe.table),
            grid=resolve_grid(recipe.grid),
        )


def resolve_recipe(recipe: Recipe, scan: Scan) -> ResolvedRecipe:
    """The recipe with every setting filled in that a rule finds from the scan or from other settings.

    Parameters
    ----------
    recipe
        Any recipe; a resolved one comes back the same.
    scan
        The scan's region of interest: see :func:`heartcase.pipeline.stages.read.region_of_scan`.
    """
    return SettingRules(scan).resolve(recipe)


def case_id_of(recipe: Recipe, scan: Scan, *, name: str | None = None) -> str:
    """The identifier that a recipe states, or the one made up from the scan and a name, the recipe's if left out."""
    scan_sha256 = scan.whole_sha256 or scan.values_sha256
    return recipe.case_id or made_up_case_id(recipe.name if name is None else name, scan_sha256)
