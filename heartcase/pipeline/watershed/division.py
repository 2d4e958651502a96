"""Division of flat minima that several labels mark: each voxel goes to the marked one at the least distance.

The *distance* of a marked voxel is 1. That of every other one is the least over its neighbours of the neighbour's own
and the cost of the step: the voxel's cost times that of the axis, both of the tree. Its label is that of the neighbour
that gives this distance, of several the one with the lowest index. These are shortest ways, as Dijkstra finds them
(Numerische Mathematik 1, 1959), in buckets by their lengths (Dial, Communications of the ACM 12, 1969). What a stroke
changes is found from it outwards, in the order of the distances, and all else in the flat stays (Ramalingam and Reps,
Journal of Algorithms 21, 1996): a stroke in a million flat voxels costs what it changes.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.marks import CONTESTED
from heartcase.schemas.arrays import Int16, Int32, Int64, UInt8

if TYPE_CHECKING:
    from heartcase.pipeline.watershed.tree import BasinTree

__all__ = ["Division", "divided_flats", "redivided"]

FAR = 2**31 - 1
"""Distance of a voxel that no marked one reaches yet."""
FARTHEST = 2**31 - 2**20
"""A flat with larger distances is divided, and not mended but divided anew."""
NOWHERE = np.int64(2**62)
"""Longer than any way."""
INDEX_BITS = 29
"""Bits of a voxel's index in what waits for its turn, a distance and an index in one number."""


@dataclass
class Division:
    """How the contested flat minima are divided."""

    distance: Int32
    """Distance of each voxel of the flats in ``counts``, int32, shape (voxels,); 0 outside of all divided flats."""
    counts: dict[int, Int64] = field(default_factory=dict)
    """Number of marked voxels of each label, int64, shape (256,), by the number of the flat."""

    def copy(self) -> Division:
        """The same with arrays of its own."""
        return Division(self.distance.copy(), dict(self.counts))


def divided_flats(tree: BasinTree, marks: UInt8, flat_label: Int16, voxels: Int64) -> Division | None:
    """Divide all contested flat minima, in place; None where there is none.

    Parameters
    ----------
    tree
        The tree of the landscape.
    marks
        Label of each painted voxel; 255 elsewhere. It is painted on.
    flat_label
        Label that marks each flat minimum: -1 none, -2 several.
    voxels
        Flat indices of the marked voxels, ascending.
    """
    contested = np.flatnonzero(flat_label == CONTESTED)
    if not len(contested):
        return None
    # nobody touches what is in no contested flat, so it costs no memory
    division = Division(np.zeros(marks.size, np.int32))
    number = tree.flat_of(voxels)
    for one in contested.tolist():
        _divide(tree, one, voxels[number == one], marks.reshape(-1), division)
    return division


def redivided(
    tree: BasinTree,
    painted: UInt8,
    marks: UInt8,
    flat_label: Int16,
    strokes: Sequence[tuple[int, Int64]],
    division: Division,
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
        Label, 255 for none, and flat indices of the voxels that have it now, each voxel once.
    division
        How the flat minima are divided; made to fit the strokes.
    """
    marked, seeded = marks.reshape(-1), painted.reshape(-1)
    voxels = np.concatenate([one for _, one in strokes])
    number = tree.flat_of(voxels)
    changed, values = [voxels[number < 0]], [seeded[voxels[number < 0]]]
    for one in np.unique(number[number >= 0]).tolist():
        inside = np.sort(voxels[number == one])
        if _stays_whole(one, seeded[inside], flat_label):
            changed.append(inside)
            values.append(seeded[inside])
            continue
        found = _mended(tree, one, inside, seeded, marked, division) or _anew(
            tree, one, seeded, marked, flat_label, division
        )
        changed.append(found[0])
        values.append(found[1])
    everywhere, value = np.concatenate(changed), np.concatenate(values)
    return [(one, everywhere[value == one]) for one in sorted({*value.tolist()}, reverse=True)]


def _stays_whole(number: int, painted: UInt8, flat_label: Int16) -> bool:
    """Whether no more than one label marks a flat, with voxels in it painted so, or erased (255); notes the label."""
    labels = np.unique(painted[painted != UNMARKED])
    if flat_label[number] == CONTESTED or len(labels) > 1:
        return False
    if flat_label[number] == -1 and len(labels):
        flat_label[number] = labels[0]
    return not len(labels) or bool(labels[0] == flat_label[number])


def _mended(
    tree: BasinTree, number: int, voxels: Int64, painted: UInt8, marks: UInt8, division: Division
) -> tuple[Int64, UInt8] | None:
    """Voxels of a flat whose marks change, and their labels; None where it has to be divided anew."""
    counts = division.counts.pop(number, None)
    if counts is None:
        return None
    was_painted = voxels[division.distance[voxels] == 1]
    now = painted[voxels]
    counts = counts - np.bincount(marks[was_painted], minlength=256)
    counts += np.bincount(now[now != UNMARKED], minlength=256)
    if np.count_nonzero(counts) < 2:
        return None
    changed, values, is_known = _mend_flat(
        tree.height.shape, *tree.costs, voxels, painted, marks, division.distance, FARTHEST
    )
    if not is_known:
        return None
    division.counts[number] = counts
    return changed, values


def _anew(
    tree: BasinTree, number: int, painted: UInt8, marks: UInt8, flat_label: Int16, division: Division
) -> tuple[Int64, UInt8]:
    """The same, found by dividing all of it."""
    bits = tree.height.view(np.int32).ravel()
    inside = _voxels_of_flat(np.flatnonzero(tree.flat == number), *tree.voxels, bits, tree.root)
    before = marks[inside]
    marks[inside] = painted[inside]
    seeds = np.sort(inside[painted[inside] != UNMARKED])
    labels = np.unique(painted[seeds])
    flat_label[number] = CONTESTED if len(labels) > 1 else [-1, *labels.tolist()][-1]
    division.distance[inside] = 0
    if len(labels) > 1:
        _divide(tree, number, seeds, marks, division)
    after = marks[inside]
    marks[inside] = before
    return inside[after != before], after[after != before]


def _divide(tree: BasinTree, number: int, seeds: Int64, marks: UInt8, division: Division) -> None:
    """Divide one flat among its marked voxels, ascending flat indices; it has no other marks, and no distances."""
    bits, counts = tree.height.view(np.int32).ravel(), np.bincount(marks[seeds], minlength=256)
    if _divide_flat(bits, tree.height.shape, *tree.costs, tree.largest_cost, seeds, marks, division.distance, FARTHEST):
        division.counts[number] = counts


@copied
def _near(v, per_slice, per_row, shape, found):
    """Neighbours of a voxel in the volume, by ascending index, into ``found[0]``, and their axes into ``found[1]``.

    Returns how many there are.
    """
    nz, ny, nx = shape
    # exact for any index below 2^29, and much quicker than a division of integers
    k = np.int64((v + 0.5) * per_slice)
    rest = v - k * (nx * ny)
    j = np.int64((rest + 0.5) * per_row)
    i = rest - j * nx
    count = 0
    if k > 0:
        found[0, count], found[1, count] = v - nx * ny, 0
        count += 1
    if j > 0:
        found[0, count], found[1, count] = v - nx, 1
        count += 1
    if i > 0:
        found[0, count], found[1, count] = v - 1, 2
        count += 1
    if i < nx - 1:
        found[0, count], found[1, count] = v + 1, 2
        count += 1
    if j < ny - 1:
        found[0, count], found[1, count] = v + nx, 1
        count += 1
    if k < nz - 1:
        found[0, count], found[1, count] = v + nx * ny, 0
        count += 1
    return count


@copied
def _later(v, at, newest, waiting, before, entries):
    """Let a voxel wait in a bucket; the two lists of what waits, longer where they were full.

    ``entries`` holds the entry that is free again, or -1, how many were used, and how many wait.
    """
    entry = entries[0]
    if entry >= 0:
        entries[0] = before[entry]
    else:
        entry = entries[1]
        entries[1] += 1
        if entry == len(waiting):
            waiting = np.append(waiting, np.empty_like(waiting))
            before = np.append(before, np.empty_like(before))
    waiting[entry], before[entry] = v, newest[at]
    newest[at] = entry
    entries[2] += 1
    return waiting, before


@kernel
def _divide_flat(bits, shape, cost, axis_cost, largest_cost, voxels, marks, distance, farthest):
    """Divide a flat minimum among its marked voxels, in place; whether the distances of all its voxels could be noted.

    Parameters
    ----------
    bits, cost, marks, distance
        Heights as bits, costs, labels and distances of all voxels, one-dimensional; the last two are written to. In
        the flat no distance but 0 may stand.
    shape
        Of the volume: (z, y, x).
    axis_cost
        Cost of a step along z, y and x.
    largest_cost
        Cost of the longest step there is.
    voxels
        Flat indices of the marked voxels of the flat, ascending.
    farthest
        No larger distance is noted.
    """
    per_slice, per_row = 1.0 / (shape[1] * shape[2]), 1.0 / shape[2]
    level = bits[voxels[0]]
    near = np.empty((2, 6), np.int64)
    bucket_count = largest_cost + 1
    newest = np.full(bucket_count, -1, np.int64)
    waiting = np.empty(4 * len(voxels) + 4096, np.int64)
    before = np.empty(len(waiting), np.int64)
    entries = np.array([-1, 0, 0])
    for v in voxels:
        distance[v] = 1
        for n in range(_near(v, per_slice, per_row, shape, near)):
            u = near[0, n]
            # a neighbour as high is of the same flat
            if bits[u] == level and marks[u] == UNMARKED:
                there = 1 + cost[u] * axis_cost[near[1, n]]
                if distance[u] == 0 or there < distance[u]:
                    distance[u] = there
                    waiting, before = _later(u, there % bucket_count, newest, waiting, before, entries)
    now = 1
    while entries[2] > 0:
        now += 1
        at = now % bucket_count
        while newest[at] >= 0:
            entry = newest[at]
            v = waiting[entry]
            newest[at], before[entry] = before[entry], entries[0]
            entries[0] = entry
            entries[2] -= 1
            if marks[v] != UNMARKED:
                continue
            near_count = _near(v, per_slice, per_row, shape, near)
            distance[v] = min(now, farthest)
            for n in range(near_count):
                u = near[0, n]
                if bits[u] != level or marks[u] == UNMARKED:
                    continue
                # of neighbours that lead here as quickly, the one with the lowest index gives its label
                if distance[u] + cost[v] * axis_cost[near[1, n]] == now or distance[u] == farthest:
                    marks[v] = marks[u]
                    break
            for n in range(near_count):
                u = near[0, n]
                if bits[u] != level or marks[u] != UNMARKED:
                    continue
                there = now + cost[u] * axis_cost[near[1, n]]
                if distance[u] == 0 or there < distance[u] or there > farthest:
                    distance[u] = min(there, farthest)
                    waiting, before = _later(u, there % bucket_count, newest, waiting, before, entries)
    return now < farthest


@kernel
def _mend_flat(shape, cost, axis_cost, voxels, painted, marks, distance, farthest):
    """Voxels of a divided flat whose labels change, the labels, and whether the distances are those of now.

    No two flat minima lie side by side: so a neighbour with a distance is of the same one.

    Parameters
    ----------
    shape
        Of the volume: (z, y, x).
    cost
        Of all voxels, one-dimensional.
    axis_cost
        Cost of a step along z, y and x.
    voxels
        Flat indices of the voxels that were painted or erased.
    painted
        Labels of the painted voxels as they are now; 255 elsewhere.
    marks, distance
        Labels and distances from before; the distances become those of now, the labels stay.
    farthest
        No larger distance is noted.
    """
    per_slice, per_row = 1.0 / (shape[1] * shape[2]), 1.0 / shape[2]
    near, beyond = np.empty((2, 6), np.int64), np.empty((2, 6), np.int64)
    # what may get another label: distances and voxels, the nearest first
    waiting = [np.int64(0) for _ in range(0)]
    shore = [np.int64(0) for _ in range(0)]
    for v in voxels:
        if painted[v] != UNMARKED:
            heapq.heappush(waiting, (np.int64(1) << INDEX_BITS) | v)
        elif distance[v] == 1:
            distance[v] = FAR
            heapq.heappush(shore, (np.int64(1) << INDEX_BITS) | v)
    # those that nothing leads to any more, outwards
    gone = [np.int64(0) for _ in range(0)]
    kept = [np.int64(0) for _ in range(0)]
    while len(shore) > 0:
        first = heapq.heappop(shore)
        was, v = first >> INDEX_BITS, first & ((np.int64(1) << INDEX_BITS) - 1)
        gone.append(v)
        for n in range(_near(v, per_slice, per_row, shape, near)):
            u = near[0, n]
            # neither a voxel of no divided flat nor a painted one
            if distance[u] <= 1 or distance[u] != was + cost[u] * axis_cost[near[1, n]]:
                continue
            is_led_to = False
            for m in range(_near(u, per_slice, per_row, shape, beyond)):
                w = beyond[0, m]
                is_led_to = is_led_to or (0 < distance[w] == distance[u] - cost[u] * axis_cost[beyond[1, m]])
            if is_led_to:
                kept.append(u)
            else:
                heapq.heappush(shore, (np.int64(distance[u]) << INDEX_BITS) | u)
                distance[u] = FAR
    for v in kept:
        # others went after it
        if distance[v] != FAR:
            heapq.heappush(waiting, (np.int64(distance[v]) << INDEX_BITS) | v)
    for v in gone:
        nearest = NOWHERE
        for n in range(_near(v, per_slice, per_row, shape, near)):
            there = distance[near[0, n]]
            if 0 < there < FAR:
                nearest = min(nearest, there + cost[v] * axis_cost[near[1, n]])
        if nearest < NOWHERE:
            heapq.heappush(waiting, (nearest << INDEX_BITS) | v)
    changed = [np.int64(0) for _ in range(0)]
    before = [np.uint8(0) for _ in range(0)]
    is_known = True
    while len(waiting) > 0:
        first = heapq.heappop(waiting)
        now, v = first >> INDEX_BITS, first & ((np.int64(1) << INDEX_BITS) - 1)
        if now >= farthest:
            is_known = False
            break
        # sooner than now: as it was, or as it waits for its turn
        if -now < distance[v] < now:
            continue
        is_new = distance[v] != now
        distance[v] = now
        near_count = _near(v, per_slice, per_row, shape, near)
        label = painted[v]
        if now > 1:
            for n in range(near_count):
                u = near[0, n]
                if 0 < distance[u] == now - cost[v] * axis_cost[near[1, n]]:
                    label = marks[u]
                    break
        is_other = label != marks[v]
        if is_other:
            changed.append(v)
            before.append(marks[v])
            marks[v] = label
        if not (is_other or is_new):
            continue
        for n in range(near_count):
            u = near[0, n]
            there = now + cost[u] * axis_cost[near[1, n]]
            known = np.int64(distance[u])
            # a distance that is foretold is negative, so that the voxel waits for its turn once
            if there < abs(known) or known == FAR:
                distance[u] = -min(there, farthest)
                heapq.heappush(waiting, (there << INDEX_BITS) | u)
            elif there == known:
                heapq.heappush(waiting, (there << INDEX_BITS) | u)
    found = np.array(changed)
    values = marks[found]
    for n in range(len(found)):
        marks[found[n]] = before[n]
    return found, values, is_known


@kernel
def _voxels_of_flat(basins, first_voxel, voxel_list, bits, root):
    """Flat indices of the voxels of a flat minimum: those at the bottom of its basins.

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
    return found[:count]
