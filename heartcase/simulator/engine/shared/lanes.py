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

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Bool, Float32, Int32, Int64, Intp
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.engine.shared.lane_kernels import (
    lay_out_nodes,
    mark_blocks,
    mark_over_springs,
    number_blocks,
    rows_of_windows,
    start_slots,
    windows_by_lanes,
)
from heartcase.simulator.engine.shared.node_copies import irregular_cells, layers_of_copies, rows_near_copies
from heartcase.simulator.engine.shared.rows import numbered_rows
from heartcase.simulator.engine.shared.spring_kernels import (
    copy_from_windows,
    find_irregular,
    leave_out,
    weigh_windows,
)
from heartcase.simulator.lattice.explicit_springs import SpringsByNode
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel

__all__ = [
    "BANK_LANES",
    "CELL_LANES",
    "CELL_NUMBERS",
    "CELL_PARTS",
    "CORNER_ROWS",
    "EMPTY_START",
    "GHOST_CELLS",
    "LANE_COUNT",
    "PART_LANES",
    "ROWS",
    "SHARE_NUMBERS",
    "LaneLayout",
    "Slots",
    "lane_layout",
]

LANE_COUNT = 8
"""Lanes of a block and of a window: one AVX register or two of NEON in float32. 16 leave more lanes empty: slower."""

CELL_NUMBERS = 11
"""Numbers that the kernels read of a cell: :func:`heartcase.simulator.engine.shared.cell_lanes.cell_numbers`."""

SHARE_NUMBERS = 9
"""Numbers of :func:`heartcase.simulator.engine.shared.cell_lanes.share_numbers`, and of a gradient or a stress."""

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
CORNER_ROWS = (4, 5, 7, 8)
"""Numbers in ROWS of the rows that a cell has corners in, by the corner's j + 2 k."""
PART_LANES = 4
"""Lanes of a part of a window of cells, all in one window of nodes; of eight, nearly half hold no cell of a heart."""
CELL_PARTS = 4
CELL_LANES = PART_LANES * CELL_PARTS
"""Cells of a window of cells, one AVX-512 register in float32; other processors work out a part of them at a time."""
EMPTY_START = LANE_COUNT
"""First lane of a block that never holds a node."""


@dataclass(frozen=True)
class Slots:
    """The blocks that hold nodes, and the empty one behind each run of them, numbered in the order of their lanes."""

    slot_of: Int32
    """Slot of every eight lanes and one more, else 0, shape (any,)."""
    node_in: Int32
    """Node in each lane of the slots, -1 for none, shape (8 * slot_count,)."""
    by_lane: Int32
    """Nodes in the order of their lanes, shape (node_count,)."""
    first: Int32
    """Where those of each window begin there, and the last end, shape (window_count + 1,)."""


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
    a row has no nodes there. In memory one more row follows, that of a window of empty lanes."""
    is_near_copies: Bool
    """Whether a node's window lies in or beside a row with copies, shape (node_count,)."""
    irregular_cells: Int64
    """Cells whose corners have ghosts, ascending, shape (irregular_count,)."""
    ghost_start: Int64
    """First lane of the ghosts of each window of GHOST_CELLS of them: four blocks that follow each other, (any,)."""
    slots: Slots = field(repr=False, compare=False)
    """How to come from lanes to nodes."""
    near_cells: Int64 = field(repr=False, compare=False)
    """Cells with a node near copies, ascending, shape (any,)."""

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

    @property
    def node_at(self) -> Int32:
        """Node in each lane, -1 where there is none, shape (lane_count,)."""
        nodes = np.full(self.lane_count, -1, np.int32)
        nodes[self.node_lane] = np.arange(len(self.node_lane))
        return nodes

    @cached_property
    def windows_by_lanes(self) -> tuple[Int64, Int32]:
        """First lane of each window, and of every eight lanes the first window that holds some and one more, else 0."""
        starts, window_of = np.empty(self.window_count, np.int64), np.zeros(self.lane_count // LANE_COUNT + 2, np.int32)
        windows_by_lanes(self.window_rows, starts, window_of)
        return starts, window_of

    def neighbour_lanes(self, nodes: Int64, offset: Int32) -> Int64:
        """Lanes in which the kernels look for the neighbours of some nodes at an offset (i, j, k), shape (count,)."""
        i, j, k = offset.tolist()
        slot = self.node_slot[nodes]
        lanes: Int64 = self.window_rows[slot // LANE_COUNT, (j + 1) + 3 * (k + 1)] + slot % LANE_COUNT + i
        return lanes

    def irregular_springs(self, model: LatticeModel, first: Int32 | None = None) -> Int64:
        """Springs of a model of these nodes whose ends do not lie at fixed distances, ascending, shape (any,).

        Where the springs from each node begin, and the last end, shape (node_count + 1,), may be given.
        """
        if not len(self.near_cells):
            return np.zeros(0, np.int64)
        # Of engines that share a layout, one may be asked in another thread meanwhile.
        known = self._known[0] if self._known else None
        if known is None or known[0] is not model.spring_nodes:
            starts = model.first_springs.astype(np.int32) if first is None else first
            springs = (model.spring_nodes, model.spring_direction, starts)
            near = (model.cell_corners, self.near_cells, self.is_near_copies)
            lanes = (self.node_lane, self.node_slot, self.window_rows, self.slots.slot_of, self.slots.node_in)
            known = (model.spring_nodes, find_irregular(*springs, *near, *lanes))
            self._known[:] = [known]
        return known[1]

    @cached_property
    def _known(self) -> list[tuple[Int32, Int64]]:
        """Springs of the model that was asked for last, and which of them are irregular."""
        return []

    def springs_apart(self, model: LatticeModel) -> SpringsByNode:
        """Explicit springs and those of the lattice that are irregular, by node."""
        irregular = self.irregular_springs(model)
        if not len(irregular):
            return SpringsByNode.of(model.explicit, model.node_index)
        values, scale = model.scaled_weight
        weight = values[irregular] * scale
        irregular, weight = irregular[weight > 0], weight[weight > 0]
        length = np.linalg.norm(DIRECTIONS, axis=1)[model.spring_direction[irregular]]
        more = (model.spring_nodes[irregular], weight, length)
        return SpringsByNode.of(model.explicit, model.node_index, more)

    def spring_weight(self, model: LatticeModel, spring_weight: Float32 | None = None) -> Float32:
        """Stiffness of the spring from each lane along each of the nine DIRECTIONS [k], shape (length(9),).

        Another value of each spring of the model, shape (spring_count,), where one is given. Zero for irregular ones.
        """
        weight = np.zeros(self.length(len(DIRECTIONS)), np.float32)
        numbers = np.zeros((self.window_count, len(DIRECTIONS), LANE_COUNT), np.float32)
        values = model.spring_weight if spring_weight is None else spring_weight
        self.write_window_weight(model, values, np.float32(1.0), numbers)
        copy_from_windows(numbers, self.window_rows, self.stride, len(DIRECTIONS), weight)
        return weight

    def write_window_weight(self, model: LatticeModel, values: Float32, scale: np.float32, numbers: Float32) -> bool:
        """Write values of the springs times a number, by window; whether any is not zero.

        Parameters
        ----------
        model
            The lattice.
        values, scale
            Values of the springs, shape (spring_count,), and the number.
        numbers
            Numbers of each window's lanes by themselves, shape (any, 9 or more, 8), of which the first nine are
            written where there is a spring that is not irregular.
        """
        springs = (model.spring_nodes, model.spring_direction, values, scale)
        first = np.empty(model.node_count + 1, np.int32)
        acts = bool(weigh_windows(*springs, self.node_slot, numbers, first))
        irregular = self.irregular_springs(model, first)
        if len(irregular):
            leave_out(*springs, irregular, first, self.node_slot, numbers)
        return acts

    def uniform_weight(self, model: LatticeModel) -> Float32:
        """Stiffness of all springs of a window's nodes, where each has 18 and all are alike, else 0 [k].

        Shape (window_count,).
        """
        regular = np.ones(model.spring_count, np.bool_)
        regular[self.irregular_springs(model)] = False
        ends = model.spring_nodes[regular].ravel()
        both = np.repeat(model.spring_weight[regular], 2)
        lowest = np.where(np.bincount(ends, minlength=model.node_count) == 2 * len(DIRECTIONS), np.inf, 0.0)
        highest = np.zeros(model.node_count)
        np.minimum.at(lowest, ends, both)
        np.maximum.at(highest, ends, both)
        by_lane, first = self.slots.by_lane, self.slots.first[:-1]
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
    index, node_count = model.node_index, model.node_count
    rows = numbered_rows(index)
    layer, is_copied = layers_of_copies(model, rows)
    has_copies = len(is_copied) > 0
    first_block = rows.low[0] // LANE_COUNT
    layer_blocks = rows.high[0] // LANE_COUNT - first_block + 2
    is_stored = np.zeros((rows.count, layer_blocks * (int(layer.max()) + 1)), np.int8)
    block_of = np.empty(node_count, np.int32)
    # The springs of whole cells are known from their corners.
    are_whole = bool(model.cell_is_whole.all())
    cells = model.cells if are_whole else model.cells[:0]
    mark_blocks(index, rows.row, layer, cells, model.cell_corners, first_block, layer_blocks, is_stored, block_of)
    if not are_whole:
        mark_over_springs(index, model.spring_nodes, block_of, is_stored)
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
    lane_count = int(run_start[-1]) + LANE_COUNT * (int(block_counts[-1]) + 1)
    start = np.empty(block_count + run_count, np.int64)
    slot_of = np.zeros(lane_count // LANE_COUNT + 1, np.int32)
    start_slots(block_counts, run_start, start, slot_of)

    node_in = np.empty(LANE_COUNT * len(start), np.int32)
    node_lane, node_slot = np.empty(node_count, np.int64), np.empty(node_count, np.int64)
    by_lane, first = np.empty(node_count, np.int32), np.empty(node_count + 1, np.int32)
    window_count = lay_out_nodes(index, block_of, number, start, node_in, node_lane, node_slot, by_lane, first)
    slots = Slots(slot_of, node_in, by_lane, first[: window_count + 1].copy())
    leading = by_lane[slots.first[:-1]]
    window_rows = np.full((window_count + 1, len(ROWS)), EMPTY_START)[:-1]
    around = rows.around(index, leading)
    rows_of_windows(around, leading, index, first_block, number, start, node_lane, window_rows)
    layout = LaneLayout(
        lane_count=lane_count,
        stride=BANK_LANES if in_banks else lane_count,
        node_lane=node_lane,
        node_slot=node_slot,
        window_rows=window_rows,
        is_near_copies=np.zeros(node_count, np.bool_),
        irregular_cells=np.zeros(0, np.int64),
        ghost_start=np.zeros(0, np.int64),
        slots=slots,
        near_cells=np.zeros(0, np.int64),
    )
    if has_copies:
        near_cells = rows_near_copies(model, layout, around, is_copied)
        irregular = irregular_cells(model, layout, near_cells)
        layout = replace(layout, near_cells=near_cells[0])
        ghost_blocks = np.full(-(-len(irregular) // GHOST_CELLS), len(CORNER_ROWS))
        room = capacity if in_banks else capacity + (len(CORNER_ROWS) + 1) * len(ghost_blocks)
        ghost_start = _run_starts(np.concatenate([block_counts, ghost_blocks]), room)[run_count:]
        if len(irregular):
            last = int(ghost_start[-1]) + LANE_COUNT * (len(CORNER_ROWS) + 1)
            layout = replace(layout, lane_count=last, irregular_cells=irregular, ghost_start=ghost_start)
            layout = layout if in_banks else replace(layout, stride=last)
    return layout


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
