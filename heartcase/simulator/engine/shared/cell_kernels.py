"""Which windows hold cells, and what they touch: kernels of :mod:`heartcase.simulator.engine.shared.cell_lanes`."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.engine.shared.lane_kernels import list_one, list_windows, node_in_lane

__all__ = [
    "lay_out_cells",
    "number_by_window",
    "share_by_node_window",
    "touched_windows",
    "write_lists",
]

_MOST_TOUCHED = 64
"""Windows that the corners of a window's cells can lie in: eight cells of eight corners."""
_GHOST_CELLS = 4
_CELL_ROWS = (4, 5, 7, 8)
"""Rows around a window that its cells have corners in."""


@kernel
def lay_out_cells(corners, irregular, node_lane, node_slot, ghost_start, cell_lane, cell_slot, held, ghost_lane):
    """Give cells their lanes: that of their lowest corner, or of that corner's ghost.

    Parameters
    ----------
    corners, irregular
        Nodes of the cells, and the cells whose corners have ghosts, ascending.
    node_lane, node_slot, ghost_start
        As of :class:`heartcase.simulator.engine.shared.lanes.LaneLayout`.
    cell_lane, cell_slot
        Lane of each cell, and its window's number times 8 plus its place there; written.
    held
        Windows of nodes that hold a cell, ascending, shape (window_count,); written.
    ghost_lane
        Lane of the ghost at each corner of the irregular cells; written.

    Returns
    -------
    int
        How many windows of nodes hold a cell.
    """
    is_irregular = np.zeros(len(corners), np.bool_)
    for cell in irregular:
        is_irregular[cell] = True
    number = np.full(len(held), -1, np.int32)
    for cell in range(len(corners)):
        if not is_irregular[cell]:
            number[node_slot[corners[cell, 0]] >> 3] = 0
    count = 0
    for window in range(len(number)):
        if number[window] == 0:
            held[count], number[window] = window, count
            count += 1
    for cell in range(len(corners)):
        if not is_irregular[cell]:
            node = corners[cell, 0]
            cell_lane[cell] = node_lane[node]
            cell_slot[cell] = 8 * number[node_slot[node] >> 3] + (node_slot[node] & 7)
    for place in range(len(irregular)):
        window, own = place // _GHOST_CELLS, 2 * (place % _GHOST_CELLS)
        lane = ghost_start[window] + own
        cell_lane[irregular[place]], cell_slot[irregular[place]] = lane, 8 * (count + window) + own
        for corner in range(8):
            ghost_lane[place, corner] = lane + (corner & 1) + 8 * (corner >> 1)
    return count


@kernel
def touched_windows(corners, node_slot, cell_slot, rows, ghost_window, starts, window_of, cell_in, touches, firsts):
    """List the windows of nodes that the cells of each window have corners in, ascending.

    Parameters
    ----------
    corners, node_slot
        Nodes of the cells, and each node's window times 8 plus its place there.
    cell_slot, rows, ghost_window
        The same of the cells, the rows of their windows, and the first of these that holds ghosts.
    starts, window_of
        As of :func:`heartcase.simulator.engine.shared.lane_kernels.windows_by_lanes`.
    cell_in
        Cell in each place of the windows, -1 for none; written.
    touches, firsts
        Room for the lists, one after the other, eight for each cell, and for where they begin and the last ends;
        written.

    Returns
    -------
    int
        Length of the longest list.
    """
    cell_in[:] = -1
    for cell in range(len(cell_slot)):
        cell_in[cell_slot[cell]] = cell
    end, longest = 0, 0
    listed = np.empty(_MOST_TOUCHED, np.int32)
    for window in range(len(rows)):
        firsts[window] = end
        count = 0
        place = 0
        while place < 8:
            cell = cell_in[8 * window + place]
            place += 1
            if cell < 0:
                continue
            if window >= ghost_window:
                for corner in range(8):
                    count = list_one(listed, count, node_slot[corners[cell, corner]] >> 3)
                continue
            # Corners of cells that follow each other lie in as many lanes of four rows, and one more.
            low = place - 1
            while place < 8 and cell_in[8 * window + place] >= 0:
                place += 1
            for row in _CELL_ROWS:
                lane = rows[window, row]
                count = list_windows(lane + low, lane + place, starts, window_of, listed, count)
        touches[end : end + count] = listed[:count]
        end += count
        longest = max(longest, count)
    firsts[len(rows)] = end
    return longest


@kernel
def write_lists(numbers, firsts, lists):
    """Write lists that follow each other into the rows of an array, and then -1."""
    for row in range(len(lists)):
        count = firsts[row + 1] - firsts[row]
        for place in range(lists.shape[1]):
            lists[row, place] = numbers[firsts[row] + place] if place < count else -1


@kernel
def number_by_window(values, cell_in, first, numbers):
    """Write numbers of the cells, shape (any, cell_count), by window behind the first, shape (count, any, 8)."""
    for window in range(len(numbers)):
        for place in range(8):
            cell = cell_in[8 * window + place]
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
