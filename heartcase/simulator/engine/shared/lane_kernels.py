"""Which rows, blocks and windows there are: kernels of :mod:`heartcase.simulator.engine.shared.lanes`.

Blocks that are stored, and the empty one behind each run of them, are numbered in the order of their lanes: slots.
Tables with eight places a slot are short, where those with one a lane are not.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = [
    "U",
    "bounds",
    "lay_out_nodes",
    "list_windows",
    "mark_blocks",
    "mark_over_springs",
    "node_in_lane",
    "number_blocks",
    "number_rows",
    "ranges_behind",
    "rows_around",
    "rows_of_windows",
    "start_slots",
    "windows_by_lanes",
    "write_behind",
]

U = np.uint64
"""A place as a number without a sign: kernels do not look whether it counts from the end, and are the quicker."""


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
        block = (node_index[U(node), U(0)] >> 3) - first_block
        place = row[U(node)] * columns + layer[U(node)] * layer_blocks + block
        block_of[U(node)] = place
        flat[U(place)] = 1
    for cell in range(len(cells)):
        if cells[U(cell), U(0)] & 7 == 7:
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
    block_count, run_count, place = 0, 0, 0
    stored, slots = is_stored.ravel(), number.ravel()
    for _ in range(is_stored.shape[0]):
        length = 0
        for _ in range(is_stored.shape[1]):
            slots[U(place)] = -1
            if stored[U(place)]:
                run_count += length == 0
                length += 1
                slots[U(place)] = block_count + run_count - 1
                counts[U(run_count - 1)] = length
                block_count += 1
            else:
                length = 0
            place += 1
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
        node_in[U(8 * slots[U(block_of[U(node)])] + (node_index[U(node), U(0)] & 7))] = node
    count, end, place = 0, -1, 0
    for at in range(len(node_in)):
        node = node_in[U(at)]
        if node < 0:
            continue
        lane = start[U(at >> 3)] + (at & 7)
        if lane >= end:
            first[U(count)] = place
            count += 1
            end = lane + 8
        node_lane[U(node)] = lane
        node_slot[U(node)] = 8 * count + lane - end
        by_lane[U(place)] = node
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
    slot = slot_of[U(lane >> 3)] - 1
    return node_in[U(8 * slot + (lane & 7))] if slot >= 0 else -1


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


@kernel
def list_windows(ranges, starts, window_of, lists, firsts):
    """List the windows that hold some lanes, ascending.

    Parameters
    ----------
    ranges
        Number of a list, the first of some lanes and the last, by the list, shape (any, 3).
    starts, window_of
        As of :func:`windows_by_lanes`.
    lists, firsts
        Room for the lists, one after the other, and for where they begin and the last ends, shape (list_count + 1,);
        written.

    Returns
    -------
    int
        Length of the longest list.
    """
    window_count = len(starts)
    end, begin, longest, number = 0, 0, 0, -1
    for place in range(len(ranges)):
        which, low, high = ranges[U(place), U(0)], ranges[U(place), U(1)], ranges[U(place), U(2)]
        if which > number:
            longest, begin = max(longest, end - begin), end
            while number < which:
                number += 1
                firsts[U(number)] = end
        block = low >> 3
        window = window_of[U(block)] - 1
        while window < 0 and 8 * block <= high:
            block += 1
            window = window_of[U(block)] - 1
        while 0 <= window < window_count and starts[U(window)] <= high:
            if starts[U(window)] + 8 > low:
                at = end
                while at > begin and lists[U(at - 1)] > window:
                    at -= 1
                if at == begin or lists[U(at - 1)] != window:
                    for other in range(end, at, -1):
                        lists[U(other)] = lists[U(other - 1)]
                    lists[U(at)] = window
                    end += 1
            window += 1
    firsts[number + 1 :] = end
    return max(longest, end - begin)


@kernel
def ranges_behind(window_rows, offsets, ranges):
    """Write the lanes with the other ends of the springs behind each window's, for :func:`list_windows`.

    Parameters
    ----------
    window_rows
        Shape (window_count, 9).
    offsets
        Vector of each direction, shape (9, 3).
    ranges
        Shape (9 * window_count, 3); written.

    Returns
    -------
    int
        How many are written: directions whose other ends lie in one row share theirs.
    """
    rows, lows, highs = np.empty(9, np.int64), np.empty(9, np.int64), np.empty(9, np.int64)
    row_count = 0
    # From the farthest row behind on, so that windows mostly come in the order of their numbers.
    for direction in range(len(offsets) - 1, -1, -1):
        row, i = 4 - offsets[direction, 1] - 3 * offsets[direction, 2], offsets[direction, 0]
        if row_count == 0 or rows[row_count - 1] != row:
            rows[row_count], lows[row_count], highs[row_count] = row, -i, 7 - i
            row_count += 1
        lows[row_count - 1] = min(lows[row_count - 1], -i)
        highs[row_count - 1] = max(highs[row_count - 1], 7 - i)
    count = 0
    for window in range(len(window_rows)):
        for which in range(row_count):
            lane = window_rows[U(window), U(rows[U(which)])]
            ranges[U(count), U(0)] = window
            ranges[U(count), U(1)], ranges[U(count), U(2)] = lane + lows[U(which)], lane + highs[U(which)]
            count += 1
    return count


@kernel
def write_behind(lists, firsts, behind):
    """Write ascending lists into the rows of an array, descending, without a row's own number, and then -1."""
    flat, length = behind.ravel(), behind.shape[1]
    for row in range(len(behind)):
        at = row * length
        for place in range(firsts[U(row + 1)] - 1, firsts[U(row)] - 1, -1):
            if lists[U(place)] != row:
                flat[U(at)] = lists[U(place)]
                at += 1
        flat[at : (row + 1) * length] = -1
