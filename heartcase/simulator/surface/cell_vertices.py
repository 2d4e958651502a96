"""Vertices that follow all eight corners of a cell: lips, cut faces, and what lies beside them.

Along a cut neighbouring vertices lie in cells that are held apart, sheared and bent, each otherwise. Hung on triangles
of nodes, by offsets that turn with these, they would not stay side by side. Between the corners of its cell a place
moves by trilinear interpolation, and where two cells meet both say the same: a lip stays one curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float32, Float64, Int32, Int64
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["NO_CELL_VERTICES", "CellVertices"]


@dataclass(frozen=True)
class CellVertices:
    """Constant arrays of vertices in cells, in grid units and axes."""

    vertices: Int32
    """Their numbers, ascending, shape (count,)."""
    corners: Int32
    """Nodes at the corners of the cell of each: corner n lies at the bits of n along i, j, k; shape (count, 8)."""
    local: Float32
    """Place in the cell, from its lowest corner, or the nearest place of it [cells, 0 to 1], shape (count, 3)."""
    beyond: Float32
    """From there to the vertex, where it lies outside of its cell [cells], shape (count, 3)."""
    normal: Float32
    """Unit normal at rest, shape (count, 3)."""
    basis: Float32
    """Basis at rest, rows T, N, B, along which tangents are kept, shape (count, 3, 3); empty where none are."""

    @classmethod
    def of(
        cls, model: LatticeModel, vertices: Int64, cells: Int32, places: Float64, normal: Float64, basis: Float64
    ) -> CellVertices:
        """Put vertices into cells of a lattice.

        Parameters
        ----------
        model
            The lattice.
        vertices, cells
            Numbers of the vertices, ascending, and the cell of each, shape (count,).
        places, normal
            Where they are at rest, in the frame of the nodes [cells], and their unit normals, shape (count, 3) each.
        basis
            As of the class.
        """
        inside = places - model.cells[cells]
        local = np.clip(inside, 0.0, 1.0)
        return cls(
            vertices.astype(np.int32),
            model.cell_corners[cells],
            local.astype(np.float32),
            (inside - local).astype(np.float32),
            normal.astype(np.float32),
            basis.astype(np.float32),
        )

    @property
    def arrays(self) -> tuple[Any, ...]:
        """What the kernels take."""
        return self.vertices, self.corners, self.local, self.beyond, self.normal, self.basis


NO_CELL_VERTICES = CellVertices(
    np.zeros(0, np.int32),
    np.zeros((0, 8), np.int32),
    np.zeros((0, 3), np.float32),
    np.zeros((0, 3), np.float32),
    np.zeros((0, 3), np.float32),
    np.zeros((0, 3, 3), np.float32),
)
"""None: an uncut surface hangs on triangles of nodes alone."""
