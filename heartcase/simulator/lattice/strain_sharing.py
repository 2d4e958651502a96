"""Strain sharing: how much of its strain a cell of a thin wall takes from the mean around its corners.

A wall that lies askew to the grid crosses cells of which it fills a corner. There trilinear displacements cannot follow
a bent wall: each cell by itself is stretched, one on the wall's one side and its neighbour on the other, and the wall
locks. No energy of single cells that is exact in uniform strain mends that: with the mean strain alone, which is the
softest of them, a wall one cell thick at 45 degrees turns 0.43 of what a beam does.

So a part of the tissue is strained by the mean deformation gradient of the tissue around a node, as in the node-based
smoothed finite element method (Liu, Nguyen-Thoi, Nguyen-Xuan and Lam, Comput. Struct. 87, 2009); that a mean is mixed
with a cell's own strain is the idea of the alpha finite element method. What is stretched in turn cancels out, uniform
strain stays exact, and as long as strain and turns are small a mean of strains is never the stiffer for it. (A mean of
two rotations is no rotation: pieces that meet along an edge alone do not turn about it quite freely any more, and a
wall that is curved to a few cells is softer.)

How large the part is follows from the shape of the tissue around: none where walls lie along the grid or fill it, most
where they are thin and askew. The numbers were chosen for strips of 0.3 to 3 cells at 0 to 45 degrees (``heartcase
bench elasticity-strip``), and hold for others that were not looked at then: of 0.4, 0.75, 1.5, 2.5 and 4 cells, at
other angles, and askew about two axes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import prange

from heartcase.compiling.kernel import loop_kernel
from heartcase.schemas.arrays import Float32, Float64, Int32, Int64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, lattice_keys

__all__ = ["corner_shares"]


_KERNEL: Float64 = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
"""Weights of the cells around, along each axis: those up to two away."""
_THICKNESSES = (0.0, 0.36, 0.5, 1.0, 1.8, 2.5, 3.4)
"""Thickness of the tissue around, sqrt(12) of its least standard deviation [cells] ..."""
_PARTS = (0.94, 0.94, 0.85, 0.57, 0.29, 0.48, 0.0)
"""... and the part that follows the corners' means where it is that thick and askew."""
_SPREAD_MIN = 1e-6
"""Variance below which tissue has no shape [edges squared]: moments may be those of a point."""
_PART_MIN = 0.05
"""Part below which a cell keeps its own strain: it would bend hardly better."""


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
    askew = np.minimum(4.0 * oblique / np.maximum((most - least) ** 2 + (0.05 * most) ** 2, _SPREAD_MIN**2), 1.0)
    thickness = np.sqrt(12.0 * np.maximum(least, 0.0))
    part = np.interp(thickness, _THICKNESSES, _PARTS) * (1.0 - (1.0 - askew) ** 2)
    return np.where(part < _PART_MIN, 0.0, part)


def _covariance_around(cells: Int32, tissue: Float64, moments: Float64) -> Float64:
    """Covariance of the tissue in and around each cell [edges squared], shape (cell_count, 3, 3)."""
    keys = lattice_keys(cells)
    order = np.argsort(keys, kind="stable")
    covariance = np.empty((len(cells), 3, 3))
    along_j, along_k = (int(lattice_keys(step) - lattice_keys((0, 0, 0))) for step in ((0, 1, 0), (0, 0, 1)))
    _spread_around(keys[order], along_j, along_k, tissue[order], moments[order], covariance)
    result = np.empty_like(covariance)
    result[order] = covariance
    return result


@loop_kernel
def _spread_around(
    keys: Int64, along_j: int, along_k: int, tissue: Float64, moments: Float64, covariance: Float64
) -> None:
    """Write the covariances, of cells in the order of their keys; those of a row along i follow each other."""
    reach = len(_KERNEL) // 2
    for cell in prange(len(keys)):
        mass = 0.0
        first, second = np.zeros(3), np.zeros((3, 3))
        d = np.zeros(3)
        for k in range(-reach, reach + 1):
            for j in range(-reach, reach + 1):
                middle = keys[cell] + k * along_k + j * along_j
                other = np.searchsorted(keys, middle - reach)
                while other < len(keys) and keys[other] <= middle + reach:
                    i = keys[other] - middle
                    d[0], d[1], d[2] = i, j, k
                    weight = _KERNEL[i + reach] * _KERNEL[j + reach] * _KERNEL[k + reach] * tissue[other]
                    mean = moments[other, :3]
                    mass += weight
                    for a in range(3):
                        first[a] += weight * (mean[a] + d[a])
                        for b in range(3):
                            place = 3 + a if a == b else 9 - a - b
                            moved = moments[other, place] + mean[a] * d[b] + mean[b] * d[a] + d[a] * d[b]
                            second[a, b] += weight * moved
                    other += 1
        for a in range(3):
            for b in range(3):
                covariance[cell, a, b] = second[a, b] / mass - first[a] / mass * (first[b] / mass)
