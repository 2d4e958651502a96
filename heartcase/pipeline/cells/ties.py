"""The triangle of nodes that each vertex of the surface follows: the nearest one on its own side of every wall and gap.

The way from the void beside a vertex to its reference point may lie in the void, and may end in tissue. Where it comes
out of tissue again there is a wall, or the lip of an opening, between the two, whatever the labels on both sides are.
And the tissue behind the vertex must hang together with that of the cell whose face it is: else that cell holds what is
beyond a gap. The fields decide.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numba
import numpy as np
from scipy.spatial import cKDTree

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.cells.ways import (
    FieldsInCells,
    fields_in_cells,
    hangs_together,
    is_beyond_wall,
    looks_elsewhere,
    searched,
)
from heartcase.pipeline.data import Surface
from heartcase.pipeline.fields.point_kernels import scratch
from heartcase.pipeline.fields.reader import FieldReader
from heartcase.pipeline.kernels.parallel import every_other
from heartcase.pipeline.kernels.vectors import dot, put, square_to_triangle
from heartcase.schemas.arrays import Float32, Float64, Int32, Int64
from heartcase.schemas.geometry import Geometry

__all__ = ["Check", "NodeTriangles", "TieChooser", "closest_weights"]


_MORE = 4
"""So many times the candidates are tried where all of them are beyond a wall or a gap."""
_NO_USE = -2
"""Instead of a triangle, where none that was not tried is near enough either."""
_HALF_WIDTH = 0.75
"""Cells from the middle of half a face to its farthest corner, rounded up: the root of 5/9."""
_CHUNK = 256


class NodeTriangles(NamedTuple):
    """Triangles that a vertex may follow. In cells: cell (i, j, k) goes from (i, j, k) on, along the grid's axes."""

    corners: Float64
    """Corners of halves of cells' faces, cells, shape (n, 3, 3): corner, then along i, j, k."""
    facing: Float64
    """Unit normals, shape (n, 3)."""
    cells: Int32
    """Index (i, j, k) of the tissue cell behind each, shape (n, 3)."""


class Check(Enum):
    """What must not be between a vertex and the triangle that it follows."""

    NOTHING = 0
    WALLS_GAPS = 1
    """A wall or a gap; for triangles that look into no void."""
    WALLS_GAPS_VOIDS = 2
    """Nor may the triangle look into another void."""


_WALLS_GAPS, _VOIDS = Check.WALLS_GAPS.value, Check.WALLS_GAPS_VOIDS.value


class TieChooser:
    """Looks for the triangles that the vertices of one surface follow."""

    def __init__(
        self, surface: Surface, reader: FieldReader, geometry: Geometry, *, penalty: float, tries: int
    ) -> None:
        """Turn the surface to the axes of the cells.

        Parameters
        ----------
        surface
            The surface; at least one triangle.
        reader
            Of the structures that surface and cells were made from.
        geometry
            Lattice of the cells, parallel to the structures'.
        penalty
            Distance by which a triangle that faces away is set back, in cells.
        tries
            Nearest triangles that are tried first.

        Raises
        ------
        ValueError
            The cells are not parallel to the structures.
        """
        self._places = np.ascontiguousarray(geometry.world_to_index(surface.vertices_mm.astype(np.float64))) + 0.5
        self._normals = np.ascontiguousarray(surface.normals.astype(np.float64) @ geometry.direction_matrix)
        self._fields = fields_in_cells(reader, geometry)
        self._penalty, self._tries = penalty, tries

    def nearest(
        self,
        who: Int64,
        triangles: NodeTriangles,
        among: Int64,
        *,
        check: Check = Check.WALLS_GAPS_VOIDS,
        most: Float64 | None = None,
    ) -> tuple[Int64, Float64]:
        """The triangle with the least distance, penalty included (ties: the first), for some vertices.

        Parameters
        ----------
        who
            Vertices, shape (m,).
        triangles
            All triangles.
        among
            Those that may be taken; at least one.
        check
            What must not be between a vertex and its triangle.
        most
            Greatest distance, cells, penalty included, at which a triangle is of use to each vertex, shape (m,).

        Returns
        -------
        chosen
            Triangle of each vertex, shape (m,); -1 where all that were tried are too far or beyond a wall or a gap.
        score
            Its distance and penalty, cells; infinite where there is none.
        """
        chosen, score = np.empty(len(who), np.int64), np.full(len(who), np.inf)
        limit = np.full(len(who), np.inf) if most is None else most
        tree = cKDTree(triangles.corners[among].mean(axis=1))
        left = np.arange(len(who))
        for tries in (self._tries, _MORE * self._tries):
            count = min(tries, len(among))
            found = tree.query(self._places[who[left]], k=count, workers=numba.get_num_threads())
            apart, tried = (np.asarray(x).reshape(len(left), count) for x in found)
            best, value = np.empty(len(left), np.int64), np.empty(len(left))
            _choose(
                self._places,
                self._normals,
                *self._fields,
                who[left],
                triangles,
                among[tried],
                apart,
                self._penalty,
                check.value,
                limit[left],
                best,
                value,
            )
            chosen[left], score[left] = best, value
            left = left[best == -1]
            if len(left) == 0 or count == len(among):
                break
        chosen[chosen == _NO_USE] = -1
        return chosen, score


def closest_weights(points: Float64, corners: Float64) -> Float32:
    """Weights of the points of triangles that are closest to some points.

    Parameters
    ----------
    points
        Shape (n, 3).
    corners
        One triangle for each point, shape (n, 3, 3): corner, then x, y, z.

    Returns
    -------
    float32, shape (n, 3)
        Multiples of 2**-24 of at least zero, so that their float32 sum is one in any order.
    """
    out = np.empty((len(points), 3), np.float32)
    _closest_weights(points, corners, out)
    return out


@copied
def _closest_point(p, a, b, c, weights):
    """Weights of the point of triangle (a, b, c) that is closest to p; returns the squared distance."""
    squared, second, third = square_to_triangle(p[0], p[1], p[2], a, b, c)
    weights[0], weights[1], weights[2] = 1.0 - second - third, second, third
    return squared


@called
def _choose_some(places, normals, fields, who, triangles, tried, apart, penalty, check, most, chosen, score, chunk):
    """:func:`_choose` for a chunk of the vertices."""
    spare, room = scratch(fields.layout), searched()
    weights, value = np.empty(3), np.empty(tried.shape[1])
    asked, answers = np.empty((tried.shape[1], 3)), np.empty(tried.shape[1], np.bool_)
    for n in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, len(who))):
        place, normal = places[who[n]], normals[who[n]]
        chosen[n], score[n] = -1, np.inf
        asked_count, known_count = 0, 0
        while True:
            best, t, c = np.inf, -1, -1
            for m in range(value.size):
                if m == known_count:
                    # all from here on are farther
                    if apart[n, m] - _HALF_WIDTH > best:
                        break
                    corner = triangles.corners[tried[n, m]]
                    squared = _closest_point(place, corner[0], corner[1], corner[2], weights)
                    away = max(-dot(normal, triangles.facing[tried[n, m]]), 0.0)
                    value[m] = np.sqrt(squared) + penalty * away
                    known_count += 1
                if value[m] < best or (value[m] == best and tried[n, m] < t):
                    best, t, c = value[m], tried[n, m], m
            if best > most[n] or best == np.inf:
                # what was not tried is farther still
                chosen[n] = _NO_USE if apart[n, -1] - _HALF_WIDTH > most[n] else -1
                break
            corner = triangles.corners[t]
            if check >= _WALLS_GAPS:
                _closest_point(place, corner[0], corner[1], corner[2], weights)
                to = weights[0] * corner[0] + weights[1] * corner[1] + weights[2] * corner[2]
                is_tied = not is_beyond_wall(fields, spare, place, normal, triangles.facing[t], to)
                if is_tied:
                    # a cell has several triangles
                    cell = triangles.cells[t]
                    at = 0
                    while at < asked_count and (
                        asked[at, 0] != cell[0] or asked[at, 1] != cell[1] or asked[at, 2] != cell[2]
                    ):
                        at += 1
                    if at == asked_count:
                        put(cell, asked[at])
                        answers[at] = hangs_together(fields, spare, room, place, normal, cell, False)
                        asked_count += 1
                    is_tied = answers[at]
                if is_tied and check >= _VOIDS:
                    facing = triangles.facing[t]
                    is_tied = not looks_elsewhere(fields, spare, room, place, normal, facing, triangles.cells[t])
                if not is_tied:
                    value[c] = np.inf
                    continue
            chosen[n], score[n] = t, best
            break


@loop_kernel
def _choose(
    places, normals, layout, tables, lattice, who, all_triangles, tried, apart, penalty, check, most, chosen, score
):
    """The best of the tried triangles (by the distance of their middles) for each vertex; ties: the least number."""
    chunks = (len(who) + _CHUNK - 1) // _CHUNK
    fields, triangles = lend(FieldsInCells(layout, tables, lattice)), lend(all_triangles)
    for number in numba.prange(chunks):
        _choose_some(
            places,
            normals,
            fields,
            who,
            triangles,
            tried,
            apart,
            penalty,
            check,
            most,
            chosen,
            score,
            every_other(number, chunks),
        )


@loop_kernel
def _closest_weights(points, corners, out):
    steps = 16777216.0
    for n in numba.prange(len(points)):
        weights = np.empty(3)
        _closest_point(points[n], corners[n, 0], corners[n, 1], corners[n, 2], weights)
        second = min(max(np.rint(weights[1] * steps), 0.0), steps)
        third = min(max(np.rint(weights[2] * steps), 0.0), steps - second)
        out[n, 0] = (steps - second - third) / steps
        out[n, 1] = second / steps
        out[n, 2] = third / steps
