"""Ghosts in the CPU kernel: the corners of irregular cells, in lanes of their own.

A ghost goes where its node goes, and what acts on it acts on its node. So the cells of their windows are worked out as
all others are. What differs is the mean strain around a node: it is taken over all its cells, wherever they lie.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32
from heartcase.simulator.engine.cpu.arrays import GhostArrays, SharingArrays
from heartcase.simulator.engine.shared.lanes import BANK_LANES, GHOST_CELLS, LANE_COUNT, SHARE_NUMBERS, CellLayout
from heartcase.simulator.lattice.model import LatticeModel

__all__ = [
    "add_ghost_forces",
    "clear_ghost_forces",
    "follow_nodes",
    "ghost_arrays",
    "mean_around_ghosts",
    "share_with_ghosts",
]

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
    used = np.flatnonzero((place[model.cell_corners] >= 0).any(axis=1)) if len(ghosted) else np.zeros(0, np.int64)
    corners = place[model.cell_corners[used]].ravel()
    cell, corner = np.repeat(used, 8), np.tile(np.arange(8), len(used))
    is_ghosted = corners >= 0
    by_place = np.flatnonzero(is_ghosted)[np.argsort(corners[is_ghosted], kind="stable")]
    count = len(ghosted)
    return GhostArrays(
        first_window=cells.ghost_window,
        lane=cells.ghost_lane.ravel(),
        of_lane=layout.node_lane[nodes],
        node_first=np.searchsorted(layout.node_slot[ghosted] // LANE_COUNT, np.arange(layout.window_count + 1)),
        node_lane=layout.node_lane[ghosted],
        ghost_first=np.searchsorted(place[nodes][by_node], np.arange(count + 1)),
        ghost_number=by_node,
        cell_first=np.searchsorted(corners[by_place], np.arange(count + 1)),
        cell_place=np.stack([cells.cell_lane[cell[by_place]], corner[by_place]], axis=1),
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
def mean_around_ghosts(window: int, sharing: SharingArrays, ghosts: GhostArrays) -> None:
    """Write the mean gradient around the nodes of a window that have ghosts, where their stress will be."""
    gradient, shares, mean = sharing.gradient, sharing.shares, sharing.stress
    for node in range(ghosts.node_first[window], ghosts.node_first[window + 1]):
        lane = ghosts.node_lane[node]
        inverse = gradient[SHARE_NUMBERS * BANK_LANES + lane]
        for number in range(SHARE_NUMBERS):
            total = np.float32(0)
            for place in range(ghosts.cell_first[node], ghosts.cell_first[node + 1]):
                cell, corner = ghosts.cell_place[place]
                total += shares[corner * BANK_LANES + cell] * gradient[number * BANK_LANES + cell]
            mean[number * BANK_LANES + lane] = total * inverse


@kernel
def share_with_ghosts(window: int, sharing: SharingArrays, ghosts: GhostArrays) -> None:
    """Write the stress of the mean strain around the ghosts of a window's nodes: that around the nodes."""
    stress = sharing.stress
    for node in range(ghosts.node_first[window], ghosts.node_first[window + 1]):
        for place in range(ghosts.ghost_first[node], ghosts.ghost_first[node + 1]):
            ghost = ghosts.lane[ghosts.ghost_number[place]]
            for number in range(SHARE_NUMBERS):
                stress[number * BANK_LANES + ghost] = stress[number * BANK_LANES + ghosts.node_lane[node]]
