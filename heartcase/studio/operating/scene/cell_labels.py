"""The tissue label of each cell, also of the parts of cells that blades made."""

from __future__ import annotations

from typing import Any

import numpy as np

from heartcase.schemas.arrays import Int32, UInt8
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.live.shapes import Structures
from heartcase.simulator.load import Case

__all__ = ["CellLabels"]


class CellLabels:
    """The labels of a case's cells.

    Parameters
    ----------
    case
        The case, loaded with ``cell_labels``.
    """

    def __init__(self, case: Case) -> None:
        assert case.cell_labels is not None
        self._case = case
        self._grid: UInt8 = np.zeros(case.model.cells.max(axis=0) + 1, np.uint8)
        self._grid[tuple(case.model.cells.T)] = case.cell_labels

    def of(self, model: LatticeModel) -> UInt8:
        """Tissue label of each cell of the case's lattice, or of one that was cut out of it, shape (cell_count,)."""
        found: UInt8 = self._grid[tuple(model.cells.T)]
        return found

    def inside(self, structures: Structures) -> list[dict[str, Any]]:
        """Value and colour of each label of tissue that no triangle of the surface shows: a cut alone does."""
        shown = {one.number for one in structures.all}
        there = set(np.unique(self._grid).tolist()) - shown - {0}
        return [{"value": one.value, "colour": one.colour} for one in self._case.manifest.labels if one.value in there]


def nearest_cell(model: LatticeModel, displacement: Any, place_mm: Any) -> int:
    """Number of the cell whose middle is nearest to a place now.

    Parameters
    ----------
    model
        The lattice.
    displacement
        Of each node [cells], shape (node_count, 3).
    place_mm
        LPS mm, shape (3,).
    """
    corners: Int32 = model.cell_corners
    middles = model.cells + displacement[corners].mean(axis=1)
    index = model.geometry.world_to_index(np.asarray(place_mm, dtype=float))
    return int(((middles - index) ** 2).sum(axis=1).argmin())
