"""The tree of a scan's landscape in the build's cache, so that a case opens again without working it out."""

from __future__ import annotations

import time
from dataclasses import dataclass

from heartcase.pipeline.artifacts.cache import Cache, stage_key
from heartcase.pipeline.data import Scan
from heartcase.pipeline.image.landscape import landscape, resolve_segment
from heartcase.pipeline.watershed.tree import BasinTree, build_basin_tree, restored_tree
from heartcase.schemas.arrays import Int64, UInt8
from heartcase.schemas.recipe.settings import SegmentSettings

__all__ = ["TREE_VERSION", "KeptTree", "scan_tree"]

TREE_VERSION = 3
"""Raised whenever the landscape or the order of the faces changes."""


@dataclass(frozen=True)
class KeptTree:
    """What is kept: the rest follows from it and the scan, quicker than it is read."""

    direction: UInt8
    """Direction of steepest descent of each voxel, uint8, shape [z, y, x]."""
    key: Int64
    """Keys of the joining faces, ascending, int64."""


def scan_tree(
    filtered: Scan, settings: SegmentSettings, *, cache: Cache | None = None, scan_sha256: str = ""
) -> BasinTree:
    """The tree of a scan's :func:`heartcase.pipeline.image.landscape.landscape`.

    Parameters
    ----------
    filtered
        The smoothed scan.
    settings
        Blur before the gradient, blur for the shape, and noise floor; by the kind of scan where they are left out.
    cache
        Where the tree is looked for and kept; None works it out.
    scan_sha256
        Hash of the smoothed scan, as its stage has it; needed with ``cache``.

    Raises
    ------
    StageError
        See :func:`heartcase.pipeline.watershed.tree.build_basin_tree`.
    """
    stated = resolve_segment(settings, filtered.modality)
    chosen = {
        "gradient_sigma_mm": stated.gradient_sigma_mm,
        "shape_sigma_mm": stated.shape_sigma_mm,
        "noise_floor": stated.noise_floor,
    }
    ground = landscape(filtered.values, filtered.geometry.spacing_mm, **chosen)
    height, costs = ground.height, (ground.cost, ground.axis_cost)
    if cache is None:
        return build_basin_tree(height, *costs)
    key = stage_key(stage="basins", version=TREE_VERSION, settings=chosen, inputs={"scan": scan_sha256})
    kept = cache.load("basins", key, KeptTree)
    if kept is not None and kept.direction.shape == height.shape:
        restored = restored_tree(height, kept.direction, kept.key, *costs)
        if restored is not None:
            return restored
    start = time.perf_counter()
    tree = build_basin_tree(height, *costs)
    cache.store("basins", key, KeptTree(tree.direction, tree.key), seconds=time.perf_counter() - start)
    return tree
