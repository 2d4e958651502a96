"""Which blocks, windows and springs there are: kernels of :mod:`heartcase.simulator.engine.shared.lanes`."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = [
    "MOST_TOUCHED",
    "mark_blocks",
    "mark_irregular",
    "number_blocks",
    "rows_of_windows",
    "touched_windows",
    "windows_behind",
    "write_weights",
]

MOST_TOUCHED = 64
"""Windows that the corners of a window's cells can lie in: eight cells of eight corners."""


@kernel
def mark_blocks(node_index, row, layer, spring_nodes, first_block, layer_blocks, lanes, is_stored):
    """Mark the blocks of all nodes, and those at the same i as a node's spring over a block's end.

    Parameters
    ----------
    node_index, row, layer
        Index (i, j, k) of each node, number of its row along i, and its layer there.
    spring_nodes
        Both ends of each spring.
    first_block, layer_blocks, lanes
        First block along i, blocks of a layer, and lanes of a block.
    is_stored
        Shape (row_count, blocks of all layers), zeros at first; written.
    """
    for node in range(len(node_index)):
        is_stored[row[node], node_index[node, 0] // lanes - first_block + layer[node] * layer_blocks] = 1
    for spring in range(len(spring_nodes)):
        one, other = spring_nodes[spring, 0], spring_nodes[spring, 1]
        block, beyond = node_index[one, 0] // lanes, node_index[other, 0] // lanes
        if block != beyond:
            is_stored[row[one], beyond - first_block + layer[one] * layer_blocks] = 1
            is_stored[row[other], block - first_block + layer[other] * layer_blocks] = 1


@kernel
def number_blocks(is_stored, number, counts):
    """Number the blocks that are stored, and write how many follow each other in each run; returns both counts."""
    block_count, run_count = 0, 0
    for row in range(is_stored.shape[0]):
        is_run = False
        for column in range(is_stored.shape[1]):
            number[row, column] = -1
            if not is_stored[row, column]:
                is_run = False
                continue
            number[row, column] = block_count
            block_count += 1
            if not is_run:
                counts[run_count] = 0
                run_count += 1
            is_run = True
            counts[run_count - 1] += 1
    return block_count, run_count


@kernel
def rows_of_windows(around, columns, places, number, start, lanes, window_rows):
    """Write the lane at each window's first i in the rows around it, where layer 0 is stored there.

    Parameters
    ----------
    around
        Number of the nine rows around each window, -1 where there is none, shape (window_count, 9).
    columns, places
        Block of each window's first i, from the first on, and its place there.
    number, start
        Number of each block, -1 for none, shape as of :func:`mark_blocks`, and its first lane.
    lanes
        Lanes of a block.
    window_rows
        Shape (window_count, 9), written where the row is stored.
    """
    for window in range(len(around)):
        column = columns[window]
        for place in range(around.shape[1]):
            row = around[window, place]
            if row < 0:
                continue
            # The window's own block or the next: where one is there, so are the lanes of the other, empty or not.
            if number[row, column] >= 0:
                window_rows[window, place] = start[number[row, column]] + places[window]
            elif column + 1 < number.shape[1] and number[row, column + 1] >= 0:
                window_rows[window, place] = start[number[row, column + 1]] + places[window] - lanes


@kernel
def mark_irregular(spring_nodes, directions, offsets, is_near, node_lane, node_slot, window_rows, node_at, irregular):
    """Mark springs that the kernels do not find at both ends, or would take for another node's.

    Parameters
    ----------
    spring_nodes, directions, offsets
        Ends and direction of each spring, and vector of each direction, shape (9, 3).
    is_near
        Whether a node's window lies near copies.
    node_lane, node_slot, window_rows, node_at
        As of :class:`heartcase.simulator.engine.shared.lanes.LaneLayout`.
    irregular
        Shape (spring_count,), zeros at first; written.
    """
    node_count = len(node_lane)
    spring_of = np.full((len(offsets), node_count), -1, np.int32)
    for spring in range(len(spring_nodes)):
        lower, higher, direction = spring_nodes[spring, 0], spring_nodes[spring, 1], directions[spring]
        if is_near[lower] or is_near[higher]:
            i, row = offsets[direction, 0], offsets[direction, 1] + 3 * offsets[direction, 2]
            there = window_rows[node_slot[lower] // 8, 4 + row] + node_slot[lower] % 8 + i
            back = window_rows[node_slot[higher] // 8, 4 - row] + node_slot[higher] % 8 - i
            if there != node_lane[higher] or back != node_lane[lower]:
                irregular[spring] = True
                continue
        spring_of[direction, lower] = spring
    for node in range(node_count):
        if not is_near[node]:
            continue
        for direction in range(len(offsets)):
            i, row = offsets[direction, 0], offsets[direction, 1] + 3 * offsets[direction, 2]
            behind = node_at[window_rows[node_slot[node] // 8, 4 - row] + node_slot[node] % 8 - i]
            if behind < 0:
                continue
            found = spring_of[direction, behind]
            if found >= 0 and spring_nodes[found, 1] != node:
                irregular[found] = True


@kernel(cached=False)
def _list_one(listed, count, one):
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
def touched_windows(windows, window_of_cell, touches, counts):
    """List the windows of nodes that the cells of each window have corners in, ascending.

    Parameters
    ----------
    windows
        Window of each cell's corners, shape (cell_count, 8).
    window_of_cell
        Window of cells of each, shape (cell_count,).
    touches, counts
        Room for the lists, shape (count, MOST_TOUCHED), and zeros at first, shape (count,); written.
    """
    for cell in range(len(windows)):
        window = window_of_cell[cell]
        for corner in range(8):
            counts[window] = _list_one(touches[window], counts[window], windows[cell, corner])


@kernel
def windows_behind(window_rows, offsets, window_of_lane, lanes, behind, counts):
    """List the windows with the other ends of the springs behind each window's lanes, descending.

    Parameters
    ----------
    window_rows
        Shape (window_count, 9).
    offsets
        Vector of each direction, shape (9, 3).
    window_of_lane
        Window that each lane is of, or -1.
    lanes
        Lanes of a window.
    behind, counts
        Room for the lists, shape (window_count, 9 lanes), and for their lengths, shape (window_count,); written.
    """
    listed = np.empty(behind.shape[1], np.int32)
    for window in range(len(window_rows)):
        count = 0
        for direction in range(len(offsets)):
            row = 4 - offsets[direction, 1] - 3 * offsets[direction, 2]
            first = window_rows[window, row] - offsets[direction, 0]
            for lane in range(lanes):
                other = window_of_lane[first + lane]
                if other >= 0 and other != window:
                    count = _list_one(listed, count, other)
        for place in range(count):
            behind[window, place] = listed[count - 1 - place]
        counts[window] = count


@kernel
def write_weights(spring_nodes, directions, values, irregular, node_lane, stride, weight):
    """Write values of the springs that are not irregular, at the lane of their lower node.

    Parameters
    ----------
    spring_nodes, directions, values, irregular
        Of the springs.
    node_lane
        Lane of each node.
    stride
        Distance from a lane's number to its next.
    weight
        Nine numbers a lane; written.
    """
    for spring in range(len(spring_nodes)):
        if not irregular[spring]:
            weight[stride * directions[spring] + node_lane[spring_nodes[spring, 0]]] = values[spring]
