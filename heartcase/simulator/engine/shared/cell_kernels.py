"""Which windows hold cells, and what they touch: kernels of :mod:`heartcase.simulator.engine.shared.cell_lanes`."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.engine.shared.lane_kernels import U, node_in_lane
from heartcase.simulator.engine.shared.lanes import CELL_LANES, CELL_PARTS, CORNER_ROWS, GHOST_CELLS, PART_LANES

__all__ = [
    "lay_out_cells",
    "number_by_window",
    "ranges_touched",
    "share_by_node_window",
    "write_lists",
]


@kernel
def lay_out_cells(
    corners, irregular, node_lane, node_slot, window_rows, ghost_start, cell_lane, cell_slot, rows, in_pairs, ghost_lane
):
    """Give cells their lanes: that of their lowest corner, or of that corner's ghost; and their places in windows.

    A window of nodes has one part of a window of cells where its cells lie in four lanes, else two: these go to a
    window of such pairs.

    Parameters
    ----------
    corners, irregular
        Nodes of the cells, and the cells whose corners have ghosts, ascending.
    node_lane, node_slot, window_rows, ghost_start
        As of :class:`heartcase.simulator.engine.shared.lanes.LaneLayout`.
    cell_lane, cell_slot
        Lane of each cell, and its window's number times 16 plus its place there; written.
    rows
        Lane at each part's first i in the rows of its corners, shape (windows of all parts that there can be, 16); that
        of an empty block at first; written.
    in_pairs
        Whether a window's parts follow each other two by two, shape (the same,); written.
    ghost_lane
        Lane of the ghost at each corner of the irregular cells; written.

    Returns
    -------
    tuple
        How many windows hold a cell, and the first of those that hold ghosts.
    """
    is_irregular = np.zeros(len(corners), np.bool_)
    for cell in irregular:
        is_irregular[cell] = True
    # First and last place of a cell in each window of nodes; then its first part, and where that begins.
    low, high = np.full(len(window_rows), 8, np.int32), np.full(len(window_rows), -1, np.int32)
    for cell in range(len(corners)):
        if not is_irregular[U(cell)]:
            slot = node_slot[U(corners[U(cell), U(0)])]
            window, place = U(slot >> 3), slot & 7
            low[window], high[window] = min(low[window], place), max(high[window], place)
    starts = rows.reshape(-1, len(CORNER_ROWS))
    # The window that is being filled with single parts and the one with pairs: number, and parts that it has.
    number, filled = np.zeros(2, np.int64), np.full(2, CELL_PARTS)
    count = 0
    for each in range(len(window_rows)):
        window = U(each)
        if high[window] < 0:
            continue
        is_pair = int(high[window] - low[window] >= PART_LANES)
        if filled[is_pair] == CELL_PARTS:
            number[is_pair], filled[is_pair] = count, 0
            in_pairs[count] = is_pair
            count += 1
        part = CELL_PARTS * number[is_pair] + filled[is_pair]
        low[window], high[window] = 0 if is_pair else min(low[window], PART_LANES), part
        for pair in range(1 + is_pair):
            for row in range(len(CORNER_ROWS)):
                lane = window_rows[window, U(CORNER_ROWS[row])] + low[window] + PART_LANES * pair
                starts[U(part + pair), U(row)] = lane
        filled[is_pair] += 1 + is_pair
    for cell in range(len(corners)):
        if not is_irregular[U(cell)]:
            node = U(corners[U(cell), U(0)])
            window, place = U(node_slot[node] >> 3), node_slot[node] & 7
            cell_lane[U(cell)] = node_lane[node]
            cell_slot[U(cell)] = PART_LANES * high[window] + place - low[window]
    ghost_window = count
    count += (2 * len(ghost_start) + CELL_PARTS - 1) // CELL_PARTS
    in_pairs[ghost_window:count] = 1
    for block in range(len(ghost_start)):
        for pair in range(2):
            part = CELL_PARTS * ghost_window + 2 * block + pair
            for row in range(len(CORNER_ROWS)):
                starts[part, row] = ghost_start[block] + 8 * row + PART_LANES * pair
    for place in range(len(irregular)):
        block, own = place // GHOST_CELLS, 2 * (place % GHOST_CELLS)
        lane = ghost_start[block] + own
        cell_lane[irregular[place]], cell_slot[irregular[place]] = lane, CELL_LANES * ghost_window + 8 * block + own
        for corner in range(8):
            ghost_lane[place, corner] = lane + (corner & 1) + 8 * (corner >> 1)
    return count, ghost_window


@kernel
def ranges_touched(corners, node_lane, cell_slot, rows, ghost_window, cell_in, ranges):
    """Write the lanes of nodes that the cells of each window have corners in, for ``list_windows``.

    Parameters
    ----------
    corners, node_lane
        Nodes of the cells, and each node's lane.
    cell_slot, rows, ghost_window
        Each cell's window times 16 plus its place there, the rows of these windows, and the first that holds ghosts.
    cell_in
        Cell in each place of the windows, -1 for none; written.
    ranges
        Shape (8 * cell_count, 3); written.

    Returns
    -------
    int
        How many are written.
    """
    cell_in[:] = -1
    for cell in range(len(cell_slot)):
        cell_in[U(cell_slot[cell])] = cell
    count = 0
    for window in range(len(rows)):
        place = 0
        while place < CELL_LANES:
            cell = cell_in[U(CELL_LANES * window + place)]
            place += 1
            if cell < 0:
                continue
            if window >= ghost_window:
                for corner in range(8):
                    lane = node_lane[corners[cell, corner]]
                    ranges[count, 0], ranges[count, 1], ranges[count, 2] = window, lane, lane
                    count += 1
                continue
            # Corners of cells of a part that follow each other lie in as many lanes of four rows, and one more.
            low, part = place - 1, (place - 1) // PART_LANES
            while place < PART_LANES * (part + 1) and cell_in[U(CELL_LANES * window + place)] >= 0:
                place += 1
            for number in range(len(CORNER_ROWS)):
                lane = rows[U(window), U(len(CORNER_ROWS) * part + number)] - PART_LANES * part
                ranges[U(count), U(0)] = window
                ranges[U(count), U(1)], ranges[U(count), U(2)] = lane + low, lane + place
                count += 1
    return count


@kernel
def write_lists(numbers, firsts, lists):
    """Write lists that follow each other into the rows of an array, and then -1."""
    flat, length = lists.ravel(), lists.shape[1]
    for row in range(len(lists)):
        start, count = firsts[row], firsts[row + 1] - firsts[row]
        for place in range(count):
            flat[U(row * length + place)] = numbers[U(start + place)]
        for place in range(count, length):
            flat[U(row * length + place)] = -1


@kernel
def number_by_window(values, cell_in, first, numbers):
    """Write numbers of the cells, shape (any, cell_count), by window behind the first, shape (count, any, 16)."""
    for window in range(len(numbers)):
        for place in range(CELL_LANES):
            cell = cell_in[CELL_LANES * window + place]
            if cell >= 0:
                for number in range(len(values)):
                    numbers[window, first + number, place] = values[number, cell]


@kernel
def share_by_node_window(
    window_rows, slot_of, node_in, by_lane, first, node_slot, corners, irregular, shares, own, numbers
):
    """Write eight numbers of the cells around each window's nodes, and one of the nodes.

    Parameters
    ----------
    window_rows, slot_of, node_in, by_lane, first, node_slot
        As of :class:`heartcase.simulator.engine.shared.lanes.LaneLayout`.
    corners, irregular
        Nodes of the cells, and the cells whose corners have ghosts.
    shares, own
        Numbers of each cell, one for each corner, shape (8, cell_count), and of each node, shape (node_count,).
    numbers
        Shape (window_count, 9, 8), zeros at first; written.
    """
    is_irregular = np.zeros(len(corners), np.bool_)
    for cell in irregular:
        is_irregular[cell] = True
    cell_of = np.full(len(node_slot), -1, np.int32)
    for cell in range(len(corners)):
        if not is_irregular[cell]:
            cell_of[corners[cell, 0]] = cell
    for window in range(len(window_rows)):
        for corner in range(8):
            # A node is the corner of the cell behind it by that corner's offset.
            lane = window_rows[window, 4 - (corner >> 1 & 1) - 3 * (corner >> 2)] - (corner & 1)
            for place in range(8):
                node = node_in_lane(lane + place, slot_of, node_in)
                if node >= 0 and cell_of[node] >= 0:
                    numbers[window, corner, place] = shares[corner, cell_of[node]]
        for node in by_lane[first[window] : first[window + 1]]:
            numbers[window, 8, node_slot[node] & 7] = own[node]
