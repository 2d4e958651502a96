"""How much of its strain a cell of a thin wall takes from the mean around its corners.

A wall that lies askew to the grid crosses cells of which it fills a corner. There trilinear displacements cannot follow
a bent wall: each cell by itself is stretched, one on the wall's one side and its neighbour on the other, and the wall
locks. No energy of single cells that is exact in uniform strain mends that: with the mean strain alone, which is the
softest of them, a wall one cell thick at 45 degrees turns 0.43 of what a beam does.

So a part of the tissue is strained by the mean deformation gradient of the tissue around a node, as in the node-based
smoothed finite element method (Liu, Nguyen-Thoi, Nguyen-Xuan and Lam, Comput. Struct. 87, 2009); that a mean is mixed
with a cell's own strain is the idea of the alpha finite element method. What is stretched in turn cancels out, uniform
strain stays exact, and a mean of strains is never the stiffer for it. How large the part is follows from the shape of
the tissue around: none where walls lie along the grid or fill it, most where they are thin and askew. The numbers were
chosen for strips of 0.3 to 3 cells at 0 to 45 degrees (``heartcase bench elasticity-strip``), and hold for others that
were not looked at then: of 0.4, 0.75, 1.5, 2.5 and 4 cells, at other angles, and askew about two axes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.schemas.lattice import CORNER_OFFSETS, lattice_keys

__all__ = ["corner_shares"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]

_KERNEL: Float64 = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
"""Weights of the cells around, along each axis: those up to two away."""
_THICKNESSES = (0.0, 0.36, 0.5, 1.0, 1.8, 2.5, 3.4)
"""Thickness of the tissue around, sqrt(12) of its least standard deviation [cells] ..."""
_PARTS = (0.94, 0.94, 0.85, 0.57, 0.33, 0.48, 0.0)
"""... and the part that follows the corners' means where it is that thick and askew."""
_PART_MIN = 1e-3
"""Part below which a cell keeps its own strain: rounding makes none."""


def corner_shares(cells: Int32, corners: Int32, coverage: npt.ArrayLike, moments: npt.ArrayLike) -> Float32:
    """Part of each cell's tissue that is strained by the mean around each of its corners.

    Parameters
    ----------
    cells
        Index (i, j, k) of each cell, shape (cell_count, 3).
    corners
        Node number of each cell's corners, shape (cell_count, 8).
    coverage
        Fraction of each cell that is tissue [1], shape (cell_count,).
    moments
        Means of x, y, z, xx, yy, zz, yz, xz, xy over each cell's tissue, from its centre [edges], (cell_count, 9).

    Returns
    -------
    ndarray
        Shape (cell_count, 8), float32; a row sums to less than 1, and the rest is strained as the cell is.
    """
    tissue, moments = np.asarray(coverage, dtype=np.float64), np.asarray(moments, dtype=np.float64)
    around = np.bincount(corners.ravel(), np.repeat(tissue, 8))
    place = np.clip(moments[:, :3] + 0.5, 0.0, 1.0)
    near: Float64 = np.where(CORNER_OFFSETS == 1, place[:, None], 1.0 - place[:, None]).prod(axis=2)
    # Corners with much tissue around, and of these the near ones: where the means cancel what they are to cancel.
    share = np.sqrt(near) * around[corners] ** 2
    part = _shared_part(cells, tissue, moments) / share.sum(axis=1)
    shares: Float32 = (part[:, None] * share).astype(np.float32)
    return shares


def _shared_part(cells: Int32, tissue: Float64, moments: Float64) -> Float64:
    """What of each cell's tissue is strained by any of its corners' means, shape (cell_count,)."""
    covariance = _covariance_around(cells, tissue, moments)
    least, _, most = np.linalg.eigvalsh(covariance).T
    oblique = (covariance[:, [1, 0, 0], [2, 2, 1]] ** 2).sum(axis=1)
    # For a wall, (4 times) the sum of the products of its unit normal's squared components: 1 at 45 degrees.
    askew = np.minimum(4.0 * oblique / ((most - least) ** 2 + (0.05 * most) ** 2), 1.0)
    thickness = np.sqrt(12.0 * np.maximum(least, 0.0))
    part = np.interp(thickness, _THICKNESSES, _PARTS) * (1.0 - (1.0 - askew) ** 2)
    return np.where(part < _PART_MIN, 0.0, part)


def _covariance_around(cells: Int32, tissue: Float64, moments: Float64) -> Float64:
    """Covariance of the tissue in and around each cell [edges squared], shape (cell_count, 3, 3)."""
    keys = lattice_keys(cells)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    mass = np.zeros(len(cells))
    first, second = np.zeros((len(cells), 3)), np.zeros((len(cells), 6))
    pairs = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
    reach = len(_KERNEL) // 2
    for offset in np.ndindex(*[len(_KERNEL)] * 3):
        d = np.array(offset) - reach
        there = lattice_keys(cells + d.astype(np.int32))
        found = np.minimum(np.searchsorted(ordered, there), len(ordered) - 1)
        here = np.flatnonzero(ordered[found] == there)
        other = order[found[here]]
        weight = _KERNEL[list(offset)].prod() * tissue[other]
        mean, square = moments[other, :3], moments[other, 3:]
        mass[here] += weight
        first[here] += weight[:, None] * (mean + d)
        for number, (a, b) in enumerate(pairs):
            moved = square[:, number] + mean[:, a] * d[b] + mean[:, b] * d[a] + float(d[a] * d[b])
            second[here, number] += weight * moved
    first /= mass[:, None]
    covariance = np.empty((len(cells), 3, 3))
    for number, (a, b) in enumerate(pairs):
        covariance[:, a, b] = covariance[:, b, a] = second[:, number] / mass - first[:, a] * first[:, b]
    return covariance
