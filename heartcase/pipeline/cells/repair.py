"""Keeping walls closed and pieces of tissue joined when the tissue becomes cells.

Two kinds of damage, each judged against the fine samples of the same cells:

- a *leak*: two void cells side by side although the samples across their common face are apart. The cell of the two
  with more tissue joins the grid.
- a *break*: tissue in one piece at the samples, in several in the cells. The fewest cells between them join.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.cells.sampling import CellSamples, VoidPieces
from heartcase.pipeline.kernels.topology import components
from heartcase.schemas.arrays import Bool, Float32, Float64, Int64, UInt16, UInt32

__all__ = [
    "CellState",
    "Index",
    "cell_coverage",
    "cells_of_pieces",
    "close_leaks",
    "find_leaks",
    "index_of",
    "join_tissue",
]

Index = tuple[int, int, int]


@dataclass
class CellState:
    """Which cells are tissue, while repairs change it."""

    tissue: Bool
    """Tissue cells, ``[k, j, i]``."""
    main: UInt16
    """The piece of each cell that stands for it where it is void."""
    is_blood: Bool
    """Whether that piece is blood."""
    added: list[Index] = field(default_factory=list)
    """Cells that joined the grid, (k, j, i)."""
    removed: list[Index] = field(default_factory=list)
    """Cells that left the grid, (k, j, i)."""

    def add(self, cell: Index) -> None:
        """Let a cell join the grid."""
        self.tissue[cell] = True
        self.added.append(cell)

    def open(self, cell: Index, piece: int) -> None:
        """Let a cell leave the grid; a piece of blood stands for it from then on."""
        self.tissue[cell] = False
        self.main[cell] = piece
        self.is_blood[cell] = True
        self.removed.append(cell)

    def copy(self) -> CellState:
        """A state that can change without this one."""
        return CellState(self.tissue.copy(), self.main.copy(), self.is_blood.copy())


def find_leaks(samples: CellSamples, pieces: VoidPieces, state: CellState) -> list[tuple[Index, Index]]:
    """Pairs of void cells, (k, j, i) each, that touch although their voids do not meet at the common face."""
    flags = np.zeros((3, *state.tissue.shape), np.bool_)
    _find_leaks(pieces.piece, state.main, state.tissue, samples.factor, flags)
    leaks = []
    for axis, *cell in np.argwhere(flags):
        other = list(cell)
        other[axis] += 1
        leaks.append((index_of(cell), index_of(other)))
    return leaks


def close_leaks(samples: CellSamples, pieces: VoidPieces, state: CellState) -> int:
    """Let cells join the grid until no two void cells leak into each other; returns how many joined.

    The cell that ends most leaks goes first, then the one with more tissue, then the one that comes first.
    """
    leaks = find_leaks(samples, pieces, state)
    joined = 0
    while leaks:
        count: dict[Index, int] = {}
        for pair in leaks:
            for cell in pair:
                if samples.coverage[cell] > 0.0:
                    count[cell] = count.get(cell, 0) + 1
        if not count:
            break
        best = min(count, key=lambda cell: (-count[cell], -float(samples.coverage[cell]), cell))
        state.add(best)
        joined += 1
        leaks = [pair for pair in leaks if best not in pair]
    return joined


def join_tissue(samples: CellSamples, state: CellState, fine: UInt32) -> list[Index]:
    """Join pieces of tissue that the cells broke apart, through the fewest cells that hold any of the same piece.

    Parameters
    ----------
    samples
        The fields in the cells.
    state
        Changed in place; cells that were opened stay open.
    fine
        Number of the tissue piece at each sample, 0 in void.

    Returns
    -------
    list of (k, j, i)
        A cell of each piece that could not be joined.
    """
    coarse, count = components(state.tissue, 26)
    if count < 2:
        return []
    cells, pieces = cells_of_pieces(fine, samples.factor)
    opened = np.zeros(state.tissue.shape, np.bool_)
    for cell in state.removed:
        opened[cell] = True
    stranded = []
    order = np.argsort(pieces, kind="stable")
    starts = np.flatnonzero(np.diff(pieces[order], prepend=-1))
    for first, last in zip(starts, [*starts[1:], len(order)], strict=True):
        mine = np.sort(cells[order[first:last]])
        if len(np.unique(coarse.ravel()[mine][state.tissue.ravel()[mine]])) > 1:
            stranded += _join_piece(samples, state, mine[~opened.ravel()[mine]])
    return stranded


def cell_coverage(samples: CellSamples, state: CellState, coverage_min: float) -> Float32:
    """Coverage of every cell after the repairs, 0 in void.

    The tissue of a cell that left the grid goes to the tissue cells around it, those that share a face first, by how
    much room they have. A cell that joined counts with at least the least coverage: with less it would join two parts
    with next to no stiffness.
    """
    coverage = np.where(state.tissue, samples.coverage, np.float32(0.0))
    for cell in state.added:
        coverage[cell] = max(coverage[cell], np.float32(coverage_min))
    for cell in state.removed:
        left = samples.coverage[cell]
        for reach in (1, 3):
            window = tuple(slice(max(c - 1, 0), c + 2) for c in cell)
            around = np.indices(coverage[window].shape)
            steps = sum(np.abs(around[a] + window[a].start - cell[a]) for a in range(3))
            room = np.where(
                (steps <= reach) & state.tissue[window], np.float32(1.0) - coverage[window], np.float32(0.0)
            )
            total = room.sum()
            if left <= 0.0 or total <= 0.0:
                continue
            given = min(left, total)
            coverage[window] += room * (given / total)
            left -= given
    return np.minimum(coverage, np.float32(1.0))


def _join_piece(samples: CellSamples, state: CellState, cells: Int64) -> list[Index]:
    """Join the coarse pieces that one fine piece runs through; ``cells`` are flat numbers, ascending."""
    shape = state.tissue.shape
    graph_pairs = _neighbour_pairs(cells, shape)
    stranded: list[Index] = []
    given_up: set[int] = set()
    while True:
        coarse = components(state.tissue, 26)[0].ravel()[cells]
        labels, sizes = np.unique(coarse[coarse > 0], return_counts=True)
        open_labels = [int(label) for label in labels if int(label) not in given_up]
        if len(open_labels) < 2:
            return stranded
        largest = int(labels[np.argmax(sizes)])
        cost = np.where(coarse > 0, 1e-6, 1.0 + 0.01 * (1.0 - samples.coverage.ravel()[cells]))
        distance, before = _shortest(graph_pairs, cost, np.flatnonzero(coarse == largest))
        targets = np.flatnonzero((coarse > 0) & (coarse != largest) & np.isfinite(distance))
        if len(targets) == 0:
            # Only opened cells lead there.
            for label in open_labels:
                if label != largest:
                    given_up.add(label)
                    stranded.append(index_of(np.unravel_index(cells[np.flatnonzero(coarse == label)[0]], shape)))
            return stranded
        at = int(targets[np.argmin(distance[targets])])
        while at >= 0:
            cell = index_of(np.unravel_index(cells[at], shape))
            if not state.tissue[cell]:
                state.add(cell)
            at = int(before[at])


def _shortest(pairs: Int64, cost: Float64, sources: Int64) -> tuple[Float64, Int64]:
    graph = sparse.csr_matrix(
        (
            np.concatenate((cost[pairs[:, 1]], cost[pairs[:, 0]])),
            (np.concatenate((pairs[:, 0], pairs[:, 1])), np.concatenate((pairs[:, 1], pairs[:, 0]))),
        ),
        shape=(len(cost), len(cost)),
    )
    distance, before, _ = csgraph.dijkstra(graph, indices=sources, min_only=True, return_predecessors=True)
    return distance, before.astype(np.int64)


def _neighbour_pairs(cells: Int64, shape: tuple[int, ...]) -> Int64:
    """Pairs of positions in ``cells`` (flat, ascending) whose cells share a corner, shape (n, 2)."""
    k, j, i = np.unravel_index(cells, shape)
    pairs = []
    steps = [(a, b, c) for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1) if (a, b, c) > (0, 0, 0)]
    for dk, dj, di in steps:
        fits = (k + dk < shape[0]) & (j + dj >= 0) & (j + dj < shape[1]) & (i + di >= 0) & (i + di < shape[2])
        here = np.flatnonzero(fits)
        wanted = ((k[here] + dk) * shape[1] + j[here] + dj) * shape[2] + i[here] + di
        found = np.minimum(np.searchsorted(cells, wanted), len(cells) - 1)
        hit = cells[found] == wanted
        pairs.append(np.stack((here[hit], found[hit]), axis=1))
    return np.concatenate(pairs)


def cells_of_pieces(fine: UInt32, factor: int) -> tuple[Int64, Int64]:
    """Every (flat cell, number of a tissue piece) that share a sample, as two arrays of the same length."""
    shape = tuple(n // factor for n in fine.shape)
    z, y, x = np.nonzero(fine)
    cell = ((z // factor) * shape[1] + y // factor) * shape[2] + x // factor
    keys = np.unique(cell.astype(np.int64) << 32 | fine[z, y, x].astype(np.int64))
    return keys >> 32, keys & 0xFFFFFFFF


def index_of(values: npt.ArrayLike) -> Index:
    """A cell's index (k, j, i) as plain numbers."""
    k, j, i = (int(v) for v in np.asarray(values))
    return k, j, i


@kernel
def _find_leaks(piece, main, tissue, s, flags):
    nk, nj, ni = tissue.shape
    for k in range(nk):
        for j in range(nj):
            for i in range(ni):
                if tissue[k, j, i] or main[k, j, i] == 0:
                    continue
                for axis in range(3):
                    a, b, c = k + (axis == 0), j + (axis == 1), i + (axis == 2)
                    if a == nk or b == nj or c == ni or tissue[a, b, c] or main[a, b, c] == 0:
                        continue
                    meets = False
                    for u in range(s):
                        for v in range(s):
                            z = k * s + (s - 1 if axis == 0 else u)
                            y = j * s + (s - 1 if axis == 1 else (u if axis == 0 else v))
                            x = i * s + (s - 1 if axis == 2 else v)
                            if (
                                piece[z, y, x] == main[k, j, i]
                                and piece[z + (axis == 0), y + (axis == 1), x + (axis == 2)] == main[a, b, c]
                            ):
                                meets = True
                    flags[axis, k, j, i] = not meets
