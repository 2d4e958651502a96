"""Ghosts in the CPU kernel: the corners of irregular cells, in lanes of their own.

A ghost goes where its node goes, and what acts on it acts on its node. So the cells of their windows are worked out as
all others are. What differs is the mean strain around a node that has ghosts: their cells are added to it one by one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int8, Int32, Int64
from heartcase.simulator.engine.shared.cell_lanes import CellLayout
from heartcase.simulator.engine.shared.lanes import BANK_LANES, CELL_LANES, GHOST_CELLS, LANE_COUNT, SHARE_NUMBERS
from heartcase.simulator.lattice.model import LatticeModel

__all__ = [
    "GhostArrays",
    "add_ghost_forces",
    "clear_ghost_forces",
    "follow_movements",
    "follow_nodes",
    "ghost_arrays",
    "share_with_ghosts",
    "sum_of_ghosts",
]


class GhostArrays(NamedTuple):
    """Ghosts of the corners of irregular cells; of length 0 where there are none."""

    first_window: int
    """First window of cells that holds them."""
    lane: Int64
    """Lane of each ghost, by the cell and then the corner, shape (irregular_count * 8,)."""
    of_lane: Int64
    """Lane of its node, the same."""
    node_first: Int64
    """Where the nodes of each window of nodes begin that have ghosts, and the last end, shape (window_count + 1,)."""
    node_lane: Int64
    """Their lanes, shape (ghosted_count,)."""
    window_number: Int64
    """Number of each window of nodes among those that have such nodes, or -1, shape (window_count,)."""
    ghost_first: Int64
    """Where their ghosts begin, and the last end, shape (ghosted_count + 1,)."""
    ghost_number: Int64
    """Numbers of their ghosts, shape (irregular_count * 8,)."""
    cell_lane: Int64
    """Lane of each ghost's cell, by the cell and then the corner, shape (irregular_count * 8,)."""


_GHOSTS = 8 * GHOST_CELLS * (CELL_LANES // LANE_COUNT)
"""Ghosts of a window of cells."""


def ghost_arrays(model: LatticeModel, cells: CellLayout) -> GhostArrays:
    """The ghosts of a layout."""
    layout, irregular = cells.layout, cells.layout.irregular_cells
    ghost_count, window_count = 8 * len(irregular), layout.window_count
    of_lane, cell_lane = np.empty(ghost_count, np.int64), np.empty(ghost_count, np.int64)
    node_first, window_number = np.zeros(window_count + 1, np.int64), np.full(window_count, -1)
    node_lane, ghost_first = np.empty(ghost_count, np.int64), np.zeros(ghost_count + 1, np.int64)
    ghost_number = np.empty(ghost_count, np.int64)
    nodes = (model.cell_corners, irregular, layout.node_lane, layout.node_slot, layout.slots.by_lane)
    found = (of_lane, cell_lane, node_first, window_number, node_lane, ghost_first, ghost_number)
    count = _sort_ghosts(*nodes, cells.cell_lane, *found) if ghost_count else 0
    return GhostArrays(
        first_window=cells.ghost_window,
        lane=cells.ghost_lane.ravel(),
        of_lane=of_lane,
        node_first=node_first,
        node_lane=node_lane[:count].copy(),
        window_number=window_number,
        ghost_first=ghost_first[: count + 1].copy(),
        ghost_number=ghost_number,
        cell_lane=cell_lane,
    )


@kernel
def _sort_ghosts(
    corners: Int32,
    irregular: Int64,
    node_lanes: Int64,
    node_slot: Int64,
    by_lane: Int32,
    cell_lanes: Int64,
    of_lane: Int64,
    cell_lane: Int64,
    node_first: Int64,
    window_number: Int64,
    node_lane: Int64,
    ghost_first: Int64,
    ghost_number: Int64,
) -> int:
    """Write what GhostArrays has of the ghosts of irregular cells; returns how many nodes have some."""
    counts = np.zeros(len(node_lanes), np.int64)
    for place in range(len(irregular)):
        for corner in range(8):
            node = corners[irregular[place], corner]
            counts[node] += 1
            of_lane[8 * place + corner] = node_lanes[node]
            cell_lane[8 * place + corner] = cell_lanes[irregular[place]]
    count, window_count = 0, 0
    for node in by_lane:
        if not counts[node]:
            continue
        window = node_slot[node] >> 3
        if window_number[window] < 0:
            window_number[window] = window_count
            window_count += 1
        node_first[window + 1] += 1
        node_lane[count] = node_lanes[node]
        ghost_first[count + 1] = ghost_first[count] + counts[node]
        # From here on where the next of the node's ghosts is put.
        counts[node] = ghost_first[count]
        count += 1
    for window in range(len(window_number)):
        node_first[window + 1] += node_first[window]
    for place in range(len(irregular)):
        for corner in range(8):
            node = corners[irregular[place], corner]
            ghost_number[counts[node]] = 8 * place + corner
            counts[node] += 1
    return count


@kernel
def follow_nodes(thread: int, thread_count: int, displacement: Float32, ghosts: GhostArrays) -> None:
    """Write the displacements of a thread's part of the ghosts."""
    count = len(ghosts.lane)
    for ghost in range(thread * count // thread_count, (thread + 1) * count // thread_count):
        for axis in range(3):
            displacement[axis * BANK_LANES + ghosts.lane[ghost]] = displacement[
                axis * BANK_LANES + ghosts.of_lane[ghost]
            ]


@kernel
def clear_ghost_forces(force: Float32, window: int, ghosts: GhostArrays) -> None:
    """Set the forces on the ghosts of a window of cells to zero."""
    first = _GHOSTS * (window - ghosts.first_window)
    for ghost in range(first, min(first + _GHOSTS, len(ghosts.lane))):
        for axis in range(3):
            force[axis * BANK_LANES + ghosts.lane[ghost]] = 0


@kernel
def add_ghost_forces(force: Float32, window: int, ghosts: GhostArrays) -> None:
    """Add the forces on the ghosts of a window of cells to those on their nodes."""
    first = _GHOSTS * (window - ghosts.first_window)
    for ghost in range(first, min(first + _GHOSTS, len(ghosts.lane))):
        for axis in range(3):
            force[axis * BANK_LANES + ghosts.of_lane[ghost]] += force[axis * BANK_LANES + ghosts.lane[ghost]]


@kernel
def sum_of_ghosts(
    window: int, start: int, gradient: Float32, shares: Float32, sums: Float32, ghosts: GhostArrays
) -> None:
    """Write what irregular cells add to the sums of gradients around the nodes of a window that starts at a lane."""
    for node in range(ghosts.node_first[window], ghosts.node_first[window + 1]):
        for number in range(SHARE_NUMBERS):
            total = np.float32(0)
            for place in range(ghosts.ghost_first[node], ghosts.ghost_first[node + 1]):
                cell = ghosts.cell_lane[ghosts.ghost_number[place]]
                total += shares[place] * gradient[number * BANK_LANES + cell]
            sums[ghosts.window_number[window], number, ghosts.node_lane[node] - start] = total


@kernel
def share_with_ghosts(window: int, stress: Float32, ghosts: GhostArrays) -> None:
    """Write the stress of the mean strain around the ghosts of a window's nodes: that around the nodes."""
    for node in range(ghosts.node_first[window], ghosts.node_first[window + 1]):
        for place in range(ghosts.ghost_first[node], ghosts.ghost_first[node + 1]):
            ghost = ghosts.lane[ghosts.ghost_number[place]]
            for number in range(SHARE_NUMBERS):
                stress[number * BANK_LANES + ghost] = stress[number * BANK_LANES + ghosts.node_lane[node]]


@kernel
def follow_movements(thread: int, thread_count: int, later: Float32, near: Int8, ghosts: GhostArrays) -> None:
    """Write where a thread's part of the ghosts are after a step, and which probes are near their nodes."""
    follow_nodes(thread, thread_count, later, ghosts)
    count = len(ghosts.lane)
    for ghost in range(thread * count // thread_count, (thread + 1) * count // thread_count):
        near[ghosts.lane[ghost]] = near[ghosts.of_lane[ghost]]
