"""What is in one place, told apart: the same movements as elsewhere, as numbers that are long enough.

The tissue is moved first along y, then z, then x; after that each corner of a sheet along a direction of its own, those
of lower number the further, as :mod:`heartcase.simulator.mesh_arrangement.sheet_sides` has it. For few
questions, as it is slow.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from heartcase.schemas.arrays import Float64, Int64
from heartcase.simulator.mesh_arrangement.sheet_sides import directions_of

__all__ = ["comes_first", "is_in_all_three", "is_nearer"]

_STEP = 64
"""Bits by which each movement is less than the one before."""
_OWN = 2048
"""Bits by which the corners' own movements are less than a whole number: two of them together count for nothing."""
_BITS = _OWN + 20 * _STEP

_Vector = tuple[int, int, int]


def _moved(corners: Int64, numbers: Sequence[int], among: Sequence[int]) -> dict[int, _Vector]:
    """Places of corners of sheets, times 2^_BITS, by number; moved by their rank among some numbers."""
    rows = {number: row for row, number in enumerate(numbers)}
    ranks = {number: rank for rank, number in enumerate(sorted(set(among)))}
    directions = directions_of(corners)
    found = {}
    for number in rows:
        rank = ranks[number]
        place, way = corners[rows[number]].tolist(), directions[rows[number]].tolist()
        bits = _BITS - _OWN - _STEP * rank
        x, y, z = ((p << _BITS) + (w << bits) for p, w in zip(place, way, strict=True))
        found[number] = (x, y, z)
    return found


def _with_tissue(corners: Int64) -> list[_Vector]:
    """Places of corners of the surface, times 2^_BITS."""
    x, y, z = 1 << (_BITS - 3 * _STEP), 1 << (_BITS - _STEP), 1 << (_BITS - 2 * _STEP)
    return [((a << _BITS) + x, (b << _BITS) + y, (c << _BITS) + z) for a, b, c in corners.tolist()]


def _minus(a: _Vector, b: _Vector) -> _Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _dot(a: _Vector, b: _Vector) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def is_in_all_three(corners: Int64, numbers: Int64, *, first_is_surface: bool) -> tuple[bool, list[float], int]:
    """Whether the point in which the planes of three triangles meet lies in all of them, where, and how they turn.

    Parameters
    ----------
    corners, numbers
        Whole-number places, shape (3, 3, 3), and numbers of the triangles' corners, shape (3, 3).
    first_is_surface
        Whether the first triangle is of the surface, and not of a sheet.
    """
    triangles = _moved_triangles(corners, numbers, first_is_surface, numbers)
    point, scale = _meeting(triangles)
    if scale == 0:
        return False, [0.0] * 3, 0
    for triangle in triangles:
        normal = _normal(triangle)
        for n in range(3):
            start, stop = triangle[n], triangle[(n + 1) % 3]
            inward = _cross(normal, _minus(stop, start))
            way = tuple(at - scale * before for at, before in zip(point, start, strict=True))
            if (_dot(inward, (way[0], way[1], way[2])) > 0) != (scale > 0):
                return False, [0.0] * 3, 0
    return True, [float(Fraction(at, scale << _BITS)) for at in point], 1 if scale > 0 else -1


def comes_first(corners: Int64, numbers: Int64, first_is_surface: Sequence[bool], way: Float64) -> bool:
    """Whether, along a way, one point in which the planes of three triangles meet comes before another.

    Parameters
    ----------
    corners, numbers
        Of both points' triangles, shapes (2, 3, 3, 3) and (2, 3, 3).
    first_is_surface
        Whether the first of each three is of the surface.
    way
        Direction, shape (3,).
    """
    x, y, z = (Fraction(float(along)) for along in way)
    heights = []
    for three, of_three, is_surface in zip(corners, numbers, first_is_surface, strict=True):
        (a, b, c), scale = _meeting(_moved_triangles(three, of_three, is_surface, numbers))
        heights.append((a * x + b * y + c * z) / scale if scale else Fraction(0))
    return heights[0] < heights[1]


def _moved_triangles(corners: Int64, numbers: Int64, first_is_surface: bool, among: Int64) -> list[list[_Vector]]:
    first = 1 if first_is_surface else 0
    moved = _moved(corners[first:].reshape(-1, 3), numbers[first:].ravel().tolist(), among.ravel().tolist())
    triangles: list[list[_Vector]] = [[moved[number] for number in row] for row in numbers[first:].tolist()]
    if first_is_surface:
        triangles.insert(0, _with_tissue(corners[0]))
    return triangles


def _normal(triangle: list[_Vector]) -> _Vector:
    p, q, r = triangle
    return _cross(_minus(q, p), _minus(r, p))


def _meeting(triangles: list[list[_Vector]]) -> tuple[_Vector, int]:
    """Where three planes meet: a place, and what it is to be divided by."""
    normals = [_normal(triangle) for triangle in triangles]
    offsets = [_dot(normal, triangle[0]) for normal, triangle in zip(normals, triangles, strict=True)]
    crosses = [_cross(normals[(n + 1) % 3], normals[(n + 2) % 3]) for n in range(3)]
    x, y, z = (sum(offset * cross[axis] for offset, cross in zip(offsets, crosses, strict=True)) for axis in range(3))
    return (x, y, z), _dot(normals[0], crosses[0])


def is_nearer(
    edge: Int64, edge_numbers: Int64, triangles: Int64, triangle_numbers: Int64, *, edge_is_of_surface: bool
) -> bool:
    """Whether an edge comes to the first of two triangles of sheets before the second.

    Parameters
    ----------
    edge, edge_numbers
        Whole-number places, shape (2, 3), and numbers of its ends.
    triangles, triangle_numbers
        Those of the corners of both triangles, shapes (2, 3, 3) and (2, 3).
    edge_is_of_surface
        Whether the edge is of the surface, and not of a sheet.
    """
    first = 2 if edge_is_of_surface else 0
    places = np.concatenate([edge, triangles.reshape(-1, 3)])[first:]
    numbers = np.concatenate([edge_numbers, triangle_numbers.ravel()])[first:].tolist()
    moved = _moved(places, numbers, numbers)
    shares: list[tuple[int, int]] = []
    start, stop = _with_tissue(edge) if edge_is_of_surface else (moved[numbers[0]], moved[numbers[1]])
    for row in triangle_numbers.tolist():
        p, q, r = (moved[number] for number in row)
        normal = _cross(_minus(q, p), _minus(r, p))
        there, beyond = _dot(normal, _minus(start, p)), _dot(normal, _minus(stop, p))
        shares.append((there, there - beyond))
    (a, b), (c, d) = shares
    return (a * d < c * b) == (b * d > 0)
