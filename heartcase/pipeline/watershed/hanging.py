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
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.kernels.union_find import root_of
from heartcase.pipeline.watershed.marks import mark_below, own_key, reach
from heartcase.pipeline.watershed.tree import NO_KEY, BasinTree
from heartcase.schemas.arrays import Int32, Int64, UInt8

__all__ = ["HangingTree", "PartedForest", "hanging_tree", "solve_parted"]


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


@dataclass(frozen=True)
class PartedForest:
    """A forest as far as its labels are known: levels take one more pass."""

    hanging: HangingTree
    """The tree that it is of."""
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
        _fill(_chunks(len(foot_label)), self.hanging.place, self.label[self.group], foot_label)

    def fill_levels(self, foot_level: Int64) -> None:
        """Write the level of each basin's foot."""
        hanging = self.hanging
        level = _levels(self.parted, self.level, hanging.above, hanging.key)
        _fill(_chunks(len(foot_level)), hanging.place, level, foot_level)


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
    return HangingTree(place, end, above, key, by_face, place[absorbed], by_larger)


def solve_parted(tree: BasinTree, landscape: tuple[Any, ...], marks: UInt8, lowest_mark: Int64) -> PartedForest:
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
    """
    marked, hanging = np.flatnonzero(lowest_mark >= 0), tree.hanging
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
    return PartedForest(hanging, group, parted, label, level)


def _chunks(count: int) -> Int64:
    return np.linspace(0, count, CHUNKS + 1).astype(np.int64)


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


@kernel
def _groups(parted, end):
    """By place: the number of the last parted place before it that it hangs on."""
    group = np.empty(len(end), np.int32)
    # parted places that hold others, the innermost last
    stack = np.empty(len(parted), np.int32)
    depth = -1
    for n in range(len(parted)):
        at = parted[n]
        until = parted[n + 1] if n + 1 < len(parted) else len(end)
        depth += 1
        stack[depth] = n
        while at < until:
            while end[parted[stack[depth]]] <= at:
                depth -= 1
            stop = min(until, end[parted[stack[depth]]])
            group[at:stop] = stack[depth]
            at = stop
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
def _levels(parted, parted_level, above, key):
    """By place: the highest face on the way to a marked voxel."""
    level = np.empty(len(above), np.int64)
    for n in range(len(parted)):
        level[parted[n]] = parted_level[n]
        until = parted[n + 1] if n + 1 < len(parted) else len(above)
        for at in range(parted[n] + 1, until):
            level[at] = max(key[at], level[above[at]])
    return level


@kernel(parallel=True)
def _fill(chunks, place, by_place, by_basin):
    for c in numba.prange(len(chunks) - 1):
        for b in range(chunks[c], chunks[c + 1]):
            by_basin[b] = by_place[place[b]]
