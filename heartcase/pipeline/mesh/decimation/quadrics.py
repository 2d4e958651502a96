"""Quadric error of a joined edge: how far the planes around its ends are from one point.

Garland and Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997, with area weights. A quadric
is ten numbers: the upper triangle of the 3 x 3 matrix by rows, the linear part, the constant. The mesh is half-edges:
``3 t + c`` runs from corner c of triangle t to its next corner.
"""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Bool, Float64, Int32, Int64

__all__ = ["best_place", "edge_costs", "next_edge", "previous_edge", "vertex_quadrics", "vertices_between"]

BORDER_WEIGHT = 2.0
"""Of the planes that keep a border between tags in place, beside the triangles' own."""
SHAPE_WEIGHT = 1e-4
"""Of the distance to the vertex itself, which decides where all around is flat."""


@kernel(cached=False, inline="always")
def next_edge(h):
    """The half-edge that follows in the same triangle."""
    return h - 2 if h % 3 == 2 else h + 1


@kernel(cached=False, inline="always")
def previous_edge(h):
    """The half-edge before in the same triangle."""
    return h + 2 if h % 3 == 0 else h - 1


@kernel
def _add_plane(quadric, nx, ny, nz, d, weight):
    quadric[0] += weight * nx * nx
    quadric[1] += weight * nx * ny
    quadric[2] += weight * nx * nz
    quadric[3] += weight * ny * ny
    quadric[4] += weight * ny * nz
    quadric[5] += weight * nz * nz
    quadric[6] += weight * nx * d
    quadric[7] += weight * ny * d
    quadric[8] += weight * nz * d
    quadric[9] += weight * d * d


def vertices_between(tail: Int32, opposite: Int32, alive: Bool, parts: Int64, widely: bool) -> Bool:
    """Vertices with triangles in two parts of a mesh; ``widely``: and all their neighbours.

    Collapses of edges between the other vertices, in different parts, read and write nothing of each other: the
    triangles around both ends, and those beyond them, lie in one part. ``parts`` are the bounds of the parts, among the
    triangles.
    """
    found = np.zeros(tail.max() + 1, np.bool_)
    if len(parts) == 2:
        return found
    _note_between(tail, opposite, alive, parts, found)
    if not widely:
        return found
    wide = found.copy()
    _note_beside(tail, alive, parts, found, wide)
    return wide


@loop_kernel
def _note_between(tail, opposite, alive, parts, found):
    """Note vertices with triangles in two parts; whichever thread comes first, what is written is true."""
    for part in numba.prange(len(parts) - 1):
        for h in range(3 * parts[part], 3 * parts[part + 1]):
            if alive[h // 3] and not parts[part] <= opposite[h] // 3 < parts[part + 1]:
                found[tail[h]] = True
                found[tail[next_edge(h)]] = True


@loop_kernel
def _note_beside(tail, alive, parts, found, wide):
    """Note the neighbours of some vertices."""
    for part in numba.prange(len(parts) - 1):
        for h in range(3 * parts[part], 3 * parts[part + 1]):
            if alive[h // 3] and found[tail[h]]:
                wide[tail[next_edge(h)]] = True


@called
def _add_triangle(t, position, tail, opposite, tags, between, wanted, quadric):
    """Add a triangle's planes to those of its vertices whose ``between`` is as wanted."""
    a, b, c = tail[3 * t], tail[3 * t + 1], tail[3 * t + 2]
    if between[a] != wanted and between[b] != wanted and between[c] != wanted:
        return
    ux, uy, uz = position[b, 0] - position[a, 0], position[b, 1] - position[a, 1], position[b, 2] - position[a, 2]
    vx, vy, vz = position[c, 0] - position[a, 0], position[c, 1] - position[a, 1], position[c, 2] - position[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    doubled = np.sqrt(nx * nx + ny * ny + nz * nz)
    if doubled <= 0.0:
        return
    nx, ny, nz = nx / doubled, ny / doubled, nz / doubled
    d = -(nx * position[a, 0] + ny * position[a, 1] + nz * position[a, 2])
    weight = doubled / 6.0
    s = SHAPE_WEIGHT * weight
    for corner in range(3):
        h = 3 * t + corner
        v = tail[h]
        if between[v] == wanted:
            x, y, z = position[v, 0], position[v, 1], position[v, 2]
            q = quadric[v]
            _add_plane(q, nx, ny, nz, d, weight)
            q[0] += s
            q[3] += s
            q[5] += s
            q[6] -= s * x
            q[7] -= s * y
            q[8] -= s * z
            q[9] += s * (x * x + y * y + z * z)
        if tags[opposite[h] // 3] == tags[t]:
            continue
        w = tail[next_edge(h)]
        ex, ey, ez = position[w, 0] - position[v, 0], position[w, 1] - position[v, 1], position[w, 2] - position[v, 2]
        mx, my, mz = ey * nz - ez * ny, ez * nx - ex * nz, ex * ny - ey * nx
        length = np.sqrt(mx * mx + my * my + mz * mz)
        if length > 0.0:
            mx, my, mz = mx / length, my / length, mz / length
            d_edge = -(mx * position[v, 0] + my * position[v, 1] + mz * position[v, 2])
            for end in (v, w):
                if between[end] == wanted:
                    _add_plane(quadric[end], mx, my, mz, d_edge, BORDER_WEIGHT * length * length / 6.0)


def vertex_quadrics(
    position: Float64, tail: Int32, opposite: Int32, tags: Int64, between: Bool, parts: Int64
) -> Float64:
    """Quadric of each vertex: of its triangles' planes, and of planes through the borders between tags.

    ``parts`` are bounds among the triangles: of parts that are worked on at the same time. ``between`` are the vertices
    with triangles in two of them.
    """
    quadric = np.zeros((len(position), 10))
    _add_inside(position, tail, opposite, tags, between, parts, quadric)
    _add_between(position, tail, opposite, tags, between, quadric)
    return quadric


@loop_kernel
def _add_inside(position, tail, opposite, tags, between, parts, quadric):
    """Add the planes of all vertices that lie in one part alone."""
    for part in numba.prange(len(parts) - 1):
        for t in range(parts[part], parts[part + 1]):
            _add_triangle(t, position, tail, opposite, tags, between, False, quadric)


@kernel
def _add_between(position, tail, opposite, tags, between, quadric):
    """Add the planes of all others, in the order of the triangles."""
    for t in range(len(tail) // 3):
        _add_triangle(t, position, tail, opposite, tags, between, True, quadric)


@copied
def best_place(quadric, position, u, v, out):
    """Cost of joining u and v; the best place goes to ``out``."""
    a = quadric[u, 0] + quadric[v, 0]
    b = quadric[u, 1] + quadric[v, 1]
    c = quadric[u, 2] + quadric[v, 2]
    d = quadric[u, 3] + quadric[v, 3]
    e = quadric[u, 4] + quadric[v, 4]
    f = quadric[u, 5] + quadric[v, 5]
    g = quadric[u, 6] + quadric[v, 6]
    h = quadric[u, 7] + quadric[v, 7]
    i = quadric[u, 8] + quadric[v, 8]
    k = quadric[u, 9] + quadric[v, 9]
    mx = 0.5 * (position[u, 0] + position[v, 0])
    my = 0.5 * (position[u, 1] + position[v, 1])
    mz = 0.5 * (position[u, 2] + position[v, 2])
    pull = 1e-3 * (a + d + f) / 3.0
    aa = a + pull
    dd = d + pull
    ff = f + pull
    rx = pull * mx - g
    ry = pull * my - h
    rz = pull * mz - i
    c00 = dd * ff - e * e
    c01 = c * e - b * ff
    c02 = b * e - c * dd
    determinant = aa * c00 + b * c01 + c * c02
    if determinant > 0.0:
        c11 = aa * ff - c * c
        c12 = b * c - aa * e
        c22 = aa * dd - b * b
        mx = (c00 * rx + c01 * ry + c02 * rz) / determinant
        my = (c01 * rx + c11 * ry + c12 * rz) / determinant
        mz = (c02 * rx + c12 * ry + c22 * rz) / determinant
    out[0] = mx
    out[1] = my
    out[2] = mz
    cost = (
        a * mx * mx + d * my * my + f * mz * mz + k
        + 2.0 * (b * mx * my + c * mx * mz + e * my * mz + g * mx + h * my + i * mz)
    )  # fmt: skip
    return max(cost, 0.0)


@loop_kernel
def edge_costs(position, tail, opposite, quadric, alive, cost):
    """Cost of joining each edge, at the lower of its half-edges; infinite at the other, and where it is gone."""
    for t in numba.prange(len(tail) // 3):
        place = np.empty(3)
        for h in range(3 * t, 3 * t + 3):
            cost[h] = np.float32(np.inf)
            if alive[t] and h < opposite[h]:
                cost[h] = best_place(quadric, position, tail[h], tail[next_edge(h)], place)
