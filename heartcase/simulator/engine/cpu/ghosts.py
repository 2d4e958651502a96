"""Ghosts in the CPU kernel: the corners of irregular cells, in lanes of their own.

A ghost goes where its node goes, and what acts on it acts on its node. So the cells of their windows are worked out as
all others are. What differs is the mean strain around a node that has ghosts: their cells are added to it one by one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int8, Int64
from heartcase.simulator.engine.shared.lanes import BANK_LANES, GHOST_CELLS, LANE_COUNT, SHARE_NUMBERS, CellLayout
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
    """Lane of each ghost, GHOST_CELLS cells to a window, shape (irregular_count * 8,)."""
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


_GHOSTS = 8 * GHOST_CELLS
"""Ghosts of a window."""


def ghost_arrays(model: LatticeModel, cells: CellLayout) -> GhostArrays:
    """The ghosts of a layout."""
    layout = cells.layout
    nodes = model.cell_corners[layout.irregular_cells].astype(np.int64).ravel()
    ghosted = np.unique(nodes)
    ghosted = ghosted[np.argsort(layout.node_lane[ghosted])]
    place = np.full(model.node_count, -1)
    place[ghosted] = np.arange(len(ghosted))
    by_node = np.argsort(place[nodes], kind="stable")
    count = len(ghosted)
    node_first = np.searchsorted(layout.node_slot[ghosted] // LANE_COUNT, np.arange(layout.window_count + 1))
    has_ghosts = np.diff(node_first) > 0
    return GhostArrays(
        first_window=cells.ghost_window,
        lane=cells.ghost_lane.ravel(),
        of_lane=layout.node_lane[nodes],
        node_first=node_first,
        node_lane=layout.node_lane[ghosted],
        window_number=np.where(has_ghosts, np.cumsum(has_ghosts) - 1, -1),
        ghost_first=np.searchsorted(place[nodes][by_node], np.arange(count + 1)),
        ghost_number=by_node,
        cell_lane=np.repeat(cells.cell_lane[layout.irregular_cells], 8),
    )


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
