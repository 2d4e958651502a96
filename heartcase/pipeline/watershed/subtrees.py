"""Subtrees of a forest that hang on one face each: what one more marker there would change.

All feet that got their label by the same face make a *piece*: before this face was joined they hung together and had no
label. The face hangs the piece on a marked voxel, or on a foot of another piece, its *parent*. A marker of another
label on the lowest voxel of any basin of the piece takes exactly the feet of the piece and of all pieces that hang on
it, directly or through others: within the piece all ways are lower than its face, what hangs on it follows its new
label, and from everywhere else a lower way leads to the markers that are there. (So it is with every stroke inside
these feet that marks such a lowest voxel; :func:`heartcase.pipeline.watershed.forest.solve_forest` of the markers with
it gives the same. The one exception is a flat minimum that is marked with two labels: it is divided.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.descent import side_offsets
from heartcase.pipeline.watershed.forest import Forest
from heartcase.pipeline.watershed.marks import mark_below
from heartcase.schemas.arrays import Bool, Int32, Int64

__all__ = ["NO_PIECE", "ForestPieces", "forest_pieces"]


NO_PIECE = -1


@dataclass(frozen=True)
class ForestPieces:
    """The pieces of a forest, by ascending key of their face; the parent of a piece comes before it.

    Feet whose lowest voxel is marked hang on no face: together they make piece 0 where there are any, with level 0.
    """

    level: Int64
    """Key of each piece's face, int64, ascending, shape (pieces,)."""
    parent: Int32
    """The piece that each piece hangs on, int32; -1 where it hangs on a marked voxel."""
    piece: Int32
    """The piece of each basin's foot, int32, shape (basins,)."""
    first_foot: Int64
    """The first basin of each piece."""
    own_count: Int64
    """Voxels of each piece's feet."""
    flipped_count: Int64
    """Voxels that a marker in the piece takes: those of its feet and of all pieces that hang on it; 0 for level 0."""

    def hanging_on(self, piece: int) -> Bool:
        """Which pieces a marker in a piece takes, itself included, bool, shape (pieces,)."""
        taken = np.zeros(len(self.level), np.bool_)
        _find_hanging(self.parent, piece, taken)
        return taken


def forest_pieces(forest: Forest) -> ForestPieces:
    """Find the pieces of a forest.

    Parameters
    ----------
    forest
        A solved forest.
    """
    tree = forest.tree
    level, first_foot, number = np.unique(forest.foot_level, return_index=True, return_inverse=True)
    piece: Int32 = number.astype(np.int32)
    direction, basin, marks = tree.direction.ravel(), tree.basin.ravel(), forest.marks.ravel()
    offsets = side_offsets(tree.height.shape)
    parent = np.full(len(level), NO_PIECE, np.int32)
    # a key without direction is that of the face under a marked voxel
    hung = np.flatnonzero((level & 7 != 0) & (forest.foot_label[first_foot] != UNMARKED))
    face = np.searchsorted(tree.key, level[hung])
    higher, lower = tree.ends
    _find_parents(
        hung, higher[face], lower[face], (direction, basin, offsets), marks, forest.lowest_mark, piece, parent
    )
    own_count = np.zeros(len(level), np.int64)
    _count_voxels((direction, basin, offsets), marks, forest.lowest_mark, piece, own_count)
    flipped_count = own_count.copy()
    if len(level) and level[0] == 0:
        flipped_count[0] = 0
    _add_to_parents(parent, level, flipped_count)
    return ForestPieces(level, parent, piece, first_foot, own_count, flipped_count)


@kernel
def _find_parents(hung, higher, lower, landscape, marks, lowest_mark, piece, parent):
    direction, basin, offsets = landscape
    for n in range(len(hung)):
        v = lower[n] if piece[basin[higher[n]]] == hung[n] else higher[n]
        b = basin[v]
        if lowest_mark[b] < 0 or mark_below(v, direction, offsets, marks) == UNMARKED:
            parent[hung[n]] = piece[b]


@kernel
def _count_voxels(landscape, marks, lowest_mark, piece, count):
    direction, basin, offsets = landscape
    for v in range(len(basin)):
        b = basin[v]
        if lowest_mark[b] < 0 or mark_below(v, direction, offsets, marks) == UNMARKED:
            count[piece[b]] += 1


@kernel
def _add_to_parents(parent, level, count):
    for n in range(len(parent) - 1, -1, -1):
        if parent[n] >= 0 and level[parent[n]] != 0:
            count[parent[n]] += count[n]


@kernel
def _find_hanging(parent, piece, taken):
    taken[piece] = True
    for n in range(piece + 1, len(parent)):
        taken[n] = parent[n] >= 0 and taken[parent[n]]
