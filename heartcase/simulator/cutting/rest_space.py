"""Where a place in deformed tissue lies at rest: a blade cuts what it meets, wherever that came from.

In a cell the place follows from its trilinear displacements (Newton's method). Beside the tissue it moves back as the
nearest cells have moved on average.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Float64, Int64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.rest_space_kernels import follow_back
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["PLACES_MAX", "places_at_rest", "refined"]

PLACES_MAX = (4096, 100_000)
"""Poses, or points in each, of a blade that is followed back to rest, and both together: what a recording holds."""
_REACH = 4.0
"""How far around a blade cells are looked for at first [cells]."""
_SPACING = 0.5
"""Distance between the places of a blade that are followed back to rest [cells]."""


def refined(poses: Float64, name: str = "blade") -> Float64:
    """A blade in poses and points so near to each other that they follow how tissue is deformed, (any, any, 3).

    Raises
    ------
    SimulationError
        It would be too many.
    """
    # Refining one way does not make the other's steps any longer.
    ways = [_counts(poses, axis) for axis in (0, 1)]
    size = [int(counts.sum()) + 1 for counts in ways]
    if max(size) > PLACES_MAX[0] or size[0] * size[1] > PLACES_MAX[1]:
        raise SimulationError(
            f"the blade reaches too far: at half a cell apart it has {size[0]:,} x {size[1]:,} places; give it near "
            "the tissue alone",
            place=name,
        )
    for axis, counts in enumerate(ways):
        rows = np.moveaxis(poses, axis, 0)
        whole = np.concatenate([[0], np.cumsum(counts)])
        at = np.interp(np.arange(whole[-1] + 1), whole, np.arange(len(rows)))
        before = np.minimum(at.astype(np.int64), len(rows) - 2)
        part = (at - before)[:, None, None]
        poses = np.moveaxis(rows[before] + part * (rows[before + 1] - rows[before]), 0, axis)
    return poses


def _counts(poses: Float64, axis: int) -> Int64:
    """Steps that each step along an axis is divided into."""
    longest = np.linalg.norm(np.diff(poses, axis=axis), axis=-1).max(axis=1 - axis)
    counts: Int64 = np.maximum(np.ceil(longest / _SPACING), 1).astype(np.int64)
    return counts


def places_at_rest(model: LatticeModel, displacement: Float32, points: npt.ArrayLike) -> Float64:
    """Places at rest of some places now [cells, frame of the nodes], shape (..., 3).

    Parameters
    ----------
    model
        The lattice.
    displacement
        Displacement of its nodes [cells], shape (node_count, 3).
    points
        Places now [cells, frame of the nodes], shape (..., 3).
    """
    places = np.asarray(points, dtype=np.float64)
    if not displacement.any():
        return places.copy()
    result = np.empty((places.size // 3, 3))
    corners = (CORNER_OFFSETS - 0.5).astype(np.float64)
    middles = model.cells.astype(np.float64) + 0.5
    follow_back(places.reshape(-1, 3), middles, model.cell_corners, displacement, corners, _REACH, result)
    return result.reshape(places.shape)
