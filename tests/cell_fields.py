"""Fields of tissue that fills the cells of a small grid, for surfaces that were not made from structures."""

from __future__ import annotations

import numpy as np

from heartcase.pipeline.data import SimulationGrid, Structures
from heartcase.schemas.geometry import Geometry

__all__ = ["structures_of_cells"]

FINE = 4
"""Voxels along a cell's edge."""


def structures_of_cells(grid: SimulationGrid, *, inset: float = 0.0) -> Structures:
    """Exact distances to the cells' boundary, pushed in by ``inset`` cells; one tissue, and background around it."""
    cell_mm = grid.geometry.spacing_mm[0]
    low, high = grid.cells.min(axis=0) - 1, grid.cells.max(axis=0) + 2
    k, j, i = np.indices((FINE * (high - low))[::-1])
    places = low + (np.stack((i, j, k), axis=-1) + 0.5) / FINE
    inside = {tuple(cell) for cell in grid.cells.tolist()}
    around = {(x, y, z) for x, y, z in np.ndindex(*(high - low))}
    void = [cell for cell in sorted(around) if tuple((np.array(cell) + low).tolist()) not in inside]
    field = _distance(places, grid.cells) - _distance(places, np.array(void) + low) + inset
    geometry = Geometry.of(
        shape=field.shape,
        origin_mm=grid.geometry.index_to_world(low - 0.5 + 0.5 / FINE),
        spacing_mm=(cell_mm / FINE,) * 3,
        direction=grid.geometry.direction_matrix,
    )
    tissue = int(grid.cell_label[0])
    fields = {tissue: (cell_mm * field).astype(np.float32), 0: (-cell_mm * field).astype(np.float32)}
    return Structures(fields, geometry, grid.table, band_mm=1e3)


def _distance(places: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Distance, in cells, to the nearest of some cells."""
    nearest = np.full(places.shape[:-1], np.inf)
    for cell in cells:
        away = np.abs(places - cell - 0.5) - 0.5
        nearest = np.minimum(nearest, np.sqrt((np.maximum(away, 0.0) ** 2).sum(axis=-1)))
    return nearest
