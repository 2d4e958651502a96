"""How landmarks and vessels follow the tissue in a page: each point hangs on the corners of the nearest cell."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from heartcase.schemas.arrays import Float32
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["hung_points"]


def hung_points(model: LatticeModel, points_mm: Any) -> dict[str, Any]:
    """What a page needs to move points with the tissue.

    Parameters
    ----------
    model
        The lattice, at rest and uncut; its cells keep their numbers when it is cut.
    points_mm
        The points at rest, LPS mm, shape (point_count, 3).

    Returns
    -------
    dict
        ``at_mm`` the points; ``cell`` the cell of each, the nearest one; ``local`` where in it, from its lowest corner
        [edges]: a point beside it goes with the nearest place of its faces.
    """
    points: Float32 = np.asarray(points_mm, dtype=np.float32).reshape(-1, 3)
    if len(points) == 0:
        return {"at_mm": points, "cell": np.zeros(0, np.uint32), "local": points}
    index = model.geometry.world_to_index(points.astype(float))
    cell = np.asarray(cKDTree(model.cells.astype(float)).query(index)[1])
    local = np.clip(index - model.cells[cell] + 0.5, 0.0, 1.0)
    return {"at_mm": points, "cell": cell.astype(np.uint32), "local": local.astype(np.float32)}
