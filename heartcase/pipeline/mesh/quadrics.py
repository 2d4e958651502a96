"""Quadric error of a joined edge: how far the planes around its ends are from one point.

Garland and Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997, with area weights. A quadric
is ten numbers: the upper triangle of the 3 x 3 matrix by rows, the linear part, the constant. The mesh is half-edges:
``3 t + c`` runs from corner c of triangle t to its next corner.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["best_place", "edge_costs", "next_edge", "previous_edge", "vertex_quadrics"]

BORDER_WEIGHT = 2.0
"""Of the planes that keep a border between tags in place, beside the triangles' own."""
SHAPE_WEIGHT = 1e-4
"""Of the distance to the vertex itself, which decides where all around is flat."""


@numba.njit(inline="always")
def next_edge(h):  # type: ignore[no-untyped-def]
    """The half-edge that follows in the same triangle."""
    return h - 2 if h % 3 == 2 else h + 1


@numba.njit(inline="always")
def previous_edge(h):  # type: ignore[no-untyped-def]
    """The half-edge before in the same triangle."""
    return h + 2 if h % 3 == 0 else h - 1


@numba.njit(cache=True, nogil=True)
def _add_plane(quadric, nx, ny, nz, d, weight):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True, nogil=True)
def vertex_quadrics(position, tail, opposite, tags):  # type: ignore[no-untyped-def]
    """Quadric of each vertex: of its triangles' planes, and of planes through the borders between tags."""
    quadric = np.zeros((len(position), 10))
    for t in range(len(tail) // 3):
        a, b, c = tail[3 * t], tail[3 * t + 1], tail[3 * t + 2]
        n = np.cross(position[b] - position[a], position[c] - position[a])
        doubled = np.sqrt((n * n).sum())
        if doubled <= 0.0:
            continue
        n /= doubled
        d = -(n * position[a]).sum()
        weight = doubled / 6.0
        for v in (a, b, c):
            _add_plane(quadric[v], n[0], n[1], n[2], d, weight)
            x, y, z = position[v]
            s = SHAPE_WEIGHT * weight
            q = quadric[v]
            q[0] += s
            q[3] += s
            q[5] += s
            q[6] -= s * x
            q[7] -= s * y
            q[8] -= s * z
            q[9] += s * (x * x + y * y + z * z)
        for corner in range(3):
            h = 3 * t + corner
            if tags[opposite[h] // 3] != tags[t]:
                u, v = tail[h], tail[next_edge(h)]
                edge = position[v] - position[u]
                m = np.cross(edge, n)
                length = np.sqrt((m * m).sum())
                if length > 0.0:
                    m /= length
                    d_edge = -(m * position[u]).sum()
                    _add_plane(quadric[u], m[0], m[1], m[2], d_edge, BORDER_WEIGHT * length * length / 6.0)
                    _add_plane(quadric[v], m[0], m[1], m[2], d_edge, BORDER_WEIGHT * length * length / 6.0)
    return quadric


@numba.njit(cache=True, nogil=True)
def best_place(quadric, position, u, v, out):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True, nogil=True, parallel=True)
def edge_costs(position, tail, opposite, quadric, alive, cost):  # type: ignore[no-untyped-def]
    """Cost of joining each edge, at the lower of its half-edges; infinite at the other, and where it is gone."""
    for t in numba.prange(len(tail) // 3):
        place = np.empty(3)
        for h in range(3 * t, 3 * t + 3):
            cost[h] = np.float32(np.inf)
            if alive[t] and h < opposite[h]:
                cost[h] = best_place(quadric, position, tail[h], tail[next_edge(h)], place)
