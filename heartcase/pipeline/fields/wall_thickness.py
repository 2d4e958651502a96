"""Wall thickness that varies from place to place, given by a table of places.

Along a centreline the thickness is that of the nearest point of the polyline, linear in arc length between the table's
points and constant beyond its ends. Among positions it is the mean weighted by the inverse fourth power of the distance
(Shepard, Proc. ACM National Conference, 1968): the table's own value at each position, never outside the table's range,
and near a position hardly touched by how many others lie far away (the power must exceed the two dimensions of a
surface for that).

A wall is where the distance d to the cavity is less than the thickness t *there*, so each point of the outer surface
is just the thickness at that point away from the cavity. ``d - t`` grows by sqrt(1 + |grad t|^2) per mm where t
varies along the wall and d across it; divided by that it is a distance again (exactly so for a cone).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import ThicknessTable
from heartcase.schemas.arrays import Float64, Int32

__all__ = ["ThicknessArrays", "table_thickness", "thickness_arrays", "thickness_at_points"]


class ThicknessArrays(NamedTuple):
    """Tables of thickness as the kernels read them."""

    wall: Int32
    """Number of the wall that each table is for."""
    kind: Int32
    """0 centreline, 1 positions; one per table."""
    first: Int32
    """First point of each table, and the number of all points at the end."""
    points: Float64
    """World mm, shape (n, 3)."""
    thickness: Float64
    """At each point, mm, shape (n,)."""
    nearest_mm: float
    """Tables are read where the distance to the cavity lies between this and the next."""
    farthest_mm: float


def thickness_arrays(
    tables: Sequence[ThicknessTable], walls: Sequence[int], *, nearest_mm: float, farthest_mm: float
) -> ThicknessArrays:
    """Pack tables for the kernels; ``walls`` holds the number of the wall of each table."""
    first = np.zeros(len(tables) + 1, np.int32)
    for n, table in enumerate(tables):
        first[n + 1] = first[n] + len(table.points_mm)
    return ThicknessArrays(
        np.array(walls, np.int32),
        np.array([0 if table.kind == "centreline" else 1 for table in tables], np.int32),
        first,
        np.array([point for table in tables for point in table.points_mm], np.float64).reshape(-1, 3),
        np.array([value for table in tables for value in table.thickness_mm], np.float64),
        nearest_mm,
        farthest_mm,
    )


def thickness_at_points(table: ThicknessTable, points_mm: npt.ArrayLike) -> tuple[Float64, Float64]:
    """Thickness and the length of its gradient at world points.

    Parameters
    ----------
    table
        A table of thicknesses.
    points_mm
        World points in mm, shape (n, 3).

    Returns
    -------
    thickness_mm, slope : Float64
        Thickness in mm and its greatest change in mm per mm, each shape (n,).
    """
    points = np.ascontiguousarray(np.asarray(points_mm, np.float64).reshape(-1, 3))
    arrays = thickness_arrays([table], [0], nearest_mm=0.0, farthest_mm=0.0)
    found = np.empty((2, len(points)))
    _at_points(arrays, points, found)
    return found[0], found[1]


@copied
def _along_centreline(points, thickness, x, y, z):
    """Thickness at the nearest point of a polyline (ties: the first), and its slope along the line there."""
    lowest = np.inf
    value = thickness[0]
    slope = 0.0
    for n in range(len(points) - 1):
        ax = points[n + 1, 0] - points[n, 0]
        ay = points[n + 1, 1] - points[n, 1]
        az = points[n + 1, 2] - points[n, 2]
        px = x - points[n, 0]
        py = y - points[n, 1]
        pz = z - points[n, 2]
        square = ax * ax + ay * ay + az * az
        # Points may be so near each other, or so far away, that their distance has no square.
        t = (px * ax + py * ay + pz * az) / square if 0.0 < square < np.inf else 0.0
        between = 0.0 < t < 1.0
        t = min(max(t, 0.0), 1.0)
        px -= t * ax
        py -= t * ay
        pz -= t * az
        distance = px * px + py * py + pz * pz
        if distance < lowest:
            lowest = distance
            step = thickness[n + 1] - thickness[n]
            value = thickness[n] + t * step
            slope = abs(step) / np.sqrt(square) if between else 0.0
    return value, slope


@copied
def _among_positions(points, thickness, x, y, z):
    """Shepard's mean with weights 1 / distance^4, and the length of its gradient."""
    lowest = np.inf
    nearest = 0
    for n in range(len(points)):
        distance = (x - points[n, 0]) ** 2 + (y - points[n, 1]) ** 2 + (z - points[n, 2]) ** 2
        if distance < lowest:
            lowest = distance
            nearest = n
    if lowest == 0.0 or lowest == np.inf:
        return thickness[nearest], 0.0
    # relative to the nearest position, so that equal numbers give just that number and nothing overflows
    total = 0.0
    mean = 0.0
    for n in range(len(points)):
        distance = (x - points[n, 0]) ** 2 + (y - points[n, 1]) ** 2 + (z - points[n, 2]) ** 2
        weight = (lowest / distance) ** 2
        total += weight
        mean += weight * (thickness[n] - thickness[nearest])
    value = thickness[nearest] + mean / total
    gx = 0.0
    gy = 0.0
    gz = 0.0
    for n in range(len(points)):
        distance = (x - points[n, 0]) ** 2 + (y - points[n, 1]) ** 2 + (z - points[n, 2]) ** 2
        factor = -4.0 * (lowest / distance) ** 2 / distance * (thickness[n] - value) / total
        gx += factor * (x - points[n, 0])
        gy += factor * (y - points[n, 1])
        gz += factor * (z - points[n, 2])
    return value, np.sqrt(gx * gx + gy * gy + gz * gz)


@copied
def table_thickness(arrays, n, x, y, z):
    """Thickness in mm, and the length of its gradient, of table ``n`` at a world point."""
    points = arrays.points[arrays.first[n] : arrays.first[n + 1]]
    thickness = arrays.thickness[arrays.first[n] : arrays.first[n + 1]]
    if arrays.kind[n] == 0:
        return _along_centreline(points, thickness, x, y, z)
    return _among_positions(points, thickness, x, y, z)


@kernel
def _at_points(arrays, points, found):
    for p in range(len(points)):
        value, slope = table_thickness(arrays, 0, points[p, 0], points[p, 1], points[p, 2])
        found[0, p] = value
        found[1, p] = slope
