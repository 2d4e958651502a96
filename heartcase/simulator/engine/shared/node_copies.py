"""Lanes for a lattice that was cut: several nodes in one place, and what does not lie at a fixed distance.

A row of nodes along i that has copies is taken apart into paths, along which each node follows the one before it. Paths
that do not overlap and have neighbours in common share a run of lanes, a layer of the row. A window of nodes finds the
rows around it where most of its nodes' neighbours lie: near a cut, some of its lanes belong to one side and some to the
other. Springs and cells whose ends lie elsewhere are irregular: springs become explicit ones, and cells get ghosts of
their corners' nodes (:mod:`heartcase.simulator.engine.shared.lanes`). They are few beside what a large cut parts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from heartcase.schemas.arrays import Bool, Int32, Int64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, lattice_keys
from heartcase.simulator.engine.shared.lane_kernels import mark_irregular
from heartcase.simulator.engine.shared.node_copy_kernels import couple, group_paths, match, vote, walk
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel

__all__ = ["CopiedRows", "Lookup", "are_among", "copied_rows", "irregular_cells", "irregular_springs", "vote_for_rows"]

_BESIDE = np.array([(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) & 1 == 0])
"""Corners of a cell in different rows at one i, shape (12, 2)."""
_WINDOWS_AT_ONCE = 1024
"""Windows that vote at once: 9 kB each."""


class Lookup(Protocol):
    """Where the kernels look for a node's neighbours."""

    @property
    def node_lane(self) -> Int64:
        """Lane of each node, shape (node_count,)."""

    @property
    def node_slot(self) -> Int64:
        """Number of its window times 8 plus its place there, shape (node_count,)."""

    @property
    def window_rows(self) -> Int64:
        """Lane at the window's first i in the nine rows, for each window, shape (window_count, 9)."""

    @property
    def is_near_copies(self) -> Bool:
        """Whether a node's window lies in or beside a row with copies, shape (node_count,)."""

    @property
    def node_at(self) -> Int32:
        """Node in each lane, -1 where there is none, shape (lane_count,)."""

    def neighbour_lanes(self, nodes: Int64, offset: Int32) -> Int64:
        """Lanes in which the kernels look for the neighbours of some nodes, shape (count,)."""


@dataclass(frozen=True)
class CopiedRows:
    """Rows along i in which a node has copies."""

    row_keys: Int64
    """Key of each, that of place (0, j, k), ascending, shape (row_count,)."""
    layer: Int64
    """Layer of its row that each node lies in, 0 in all other rows, shape (node_count,)."""


def copied_rows(model: LatticeModel) -> CopiedRows | None:
    """The rows of a lattice that have copies, in layers; None where no node has any."""
    keys = lattice_keys(model.node_index)
    if (np.diff(keys) > 0).all():
        return None
    places = model.node_index.copy()
    places[:, 0] = 0
    rows = lattice_keys(places)
    order = np.argsort(keys, kind="stable")
    twins = order[1:][np.diff(keys[order]) == 0]
    row_keys = np.unique(rows[twins])
    is_copied = are_among(rows, row_keys)
    after, before = _paths(model, is_copied)
    starts = np.flatnonzero(is_copied & (before < 0))
    path = np.full(model.node_count, -1, np.int64)
    walk(starts, after, path)
    group = _grouped(model, path, rows)
    # The layers of a row are numbered by their first paths.
    order = np.lexsort((keys[starts], rows[starts]))
    _, first = np.unique(group[order], return_index=True)
    leading = order[np.sort(first)]
    row_of = rows[starts[leading]]
    number = np.arange(len(leading)) - np.searchsorted(row_of, row_of)
    layer_of_group = np.zeros(len(starts), np.int64)
    layer_of_group[group[leading]] = number
    return CopiedRows(row_keys, np.where(is_copied, layer_of_group[group[path]], 0))


def are_among(keys: Int64, listed: Int64) -> Bool:
    """Which keys are listed, in ascending order and not none."""
    among: Bool = listed[np.minimum(np.searchsorted(listed, keys), len(listed) - 1)] == keys
    return among


def _paths(model: LatticeModel, is_copied: Bool) -> tuple[Int64, Int64]:
    """Node after and before each node on its path, -1 for none; nodes that share most cells follow each other."""
    corners = model.cell_corners[is_copied[model.cell_corners].any(axis=1)].astype(np.int64)
    links = corners.reshape(-1, 4, 2).reshape(-1, 2)
    links = links[is_copied[links[:, 0]]]
    pairs, count = np.unique(links[:, 0] * model.node_count + links[:, 1], return_counts=True)
    pairs = pairs[np.lexsort((pairs, -count))]
    after, before = np.full(model.node_count, -1, np.int64), np.full(model.node_count, -1, np.int64)
    match(pairs // model.node_count, pairs % model.node_count, after, before)
    return after, before


def _grouped(model: LatticeModel, path: Int64, rows: Int64) -> Int64:
    """Number of the run that each path lies in: that of its first path, shape (path_count,).

    Those that have most neighbours in common come together first, so that a window finds all of its neighbours at one
    distance.
    """
    path_count = int(path.max()) + 1
    # A row without copies counts as one path.
    corners = model.cell_corners[(path >= 0)[model.cell_corners].any(axis=1)]
    nodes = np.flatnonzero(np.bincount(corners.ravel(), minlength=model.node_count))
    row = np.full(model.node_count, -1)
    row[nodes] = np.unique(rows[nodes], return_inverse=True)[1].ravel()
    element = np.where(path >= 0, path, path_count + row)
    a, b = _BESIDE.T
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
    couples = np.empty((couple(middle, side, weight, row_of_path, np.empty((0, 3), np.int64)), 3), np.int64)
    couple(middle, side, weight, row_of_path, couples)
    i = model.node_index[:, 0].astype(np.int64)
    low, high = np.full(path_count, np.iinfo(np.int64).max), np.full(path_count, np.iinfo(np.int64).min)
    np.minimum.at(low, path[path >= 0], i[path >= 0])
    np.maximum.at(high, path[path >= 0], i[path >= 0])
    one, other, common = couples.T
    gap = np.maximum(low[one], low[other]) - np.minimum(high[one], high[other])
    couples = couples[np.lexsort((other, one, -common, gap))]
    couples = couples[np.sort(gap) <= 8]
    group = np.arange(path_count)
    group_paths(couples, low, high, group)
    return group


def vote_for_rows(
    model: LatticeModel, node_lane: Int64, node_slot: Int64, windows: Int64, window_rows: Int64, lane_count: int
) -> None:
    """Write the rows of some windows of 8 lanes: where most neighbours of their nodes lie.

    Parameters
    ----------
    model
        The lattice.
    node_lane
        Lane of each node, shape (node_count,).
    node_slot
        Number of its window times 8 plus its place there, shape (node_count,).
    windows
        Windows to find rows for, shape (count,).
    window_rows
        Rows of all windows, shape (window_count, 9); numbers (j + 1) + 3 (k + 1) for the rows around.
    """
    window_count = len(window_rows)
    is_asked = np.zeros(window_count, np.bool_)
    is_asked[windows] = True
    asks = is_asked[node_slot // 8]
    corners = model.cell_corners[asks[model.cell_corners].any(axis=1)]
    # The room for votes does not grow with the cut.
    for first in range(0, len(windows), _WINDOWS_AT_ONCE):
        some = windows[first : first + _WINDOWS_AT_ONCE]
        if len(windows) > _WINDOWS_AT_ONCE:
            is_asked[:] = False
            is_asked[some] = True
            asks = is_asked[node_slot // 8]
        vote(corners, model.node_index, node_lane, node_slot, asks, some, window_rows, window_count, lane_count)


def irregular_springs(model: LatticeModel, lookup: Lookup) -> Bool:
    """Springs that kernels do not find at both ends, or would take for another node's, shape (spring_count,)."""
    irregular = np.zeros(model.spring_count, np.bool_)
    mark_irregular(
        model.spring_nodes,
        model.spring_direction,
        DIRECTIONS,
        lookup.is_near_copies,
        lookup.node_lane,
        lookup.node_slot,
        lookup.window_rows,
        lookup.node_at,
        irregular,
    )
    return irregular


def irregular_cells(model: LatticeModel, lookup: Lookup) -> Int64:
    """Cells whose corners the kernels do not find, or that they would take for another node's, ascending."""
    is_near = lookup.is_near_copies
    corners = model.cell_corners.astype(np.int64)
    near = np.flatnonzero(is_near[corners].any(axis=1))
    if not len(near):
        return near
    irregular = np.zeros(model.cell_count, np.bool_)
    lowest = corners[near, 0]
    for number, offset in enumerate(CORNER_OFFSETS):
        there = corners[near, number]
        fits = lookup.neighbour_lanes(lowest, offset) == lookup.node_lane[there]
        fits &= lookup.neighbour_lanes(there, -offset) == lookup.node_lane[lowest]
        irregular[near[~fits]] = True
    # Of cells with one lowest node, the first keeps its lane.
    kept = near[~irregular[near]]
    _, first = np.unique(corners[kept, 0], return_index=True)
    irregular[np.delete(kept, first)] = True
    cell_of = np.full(model.node_count, -1)
    kept = np.flatnonzero(~irregular)
    cell_of[corners[kept, 0]] = kept
    nodes = np.flatnonzero(is_near)
    for number, offset in enumerate(CORNER_OFFSETS):
        behind = lookup.node_at[lookup.neighbour_lanes(nodes, -offset)]
        found = np.where(behind >= 0, cell_of[behind], -1)
        is_wrong = (found >= 0) & (corners[found, number] != nodes)
        irregular[found[is_wrong]] = True
    return np.flatnonzero(irregular)
