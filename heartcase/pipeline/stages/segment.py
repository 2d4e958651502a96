"""The segment stage: each voxel gets a label (thesis 11.1.1)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.stages.stage import Stage, Work, have, resolved_all
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.settings import resolved

if TYPE_CHECKING:
    from heartcase.pipeline.watershed.tree import BasinTree

__all__ = ["STAGE", "filtered_tree"]


def filtered_tree(work: Work) -> BasinTree:
    """The watershed's tree of the smoothed scan: kept from before, or made and kept."""
    from heartcase.pipeline.watershed.tree_cache import scan_tree

    filtered = have(work.outputs.filtered)
    return scan_tree(filtered.get(), work.recipe.segment, cache=work.cache, scan_sha256=filtered.sha256)


def _is_made(recipe: Recipe) -> bool:
    """Whether heartcase makes the segmentation, and not a file brings it."""
    return recipe.segment.finished_file is None


def _settings(work: Work) -> dict[str, Any]:
    settings = resolved(work.recipe.segment) | {"labels": resolved_all(work.recipe.labels)}
    # what concerns a file's names or the markers is in what they give
    for elsewhere in ("file", "names", "convention", "others", "order", "automatic"):
        settings.pop(elsewhere)
    return settings


def _compute(work: Work) -> Segmentation:
    from heartcase.pipeline.markers.load_markers import load_segmentation
    from heartcase.pipeline.watershed.segment_scan import segment_scan

    recipe, outputs = work.recipe, work.outputs
    file = recipe.segment.finished_file
    if file is None:
        return segment_scan(
            have(outputs.filtered).get(),
            outputs.markers.get() if outputs.markers else None,
            recipe.segment,
            recipe.table,
            make_tree=lambda: filtered_tree(work),
        )
    return load_segmentation(
        work.directory / file,
        recipe.segment.names,
        recipe.table,
        have(outputs.scan).get().geometry,
        convention=recipe.segment.convention,
        others=recipe.segment.others,
        order=recipe.segment.order,
    )


STAGE = Stage(
    name="segment",
    version=5,
    title="segmenting",
    deed="find the structures",
    subject="finding the structures",
    output="segmentation",
    kind=Segmentation,
    settings=_settings,
    compute=_compute,
    inputs={"scan": "filtered", "markers": "markers"},
    expected_seconds=5.0,
    is_kept=_is_made,
)
