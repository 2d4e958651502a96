"""The minimum spanning tree of a landscape: basins, and the lowest faces that join them.

It serves every set of markers, so it is worked out once per scan. The faces between basins are found slab by slab and
joined by Boruvka's algorithm of 1926 (Nesetril, Milkova and Nesetrilova, Discrete Mathematics 233, 2001). The order of
the faces is strict, so there is one minimum spanning tree only, whatever the threads do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.watershed.descent import (
    basins_of,
    neighbour_ranks,
    ranks_at,
    row_chunks,
    side_of_rank,
    side_offsets,
    steepest_descent,
)
from heartcase.pipeline.watershed.plateaus import flat_minima, ways_to_flats
from heartcase.schemas.arrays import Float32, Int32, Int64, UInt8, UInt16
from heartcase.schemas.errors import StageError

if TYPE_CHECKING:
    from heartcase.pipeline.watershed.hanging import HangingTree

__all__ = ["MOST_VOXELS", "BasinTree", "build_basin_tree", "restored_tree"]


MOST_VOXELS = 1 << 29
"""Voxels of the largest volume: a face's key holds the index of its higher voxel in 29 bits."""
NO_KEY = np.int64(2**63 - 1)
NO_PAIR = -1
INFINITE = 0x7F800000
"""Bits of an infinite height; those of a NaN are higher."""
NOTED = 1 << 14
"""Pairs of basins whose faces were met last; enough for those of a row and the slice before it."""
HASH = np.int64(0x9E3779B97F4A7C15 - (1 << 64))
"""The golden ratio's multiplier of Knuth, The Art of Computer Programming 3, 6.4."""


@dataclass(frozen=True)
class BasinTree:
    """A landscape's minimum spanning tree under the order of :mod:`heartcase.pipeline.watershed`.

    A face's *key* is an int64 that ascends in that order: the bits of the height of its higher voxel, 29 bits of that
    voxel's index, and in three bits how many of that voxel's neighbours are lower than the face's lower voxel.
    """

    height: Float32
    """The landscape, float32, shape [z, y, x], >= 0."""
    direction: UInt8
    """Direction of steepest descent of each voxel, uint8."""
    basin: Int32
    """Basin of each voxel, int32."""
    root: Int64
    """Flat index of each basin's lowest voxel, int64, ascending."""
    key: Int64
    """Keys of the faces that join the basins, ascending, int64, shape (basins - 1,)."""
    lower: Int32
    """Flat index of the lower voxel of each joining face, int32."""
    cost: UInt16 | None = None
    """Cost of a step into each voxel inside a flat minimum, uint16 >= 1, shape [z, y, x]; None: 1 everywhere."""
    axis_cost: tuple[int, int, int] = (1, 1, 1)
    """What a step along z, y and x is worth besides, >= 1: voxels are longer along some axes."""

    @cached_property
    def costs(self) -> tuple[UInt16, Int64]:
        """Costs of all voxels, flat, and of the axes, int64, for the division of flat minima."""
        cost = np.ones(self.height.size, np.uint16) if self.cost is None else self.cost.reshape(-1)
        return cost, np.array(self.axis_cost, np.int64)

    @cached_property
    def largest_cost(self) -> int:
        """Cost of the longest step there is."""
        return int(self.costs[0].max(initial=1)) * max(self.axis_cost)

    @property
    def basin_count(self) -> int:
        """Number of basins."""
        return len(self.root)

    @cached_property
    def ends(self) -> tuple[Int64, Int64]:
        """Flat indices of the higher and of the lower voxel of each joining face."""
        return (self.key >> 3) & (MOST_VOXELS - 1), self.lower.astype(np.int64)

    @cached_property
    def basins(self) -> tuple[Int32, Int32]:
        """The basins that each joining face joins: that of its higher and that of its lower voxel."""
        basin = self.basin.ravel()
        higher, lower = self.ends
        return basin[higher], basin[lower]

    @cached_property
    def flat(self) -> Int32:
        """Number of the flat minimum of two voxels or more at each basin's bottom, int32; -1 where there is none."""
        return flat_minima(self.height, self.root, self.key, *self.basins)

    @cached_property
    def ways(self) -> UInt8:
        """Direction of steepest descent of each voxel; none where a flat minimum is reached."""
        return ways_to_flats(self.height, self.direction, self.basin, self.root, self.flat)

    @cached_property
    def neighbours(self) -> tuple[Int64, Int32]:
        """Joining faces of each basin: ``faces[start[b]:start[b + 1]]`` for basin ``b``."""
        start, faces = _neighbours(self.basin_count, *self.basins)
        return start, faces

    @cached_property
    def voxels(self) -> tuple[Int64, Int32]:
        """Voxels of each basin, by ascending index: ``voxels[start[b]:start[b + 1]]`` for basin ``b``."""
        start, voxels = _voxel_lists(self.basin.ravel(), self.basin_count)
        return start, voxels

    def voxels_of(self, basins: Int64) -> tuple[Int64, Int64]:
        """Flat indices of the voxels of some basins, one basin after the other, and the basin of each."""
        start, voxel_list = self.voxels
        counts = start[basins + 1] - start[basins]
        owner = np.repeat(basins, counts)
        first = np.repeat(start[basins] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
        return voxel_list[first + np.arange(len(owner))].astype(np.int64), owner

    def flat_of(self, voxels: Int64) -> Int32:
        """Number of the flat minimum that each voxel, a flat index, lies in, int32; -1 where it lies in none."""
        bits, basin = self.height.view(np.int32).ravel(), self.basin.ravel()[voxels]
        return np.where(bits[voxels] == bits[self.root[basin]], self.flat[basin], np.int32(-1))

    @cached_property
    def hanging(self) -> HangingTree:
        """What each basin hangs on while it is not marked: see :mod:`heartcase.pipeline.watershed.hanging`."""
        from heartcase.pipeline.watershed.hanging import hanging_tree

        return hanging_tree(self)


def build_basin_tree(
    height: Float32, cost: UInt16 | None = None, axis_cost: tuple[int, int, int] = (1, 1, 1)
) -> BasinTree:
    """Find the basins of a landscape and join them.

    Parameters
    ----------
    height
        Finite float32 >= 0, shape [z, y, x]: the gradient magnitude.
    cost, axis_cost
        As in :class:`BasinTree`: they say how a flat minimum is divided, and change nothing else.

    Raises
    ------
    StageError
        A height is negative or not finite, or there are more than 2^29 voxels.
    """
    height = np.ascontiguousarray(height, np.float32)
    if height.size > MOST_VOXELS:
        raise StageError(
            f"the scan has {height.size:,} voxels, more than {MOST_VOXELS:,}: cut a region of interest out",
            place="segment",
        )
    if not _is_ordered_by_bits(height):
        # a negative zero would sort below everything; adding zero makes it positive
        height = height + np.float32(0.0)
    if not height.size or not _is_ordered_by_bits(height):
        raise StageError("the gradient is negative or not a number somewhere: check the scan", place="segment")
    direction = steepest_descent(height)
    basin, root = basins_of(direction)
    key, lower = joining_faces(height, basin, root)
    return BasinTree(height, direction, basin, root, key, lower, cost, axis_cost)


def restored_tree(
    height: Float32,
    direction: UInt8,
    key: Int64,
    cost: UInt16 | None = None,
    axis_cost: tuple[int, int, int] = (1, 1, 1),
) -> BasinTree | None:
    """A tree from what :mod:`heartcase.pipeline.watershed.tree_cache` keeps; None where its parts do not agree."""
    basin, root = basins_of(direction)
    if len(root) != len(key) + 1:
        return None
    lower = np.empty(len(key), np.int32)
    _find_lower_ends(key, height, side_offsets(height.shape), lower)
    return BasinTree(height, direction, basin, root, key, lower, cost, axis_cost)


def _is_ordered_by_bits(height: Float32) -> bool:
    """Whether the heights' bits sort as they do: none is negative, a negative zero, infinite or NaN."""
    bits = height.view(np.int32)
    return bool(bits.min(initial=0) >= 0 and bits.max(initial=0) < INFINITE)


def joining_faces(height: Float32, basin: Int32, root: Int64) -> tuple[Int64, Int32]:
    """The faces of the minimum spanning tree between basins.

    Parameters
    ----------
    height, basin, root
        As in :class:`BasinTree`.

    Returns
    -------
    key
        int64, shape (basins - 1,), ascending.
    lower
        Flat index of each face's lower voxel, int32.
    """
    tree = np.empty(len(root) - 1, np.int64)
    if not len(tree):
        return tree, np.empty(0, np.int32)
    flat, offsets, chunks = basin.ravel(), side_offsets(height.shape), row_chunks(height.shape)
    start = chunks * 3 * height.shape[2]
    # as large as it could have to be; pages that are never written take no memory
    key, pair = np.empty(int(start[-1]) + 1, np.int64), np.empty(int(start[-1]) + 1, np.int64)
    pair[-1] = NO_PAIR
    best = np.full((len(chunks) - 1, len(root)), NO_KEY, np.int64)
    stop = np.empty(len(chunks) - 1, np.int64)
    ranks = neighbour_ranks(height).reshape(-1)
    _find_candidates(height.view(np.int32), basin, ranks, chunks, offsets, start, stop, key, pair, best)
    component = np.arange(len(root), dtype=np.int32)
    found, count = 0, len(root)
    while count > 1:
        lowest, parent = np.empty(count, np.int64), np.empty(count, np.int32)
        _find_lowest_faces(best, flat, ranks, offsets, component, lowest, parent)
        found, mapping, count = _merge(lowest, parent, tree, found)
        component = mapping[component]
        best = np.full((len(chunks) - 1, count), NO_KEY, np.int64)
        _contract(start, stop, key, pair, mapping, best)
    tree.sort()
    lower = np.empty(len(tree), np.int32)
    _find_lower_by_rank(tree, ranks, offsets, lower)
    return tree, lower


@copied
def _find_in_rows(bits, basin, ranks, low, high, ny, nx, last, offsets, at, key, pair):
    """Faces between basins in the rows ``low`` to ``high`` - 1, all but a few of those that are not the lowest.

    Most of the faces between two basins follow closely on each other, so a small table of where the faces of a pair
    were noted last is enough to note one instead of five. Nothing here branches on the data: it cannot be predicted.
    """
    lower = np.empty(3 * nx, np.int32)
    side = np.empty(3 * nx, np.int32)
    noted = np.full(NOTED, len(pair) - 1, np.int64)
    for line in range(low, high):
        begin = line * nx
        count = 0
        for u in range(begin, begin + nx - 1):
            lower[count] = u
            side[count] = 4
            count += basin[u] != basin[u + 1]
        if line % ny < ny - 1:
            for u in range(begin, begin + nx):
                lower[count] = u
                side[count] = 5
                count += basin[u] != basin[u + nx]
        if line < last:
            step = nx * ny
            for u in range(begin, begin + nx):
                lower[count] = u
                side[count] = 6
                count += basin[u] != basin[u + step]
        for n in range(count):
            here = np.int64(lower[n])
            there = here + offsets[side[n]]
            up = np.int64(bits[here] > bits[there])
            higher = there - up * (there - here)
            down = np.int64(side[n]) * (2 * up - 1) + 6 - 6 * up
            rank = np.int64(ranks[higher] >> (3 * down)) & 7
            one = (np.int64(max(bits[here], bits[there])) << 32) | (higher << 3) | rank
            at = _note(one, basin[here], basin[there], noted, at, key, pair)
    return at


@kernel(inline="always")
def _note(one, a, b, noted, at, key, pair):
    """Put a face between ``a`` and ``b`` down in the list that ends at ``at``, or in the place of a higher one."""
    both = (np.int64(min(a, b)) << 32) | np.int64(max(a, b))
    slot = (both * HASH >> 40) & (NOTED - 1)
    place = np.int64(noted[slot])
    known = -np.int64(pair[place] == both)
    place = (place & known) | (at & ~known)
    key[place] = min((key[place] & known) | (NO_KEY & ~known), one)
    pair[place] = both
    noted[slot] = place
    return at + 1 + known


@copied
def _lowest_of_each(low, high, key, pair, best):
    for e in range(low, high):
        a = pair[e] >> 32
        b = pair[e] & 0x7FFFFFFF
        best[a] = min(best[a], key[e])
        best[b] = min(best[b], key[e])


@loop_kernel
def _find_candidates(bits, basin, ranks, chunks, offsets, start, stop, key, pair, best):
    nz, ny, nx = bits.shape
    last = (nz - 1) * ny
    flat_bits, flat_basin = bits.ravel(), basin.ravel()
    for c in numba.prange(len(chunks) - 1):
        stop[c] = _find_in_rows(
            flat_bits, flat_basin, ranks, chunks[c], chunks[c + 1], ny, nx, last, offsets, start[c], key, pair
        )
        _lowest_of_each(start[c], stop[c], key, pair, best[c])


@loop_kernel
def _find_lowest_faces(best, basin, ranks, offsets, component, lowest, parent):
    """Find the lowest face of each component, of those that the threads found, and the component beyond it."""
    for c in numba.prange(len(lowest)):
        one = best[0, c]
        for n in range(1, best.shape[0]):
            one = min(one, best[n, c])
        hi = (one >> 3) & (MOST_VOXELS - 1)
        other = component[basin[hi]]
        if other == c:
            other = component[basin[hi + offsets[side_of_rank(ranks[hi], one & 7)]]]
        lowest[c] = one
        parent[c] = other


@kernel
def _merge(lowest, parent, tree, found):
    """Join each component with the one beyond its lowest face; the new number of each component, and how many."""
    count = len(lowest)
    for c in range(count):
        other = parent[c]
        # of two that chose the same face the one with the lower number leads
        if lowest[other] == lowest[c] and c < other:
            parent[c] = c
        else:
            tree[found] = lowest[c]
            found += 1
    mapping = np.empty(count, np.int32)
    fresh = 0
    for c in range(count):
        if parent[c] == c:
            mapping[c] = fresh
            fresh += 1
    for c in range(count):
        top = c
        while parent[top] != top:
            top = parent[top]
        u = c
        while parent[u] != top:
            parent[u], u = top, parent[u]
        mapping[c] = mapping[top]
    return found, mapping, fresh


@copied
def _contract_chunk(low, high, key, pair, mapping):
    noted = np.full(NOTED, len(pair) - 1, np.int64)
    at = low
    for e in range(low, high):
        one = key[e]
        a = mapping[pair[e] >> 32]
        b = mapping[pair[e] & 0x7FFFFFFF]
        if a != b:
            at = _note(one, a, b, noted, at, key, pair)
    return at


@loop_kernel
def _contract(start, stop, key, pair, mapping, best):
    """Number the components anew in the list of faces, drop those inside one, and find each one's lowest."""
    for c in numba.prange(len(stop)):
        stop[c] = _contract_chunk(start[c], stop[c], key, pair, mapping)
        _lowest_of_each(start[c], stop[c], key, pair, best[c])


@loop_kernel
def _find_lower_by_rank(key, ranks, offsets, lower):
    """Find the lower voxel of each face."""
    for e in numba.prange(len(key)):
        v = (key[e] >> 3) & (MOST_VOXELS - 1)
        lower[e] = v + offsets[side_of_rank(ranks[v], key[e] & 7)]


@loop_kernel
def _find_lower_ends(key, height, offsets, lower):
    """The same where the ranks are not at hand."""
    for e in numba.prange(len(key)):
        v = (key[e] >> 3) & (MOST_VOXELS - 1)
        lower[e] = v + offsets[side_of_rank(ranks_at(height, v), key[e] & 7)]


@kernel
def _neighbours(count, first, second):
    start = np.zeros(count + 1, np.int64)
    for e in range(len(first)):
        start[first[e] + 1] += 1
        start[second[e] + 1] += 1
    for b in range(count):
        start[b + 1] += start[b]
    at = start[:-1].copy()
    faces = np.empty(2 * len(first), np.int32)
    for e in range(len(first)):
        for b in (first[e], second[e]):
            faces[at[b]] = e
            at[b] += 1
    return start, faces


@kernel
def _voxel_lists(basin, count):
    start = np.zeros(count + 1, np.int64)
    for v in range(len(basin)):
        start[basin[v] + 1] += 1
    for b in range(count):
        start[b + 1] += start[b]
    at = start[:-1].copy()
    voxels = np.empty(len(basin), np.int32)
    for v in range(len(basin)):
        voxels[at[basin[v]]] = v
        at[basin[v]] += 1
    return start, voxels
