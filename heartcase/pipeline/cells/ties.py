"""Which triangle of nodes a vertex of the surface follows: the nearest one on its own side of every wall and gap.

The way from a vertex to its reference point may lie in the void, and may end in tissue. Where it comes out of tissue
again there is a wall, or the lip of an opening, between the two, whatever the labels on both sides are. And the surface
around the vertex must lead into the cell whose face it is: else that cell holds what is beyond a gap.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from heartcase.pipeline.data import Surface
from heartcase.pipeline.mesh.triangle_grid import triangle_grid
from heartcase.pipeline.side_by_side import every_other
from heartcase.pipeline.vectors import dot, square_to_triangle
from heartcase.schemas.geometry import Geometry

__all__ = ["NodeTriangles", "TieChooser", "closest_weights"]

Bool = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]

_IN_TISSUE = 0.25
"""Cells that a way may lead through tissue at its end."""
_BEYOND = 0.4
"""Cells beyond a triangle within which a way that ends in tissue, and comes from behind, must not come out of it."""
_SKIN = 0.05
"""Cells around a cell that count as the cell where the surface leads: what it holds too little of is left out. And
cells beside tissue that may be in it."""
_AROUND = 0.5
"""Cells around the cells of a vertex and a triangle within which the surface must lead from one to the other."""
_MORE = 4
"""So many times the candidates are tried where all of them are beyond a wall or a gap."""
_CHUNK = 128
_HAIR = 1e-6
"""Boxes by which a way is taken to be wider, so that rounding leaves no box out."""


class NodeTriangles(NamedTuple):
    """Triangles that a vertex may follow."""

    corners: Float64
    """Corners, mm, shape (n, 3, 3): corner, then x, y, z."""
    facing: Float64
    """Unit normals, shape (n, 3)."""
    cells: Int32
    """Index (i, j, k) of the tissue cell behind each, shape (n, 3)."""


class _Mesh(NamedTuple):
    """The surface, as the kernels read it."""

    vertices: Float64
    normals: Float64
    triangles: Int32
    places: Float64
    """Vertices in cells, shape (vertex_count, 3): cell (i, j, k) goes from (i, j, k) on."""
    start: Int64
    """Where each vertex begins in ``incident``, and the end of the last."""
    incident: Int32
    """Triangles around each vertex."""


class TieChooser:
    """Looks for the triangles that the vertices of one surface follow."""

    def __init__(self, surface: Surface, geometry: Geometry, *, penalty: float, tries: int) -> None:
        """Sort the surface's triangles into boxes.

        Parameters
        ----------
        surface
            The surface; at least one triangle.
        geometry
            Lattice of the cells.
        penalty
            Distance by which a triangle that faces away is set back, in cells.
        tries
            Nearest triangles that are tried first.
        """
        vertices = surface.vertices_mm.astype(np.float64)
        corner = surface.triangles.ravel()
        self._mesh = _Mesh(
            vertices,
            surface.normals.astype(np.float64),
            surface.triangles,
            np.ascontiguousarray(geometry.world_to_index(vertices)) + 0.5,
            np.concatenate(([0], np.cumsum(np.bincount(corner, minlength=len(vertices))))),
            (np.argsort(corner, kind="stable") // 3).astype(np.int32),
        )
        self._boxes = triangle_grid(vertices, surface.triangles)
        cell_mm = geometry.spacing_mm[0]
        self._penalty_mm, self._tries = penalty * cell_mm, tries
        self._skin_mm, self._beyond_mm = _IN_TISSUE * cell_mm, _BEYOND * cell_mm

    def nearest(
        self,
        who: Int64,
        triangles: NodeTriangles,
        among: Int64,
        *,
        is_any: bool = False,
        most_mm: Float64 | None = None,
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
        is_any
            Whether walls and gaps in the way do not matter.
        most_mm
            Greatest distance, penalty included, at which a triangle is of use to each vertex, shape (m,).

        Returns
        -------
        chosen
            Triangle of each vertex, shape (m,); -1 where all that were tried are too far or beyond a wall or a gap.
        score
            Its distance and penalty, mm; infinite where there is none.
        """
        chosen, score = np.empty(len(who), np.int64), np.full(len(who), np.inf)
        most = np.full(len(who), np.inf) if most_mm is None else most_mm
        tree = cKDTree(triangles.corners[among].mean(axis=1))
        left = np.arange(len(who))
        for tries in (self._tries, _MORE * self._tries):
            count = min(tries, len(among))
            places = self._mesh.vertices[who[left]]
            found = tree.query(places, k=count, workers=numba.get_num_threads())[1].reshape(len(left), count)
            best, value = np.empty(len(left), np.int64), np.empty(len(left))
            tried = np.sort(among[found], axis=1)
            reach = self._penalty_mm, self._skin_mm, self._beyond_mm
            _choose(self._mesh, self._boxes, who[left], triangles, tried, reach, is_any, most[left], best, value)
            chosen[left], score[left] = best, value
            left = left[best < 0]
            if len(left) == 0 or count == len(among):
                break
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


@numba.njit(cache=True, nogil=True)
def _closest_point(p, a, b, c, weights):  # type: ignore[no-untyped-def]
    """Weights of the point of triangle (a, b, c) that is closest to p; returns the squared distance."""
    squared, second, third = square_to_triangle(p[0], p[1], p[2], a, b, c)
    weights[0], weights[1], weights[2] = 1.0 - second - third, second, third
    return squared


@numba.njit(cache=True, nogil=True)
def _crossing(p, way, corner):  # type: ignore[no-untyped-def]
    """Part of a way from p up to a triangle, its rim included: above 0 where it comes out of tissue, below it goes in.

    0 where the way does not meet it.
    """
    a = corner[0]
    e1x, e1y, e1z = corner[1, 0] - a[0], corner[1, 1] - a[1], corner[1, 2] - a[2]
    e2x, e2y, e2z = corner[2, 0] - a[0], corner[2, 1] - a[1], corner[2, 2] - a[2]
    nx, ny, nz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
    along = way[0] * nx + way[1] * ny + way[2] * nz
    if along == 0.0:
        return 0.0
    sx, sy, sz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    part = -(sx * nx + sy * ny + sz * nz) / along
    if part <= 0.0 or part > 1.0:
        return 0.0
    qx, qy, qz = sy * way[2] - sz * way[1], sz * way[0] - sx * way[2], sx * way[1] - sy * way[0]
    u = -(qx * e2x + qy * e2y + qz * e2z) / along
    v = (qx * e1x + qy * e1y + qz * e1z) / along
    if u < 0.0 or v < 0.0 or u + v > 1.0:
        return 0.0
    return part if along > 0.0 else -part


@numba.njit(cache=True, nogil=True)
def _boxes_on_way(axis, begin, end, p, way, boxes):  # type: ignore[no-untyped-def]
    """First and last layer of boxes along an axis that a part of a way from p passes, a hair's breadth around it."""
    a = (p[axis] + begin * way[axis] - boxes.origin[axis]) / boxes.edge
    b = (p[axis] + end * way[axis] - boxes.origin[axis]) / boxes.edge
    first = max(int(np.floor(min(a, b) - _HAIR)), 0)
    return first, min(int(np.floor(max(a, b) + _HAIR)), boxes.size[axis] - 1)


@numba.njit(cache=True, nogil=True)
def _part_in_layer(axis, layer, begin, end, p, way, boxes):  # type: ignore[no-untyped-def]
    """The part of a part of a way from p that lies in a layer of boxes, a hair's breadth around it."""
    if way[axis] == 0.0:
        return begin, end
    a = (boxes.origin[axis] + (layer - _HAIR) * boxes.edge - p[axis]) / way[axis]
    b = (boxes.origin[axis] + (layer + 1 + _HAIR) * boxes.edge - p[axis]) / way[axis]
    return max(begin, min(a, b)), min(end, max(a, b))


@numba.njit(cache=True, nogil=True)
def _first_and_last(vertex, p, way, triangles, boxes):  # type: ignore[no-untyped-def]
    """Whether a way from p comes out of tissue, and the part of it after which it last goes in; 0 where it does not.

    What is incident to a vertex is left out.
    """
    goes_in = 0.0
    first, last = _boxes_on_way(2, 0.0, 1.0, p, way, boxes)
    for k in range(first, last + 1):
        from_k, to_k = _part_in_layer(2, k, 0.0, 1.0, p, way, boxes)
        first_j, last_j = _boxes_on_way(1, from_k, to_k, p, way, boxes)
        for j in range(first_j, last_j + 1):
            from_j, to_j = _part_in_layer(1, j, from_k, to_k, p, way, boxes)
            first_i, last_i = _boxes_on_way(0, from_j, to_j, p, way, boxes)
            for i in range(first_i, last_i + 1):
                box = (k * boxes.size[1] + j) * boxes.size[0] + i
                for n in range(boxes.start[box], boxes.start[box + 1]):
                    t = boxes.item[n]
                    if triangles[t, 0] == vertex or triangles[t, 1] == vertex or triangles[t, 2] == vertex:
                        continue
                    part = _crossing(p, way, boxes.corner[t])
                    if part > 0.0:
                        return True, goes_in
                    goes_in = max(goes_in, -part)
    return False, goes_in


@numba.njit(cache=True, nogil=True)
def _is_near(vertex, p, reach, triangles, boxes):  # type: ignore[no-untyped-def]
    """Whether a triangle that is not incident to a vertex is within a distance of a place."""
    weights, low, high = np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        low[axis] = max(int(np.floor((p[axis] - reach - boxes.origin[axis]) / boxes.edge)), 0)
        high[axis] = min(int(np.floor((p[axis] + reach - boxes.origin[axis]) / boxes.edge)), boxes.size[axis] - 1)
    for k in range(low[2], high[2] + 1):
        for j in range(low[1], high[1] + 1):
            for i in range(low[0], high[0] + 1):
                box = (k * boxes.size[1] + j) * boxes.size[0] + i
                for n in range(boxes.start[box], boxes.start[box + 1]):
                    t = boxes.item[n]
                    if triangles[t, 0] == vertex or triangles[t, 1] == vertex or triangles[t, 2] == vertex:
                        continue
                    three = boxes.corner[t]
                    if _closest_point(p, three[0], three[1], three[2], weights) <= reach * reach:
                        return True
    return False


@numba.njit(cache=True, nogil=True)
def _starts_in_tissue(mesh, v, way):  # type: ignore[no-untyped-def]
    """Whether a way leads from a vertex into the tissue: by the triangles around it that its beginning is nearest to.

    Where that is an edge, or the vertex, the sum of the normals around it decides.
    """
    p = mesh.vertices[v]
    q = p + 1e-3 * way
    weights, normal, side = np.empty(3), np.zeros(3), np.zeros(3)
    nearest = np.inf
    slack = 1e-12 * dot(way, way)
    for n in range(mesh.start[v], mesh.start[v + 1]):
        three = mesh.triangles[mesh.incident[n]]
        a, b, c = mesh.vertices[three[0]], mesh.vertices[three[1]], mesh.vertices[three[2]]
        squared = _closest_point(q, a, b, c, weights)
        if squared > nearest + slack:
            continue
        if squared < nearest - slack:
            nearest = squared
            side[:] = 0.0
        e, f = b - a, c - a
        normal[0] = e[1] * f[2] - e[2] * f[1]
        normal[1] = e[2] * f[0] - e[0] * f[2]
        normal[2] = e[0] * f[1] - e[1] * f[0]
        length = np.sqrt(dot(normal, normal))
        if length > 0.0:
            side += normal / length
    return dot(way, side) < 0.0


@numba.njit(cache=True, nogil=True)
def _is_beyond(mesh, boxes, v, facing, to, skin, beyond):  # type: ignore[no-untyped-def]
    """Whether a wall is between a vertex and a point of a triangle."""
    way = to - mesh.vertices[v]
    comes_out, goes_in = _first_and_last(v, mesh.vertices[v], way, mesh.triangles, boxes)
    if comes_out:
        return True
    if goes_in == 0.0 and not _starts_in_tissue(mesh, v, way):
        if dot(way, facing) <= 0.0:
            return False
        # The decimated surface is off the true one: right beside tissue may be in it.
        near = _SKIN / _BEYOND * beyond
        return _is_near(v, to, near, mesh.triangles, boxes) and (
            _first_and_last(v, mesh.vertices[v], way + 0.5 * beyond * facing, mesh.triangles, boxes)[0]
            or _first_and_last(v, to, beyond * facing, mesh.triangles, boxes)[0]
        )
    # It ends in tissue: in that of a cell that is none, for having too little, or in the skin of a wall.
    inside = (1.0 - goes_in) * np.sqrt(dot(way, way))
    if inside > skin:
        return True
    return dot(way, facing) > 0.0 and _first_and_last(v, to, beyond * facing, mesh.triangles, boxes)[0]


@numba.njit(cache=True, nogil=True)
def _meets_cell(p, q, r, cell):  # type: ignore[no-untyped-def]
    """Whether a triangle and a cell, grown by its skin, meet: no plane along a face, or through two edges, parts them.

    The planes are those of separating axes: the axes of the cell, the normal, and axes across an edge of each.
    """
    half = 0.5 + _SKIN
    for a in range(3):
        middle = cell[a] + 0.5
        if max(p[a], q[a], r[a]) < middle - half or min(p[a], q[a], r[a]) > middle + half:
            return False
    px, py, pz = p[0] - cell[0] - 0.5, p[1] - cell[1] - 0.5, p[2] - cell[2] - 0.5
    qx, qy, qz = q[0] - cell[0] - 0.5, q[1] - cell[1] - 0.5, q[2] - cell[2] - 0.5
    rx, ry, rz = r[0] - cell[0] - 0.5, r[1] - cell[1] - 0.5, r[2] - cell[2] - 0.5
    ux, uy, uz = qx - px, qy - py, qz - pz
    vx, vy, vz = rx - px, ry - py, rz - pz
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    if abs(nx * px + ny * py + nz * pz) > half * (abs(nx) + abs(ny) + abs(nz)):
        return False
    for edge in range(3):
        ex, ey, ez = (ux, uy, uz) if edge == 0 else ((vx, vy, vz) if edge == 1 else (vx - ux, vy - uy, vz - uz))
        for a in range(3):
            x, y, z = (0.0, -ez, ey) if a == 0 else ((ez, 0.0, -ex) if a == 1 else (-ey, ex, 0.0))
            one, two, three = x * px + y * py + z * pz, x * qx + y * qy + z * qz, x * rx + y * ry + z * rz
            reach = half * (abs(x) + abs(y) + abs(z))
            if max(one, two, three) < -reach or min(one, two, three) > reach:
                return False
    return True


@numba.njit(cache=True, nogil=True)
def _leads_to(mesh, vertex, cell, low, high, seen, stamp, stack):  # type: ignore[no-untyped-def]
    """Whether the surface leads from a vertex into a cell, near the cells of both."""
    for a in range(3):
        own = int(np.floor(mesh.places[vertex, a]))
        low[a], high[a] = min(own, cell[a]) - _AROUND, max(own, cell[a]) + 1.0 + _AROUND
    stack[0] = vertex
    seen[vertex] = stamp
    top = 1
    while top > 0:
        top -= 1
        at = stack[top]
        for n in range(mesh.start[at], mesh.start[at + 1]):
            three = mesh.triangles[mesh.incident[n]]
            if _meets_cell(mesh.places[three[0]], mesh.places[three[1]], mesh.places[three[2]], cell):
                return True
            for c in range(3):
                other = three[c]
                if seen[other] == stamp:
                    continue
                seen[other] = stamp
                is_near = True
                for a in range(3):
                    if mesh.places[other, a] < low[a] or mesh.places[other, a] > high[a]:
                        is_near = False
                if is_near:
                    stack[top] = other
                    top += 1
    return False


@numba.njit(cache=True, nogil=True, parallel=True)
def _choose(mesh, boxes, who, triangles, tried, reach, is_any, most, chosen, score):  # type: ignore[no-untyped-def]
    """The best of the tried triangles (ascending numbers) for each vertex; ties: the first."""
    penalty, skin, beyond = reach
    chunks = (len(who) + _CHUNK - 1) // _CHUNK
    for number in numba.prange(chunks):
        chunk = every_other(number, chunks)
        seen, stack = np.zeros(len(mesh.vertices), np.int64), np.empty(len(mesh.vertices), np.int64)
        low, high, weights, value = np.empty(3), np.empty(3), np.empty(3), np.empty(tried.shape[1])
        asked, answers = np.empty((tried.shape[1], 3)), np.empty(tried.shape[1], np.bool_)
        stamp = 0
        for n in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, len(who))):
            v = who[n]
            for c in range(len(value)):
                corner = triangles.corners[tried[n, c]]
                squared = _closest_point(mesh.vertices[v], corner[0], corner[1], corner[2], weights)
                away = max(-dot(mesh.normals[v], triangles.facing[tried[n, c]]), 0.0)
                value[c] = np.sqrt(squared) + penalty * away
            chosen[n], score[n] = -1, np.inf
            asked_count = 0
            for _ in range(len(value)):
                c = int(np.argmin(value))
                if value[c] > most[n]:
                    break
                t = tried[n, c]
                corner = triangles.corners[t]
                if not is_any:
                    _closest_point(mesh.vertices[v], corner[0], corner[1], corner[2], weights)
                    to = weights[0] * corner[0] + weights[1] * corner[1] + weights[2] * corner[2]
                    is_tied = not _is_beyond(mesh, boxes, v, triangles.facing[t], to, skin, beyond)
                    if is_tied:
                        # a cell has several triangles
                        cell = triangles.cells[t]
                        at = 0
                        while at < asked_count and (
                            asked[at, 0] != cell[0] or asked[at, 1] != cell[1] or asked[at, 2] != cell[2]
                        ):
                            at += 1
                        if at == asked_count:
                            stamp += 1
                            asked[at] = cell
                            answers[at] = _leads_to(mesh, v, cell, low, high, seen, stamp, stack)
                            asked_count += 1
                        is_tied = answers[at]
                    if not is_tied:
                        value[c] = np.inf
                        continue
                chosen[n], score[n] = t, value[c]
                break


@numba.njit(cache=True, nogil=True, parallel=True)
def _closest_weights(points, corners, out):  # type: ignore[no-untyped-def]
    steps = 16777216.0
    for n in numba.prange(len(points)):
        weights = np.empty(3)
        _closest_point(points[n], corners[n, 0], corners[n, 1], corners[n, 2], weights)
        second = min(max(np.rint(weights[1] * steps), 0.0), steps)
        third = min(max(np.rint(weights[2] * steps), 0.0), steps - second)
        out[n, 0] = (steps - second - third) / steps
        out[n, 1] = second / steps
        out[n, 2] = third / steps
