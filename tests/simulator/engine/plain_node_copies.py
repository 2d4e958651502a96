"""Rows with copies in plain NumPy over whole arrays: the oracle of the kernels that lay them out."""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import NamedTuple

import numpy as np

from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, lattice_keys

_BESIDE = np.array([(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) & 1 == 0])
"""Corners of a cell in different rows at one i, shape (12, 2)."""


class CopiedRows(NamedTuple):
    """Rows along i in which a node has copies: their keys, ascending, and the layer of its row that each node is in."""

    row_keys: np.ndarray
    layer: np.ndarray


def copied_rows(model):
    """The rows of a lattice that have copies, or cells with one lowest node, in layers; None where there are none."""
    keys = lattice_keys(model.node_index)
    lowest, cell_count = np.unique(model.cell_corners[:, 0], return_counts=True)
    shared = lowest[cell_count > 1]
    if (np.diff(keys) > 0).all() and not len(shared):
        return None
    places = model.node_index.copy()
    places[:, 0] = 0
    rows = lattice_keys(places)
    order = np.argsort(keys, kind="stable")
    twins = order[1:][np.diff(keys[order]) == 0]
    row_keys = np.unique(rows[np.concatenate([twins, shared])])
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


def are_among(keys, listed):
    """Which keys are listed, in ascending order and not none."""
    return listed[np.minimum(np.searchsorted(listed, keys), len(listed) - 1)] == keys


def _paths(model, is_copied):
    """Node after and before each node on its path, -1 for none; nodes that share most cells follow each other."""
    corners = model.cell_corners[is_copied[model.cell_corners].any(axis=1)].astype(np.int64)
    links = corners.reshape(-1, 4, 2).reshape(-1, 2)
    links = links[is_copied[links[:, 0]]]
    pairs, count = np.unique(links[:, 0] * model.node_count + links[:, 1], return_counts=True)
    pairs = pairs[np.lexsort((pairs, -count))]
    after, before = np.full(model.node_count, -1, np.int64), np.full(model.node_count, -1, np.int64)
    match(pairs // model.node_count, pairs % model.node_count, after, before)
    return after, before


def _grouped(model, path, rows):
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
    couples = couples_of(middle, side, weight, row_of_path)
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


def vote_for_rows(model, node_lane, node_slot, windows, window_rows, lane_count):
    """Write the rows of some windows of 8 lanes: where most neighbours of their nodes lie."""
    votes = {(window, row): Counter() for window in windows.tolist() for row in range(9)}
    for corners in model.cell_corners.tolist():
        for node in corners:
            window, place = divmod(int(node_slot[node]), 8)
            if (window, 0) not in votes:
                continue
            for other in corners:
                i, j, k = (model.node_index[other] - model.node_index[node]).tolist()
                lane = int(node_lane[other]) - i - place
                if (j, k) != (0, 0) and 8 <= lane <= lane_count - 16:
                    votes[window, j + 1 + 3 * (k + 1)][lane] += 1
    for (window, row), each in votes.items():
        if each:
            window_rows[window, row] = min(each, key=lambda lane: (-each[lane], lane))


def irregular_cells(model, lookup):
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


def match(lower, higher, after, before):
    """Let nodes follow each other along some links, the first first."""
    for low, high in zip(lower.tolist(), higher.tolist(), strict=True):
        if after[low] < 0 and before[high] < 0:
            after[low], before[high] = high, low


def walk(starts, after, path):
    """Give the nodes of each path its number."""
    for number, start in enumerate(starts):
        node = start
        while node >= 0:
            path[node] = number
            node = after[node]


def couples_of(middle, side, weight, row_of_path):
    """The pairs of sides in one row with one middle, with their lesser weight, shape (any, 3)."""
    couples = [
        (side[first], side[second], min(weight[first], weight[second]))
        for first, second in combinations(range(len(middle)), 2)
        if middle[first] == middle[second] and row_of_path[side[first]] == row_of_path[side[second]]
    ]
    return np.array(couples, np.int64).reshape(-1, 3)


def group_paths(couples, low, high, group):
    """Bring paths together, couple by couple, where none of their groups' paths overlap."""
    for one, other in couples[:, :2]:
        ours, theirs = np.flatnonzero(group == group[one]), np.flatnonzero(group == group[other])
        overlaps = (low[ours, None] <= high[theirs]) & (low[theirs] <= high[ours, None])
        if group[one] != group[other] and not overlaps.any():
            group[np.concatenate([ours, theirs])] = min(group[one], group[other])
