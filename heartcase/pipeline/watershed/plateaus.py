"""Flat minima, and their division where several labels mark one: half way, by steps (a first-in first-out flood)."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.watershed.descent import side_offsets

__all__ = ["divide_flat", "extend_division", "flat_minima"]

Float32 = npt.NDArray[np.float32]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]


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
    found: Int32 = _flat_minima(bits, height.shape, side_offsets(height.shape), root, key, first, second)
    return found


@kernel
def divide_flat(bits, basin, flat, shape, offsets, voxels, marks, steps, unmarked):  # type: ignore[no-untyped-def]
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
    steps
        Gets the steps of each voxel of the flat to its marked voxel, int32.
    unmarked
        Value in ``marks`` of what is not marked.
    """
    nz, ny, nx = shape
    shore = voxels
    step = np.int32(0)
    for v in voxels:
        steps[v] = step
    level = bits[shore[0]]
    number = flat[basin[shore[0]]]
    while len(shore) > 0:
        step += np.int32(1)
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
                    steps[u] = step
                    reached[count] = u
                    count += 1
        shore = np.sort(reached[:count])


@copied
def _is_inside(v, side, shape):  # type: ignore[no-untyped-def]
    """Whether a voxel has a neighbour in a direction."""
    nz, ny, nx = shape
    i = v % nx
    j = v // nx % ny
    k = v // (nx * ny)
    if side == 0:
        return k > 0
    if side == 1:
        return j > 0
    if side == 2:
        return i > 0
    if side == 4:
        return i < nx - 1
    if side == 5:
        return j < ny - 1
    return side == 6 and k < nz - 1


@copied
def _nearer_label(u, step, number, level, bits, basin, flat, shape, offsets, marks, steps):  # type: ignore[no-untyped-def]
    """Label of the neighbour with the lowest index that is one step nearer; the directions ascend with the index."""
    for side in range(7):
        if _is_inside(u, side, shape):
            w = u + offsets[side]
            if bits[w] == level and flat[basin[w]] == number and steps[w] == step - 1:
                return marks[w]
    return marks[u]


@kernel
def extend_division(bits, basin, flat, shape, offsets, voxels, label, marks, steps):  # type: ignore[no-untyped-def]
    """Carry newly marked voxels into the division of their flat minima, in place; all voxels that got the label.

    A voxel changes where the new ones are nearer, or as near with a neighbour of lower index one step nearer: it then
    gets their label, never another one. So only what changes is looked at, wave by wave.

    Parameters
    ----------
    bits, basin, flat, shape, offsets, marks, steps
        As for :func:`divide_flat`, which has divided the flats of all ``voxels``.
    voxels
        Flat indices of the voxels that were marked.
    label
        Their label.
    """
    changed = [np.int64(v) for v in voxels]
    for v in voxels:
        marks[v] = label
        steps[v] = 0
    begin = 0
    step = np.int32(0)
    while begin < len(changed):
        step += np.int32(1)
        end = len(changed)
        for n in range(begin, end):
            v = changed[n]
            level = bits[v]
            number = flat[basin[v]]
            for side in range(7):
                if not _is_inside(v, side, shape):
                    continue
                u = v + offsets[side]
                if bits[u] != level or flat[basin[u]] != number or steps[u] < step:
                    continue
                if steps[u] == step:
                    if marks[u] == label:
                        continue
                    if _nearer_label(u, step, number, level, bits, basin, flat, shape, offsets, marks, steps) != label:
                        continue
                steps[u] = step
                marks[u] = label
                changed.append(u)
        begin = end
    return np.array(changed)


@copied
def _find(leader, b):  # type: ignore[no-untyped-def]
    while leader[b] != b:
        leader[b] = leader[leader[b]]
        b = leader[b]
    return b


@kernel(parallel=True)
def _has_flat_bottom(bits, shape, offsets, root):  # type: ignore[no-untyped-def]
    """Basins whose lowest voxel has a neighbour as high."""
    has_flat = np.empty(len(root), np.bool_)
    for b in numba.prange(len(root)):
        has_flat[b] = _has_equal_neighbour(bits, shape, offsets, root[b])
    return has_flat


@kernel
def _flat_minima(bits, shape, offsets, root, key, first, second):  # type: ignore[no-untyped-def]
    count = len(root)
    flat = np.full(count, -1, np.int32)
    has_flat = _has_flat_bottom(bits, shape, offsets, root)
    if not has_flat.any():
        return flat
    leader = np.arange(count).astype(np.int32)
    for e in range(len(key)):
        a, b = first[e], second[e]
        if not (has_flat[a] and has_flat[b]):
            continue
        level = key[e] >> 32
        if level == bits[root[a]] and level == bits[root[b]]:
            leader[max(_find(leader, a), _find(leader, b))] = min(_find(leader, a), _find(leader, b))
    is_minimum = np.ones(count, np.bool_)
    for e in range(len(key)):
        a, b = first[e], second[e]
        if not (has_flat[a] or has_flat[b]):
            continue
        level = key[e] >> 32
        # the lowest way out of a flat that has a lower neighbour is as high as the flat itself
        if level == bits[root[a]] and level > bits[root[b]]:
            is_minimum[_find(leader, a)] = False
        if level == bits[root[b]] and level > bits[root[a]]:
            is_minimum[_find(leader, b)] = False
    for b in range(count):
        if has_flat[b]:
            top = _find(leader, b)
            if is_minimum[top]:
                flat[b] = top
    return flat


@copied
def _has_equal_neighbour(bits, shape, offsets, v):  # type: ignore[no-untyped-def]
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
