"""The layout of a lattice in memory: nodes in lanes of vectors.

Nodes are stored in blocks of 8 lanes: 8 neighbours along i, aligned. Blocks that follow each other along i lie side by
side, as a run; between runs lies an empty block. A vector instruction works on a window: 8 lanes of a run from a node
on, so that few of them are empty. A neighbour along (i, j, k) of a window's nodes is the lane at a fixed distance from
where the window's i begins in the row (j, k). Lanes without a node have no mass and no springs: they cost time but
change nothing.

An array with several numbers a lane, such as the components of a vector, has them at a fixed distance, the stride. The
CPU's lanes lie in banks, so that the stride is the same for every lattice: a constant of the compiled kernel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int32, Int64, Intp
from heartcase.schemas.bundle.lattice import lattice_keys
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.forces.cell_forces import tissue_spread
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel

__all__ = [
    "BANK_LANES",
    "CELL_NUMBERS",
    "EMPTY_START",
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

    def spring_weight(self, model: LatticeModel, spring_weight: Float32 | None = None) -> Float32:
        """Stiffness of the spring from each lane along each of the nine DIRECTIONS [k], shape (length(9),).

        Another value of each spring of the model, shape (spring_count,), where one is given.
        """
        weight = np.zeros(self.length(len(DIRECTIONS)), np.float32)
        values = model.spring_weight if spring_weight is None else spring_weight
        weight[self.stride * model.spring_direction.astype(np.int64) + self.node_lane[model.spring_nodes[:, 0]]] = (
            values
        )
        return weight

    def uniform_weight(self, model: LatticeModel) -> Float32:
        """Stiffness of all springs of a window's nodes, where each has 18 and all are alike, else 0 [k].

        Shape (window_count,).
        """
        ends = model.spring_nodes.ravel()
        both = np.repeat(model.spring_weight, 2)
        lowest = np.where(np.bincount(ends, minlength=model.node_count) == 2 * len(DIRECTIONS), np.inf, 0.0)
        highest = np.zeros(model.node_count)
        np.minimum.at(lowest, ends, both)
        np.maximum.at(highest, ends, both)
        first = np.flatnonzero(np.diff(self.node_slot // LANE_COUNT, prepend=-1))
        low, high = np.minimum.reduceat(lowest, first), np.maximum.reduceat(highest, first)
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
    blocks = model.node_index.copy()
    blocks[:, 0] //= LANE_COUNT
    keys = lattice_keys(blocks)
    first = np.flatnonzero(np.diff(keys, prepend=keys[0] - 1))
    used = keys[first]
    # A spring over a block's end is found through the block at the same i in the other's row: store that too.
    over = model.spring_nodes[np.diff(blocks[:, 0][model.spring_nodes], axis=1)[:, 0] != 0]
    lower, higher = blocks[over[:, 0]], blocks[over[:, 1]]
    beside_lower = np.column_stack([higher[:, 0], lower[:, 1:]])
    beside_higher = np.column_stack([lower[:, 0], higher[:, 1:]])
    stored = np.unique(np.concatenate([used, lattice_keys(beside_lower), lattice_keys(beside_higher)]))
    run = np.cumsum(np.diff(stored, prepend=stored[0] - 2) != 1) - 1
    block_counts = np.bincount(run)
    capacity = BANK_LANES // LANE_COUNT if in_banks else _HEAD_BLOCKS + len(stored) + len(block_counts)
    longest = int(block_counts.max())
    if longest + 1 > capacity - _HEAD_BLOCKS:
        raise SimulationError(
            f"a row of the lattice is {longest} blocks of {LANE_COUNT} nodes long along its first axis; "
            f"the CPU takes {capacity - _HEAD_BLOCKS - 1}: use larger cells, or a part of the lattice"
        )
    run_start = _run_starts(block_counts, capacity)
    before = np.cumsum(block_counts) - block_counts
    start = run_start[run] + LANE_COUNT * (np.arange(len(stored)) - before[run])
    lane_count = int(start[-1]) + 2 * LANE_COUNT

    node_lane = start[np.searchsorted(stored, keys)] + model.node_index[:, 0] % LANE_COUNT
    first, window = _windows(node_lane)
    corner = model.node_index[first]
    rows = np.repeat(corner[:, None, :], len(ROWS), axis=1)
    rows[:, :, 1:] += ROWS
    place = rows[:, :, 0] % LANE_COUNT
    rows[:, :, 0] //= LANE_COUNT
    window_rows = np.full(rows.shape[:2], EMPTY_START)
    # The next block, then the window's own: where it is there, so are the lanes of the other, empty or not.
    for ahead in (1, 0):
        row_keys = lattice_keys(rows + np.array([ahead, 0, 0]))
        nearest = np.minimum(np.searchsorted(stored, row_keys), len(stored) - 1)
        is_there = stored[nearest] == row_keys
        window_rows[is_there] = (start[nearest] + place - ahead * LANE_COUNT)[is_there]

    node_slot = LANE_COUNT * window + node_lane - node_lane[first][window]
    return LaneLayout(
        lane_count=lane_count,
        stride=BANK_LANES if in_banks else lane_count,
        node_lane=node_lane,
        node_slot=node_slot,
        window_rows=window_rows,
    )


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
    """Where the cells are: each in the lane of its lowest corner."""

    layout: LaneLayout
    """Of the nodes."""
    cell_lane: Int64
    """Lane of each cell, shape (cell_count,)."""
    window_rows: Int64
    """Rows of the windows that hold a cell, shape (count, 9)."""
    touches: Int64
    """Windows of nodes that the cells of each of these windows have corners in, then -1, shape (count, 8)."""

    def numbers(self, model: LatticeModel) -> Float32:
        """:func:`cell_numbers` by lane, shape (length(11),), float32; zero where there is no cell."""
        numbers = np.zeros(self.layout.length(CELL_NUMBERS), np.float32)
        numbers[self.layout.places(self.cell_lane, CELL_NUMBERS)] = cell_numbers(model).T
        return numbers

    def shares(self, model: LatticeModel) -> Float32:
        """:func:`share_numbers` by lane, shape (length(9),), float32; zero where there is no cell."""
        shares = np.zeros(self.layout.length(SHARE_NUMBERS), np.float32)
        shares[self.layout.places(self.cell_lane, SHARE_NUMBERS)] = share_numbers(model).T
        return shares


def cell_layout(model: LatticeModel, layout: LaneLayout) -> CellLayout:
    """Lay out the cells of a lattice in the lanes of its nodes."""
    windows = layout.node_slot[model.cell_corners] // LANE_COUNT
    held, window_of_cell = np.unique(windows[:, 0], return_inverse=True)
    pairs = np.unique(np.stack([np.repeat(window_of_cell, 8), windows.ravel()], axis=1), axis=0)
    place = np.arange(len(pairs)) - np.searchsorted(pairs[:, 0], pairs[:, 0])
    touches = np.full((len(held), 8), -1, np.int64)
    touches[pairs[:, 0], place] = pairs[:, 1]
    lane = layout.node_lane[model.cell_corners[:, 0]]
    rows = np.ascontiguousarray(layout.window_rows[held])
    return CellLayout(layout=layout, cell_lane=lane, window_rows=rows, touches=touches)


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
