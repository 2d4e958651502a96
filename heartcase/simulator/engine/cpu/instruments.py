"""Explicit springs in the CPU kernel, and those of a cut lattice whose ends lie anywhere: they pull before a step.

Nodes with such springs lie in groups of 8: one vector instruction works on a spring of each. Each spring is worked out
from both ends, so that no thread waits for another. Nodes of a group lie near each other in memory, and have about as
many springs; what a node has less than its group does not pull.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int64
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
    counts = np.diff(springs.first)
    nodes = np.flatnonzero(counts)
    nodes = nodes[np.argsort(layout.node_lane[nodes])]
    nodes = nodes[np.lexsort((-counts[nodes], np.arange(len(nodes)) // _NEAR))]
    group_count = -(-len(nodes) // LANE_COUNT)
    group, place = np.divmod(np.arange(len(nodes)), LANE_COUNT)
    lane = np.full((group_count, LANE_COUNT), EMPTY_START)
    lane[group, place] = layout.node_lane[nodes]
    window = np.repeat(layout.node_slot[nodes[::LANE_COUNT], None] // LANE_COUNT, LANE_COUNT, axis=1)
    window[group, place] = layout.node_slot[nodes] // LANE_COUNT
    longest = np.maximum.reduceat(counts[nodes], np.arange(0, len(nodes), LANE_COUNT)) if len(nodes) else counts[:0]
    first = np.concatenate([[0], np.cumsum(longest)]).astype(np.int64)

    other = np.repeat(lane, longest, axis=0)
    numbers = np.zeros((len(other), EXPLICIT_NUMBERS, LANE_COUNT), np.float32)
    # A spring that does not pull, of length one, to the node itself.
    numbers[:, [0, 3]] = 1.0
    of_node = np.repeat(np.arange(len(nodes)), counts[nodes])
    number = np.arange(len(of_node)) - np.repeat(np.cumsum(counts[nodes]) - counts[nodes], counts[nodes])
    spring = springs.first[nodes][of_node] + number
    row, column = first[group[of_node]] + number, place[of_node]
    other[row, column] = layout.node_lane[springs.other[spring]]
    numbers[row, :4, column] = springs.offset[spring]
    numbers[row, 4, column] = springs.excess[spring]
    numbers[row, 5, column] = springs.stiffness[spring]
    return ExplicitArrays(lane, window, first, other, numbers)


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
