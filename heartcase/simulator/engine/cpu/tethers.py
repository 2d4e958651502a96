"""Tethers in the CPU kernel: before a step they pull at their nodes, and tissue at both ends sleeps or wakes together.

What each tether pulls with is worked out once, by one thread, and read by all after the barrier.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int64
from heartcase.simulator.engine.cpu.barrier import raise_to
from heartcase.simulator.engine.cpu.chunks import ChunkArrays
from heartcase.simulator.engine.cpu.instruments import Constants
from heartcase.simulator.engine.cpu.sleep import PULLED, SleepArrays
from heartcase.simulator.engine.shared.lanes import BANK_LANES, LANE_COUNT, LaneLayout
from heartcase.simulator.lattice.tethers import END_NODES, Tethers, TethersByNode

__all__ = ["TetherArrays", "keep_both_ends_awake", "pull_by_tethers", "stretch_tethers", "tether_arrays"]


class TetherArrays(NamedTuple):
    """Tethers as the kernel reads them."""

    lanes: Int64
    """Lanes of the nodes of each, shape (count, 16)."""
    windows: Int64
    """Windows of these, shape (count, 16)."""
    shares: Float32
    """Their shares, shape (count, 16)."""
    shapes: Float32
    """As of :meth:`heartcase.simulator.lattice.tethers.Tethers.shapes`, shape (count, 8)."""
    pull: Float32
    """Room for the tension of each times its unit vector, shape (count, 3)."""
    node_lanes: Int64
    """Lanes of the nodes at which one pulls, shape (node_count,)."""
    node_windows: Int64
    """Windows of these, shape (node_count,)."""
    first: Int64
    """Where the tethers of each begin, and the last end, shape (node_count + 1,)."""
    number: Int64
    """Tether, shape (any,)."""
    share: Float32
    """The node's share in it, shape (any,)."""


def tether_arrays(layout: LaneLayout, tethers: Tethers) -> TetherArrays:
    """Tethers in a layout."""
    if not tethers.count:
        return _nothing_tied()
    by_node = TethersByNode.of(tethers)
    window_of = layout.node_slot // LANE_COUNT
    return TetherArrays(
        layout.node_lane[tethers.nodes],
        window_of[tethers.nodes],
        tethers.shares,
        tethers.shapes(),
        np.zeros((tethers.count, 3), np.float32),
        layout.node_lane[by_node.nodes],
        window_of[by_node.nodes],
        by_node.first,
        by_node.number.astype(np.int64),
        by_node.share.astype(np.float32),
    )


def _nothing_tied() -> TetherArrays:
    lanes, shares = np.zeros((0, 2 * END_NODES), np.int64), np.zeros((0, 2 * END_NODES), np.float32)
    shapes, pull = np.zeros((0, 8), np.float32), np.zeros((0, 3), np.float32)
    nodes, first, numbers = np.zeros(0, np.int64), np.zeros(1, np.int64), np.zeros(0, np.float32)
    return TetherArrays(lanes, lanes, shares, shapes, pull, nodes, nodes, first, nodes, numbers)


@kernel
def stretch_tethers(thread: int, thread_count: int, now: Float32, row_step: int, tethers: TetherArrays) -> None:
    """Write what a thread's part of the tethers pulls with in a step of a row."""
    lanes, shares, shapes, pull = tethers.lanes, tethers.shares, tethers.shapes, tethers.pull
    for tether in range(thread, len(lanes), thread_count):
        x, y, z = shapes[tether, 0], shapes[tether, 1], shapes[tether, 2]
        for place in range(lanes.shape[1]):
            lane, share = lanes[tether, place], shares[tether, place]
            x += share * now[lane]
            y += share * now[BANK_LANES + lane]
            z += share * now[2 * BANK_LANES + lane]
        distance = np.sqrt(x * x + y * y + z * z)
        passed = np.float32(row_step)
        stretch = distance - (shapes[tether, 4] + passed * shapes[tether, 6])
        over = np.float32(0)
        if stretch > 0 and distance > 0:
            most = shapes[tether, 5] + passed * shapes[tether, 7]
            over = min(shapes[tether, 3] * stretch, most) / distance
        pull[tether, 0], pull[tether, 1], pull[tether, 2] = over * x, over * y, over * z


@kernel
def pull_by_tethers(
    chunk: int,
    velocity: Float32,
    inverse_mass: Float32,
    tethers: TetherArrays,
    constants: Constants,
    chunks: ChunkArrays,
) -> None:
    """Give a chunk's velocities before a step what the tethers will add to them in it.

    The step keeps a part of the velocity, so they are given the more.
    """
    node_lanes, first, number, share, pull = (
        tethers.node_lanes,
        tethers.first,
        tethers.number,
        tethers.share,
        tethers.pull,
    )
    for node in range(len(node_lanes)):
        if chunks.chunk_of[tethers.node_windows[node]] != chunk:
            continue
        x, y, z = np.float32(0), np.float32(0), np.float32(0)
        for at in range(first[node], first[node + 1]):
            tether = number[at]
            x -= share[at] * pull[tether, 0]
            y -= share[at] * pull[tether, 1]
            z -= share[at] * pull[tether, 2]
        lane = node_lanes[node]
        scale = constants[2] / constants[1] * inverse_mass[lane]
        velocity[lane] += scale * x
        velocity[BANK_LANES + lane] += scale * y
        velocity[2 * BANK_LANES + lane] += scale * z


@kernel
def keep_both_ends_awake(tethers: TetherArrays, sleep: SleepArrays) -> None:
    """After a check, mark the blocks at both ends of a tether as moving where one of them is, or it is being drawn."""
    windows, shapes = tethers.windows, tethers.shapes
    for tether in range(len(windows)):
        is_moving = shapes[tether, 6] != 0 or shapes[tether, 7] != 0
        for place in range(windows.shape[1]):
            for block in sleep.blocks_of_window[windows[tether, place]]:
                if sleep.is_moving[block]:
                    is_moving = True
        if is_moving:
            for place in range(windows.shape[1]):
                for block in sleep.blocks_of_window[windows[tether, place]]:
                    raise_to(sleep.is_moving, block, PULLED)
