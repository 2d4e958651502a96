"""The watershed transform from markers, by one priority flood (Beucher and Meyer 1993; thesis 11.1.1)."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

__all__ = ["flood_from_markers"]

Float32 = npt.NDArray[np.float32]
UInt8 = npt.NDArray[np.uint8]


def flood_from_markers(height: Float32, markers: UInt8, *, unmarked: int) -> UInt8:
    """Flood a landscape from markers, without watershed lines.

    The lowest voxel on the shore floods its neighbours through its six faces: each that is dry takes its label and
    joins the shore. Tie rule: of equally low voxels the one that joined first; markers join in the order of their
    index (x fastest), neighbours in the order z - 1, y - 1, x - 1, x + 1, y + 1, z + 1. So on a plateau two floods
    meet half way, and the result depends on nothing but the input.

    Parameters
    ----------
    height
        Height of each voxel, finite float32, shape [z, y, x].
    markers
        Label of each marked voxel, same shape; 0 is a label like the others.
    unmarked
        The value in ``markers`` of voxels that are not marked.

    Returns
    -------
    ndarray
        Label of every voxel, uint8; marked voxels keep theirs. Without any marker all stay ``unmarked``.
    """
    labels = markers.copy()
    _flood(np.ascontiguousarray(height, np.float32), labels, np.uint8(unmarked))
    return labels


@numba.njit(cache=True, nogil=True)
def _flood(height, labels, unmarked):  # type: ignore[no-untyped-def]
    """Fill ``labels`` in place; the shore is a binary heap ordered by (height, turn of joining)."""
    nz, ny, nx = labels.shape
    flat_height = height.ravel()
    flat_labels = labels.reshape(labels.size)
    heap_height = np.empty(labels.size, np.float32)
    heap_turn = np.empty(labels.size, np.int64)
    heap_voxel = np.empty(labels.size, np.int64)
    count = 0
    turn = 0
    for voxel in range(labels.size):
        if flat_labels[voxel] != unmarked:
            _push(heap_height, heap_turn, heap_voxel, count, flat_height[voxel], turn, voxel)
            count += 1
            turn += 1
    while count > 0:
        voxel = heap_voxel[0]
        count -= 1
        _drop_first(heap_height, heap_turn, heap_voxel, count)
        label = flat_labels[voxel]
        i = voxel % nx
        j = voxel // nx % ny
        k = voxel // (nx * ny)
        for side in range(6):
            if side == 0 and k > 0:
                near = voxel - nx * ny
            elif side == 1 and j > 0:
                near = voxel - nx
            elif side == 2 and i > 0:
                near = voxel - 1
            elif side == 3 and i < nx - 1:
                near = voxel + 1
            elif side == 4 and j < ny - 1:
                near = voxel + nx
            elif side == 5 and k < nz - 1:
                near = voxel + nx * ny
            else:
                continue
            if flat_labels[near] == unmarked:
                flat_labels[near] = label
                _push(heap_height, heap_turn, heap_voxel, count, flat_height[near], turn, near)
                count += 1
                turn += 1


@numba.njit(cache=True, nogil=True)
def _push(heights, turns, voxels, count, height, turn, voxel):  # type: ignore[no-untyped-def]
    """Add an entry to a heap of ``count`` entries; its turn is later than all others'."""
    hole = count
    while hole > 0:
        parent = (hole - 1) // 2
        if heights[parent] <= height:
            break
        heights[hole] = heights[parent]
        turns[hole] = turns[parent]
        voxels[hole] = voxels[parent]
        hole = parent
    heights[hole] = height
    turns[hole] = turn
    voxels[hole] = voxel


@numba.njit(cache=True, nogil=True)
def _drop_first(heights, turns, voxels, count):  # type: ignore[no-untyped-def]
    """Remove the first entry; ``count`` entries are left."""
    height, turn, voxel = heights[count], turns[count], voxels[count]
    hole = 0
    while True:
        child = 2 * hole + 1
        if child >= count:
            break
        right = child + 1
        if right < count and (
            heights[right] < heights[child] or (heights[right] == heights[child] and turns[right] < turns[child])
        ):
            child = right
        if height < heights[child] or (height == heights[child] and turn < turns[child]):
            break
        heights[hole] = heights[child]
        turns[hole] = turns[child]
        voxels[hole] = voxels[child]
        hole = child
    heights[hole] = height
    turns[hole] = turn
    voxels[hole] = voxel
