"""The cases of marching cubes: which triangles close off the corners of a cube that are tissue.

The table is worked out, not copied. On each face of a cube, corners of the void that only meet across the face's
diagonal are cut off one by one, so tissue is connected over faces and edges and the void over faces alone: no wall that
is one point thick has a hole. The rule looks at one face alone, so two cubes agree about the face they share, and the
mesh is closed and manifold, without a test of the inside (Lorensen and Cline, "Marching cubes", SIGGRAPH 1987, cut
complementary cases alike and leave holes). No triangle's edge inside a cube joins two points of one face: it could meet
the same edge of the next cube.

Corner ``n`` of a cube has the offsets x, y, z in the bits 0, 1, 2 of ``n``. Edge ``4 a + n`` runs along axis ``a``; the
bits of ``n`` are the offsets along the two other axes, the lower axis first.
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import NamedTuple

import numpy as np

from heartcase.schemas.arrays import Int64

__all__ = ["CubeCases", "cube_cases", "edge_corners"]

Polygon = tuple[int, ...]
Triangle = tuple[int, int, int]


class CubeCases(NamedTuple):
    """For each of the 256 cases; bit ``n`` of a case says that corner ``n`` is tissue."""

    triangle_count: Int64
    """Shape (256,)."""
    edges: Int64
    """Cube edges that the triangles' corners lie on, counter-clockwise seen from the void, shape (256, most, 3)."""


def edge_corners(edge: int) -> tuple[int, int]:
    """The two corners of an edge, the lower one first."""
    axis, rest = divmod(edge, 4)
    first, second = (other for other in range(3) if other != axis)
    corner = ((rest & 1) << first) | ((rest >> 1) << second)
    return corner, corner | (1 << axis)


_EDGE_OF = {frozenset(edge_corners(edge)): edge for edge in range(12)}


def _faces() -> list[tuple[int, int, int, int]]:
    """Corners of each face, counter-clockwise seen from outside the cube."""
    found = []
    for axis, side in itertools.product(range(3), (0, 1)):
        u, v = (1 << (axis + 1) % 3), (1 << (axis + 2) % 3)
        base = side << axis
        ring = (base, base | u, base | u | v, base | v)
        found.append(ring if side else ring[::-1])
    return found


_FACES = _faces()
_FACES_OF_EDGE = {
    edge: frozenset(n for n, ring in enumerate(_FACES) if set(edge_corners(edge)) <= set(ring)) for edge in range(12)
}


@cache
def cube_cases() -> CubeCases:
    """The table of all cases."""
    found = [[triangle for loop in _loops(case) for triangle in _triangulated(loop)] for case in range(256)]
    edges = np.zeros((256, max(map(len, found)), 3), np.int64)
    for case, triangles in enumerate(found):
        edges[case, : len(triangles)] = np.reshape(triangles, (-1, 3))
    return CubeCases(np.array([len(one) for one in found], np.int64), edges)


def _loops(case: int) -> list[Polygon]:
    """Closed polygons, by the cube edges of their corners, that part tissue from void."""
    following: dict[int, int] = {}
    for ring in _FACES:
        is_void = [not case >> corner & 1 for corner in ring]
        for k in range(4):
            if is_void[k] and not is_void[k - 1]:
                end = next(m for m in range(k, k + 4) if not is_void[(m + 1) % 4])
                enter = _EDGE_OF[frozenset((ring[k - 1], ring[k]))]
                leave = _EDGE_OF[frozenset((ring[end % 4], ring[(end + 1) % 4]))]
                following[leave] = enter
    loops = []
    while following:
        loop = [min(following)]
        while (after := following.pop(loop[-1])) != loop[0]:
            loop.append(after)
        loops.append(tuple(loop))
    return loops


def _triangulated(loop: Polygon) -> tuple[Triangle, ...]:
    """Of the triangulations without a diagonal in a face of the cube the one that leaves most tissue (ties: the first).

    So a layer of tissue that ends in a plane of the lattice, as at the volume's border, has a flat end up to its rim.
    """
    return max(
        (one for one in _triangulations(loop) if not _lies_in_a_face(loop, one)),
        key=lambda triangles: round(sum(map(_volume, triangles)), 9),
    )


def _triangulations(polygon: Polygon) -> list[tuple[Triangle, ...]]:
    if len(polygon) < 3:
        return [()]
    found = []
    # the triangle on the side from the last corner to the first has one of the others as its tip
    for tip in range(1, len(polygon) - 1):
        triangle = (polygon[0], polygon[tip], polygon[-1])
        for before in _triangulations(polygon[: tip + 1]):
            for after in _triangulations(polygon[tip:]):
                found.append((*before, triangle, *after))
    return found


def _lies_in_a_face(loop: Polygon, triangles: tuple[Triangle, ...]) -> bool:
    sides = {frozenset(pair) for pair in zip(loop, loop[1:] + loop[:1], strict=True)}
    inner = {frozenset(pair) for triangle in triangles for pair in itertools.combinations(triangle, 2)} - sides
    return any(_FACES_OF_EDGE[min(pair)] & _FACES_OF_EDGE[max(pair)] for pair in inner)


@cache
def _volume(triangle: Triangle) -> float:
    """Volume between a triangle and the cube's corner 0, with the triangle's corners in the middles of their edges."""
    middles = np.array([[[c >> axis & 1 for axis in range(3)] for c in edge_corners(edge)] for edge in triangle])
    return float(np.linalg.det(middles.mean(axis=1))) / 6.0
