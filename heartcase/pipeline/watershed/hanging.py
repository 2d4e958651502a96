"""Solving a forest anew where few basins are marked: in time of what is marked, and one pass over the basins.

Without markers the faces join the basins one after the other. At each face the smaller side is *absorbed*: while none
of its basins is marked, it has the label of the basin at the face's other end. It had none before this face, and the
other side either gives it its own label here, or gets it together with it later. So every basin *hangs* on one other:
that at the far end of the face by which the side that it is the head of was absorbed. These links form a tree, which
does not depend on the markers.

Markers *part* a basin from what it hangs on where the side that it heads holds a marked basin, or where the face ends
above a marked voxel. A marked basin lies in at most log2(basins) absorbed sides, as each is at least twice as large as
the one before. So few basins are parted, and Kruskal's algorithm has to look at their faces alone; all others have the
label of the parted basin that they hang on, directly or through others, and reach it by the highest face on this way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.kernels.union_find import root_of
from heartcase.pipeline.watershed.marks import mark_below, own_key, reach
from heartcase.pipeline.watershed.tree import NO_KEY, BasinTree
from heartcase.schemas.arrays import Int32, Int64, UInt8

__all__ = ["Filling", "HangingTree", "PartedForest", "hanging_tree", "solve_parted"]


CHUNKS = 16


@dataclass(frozen=True)
class HangingTree:
    """What each basin hangs on. Made by :func:`hanging_tree`.

    Places are numbers of basins in an order in which each stands before all that hang on it, and these directly behind.
    """

    place: Int32
    """Place of each basin, int32."""
    end: Int32
    """By place: behind the last place of those that hang on it, directly or through others."""
    above: Int32
    """By place: the place of what it hangs on; -1 for the first."""
    key: Int64
    """By place: key of the face by which it hangs; 0 for the first."""
    face: Int32
    """By place: number of that face; -1 for the first."""
    absorbed: Int32
    """Place of the head of the side that each joining face absorbs."""
    larger: Int32
    """By place: the place of the head of the side that absorbed it; -1 for the first."""
    voxels_before: Int64
    """By place: number of voxels of the basins at all places before it, int64; with one more entry, for all."""


@dataclass(frozen=True)
class PartedForest:
    """A forest of few marked basins: what each basin has follows from the parted one that it hangs on."""

    hanging: HangingTree
    """The tree that it is of."""
    marked: Int64
    """The marked basins, ascending."""
    group: Int32
    """By place: number of the parted basin that it hangs on."""
    parted: Int32
    """Places of the parted basins, ascending."""
    label: UInt8
    """Label of the feet of each of them."""
    level: Int64
    """Level of the foot of each of them."""

    def fill_labels(self, foot_label: UInt8) -> None:
        """Write the label of each basin's foot."""
        # one byte a place stays in a processor's cache
        _fill(_chunks(0, len(foot_label)), self.hanging.place, self.label[self.group], foot_label)

    def label_counts(self, tree: BasinTree, landscape: tuple[Any, ...], marks: UInt8) -> Int64:
        """Number of voxels of each label, int64, shape (256,)."""
        hanging = self.hanging
        count: Int64 = _count(self.parted, hanging.end, self.label, hanging.voxels_before)
        feet = self.label[self.group[hanging.place[self.marked]]]
        _count_marked(self.marked, feet, tree.voxels, landscape, marks, count)
        return count


class Filling:
    """Labels and levels of all feet of a parted forest, written out piece by piece.

    Parameters
    ----------
    solved
        The forest.
    """

    def __init__(self, solved: PartedForest) -> None:
        count = len(solved.group)
        self.foot_label: UInt8 = np.empty(count, np.uint8)
        """Label of each basin's foot."""
        self.foot_level: Int64 = np.empty(count, np.int64)
        """Level of each basin's foot."""
        self._solved = solved
        self._by_place: Int64 = np.empty(count, np.int64)
        self._at = 0

    def go_on(self, most: int) -> bool:
        """Work out so many more feet, at most; whether all of them are done."""
        solved, count = self._solved, len(self.foot_label)
        hanging = solved.hanging
        # first the levels of all places, in their order, and then both of all basins
        first = self._at % count
        stop = min(first + most, count)
        if self._at < count:
            _levels(solved.parted, solved.level, hanging.above, hanging.key, self._by_place, first, stop)
        else:
            chunks = _chunks(first, stop)
            _fill(chunks, hanging.place, self._by_place, self.foot_level)
            _fill_labels(chunks, hanging.place, solved.group, solved.label, self.foot_label)
        self._at += stop - first
        return self._at == 2 * count


def hanging_tree(tree: BasinTree) -> HangingTree:
    """Find what each basin hangs on.

    Parameters
    ----------
    tree
        The tree of a landscape.
    """
    first, second = tree.basins
    hangs_on, face, absorbed, larger = _absorb(first, second, tree.basin_count)
    place, end, order = _places(hangs_on)
    at_first = hangs_on[order] < 0
    above = place[hangs_on[order]]
    by_face = face[order]
    key = np.zeros(tree.basin_count, np.int64)
    key[~at_first] = tree.key[by_face[~at_first]]
    above[at_first] = -1
    by_larger = place[larger[order]]
    by_larger[at_first] = -1
    first_voxel, _ = tree.voxels
    before = np.zeros(tree.basin_count + 1, np.int64)
    np.cumsum(np.diff(first_voxel)[order], out=before[1:])
    return HangingTree(place, end, above, key, by_face, place[absorbed], by_larger, before)


def solve_parted(
    tree: BasinTree, landscape: tuple[Any, ...], marks: UInt8, lowest_mark: Int64, marked: Int64
) -> PartedForest:
    """Label all feet.

    Parameters
    ----------
    tree
        The tree of the landscape.
    landscape
        The bits of its heights, directions, basins and offsets of sides, all flat.
    marks
        Label of each marked voxel, with contested flat minima divided; 255 elsewhere; flat.
    lowest_mark
        Flat index of each basin's lowest marked voxel; -1 without any.
    marked
        The basins that have one, ascending, int64.
    """
    hanging = tree.hanging
    start, faces = tree.neighbours
    higher, lower = tree.ends
    parted = _parted(
        marked, landscape, (start, faces, higher, lower), hanging.absorbed, hanging.larger, hanging.place, marks
    )
    parted.sort()
    group = _groups(parted, hanging.end)
    # the first place hangs by no face
    used = np.sort(hanging.face[parted[1:]])
    ends = (tree.key[used], higher[used], lower[used])
    label, level = _solve(marked, ends, landscape, hanging.place, group, len(parted), marks, lowest_mark)
    return PartedForest(hanging, marked, group, parted, label, level)


def _chunks(first: int, stop: int) -> Int64:
    return np.linspace(first, stop, CHUNKS + 1).astype(np.int64)


@kernel
def _absorb(first, second, count):
    """What each basin hangs on, by which face, and the head of the larger side; for each face whom it absorbs."""
    parent = np.arange(count).astype(np.int32)
    size = np.ones(count, np.int32)
    hangs_on = np.full(count, -1, np.int32)
    face = np.full(count, -1, np.int32)
    larger = np.full(count, -1, np.int32)
    absorbed = np.empty(len(first), np.int32)
    for e in range(len(first)):
        a = root_of(parent, first[e])
        b = root_of(parent, second[e])
        other = second[e]
        if size[a] > size[b]:
            a, b = b, a
            other = first[e]
        parent[a] = b
        size[b] += size[a]
        hangs_on[a] = other
        face[a] = e
        larger[a] = b
        absorbed[e] = a
    return hangs_on, face, absorbed, larger


@kernel
def _places(hangs_on):
    """Place of each basin, the end of what hangs on each place, and the basin of each place."""
    count = len(hangs_on)
    start = np.zeros(count + 2, np.int32)
    for b in range(count):
        if hangs_on[b] >= 0:
            start[hangs_on[b] + 2] += 1
    start = np.cumsum(start).astype(np.int32)
    below = np.empty(count, np.int32)
    head = np.int32(0)
    for b in range(count):
        if hangs_on[b] >= 0:
            below[start[hangs_on[b] + 1]] = b
            start[hangs_on[b] + 1] += 1
        else:
            head = np.int32(b)
    place = np.empty(count, np.int32)
    end = np.empty(count, np.int32)
    order = np.empty(count, np.int32)
    path = np.empty(count, np.int32)
    following = start[:-1].copy()
    depth = 0
    path[0] = head
    place[head] = 0
    order[0] = head
    at = 1
    while depth >= 0:
        b = path[depth]
        if following[b] < start[b + 1]:
            one = below[following[b]]
            following[b] += 1
            place[one] = at
            order[at] = one
            at += 1
            depth += 1
            path[depth] = one
        else:
            end[place[b]] = at
            depth -= 1
    return place, end, order


@kernel
def _parted(marked, landscape, graph, absorbed, larger, place, marks):
    """Places of the basins that markers part from what they hang on, and the first place."""
    _, direction, basin, offsets = landscape
    start, faces, higher, lower = graph
    is_parted = np.zeros(len(place), np.bool_)
    is_parted[0] = True
    found = [np.int32(0)]
    for b in marked:
        at = place[b]
        # where one side is known to hold a mark, all larger ones are
        while at > 0 and not is_parted[at]:
            is_parted[at] = True
            found.append(np.int32(at))
            at = larger[at]
    for b in marked:
        for n in range(start[b], start[b + 1]):
            here = higher[faces[n]]
            if basin[here] != b:
                here = lower[faces[n]]
            one = absorbed[faces[n]]
            if not is_parted[one] and mark_below(here, direction, offsets, marks) != UNMARKED:
                is_parted[one] = True
                found.append(np.int32(one))
    return np.array(found)


@kernel(cached=False)
def _stretches(parted, end):
    """Stretches of places that hang on the same parted place: where each begins, and the number of that place.

    The last one ends with the places. There are no more than two for each that is parted.
    """
    first, number = np.empty(2 * len(parted), np.int64), np.empty(2 * len(parted), np.int32)
    # parted places that hold others, the innermost last
    stack = np.empty(len(parted), np.int32)
    depth = -1
    count = 0
    for n in range(len(parted)):
        at = parted[n]
        until = parted[n + 1] if n + 1 < len(parted) else len(end)
        depth += 1
        stack[depth] = n
        while at < until:
            while end[parted[stack[depth]]] <= at:
                depth -= 1
            first[count], number[count] = at, stack[depth]
            count += 1
            at = min(until, end[parted[stack[depth]]])
    return first[:count], number[:count]


@kernel
def _groups(parted, end):
    """By place: the number of the last parted place before it that it hangs on."""
    group = np.empty(len(end), np.int32)
    first, number = _stretches(parted, end)
    for n in range(len(first)):
        group[first[n] : first[n + 1] if n + 1 < len(first) else len(end)] = number[n]
    return group


@kernel
def _solve(marked, ends, landscape, place, group, count, marks, lowest_mark):
    """Kruskal's algorithm over the faces of parted basins and those under the lowest marked voxels, in their order."""
    bits, direction, basin, offsets = landscape
    key, higher, lower = ends
    label = np.full(count, UNMARKED, np.uint8)
    level = np.full(count, NO_KEY, np.int64)
    following = np.arange(count).astype(np.int32)
    own = np.empty(len(marked), np.int64)
    for n in range(len(marked)):
        own[n] = own_key(lowest_mark[marked[n]], bits, direction)
    order = np.argsort(own)
    at = 0
    for e in range(len(key) + 1):
        one = key[e] if e < len(key) else NO_KEY
        while at < len(order) and own[order[at]] < one:
            b = marked[order[at]]
            if label[group[place[b]]] == UNMARKED:
                reach(group[place[b]], own[order[at]], marks[lowest_mark[b]], following, label, level)
            at += 1
        if e == len(key):
            break
        a, b = basin[higher[e]], basin[lower[e]]
        first, second = group[place[a]], group[place[b]]
        here = _given(higher[e], a, label[first], direction, offsets, marks, lowest_mark)
        there = _given(lower[e], b, label[second], direction, offsets, marks, lowest_mark)
        if here[0] == UNMARKED and there[0] == UNMARKED:
            following[first], following[second] = following[second], following[first]
        elif here[0] == UNMARKED and here[1]:
            reach(first, one, there[0], following, label, level)
        elif there[0] == UNMARKED and there[1]:
            reach(second, one, here[0], following, label, level)
    return label, level


@copied
def _given(v, b, label, direction, offsets, marks, lowest_mark):
    """The label at a face's end in a basin whose foot has one, or none; and whether it is the foot's."""
    if lowest_mark[b] >= 0:
        mark = mark_below(v, direction, offsets, marks)
        if mark != UNMARKED:
            return mark, False
    return label, True


@kernel
def _levels(parted, parted_level, above, key, level, first, stop):
    """By place, for some of them: the highest face on the way to a marked voxel. Those before are there already."""
    n = np.searchsorted(parted, first)
    for at in range(first, stop):
        if n < len(parted) and parted[n] == at:
            level[at] = parted_level[n]
            n += 1
        else:
            level[at] = max(key[at], level[above[at]])


@kernel
def _count(parted, end, label, voxels_before):
    """How many voxels the basins of each label have, int64, shape (256,), as if none of them were marked."""
    count = np.zeros(256, np.int64)
    first, number = _stretches(parted, end)
    for n in range(len(first)):
        stop = first[n + 1] if n + 1 < len(first) else len(end)
        count[label[number[n]]] += voxels_before[stop] - voxels_before[first[n]]
    return count


@kernel
def _count_marked(marked, feet, voxel_lists, landscape, marks, count):
    """Count the voxels of marked basins, which were counted as those of their feet, as they are."""
    _, direction, _, offsets = landscape
    first_voxel, voxel_list = voxel_lists
    for m in range(len(marked)):
        b = marked[m]
        count[feet[m]] -= first_voxel[b + 1] - first_voxel[b]
        for n in range(first_voxel[b], first_voxel[b + 1]):
            mark = mark_below(np.int64(voxel_list[n]), direction, offsets, marks)
            count[mark if mark != UNMARKED else feet[m]] += 1


@loop_kernel
def _fill(chunks, place, by_place, by_basin):
    for c in numba.prange(len(chunks) - 1):
        for b in range(chunks[c], chunks[c + 1]):
            by_basin[b] = by_place[place[b]]


@loop_kernel
def _fill_labels(chunks, place, group, label, by_basin):
    for c in numba.prange(len(chunks) - 1):
        for b in range(chunks[c], chunks[c + 1]):
            by_basin[b] = label[group[place[b]]]
