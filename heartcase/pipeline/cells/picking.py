"""The coarse surface that instruments pick nodes with (thesis 10.2.4, 11.2.2)."""

from __future__ import annotations

import numpy as np

from heartcase.pipeline.data import PickingSurface, SimulationGrid
from heartcase.schemas.arrays import Int32

__all__ = ["picking_surface", "split_faces"]


def split_faces(faces: Int32) -> Int32:
    """Split quads along the diagonal from their first to their third corner.

    Parameters
    ----------
    faces
        Node numbers, shape (face_count, 4).

    Returns
    -------
    int32, shape (2 * face_count, 3)
        Triangles 2 f and 2 f + 1 of face f, turning the same way.
    """
    triangles = np.stack((faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]), axis=1).reshape(-1, 3)
    return np.ascontiguousarray(triangles, dtype=np.int32)


def picking_surface(grid: SimulationGrid) -> PickingSurface:
    """Make the picking surface: one vertex per boundary node of the grid, two triangles per boundary face.

    It is closed: every edge is passed as often one way as the other. Where tissue cells meet only along an edge or
    at a corner they share its vertices, as they share its nodes.
    """
    nodes, vertices = np.unique(split_faces(grid.faces), return_inverse=True)
    return PickingSurface(
        nodes=nodes.astype(np.int32),
        triangles=vertices.reshape(-1, 3).astype(np.int32),
        triangle_label=np.repeat(grid.face_label, 2),
    )
