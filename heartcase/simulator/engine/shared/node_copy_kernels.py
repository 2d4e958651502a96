"""Paths of nodes, their runs, and votes of windows: kernels of :mod:`heartcase.simulator.engine.shared.node_copies`."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = ["couple", "group_paths", "match", "vote", "walk"]

_CANDIDATES = 64
"""Different places of a neighbouring row that the nodes of a window can vote for."""


@kernel
def match(lower, higher, after, before):
    """Let nodes follow each other along some links, the first first."""
    for link in range(len(lower)):
        if after[lower[link]] < 0 and before[higher[link]] < 0:
            after[lower[link]] = higher[link]
            before[higher[link]] = lower[link]


@kernel
def walk(starts, after, path):
    """Give the nodes of each path its number."""
    for number in range(len(starts)):
        node = starts[number]
        while node >= 0:
            path[node] = number
            node = after[node]


@kernel
def couple(middle, side, weight, row_of_path, couples):
    """Count the pairs of sides in one row with one middle; write them with their lesser weight as there is room."""
    count = 0
    for first in range(len(middle)):
        for second in range(first + 1, len(middle)):
            if middle[second] != middle[first] or row_of_path[side[second]] != row_of_path[side[first]]:
                break
            if count < len(couples):
                couples[count, 0], couples[count, 1] = side[first], side[second]
                couples[count, 2] = min(weight[first], weight[second])
            count += 1
    return count


@kernel
def group_paths(couples, low, high, group):
    """Bring paths together, couple by couple, where none of their groups' paths overlap."""
    following = np.full(len(low), -1, np.int64)
    for number in range(len(couples)):
        one, other = group[couples[number, 0]], group[couples[number, 1]]
        if one == other:
            continue
        one, other = min(one, other), max(one, other)
        overlaps = False
        last = one
        here = one
        while here >= 0:
            there = other
            while there >= 0:
                if low[here] <= high[there] and low[there] <= high[here]:
                    overlaps = True
                there = following[there]
            last = here
            here = following[here]
        if overlaps:
            continue
        following[last] = other
        here = other
        while here >= 0:
            group[here] = one
            here = following[here]


@kernel
def vote(corners, node_index, node_lane, node_slot, asks, windows, window_rows, window_count, lane_count):
    """Write the rows of windows where most neighbours of their nodes lie."""
    number = np.full(window_count, -1, np.int64)
    for place in range(len(windows)):
        number[windows[place]] = place
    lanes = np.full((len(windows), 9, _CANDIDATES), -1, np.int64)
    votes = np.zeros((len(windows), 9, _CANDIDATES), np.int64)
    for cell in range(len(corners)):
        for a in range(8):
            node = corners[cell, a]
            if not asks[node]:
                continue
            window = number[node_slot[node] // 8]
            for b in range(8):
                other = corners[cell, b]
                i = node_index[other, 0] - node_index[node, 0]
                row = node_index[other, 1] - node_index[node, 1] + 1
                row += 3 * (node_index[other, 2] - node_index[node, 2] + 1)
                if row == 4:
                    continue
                lane = node_lane[other] - i - node_slot[node] % 8
                if lane < 8 or lane > lane_count - 16:
                    continue
                for candidate in range(_CANDIDATES):
                    if lanes[window, row, candidate] < 0:
                        lanes[window, row, candidate] = lane
                    if lanes[window, row, candidate] == lane:
                        votes[window, row, candidate] += 1
                        break
    for place in range(len(windows)):
        for row in range(9):
            best = 0
            for candidate in range(_CANDIDATES):
                lane, count = lanes[place, row, candidate], votes[place, row, candidate]
                if lane < 0:
                    break
                if count > best or (count == best and lane < window_rows[windows[place], row]):
                    best = count
                    window_rows[windows[place], row] = lane
