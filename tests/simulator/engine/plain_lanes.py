"""Layouts of lanes in plain NumPy over all pairs and keys: the oracle of the kernels that build them."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import numpy as np

from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, distinct_keys, lattice_keys
from heartcase.simulator.engine.shared import lanes, node_copies
from heartcase.simulator.engine.shared.lanes import LANE_COUNT, ROWS, LaneLayout
from heartcase.simulator.engine.shared.node_copies import copied_rows, irregular_cells, vote_for_rows
from heartcase.simulator.lattice.model import DIRECTIONS


def plain_lane_layout(model, *, in_banks=False):
    """The layout of a lattice."""
    with patch.object(node_copies, "_grouped", _grouped), patch.object(node_copies, "are_among", np.isin):
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
    first, window_by_lane = lanes._windows(node_lane[by_lane])
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

    layout = LaneLayout(
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
        ghost_blocks = np.full(-(-len(irregular) // lanes.GHOST_CELLS), len(lanes._GHOST_ROWS))
        room = capacity if in_banks else capacity + (len(lanes._GHOST_ROWS) + 1) * len(ghost_blocks)
        ghost_start = lanes._run_starts(np.concatenate([block_counts, ghost_blocks]), room)[len(block_counts) :]
        if len(irregular):
            last = int(ghost_start[-1]) + LANE_COUNT * (len(lanes._GHOST_ROWS) + 1)
            layout = replace(layout, lane_count=last, irregular_cells=irregular, ghost_start=ghost_start)
    return replace(layout, stride=lanes.BANK_LANES if in_banks else layout.lane_count)


def _grouped(model, path, rows):
    """Number of the run that each path lies in."""
    path_count = int(path.max()) + 1
    # A row without copies counts as one path.
    _, row = np.unique(rows, return_inverse=True)
    element = np.where(path >= 0, path, path_count + row)
    corners = model.cell_corners[(path[model.cell_corners] >= 0).any(axis=1)]
    a, b = node_copies._BESIDE.T
    pairs = np.stack([element[corners[:, a]].ravel(), element[corners[:, b]].ravel()], axis=1)
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    pairs = pairs[pairs[:, 1] < path_count]
    keys, weight = np.unique(pairs[:, 0] * path_count + pairs[:, 1], return_counts=True)
    middle, side = keys // path_count, keys % path_count
    # Sides of one middle that lie in one row follow each other.
    row_of_path = np.zeros(path_count, np.int64)
    row_of_path[path[path >= 0]] = row[path >= 0]
    order = np.lexsort((side, row_of_path[side], middle))
    middle, side, weight = middle[order], side[order], weight[order]
    couples = np.empty((node_copies.couple(middle, side, weight, row_of_path, np.empty((0, 3), np.int64)), 3), np.int64)
    node_copies.couple(middle, side, weight, row_of_path, couples)
    i = model.node_index[:, 0].astype(np.int64)
    low, high = np.full(path_count, np.iinfo(np.int64).max), np.full(path_count, np.iinfo(np.int64).min)
    np.minimum.at(low, path[path >= 0], i[path >= 0])
    np.maximum.at(high, path[path >= 0], i[path >= 0])
    one, other, common = couples.T
    gap = np.maximum(low[one], low[other]) - np.minimum(high[one], high[other])
    couples = couples[np.lexsort((other, one, -common, gap))]
    couples = couples[np.sort(gap) <= 8]
    group = np.arange(path_count)
    node_copies.group_paths(couples, low, high, group)
    return group


def plain_cell_layout(model, layout):
    """Lay out the cells of a lattice in the lanes of its nodes."""
    irregular = layout.irregular_cells
    regular = np.delete(np.arange(model.cell_count), irregular)
    windows = layout.node_slot[model.cell_corners] // LANE_COUNT
    held, number = np.unique(windows[regular, 0], return_inverse=True)
    window_of_cell = np.empty(model.cell_count, np.int64)
    window_of_cell[regular] = number
    place = np.arange(len(irregular))
    window_of_cell[irregular] = len(held) + place // lanes.GHOST_CELLS
    cell_lane = layout.node_lane[model.cell_corners[:, 0]]
    cell_lane[irregular] = layout.ghost_start[place // lanes.GHOST_CELLS] + 2 * (place % lanes.GHOST_CELLS)
    offset = CORNER_OFFSETS.astype(np.int64)
    ghost_lane = cell_lane[irregular, None] + offset[:, 0] + LANE_COUNT * (offset[:, 1] + 2 * offset[:, 2])
    ghost_rows = np.full((len(layout.ghost_start), len(ROWS)), lanes.EMPTY_START)
    ghost_rows[:, lanes._GHOST_ROWS] = layout.ghost_start[:, None] + LANE_COUNT * np.arange(len(lanes._GHOST_ROWS))

    pairs = distinct_keys((window_of_cell[:, None] * layout.window_count + windows).ravel())
    here, there = pairs // layout.window_count, pairs % layout.window_count
    place = np.arange(len(pairs)) - np.searchsorted(here, here)
    touches = np.full((len(held) + len(ghost_rows), max(8, int(place.max()) + 1)), -1, np.int64)
    touches[here, place] = there
    rows = np.concatenate([layout.window_rows[held], ghost_rows])
    # The middle one of a window's rows is its own.
    cell_slot = LANE_COUNT * window_of_cell + cell_lane - rows[window_of_cell, 4]
    return lanes.CellLayout(
        layout=layout,
        cell_lane=cell_lane,
        cell_slot=cell_slot,
        window_rows=rows,
        touches=touches,
        ghost_lane=ghost_lane,
    )


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


def plain_spring_weight(model, layout):
    """Stiffness of the springs from each lane."""
    weight = np.zeros(layout.length(len(DIRECTIONS)), np.float32)
    regular = ~plain_irregular_springs(model, layout)
    lower = layout.node_lane[model.spring_nodes[regular, 0]]
    weight[layout.stride * model.spring_direction[regular].astype(np.int64) + lower] = model.spring_weight[regular]
    return weight


def plain_windows_behind(layout):
    window_count = layout.window_count
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
