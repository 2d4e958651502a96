"""Tissue that cells cover in part: coverage and moments from samples, and points between the nodes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from heartcase.schemas.arrays import Bool, Float64, Int32
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.lattice.moduli import ForceLaw

COVERAGE_MIN = 0.02
SAMPLES = 8
"""Samples of a cell along each axis, where no other number is asked for."""


def voxelised(
    is_tissue: Callable[[Float64], Bool],
    low: tuple[int, int, int],
    high: tuple[int, int, int],
    edge: float,
    law: ForceLaw,
    cell_mm: float,
    *,
    samples: int = SAMPLES,
    coverage_min: float = COVERAGE_MIN,
    is_near: Callable[[Float64], Bool] | None = None,
) -> LatticeModel:
    """Cells with the coverage and the moments of samples.

    Parameters
    ----------
    is_tissue
        From positions, shape (..., 3), in units of length.
    low, high
        Range of the cells' indices.
    edge
        Edge of a cell in units of length; corner (0, 0, 0) lies at the origin.
    law
        What resists deformation.
    cell_mm
        Edge of a cell, mm.
    samples
        Samples of a cell along each axis.
    coverage_min
        Part of a cell that is tissue from which on it is one.
    is_near
        Whether there may be tissue in a cell, from positions of cells' middles; others are not sampled.
    """
    cells = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)
    if is_near is not None:
        cells = cells[is_near((cells + 0.5) * edge)]
    along = (np.arange(samples) + 0.5) / samples - 0.5
    x = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)
    products = np.stack([x[:, 1] * x[:, 2], x[:, 0] * x[:, 2], x[:, 0] * x[:, 1]], axis=1)
    # A sample stands for a cube, which has a second moment of its own.
    terms = np.concatenate([x, x * x + 1.0 / (12 * samples**2), products], axis=1)
    coverage, moments = np.zeros(len(cells)), np.zeros((len(cells), 9))
    for some in np.array_split(np.arange(len(cells)), len(cells) // 1000 + 1):
        inside = is_tissue((cells[some, None] + 0.5 + x) * edge).astype(float)
        coverage[some] = inside.mean(axis=1)
        moments[some] = inside @ terms / np.maximum(inside.sum(axis=1), 1.0)[:, None]
    kept = coverage >= coverage_min
    return make_model(cells[kept], coverage=coverage[kept], moments=moments[kept], law=law, cell_mm=cell_mm)


def located(model: LatticeModel, points: Float64) -> tuple[Int32, Float64]:
    """Corners of the cell of each point [cells], and their trilinear shares, shape (count, 8) each.

    A point whose cell has too little tissue to be there belongs to the nearest that is, and shares go beyond 0 and 1.
    """
    # The largest coordinate's distance tells a cell that holds the point from one that does not.
    _, cell = cKDTree(model.cells + 0.5).query(points, p=np.inf)
    place = points[:, None] - model.cells[cell][:, None]
    shares: Float64 = np.where(CORNER_OFFSETS == 1, place, 1.0 - place).prod(axis=2)
    return model.cell_corners[cell], shares
