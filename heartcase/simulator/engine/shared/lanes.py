"""The layout of a lattice in memory: nodes in lanes of vectors.

Nodes are stored in blocks of 8 lanes: 8 neighbours along i, aligned. Blocks that follow each other along i lie side by
side, as a run; between runs lies an empty block. A vector instruction works on a window: 8 lanes of a run from a node
on, so that few of them are empty. A neighbour along (i, j, k) of a window's nodes is the lane at a fixed distance from
where the window's i begins in the row (j, k). Lanes without a node have no mass and no springs: they cost time but
change nothing.

A lattice that was cut has copies of nodes (:mod:`heartcase.simulator.engine.shared.node_copies`). Of cells whose
corners do not lie at these distances, the corners have ghosts: lanes of their own, GHOST_CELLS cells to a window, which
repeat what their nodes do.

An array with several numbers a lane, such as the components of a vector, has them at a fixed distance, the stride. The
CPU's lanes lie in banks, so that the stride is the same for every lattice: a constant of the compiled kernel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Bool, Float32, Int32, Int64, Intp
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, distinct_keys, lattice_keys
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.engine.shared.lane_kernels import (
    MOST_TOUCHED,
    mark_blocks,
    number_blocks,
    rows_of_windows,
    touched_windows,
    write_weights,
)
from heartcase.simulator.engine.shared.node_copies import (
    are_among,
    copied_rows,
    irregular_cells,
    irregular_springs,
    vote_for_rows,
)
from heartcase.simulator.forces.cell_forces import tissue_spread
from heartcase.simulator.lattice.explicit_springs import SpringsByNode
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel

__all__ = [
    "BANK_LANES",
    "CELL_NUMBERS",
    "EMPTY_START",
    "GHOST_CELLS",
    "LANE_COUNT",
    "ROWS",
    "SHARE_NUMBERS",
    "CellLayout",
    "LaneLayout",
    "cell_layout",
    "cell_numbers",
    "inverse_shared",
    "lane_layout",
    "share_numbers",
]

LANE_COUNT = 8
"""Lanes of a block and of a window: one AVX register or two of NEON in float32. 16 leave more lanes empty: slower."""

CELL_NUMBERS = 11
"""Numbers that the kernels read of a cell: :func:`cell_numbers`."""

SHARE_NUMBERS = 9
"""Numbers of :func:`share_numbers`, and of a gradient or a stress."""

ROWS: Int32 = np.array([(j, k) for k in (-1, 0, 1) for j in (-1, 0, 1)], dtype=np.int32)
"""Offset (j, k) of a window's own row (number 4) and of the eight rows around it, shape (9, 2)."""

BANK_LANES = 8304
"""Lanes of a bank. Runs lie in one bank each; an odd number of cache lines, so that a lane's numbers do not push each
other out of a cache's sets."""

_BANK_NUMBERS = CELL_NUMBERS
"""Most numbers of a lane: so many strips of BANK_LANES float32 follow each other before the next bank begins."""
_HEAD_BLOCKS = 3
GHOST_CELLS = 4
"""Irregular cells whose ghosts share a window: a cell takes two lanes in each of four rows."""
_GHOST_ROWS = (4, 5, 7, 8)
"""Numbers in ROWS of the rows that a cell has corners in."""
EMPTY_START = LANE_COUNT
"""First lane of a block that never holds a node."""


@dataclass(frozen=True)
class LaneLayout:
    """Where the nodes are in memory. Springs may be removed or change; the layout stays."""

    lane_count: int
    """Length of an array with one number per lane; in banks the other numbers' places are in between."""
    stride: int
    """Distance from a lane's number to its next in an array with several."""
    node_lane: Int64
    """Lane of each node, shape (node_count,)."""
    node_slot: Int64
    """Number of the node's window times 8 plus its place there, shape (node_count,)."""
    window_rows: Int64
    """Lane at the window's first i in the nine ROWS, for each window, shape (window_count, 9); in an empty block where
    a row has no nodes there."""
    is_near_copies: Bool
    """Whether a node's window lies in or beside a row with copies, shape (node_count,)."""
    irregular_cells: Int64
    """Cells whose corners have ghosts, ascending, shape (irregular_count,)."""
    ghost_start: Int64
    """First lane of the ghosts of each window of GHOST_CELLS of them: four blocks that follow each other, (any,)."""

    @property
    def window_count(self) -> int:
        """Number of windows that hold all nodes."""
        return len(self.window_rows)

    def length(self, number_count: int) -> int:
        """Length of an array with so many numbers per lane."""
        return self.lane_count + (number_count - 1) * self.stride

    def places(self, lanes: Int64, number_count: int) -> Int64:
        """Where such an array has the numbers of some lanes, shape (len(lanes), number_count)."""
        return lanes[:, None] + self.stride * np.arange(number_count)

    @cached_property
    def node_at(self) -> Int32:
        """Node in each lane, -1 where there is none, shape (lane_count,)."""
        return _nodes_in_lanes(self.node_lane, self.lane_count)

    @cached_property
    def nodes_by_lane(self) -> Int32:
        """Nodes in the order of their lanes, shape (node_count,)."""
        return self.node_at[self.node_at >= 0]

    def neighbour_lanes(self, nodes: Int64, offset: Int32) -> Int64:
        """Lanes in which the kernels look for the neighbours of some nodes at an offset (i, j, k), shape (count,)."""
        i, j, k = offset.tolist()
        slot = self.node_slot[nodes]
        lanes: Int64 = self.window_rows[slot // LANE_COUNT, (j + 1) + 3 * (k + 1)] + slot % LANE_COUNT + i
        return lanes

    def irregular_springs(self, model: LatticeModel) -> Bool:
        """Springs of a model of these nodes whose ends do not lie at fixed distances, shape (spring_count,)."""
        if not self.is_near_copies.any():
            return np.zeros(model.spring_count, np.bool_)
        if not self._known or self._known[0][0] is not model.spring_nodes:
            self._known[:] = [(model.spring_nodes, irregular_springs(model, self))]
        return self._known[0][1]

    @cached_property
    def _known(self) -> list[tuple[Int32, Bool]]:
        """Springs of the model that was asked for last, and which of them are irregular."""
        return []

    def springs_apart(self, model: LatticeModel) -> SpringsByNode:
        """Explicit springs and those of the lattice that are irregular, by node."""
        irregular = np.flatnonzero(self.irregular_springs(model))
        weight = model.acting_weight[irregular]
        irregular, weight = irregular[weight > 0], weight[weight > 0]
        more = (model.spring_nodes[irregular], weight, model.spring_length[irregular])
        return SpringsByNode.of(model.explicit, model.node_index, more)

    def spring_weight(self, model: LatticeModel, spring_weight: Float32 | None = None) -> Float32:
        """Stiffness of the spring from each lane along each of the nine DIRECTIONS [k], shape (length(9),).

        Another value of each spring of the model, shape (spring_count,), where one is given. Zero for irregular ones.
        """
        weight = np.zeros(self.length(len(DIRECTIONS)), np.float32)
        values = model.spring_weight if spring_weight is None else spring_weight
        irregular = self.irregular_springs(model)
        write_weights(
            model.spring_nodes, model.spring_direction, values, irregular, self.node_lane, self.stride, weight
        )
        return weight

    def uniform_weight(self, model: LatticeModel) -> Float32:
        """Stiffness of all springs of a window's nodes, where each has 18 and all are alike, else 0 [k].

        Shape (window_count,).
        """
        regular = ~self.irregular_springs(model)
        ends = model.spring_nodes[regular].ravel()
        both = np.repeat(model.spring_weight[regular], 2)
        lowest = np.where(np.bincount(ends, minlength=model.node_count) == 2 * len(DIRECTIONS), np.inf, 0.0)
        highest = np.zeros(model.node_count)
        np.minimum.at(lowest, ends, both)
        np.maximum.at(highest, ends, both)
        by_lane = self.nodes_by_lane
        first = np.flatnonzero(np.diff(self.node_slot[by_lane] // LANE_COUNT, prepend=-1))
        low, high = np.minimum.reduceat(lowest[by_lane], first), np.maximum.reduceat(highest[by_lane], first)
        return np.where(low == high, low, 0.0).astype(np.float32)

    def windows_of(self, nodes: Intp) -> Int64:
        """Rows of the windows that hold some nodes, shape (count, 9)."""
        return self.window_rows[np.unique(self.node_slot[nodes] // LANE_COUNT)]


def lane_layout(model: LatticeModel, *, in_banks: bool = False) -> LaneLayout:
    """Lay out a lattice in lanes, or in banks of lanes.

    Raises
    ------
    SimulationError
        A row of nodes along i does not fit into a bank.
    """
    rows = copied_rows(model)
    layer = np.zeros(model.node_count, np.int64) if rows is None else rows.layer
    block = model.node_index[:, 0] // LANE_COUNT
    first_block, layer_blocks = int(block.min()), int(np.ptp(block)) + 2
    keys = _row_keys(model.node_index)
    row_keys = distinct_keys(keys)
    row = np.searchsorted(row_keys, keys)
    is_stored = np.zeros((len(row_keys), layer_blocks * (int(layer.max()) + 1)), np.int8)
    mark_blocks(model.node_index, row, layer, model.spring_nodes, first_block, layer_blocks, LANE_COUNT, is_stored)
    number, block_counts = np.empty(is_stored.shape, np.int32), np.empty(is_stored.size, np.int64)
    block_count, run_count = number_blocks(is_stored, number, block_counts)
    block_counts = block_counts[:run_count].copy()
    capacity = BANK_LANES // LANE_COUNT if in_banks else _HEAD_BLOCKS + block_count + 2 * run_count
    longest = int(block_counts.max())
    if longest + 1 > capacity - _HEAD_BLOCKS:
        raise SimulationError(
            f"a row of the lattice is {longest} blocks of {LANE_COUNT} nodes long along its first axis; "
            f"the CPU takes {capacity - _HEAD_BLOCKS - 1}: use larger cells, or a part of the lattice"
        )
    run_start = _run_starts(block_counts, capacity)
    before = np.cumsum(block_counts) - block_counts
    start = np.repeat(run_start - LANE_COUNT * before, block_counts) + LANE_COUNT * np.arange(block_count)

    own = number[row, block - first_block + layer * layer_blocks]
    node_lane = start[own] + model.node_index[:, 0] % LANE_COUNT
    lane_count = int(start[-1]) + 2 * LANE_COUNT
    by_lane = _nodes_in_lanes(node_lane, lane_count)
    by_lane = by_lane[by_lane >= 0]
    first, window_by_lane = _windows(node_lane[by_lane])
    first = by_lane[first]
    window = np.empty_like(window_by_lane)
    window[by_lane] = window_by_lane
    window_rows = np.full((len(first), len(ROWS)), EMPTY_START)
    around_keys = _row_keys(model.node_index[first, None] + np.insert(ROWS, 0, 0, axis=1))
    around = np.where(are_among(around_keys, row_keys), np.searchsorted(row_keys, around_keys), -1)
    places = model.node_index[first, 0] % LANE_COUNT
    rows_of_windows(around, block[first] - first_block, places, number, start, LANE_COUNT, window_rows)
    window_rows[:, 4] = node_lane[first]

    layout = LaneLayout(
        lane_count=lane_count,
        stride=0,
        node_lane=node_lane,
        node_slot=LANE_COUNT * window + node_lane - node_lane[first][window],
        window_rows=window_rows,
        is_near_copies=np.zeros(model.node_count, np.bool_),
        irregular_cells=np.zeros(0, np.int64),
        ghost_start=np.zeros(0, np.int64),
    )
    if rows is not None:
        is_near = np.asarray(are_among(around_keys, rows.row_keys).any(axis=1))
        near = np.flatnonzero(is_near)
        window_rows[near] = np.where(np.arange(len(ROWS)) == 4, window_rows[near], EMPTY_START)
        vote_for_rows(model, node_lane, layout.node_slot, near, window_rows, layout.lane_count)
        layout = replace(layout, is_near_copies=is_near[window])
        irregular = irregular_cells(model, layout)
        ghost_blocks = np.full(-(-len(irregular) // GHOST_CELLS), len(_GHOST_ROWS))
        room = capacity if in_banks else capacity + (len(_GHOST_ROWS) + 1) * len(ghost_blocks)
        ghost_start = _run_starts(np.concatenate([block_counts, ghost_blocks]), room)[len(block_counts) :]
        if len(irregular):
            last = int(ghost_start[-1]) + LANE_COUNT * (len(_GHOST_ROWS) + 1)
            layout = replace(layout, lane_count=last, irregular_cells=irregular, ghost_start=ghost_start)
    return replace(layout, stride=BANK_LANES if in_banks else layout.lane_count)


def _nodes_in_lanes(node_lane: Int64, lane_count: int) -> Int32:
    nodes = np.full(lane_count, -1, np.int32)
    nodes[node_lane] = np.arange(len(node_lane))
    return nodes


def _row_keys(places: npt.ArrayLike) -> Int64:
    """Keys of the rows along i that places (i, j, k) lie in: those of (0, j, k)."""
    starts = np.array(places)
    starts[..., 0] = 0
    return lattice_keys(starts)


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
    """Number of the cell's window times 8 plus its place there, shape (cell_count,)."""
    window_rows: Int64
    """Rows of the windows that hold a cell, shape (count, 9); last those of ghosts."""
    touches: Int64
    """Windows of nodes that the cells of each of these windows have corners in, then -1, shape (count, 8 or more)."""
    ghost_lane: Int64
    """Lane of the ghost at each corner of the irregular cells, shape (irregular_count, 8)."""

    @property
    def ghost_window(self) -> int:
        """First window that holds ghosts."""
        return len(self.window_rows) - len(self.layout.ghost_start)

    def by_window(self, values: Float32) -> Float32:
        """Numbers of each cell, shape (any, cell_count), of each window's lanes by themselves; zero without a cell.

        Shape (count, any, 8).
        """
        numbers = np.zeros((len(self.window_rows), len(values), LANE_COUNT), np.float32)
        numbers[self.cell_slot // LANE_COUNT, :, self.cell_slot % LANE_COUNT] = values.T
        return numbers

    def by_node_window(self, values: Float32) -> Float32:
        """Eight numbers of each cell, one for each corner, shape (8, cell_count), by the windows of the corners' nodes.

        Zero where there is no cell, or one that is irregular. Shape (window_count of nodes, 8, 8).
        """
        cell_at = np.full(self.layout.lane_count, -1)
        cell_at[self.cell_lane] = np.arange(len(self.cell_lane))
        cell_at[self.ghost_lane.ravel()] = -1
        rows = self.layout.window_rows
        numbers = np.zeros((len(rows), len(CORNER_OFFSETS), LANE_COUNT), np.float32)
        for corner, (i, j, k) in enumerate(CORNER_OFFSETS.tolist()):
            # A node is the corner of the cell behind it by that corner's offset.
            cell = cell_at[rows[:, 4 - j - 3 * k, None] - i + np.arange(LANE_COUNT)]
            numbers[:, corner] = np.where(cell >= 0, values[corner, cell], np.float32(0.0))
        return numbers


def cell_layout(model: LatticeModel, layout: LaneLayout) -> CellLayout:
    """Lay out the cells of a lattice in the lanes of its nodes."""
    irregular = layout.irregular_cells
    windows = layout.node_slot[model.cell_corners] // LANE_COUNT
    is_held = np.zeros(layout.window_count, np.bool_)
    is_regular = np.ones(model.cell_count, np.bool_)
    is_regular[irregular] = False
    is_held[windows[is_regular, 0]] = True
    held = np.flatnonzero(is_held)
    window_of_cell = (np.cumsum(is_held) - 1)[windows[:, 0]]
    place = np.arange(len(irregular))
    place_of_cell = layout.node_slot[model.cell_corners[:, 0]] % LANE_COUNT
    place_of_cell[irregular] = 2 * (place % GHOST_CELLS)
    window_of_cell[irregular] = len(held) + place // GHOST_CELLS
    cell_lane = layout.node_lane[model.cell_corners[:, 0]]
    cell_lane[irregular] = layout.ghost_start[place // GHOST_CELLS] + 2 * (place % GHOST_CELLS)
    offset = CORNER_OFFSETS.astype(np.int64)
    ghost_lane = cell_lane[irregular, None] + offset[:, 0] + LANE_COUNT * (offset[:, 1] + 2 * offset[:, 2])
    ghost_rows = np.full((len(layout.ghost_start), len(ROWS)), EMPTY_START)
    ghost_rows[:, _GHOST_ROWS] = layout.ghost_start[:, None] + LANE_COUNT * np.arange(len(_GHOST_ROWS))

    count = len(held) + len(ghost_rows)
    room, counts = np.empty((count, MOST_TOUCHED), np.int64), np.zeros(count, np.int64)
    touched_windows(windows, window_of_cell, room, counts)
    touches = room[:, : max(8, int(counts.max(initial=0)))].copy()
    touches[np.arange(touches.shape[1]) >= counts[:, None]] = -1
    rows = np.concatenate([layout.window_rows[held], ghost_rows])
    return CellLayout(
        layout=layout,
        cell_lane=cell_lane,
        cell_slot=LANE_COUNT * window_of_cell + place_of_cell,
        window_rows=rows,
        touches=touches,
        ghost_lane=ghost_lane,
    )


@kernel
def _run_starts(block_counts: Int64, capacity: int) -> Int64:
    """First lane of each run: an empty block follows each, and no bank holds more blocks than its capacity."""
    starts = np.empty_like(block_counts)
    bank, block = 0, _HEAD_BLOCKS
    for run in range(len(block_counts)):
        if block + block_counts[run] + 1 > capacity:
            bank, block = bank + 1, _HEAD_BLOCKS
        starts[run] = bank * _BANK_NUMBERS * BANK_LANES + LANE_COUNT * block
        block += block_counts[run] + 1
    return starts


@kernel
def _windows(node_lane: Int64) -> tuple[Int64, Int64]:
    """First node of each window, and window of each node: a window begins at the first node that none holds yet."""
    first, window = np.empty_like(node_lane), np.empty_like(node_lane)
    count, end = 0, -1
    for node in range(len(node_lane)):
        if node_lane[node] >= end:
            first[count], end = node, node_lane[node] + LANE_COUNT
            count += 1
        window[node] = count - 1
    return first[:count].copy(), window
