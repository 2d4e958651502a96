"""How near an incision comes to what must not be hurt: coronary arteries, and any labelled structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float64, Int64
from heartcase.schemas.errors import SimulationError
from heartcase.schemas.landmarks import Landmark
from heartcase.simulator.incisions.directions import divided
from heartcase.simulator.incisions.segments import nearest_triangles

__all__ = ["Carrier", "Nearness", "as_triangles", "carried", "to_structure", "to_vessel", "to_vessels"]

_SPACING_MM = 1.0
"""Longest piece of a curve whose distance is worked out as one, mm: it says where; the distance itself is exact."""


@dataclass(frozen=True)
class Nearness:
    """How near a cut comes to something."""

    name: str
    """What."""
    distance_mm: float
    """Shortest distance, mm; below 0 as deep as it goes into a vessel."""
    place_mm: Float64
    """About where, on the vessel's course or the curve: the middle of the nearest piece, mm, shape (3,)."""


@dataclass(frozen=True)
class Carrier:
    """A surface that carries points on or near it: which vertex each goes with is looked for once."""

    rest_mm: npt.NDArray[np.floating]
    """Its vertices at rest, mm, shape (vertex_count, 3)."""
    _nearest: dict[bytes, Int64] = field(default_factory=dict, repr=False, compare=False)

    def carried(self, points_mm: npt.ArrayLike, now_mm: npt.ArrayLike) -> Float64:
        """Where points are now: each goes the way of the vertex that was nearest to it at rest.

        Parameters
        ----------
        points_mm
            Points at rest, mm, shape (count, 3).
        now_mm
            The vertices now, mm, shape (vertex_count, 3).
        """
        points = np.asarray(points_mm, dtype=float).reshape(-1, 3)
        nearest = self._nearest.get(points.tobytes())
        if nearest is None:
            rest = np.asarray(self.rest_mm, dtype=float)
            nearest = np.array([np.argmin(((rest - point) ** 2).sum(axis=1)) for point in points], np.int64)
            self._nearest[points.tobytes()] = nearest
        now, rest = (np.asarray(one)[nearest].astype(float) for one in (now_mm, self.rest_mm))
        moved: Float64 = points + now - rest
        return moved


def carried(points_mm: npt.ArrayLike, rest_mm: npt.ArrayLike, now_mm: npt.ArrayLike) -> Float64:
    """Where points on or near a surface are now: each goes the way of the vertex that was nearest to it at rest.

    Parameters
    ----------
    points_mm
        Points at rest, mm, shape (count, 3).
    rest_mm, now_mm
        The surface's vertices at rest and now, mm, shape (vertex_count, 3).
    """
    rest, now = (np.asarray(one, dtype=float).reshape(-1, 3) for one in (rest_mm, now_mm))
    return Carrier(rest).carried(points_mm, now)


def to_vessel(corners_mm: npt.ArrayLike, course_mm: npt.ArrayLike, radius_mm: float, *, name: str) -> Nearness:
    """How near what is cut comes to the outside of a vessel.

    Parameters
    ----------
    corners_mm
        Triangles, mm, shape (count, 3, 3), at least one: :func:`as_triangles` makes them of a line.
    course_mm
        The vessel's middle line, mm, shape (count, 3), at least two points.
    radius_mm
        Its radius, mm.
    name
        Its name.

    Raises
    ------
    SimulationError
        The middle line is none.
    """
    distance, place = _nearest(course_mm, np.asarray(corners_mm, dtype=float))
    return Nearness(name, distance - radius_mm, place)


def to_vessels(corners_mm: npt.ArrayLike, landmarks: Sequence[Landmark]) -> tuple[Nearness, ...]:
    """How near what is cut comes to each vessel among a case's landmarks at rest, the nearest first.

    Parameters
    ----------
    corners_mm
        Triangles at rest, mm, shape (count, 3, 3), at least one.
    landmarks
        Landmarks of the case: those that are vessels count, such as the coronary arteries.
    """
    found = [
        to_vessel(corners_mm, one.points_mm, one.radius_mm or 0.0, name=one.name) for one in landmarks if one.is_vessel
    ]
    return tuple(sorted(found, key=lambda one: (one.distance_mm, one.name)))


def as_triangles(curve_mm: npt.ArrayLike) -> Float64:
    """An open curve as triangles without an area, mm, shape (count - 1, 3, 3).

    Raises
    ------
    SimulationError
        It is no curve.
    """
    curve = _checked(curve_mm)
    return np.stack([curve[:-1], curve[1:], curve[1:]], axis=1)


def to_structure(
    curve_mm: npt.ArrayLike, vertices_mm: npt.ArrayLike, triangles: npt.ArrayLike, is_of_it: Bool, *, name: str
) -> Nearness:
    """How near an open curve comes to the triangles of a labelled structure.

    Parameters
    ----------
    curve_mm
        The incision as it is now, mm, shape (count, 3).
    vertices_mm
        The surface's vertices now, mm, shape (vertex_count, 3).
    triangles
        Their numbers, shape (triangle_count, 3).
    is_of_it
        Which triangles are the structure's, by their label, shape (triangle_count,).
    name
        Its name.

    Raises
    ------
    SimulationError
        It has no triangle.
    """
    corners = np.asarray(vertices_mm, dtype=float)[np.asarray(triangles)[is_of_it]]
    if not len(corners):
        raise SimulationError(f"the surface has no triangle of {name}: name a structure that it shows", place=name)
    distance, place = _nearest(curve_mm, corners)
    return Nearness(name, distance, place)


def _nearest(curve_mm: npt.ArrayLike, corners: Float64) -> tuple[float, Float64]:
    curve = _checked(curve_mm)
    middles, lengths = divided(curve, _SPACING_MM, is_closed=False)
    along = np.repeat(np.diff(curve, axis=0), _pieces(curve), axis=0)
    size = np.linalg.norm(along, axis=1, keepdims=True)
    half = 0.5 * lengths[:, None] * np.divide(along, size, out=np.zeros_like(along), where=size > 0.0)
    distance, _ = nearest_triangles(middles - half, middles + half, corners)
    nearest = int(np.argmin(distance))
    return float(distance[nearest]), middles[nearest]


def _checked(curve_mm: npt.ArrayLike) -> Float64:
    curve = np.asarray(curve_mm, dtype=float)
    if curve.ndim != 2 or curve.shape[0] < 2 or curve.shape[1] != 3 or not np.isfinite(curve).all():
        raise SimulationError("a curve must be at least two finite points", place="curve_mm")
    return curve


def _pieces(curve: Float64) -> Int64:
    """Pieces of each of the curve's segments, as it was divided."""
    lengths = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    pieces: Int64 = np.maximum(np.ceil(lengths / _SPACING_MM), 1).astype(np.int64)
    return pieces
