"""Layouts of lanes in plain NumPy over all pairs and keys: the oracle of the kernels that build them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, distinct_keys, lattice_keys
from heartcase.simulator.engine.shared import lanes
from heartcase.simulator.engine.shared.lanes import LANE_COUNT, ROWS
from heartcase.simulator.lattice.model import DIRECTIONS
from tests.simulator.engine.plain_node_copies import copied_rows, irregular_cells, vote_for_rows


@dataclass(frozen=True)
class PlainLayout:
    """What a LaneLayout says."""

    lane_count: int
    stride: int
    node_lane: np.ndarray
    node_slot: np.ndarray
    window_rows: np.ndarray
    is_near_copies: np.ndarray
    irregular_cells: np.ndarray
    ghost_start: np.ndarray

    @cached_property
    def node_at(self):
        nodes = np.full(self.lane_count, -1, np.int32)
        nodes[self.node_lane] = np.arange(len(self.node_lane))
        return nodes

    def neighbour_lanes(self, nodes, offset):
        i, j, k = offset.tolist()
        slot = self.node_slot[nodes]
        return self.window_rows[slot // LANE_COUNT, (j + 1) + 3 * (k + 1)] + slot % LANE_COUNT + i


@dataclass(frozen=True)
class PlainCells:
    """What a CellLayout says of the cells."""

    cell_lane: np.ndarray
    cell_slot: np.ndarray
    window_rows: np.ndarray
    in_pairs: np.ndarray
    ghost_window: int
    touches: np.ndarray
    ghost_lane: np.ndarray


def plain_lane_layout(model, *, in_banks=False):
    """The layout of a lattice."""
    rows = copied_rows(model)
    layer = np.zeros(model.node_count, np.int64) if rows is None else rows.layer
    i, j, k = model.node_index.astype(np.int64).T
    block = i // LANE_COUNT
    first_block = int(block.min())
    layer_blocks = int(np.ptp(block)) + 2

    def keys_of(block, layer, j, k):
        return lattice_keys(np.stack([block - first_block + layer * layer_blocks, j, k], axis=-1))

    keys = keys_of(block, layer, j, k)
    # A spring over a block's end is found through the block at the same i in the other's row: store that too.
    over = model.spring_nodes[np.diff(block[model.spring_nodes], axis=1)[:, 0] != 0]
    beside = [keys_of(block[there], layer[here], j[here], k[here]) for here, there in (over.T, over.T[::-1])]
    stored = distinct_keys(np.concatenate([keys, *beside]))
    run = np.cumsum(np.diff(stored, prepend=stored[0] - 2) != 1) - 1
    block_counts = np.bincount(run)
    capacity = lanes.BANK_LANES // LANE_COUNT if in_banks else lanes._HEAD_BLOCKS + len(stored) + 2 * len(block_counts)
    run_start = lanes._run_starts(block_counts, capacity)
    before = np.cumsum(block_counts) - block_counts
    start = run_start[run] + LANE_COUNT * (np.arange(len(stored)) - before[run])

    node_lane = start[np.searchsorted(stored, keys)] + i % LANE_COUNT
    by_lane = np.argsort(node_lane) if rows is not None else np.arange(model.node_count)
    first, window_by_lane = _windows(node_lane[by_lane])
    first = by_lane[first]
    window = np.empty_like(window_by_lane)
    window[by_lane] = window_by_lane
    window_rows = np.full((len(first), len(ROWS)), lanes.EMPTY_START)
    rows_j, rows_k = j[first, None] + ROWS[:, 0], k[first, None] + ROWS[:, 1]
    # The next block, then the window's own: where it is there, so are the lanes of the other, empty or not.
    for ahead in (1, 0):
        row_keys = keys_of(
            np.broadcast_to(block[first, None] + ahead, rows_j.shape), np.zeros_like(rows_j), rows_j, rows_k
        )
        nearest = np.minimum(np.searchsorted(stored, row_keys), len(stored) - 1)
        is_there = stored[nearest] == row_keys
        place = np.broadcast_to(i[first, None] % LANE_COUNT, is_there.shape)
        window_rows[is_there] = (start[nearest] + place - ahead * LANE_COUNT)[is_there]
    window_rows[:, 4] = node_lane[first]

    layout = PlainLayout(
        lane_count=int(start[-1]) + 2 * LANE_COUNT,
        stride=0,
        node_lane=node_lane,
        node_slot=LANE_COUNT * window + node_lane - node_lane[first][window],
        window_rows=window_rows,
        is_near_copies=np.zeros(model.node_count, np.bool_),
        irregular_cells=np.zeros(0, np.int64),
        ghost_start=np.zeros(0, np.int64),
    )
    if rows is not None:
        row_keys = lattice_keys(np.stack([np.zeros_like(rows_j), rows_j, rows_k], axis=-1))
        is_near = np.asarray(np.isin(row_keys, rows.row_keys).any(axis=1))
        near = np.flatnonzero(is_near)
        window_rows[near] = np.where(np.arange(len(ROWS)) == 4, window_rows[near], lanes.EMPTY_START)
        vote_for_rows(model, node_lane, layout.node_slot, near, window_rows, layout.lane_count)
        layout = replace(layout, is_near_copies=is_near[window])
        irregular = irregular_cells(model, layout)
        ghost_blocks = np.full(-(-len(irregular) // lanes.GHOST_CELLS), len(lanes.CORNER_ROWS))
        room = capacity if in_banks else capacity + (len(lanes.CORNER_ROWS) + 1) * len(ghost_blocks)
        ghost_start = lanes._run_starts(np.concatenate([block_counts, ghost_blocks]), room)[len(block_counts) :]
        if len(irregular):
            last = int(ghost_start[-1]) + LANE_COUNT * (len(lanes.CORNER_ROWS) + 1)
            layout = replace(layout, lane_count=last, irregular_cells=irregular, ghost_start=ghost_start)
    return replace(layout, stride=lanes.BANK_LANES if in_banks else layout.lane_count)


def _windows(node_lane):
    """First node of each window, and window of each node: a window begins at the first node that none holds yet."""
    first, window, end = [], np.empty(len(node_lane), np.int64), -1
    for node, lane in enumerate(node_lane.tolist()):
        if lane >= end:
            first.append(node)
            end = lane + LANE_COUNT
        window[node] = len(first) - 1
    return np.array(first), window


def plain_cell_layout(model, layout):
    """Lay out the cells of a lattice in the lanes of its nodes."""
    irregular = layout.irregular_cells
    regular = np.delete(np.arange(model.cell_count), irregular)
    slots = layout.node_slot[model.cell_corners]
    own = slots[regular, 0] // LANE_COUNT
    # Parts of windows of nodes, by kind: those that are pairs, others; each a place in a window of cells and its rows.
    part_of, first_of, parts, in_pairs, filled = {}, {}, [], [], {True: 4, False: 4}
    open_window = {}
    for window in np.unique(own).tolist():
        places = slots[regular, 0][own == window] % LANE_COUNT
        is_pair = bool(np.ptp(places) >= lanes.PART_LANES)
        if filled[is_pair] == lanes.CELL_PARTS:
            open_window[is_pair], filled[is_pair] = len(in_pairs), 0
            in_pairs.append(is_pair)
            parts.append([None] * lanes.CELL_PARTS)
        first = 0 if is_pair else min(int(places.min()), lanes.PART_LANES)
        part_of[window] = lanes.CELL_PARTS * open_window[is_pair] + filled[is_pair]
        first_of[window] = first
        for shift in (first, first + lanes.PART_LANES)[: 1 + is_pair]:
            parts[open_window[is_pair]][filled[is_pair]] = layout.window_rows[window, lanes.CORNER_ROWS] + shift
            filled[is_pair] += 1
    ghost_window = len(in_pairs)
    blocks = [start + LANE_COUNT * np.arange(4) + shift for start in layout.ghost_start for shift in (0, 4)]
    for first in range(0, len(blocks), lanes.CELL_PARTS):
        these = blocks[first : first + lanes.CELL_PARTS]
        parts.append(these + [None] * (lanes.CELL_PARTS - len(these)))
        in_pairs.append(True)
    empty = np.full(4, lanes.EMPTY_START)
    rows = np.array([np.concatenate([empty if part is None else part for part in each]) for each in parts])

    cell_lane = layout.node_lane[model.cell_corners[:, 0]]
    cell_slot = np.empty(model.cell_count, np.int64)
    for cell, window in zip(regular.tolist(), own.tolist(), strict=True):
        cell_slot[cell] = lanes.PART_LANES * part_of[window] + slots[cell, 0] % LANE_COUNT - first_of[window]
    place = np.arange(len(irregular))
    behind = 2 * (place % lanes.GHOST_CELLS)
    cell_lane[irregular] = layout.ghost_start[place // lanes.GHOST_CELLS] + behind
    cell_slot[irregular] = lanes.CELL_LANES * ghost_window + LANE_COUNT * (place // lanes.GHOST_CELLS) + behind
    offset = CORNER_OFFSETS.astype(np.int64)
    ghost_lane = cell_lane[irregular, None] + offset[:, 0] + LANE_COUNT * (offset[:, 1] + 2 * offset[:, 2])

    window_of_cell, window_count = cell_slot // lanes.CELL_LANES, len(layout.window_rows)
    pairs = distinct_keys((window_of_cell[:, None] * window_count + slots // LANE_COUNT).ravel())
    here, there = pairs // window_count, pairs % window_count
    place = np.arange(len(pairs)) - np.searchsorted(here, here)
    touches = np.full((len(rows), max(8, int(place.max()) + 1)), -1, np.int64)
    touches[here, place] = there
    return PlainCells(cell_lane, cell_slot, rows, np.array(in_pairs, np.int8), ghost_window, touches, ghost_lane)


def plain_irregular_springs(model, lookup):
    """Springs that kernels do not find at both ends, or would take for another node's, shape (spring_count,)."""
    irregular = np.zeros(model.spring_count, np.bool_)
    ends = model.spring_nodes.astype(np.int64)
    is_near = lookup.is_near_copies
    near = np.flatnonzero(is_near[ends].any(axis=1))
    nodes = np.flatnonzero(is_near)
    for number, offset in enumerate(DIRECTIONS):
        springs = near[model.spring_direction[near] == number]
        lower, higher = ends[springs].T
        fits = lookup.neighbour_lanes(lower, offset) == lookup.node_lane[higher]
        fits &= lookup.neighbour_lanes(higher, -offset) == lookup.node_lane[lower]
        irregular[springs[~fits]] = True
        spring_of = np.full(model.node_count, -1)
        kept = np.flatnonzero((model.spring_direction == number) & ~irregular)
        spring_of[ends[kept, 0]] = kept
        found = spring_of[lookup.node_at[lookup.neighbour_lanes(nodes, -offset)]]
        found[lookup.node_at[lookup.neighbour_lanes(nodes, -offset)] < 0] = -1
        is_wrong = (found >= 0) & (ends[found, 1] != nodes)
        irregular[found[is_wrong]] = True
    return irregular


def plain_spring_weight(model, layout, values):
    """Values of the springs from each lane."""
    weight = np.zeros(layout.lane_count + (len(DIRECTIONS) - 1) * layout.stride, np.float32)
    regular = ~plain_irregular_springs(model, layout)
    lower = layout.node_lane[model.spring_nodes[regular, 0]]
    weight[layout.stride * model.spring_direction[regular].astype(np.int64) + lower] = values[regular]
    return weight


def plain_window_numbers(model, layout):
    """Acting stiffness of the springs and inverse mass of each window's lanes, and zeros."""
    weight = plain_spring_weight(model, layout, model.acting_weight)
    window_lanes = layout.window_rows[:, 4, None] + np.arange(LANE_COUNT)
    numbers = np.zeros((len(window_lanes) + 1, len(DIRECTIONS) + 1, LANE_COUNT), np.float32)
    for direction in range(len(DIRECTIONS)):
        numbers[:-1, direction] = weight[direction * layout.stride + window_lanes]
    inverse_mass = np.zeros(layout.lane_count, np.float32)
    inverse_mass[layout.node_lane] = model.inverse_mass
    numbers[:-1, -1] = inverse_mass[window_lanes]
    return numbers


def plain_by_window(cells, values):
    """Numbers of each cell, shape (any, cell_count), of each window's lanes by themselves."""
    numbers = np.zeros((len(cells.window_rows), len(values), lanes.CELL_LANES), np.float32)
    numbers[cells.cell_slot // lanes.CELL_LANES, :, cells.cell_slot % lanes.CELL_LANES] = values.T
    return numbers


def plain_by_node_window(cells, layout, values):
    """Eight numbers of each cell, one for each corner, by the windows of the corners' nodes, but of irregular ones."""
    cell_at = np.full(layout.lane_count, -1)
    cell_at[cells.cell_lane] = np.arange(len(cells.cell_lane))
    cell_at[cells.ghost_lane.ravel()] = -1
    rows = layout.window_rows
    numbers = np.zeros((len(rows), len(CORNER_OFFSETS), LANE_COUNT), np.float32)
    for corner, (i, j, k) in enumerate(CORNER_OFFSETS.tolist()):
        cell = cell_at[rows[:, 4 - j - 3 * k, None] - i + np.arange(LANE_COUNT)]
        numbers[:, corner] = np.where(cell >= 0, values[corner, cell], np.float32(0.0))
    return numbers


def plain_ghost_arrays(model, cells, layout):
    """The ghosts of a layout, as GhostArrays has them from ``lane`` on."""
    nodes = model.cell_corners[layout.irregular_cells].astype(np.int64).ravel()
    ghosted = np.unique(nodes)
    ghosted = ghosted[np.argsort(layout.node_lane[ghosted])]
    place = np.full(model.node_count, -1)
    place[ghosted] = np.arange(len(ghosted))
    by_node = np.argsort(place[nodes], kind="stable")
    window_count = len(layout.window_rows)
    node_first = np.searchsorted(layout.node_slot[ghosted] // LANE_COUNT, np.arange(window_count + 1))
    has_ghosts = np.diff(node_first) > 0
    return (
        cells.ghost_lane.ravel(),
        layout.node_lane[nodes],
        node_first,
        layout.node_lane[ghosted],
        np.where(has_ghosts, np.cumsum(has_ghosts) - 1, -1),
        np.searchsorted(place[nodes][by_node], np.arange(len(ghosted) + 1)),
        by_node,
        np.repeat(cells.cell_lane[layout.irregular_cells], 8),
    )


def plain_springs_by_node(springs, node_index, more):
    """Explicit springs and more by node: what SpringsByNode has."""
    nodes = np.concatenate([springs.nodes, more[0]])
    stiffness = np.concatenate([springs.stiffness, more[1]])
    rest_length = np.concatenate([springs.rest_length.astype(np.float64), more[2]])
    here, there = np.concatenate([nodes, nodes[:, ::-1]]).T
    order = np.argsort(here, kind="stable")
    here, there, length = here[order], there[order], np.tile(rest_length, 2)[order]
    way = (node_index[there] - node_index[here]).astype(np.float64)
    excess = (way**2).sum(axis=1) - length**2
    return (
        np.concatenate([[0], np.cumsum(np.bincount(here, minlength=len(node_index)))]).astype(np.int32),
        there.astype(np.int32),
        np.column_stack([way, length]).astype(np.float32),
        np.where(np.abs(excess) < 1e-12 * length**2, 0.0, excess).astype(np.float32),
        np.tile(stiffness, 2)[order].astype(np.float32),
    )


def plain_springs_apart(model, layout):
    """Explicit springs and those that are irregular, by node."""
    irregular = plain_irregular_springs(model, layout) & (model.acting_weight > 0)
    more = (model.spring_nodes[irregular], model.acting_weight[irregular], model.spring_length[irregular])
    return plain_springs_by_node(model.explicit, model.node_index, more)


def plain_explicit_arrays(layout, by_node):
    """Nodes with springs in groups, of springs by node; what ExplicitArrays has."""
    springs_first, springs_other, offset, excess, stiffness = by_node
    counts = np.diff(springs_first)
    nodes = np.flatnonzero(counts)
    nodes = nodes[np.argsort(layout.node_lane[nodes])]
    nodes = nodes[np.lexsort((-counts[nodes], np.arange(len(nodes)) // (8 * LANE_COUNT)))]
    group_count = -(-len(nodes) // LANE_COUNT)
    group, place = np.divmod(np.arange(len(nodes)), LANE_COUNT)
    lane = np.full((group_count, LANE_COUNT), lanes.EMPTY_START)
    lane[group, place] = layout.node_lane[nodes]
    window = np.repeat(layout.node_slot[nodes[::LANE_COUNT], None] // LANE_COUNT, LANE_COUNT, axis=1)
    window[group, place] = layout.node_slot[nodes] // LANE_COUNT
    longest = np.maximum.reduceat(counts[nodes], np.arange(0, len(nodes), LANE_COUNT)) if len(nodes) else counts[:0]
    first = np.concatenate([[0], np.cumsum(longest)]).astype(np.int64)
    other = np.repeat(lane, longest, axis=0)
    numbers = np.zeros((len(other), 6, LANE_COUNT), np.float32)
    numbers[:, [0, 3]] = 1.0
    of_node = np.repeat(np.arange(len(nodes)), counts[nodes])
    number = np.arange(len(of_node)) - np.repeat(np.cumsum(counts[nodes]) - counts[nodes], counts[nodes])
    spring = springs_first[nodes][of_node] + number
    row, column = first[group[of_node]] + number, place[of_node]
    other[row, column] = layout.node_lane[springs_other[spring]]
    numbers[row, :4, column] = offset[spring]
    numbers[row, 4, column] = excess[spring]
    numbers[row, 5, column] = stiffness[spring]
    return lane, window, first, other, numbers


def plain_windows_behind(layout):
    window_count = len(layout.window_rows)
    window_of_lane = np.full(layout.lane_count, -1, np.int32)
    window_of_lane[layout.window_rows[:, 4, None] + np.arange(LANE_COUNT)] = np.arange(window_count)[:, None]
    row_of = {(int(j), int(k)): number for number, (j, k) in enumerate(ROWS)}
    found = [
        window_of_lane[layout.window_rows[:, row_of[-j, -k], None] - i + np.arange(LANE_COUNT)]
        for i, j, k in DIRECTIONS.tolist()
    ]
    behind = np.sort(np.concatenate(found, axis=1), axis=1)[:, ::-1]
    behind[:, 1:][behind[:, 1:] == behind[:, :-1]] = -1
    behind[behind == np.arange(window_count)[:, None]] = -1
    behind = np.sort(behind, axis=1)[:, ::-1]
    return np.ascontiguousarray(behind[:, : max(1, int((behind >= 0).sum(axis=1).max(initial=0)))])


def plain_corner_guard_scale(model):
    """Stiffness of the corner guard of each cell [k/h]."""
    own = model.cell_coverage * model.cell_stiffness
    corners = model.cell_corners.ravel()
    around = np.bincount(corners, np.repeat(own, 8), minlength=model.node_count)
    mean = np.divide(around, np.bincount(corners, minlength=model.node_count), out=around, where=around > 0)
    mean[model.node_is_fixed] = np.inf
    least = mean[model.cell_corners].min(axis=1)
    scale = np.where(np.isfinite(least), np.maximum(own, least), own)
    return np.where(model.cell_is_whole, model.law.corner_stiffness * scale, 0.0).astype(np.float32)
