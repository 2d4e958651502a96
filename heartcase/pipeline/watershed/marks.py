"""Marked voxels in their basins and flat minima."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.descent import ROOT
from heartcase.pipeline.watershed.flat_minima.division_kernels import CONTESTED
from heartcase.schemas.arrays import Int64, UInt8

__all__ = [
    "find_lowest_marks",
    "is_flat_contested",
    "mark_below",
    "marked_voxels",
    "note_erased",
    "note_flats",
    "note_marked",
    "own_key",
    "reach",
]


def marked_voxels(marks: UInt8) -> Int64:
    """Flat indices of the marked voxels, ascending."""
    return np.flatnonzero(marks != UNMARKED)


@kernel
def note_flats(bits, basin, root, flat, marks, voxels, flat_label):
    """Which label marks each flat minimum, or that several do."""
    flat_label[:] = -1
    for v in voxels:
        b = basin[v]
        number = flat[b]
        if number >= 0 and bits[v] == bits[root[b]]:
            if flat_label[number] == -1:
                flat_label[number] = marks[v]
            elif flat_label[number] != marks[v]:
                flat_label[number] = CONTESTED


@kernel
def is_flat_contested(bits, basin, root, flat, flat_label, voxels, label):
    """Whether a flat minimum with some voxels that get a label (255: lose theirs) holds several labels, then or before.

    Notes the label where not. That of a flat whose markers are all gone stays noted: it is solved anew in vain.
    """
    for v in voxels:
        number = flat[basin[v]]
        if number >= 0 and bits[v] == bits[root[basin[v]]]:
            if label == UNMARKED:
                if flat_label[number] == CONTESTED:
                    return True
            elif flat_label[number] == -1:
                flat_label[number] = label
            elif flat_label[number] != label:
                return True
    return False


@kernel
def find_lowest_marks(bits, basin, voxels, lowest):
    """Note each basin's lowest marked voxel in ``lowest``, which holds -1."""
    for v in voxels:
        old = lowest[basin[v]]
        if old < 0 or bits[v] < bits[old] or (bits[v] == bits[old] and v < old):
            lowest[basin[v]] = v


@kernel
def note_marked(bits, basin, voxels, label, marks, lowest):
    """Mark voxels with a label, and note where they are the lowest marked ones of their basins."""
    marks[voxels] = label
    find_lowest_marks(bits, basin, voxels, lowest)


@kernel
def note_erased(bits, basin, voxel_lists, voxels, marks, lowest):
    """Take the markers of voxels away, and note which are the lowest marked ones of their basins then."""
    first_voxel, voxel_list = voxel_lists
    marks[voxels] = UNMARKED
    for v in voxels:
        b = basin[v]
        if lowest[b] < 0 or marks[lowest[b]] != UNMARKED:
            continue
        lowest[b] = -1
        for n in range(first_voxel[b], first_voxel[b + 1]):
            one, old = np.int64(voxel_list[n]), lowest[b]
            # of equally high voxels the one with the lower index comes first
            if marks[one] != UNMARKED and (old < 0 or bits[one] < bits[old]):
                lowest[b] = one


@kernel
def mark_below(v, direction, offsets, marks):
    """Label of the first marked voxel on the way down from a voxel, itself included; 255 where it ends in the foot."""
    while marks[v] == UNMARKED and direction[v] != ROOT:
        v += offsets[direction[v]]
    return marks[v]


@copied
def own_key(v, bits, direction):
    """Key of the face under a marked voxel, through which it reaches the foot; 0 where it is in the foot."""
    if direction[v] == ROOT:
        return np.int64(0)
    return (np.int64(bits[v]) << 32) | (np.int64(v) << 3)


@copied
def reach(foot, level, label, following, foot_label, foot_level):
    """Give a label to all feet that hang together with one and have none."""
    at = foot
    while foot_label[at] == UNMARKED:
        foot_label[at] = label
        foot_level[at] = level
        at = following[at]
