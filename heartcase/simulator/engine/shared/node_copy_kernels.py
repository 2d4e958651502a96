"""Paths of nodes, their runs, votes of windows, and cells out of place: kernels for lattices that were cut.

See :mod:`heartcase.simulator.engine.shared.node_copies`.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.engine.shared.lane_kernels import U, node_in_lane

__all__ = [
    "find_irregular_cells",
    "find_near_cells",
    "find_near_windows",
    "group_paths",
    "lay_in_layers",
    "mark_copied_rows",
    "vote",
]

_CANDIDATES = 64
"""Different places of a neighbouring row that the nodes of a window can vote for."""
_APART_MOST = 8
"""Nodes along i between two paths up to which they may share a run."""


@kernel
def mark_copied_rows(node_index, corners, row, low_i, length, is_copied):
    """Mark the rows in which several nodes lie in one place, or cells have one lowest node; returns whether any do.

    A sheet may part a cell without a copy of a node: where both pieces reach each of its nodes around the sheet.
    """
    is_there = np.zeros(len(is_copied) * length, np.bool_)
    found = False
    for node in range(len(node_index)):
        place = row[node] * length + node_index[node, 0] - low_i
        if is_there[place]:
            is_copied[row[node]] = True
            found = True
        is_there[place] = True
    is_lowest = np.zeros(len(node_index), np.bool_)
    for cell in range(len(corners)):
        lowest = U(corners[U(cell), U(0)])
        if is_lowest[lowest]:
            is_copied[row[lowest]] = True
            found = True
        is_lowest[lowest] = True
    return found


@kernel(cached=False)
def _find_in_list(first, following, numbers, count, which, number):
    """Entry of a number in one of some lists that ascend: the next of all where it was none, and now is."""
    before, here = -1, first[which]
    while here >= 0 and numbers[here] < number:
        before, here = here, following[here]
    if here >= 0 and numbers[here] == number:
        return here
    numbers[count], following[count] = number, here
    if before < 0:
        first[which] = count
    else:
        following[before] = count
    return count


@kernel
def _find_paths(corners, row, is_copied, path):
    """Number the paths of nodes, -1 for none at first; those that share most cells follow each other.

    Returns the first node of each.
    """
    node_count = len(row)
    link_count = 4 * len(corners)
    first = np.full(node_count, -1, np.int32)
    following, numbers, weights = (
        np.empty(link_count, np.int32),
        np.empty(link_count, np.int32),
        np.empty(link_count, np.int32),
    )
    count = 0
    for cell in range(len(corners)):
        for edge in range(4):
            lower, higher = corners[cell, 2 * edge], corners[cell, 2 * edge + 1]
            if not is_copied[row[lower]]:
                continue
            entry = first[lower]
            if entry < 0 or numbers[entry] != higher:
                entry = _find_in_list(first, following, numbers, count, lower, higher)
            if entry == count:
                weights[entry] = 0
                count += 1
            weights[entry] += 1
    most = 0
    for entry in range(count):
        most = max(most, weights[entry])
    nodes = np.empty(node_count, np.int32)
    copied_count = 0
    for node in range(node_count):
        if is_copied[row[node]]:
            nodes[copied_count] = node
            copied_count += 1
    after, before = np.full(node_count, -1, np.int32), np.full(node_count, -1, np.int32)
    for weight in range(most, 0, -1):
        for lower in nodes[:copied_count]:
            entry = first[lower]
            while entry >= 0:
                higher = numbers[entry]
                if weights[entry] == weight and after[lower] < 0 and before[higher] < 0:
                    after[lower], before[higher] = higher, lower
                entry = following[entry]
    starts = np.empty(copied_count, np.int32)
    path_count = 0
    for start in nodes[:copied_count]:
        if before[start] >= 0:
            continue
        node = start
        while node >= 0:
            path[node] = path_count
            node = after[node]
        starts[path_count] = start
        path_count += 1
    return starts[:path_count].copy()


@kernel
def _couple(corners, row, path, starts, low, high, row_count):
    """Pairs of paths in one row that do not overlap, by how far they are apart, and those with most in common first.

    Paths have in common what a path or a row without copies beside them shares most cells with both.
    """
    path_count = len(starts)
    # Paths beside each path or row, and of how many cells: each corner has three others beside it in a cell.
    room = 24 * len(corners)
    first = np.full(path_count + row_count, -1, np.int32)
    following, sides, weights = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32)
    element, lasts, middles = np.empty(8, np.int64), np.full(64, -1, np.int64), np.empty(64, np.int64)
    count = 0
    for cell in range(len(corners)):
        for corner in range(8):
            node = U(corners[U(cell), U(corner)])
            element[U(corner)] = path[node] if path[node] >= 0 else path_count + row[node]
        for corner in range(8):
            if element[U(corner)] >= path_count:
                continue
            side = element[U(corner)]
            for other in range(corner & 1, 8, 2):
                if other == corner:
                    continue
                middle, pair = element[U(other)], U(8 * corner + other)
                # Cells follow each other along rows: mostly it is the pair of the cell before.
                entry = lasts[pair]
                if entry < 0 or middles[pair] != middle or sides[entry] != side:
                    entry = _find_in_list(first, following, sides, count, middle, side)
                    if entry == count:
                        weights[entry] = 0
                        count += 1
                    lasts[pair], middles[pair] = entry, middle
                weights[entry] += 1
    couple_count = 0
    for middle in range(len(first)):
        one = first[middle]
        while one >= 0:
            other = following[one]
            while other >= 0:
                couple_count += row[starts[sides[one]]] == row[starts[sides[other]]]
                other = following[other]
            one = following[one]
    first_couple = np.full(path_count, -1, np.int32)
    next_couple, others, commons = (
        np.empty(couple_count, np.int32),
        np.empty(couple_count, np.int32),
        np.empty(couple_count, np.int32),
    )
    couple_count = 0
    most = 0
    for middle in range(len(first)):
        one = first[middle]
        while one >= 0:
            other = following[one]
            while other >= 0:
                a, b = sides[one], sides[other]
                gap = max(low[a], low[b]) - min(high[a], high[b])
                if row[starts[a]] == row[starts[b]] and 0 < gap <= _APART_MOST:
                    common = min(weights[one], weights[other])
                    most = max(most, common)
                    entry = _find_in_list(first_couple, next_couple, others, couple_count, a, b)
                    if entry == couple_count:
                        commons[entry] = 0
                        couple_count += 1
                    commons[entry] = max(commons[entry], common)
                other = following[other]
            one = following[one]
    couples = np.empty((couple_count, 2), np.int32)
    keys = np.empty(couple_count, np.int64)
    place = 0
    for one in range(path_count):
        entry = first_couple[one]
        while entry >= 0:
            other = others[entry]
            gap = max(low[one], low[other]) - min(high[one], high[other])
            couples[place, 0], couples[place, 1] = one, other
            keys[place] = gap * (most + 1) + most - commons[entry]
            place += 1
            entry = next_couple[entry]
    return couples[np.argsort(keys, kind="mergesort")]


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
def _around_copied_rows(corners, row, is_copied):
    """Corners of the cells that have some in rows with copies."""
    found, count = np.empty((len(corners), 8), np.int32), 0
    for cell in range(len(corners)):
        for edge in range(4):
            if is_copied[U(row[U(corners[U(cell), U(2 * edge)])])]:
                for corner in range(8):
                    found[U(count), U(corner)] = corners[U(cell), U(corner)]
                count += 1
                break
    return found[:count]


@kernel
def lay_in_layers(node_index, corners, row, is_copied, low_i, length, layer):
    """Write the layer of its row that each node lies in, zeros at first.

    Parameters
    ----------
    node_index, corners
        Index (i, j, k) of each node, and nodes of the cells.
    row, is_copied
        Row along i of each node, and whether there are copies in each.
    low_i, length
        Least i of all nodes, and to how many places along i they reach.
    layer
        Shape (node_count,); written.
    """
    corners = _around_copied_rows(corners, row, is_copied)
    path = np.full(len(row), -1, np.int32)
    starts = _find_paths(corners, row, is_copied, path)
    path_count = len(starts)
    low, high = np.empty(path_count, np.int64), np.empty(path_count, np.int64)
    for number in range(path_count):
        low[number] = high[number] = node_index[starts[number], 0]
    for node in range(len(path)):
        if path[node] >= 0:
            high[path[node]] = max(high[path[node]], node_index[node, 0])
    group = np.arange(path_count)
    group_paths(_couple(corners, row, path, starts, low, high, len(is_copied)), low, high, group)
    # The layers of a row are numbered by their first paths.
    keys = np.empty(path_count, np.int64)
    for number in range(path_count):
        keys[number] = row[starts[number]] * length + low[number] - low_i
    layer_of = np.full(path_count, -1, np.int32)
    last, count = -1, 0
    for nth in np.argsort(keys, kind="mergesort"):
        number = int(nth)
        if row[starts[number]] != last:
            last, count = row[starts[number]], 0
        if layer_of[group[number]] < 0:
            layer_of[group[number]] = count
            count += 1
    for node in range(len(path)):
        if path[node] >= 0:
            layer[node] = layer_of[group[path[node]]]


@kernel
def find_near_windows(around, is_copied, by_lane, first, window_rows, is_near):
    """Windows in or beside a row with copies, ascending; all their rows but their own are emptied.

    Parameters
    ----------
    around, is_copied
        Number of the nine rows around each window, -1 where there is none, and whether there are copies in each.
    by_lane, first, window_rows
        As of :class:`heartcase.simulator.engine.shared.lanes.LaneLayout`.
    is_near
        Whether each node lies in such a window, shape (node_count,), zeros at first; written.
    """
    windows, count = np.empty(len(around), np.int64), 0
    for window in range(len(around)):
        is_beside = False
        for which in range(9):
            row = around[U(window), U(which)]
            is_beside = is_beside or (row >= 0 and is_copied[U(row)])
        if not is_beside:
            continue
        windows[count] = window
        count += 1
        for row in range(9):
            if row != 4:
                window_rows[window, row] = 8
        for node in by_lane[first[window] : first[window + 1]]:
            is_near[node] = True
    return windows[:count].copy()


@kernel
def find_near_cells(corners, is_near):
    """Cells with a corner at a node that is near copies, ascending, and whether each is one."""
    cells, is_among = np.empty(len(corners), np.int64), np.zeros(len(corners), np.bool_)
    count = 0
    for cell in range(len(corners)):
        for corner in range(8):
            if is_near[U(corners[U(cell), U(corner)])]:
                cells[U(count)], is_among[U(cell)] = cell, True
                count += 1
                break
    return cells[:count].copy(), is_among


@kernel
def vote(corners, near_cells, is_near, node_lane, node_slot, by_lane, first, windows, lane_count, window_rows):
    """Write the rows of some windows of 8 lanes: where most neighbours of their nodes lie, or the first of such places.

    Parameters
    ----------
    corners, near_cells
        Nodes of the cells, and the cells around the windows' nodes.
    is_near
        Whether each node lies in one of the windows.
    node_lane, node_slot, by_lane, first, window_rows
        As of :class:`heartcase.simulator.engine.shared.lanes.LaneLayout`; the rows are written.
    windows
        Windows to find rows for, shape (count,).
    lane_count
        Lanes that there are.
    """
    node_count = len(node_lane)
    starts = np.zeros(node_count + 1, np.int32)
    for cell in near_cells:
        for corner in range(8):
            node = corners[cell, corner]
            starts[node + 1] += is_near[node]
    for node in range(node_count):
        starts[node + 1] += starts[node]
    around, filled = np.empty(starts[node_count], np.int64), starts.copy()
    for cell in near_cells:
        for corner in range(8):
            node = corners[cell, corner]
            if is_near[node]:
                around[filled[node]] = 8 * cell + corner
                filled[node] += 1
    lanes, votes = np.empty((9, _CANDIDATES), np.int64), np.empty((9, _CANDIDATES), np.int64)
    counts = np.empty(9, np.int64)
    for window in windows:
        counts[:] = 0
        for which in range(first[window], first[window + 1]):
            node = by_lane[U(which)]
            for at in range(starts[node], starts[node + 1]):
                cell, own = around[U(at)] >> 3, around[U(at)] & 7
                for corner in range(8):
                    if corner >> 1 == own >> 1:
                        continue
                    row = 4 + (corner >> 1 & 1) - (own >> 1 & 1) + 3 * ((corner >> 2) - (own >> 2))
                    other = U(corners[U(cell), U(corner)])
                    lane = node_lane[other] - (corner & 1) + (own & 1) - (node_slot[U(node)] & 7)
                    if lane < 8 or lane > lane_count - 16:
                        continue
                    place = 0
                    while place < counts[U(row)] and lanes[U(row), U(place)] != lane:
                        place += 1
                    if place == _CANDIDATES:
                        continue
                    if place == counts[U(row)]:
                        lanes[U(row), U(place)], votes[U(row), U(place)] = lane, 0
                        counts[U(row)] += 1
                    votes[U(row), U(place)] += 1
        for row in range(9):
            best = 0
            for place in range(counts[row]):
                lane, count = lanes[row, place], votes[row, place]
                if count > best or (count == best and lane < window_rows[window, row]):
                    best = count
                    window_rows[window, row] = lane


@kernel
def find_irregular_cells(
    corners, near_cells, is_near_cell, is_near, node_lane, node_slot, window_rows, slot_of, node_in
):
    """Cells whose corners the kernels do not find, or that they would take for another node's, ascending.

    Parameters
    ----------
    corners, near_cells, is_near_cell
        Nodes of the cells, and of :func:`find_near_cells`.
    is_near, node_lane, node_slot, window_rows, slot_of, node_in
        As of :class:`heartcase.simulator.engine.shared.lanes.LaneLayout`.
    """
    irregular = np.zeros(len(corners), np.bool_)
    for cell in near_cells:
        lowest = U(corners[cell, 0])
        start, place = node_slot[lowest] >> 3, node_slot[lowest] & 7
        for corner in range(8):
            other, i, row = U(corners[U(cell), U(corner)]), corner & 1, (corner >> 1 & 1) + 3 * (corner >> 2)
            there = window_rows[U(start), U(4 + row)] + place + i
            back = window_rows[U(node_slot[other] >> 3), U(4 - row)] + (node_slot[other] & 7) - i
            if there != node_lane[other] or back != node_lane[lowest]:
                irregular[cell] = True
    # Of cells with one lowest node, the first keeps its lane.
    cell_of = np.full(len(node_lane), -1, np.int32)
    for cell in range(len(corners)):
        if not irregular[U(cell)]:
            lowest = U(corners[U(cell), U(0)])
            if is_near_cell[U(cell)] and cell_of[lowest] >= 0:
                irregular[U(cell)] = True
            else:
                cell_of[lowest] = cell
    for node in range(len(node_lane)):
        if not is_near[node]:
            continue
        for corner in range(8):
            row = (corner >> 1 & 1) + 3 * (corner >> 2)
            lane = window_rows[node_slot[node] >> 3, 4 - row] + (node_slot[node] & 7) - (corner & 1)
            behind = node_in_lane(lane, slot_of, node_in)
            if behind >= 0 and cell_of[behind] >= 0 and corners[cell_of[behind], corner] != node:
                irregular[cell_of[behind]] = True
    found, count = np.empty(len(corners), np.int64), 0
    for cell in range(len(corners)):
        if irregular[cell]:
            found[count] = cell
            count += 1
    return found[:count].copy()
