"""What a plane shows of the labels: its voxels, listed once, so that each stroke labels these and no others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.marks import mark_below
from heartcase.pipeline.watershed.painting import TILE
from heartcase.pipeline.watershed.tree import BasinTree
from heartcase.schemas.arrays import Bool, Float64, Int32, Int64

__all__ = ["Sight", "paint_sight", "plane_in_sight"]

_EDGE = 1e-3
"""Voxels; a plane this near to a voxel's face is drawn with either of the two."""


@dataclass(frozen=True)
class Sight:
    """The voxels whose cubes a plane meets. Made by :func:`plane_in_sight`."""

    voxel: Int64
    """Flat index of each, ascending."""
    basin: Int32
    """Basin of each."""
    tiles: Bool
    """Tiles that hold any, shape [z, y, x] of tiles."""
    low: Int64
    """First (z, y, x) of those in each tile, shape [z, y, x, 3] by tile."""
    high: Int64
    """Behind the last of them, same shape."""
    is_box: bool
    """Whether they are all voxels of one box: the plane lies along the scan's axes."""


def plane_in_sight(tree: BasinTree, normal: Float64, offset: float) -> Sight:
    """List what the plane ``normal @ (i, j, k) == offset`` shows.

    Parameters
    ----------
    tree
        The tree of the scan's landscape.
    normal
        Float64, shape (3,), of any length but 0.
    offset
        Where it lies.
    """
    shape = tree.height.shape
    reach = (0.5 + _EDGE) * float(np.abs(normal).sum())
    voxel = _near_plane(normal, offset, reach, shape)
    low, high = _bounds(voxel, shape, tuple(-(-n // TILE) for n in shape))
    tiles = high[..., 0] > 0
    size = high[tiles].max(axis=0) - low[tiles].min(axis=0) if len(voxel) else np.zeros(3, np.int64)
    return Sight(voxel, tree.basin.ravel()[voxel], tiles, low, high, len(voxel) == int(size.prod()))


@kernel
def _near_plane(normal, offset, reach, shape):
    """Flat indices of the voxels at which ``normal @ (i, j, k)`` is no further than ``reach`` from ``offset``."""
    nz, ny, nx = shape
    a, b, c = normal
    first = np.zeros(nz * ny, np.int64)
    last = np.full(nz * ny, -1, np.int64)
    count = 0
    for k in range(nz):
        for j in range(ny):
            rest = offset - b * j - c * k
            low, high = 0.0, nx - 1.0
            # a row along the plane is seen in whole or not at all
            if abs(a) * nx < 1e-9 * reach:
                high = high if abs(rest) <= reach else -1.0
            else:
                one, other = (rest - reach) / a, (rest + reach) / a
                low = np.ceil(max(min(one, other), low))
                high = np.floor(min(max(one, other), high))
            row = k * ny + j
            first[row], last[row] = low, high
            count += max(last[row] - first[row] + 1, 0)
    found = np.empty(count, np.int64)
    at = 0
    for row in range(nz * ny):
        for i in range(first[row], last[row] + 1):
            found[at] = row * nx + i
            at += 1
    return found


@kernel
def _bounds(voxels, shape, tile_counts):
    """By tile: the lowest (z, y, x) of some voxels in it, and behind the highest; both 0 where there are none."""
    _, ny, nx = shape
    low = np.zeros((*tile_counts, 3), np.int64)
    high = np.zeros((*tile_counts, 3), np.int64)
    for v in voxels:
        row = v // nx
        place = (row // ny, row % ny, v % nx)
        c, b, a = place[0] // TILE, place[1] // TILE, place[2] // TILE
        is_new = high[c, b, a, 0] == 0
        for axis in range(3):
            one = place[axis]
            low[c, b, a, axis] = one if is_new else min(low[c, b, a, axis], one)
            high[c, b, a, axis] = max(high[c, b, a, axis], one + 1)
    return low, high


@kernel
def paint_sight(voxel, basin, feet, landscape, marks, lowest_mark, labels, shape, is_changed):
    """Label some voxels of given basins; notes tiles in which that changed any.

    ``feet`` holds the label of each basin's foot, behind two empty tables; or the place of each basin, the group of
    each place, and the label of each group.
    """
    place, group, label = feet
    is_parted = len(place) > 0
    _, direction, _, offsets = landscape
    _, ny, nx = shape
    # neighbours mostly are of one basin
    before, foot, is_marked = np.int32(-1), np.uint8(UNMARKED), False
    for n in range(len(voxel)):
        b = basin[n]
        if b != before:
            before, is_marked = b, lowest_mark[b] >= 0
            foot = label[group[place[b]] if is_parted else b]
        v = voxel[n]
        found = foot
        if is_marked:
            mark = mark_below(v, direction, offsets, marks)
            if mark != UNMARKED:
                found = mark
        if labels[v] != found:
            labels[v] = found
            row = v // nx
            is_changed[row // ny // TILE, row % ny // TILE, v % nx // TILE] = True
