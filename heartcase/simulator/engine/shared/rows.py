"""Rows of nodes along i, numbered by k and j."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Int32, Int64
from heartcase.schemas.bundle.lattice import distinct_keys, lattice_keys
from heartcase.simulator.engine.shared.lane_kernels import bounds, number_rows, rows_around

__all__ = ["Rows", "numbered_rows"]

_PLACES_PER_NODE = 16
"""Places (j, k) of a lattice's box over its nodes up to which a table holds a row's number for each: it is quicker to
read than keys are to search, and longer where a few nodes lie far apart."""
_AROUND = np.array([(0, j, k) for k in (-1, 0, 1) for j in (-1, 0, 1)])


@dataclass(frozen=True)
class Rows:
    """The rows of a lattice."""

    low: tuple[int, int, int]
    """Least i, j and k of its nodes."""
    high: tuple[int, int, int]
    """Largest i, j and k."""
    row: Int32
    """Row of each node, shape (node_count,)."""
    count: int
    """Number of rows."""
    table: Int32
    """Number of the row at each k and j, from one before the least on, and one more, else 0; of length 0 where the
    keys are searched."""
    keys: Int64
    """Key of each row, that of place (0, j, k), ascending, shape (count,); of length 0 where there is a table."""

    def around(self, node_index: Int32, nodes: Int32) -> Int32:
        """Numbers of the rows around some nodes, j by j and k by k, -1 where there is none, shape (count, 9)."""
        around = np.empty((len(nodes), len(_AROUND)), np.int32)
        if len(self.table):
            rows_around(node_index, nodes, self.low[1] - 1, self.low[2] - 1, self.table, around)
            return around
        keys = _row_keys(node_index[nodes, None] + _AROUND)
        place = np.minimum(np.searchsorted(self.keys, keys), self.count - 1)
        around[:] = np.where(self.keys[place] == keys, place, -1)
        return around


def numbered_rows(node_index: Int32) -> Rows:
    """The rows of nodes at some places (i, j, k), shape (node_count, 3)."""
    (i, j, k), (i_most, j_most, k_most) = bounds(node_index).tolist()
    box = (i, j, k), (i_most, j_most, k_most)
    shape = (k_most - k + 3, j_most - j + 3)
    if shape[0] * shape[1] <= _PLACES_PER_NODE * (len(node_index) + 64):
        table, row = np.zeros(shape, np.int32), np.empty(len(node_index), np.int32)
        count = number_rows(node_index, j - 1, k - 1, table, row)
        return Rows(*box, row, count, table, np.zeros(0, np.int64))
    keys = _row_keys(node_index)
    row_keys = distinct_keys(keys)
    row = np.searchsorted(row_keys, keys).astype(np.int32)
    return Rows(*box, row, len(row_keys), np.zeros((0, 0), np.int32), row_keys)


def _row_keys(places: Int32 | Int64) -> Int64:
    """Keys of the rows along i that places (i, j, k) lie in: those of (0, j, k)."""
    starts = np.array(places)
    starts[..., 0] = 0
    return lattice_keys(starts)
