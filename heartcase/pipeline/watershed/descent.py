"""Steepest descent on a landscape: which way each voxel drains, and in which basin it ends."""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Float32, Int32, Int64, UInt8

__all__ = [
    "ROOT",
    "basins_of",
    "neighbour_ranks",
    "ranks_at",
    "row_chunks",
    "side_of_rank",
    "side_offsets",
    "steepest_descent",
]


ROOT = 3
"""Direction of a voxel without lower neighbour. The others, by ascending index of the neighbour: 0 z - 1, 1 y - 1,
2 x - 1, 4 x + 1, 5 y + 1, 6 z + 1."""
MOST_CHUNKS = 16


def side_offsets(shape: tuple[int, ...]) -> Int64:
    """Difference of the flat index to the neighbour in each of the seven directions, int64, shape (7,)."""
    _, ny, nx = shape
    return np.array([-nx * ny, -nx, -1, 0, 1, nx, nx * ny], np.int64)


def row_chunks(shape: tuple[int, ...]) -> Int64:
    """Bounds of about equal runs of the volume's rows for the threads, int64; no result depends on them."""
    rows = shape[0] * shape[1]
    count = min(rows, numba.get_num_threads(), MOST_CHUNKS)
    return np.linspace(0, rows, count + 1).astype(np.int64)


def steepest_descent(height: Float32) -> UInt8:
    """Direction to the lowest of a voxel and its six neighbours.

    Parameters
    ----------
    height
        Finite float32, shape [z, y, x], C order. Of equal heights the voxel with the lower index is lower.

    Returns
    -------
    ndarray
        uint8, same shape: see :data:`ROOT`.
    """
    direction = np.empty(height.shape, np.uint8)
    _directions(height, direction)
    return direction


def neighbour_ranks(height: Float32) -> Int32:
    """Order of each voxel's six neighbours, the lowest first.

    Parameters
    ----------
    height
        Finite float32, shape [z, y, x], C order. Of equal heights the voxel with the lower index is lower.

    Returns
    -------
    ndarray
        int32, same shape: the number of neighbours that are lower than the one in direction ``d``, in the three bits
        from ``3 * d`` on. What lies outside the volume comes last.
    """
    ranks = np.empty(height.shape, np.int32)
    _ranks(height, ranks)
    return ranks


def basins_of(direction: UInt8) -> tuple[Int32, Int64]:
    """Number the basins by the index of their lowest voxel, and find the basin of each voxel.

    Parameters
    ----------
    direction
        From :func:`steepest_descent`.

    Returns
    -------
    basin
        int32, same shape.
    root
        Flat index of each basin's lowest voxel, int64, ascending.
    """
    basin = np.empty(direction.shape, np.int32)
    chunks = row_chunks(direction.shape) * direction.shape[2]
    counts = np.empty(len(chunks) - 1, np.int64)
    _count_roots(direction.ravel(), chunks, counts)
    first = np.concatenate([[0], np.cumsum(counts)])
    root = np.empty(int(first[-1]), np.int64)
    _number_roots(direction.ravel(), chunks, first, basin.reshape(-1), root)
    _follow(direction.ravel(), chunks, side_offsets(direction.shape), basin.reshape(-1))
    return basin, root


def _follow(direction: UInt8, chunks: Int64, offsets: Int64, basin: Int32) -> None:
    """Hand the basins' numbers up the descents; no branch depends on the data, which could not be predicted."""
    waiting = np.empty(len(direction), np.int32)
    count = np.empty(len(chunks) - 1, np.int64)
    _first_sweeps(direction, chunks, offsets, basin, waiting, count)
    while count.any():
        _further_sweeps(direction, chunks, offsets, basin, waiting, count)


@kernel(inline="always")
def _lowest_side(zm, ym, xm, here, xp, yp, zp):
    best = zm
    side = 0
    if ym < best:
        best = ym
        side = 1
    if xm < best:
        best = xm
        side = 2
    if here < best:
        best = here
        side = 3
    if xp < best:
        best = xp
        side = 4
    if yp < best:
        best = yp
        side = 5
    if zp < best:
        side = 6
    return side


@copied
def _row_directions(row, zm, ym, yp, zp, out):
    last = len(row) - 1
    wall = np.float32(np.inf)
    out[0] = _lowest_side(zm[0], ym[0], wall, row[0], row[min(1, last)] if last > 0 else wall, yp[0], zp[0])
    for i in range(1, last):
        out[i] = _lowest_side(zm[i], ym[i], row[i - 1], row[i], row[i + 1], yp[i], zp[i])
    if last > 0:
        out[last] = _lowest_side(zm[last], ym[last], row[last - 1], row[last], wall, yp[last], zp[last])


@kernel(inline="always")
def _rows_around(height, wall, k, j):
    """The rows beside a row, at z - 1, y - 1, y + 1 and z + 1: ``wall`` where the volume ends."""
    nz, ny, _ = height.shape
    zm = height[k - 1, j] if k > 0 else wall
    ym = height[k, j - 1] if j > 0 else wall
    yp = height[k, j + 1] if j < ny - 1 else wall
    zp = height[k + 1, j] if k < nz - 1 else wall
    return zm, ym, yp, zp


@loop_kernel
def _directions(height, direction):
    nz, ny, nx = height.shape
    wall = np.full(nx, np.inf, np.float32)
    for line in numba.prange(nz * ny):
        k = line // ny
        j = line - k * ny
        zm, ym, yp, zp = _rows_around(height, wall, k, j)
        _row_directions(height[k, j], zm, ym, yp, zp, direction[k, j])


@kernel(inline="always")
def _count_lower(zm, ym, xm, xp, yp, zp):
    """How many neighbours are lower than each, three bits for each direction."""
    ym_zm = np.int32(ym < zm)
    xm_zm = np.int32(xm < zm)
    xp_zm = np.int32(xp < zm)
    yp_zm = np.int32(yp < zm)
    zp_zm = np.int32(zp < zm)
    xm_ym = np.int32(xm < ym)
    xp_ym = np.int32(xp < ym)
    yp_ym = np.int32(yp < ym)
    zp_ym = np.int32(zp < ym)
    xp_xm = np.int32(xp < xm)
    yp_xm = np.int32(yp < xm)
    zp_xm = np.int32(zp < xm)
    yp_xp = np.int32(yp < xp)
    zp_xp = np.int32(zp < xp)
    zp_yp = np.int32(zp < yp)
    ranks = ym_zm + xm_zm + xp_zm + yp_zm + zp_zm
    ranks |= (np.int32(1) - ym_zm + xm_ym + xp_ym + yp_ym + zp_ym) << np.int32(3)
    ranks |= (np.int32(2) - xm_zm - xm_ym + xp_xm + yp_xm + zp_xm) << np.int32(6)
    ranks |= (np.int32(3) - xp_zm - xp_ym - xp_xm + yp_xp + zp_xp) << np.int32(12)
    ranks |= (np.int32(4) - yp_zm - yp_ym - yp_xm - yp_xp + zp_yp) << np.int32(15)
    ranks |= (np.int32(5) - zp_zm - zp_ym - zp_xm - zp_xp - zp_yp) << np.int32(18)
    return ranks


@copied
def _row_ranks(row, zm, ym, yp, zp, out):
    last = len(row) - 1
    wall = np.float32(np.inf)
    out[0] = _count_lower(zm[0], ym[0], wall, row[1] if last > 0 else wall, yp[0], zp[0])
    for i in range(1, last):
        out[i] = _count_lower(zm[i], ym[i], row[i - 1], row[i + 1], yp[i], zp[i])
    if last > 0:
        out[last] = _count_lower(zm[last], ym[last], row[last - 1], wall, yp[last], zp[last])


@loop_kernel
def _ranks(height, ranks):
    nz, ny, nx = height.shape
    wall = np.full(nx, np.inf, np.float32)
    for line in numba.prange(nz * ny):
        k = line // ny
        j = line - k * ny
        zm, ym, yp, zp = _rows_around(height, wall, k, j)
        _row_ranks(height[k, j], zm, ym, yp, zp, ranks[k, j])


@kernel(inline="always")
def side_of_rank(ranks, rank):
    """Direction of the neighbour with a rank, from a voxel's :func:`neighbour_ranks`."""
    side = 0
    side += 1 * (((ranks >> 3) & 7) == rank)
    side += 2 * (((ranks >> 6) & 7) == rank)
    side += 4 * (((ranks >> 12) & 7) == rank)
    side += 5 * (((ranks >> 15) & 7) == rank)
    side += 6 * (((ranks >> 18) & 7) == rank)
    return side


@copied
def ranks_at(height, v):
    """:func:`neighbour_ranks` of one voxel, by its flat index."""
    nz, ny, nx = height.shape
    k = v // (nx * ny)
    j = v // nx - k * ny
    i = v % nx
    wall = np.float32(np.inf)
    return _count_lower(
        height[k - 1, j, i] if k > 0 else wall,
        height[k, j - 1, i] if j > 0 else wall,
        height[k, j, i - 1] if i > 0 else wall,
        height[k, j, i + 1] if i < nx - 1 else wall,
        height[k, j + 1, i] if j < ny - 1 else wall,
        height[k + 1, j, i] if k < nz - 1 else wall,
    )


@loop_kernel
def _count_roots(direction, chunks, counts):
    for c in numba.prange(len(chunks) - 1):
        count = 0
        for v in range(chunks[c], chunks[c + 1]):
            count += direction[v] == ROOT
        counts[c] = count


@loop_kernel
def _number_roots(direction, chunks, first, basin, root):
    for c in numba.prange(len(chunks) - 1):
        number = first[c]
        for v in range(chunks[c], chunks[c + 1]):
            if direction[v] == ROOT:
                basin[v] = number
                root[number] = v
                number += 1
            else:
                basin[v] = -1


@copied
def _sweep(direction, low, high, waiting, count, forward, offsets, basin):
    """Give the voxels that wait the number of the neighbour they drain to, where that is known; how many still wait.

    ``waiting[low:high]`` holds them: at its end for a sweep forward, at its start for one back, and the other way round
    when it is done. Another thread may give a neighbour its number meanwhile; it is then known now or in a later sweep.
    """
    left = 0
    if forward:
        for n in range(high - count, high):
            v = waiting[n]
            number = basin[v + offsets[direction[v]]]
            basin[v] = number
            waiting[low + left] = v
            left += number < 0
    else:
        for n in range(low + count - 1, low - 1, -1):
            v = waiting[n]
            number = basin[v + offsets[direction[v]]]
            basin[v] = number
            waiting[high - 1 - left] = v
            left += number < 0
    return left


@copied
def _sweep_until_stuck(direction, low, high, waiting, count, offsets, basin):
    before = count + 1
    while 0 < count < before:
        before = count
        count = _sweep(direction, low, high, waiting, count, False, offsets, basin)
        count = _sweep(direction, low, high, waiting, count, True, offsets, basin)
    return count


@copied
def _first_sweep(direction, low, high, waiting, offsets, basin):
    left = 0
    for v in range(low, high):
        number = basin[v + offsets[direction[v]]]
        basin[v] = number
        waiting[low + left] = v
        left += number < 0
    return left


@loop_kernel
def _first_sweeps(direction, chunks, offsets, basin, waiting, count):
    """Sweep each chunk once; its voxels that wait then, from its start in ``waiting`` on, and how many they are."""
    for c in numba.prange(len(chunks) - 1):
        count[c] = _first_sweep(direction, chunks[c], chunks[c + 1], waiting, offsets, basin)


@loop_kernel
def _further_sweeps(direction, chunks, offsets, basin, waiting, count):
    """Sweep each chunk until what still waits there waits for other chunks, or nothing does."""
    for c in numba.prange(len(chunks) - 1):
        count[c] = _sweep_until_stuck(direction, chunks[c], chunks[c + 1], waiting, count[c], offsets, basin)
