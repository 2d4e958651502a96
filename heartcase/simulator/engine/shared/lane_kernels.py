"""Which rows, blocks and windows there are: kernels of :mod:`heartcase.simulator.engine.shared.lanes`.

Blocks that are stored, and the empty one behind each run of them, are numbered in the order of their lanes: slots.
Tables with eight places a slot are short, where those with one a lane are not.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = [
    "bounds",
    "lay_out_nodes",
    "list_one",
    "list_windows",
    "mark_blocks",
    "mark_over_springs",
    "node_in_lane",
    "number_blocks",
    "number_rows",
    "rows_around",
    "rows_of_windows",
    "start_slots",
    "windows_behind",
    "windows_by_lanes",
]


@kernel
def bounds(index):
    """Least and largest of the three numbers of some places, shape (2, 3)."""
    found = np.empty((2, 3), np.int64)
    for axis in range(3):
        found[0, axis] = found[1, axis] = index[0, axis]
    for place in range(len(index)):
        for axis in range(3):
            number = index[place, axis]
            found[0, axis] = min(found[0, axis], number)
            found[1, axis] = max(found[1, axis], number)
    return found


@kernel
def number_rows(node_index, low_j, low_k, table, row):
    """Number the rows along i that have nodes, by k and j; returns how many there are.

    Parameters
    ----------
    node_index
        Index (i, j, k) of each node.
    low_j, low_k
        Place (j, k) of the table's first row.
    table
        Shape (k, j), zeros at first: written with the number of each row and one more.
    row
        Row of each node; written.
    """
    flat, width = table.ravel(), table.shape[1]
    for node in range(len(node_index)):
        row[node] = width * (node_index[node, 2] - low_k) + node_index[node, 1] - low_j
        flat[row[node]] = 1
    count = 0
    for place in range(len(flat)):
        if flat[place]:
            count += 1
            flat[place] = count
    for node in range(len(node_index)):
        row[node] = flat[row[node]] - 1
    return count


@kernel
def rows_around(node_index, nodes, low_j, low_k, table, around):
    """Write the numbers of the nine rows around some nodes, -1 where there is none; shape (count, 9)."""
    for place in range(len(nodes)):
        j, k = node_index[nodes[place], 1] - low_j, node_index[nodes[place], 2] - low_k
        for number in range(9):
            around[place, number] = table[k + number // 3 - 1, j + number % 3 - 1] - 1


@kernel
def mark_blocks(node_index, row, layer, cells, corners, first_block, layer_blocks, is_stored, block_of):
    """Mark the blocks of all nodes, and those at the same i as a node's neighbour over a block's end.

    Parameters
    ----------
    node_index, row, layer
        Index (i, j, k) of each node, number of its row along i, and its layer there.
    cells, corners
        Index and corners of the cells whose nodes are neighbours.
    first_block, layer_blocks
        First block along i, and blocks of a layer.
    is_stored
        Shape (row_count, blocks of all layers), zeros at first; written.
    block_of
        Place of each node's block there; written.
    """
    flat, columns = is_stored.ravel(), is_stored.shape[1]
    for node in range(len(node_index)):
        place = row[node] * columns + layer[node] * layer_blocks + (node_index[node, 0] >> 3) - first_block
        block_of[node] = place
        flat[place] = 1
    for cell in range(len(cells)):
        if cells[cell, 0] & 7 == 7:
            for corner in range(8):
                flat[block_of[corners[cell, corner]] + 1 - 2 * (corner & 1)] = 1


@kernel
def mark_over_springs(node_index, spring_nodes, block_of, is_stored):
    """Mark the blocks at the same i as a node's spring over a block's end, where cells do not say which there are."""
    flat = is_stored.ravel()
    for spring in range(len(spring_nodes)):
        one, other = spring_nodes[spring, 0], spring_nodes[spring, 1]
        way = (node_index[other, 0] >> 3) - (node_index[one, 0] >> 3)
        if way:
            flat[block_of[one] + way] = 1
            flat[block_of[other] - way] = 1


@kernel
def number_blocks(is_stored, number, counts):
    """Write the slot of each block that is stored, and how many follow each other in each run; returns both counts."""
    block_count, run_count = 0, 0
    for row in range(is_stored.shape[0]):
        is_run = False
        for column in range(is_stored.shape[1]):
            number[row, column] = -1
            if not is_stored[row, column]:
                is_run = False
                continue
            if not is_run:
                counts[run_count] = 0
                run_count += 1
            is_run = True
            number[row, column] = block_count + run_count - 1
            counts[run_count - 1] += 1
            block_count += 1
    return block_count, run_count


@kernel
def start_slots(counts, run_start, start, slot_of):
    """Write the first lane of each slot, and of every eight lanes the slot and one more, zeros at first."""
    slot = 0
    for run in range(len(counts)):
        for block in range(counts[run] + 1):
            start[slot] = run_start[run] + 8 * block
            slot_of[start[slot] >> 3] = slot + 1
            slot += 1


@kernel
def lay_out_nodes(node_index, block_of, number, start, node_in, node_lane, node_slot, by_lane, first):
    """Give nodes their lanes, and windows their nodes: a window begins at the first node that none holds yet.

    Parameters
    ----------
    node_index, block_of
        Index (i, j, k) of each node, and the place of its block.
    number, start
        Slot of each block by its place, and first lane of each slot.
    node_in
        Node in each lane of the slots, -1 for none; written.
    node_lane, node_slot
        Lane of each node, and its window's number times 8 plus its place there; written.
    by_lane, first
        Nodes in the order of their lanes, and where those of each window begin there, shape (any,), then how many there
        are; written.

    Returns
    -------
    int
        How many windows there are.
    """
    slots = number.ravel()
    node_in[:] = -1
    for node in range(len(node_index)):
        node_in[8 * slots[block_of[node]] + (node_index[node, 0] & 7)] = node
    count, end, place = 0, -1, 0
    for at in range(len(node_in)):
        node = node_in[at]
        if node < 0:
            continue
        lane = start[at >> 3] + (at & 7)
        if lane >= end:
            first[count] = place
            count += 1
            end = lane + 8
        node_lane[node] = lane
        node_slot[node] = 8 * count + lane - end
        by_lane[place] = node
        place += 1
    first[count] = place
    return count


@kernel
def rows_of_windows(around, nodes, node_index, first_block, number, start, node_lane, window_rows):
    """Write the lane at each window's first i in the rows around it, where layer 0 is stored there.

    Parameters
    ----------
    around
        Number of the nine rows around each window, -1 where there is none, shape (window_count, 9).
    nodes, node_index
        First node of each window, and index (i, j, k) of each node.
    first_block
        First block along i.
    number, start
        Slot of each block, -1 for none, shape as of :func:`mark_blocks`, and its first lane.
    node_lane
        Lane of each node: that of its window's own row.
    window_rows
        Shape (window_count, 9); written where the row is stored.
    """
    for window in range(len(around)):
        node = nodes[window]
        column, place = (node_index[node, 0] >> 3) - first_block, node_index[node, 0] & 7
        for which in range(9):
            row = around[window, which]
            if row < 0:
                continue
            # The window's own block or the next: where one is there, so are the lanes of the other, empty or not.
            if number[row, column] >= 0:
                window_rows[window, which] = start[number[row, column]] + place
            elif column + 1 < number.shape[1] and number[row, column + 1] >= 0:
                window_rows[window, which] = start[number[row, column + 1]] + place - 8
        window_rows[window, 4] = node_lane[node]


@kernel(cached=False, inline="always")
def node_in_lane(lane, slot_of, node_in):
    """Node in a lane, -1 where there is none."""
    slot = slot_of[lane >> 3] - 1
    return node_in[8 * slot + (lane & 7)] if slot >= 0 else -1


@kernel(cached=False, inline="always")
def list_one(listed, count, one):
    """Insert a number among those that ascend, unless it is there; returns how many there are."""
    place = count
    while place > 0 and listed[place - 1] > one:
        place -= 1
    if place > 0 and listed[place - 1] == one:
        return count
    for other in range(count, place, -1):
        listed[other] = listed[other - 1]
    listed[place] = one
    return count + 1


@kernel
def windows_by_lanes(window_rows, starts, window_of):
    """Write the first lane of each window, and of every eight lanes the first window that holds some and one more.

    ``window_of``: zeros, shape (any,), written.
    """
    for window in range(len(window_rows)):
        start = window_rows[window, 4]
        starts[window] = start
        for lane in (start, start + 7):
            if window_of[lane >> 3] == 0:
                window_of[lane >> 3] = window + 1


@kernel(cached=False, inline="always")
def list_windows(low, high, starts, window_of, listed, count):
    """Insert the windows that hold lanes from a low to a high one among those that are listed; returns how many."""
    block = low >> 3
    window = window_of[block] - 1
    while window < 0 and 8 * block <= high:
        block += 1
        window = window_of[block] - 1
    while 0 <= window < len(starts) and starts[window] <= high:
        if starts[window] + 8 > low:
            count = list_one(listed, count, window)
        window += 1
    return count


@kernel
def windows_behind(window_rows, offsets, starts, window_of, behind, firsts):
    """List the windows with the other ends of the springs behind each window's lanes, descending.

    Parameters
    ----------
    window_rows
        Shape (window_count, 9).
    offsets
        Vector of each direction, shape (9, 3).
    starts, window_of
        As of :func:`windows_by_lanes`.
    behind, firsts
        Room for the lists, one after the other, shape (2 * 9 * window_count,), and for where they begin and the last
        ends; written. A window's lanes behind along a direction lie in two windows at most.

    Returns
    -------
    int
        Length of the longest list.
    """
    # Directions whose other ends lie in one row share its lanes; from the farthest row behind on.
    rows, lows, highs = np.empty(9, np.int64), np.empty(9, np.int64), np.empty(9, np.int64)
    row_count = 0
    for direction in range(len(offsets) - 1, -1, -1):
        row, i = 4 - offsets[direction, 1] - 3 * offsets[direction, 2], offsets[direction, 0]
        if row_count == 0 or rows[row_count - 1] != row:
            rows[row_count], lows[row_count], highs[row_count] = row, -i, 7 - i
            row_count += 1
        lows[row_count - 1] = min(lows[row_count - 1], -i)
        highs[row_count - 1] = max(highs[row_count - 1], 7 - i)
    listed = np.empty(2 * len(offsets) + 1, np.int32)
    end, longest = 0, 0
    for window in range(len(window_rows)):
        firsts[window] = end
        count = 0
        for which in range(row_count):
            lane = window_rows[window, rows[which]]
            count = list_windows(lane + lows[which], lane + highs[which], starts, window_of, listed, count)
        kept = 0
        for place in range(count - 1, -1, -1):
            if listed[place] != window:
                behind[end + kept] = listed[place]
                kept += 1
        end += kept
        longest = max(longest, kept)
    firsts[len(window_rows)] = end
    return longest
