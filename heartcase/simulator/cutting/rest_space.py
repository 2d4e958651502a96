"""Where a place in deformed tissue lies at rest: a blade cuts what it meets, wherever that came from.

In a cell the place follows from its trilinear displacements (Newton's method). Beside the tissue it moves back as the
nearest cells have moved on average. Between lips that are held apart a blade cuts nothing: that space has no place at
rest.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float32, Float64, Int64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.crossings import SAMPLES
from heartcase.simulator.cutting.parted_lattice import PartedLattice
from heartcase.simulator.cutting.rest_space_kernels import Tissue, draw_in, find_near, follow_back
from heartcase.simulator.cutting.sheet_kernels import divided, step_lengths, steps_of
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["PLACES_MAX", "blade_at_rest", "places_at_rest", "refined"]

PLACES_MAX = (4096, 100_000)
"""Poses, or points in each, of a blade that is followed back to rest, and both together: what a recording holds."""
_REACH = 4.0
"""How far around a blade cells are looked for at first [cells]."""
_SPACING = 0.5
"""Distance between the places of a blade that are followed back to rest [cells]."""
_AROUND: Int64 = np.array([(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1)])
"""Poses and points beside one another, the nearest first."""
_HALVINGS = 4
"""Of the way between a point in tissue and one beside it in none."""
_CORNERS: Float64 = (CORNER_OFFSETS - 0.5).astype(np.float64)
"""Of a cell from its centre, shape (8, 3)."""


def refined(poses: Float64, name: str = "blade") -> Float64:
    """A blade in poses and points so near to each other that they follow how tissue is deformed, (any, any, 3).

    Raises
    ------
    SimulationError
        It would be too many.
    """
    # Refining one way does not make the other's steps any longer.
    steps, more = steps_of(*step_lengths(poses), _SPACING)
    size = int(steps.sum()) + 1, int(more.sum()) + 1
    if max(size) > PLACES_MAX[0] or size[0] * size[1] > PLACES_MAX[1]:
        raise SimulationError(
            f"the blade reaches too far: at half a cell apart it has {size[0]:,} x {size[1]:,} places; give it near "
            "the tissue alone",
            place=name,
        )
    places: Float64 = divided(poses, steps, more)
    return places


def places_at_rest(
    model: LatticeModel, displacement: Float32, points: npt.ArrayLike, parted: PartedLattice | None = None
) -> tuple[Float64, Bool]:
    """Places at rest of some places now [cells, frame of the nodes], and which lie in no tissue, (..., 3) and (...).

    Parameters
    ----------
    model
        The lattice.
    displacement
        Displacement of its nodes [cells], shape (node_count, 3).
    points
        Places now [cells, frame of the nodes], shape (..., 3).
    parted
        How the lattice was parted, where it was cut. A place between lips that are held apart is in the tissue of
        neither: the cells of both reach over it.
    """
    places = np.asarray(points, dtype=np.float64)
    is_open = np.zeros(places.shape[:-1], np.bool_)
    if not displacement.any():
        return places.copy(), is_open
    result = np.empty((places.size // 3, 3))
    flat, tissue = places.reshape(-1, 3), _tissue(model, displacement, parted)
    near = find_near(flat, tissue, _REACH)
    follow_back(flat, tissue, near, near, result, is_open.reshape(-1))
    return result.reshape(places.shape), is_open


def blade_at_rest(
    model: LatticeModel, displacement: Float32, points: Float64, parted: PartedLattice | None = None
) -> Float64:
    """What a blade sweeps now, at rest: the same poses and points, NaN where it meets no tissue.

    Only what it passes in tissue is cut. A point beside such a one is drawn near to it, until it has just left the
    tissue, so that the cut goes to the lip and not beyond.

    Parameters
    ----------
    model, displacement, parted
        As of :func:`places_at_rest`.
    points
        Places now [cells, frame of the nodes], shape (pose_count, point_count, 3).
    """
    if not displacement.any():
        return points.copy()
    flat, tissue = points.reshape(-1, 3), _tissue(model, displacement, parted)
    near = find_near(flat, tissue, _REACH)
    result, is_open = np.empty(points.shape), np.empty(points.shape[:2], np.bool_)
    wider = follow_back(flat, tissue, near, near, result.reshape(-1, 3), is_open.reshape(-1))
    if is_open.any():
        draw_in(points, is_open, _AROUND, _HALVINGS, tissue, near, wider, result)
    return result


def _tissue(model: LatticeModel, displacement: Float32, parted: PartedLattice | None) -> Tissue:
    none = np.zeros(0, np.int64)
    pieces = (np.zeros(0, np.int32), none, none, none, np.zeros((0, SAMPLES**3), np.int32))
    if parted is not None:
        found = parted.pieces
        pieces = (parted.cell_origin, found.cells, found.counts, found.first, found.samples)
    return Tissue(model.cells, model.cell_corners, displacement, _CORNERS, *pieces)
