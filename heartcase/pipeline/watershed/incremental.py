"""Updating a forest where voxels were marked, or markers taken away."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.descent import ROOT
from heartcase.pipeline.watershed.marks import mark_below, own_key, reach
from heartcase.pipeline.watershed.tree import NO_KEY

__all__ = ["mend", "unmark"]


@kernel
def mend(landscape, graph, voxels, label, marks, foot_label, foot_level, lowest_mark, most):
    """Mark voxels, and carry the label as far as its way is lower than what was there; the basins to paint anew.

    ``most`` limits the number of feet that the label is carried to; with more, the answer is empty, and the forest must
    be solved anew: what it holds then is neither the old one nor the new.
    """
    bits, direction, basin, offsets = landscape
    start, faces, key, higher, lower = graph
    count = len(lowest_mark)
    touched = np.empty(len(voxels), np.int64)
    touched_count = 0
    is_changed = np.zeros(count, np.bool_)
    for v in voxels:
        marks[v] = label
        b = basin[v]
        if not is_changed[b]:
            is_changed[b] = True
            touched[touched_count] = b
            touched_count += 1
        old = lowest_mark[b]
        if old < 0 or bits[v] < bits[old] or (bits[v] == bits[old] and v < old):
            lowest_mark[b] = v
    touched = np.sort(touched[:touched_count])
    changed = [np.int64(b) for b in touched]
    left = np.full(1, most, np.int64)
    # first every marked foot itself: then no way that leads over a voxel marked now is the best one of its foot
    for b in touched:
        mark = lowest_mark[b]
        _carry(
            b,
            own_key(mark, bits, direction),
            marks[mark],
            landscape,
            graph,
            marks,
            foot_label,
            foot_level,
            lowest_mark,
            is_changed,
            changed,
            left,
        )
    for b in touched:
        if left[0] < 0:
            return np.empty(0, np.int64)
        for n in range(start[b], start[b + 1]):
            one = key[faces[n]]
            here, there = higher[faces[n]], lower[faces[n]]
            if basin[here] != b:
                here, there = there, here
            mark = mark_below(here, direction, offsets, marks)
            if mark != UNMARKED and mark_below(there, direction, offsets, marks) == UNMARKED:
                _carry(
                    basin[there],
                    one,
                    mark,
                    landscape,
                    graph,
                    marks,
                    foot_label,
                    foot_level,
                    lowest_mark,
                    is_changed,
                    changed,
                    left,
                )
    if left[0] < 0:
        return np.empty(0, np.int64)
    # in the order of the volume, for the memory's sake
    return np.sort(np.array(changed))


@copied
def _carry(foot, level, label, landscape, graph, marks, foot_label, foot_level, lowest_mark, is_changed, changed, left):
    """Offer a label to a foot by a way as high as ``level``, and on to all feet that have a higher way now.

    Where the way is the one that a foot has already, only its label is new. ``left`` is how many feet it may still be
    carried to; below 0 nothing goes on.
    """
    _, direction, basin, offsets = landscape
    start, faces, key, higher, lower = graph
    if not (level < foot_level[foot] or (level == foot_level[foot] and label != foot_label[foot])):
        return
    stack = [(np.int64(foot), np.int64(level))]
    while len(stack) > 0 and left[0] >= 0:
        b, level = stack.pop()
        left[0] -= 1
        # a tree has one way only to each foot, so nothing better can have come meanwhile
        if foot_label[b] != label and not is_changed[b]:
            is_changed[b] = True
            changed.append(b)
        foot_label[b] = label
        foot_level[b] = level
        for n in range(start[b], start[b + 1]):
            one = key[faces[n]]
            here, there = higher[faces[n]], lower[faces[n]]
            if basin[here] != b:
                here, there = there, here
            other = basin[there]
            beyond = max(level, one)
            if not (beyond < foot_level[other] or (beyond == foot_level[other] and label != foot_label[other])):
                continue
            if lowest_mark[b] >= 0 and mark_below(here, direction, offsets, marks) != UNMARKED:
                continue
            if lowest_mark[other] >= 0 and mark_below(there, direction, offsets, marks) != UNMARKED:
                continue
            stack.append((np.int64(other), beyond))


@kernel
def unmark(landscape, graph, voxel_lists, voxels, marks, foot_label, foot_level, lowest_mark, most):
    """Take the markers of voxels away, and label what hung on them anew; the basins to paint anew.

    Only what hung on these markers can change: ways become longer, never shorter. ``most`` limits the number of feet to
    be labelled; with more, the answer is empty, and the forest must be solved anew: its feet are the old ones.
    """
    bits, _, basin, _ = landscape
    first_voxel, voxel_list = voxel_lists
    count = len(lowest_mark)
    is_taken = np.zeros(count, np.bool_)
    touched = np.empty(len(voxels), np.int64)
    touched_count = 0
    for v in voxels:
        if not is_taken[basin[v]]:
            is_taken[basin[v]] = True
            touched[touched_count] = basin[v]
            touched_count += 1
    touched = touched[:touched_count]
    is_taken[touched] = False
    erased = set(voxels)
    feet = _feet_that_hang(landscape, graph, touched, erased, marks, foot_level, lowest_mark, is_taken, most)
    marks[voxels] = UNMARKED
    for b in touched:
        if lowest_mark[b] in erased:
            lowest_mark[b] = -1
            for n in range(first_voxel[b], first_voxel[b + 1]):
                v, old = np.int64(voxel_list[n]), lowest_mark[b]
                # of equally high voxels the one with the lower index comes first
                if marks[v] != UNMARKED and (old < 0 or bits[v] < bits[old]):
                    lowest_mark[b] = v
    if len(feet) > most:
        return np.empty(0, np.int64)
    for b in feet:
        foot_label[b] = UNMARKED
        foot_level[b] = NO_KEY
    _solve_feet(feet, is_taken, landscape, graph, marks, foot_label, foot_level, lowest_mark)
    for b in touched:
        if not is_taken[b]:
            feet.append(b)
    return np.sort(np.array(feet))


@copied
def _first_marked(v, direction, offsets, marks):
    """The first marked voxel on the way down from a voxel, itself included; the basin's lowest where there is none."""
    while marks[v] == UNMARKED and direction[v] != ROOT:
        v += offsets[direction[v]]
    return v


@copied
def _feet_that_hang(landscape, graph, touched, erased, marks, foot_level, lowest_mark, is_taken, most):
    """Feet whose way leads to a marked voxel that is erased, noted in ``is_taken``; some of them where too many do."""
    bits, direction, basin, offsets = landscape
    start, faces, key, higher, lower = graph
    feet = [np.int64(0)]
    feet.clear()
    for b in touched:
        mark = lowest_mark[b]
        if mark in erased and foot_level[b] == own_key(mark, bits, direction) and not is_taken[b]:
            is_taken[b] = True
            feet.append(b)
        for n in range(start[b], start[b + 1]):
            here, there = higher[faces[n]], lower[faces[n]]
            if basin[here] != b:
                here, there = there, here
            other = np.int64(basin[there])
            # a face's key is the level of that foot only which is reached through it from a marked voxel
            if foot_level[other] != key[faces[n]] or is_taken[other]:
                continue
            if _first_marked(here, direction, offsets, marks) not in erased:
                continue
            if mark_below(there, direction, offsets, marks) == UNMARKED:
                is_taken[other] = True
                feet.append(other)
    at = 0
    while at < len(feet) <= most:
        b = feet[at]
        at += 1
        for n in range(start[b], start[b + 1]):
            here, there = higher[faces[n]], lower[faces[n]]
            if basin[here] != b:
                here, there = there, here
            other = np.int64(basin[there])
            if is_taken[other] or foot_level[other] != max(foot_level[b], key[faces[n]]):
                continue
            if lowest_mark[b] >= 0 and mark_below(here, direction, offsets, marks) != UNMARKED:
                continue
            if lowest_mark[other] >= 0 and mark_below(there, direction, offsets, marks) != UNMARKED:
                continue
            is_taken[other] = True
            feet.append(other)
    return feet


@copied
def _solve_feet(feet, is_taken, landscape, graph, marks, foot_label, foot_level, lowest_mark):
    """Kruskal's algorithm over the faces of some feet; what is beyond them has its label already."""
    bits, direction, basin, offsets = landscape
    start, faces, key, higher, lower = graph
    # what may give a foot its label, or join it with another one, and when
    when = [np.int64(0)]
    foot = [np.int64(0)]
    other_foot = [np.int64(0)]
    label_of = [np.int64(0)]
    when.clear()
    foot.clear()
    other_foot.clear()
    label_of.clear()
    for b in feet:
        if lowest_mark[b] >= 0:
            when.append(own_key(lowest_mark[b], bits, direction))
            foot.append(b)
            other_foot.append(np.int64(-1))
            label_of.append(np.int64(marks[lowest_mark[b]]))
        for n in range(start[b], start[b + 1]):
            one = key[faces[n]]
            here, there = higher[faces[n]], lower[faces[n]]
            if basin[here] != b:
                here, there = there, here
            if lowest_mark[b] >= 0 and mark_below(here, direction, offsets, marks) != UNMARKED:
                continue
            other = np.int64(basin[there])
            label = np.int64(UNMARKED)
            if lowest_mark[other] >= 0:
                label = np.int64(mark_below(there, direction, offsets, marks))
            joined = np.int64(-1)
            if label == UNMARKED:
                if is_taken[other]:
                    joined = other
                    if other < b:
                        continue
                else:
                    label = np.int64(foot_label[other])
                    one = max(one, foot_level[other])
                    if label == UNMARKED:
                        continue
            when.append(one)
            foot.append(b)
            other_foot.append(joined)
            label_of.append(label)
    following = np.empty(len(lowest_mark), np.int32)
    for b in feet:
        following[b] = b
    for n in np.argsort(np.array(when)):
        a, b = foot[n], other_foot[n]
        if b < 0:
            reach(a, when[n], label_of[n], following, foot_label, foot_level)
        elif foot_label[a] == UNMARKED and foot_label[b] == UNMARKED:
            following[a], following[b] = following[b], following[a]
        elif foot_label[a] == UNMARKED:
            reach(a, when[n], foot_label[b], following, foot_label, foot_level)
        elif foot_label[b] == UNMARKED:
            reach(b, when[n], foot_label[a], following, foot_label, foot_level)
