"""The numbering of the simulation grid's nodes and the springs of a cell: part of the bundle's format.

Corner (i, j, k) of cell (i, j, k) lies half a cell before its centre along each axis. Corners, cells and nodes are
ordered by k, then j, then i. The eight corners of a cell are numbered by their offset: bit 0 is i, bit 1 j, bit 2 k.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Int32, Int64
from heartcase.schemas.errors import BundleError

__all__ = [
    "CELL_DIAGONALS",
    "CELL_EDGES",
    "CORNER_OFFSETS",
    "FULL_MOMENTS",
    "STEP_SAFETY",
    "cell_indices",
    "cell_nodes",
    "distinct_keys",
    "lattice_keys",
    "step_sizes",
]


CORNER_OFFSETS: Int32 = np.array([[c & 1, c >> 1 & 1, c >> 2 & 1] for c in range(8)], dtype=np.int32)
"""Offset (i, j, k) of each corner of a cell, shape (8, 3)."""

_PAIRS = [(a, b) for a in range(8) for b in range(a + 1, 8)]
CELL_EDGES: Int32 = np.array([p for p in _PAIRS if (p[0] ^ p[1]).bit_count() == 1], dtype=np.int32)
"""Corner numbers of the 12 edges of a cell, shape (12, 2)."""
CELL_DIAGONALS: Int32 = np.array([p for p in _PAIRS if (p[0] ^ p[1]).bit_count() == 2], dtype=np.int32)
"""Corner numbers of the 12 face diagonals of a cell, shape (12, 2)."""

FULL_MOMENTS: Float32 = np.array([0.0] * 3 + [1 / 12] * 3 + [0.0] * 3, np.float32)
"""Moments of a full cell: means of x, y, z, xx, yy, zz, yz, xz, xy over its tissue, from its centre along the grid's
axes [edges], shape (9,)."""

STEP_SAFETY = 0.8
"""Default step over the limit of the stretched lattice."""

_OFFSET = 1 << 20
_INDEX_MOST = _OFFSET - 2
"""So that corners have keys, too."""
_NO_INDICES = f"give the index (i, j, k) of each cell: whole numbers of up to {_INDEX_MOST}, shape (cell_count, 3)"


def lattice_keys(indices: npt.ArrayLike) -> Int64:
    """One integer per index (i, j, k), ascending in the lattice's order; shape (..., 3) to (...)."""
    ijk = np.asarray(indices, dtype=np.int64) + _OFFSET
    keys: Int64 = (ijk[..., 2] << 42) | (ijk[..., 1] << 21) | ijk[..., 0]
    return keys


def distinct_keys(keys: Int64) -> Int64:
    """Each key once, ascending, as ``numpy.unique`` says, whose hash table is slower than sorting where many differ."""
    ascending = np.sort(keys, axis=None)
    is_first = np.ones(len(ascending), np.bool_)
    np.not_equal(ascending[1:], ascending[:-1], out=is_first[1:])
    return ascending[is_first]


def cell_nodes(cells: npt.ArrayLike) -> tuple[Int32, Int32]:
    """Number the corners of the cells.

    Parameters
    ----------
    cells
        Index (i, j, k) of each cell, whole numbers, shape (cell_count, 3); each within +-(2**20 - 2).

    Returns
    -------
    nodes
        Corner (i, j, k) of each node, int32, shape (node_count, 3), by k, j, i.
    corners
        Node number of each cell's eight corners, int32, shape (cell_count, 8).

    Raises
    ------
    BundleError
        The cells are no indices.
    """
    cells = cell_indices(cells)
    corners = cells[:, None, :] + CORNER_OFFSETS[None, :, :]
    _, first, inverse = np.unique(lattice_keys(corners).ravel(), return_index=True, return_inverse=True)
    nodes = np.ascontiguousarray(corners.reshape(-1, 3)[first])
    return nodes, inverse.reshape(-1, 8).astype(np.int32)


def cell_indices(cells: npt.ArrayLike) -> Int32:
    """Indices of cells, int32, shape (cell_count, 3).

    Raises
    ------
    BundleError
        They have another shape, are no whole numbers, or lie beyond +-(2**20 - 2).
    """
    try:
        given = np.asarray(cells)
        numbers = given.astype(np.int64) if given.dtype.kind in "iu" else np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise BundleError(_NO_INDICES, place="cells") from None
    is_empty = not numbers.size
    if not is_empty and (numbers.ndim != 2 or numbers.shape[1] != 3):
        raise BundleError(f"{_NO_INDICES} (found shape {numbers.shape})", place="cells")
    is_index = np.abs(numbers) <= _INDEX_MOST
    is_index &= numbers == np.floor(numbers)
    if not is_index.all():
        row = int(np.flatnonzero(~is_index.all(axis=1))[0])
        raise BundleError(f"{_NO_INDICES} (cell {row} is {numbers[row].tolist()})", place="cells")
    return numbers.reshape(-1, 3).astype(np.int32)


def step_sizes(modulus_over_density: float, cell_mm: float) -> tuple[float, float]:
    """Default step and limit of the step at rest of a lattice of springs, s: docs/bundle.md.

    A cell's largest squared frequency is 20 k/m with k = 0.4 E h and m = density h^3 (both scale with coverage), so
    it is 8 E / (density h^2); the default step keeps a margin for stretched springs, 24 k/m, and takes 0.8 of it.

    Parameters
    ----------
    modulus_over_density
        Young's modulus over density of the quickest tissue, Pa m3/kg.
    cell_mm
        Edge of a cell, mm.
    """
    stiffness_over_mass = 0.4 * modulus_over_density / (cell_mm * 1e-3) ** 2
    return STEP_SAFETY * 2.0 / sqrt(24.0 * stiffness_over_mass), 2.0 / sqrt(20.0 * stiffness_over_mass)
