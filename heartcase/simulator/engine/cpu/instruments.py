"""Explicit springs in the CPU kernel, and those of a cut lattice whose ends lie anywhere: they pull before a step.

Nodes with such springs lie in groups of 8: one vector instruction works on a spring of each. Each spring is worked out
from both ends, so that no thread waits for another. Nodes of a group lie near each other in memory, and have about as
many springs; what a node has less than its group does not pull.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int32, Int64
from heartcase.simulator.engine.cpu.chunks import ChunkArrays
from heartcase.simulator.engine.cpu.springs import EXPLICIT_NUMBERS, pull_of_group
from heartcase.simulator.engine.shared.lanes import BANK_LANES, EMPTY_START, LANE_COUNT, LaneLayout
from heartcase.simulator.lattice.explicit_springs import SpringsByNode

__all__ = ["Constants", "ExplicitArrays", "explicit_arrays", "pull_explicitly"]

Constants = tuple[np.float32, ...]

_NEAR = 8 * LANE_COUNT
"""Nodes that follow each other in memory, of which those with as many springs share groups."""


class ExplicitArrays(NamedTuple):
    """Groups of nodes with explicit springs; of length 0 where there are none."""

    lane: Int64
    """Lane of each node, an empty one where a group has less than 8, shape (group_count, 8)."""
    window: Int64
    """Its window, the first of its group's where it has less, shape (group_count, 8)."""
    first: Int64
    """Where the springs of each group begin, and the last end, shape (group_count + 1,)."""
    other: Int64
    """Lane at the other end of the springs, shape (any, 8)."""
    numbers: Float32
    """Offset, rest length, excess and stiffness of these, as of
    :class:`heartcase.simulator.lattice.explicit_springs.SpringsByNode`, shape (any, 6, 8)."""


def explicit_arrays(layout: LaneLayout, springs: SpringsByNode) -> ExplicitArrays:
    """Put the nodes with springs into groups."""
    nodes = np.empty(len(layout.node_lane) if len(springs.other) else 0, np.int32)
    count = _order_nodes(springs.first, layout.slots.by_lane, nodes) if len(nodes) else 0
    group_count = -(-count // LANE_COUNT)
    lane, window = np.empty((group_count, LANE_COUNT), np.int64), np.empty((group_count, LANE_COUNT), np.int64)
    first = np.zeros(group_count + 1, np.int64)
    row_count = _lay_out_groups(nodes[:count], springs.first, layout.node_lane, layout.node_slot, lane, window, first)
    other = np.empty((row_count, LANE_COUNT), np.int64)
    numbers = np.empty((row_count, EXPLICIT_NUMBERS, LANE_COUNT), np.float32)
    values = (springs.first, springs.other, springs.offset, springs.excess, springs.stiffness)
    _fill_groups(nodes[:count], *values, layout.node_lane, lane, first, other, numbers)
    return ExplicitArrays(lane, window, first, other, numbers)


@kernel
def _order_nodes(springs_first: Int32, by_lane: Int32, nodes: Int32) -> int:
    """List the nodes with springs by lane, and those near each other by how many they have, most first.

    Returns how many there are.
    """
    count = 0
    for node in by_lane:
        springs = springs_first[node + 1] - springs_first[node]
        if not springs:
            continue
        place = count
        while place % _NEAR:
            before = nodes[place - 1]
            if springs_first[before + 1] - springs_first[before] >= springs:
                break
            nodes[place] = before
            place -= 1
        nodes[place] = node
        count += 1
    return count


@kernel
def _lay_out_groups(
    nodes: Int32, springs_first: Int32, node_lane: Int64, node_slot: Int64, lane: Int64, window: Int64, first: Int64
) -> int:
    """Write lanes and windows of the groups' nodes, and where their springs begin; returns where the last end."""
    for group in range(len(lane)):
        longest = 0
        for place in range(LANE_COUNT):
            at = LANE_COUNT * group + place
            node = nodes[min(at, len(nodes) - 1)]
            is_there = at < len(nodes)
            lane[group, place] = node_lane[node] if is_there else EMPTY_START
            window[group, place] = node_slot[node] // LANE_COUNT if is_there else window[group, 0]
            if is_there:
                longest = max(longest, springs_first[node + 1] - springs_first[node])
        first[group + 1] = first[group] + longest
    end: int = first[len(lane)]
    return end


@kernel
def _fill_groups(
    nodes: Int32,
    springs_first: Int32,
    springs_other: Int32,
    offset: Float32,
    excess: Float32,
    stiffness: Float32,
    node_lane: Int64,
    lane: Int64,
    first: Int64,
    other: Int64,
    numbers: Float32,
) -> None:
    """Write the springs of the groups; of a node that has less than its group, some that do not pull: to itself."""
    numbers[:] = 0
    for group in range(len(lane)):
        for place in range(LANE_COUNT):
            at = LANE_COUNT * group + place
            start = springs_first[nodes[at]] if at < len(nodes) else 0
            count = springs_first[nodes[at] + 1] - start if at < len(nodes) else 0
            for row in range(first[group], first[group + 1]):
                spring = start + row - first[group]
                if row - first[group] >= count:
                    other[row, place] = lane[group, place]
                    numbers[row, 0, place] = numbers[row, 3, place] = 1
                    continue
                other[row, place] = node_lane[springs_other[spring]]
                for number in range(4):
                    numbers[row, number, place] = offset[spring, number]
                numbers[row, 4, place] = excess[spring]
                numbers[row, 5, place] = stiffness[spring]


@kernel
def pull_explicitly(
    chunk: int,
    now: Float32,
    velocity: Float32,
    inverse_mass: Float32,
    explicit: ExplicitArrays,
    constants: Constants,
    chunks: ChunkArrays,
) -> None:
    """Give a chunk's velocities before a step what the explicit springs will add to them in it.

    The step keeps a part of the velocity, so they are given the more.
    """
    lane, windows, first, other, numbers = explicit
    chunk_of = chunks.chunk_of
    pull = np.empty((3, LANE_COUNT), np.float32)
    for group in range(len(lane)):
        is_mine = False
        for place in range(LANE_COUNT):
            is_mine = is_mine or chunk_of[windows[group, place]] == chunk
        if not is_mine:
            continue
        pull_of_group(now, lane, other, numbers, pull, group, first[group], first[group + 1])
        for place in range(LANE_COUNT):
            own = lane[group, place]
            if own == EMPTY_START or chunk_of[windows[group, place]] != chunk:
                continue
            scale = constants[2] / constants[1] * inverse_mass[own]
            for axis in range(3):
                velocity[axis * BANK_LANES + own] += scale * pull[axis, place]
