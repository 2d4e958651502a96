"""Places in tissue that a thread goes through: bound to the nodes of their own side, and carried over cuts.

A place is a point in an uncut cell, and the sample of its tissue that is nearest. Whatever is cut later, it belongs to
the piece of the cell that this sample belongs to, so that going back and on, and cuts in any order, lead to the same
nodes. In its piece it follows the corners by their trilinear weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64, Int32
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.cutting.descent import cells_of_samples
from heartcase.simulator.cutting.tissue_samples import SAMPLE_PLACES
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.tethers import whole_weights
from heartcase.simulator.surface_splitting.surface_binding import closest_weights

__all__ = [
    "REACH_MM",
    "Place",
    "PlaceOnSurface",
    "as_known",
    "cell_of",
    "nearest_on_surface",
    "nodes_and_weights",
    "place_near",
    "weights_at",
]

REACH_MM = 6.0
"""How far from tissue a place may be given, mm."""
_CANDIDATES = 64
"""Cells nearest to a point in which its place is looked for."""
_ROUNDS = 12
"""Of Newton's method."""
_BEHIND = 1.0 / 8.0
"""How far behind the surface a point is asked which tissue it belongs to [cells]: the distance of two samples."""
_OFFSETS = CORNER_OFFSETS.astype(np.float64)


@dataclass(frozen=True)
class Place:
    """A place in tissue."""

    cell: int
    """Cell of the uncut lattice."""
    sample: int
    """Sample of the cell, of whose piece it is."""
    local: tuple[float, float, float]
    """Where in the cell, from its lowest corner, 0 to 1 along each axis."""


@dataclass(frozen=True)
class PlaceOnSurface:
    """The place of a surface that is nearest to a point."""

    point: Float64
    """Where it is, in the frame that the vertices are in, shape (3,)."""
    behind: Float64
    """A point a little behind it, on the side of the tissue, shape (3,)."""
    distance: float
    """How far the point was from it."""


def weights_at(local: npt.ArrayLike) -> Float64:
    """Trilinear weights of a cell's corners at places in it, shape (..., 8)."""
    at = np.asarray(local, dtype=np.float64)[..., None, :]
    weights: Float64 = np.where(_OFFSETS == 1, at, 1.0 - at).prod(axis=-1)
    return weights


def nodes_and_weights(model: LatticeModel, cell: int, local: npt.ArrayLike) -> tuple[Int32, Float64]:
    """Corners of a cell of ``model`` and their weights at a place in it: whole weights that sum to one, (8,) each."""
    return model.cell_corners[cell], whole_weights(weights_at(local))


def cell_of(place: Place, cuts: Cuts | None) -> int:
    """Cell of the lattice that some cuts leave in which a place lies."""
    if cuts is None or cuts.parted is None:
        return place.cell
    cells = cells_of_samples(cuts.uncut, cuts.parted, np.array([place.cell]))[0]
    # A sample without tissue of a cell whose tissue has none: its first piece.
    return int(cells[place.sample]) if cells[place.sample] >= 0 else place.cell


def as_known(place: Place, uncut: LatticeModel, *, name: str = "stitch") -> Place:
    """A place that was given as numbers.

    Raises
    ------
    SimulationError
        The lattice has no such cell, or a cell no such sample.
    """
    if place.cell >= uncut.cell_count or place.sample >= len(SAMPLE_PLACES):
        raise SimulationError("this place is in another lattice: give it in mm", place=name)
    return place


def nearest_on_surface(point: npt.ArrayLike, vertices: npt.ArrayLike, triangles: Int32) -> PlaceOnSurface:
    """The nearest place of a closed surface.

    Parameters
    ----------
    point
        Shape (3,).
    vertices
        Where the vertices are, shape (vertex_count, 3), in one unit with the point [cells].
    triangles
        Counter-clockwise from outside, shape (triangle_count, 3).
    """
    at = np.asarray(point, dtype=np.float64)
    corners = np.asarray(vertices)[triangles].astype(np.float64)
    # A triangle cannot be nearer than its box.
    low, high = corners.min(axis=1), corners.max(axis=1)
    box = np.linalg.norm(np.maximum(np.maximum(low - at, at - high), 0.0), axis=1)
    far = np.linalg.norm(corners - at, axis=2).min()
    near = np.flatnonzero(box <= far)
    a, b, c = corners[near].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    near, normal = near[size > 0], normal[size > 0] / size[size > 0, None]
    weights = closest_weights(np.broadcast_to(at, (len(near), 3)), corners[near])
    places = np.einsum("tc,tcx->tx", weights, corners[near])
    away = np.linalg.norm(places - at, axis=1)
    nearest = int(away.argmin())
    return PlaceOnSurface(places[nearest], places[nearest] - _BEHIND * normal[nearest], float(away[nearest]))


def place_near(
    model: LatticeModel,
    cuts: Cuts,
    displacement: npt.ArrayLike,
    point: npt.ArrayLike,
    *,
    behind: npt.ArrayLike | None = None,
    name: str = "stitch",
) -> Place:
    """The place in tissue that is nearest to a point.

    Parameters
    ----------
    model
        The lattice now.
    cuts
        What was cut of it, and its tissue.
    displacement
        Displacement of its nodes [cells], shape (node_count, 3).
    point
        [cells], in the frame of the nodes, shape (3,).
    behind
        Where it is asked which tissue it belongs to; the point itself when left out.
    name
        Name in messages.

    Raises
    ------
    SimulationError
        There is no tissue near.
    """
    at = np.asarray(point, dtype=np.float64)
    ask = at if behind is None else np.asarray(behind, dtype=np.float64)
    corners = model.node_index.astype(np.float64) + np.asarray(displacement, dtype=np.float64)
    middle = corners[model.cell_corners].mean(axis=1)
    away = np.einsum("nx,nx->n", middle - at, middle - at)
    if cuts.excised is not None:
        away[cuts.excised[model.cell_corners[:, 0]]] = np.inf
    cells = np.argsort(away, kind="stable")[:_CANDIDATES]
    around = corners[model.cell_corners[cells]]
    local = _local_places(around, at)
    beside = _at(around, local) - at
    missed = np.linalg.norm(beside, axis=1)

    parted = cuts.parted
    origin = cells if parted is None else parted.cell_origin[cells].astype(np.int64)
    is_tissue = cuts.tissue.of_cells(cuts.uncut.cells[origin], cuts.uncut.cell_moments[origin])
    if parted is not None:
        of_sample = cells_of_samples(cuts.uncut, parted, np.unique(origin))
        is_tissue &= of_sample[np.searchsorted(np.unique(origin), origin)] == cells[:, None]
    samples = np.einsum("sc,ncx->nsx", weights_at(SAMPLE_PLACES + 0.5), around)
    to_sample = np.where(is_tissue, np.linalg.norm(samples - ask, axis=2), np.inf)
    nearest = int((to_sample.min(axis=1) + missed).argmin())
    if not missed[nearest] * model.cell_mm <= REACH_MM:
        raise SimulationError(
            f"there is no tissue within {REACH_MM:g} mm of this place; the nearest is "
            f"{missed[nearest] * model.cell_mm:.1f} mm away: give one on the tissue",
            place=name,
        )
    x, y, z = local[nearest].tolist()
    return Place(int(origin[nearest]), int(to_sample[nearest].argmin()), (x, y, z))


def _local_places(corners: Float64, point: Float64) -> Float64:
    """Place in each cell, 0 to 1, that is nearest to a point by Newton's method; corners of shape (count, 8, 3)."""
    local = np.full((len(corners), 3), 0.5)
    signs = 2.0 * _OFFSETS - 1.0
    for _ in range(_ROUNDS):
        gap = _at(corners, local) - point
        part = np.where(_OFFSETS == 1, local[:, None, :], 1.0 - local[:, None, :])
        slopes = np.stack([signs[:, a] * part[..., (a + 1) % 3] * part[..., (a + 2) % 3] for a in range(3)], axis=2)
        matrix = np.einsum("ncx,nca->nxa", corners, slopes)
        flat = np.abs(np.linalg.det(matrix)) < 1e-6
        matrix[flat] = np.eye(3)
        # No further than half a cell a round, and never out of the cell.
        local = np.clip(local - np.clip(np.linalg.solve(matrix, gap[..., None])[..., 0], -0.5, 0.5), 0.0, 1.0)
    return local


def _at(corners: Float64, local: Float64) -> Float64:
    """Where places in cells are, shape (count, 3)."""
    places: Float64 = np.einsum("nc,ncx->nx", weights_at(local), corners)
    return places
