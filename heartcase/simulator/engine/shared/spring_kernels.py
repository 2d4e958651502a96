"""Which springs kernels do not find at fixed distances, and the stiffness of those that they do find.

Springs lie in the order of their lower ends.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.engine.shared.lane_kernels import node_in_lane
from heartcase.simulator.lattice.model import DIRECTIONS

__all__ = ["copy_from_windows", "find_irregular", "first_springs", "weigh_windows"]


@kernel
def first_springs(spring_nodes, first):
    """Write where the springs from each node begin, and the last end, shape (node_count + 1,)."""
    last = -1
    for spring in range(len(spring_nodes)):
        lower = spring_nodes[spring, 0]
        while last < lower:
            last += 1
            first[last] = spring
    first[last + 1 :] = len(spring_nodes)


@kernel
def find_irregular(
    spring_nodes, directions, first, corners, near_cells, is_near, node_lane, node_slot, window_rows, slot_of, node_in
):
    """Springs that the kernels do not find at both ends, or would take for another node's, ascending.

    Parameters
    ----------
    spring_nodes, directions, first
        Ends and direction of each spring, and as of :func:`first_springs`.
    corners, near_cells
        Nodes of the cells, and the cells near copies.
    is_near, node_lane, node_slot, window_rows, slot_of, node_in
        As of :class:`heartcase.simulator.engine.shared.lanes.LaneLayout`.
    """
    irregular = np.zeros(len(spring_nodes), np.bool_)
    found, count = np.empty(len(spring_nodes), np.int64), 0
    # Node that a spring leads to from each node beside these along each direction, where it is found at both ends.
    fitting = np.empty((len(is_near), len(DIRECTIONS)), np.int32)
    # A spring that ends near copies lies in a cell there.
    is_beside = np.zeros(len(is_near), np.bool_)
    for cell in near_cells:
        for corner in range(8):
            is_beside[corners[cell, corner]] = True
    for lower in range(len(is_beside)):
        if not is_beside[lower]:
            continue
        slot, is_near_lower = node_slot[lower], is_near[lower]
        fitting[lower] = -1
        for spring in range(first[lower], first[lower + 1]):
            higher, direction = spring_nodes[spring, 1], directions[spring]
            if not (is_near_lower or is_near[higher]):
                continue
            i, row = DIRECTIONS[direction, 0], DIRECTIONS[direction, 1] + 3 * DIRECTIONS[direction, 2]
            there = window_rows[slot >> 3, 4 + row] + (slot & 7) + i
            back = window_rows[node_slot[higher] >> 3, 4 - row] + (node_slot[higher] & 7) - i
            if there != node_lane[higher] or back != node_lane[lower]:
                irregular[spring] = True
                found[count] = spring
                count += 1
            else:
                fitting[lower, direction] = higher
    for node in range(len(is_near)):
        if not is_near[node]:
            continue
        slot = node_slot[node]
        for direction in range(len(DIRECTIONS)):
            i, row = DIRECTIONS[direction, 0], DIRECTIONS[direction, 1] + 3 * DIRECTIONS[direction, 2]
            behind = node_in_lane(window_rows[slot >> 3, 4 - row] + (slot & 7) - i, slot_of, node_in)
            # Of the springs that are found at both ends one at most leads from a node along a direction.
            if behind < 0 or (is_beside[behind] and fitting[behind, direction] == node):
                continue
            for spring in range(first[behind], first[behind + 1]):
                if directions[spring] == direction and spring_nodes[spring, 1] != node and not irregular[spring]:
                    irregular[spring] = True
                    found[count] = spring
                    count += 1
    return np.sort(found[:count])


@kernel
def weigh_windows(spring_nodes, directions, values, scale, irregular, node_slot, numbers):
    """Write values of the springs that are not irregular, times a number, by the window of their lower node.

    Parameters
    ----------
    spring_nodes, directions, values, scale, irregular
        Of the springs; and which are irregular, ascending.
    node_slot
        Number of each node's window times 8 plus its place there.
    numbers
        Nine or more numbers of each window's lanes, shape (any, any, 8); written at the springs' directions.

    Returns
    -------
    bool
        Whether a spring's value is not zero.
    """
    flat, place = numbers.ravel(), np.empty(len(node_slot), np.uint32)
    for node in range(len(node_slot)):
        place[node] = (node_slot[node] >> 3) * numbers.shape[1] * 8 + (node_slot[node] & 7)
    acts = False
    # Numbers without a sign are not looked at for counting from the end.
    for spring in range(len(spring_nodes)):
        value = values[spring] * scale
        acts |= value != 0
        flat[np.uint64(place[np.uint32(spring_nodes[spring, 0])]) + np.uint64(8) * np.uint64(directions[spring])] = (
            value
        )
    for spring in irregular:
        flat[place[spring_nodes[spring, 0]] + 8 * directions[spring]] = 0
    # One that is not irregular may lead along the same direction.
    for number in range(len(irregular)):
        spring = irregular[number]
        for way in (-1, 1):
            other, at = spring + way, number + way
            while 0 <= other < len(spring_nodes):
                if spring_nodes[other, 0] != spring_nodes[spring, 0] or directions[other] != directions[spring]:
                    break
                if 0 <= at < len(irregular) and irregular[at] == other:
                    at += way
                else:
                    value = values[other] * scale
                    flat[place[spring_nodes[other, 0]] + 8 * directions[other]] = value
                other += way
    return acts


@kernel
def copy_from_windows(numbers, rows, stride, count, array):
    """Copy the first so many numbers of each window's lanes to where these lie.

    Parameters
    ----------
    numbers
        Shape (any, count or more, 8).
    rows
        Rows of the windows, shape (window_count, 9).
    stride, count
        Distance from a lane's number to its next, and how many are copied.
    array
        So many numbers a lane; written.
    """
    for window in range(len(rows)):
        for number in range(count):
            start = number * stride + rows[window, 4]
            for place in range(8):
                array[start + place] = numbers[window, number, place]
