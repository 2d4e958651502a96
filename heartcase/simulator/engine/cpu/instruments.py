"""Explicit springs in the CPU kernel, and those of a cut lattice whose ends lie anywhere: they pull before a step.

Nodes with such springs lie in groups of 8: one vector instruction works on a spring of each. Each spring is worked out
from both ends, so that no thread waits for another. Nodes of a group lie near each other in memory, and have about as
many springs; what a node has less than its group does not pull.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from heartcase.compiling.emitting import array_data, counted, nothing, room_with
from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int64
from heartcase.simulator.engine.cpu.chunks import ChunkArrays
from heartcase.simulator.engine.cpu.vector_ir import Lanes
from heartcase.simulator.engine.shared.lanes import BANK_LANES, EMPTY_START, LANE_COUNT, LaneLayout
from heartcase.simulator.lattice.explicit_springs import SpringsByNode

__all__ = ["Constants", "ExplicitArrays", "explicit_arrays", "pull_explicitly"]

Constants = tuple[np.float32, ...]

_NUMBERS = 6
"""Numbers of a spring: offset along x, y, z, rest length, excess, stiffness."""
_NEAR = 8 * LANE_COUNT
"""Nodes that follow each other in memory, of which those with as many springs share groups."""
_TINY = 1e-30
"""Keeps the division defined where two nodes lie on one spot."""
_INDEX = ir.IntType(64)


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
    numbers = np.zeros((len(other), _NUMBERS, LANE_COUNT), np.float32)
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


@intrinsic
def _pull_of_group(typing_context, now, lane, other, numbers, pull, group, first, end):
    """Write the pull of the springs from ``first`` to before ``end`` on the nodes of a group, shape (3, 8)."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:5], arguments, strict=False)
        u, own_lanes, lanes, n, result = (array_data(context, builder, *pair) for pair in arrays)
        own = _vectors_at(builder, u, own_lanes, arguments[5])
        total = [room_with(builder, Lanes.filled(builder, 0.0).value) for _ in range(3)]
        with counted(builder, arguments[6], arguments[7]) as (spring, _):
            there = _vectors_at(builder, u, lanes, spring)
            offset = [Lanes.of_window(builder, n, spring, axis, _NUMBERS) for axis in range(3)]
            length, excess, stiffness = (Lanes.of_window(builder, n, spring, which, _NUMBERS) for which in (3, 4, 5))
            moved = [there[axis] - own[axis] for axis in range(3)]
            d = [offset[axis] + moved[axis] for axis in range(3)]
            square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + _TINY
            e = excess
            for axis in range(3):
                e = e + (offset[axis] + d[axis]) * moved[axis]
            tension = stiffness * e / (square + length * square.root())
            for axis in range(3):
                before = Lanes(builder, builder.load(total[axis]))
                builder.store((before + tension * d[axis]).value, total[axis])
        for axis in range(3):
            place = builder.gep(result, [ir.Constant(_INDEX, axis * LANE_COUNT)])
            Lanes(builder, builder.load(total[axis])).store(place)
        return nothing(context)

    return types.void(now, lane, other, numbers, pull, types.int64, types.int64, types.int64), codegen


def _vectors_at(builder: Any, displacement: Any, lanes: Any, row: Any) -> list[Lanes]:
    """The displacements at a row of lanes that lie anywhere."""
    start = builder.mul(row, ir.Constant(_INDEX, LANE_COUNT))
    places = [
        builder.load(builder.gep(lanes, [builder.add(start, ir.Constant(_INDEX, place))]))
        for place in range(LANE_COUNT)
    ]
    return [
        Lanes.gathered(
            builder,
            [
                builder.gep(displacement, [builder.add(place, ir.Constant(_INDEX, axis * BANK_LANES))])
                for place in places
            ],
        )
        for axis in range(3)
    ]


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
        _pull_of_group(now, lane, other, numbers, pull, group, first[group], first[group + 1])
        for place in range(LANE_COUNT):
            own = lane[group, place]
            if own == EMPTY_START or chunk_of[windows[group, place]] != chunk:
                continue
            scale = constants[2] / constants[1] * inverse_mass[own]
            for axis in range(3):
                velocity[axis * BANK_LANES + own] += scale * pull[axis, place]
