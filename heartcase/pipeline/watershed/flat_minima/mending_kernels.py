"""Kernels that mend a divided flat minimum some voxels at a time.

What waits for its turn stands in a heap, an int64 array that lasts from one call to the next: first the number of its
entries, then these, the least at 1. An entry is a distance and, in its lowest bits, a voxel's flat index.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.flat_minima.division_kernels import FAR, near_voxels

__all__ = ["feed", "spread", "take_back", "withdraw"]

INDEX_BITS = 29
"""Bits of a voxel's index in an entry, and in what is noted: a distance and an index in one number."""


@copied
def _with_room(heap, count):
    """A heap with room for so many more entries."""
    if heap[0] + count < len(heap):
        return heap
    longer = np.empty(2 * len(heap) + count, np.int64)
    longer[: len(heap)] = heap
    return longer


@copied
def _put(heap, distance, v):
    """Let a voxel wait for its turn in a heap with room for it."""
    entry = (np.int64(distance) << INDEX_BITS) | v
    heap[0] += 1
    at = heap[0]
    while at > 1 and heap[at >> 1] > entry:
        heap[at] = heap[at >> 1]
        at >>= 1
    heap[at] = entry


@copied
def _take(heap):
    """Take the least entry out of a heap: its distance and voxel."""
    first, last = heap[1], heap[heap[0]]
    heap[0] -= 1
    count, at = heap[0], 1
    while 2 * at <= count:
        below = 2 * at
        if below < count and heap[below + 1] < heap[below]:
            below += 1
        if heap[below] >= last:
            break
        heap[at] = heap[below]
        at = below
    heap[at] = last
    return first >> INDEX_BITS, first & ((np.int64(1) << INDEX_BITS) - 1)


@kernel
def feed(shape, voxels, painted, marks, distance, waiting, withdrawn):
    """Let painted voxels wait for their turn, and erased ones be withdrawn.

    A painted voxel with its mark that has painted ones around it alone leads nowhere, and has not to wait.

    Returns the two heaps, and what there was before: voxels and distances in one number, and marks.
    """
    per_slice, per_row = 1.0 / (shape[1] * shape[2]), 1.0 / shape[2]
    near = np.empty((2, 6), np.int64)
    waiting, withdrawn = _with_room(waiting, len(voxels)), _with_room(withdrawn, len(voxels))
    noted = [np.int64(0) for _ in range(0)]
    noted_marks = [np.uint8(0) for _ in range(0)]
    for v in voxels:
        # of a voxel whose distance is foretold that was noted
        if distance[v] > 0:
            noted.append((np.int64(distance[v]) << INDEX_BITS) | v)
            noted_marks.append(marks[v])
        if painted[v] != UNMARKED:
            waits = painted[v] != marks[v]
            for n in range(near_voxels(v, per_slice, per_row, shape, near)):
                waits = waits or (distance[near[0, n]] != 0 and painted[near[0, n]] == UNMARKED)
            if waits:
                distance[v] = -1
                _put(waiting, 1, v)
            else:
                distance[v] = 1
        elif distance[v] == 1:
            distance[v] = FAR
            _put(withdrawn, 1, v)
    return waiting, withdrawn, np.array(noted), np.array(noted_marks)


@kernel
def withdraw(shape, cost, axis_cost, marks, distance, waiting, withdrawn, most):
    """Withdraw so many voxels, outwards, that nothing leads to any more; around them the labels spread later.

    Returns the two heaps, the number of voxels, and what there was before: voxels and distances in one number, and
    marks. No two flat minima lie side by side: so a neighbour with a distance is of the same one.
    """
    per_slice, per_row = 1.0 / (shape[1] * shape[2]), 1.0 / shape[2]
    near, beyond = np.empty((2, 6), np.int64), np.empty((2, 6), np.int64)
    noted = [np.int64(0) for _ in range(0)]
    noted_marks = [np.uint8(0) for _ in range(0)]
    count = 0
    while withdrawn[0] > 0 and count < most:
        waiting, withdrawn = _with_room(waiting, 6), _with_room(withdrawn, 6)
        was, v = _take(withdrawn)
        count += 1
        for n in range(near_voxels(v, per_slice, per_row, shape, near)):
            u = near[0, n]
            known = distance[u]
            # of no divided flat, withdrawn too, or waiting for its turn
            if known <= 0 or known == FAR:
                continue
            is_left = known > 1 and known == was + cost[u] * axis_cost[near[1, n]]
            if is_left:
                for m in range(near_voxels(u, per_slice, per_row, shape, beyond)):
                    there = distance[beyond[0, m]]
                    is_left = is_left and not (0 < there == known - cost[u] * axis_cost[beyond[1, m]])
            if is_left:
                noted.append((np.int64(known) << INDEX_BITS) | u)
                noted_marks.append(marks[u])
                distance[u] = FAR
                _put(withdrawn, known, u)
            else:
                _put(waiting, known, u)
    return waiting, withdrawn, count, np.array(noted), np.array(noted_marks)


@kernel
def spread(shape, cost, axis_cost, painted, marks, distance, waiting, farthest, most):
    """Spread distances and labels over so many voxels, the nearest first; ``marks`` stays as it was.

    Returns the heap, the voxels whose labels change, these labels, the number of voxels, whether one is too far, and
    what there was before: voxels and distances in one number, and marks.
    """
    per_slice, per_row = 1.0 / (shape[1] * shape[2]), 1.0 / shape[2]
    near = np.empty((2, 6), np.int64)
    noted = [np.int64(0) for _ in range(0)]
    noted_marks = [np.uint8(0) for _ in range(0)]
    changed = [np.int64(0) for _ in range(0)]
    before = [np.uint8(0) for _ in range(0)]
    is_too_far = False
    count = 0
    while waiting[0] > 0 and count < most:
        waiting = _with_room(waiting, 6)
        now, v = _take(waiting)
        if now >= farthest:
            is_too_far = True
            break
        # it was sooner, or has been withdrawn since
        if abs(distance[v]) != now:
            continue
        count += 1
        is_new = distance[v] < 0
        near_count = near_voxels(v, per_slice, per_row, shape, near)
        label = painted[v]
        if now > 1:
            # of neighbours that lead here as quickly, the one with the lowest index gives its label
            for n in range(near_count):
                u = near[0, n]
                if 0 < distance[u] == now - cost[v] * axis_cost[near[1, n]]:
                    label = marks[u]
                    break
        is_other = label != marks[v]
        if is_other:
            if not is_new:
                noted.append((now << INDEX_BITS) | v)
                noted_marks.append(marks[v])
            changed.append(v)
            before.append(marks[v])
            marks[v] = label
        distance[v] = now
        for n in range(near_count):
            u = near[0, n]
            there = min(now + cost[u] * axis_cost[near[1, n]], farthest)
            known = np.int64(distance[u])
            # a distance that is foretold is negative, so that the voxel waits for its turn once
            if there < abs(known):
                if known > 0:
                    noted.append((known << INDEX_BITS) | u)
                    noted_marks.append(marks[u])
                distance[u] = -there
                _put(waiting, there, u)
            elif there == known and (is_new or is_other):
                _put(waiting, there, u)
    found = np.array(changed)
    values = marks[found]
    for n in range(len(found)):
        marks[found[n]] = before[n]
    return waiting, found, values, count, is_too_far, np.array(noted), np.array(noted_marks)


@kernel
def take_back(noted, noted_marks, marks, distance):
    """Write noted distances and marks, the latest first; the voxels whose marks that changes, and what they were."""
    changed = [np.int64(0) for _ in range(0)]
    now = [np.uint8(0) for _ in range(0)]
    for n in range(len(noted) - 1, -1, -1):
        v = noted[n] & ((np.int64(1) << INDEX_BITS) - 1)
        distance[v] = noted[n] >> INDEX_BITS
        if marks[v] != noted_marks[n]:
            changed.append(v)
            now.append(marks[v])
            marks[v] = noted_marks[n]
    return np.array(changed), np.array(now)
