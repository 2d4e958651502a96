"""Lanes for a lattice that was cut: several nodes in one place, and what does not lie at a fixed distance.

A row of nodes along i that has copies is taken apart into paths, along which each node follows the one before it. Paths
that do not overlap and have neighbours in common share a run of lanes, a layer of the row. A window of nodes finds the
rows around it where most of its nodes' neighbours lie: near a cut, some of its lanes belong to one side and some to the
other. Springs and cells whose ends lie elsewhere are irregular: springs become explicit ones, and cells get ghosts of
their corners' nodes (:mod:`heartcase.simulator.engine.shared.lanes`). They are few beside what a large cut parts.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from heartcase.schemas.arrays import Bool, Int32, Int64
from heartcase.simulator.engine.shared.node_copy_kernels import (
    find_irregular_cells,
    find_near_cells,
    find_near_windows,
    lay_in_layers,
    mark_copied_rows,
    vote,
)
from heartcase.simulator.engine.shared.rows import Rows
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["NearCells", "irregular_cells", "layers_of_copies", "rows_near_copies"]

NearCells = tuple[Int64, Bool]
"""Cells near copies, ascending, and whether each cell is one."""


class _Lanes(Protocol):
    """Where nodes are, and are looked for: a :class:`heartcase.simulator.engine.shared.lanes.LaneLayout`."""

    @property
    def lane_count(self) -> int: ...
    @property
    def node_lane(self) -> Int64: ...
    @property
    def node_slot(self) -> Int64: ...
    @property
    def window_rows(self) -> Int64: ...
    @property
    def is_near_copies(self) -> Bool: ...
    @property
    def slots(self) -> _Slots: ...


class _Slots(Protocol):
    """How to come from lanes to nodes."""

    @property
    def slot_of(self) -> Int32: ...
    @property
    def node_in(self) -> Int32: ...
    @property
    def by_lane(self) -> Int32: ...
    @property
    def first(self) -> Int32: ...


def layers_of_copies(model: LatticeModel, rows: Rows) -> tuple[Int32, Bool]:
    """Layer of its row that each node lies in, shape (node_count,), and whether each row has copies.

    A row where several cells have one lowest node counts as one with copies. The layer is 0 in all rows without
    copies. Where no row has any, the second is of length 0.
    """
    layer, is_copied = np.zeros(model.node_count, np.int32), np.zeros(rows.count, np.bool_)
    low, length = rows.low[0], rows.high[0] - rows.low[0] + 1
    if not mark_copied_rows(model.node_index, model.cell_corners, rows.row, low, length, is_copied):
        return layer, is_copied[:0]
    lay_in_layers(model.node_index, model.cell_corners, rows.row, is_copied, low, length, layer)
    return layer, is_copied


def rows_near_copies(model: LatticeModel, layout: _Lanes, around: Int32, is_copied: Bool) -> NearCells:
    """Write the rows of the windows near copies, where most neighbours of their nodes lie, and which nodes these hold.

    Parameters
    ----------
    model, layout
        The lattice, and its nodes' lanes. Of the windows near copies the rows, and of their nodes that they are near
        copies, are written.
    around
        Number of the nine rows around each window, -1 where there is none, shape (window_count, 9).
    is_copied
        Whether each row has copies.
    """
    slots = layout.slots
    near = find_near_windows(around, is_copied, slots.by_lane, slots.first, layout.window_rows, layout.is_near_copies)
    near_cells: NearCells = find_near_cells(model.cell_corners, layout.is_near_copies)
    vote(
        model.cell_corners,
        near_cells[0],
        layout.is_near_copies,
        layout.node_lane,
        layout.node_slot,
        slots.by_lane,
        slots.first,
        near,
        layout.lane_count,
        layout.window_rows,
    )
    return near_cells


def irregular_cells(model: LatticeModel, layout: _Lanes, near_cells: NearCells) -> Int64:
    """Cells whose corners the kernels do not find, or that they would take for another node's, ascending."""
    found: Int64 = find_irregular_cells(
        model.cell_corners,
        *near_cells,
        layout.is_near_copies,
        layout.node_lane,
        layout.node_slot,
        layout.window_rows,
        layout.slots.slot_of,
        layout.slots.node_in,
    )
    return found
