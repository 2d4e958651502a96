"""The tree of a scan's landscape in the build's cache, so that a case opens again without working it out."""

from __future__ import annotations

import time
from dataclasses import dataclass

from heartcase.pipeline.artifacts.cache import Cache, stage_key
from heartcase.pipeline.data import Scan
from heartcase.pipeline.image.landscape import landscape
from heartcase.pipeline.watershed.tree import BasinTree, build_basin_tree, restored_tree
from heartcase.schemas.arrays import Int64, UInt8

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
    filtered: Scan,
    *,
    gradient_sigma_mm: float,
    shape_sigma_mm: float,
    cache: Cache | None = None,
    scan_sha256: str = "",
) -> BasinTree:
    """The tree of a scan's :func:`heartcase.pipeline.image.landscape.landscape`.

    Parameters
    ----------
    filtered
        The smoothed scan.
    gradient_sigma_mm, shape_sigma_mm
        Blur before the gradient and for the shape, mm; 0 for none.
    cache
        Where the tree is looked for and kept; None works it out.
    scan_sha256
        Hash of the smoothed scan, as its stage has it; needed with ``cache``.

    Raises
    ------
    StageError
        See :func:`heartcase.pipeline.watershed.tree.build_basin_tree`.
    """
    settings = {"gradient_sigma_mm": gradient_sigma_mm, "shape_sigma_mm": shape_sigma_mm}
    height = landscape(filtered.values, filtered.geometry.spacing_mm, **settings)
    if cache is None:
        return build_basin_tree(height)
    key = stage_key(stage="basins", version=TREE_VERSION, settings=settings, inputs={"scan": scan_sha256})
    kept = cache.load("basins", key, KeptTree)
    if kept is not None and kept.direction.shape == height.shape:
        restored = restored_tree(height, kept.direction, kept.key)
        if restored is not None:
            return restored
    start = time.perf_counter()
    tree = build_basin_tree(height)
    cache.store("basins", key, KeptTree(tree.direction, tree.key), seconds=time.perf_counter() - start)
    return tree
