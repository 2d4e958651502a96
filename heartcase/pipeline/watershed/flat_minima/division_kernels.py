"""Kernels of flat minima: their voxels, and how marked ones divide them when nothing is known of it yet."""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.data import UNMARKED

__all__ = [
    "CONTESTED",
    "FAR",
    "divide_flat",
    "lowest_in_flat",
    "mark_flat",
    "near_voxels",
    "others_in_flat",
    "voxels_of_flat",
]

CONTESTED = -2
"""Of a flat minimum: several labels mark it."""
FAR = 2**31 - 1
"""Distance of a voxel that no marked one reaches yet."""


@copied
def near_voxels(v, per_slice, per_row, shape, found):
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
def divide_flat(bits, shape, cost, axis_cost, largest_cost, voxels, marks, distance, farthest):
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
        for n in range(near_voxels(v, per_slice, per_row, shape, near)):
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
            near_count = near_voxels(v, per_slice, per_row, shape, near)
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
def voxels_of_flat(basins, first_voxel, voxel_list, bits, root):
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


@loop_kernel
def mark_flat(chunks, bits, basin, flat, number, level, label, marks, distance):
    """Mark all voxels of a flat minimum that are not yet; none of them has a distance then.

    Parameters
    ----------
    chunks
        Flat indices between which pieces of the volume lie.
    bits, basin, marks, distance
        Heights as bits, basins, labels and distances of all voxels, one-dimensional; the last two are written to.
    flat
        Number of the flat minimum that each basin's lowest voxel lies in.
    number, level
        The flat's, and its height as bits.
    label
        Value that its voxels get.
    """
    for c in numba.prange(len(chunks) - 1):
        for v in range(chunks[c], chunks[c + 1]):
            if bits[v] == level and flat[basin[v]] == number:
                distance[v] = FAR
                if marks[v] == UNMARKED:
                    marks[v] = label


@kernel
def others_in_flat(bits, basin, flat, number, level, label, marks):
    """Flat indices of the voxels of a flat minimum with other marks than ``label``."""
    found = [np.int64(0) for _ in range(0)]
    for v in range(len(bits)):
        if bits[v] == level and marks[v] != label and flat[basin[v]] == number:
            found.append(np.int64(v))
    return np.array(found)


@kernel
def lowest_in_flat(basins, first_voxel, voxel_list, bits, level):
    """Flat index of the first voxel of each of a flat minimum's basins that lies in it."""
    found = np.empty(len(basins), np.int64)
    for n in range(len(basins)):
        at = first_voxel[basins[n]]
        while bits[voxel_list[at]] != level:
            at += 1
        found[n] = voxel_list[at]
    return found
