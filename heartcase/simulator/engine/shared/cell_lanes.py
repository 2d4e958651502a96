"""The cells of a lattice in the lanes of its nodes, and what kernels read of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from heartcase.schemas.arrays import Float32, Int8, Int32, Int64
from heartcase.simulator.engine.shared.cell_kernels import (
    lay_out_cells,
    number_by_window,
    ranges_touched,
    share_by_node_window,
    write_lists,
)
from heartcase.simulator.engine.shared.lane_kernels import list_windows
from heartcase.simulator.engine.shared.lanes import (
    CELL_LANES,
    CELL_NUMBERS,
    CELL_PARTS,
    CORNER_ROWS,
    EMPTY_START,
    LaneLayout,
)
from heartcase.simulator.forces.cell_forces import tissue_spread
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["CellLayout", "cell_layout", "cell_numbers", "inverse_shared", "share_numbers"]


def cell_numbers(model: LatticeModel) -> Float32:
    """What the law's kernels read of each cell, shape (11, cell_count), float32.

    The covered stiffness [k/h], then for elements the means of x, y, z, yz, xz, xy and variances along x, y, z of the
    tissue [edges], for springs zeros; last the corner guard's stiffness [k/h].
    """
    numbers = np.zeros((CELL_NUMBERS, model.cell_count), np.float32)
    numbers[0] = model.cell_force_scale
    if model.law.is_element:
        moments = model.cell_moments.astype(np.float64)
        numbers[1:-1] = np.concatenate([moments[:, :3].T, moments[:, 6:].T, tissue_spread(moments).T])
    numbers[-1] = model.corner_guard_scale
    return numbers


def share_numbers(model: LatticeModel) -> Float32:
    """What of each cell's covered stiffness is strained by the mean around each of its corners, and what by itself.

    In k/h, shape (9, cell_count), float32.
    """
    shared = model.shared_stiffness
    own = model.cell_force_scale - shared.sum(axis=1)
    return np.concatenate([shared.T, own[None]])


def inverse_shared(model: LatticeModel) -> Float32:
    """Inverse of the stiffness that shares strain around each node [h/k], zero where none does, (node_count,)."""
    shared = np.bincount(model.cell_corners.ravel(), model.shared_stiffness.ravel(), minlength=model.node_count)
    return np.divide(1.0, shared, out=np.zeros_like(shared), where=shared > 0.0).astype(np.float32)


@dataclass(frozen=True)
class CellLayout:
    """Where the cells are: each in the lane of its lowest corner, or of that corner's ghost."""

    layout: LaneLayout
    """Of the nodes."""
    cell_lane: Int64
    """Lane of each cell, shape (cell_count,)."""
    cell_slot: Int64
    """Number of the cell's window times CELL_LANES plus its place there, shape (cell_count,)."""
    window_rows: Int64
    """Lane at the first i of each part of the windows that hold a cell, in the rows of the corners (CORNER_ROWS), part
    by part, shape (count, CELL_PARTS * 4); in an empty block where there is no part. Last those of ghosts."""
    in_pairs: Int8
    """Whether a window's parts follow each other in their rows two by two, else 0, shape (count,)."""
    ghost_window: int
    """First window that holds ghosts."""
    touches: Int64
    """Windows of nodes that the cells of each of these windows have corners in, then -1, shape (count, 8 or more)."""
    ghost_lane: Int64
    """Lane of the ghost at each corner of the irregular cells, shape (irregular_count, 8)."""

    cell_in: Int32 = field(repr=False, compare=False)
    """Cell in each place of the windows, -1 for none, shape (CELL_LANES * count,)."""

    def write_by_window(self, values: Float32, first: int, numbers: Float32) -> None:
        """Write numbers of each cell, shape (any, cell_count), of each window's lanes by themselves.

        ``numbers``: shape (count, any, CELL_LANES), zeros at first; behind the first so many are written.
        """
        number_by_window(values, self.cell_in, first, numbers)

    def write_numbers(self, model: LatticeModel, numbers: Float32) -> None:
        """Write :func:`cell_numbers` of each window's lanes by themselves into zeros, (count, 11, CELL_LANES)."""
        if model.law.is_element:
            self.write_by_window(cell_numbers(model), 0, numbers)
            return
        self.write_by_window(model.cell_force_scale[None], 0, numbers)
        self.write_by_window(model.corner_guard_scale[None], CELL_NUMBERS - 1, numbers)

    def by_node_window(self, model: LatticeModel, shares: Float32, own: Float32, numbers: Float32) -> None:
        """Write eight numbers of each cell by the windows of its corners' nodes, and then one of these nodes.

        Zero where there is no cell, or one that is irregular.

        Parameters
        ----------
        model
            The lattice.
        shares, own
            Numbers of each cell, one for each corner, shape (8, cell_count), and of each node, shape (node_count,).
        numbers
            Shape (window_count of nodes, 9, 8), zeros at first; written.
        """
        layout, slots = self.layout, self.layout.slots
        lanes = (layout.window_rows, slots.slot_of, slots.node_in, slots.by_lane, slots.first, layout.node_slot)
        share_by_node_window(*lanes, model.cell_corners, layout.irregular_cells, shares, own, numbers)


def cell_layout(model: LatticeModel, layout: LaneLayout) -> CellLayout:
    """Lay out the cells of a lattice in the lanes of its nodes."""
    irregular, corners = layout.irregular_cells, model.cell_corners
    cell_lane, cell_slot = np.empty(model.cell_count, np.int64), np.empty(model.cell_count, np.int64)
    ghost_lane = np.empty((len(irregular), 8), np.int64)
    # Two parts for each window of nodes and one of ghosts; three windows may not be full.
    most = 2 * (layout.window_count + len(layout.ghost_start)) // CELL_PARTS + 3
    in_pairs = np.zeros(most, np.int8)
    rows = np.full((most, CELL_PARTS * len(CORNER_ROWS)), EMPTY_START)
    lanes = (layout.node_lane, layout.node_slot, layout.window_rows, layout.ghost_start)
    count, ghost_window = lay_out_cells(corners, irregular, *lanes, cell_lane, cell_slot, rows, in_pairs, ghost_lane)
    rows, in_pairs = rows[:count], in_pairs[:count]
    cell_in, firsts = np.empty(CELL_LANES * len(rows), np.int32), np.empty(len(rows) + 1, np.int64)
    # Each cell has eight corners, in a window each at most.
    ranges, room = np.empty((8 * model.cell_count, 3), np.int64), np.empty(8 * model.cell_count, np.int32)
    range_count = ranges_touched(corners, layout.node_lane, cell_slot, rows, ghost_window, cell_in, ranges)
    longest = list_windows(ranges[:range_count], *layout.windows_by_lanes, room, firsts)
    touches = np.empty((len(rows), max(8, longest)), np.int64)
    write_lists(room, firsts, touches)
    return CellLayout(
        layout=layout,
        cell_lane=cell_lane,
        cell_slot=cell_slot,
        window_rows=rows,
        in_pairs=in_pairs,
        ghost_window=ghost_window,
        touches=touches,
        ghost_lane=ghost_lane,
        cell_in=cell_in,
    )
