"""Kernels of strokes, loaded before the first one."""

from __future__ import annotations

import numpy as np

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.flat_minima.division_kernels import FAR
from heartcase.pipeline.watershed.flat_minima.mending import Mending
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.marks import note_erased, note_marked
from heartcase.pipeline.watershed.painting import tiles_of
from heartcase.pipeline.watershed.sight import plane_in_sight
from heartcase.pipeline.watershed.tree import build_basin_tree

__all__ = ["load_stroke_kernels"]


def load_stroke_kernels() -> None:
    """Have the kernels at hand that strokes call: a first one would wait for each of them to be loaded."""
    shape = (4, 4, 4)
    # every second voxel is a basin
    height = (np.indices(shape).sum(axis=0) % 2 + np.arange(64).reshape(shape) / 64).astype(np.float32)
    tree = build_basin_tree(height)
    sight = plane_in_sight(tree, np.array([0.0, 0.0, 1.0]), 1.0)
    forest = solve_forest(tree, np.full(shape, UNMARKED, np.uint8))
    forest.puts_off = True
    for voxel, label in ((0, 1), (63, 2), (63, UNMARKED)):
        forest.paint(np.array([voxel]), label)
    first_voxel, voxel_list = tree.voxels
    tiles_of(np.arange(tree.basin_count), first_voxel, voxel_list, shape, forest.put_off)
    for is_behind in (False, True):
        if is_behind:
            forest.fall_behind()
        forest.settle_sight(sight)
        forest.settle_boxes([(slice(0, 1), slice(0, 4), slice(0, 4))])
        forest.label_counts(), forest.painted_counts()
    bits, basin, voxels = height.view(np.int32).ravel(), tree.basin.ravel(), np.array([1])
    marks, lowest = forest.marks.reshape(-1), forest.lowest_mark
    note_marked(bits, basin, voxels, 1, marks, lowest)
    note_erased(bits, basin, tree.voxels, voxels, marks, lowest)
    forest.settle()
    _load_flat_kernels()


def _load_flat_kernels() -> None:
    """The same for strokes in a flat minimum that several labels mark: all is one."""
    tree = build_basin_tree(np.zeros((2, 4, 4), np.float32))
    forest = solve_forest(tree, np.full((2, 4, 4), UNMARKED, np.uint8))
    forest.puts_off = True
    # divided, mended outwards, withdrawn, and of one label again
    for voxel, label in ((0, 1), (31, 2), (5, 2), (5, UNMARKED), (31, UNMARKED)):
        forest.paint(np.array([voxel]), label)
    forest.settle()
    painted, voxels = forest.painted.reshape(-1), np.array([0])
    distance = np.full(painted.size, FAR, np.int32)
    mending = Mending(tree.height.shape, *tree.costs, distance, FAR)
    mending.feed(voxels, np.array([UNMARKED], np.uint8), painted, painted.copy())
    mending.go_on(painted, painted.copy(), 1)
    mending.take_back(painted.copy())
