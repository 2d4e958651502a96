"""Which springs kernels do not find at fixed distances, and the stiffness of those that they do find.

Springs lie in the order of their lower ends.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.engine.shared.lane_kernels import U, node_in_lane
from heartcase.simulator.lattice.model import DIRECTIONS

__all__ = ["copy_from_windows", "find_irregular", "leave_out", "weigh_windows"]


@kernel
def find_irregular(
    spring_nodes, directions, first, corners, near_cells, is_near, node_lane, node_slot, window_rows, slot_of, node_in
):
    """Springs that the kernels do not find at both ends, or would take for another node's, ascending.

    Parameters
    ----------
    spring_nodes, directions, first
        Ends and direction of each spring, and as of :func:`weigh_windows`.
    corners, near_cells
        Nodes of the cells, and the cells near copies.
    is_near, node_lane, node_slot, window_rows, slot_of, node_in
        As of :class:`heartcase.simulator.engine.shared.lanes.LaneLayout`.
    """
    offsets = np.empty((len(DIRECTIONS), 2), np.int64)
    offsets[:, 0], offsets[:, 1] = DIRECTIONS[:, 0], DIRECTIONS[:, 1] + 3 * DIRECTIONS[:, 2]
    irregular = np.zeros(len(spring_nodes), np.bool_)
    found, count = np.empty(len(spring_nodes), np.int64), 0
    # Node that a spring leads to from each node beside these along each direction, where it is found at both ends.
    fitting = np.empty((len(is_near), len(DIRECTIONS)), np.int32)
    # A spring that ends near copies lies in a cell there.
    is_beside = np.zeros(len(is_near), np.bool_)
    for cell in near_cells:
        for corner in range(8):
            is_beside[U(corners[U(cell), U(corner)])] = True
    for lower in range(len(is_beside)):
        if not is_beside[lower]:
            continue
        slot, is_near_lower = node_slot[lower], is_near[lower]
        fitting[lower] = -1
        for spring in range(first[lower], first[lower + 1]):
            higher, way = U(spring_nodes[U(spring), 1]), U(directions[U(spring)])
            if not (is_near_lower or is_near[higher]):
                continue
            i, row = offsets[way, U(0)], offsets[way, U(1)]
            there = window_rows[U(slot >> 3), U(4 + row)] + (slot & 7) + i
            back = window_rows[U(node_slot[higher] >> 3), U(4 - row)] + (node_slot[higher] & 7) - i
            if there != node_lane[higher] or back != node_lane[lower]:
                irregular[U(spring)] = True
                found[U(count)] = spring
                count += 1
            else:
                fitting[U(lower), way] = higher
    for node in range(len(is_near)):
        if not is_near[node]:
            continue
        slot = node_slot[node]
        for direction in range(len(DIRECTIONS)):
            i, row = offsets[U(direction), U(0)], offsets[U(direction), U(1)]
            lane = window_rows[U(slot >> 3), U(4 - row)] + (slot & 7) - i
            behind = node_in_lane(lane, slot_of, node_in)
            # Of the springs that are found at both ends one at most leads from a node along a direction.
            if behind < 0 or (is_beside[U(behind)] and fitting[U(behind), U(direction)] == node):
                continue
            for spring in range(first[behind], first[behind + 1]):
                if directions[spring] == direction and spring_nodes[spring, 1] != node and not irregular[spring]:
                    irregular[spring] = True
                    found[count] = spring
                    count += 1
    return np.sort(found[:count])


@kernel
def weigh_windows(spring_nodes, directions, values, scale, node_slot, numbers, first):
    """Write values of the springs, times a number, by the window of their lower node.

    Parameters
    ----------
    spring_nodes, directions, values, scale
        Of the springs.
    node_slot
        Number of each node's window times 8 plus its place there.
    numbers
        Nine or more numbers of each window's lanes, shape (any, any, 8); written at the springs' directions.
    first
        Where the springs from each node begin, and the last end, shape (node_count + 1,); written.

    Returns
    -------
    bool
        Whether a spring's value is not zero.
    """
    flat, place = numbers.ravel(), np.empty(len(node_slot), np.uint32)
    for node in range(len(node_slot)):
        place[U(node)] = (node_slot[U(node)] >> 3) * numbers.shape[1] * 8 + (node_slot[node] & 7)
    acts = False
    first[:] = 0
    for spring in range(len(spring_nodes)):
        value, lower = values[spring] * scale, U(spring_nodes[spring, 0])
        acts |= value != 0
        flat[U(place[lower]) + U(8) * U(directions[spring])] = value
        first[lower + U(1)] = spring + 1
    for node in range(len(node_slot)):
        first[node + 1] = max(first[node], first[node + 1])
    return acts


@kernel
def leave_out(spring_nodes, directions, values, scale, irregular, first, node_slot, numbers):
    """Write zeros for springs that are irregular, but what another has that leads from the same node the same way.

    Parameters are those of :func:`weigh_windows`; ``irregular``: which are, ascending.
    """
    for spring in irregular:
        slot = node_slot[spring_nodes[spring, 0]]
        numbers[slot >> 3, directions[spring], slot & 7] = 0
    for number in range(len(irregular)):
        spring = irregular[number]
        lower = spring_nodes[spring, 0]
        if number and spring_nodes[irregular[number - 1], 0] == lower:
            continue
        slot, at = node_slot[lower], number
        for other in range(first[lower], first[lower + 1]):
            if at < len(irregular) and irregular[at] == other:
                at += 1
            else:
                numbers[slot >> 3, directions[other], slot & 7] = values[other] * scale


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
