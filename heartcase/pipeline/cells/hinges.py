"""Cells that are joined to the rest of the tissue by an edge or a corner only: they would swing freely.

Two cells that share a face share four nodes and are stiff together. Across an edge they share two nodes, a hinge
without stiffness, and across a corner one, a pivot. So the groups of cells joined by faces are the stiff bodies of a
piece of tissue, and all but its largest hang. A group of next to no tissue is dropped; a larger one is joined by faces
through one or two more cells: one beside a common edge, or two in a row beside a common corner.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.cells.passages import closes_passage
from heartcase.pipeline.cells.repair import CellState, Index, cells_of_pieces, find_leaks, index_of
from heartcase.pipeline.cells.sampling import CellSamples, VoidPieces
from heartcase.pipeline.kernels.topology import components
from heartcase.schemas.arrays import Bool, Int32, Int64, UInt8, UInt32

__all__ = ["NEGLIGIBLE_CELLS", "NEGLIGIBLE_SHARE", "HingeRepairs", "hanging_cells", "mend_hinges"]


NEGLIGIBLE_CELLS = 1.0
"""A hanging group is dropped where it holds less tissue than this many full cells ..."""
NEGLIGIBLE_SHARE = 1e-3
"""... and less than this part of all tissue."""

_FACES = ((-1, 0, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1), (0, 1, 0), (1, 0, 0))


@dataclass(frozen=True)
class HingeRepairs:
    """What was done about groups of cells that hung by edges and corners."""

    dropped_groups: int = 0
    """Groups of next to no tissue that left the grid."""
    dropped_cells: int = 0
    """Cells of these groups."""
    joined_groups: int = 0
    """Groups that were joined by faces."""
    added_cells: int = 0
    """Cells that joined the grid for that."""


def mend_hinges(samples: CellSamples, pieces: VoidPieces, state: CellState, fine: UInt32) -> HingeRepairs:
    """Drop or join the groups of cells that hang on their piece of tissue by edges and corners only.

    A group is dropped where its tissue is below :data:`NEGLIGIBLE_CELLS` and :data:`NEGLIGIBLE_SHARE`, unless that
    makes a leak, parts a piece of tissue or changes the pieces of blood. Any other group is joined by faces through
    the fewest cells (of these the ones with most tissue, then the first), unless they close a passage of blood or touch
    another piece of tissue. Groups that share no piece of tissue at the samples touch by chance and stay as they are.

    Parameters
    ----------
    samples, pieces
        The fields in the cells and the pieces of void in each.
    state
        Changed in place; cells that were opened stay open.
    fine
        Number of the tissue piece at each sample, 0 in void.
    """
    dropped_groups = dropped_cells = 0
    limit = min(NEGLIGIBLE_CELLS, NEGLIGIBLE_SHARE * float(samples.coverage[state.tissue].sum(dtype=np.float64)))
    for cells in _hanging_groups(state.tissue):
        amount = float(samples.coverage[tuple(cells.T)].sum(dtype=np.float64))
        if amount < limit and _drop(samples, pieces, state, cells):
            dropped_groups += 1
            dropped_cells += len(cells)
    joined_groups = added_cells = 0
    cells_of_fine: tuple[Int64, Int64] | None = None
    is_changed = True
    while is_changed:
        is_changed = False
        for cells in _hanging_groups(state.tissue):
            cells_of_fine = cells_of_fine or cells_of_pieces(fine, samples.factor)
            way = _way_to_rest(samples, state, cells, cells_of_fine)
            if way is not None:
                for cell in way:
                    state.add(cell)
                joined_groups += 1
                added_cells += len(way)
                is_changed = True
                break
    return HingeRepairs(dropped_groups, dropped_cells, joined_groups, added_cells)


def hanging_cells(tissue: Bool, corners: Int32, nodes: Int32, fixed: UInt8) -> list[Index]:
    """The first cell (k, j, i) of each group of cells that can swing about an edge or a corner.

    A group is stiff with the rest where it shares three nodes off one line with what is stiff or held already.

    Parameters
    ----------
    tissue
        Tissue cells, ``[k, j, i]``.
    corners, nodes
        From :func:`heartcase.schemas.bundle.lattice.cell_nodes`.
    fixed
        1 for each node that is held, shape (node_count,).
    """
    loose = _hanging_groups(tissue)
    number = np.full(tissue.shape, -1, np.int64)
    number[tissue] = np.arange(len(corners))
    of_group = [np.unique(corners[number[tuple(cells.T)]]) for cells in loose]
    is_loose = np.zeros(len(corners), np.bool_)
    for cells in loose:
        is_loose[number[tuple(cells.T)]] = True
    stiff = fixed.astype(np.bool_)
    stiff[corners[~is_loose]] = True
    left = list(range(len(loose)))
    while True:
        swings = [n for n in left if not _span_a_plane(nodes[of_group[n][stiff[of_group[n]]]])]
        if len(swings) == len(left):
            return [index_of(loose[n][0]) for n in left]
        for n in set(left) - set(swings):
            stiff[of_group[n]] = True
        left = swings


def _span_a_plane(points: Int32) -> bool:
    return len(points) > 2 and int(np.linalg.matrix_rank(points[1:] - points[0])) > 1


def _hanging_groups(tissue: Bool) -> list[Int64]:
    """Cells (k, j, i) of each face-connected group but the largest (ties: the first) of its piece; smallest first."""
    groups, count = components(tissue, 6)
    piece, piece_count = components(tissue, 26)
    if count == piece_count:
        return []
    cells = np.argwhere(tissue)
    group, of_cell = groups[tissue].astype(np.int64), piece[tissue].astype(np.int64)
    size = np.bincount(group, minlength=count + 1)
    of_group = np.zeros(count + 1, np.int64)
    of_group[group] = of_cell
    order = np.lexsort((np.arange(1, count + 1), -size[1:], of_group[1:])) + 1
    is_first = np.diff(of_group[order], prepend=0) > 0
    hanging = order[~is_first]
    return [cells[group == n] for n in hanging[np.lexsort((hanging, size[hanging]))]]


def _drop(samples: CellSamples, pieces: VoidPieces, state: CellState, cells: Int64) -> bool:
    """Take a group out of the grid unless that does harm; says whether it went."""
    at = tuple(cells.T)
    leaks = len(find_leaks(samples, pieces, state))
    before = _piece_counts(state)
    state.tissue[at] = False
    if len(find_leaks(samples, pieces, state)) > leaks or _piece_counts(state) != before:
        state.tissue[at] = True
        return False
    gone = [index_of(cell) for cell in cells]
    state.added = [cell for cell in state.added if cell not in gone]
    state.removed += gone
    return True


def _piece_counts(state: CellState) -> tuple[int, int]:
    return components(state.tissue, 26)[1], components(state.is_blood & ~state.tissue, 6)[1]


def _way_to_rest(
    samples: CellSamples, state: CellState, cells: Int64, cells_of_fine: tuple[Int64, Int64]
) -> tuple[Index, ...] | None:
    """The cells that join a group by faces to another group of its piece; None where there is no good way."""
    piece = components(state.tissue, 26)[0]
    groups = components(state.tissue, 6)[0]
    mine, own = int(groups[tuple(cells[0])]), int(piece[tuple(cells[0])])
    kin = _kin(groups, piece == own, mine, cells_of_fine)
    opened = set(state.removed)
    ways = {way for cell in cells for way in _ways_from(index_of(cell), state.tissue, groups, mine, kin)}
    for way in sorted(ways, key=lambda way: (len(way), -sum(float(samples.coverage[cell]) for cell in way), way)):
        touches_own_piece_only = all(set(np.unique(piece[_around(cell)]).tolist()) <= {0, own} for cell in way)
        if touches_own_piece_only and opened.isdisjoint(way) and not closes_passage(state, way):
            return way
    return None


def _kin(groups: UInt32, own: Bool, mine: int, cells_of_fine: tuple[Int64, Int64]) -> set[int]:
    """The other groups of the same piece that hold tissue of the same pieces at the samples."""
    cell, fine = cells_of_fine
    group = np.where(own, groups, 0).ravel()[cell]
    same = np.isin(fine, np.unique(fine[group == mine])) & (group > 0) & (group != mine)
    return {int(n) for n in np.unique(group[same])}


def _ways_from(cell: Index, tissue: Bool, groups: UInt32, mine: int, kin: set[int]) -> Iterator[tuple[Index, ...]]:
    """Rows of one or two void cells, each by a face, from a cell of one group to a cell of its kin."""
    for first in _beside(cell, tissue.shape):
        if tissue[first]:
            continue
        for second in _beside(first, tissue.shape):
            if int(groups[second]) in kin:
                yield (first,)
            elif not tissue[second] and any(int(groups[third]) in kin for third in _beside(second, tissue.shape)):
                yield (first, second)


def _beside(cell: Index, shape: tuple[int, ...]) -> Iterator[Index]:
    for step in _FACES:
        k, j, i = (cell[axis] + step[axis] for axis in range(3))
        if 0 <= k < shape[0] and 0 <= j < shape[1] and 0 <= i < shape[2]:
            yield k, j, i


def _around(cell: Index) -> tuple[slice, ...]:
    return tuple(slice(max(at - 1, 0), at + 2) for at in cell)
