"""Flat minima, and their division where several labels mark one: half way, by steps (a first-in first-out flood)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.kernels.union_find import root_of
from heartcase.pipeline.watershed.descent import ROOT, row_chunks, side_offsets
from heartcase.pipeline.watershed.marks import CONTESTED
from heartcase.schemas.arrays import Float32, Int16, Int32, Int64, UInt8

if TYPE_CHECKING:
    from heartcase.pipeline.watershed.tree import BasinTree

__all__ = ["divide_flat", "divided_anew", "flat_minima", "ways_to_flats"]


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


def divided_anew(
    tree: BasinTree, painted: UInt8, marks: UInt8, flat_label: Int16, strokes: Sequence[tuple[int, Int64]]
) -> list[tuple[int, Int64]]:
    """Voxels whose marks change with strokes that lie in contested flat minima, by their label: first 255, none.

    Parameters
    ----------
    tree
        The tree of the landscape.
    painted
        Label of each painted voxel, the strokes' among them; 255 elsewhere.
    marks
        The same from before the strokes, with contested flat minima divided; it is so again afterwards.
    flat_label
        Label that marks each flat minimum: -1 none, -2 several; made to fit the strokes.
    strokes
        Label, 255 for none, and flat indices of the voxels that have it now.
    """
    marked, seeded, shape = marks.reshape(-1), painted.reshape(-1), painted.shape
    bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
    voxels = np.concatenate([one for _, one in strokes])
    own = basin[voxels]
    is_inside = (tree.flat[own] >= 0) & (bits[voxels] == bits[tree.root[own]])
    changed, values = [voxels[~is_inside]], [seeded[voxels[~is_inside]]]
    for number in np.unique(tree.flat[own[is_inside]]).tolist():
        inside = _voxels_of_flat(np.flatnonzero(tree.flat == number), *tree.voxels, bits, tree.root)
        before = marked[inside]
        marked[inside] = seeded[inside]
        seeds = inside[seeded[inside] != UNMARKED]
        labels = np.unique(seeded[seeds])
        flat_label[number] = CONTESTED if len(labels) > 1 else [-1, *labels.tolist()][-1]
        if len(labels) > 1:
            divide_flat(bits, basin, tree.flat, shape, side_offsets(shape), seeds, marked, UNMARKED)
        after = marked[inside]
        marked[inside] = before
        changed.append(inside[after != before])
        values.append(after[after != before])
    everywhere, value = np.concatenate(changed), np.concatenate(values)
    return [(one, everywhere[value == one]) for one in sorted({*value.tolist()}, reverse=True)]


@kernel
def divide_flat(bits, basin, flat, shape, offsets, voxels, marks, unmarked):
    """Divide a flat minimum among its marked voxels, in place: each voxel goes to the marked one with fewest steps.

    Parameters
    ----------
    bits, basin, marks
        Heights as bits, basins and labels of all voxels, one-dimensional; ``marks`` is painted on.
    flat
        Number of the flat minimum at each basin's bottom.
    shape, offsets
        Of the volume: (z, y, x), and from :func:`heartcase.pipeline.watershed.descent.side_offsets`.
    voxels
        Flat indices of the marked voxels of the flat, ascending.
    unmarked
        Value in ``marks`` of what is not marked.
    """
    nz, ny, nx = shape
    shore = voxels
    level = bits[shore[0]]
    number = flat[basin[shore[0]]]
    while len(shore) > 0:
        reached = np.empty(6 * len(shore), np.int64)
        count = 0
        # in ascending order, so that of neighbours equally near the one with the lowest index gives its label
        for v in shore:
            i = v % nx
            j = v // nx % ny
            k = v // (nx * ny)
            for side in range(7):
                if (
                    side == 3
                    or (side == 0 and k == 0)
                    or (side == 1 and j == 0)
                    or (side == 2 and i == 0)
                    or (side == 4 and i == nx - 1)
                    or (side == 5 and j == ny - 1)
                    or (side == 6 and k == nz - 1)
                ):
                    continue
                u = v + offsets[side]
                if marks[u] == unmarked and bits[u] == level and flat[basin[u]] == number:
                    marks[u] = marks[v]
                    reached[count] = u
                    count += 1
        shore = np.sort(reached[:count])


@kernel
def _voxels_of_flat(basins, first_voxel, voxel_list, bits, root):
    """Flat indices of the voxels of a flat minimum, ascending: those at the bottom of its basins.

    Parameters
    ----------
    basins
        Numbers of its basins.
    first_voxel, voxel_list
        The voxels of each basin.
    bits
        Heights as bits, one-dimensional.
    root
        Flat index of each basin's lowest voxel.
    """
    count = 0
    for b in basins:
        count += first_voxel[b + 1] - first_voxel[b]
    found = np.empty(count, np.int64)
    count = 0
    for b in basins:
        level = bits[root[b]]
        for n in range(first_voxel[b], first_voxel[b + 1]):
            if bits[voxel_list[n]] == level:
                found[count] = voxel_list[n]
                count += 1
    return np.sort(found[:count])


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
