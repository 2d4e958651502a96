"""Flat minima: sets of voxels of one height that hang together and have no lower neighbour."""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.kernels.union_find import root_of
from heartcase.pipeline.watershed.descent import ROOT, row_chunks, side_offsets
from heartcase.schemas.arrays import Float32, Int32, Int64, UInt8

__all__ = ["flat_minima", "ways_to_flats"]


def flat_minima(height: Float32, root: Int64, key: Int64, first: Int32, second: Int32) -> Int32:
    """Number the flat minima of two voxels or more.

    Parameters
    ----------
    height
        The landscape, float32, shape [z, y, x].
    root
        Flat index of each basin's lowest voxel, int64.
    key, first, second
        Keys of the joining faces and the basins on their sides.

    Returns
    -------
    ndarray
        Number of the flat at each basin's bottom, int32; -1 where its lowest voxel stands alone, or where the flat has
        a lower neighbour. The basin's voxels as high as its lowest one are those of the flat.
    """
    bits = height.view(np.int32).ravel()
    has_flat = np.empty(len(root), np.bool_)
    _find_flat_bottoms(bits, height.shape, side_offsets(height.shape), root, has_flat)
    flat = np.full(len(root), -1, np.int32)
    if has_flat.any():
        _number_flats(bits, root, key, first, second, has_flat, flat)
    return flat


def ways_to_flats(height: Float32, direction: UInt8, basin: Int32, root: Int64, flat: Int32) -> UInt8:
    """Directions of steepest descent that end where a flat minimum is reached, uint8; the same array without any.

    A label that marks a flat minimum alone is that of its feet, and where several do each of its voxels is marked: so
    for a voxel's label nothing has to be looked for inside.

    Parameters
    ----------
    height, direction, basin
        The landscape, and direction and basin of each voxel, shape [z, y, x].
    root, flat
        Flat index of each basin's lowest voxel, and number of the flat minimum there: see :func:`flat_minima`.
    """
    if not (flat >= 0).any():
        return direction
    ways = direction.copy()
    bits = height.view(np.int32).ravel()
    level = np.where(flat >= 0, bits[root], np.int32(-1))
    _end_in_flats(row_chunks(height.shape) * height.shape[2], bits, basin.ravel(), level, ways.reshape(-1))
    return ways


@loop_kernel
def _end_in_flats(chunks, bits, basin, level, ways):
    for c in numba.prange(len(chunks) - 1):
        for v in range(chunks[c], chunks[c + 1]):
            if bits[v] == level[basin[v]]:
                ways[v] = ROOT


@loop_kernel
def _find_flat_bottoms(bits, shape, offsets, root, has_flat):
    """Find the basins whose lowest voxel has a neighbour as high."""
    for b in numba.prange(len(root)):
        has_flat[b] = _has_equal_neighbour(bits, shape, offsets, root[b])


@kernel
def _number_flats(bits, root, key, first, second, has_flat, flat):
    """Number the flat minima among the flat bottoms in ``flat``, which holds -1."""
    count = len(root)
    leader = np.arange(count).astype(np.int32)
    for e in range(len(key)):
        a, b = first[e], second[e]
        if not (has_flat[a] and has_flat[b]):
            continue
        level = key[e] >> 32
        if level == bits[root[a]] and level == bits[root[b]]:
            leader[max(root_of(leader, a), root_of(leader, b))] = min(root_of(leader, a), root_of(leader, b))
    is_minimum = np.ones(count, np.bool_)
    for e in range(len(key)):
        a, b = first[e], second[e]
        if not (has_flat[a] or has_flat[b]):
            continue
        level = key[e] >> 32
        # the lowest way out of a flat that has a lower neighbour is as high as the flat itself
        if level == bits[root[a]] and level > bits[root[b]]:
            is_minimum[root_of(leader, a)] = False
        if level == bits[root[b]] and level > bits[root[a]]:
            is_minimum[root_of(leader, b)] = False
    for b in range(count):
        if has_flat[b]:
            top = root_of(leader, b)
            if is_minimum[top]:
                flat[b] = top


@copied
def _has_equal_neighbour(bits, shape, offsets, v):
    nz, ny, nx = shape
    i = v % nx
    j = v // nx % ny
    k = v // (nx * ny)
    return (
        (k > 0 and bits[v + offsets[0]] == bits[v])
        or (j > 0 and bits[v + offsets[1]] == bits[v])
        or (i > 0 and bits[v + offsets[2]] == bits[v])
        or (i < nx - 1 and bits[v + offsets[4]] == bits[v])
        or (j < ny - 1 and bits[v + offsets[5]] == bits[v])
        or (k < nz - 1 and bits[v + offsets[6]] == bits[v])
    )
