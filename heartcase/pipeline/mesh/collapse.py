"""Kernels of the edge collapse: quadrics, a heap of edges, and the checks that keep the mesh sound.

The mesh is half-edges: ``3 t + c`` runs from corner c of triangle t to its next corner. An entry of the heap is stale
when one of its ends has changed since it was made; ties in cost go to the lower half-edge.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["collapse"]

BORDER_WEIGHT = 2.0
SHAPE_WEIGHT = 1e-4
LEAST_COSINE = 0.4
LEAST_QUALITY = 0.12
SPECK_AREA = 0.01
TWO_ROOT_3 = 2.0 * 3.0**0.5


@numba.njit(inline="always")
def _next(h):  # type: ignore[no-untyped-def]
    return h - 2 if h % 3 == 2 else h + 1


@numba.njit(inline="always")
def _previous(h):  # type: ignore[no-untyped-def]
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
def _quadrics(position, tail, opposite, tags):  # type: ignore[no-untyped-def]
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
                u, v = tail[h], tail[_next(h)]
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
def _best(quadric, position, u, v, out):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True, nogil=True)
def _sift_down(cost, edge, born, size, place):  # type: ignore[no-untyped-def]
    c, h, b = cost[place], edge[place], born[place]
    while True:
        child = 2 * place + 1
        if child >= size:
            break
        right = child + 1
        if right < size and (cost[right] < cost[child] or (cost[right] == cost[child] and edge[right] < edge[child])):
            child = right
        if c < cost[child] or (c == cost[child] and h <= edge[child]):
            break
        cost[place], edge[place], born[place] = cost[child], edge[child], born[child]
        place = child
    cost[place], edge[place], born[place] = c, h, b


@numba.njit(cache=True, nogil=True)
def _sift_up(cost, edge, born, place):  # type: ignore[no-untyped-def]
    c, h, b = cost[place], edge[place], born[place]
    while place > 0:
        parent = (place - 1) // 2
        if cost[parent] < c or (cost[parent] == c and edge[parent] <= h):
            break
        cost[place], edge[place], born[place] = cost[parent], edge[parent], born[parent]
        place = parent
    cost[place], edge[place], born[place] = c, h, b


@numba.njit(cache=True, nogil=True)
def _add_normals(position, tail, opposite, start, normal):  # type: ignore[no-untyped-def]
    """Add the doubled areas of the triangles around the tail of ``start`` to ``normal``; their least quality."""
    least = 1.0
    g = start
    while True:
        v = tail[g]
        b = tail[_next(g)]
        c = tail[_previous(g)]
        ux = position[b, 0] - position[v, 0]
        uy = position[b, 1] - position[v, 1]
        uz = position[b, 2] - position[v, 2]
        wx = position[c, 0] - position[v, 0]
        wy = position[c, 1] - position[v, 1]
        wz = position[c, 2] - position[v, 2]
        nx = uy * wz - uz * wy
        ny = uz * wx - ux * wz
        nz = ux * wy - uy * wx
        normal[0] += nx
        normal[1] += ny
        normal[2] += nz
        sides = 2.0 * (ux * ux + uy * uy + uz * uz + wx * wx + wy * wy + wz * wz - ux * wx - uy * wy - uz * wz)
        least = min(least, TWO_ROOT_3 * np.sqrt(nx * nx + ny * ny + nz * nz) / sides)
        g = _next(opposite[g])
        if g == start:
            return least


@numba.njit(cache=True, nogil=True)
def _keeps_shape(position, tail, opposite, start, gone_a, gone_b, p, around, floor):  # type: ignore[no-untyped-def]
    """Whether moving the tail of ``start`` to ``p`` turns over none of its triangles and makes no needle.

    The normal of a needle or a speck means little: it is held against the mean normal ``around`` instead.
    """
    mean = np.sqrt(around[0] * around[0] + around[1] * around[1] + around[2] * around[2])
    g = start
    while True:
        t = g // 3
        if t not in (gone_a, gone_b):
            v = tail[g]
            b = tail[_next(g)]
            c = tail[_previous(g)]
            ex = position[c, 0] - position[b, 0]
            ey = position[c, 1] - position[b, 1]
            ez = position[c, 2] - position[b, 2]
            ux = position[v, 0] - position[b, 0]
            uy = position[v, 1] - position[b, 1]
            uz = position[v, 2] - position[b, 2]
            wx = p[0] - position[b, 0]
            wy = p[1] - position[b, 1]
            wz = p[2] - position[b, 2]
            ox = ey * uz - ez * uy
            oy = ez * ux - ex * uz
            oz = ex * uy - ey * ux
            nx = ey * wz - ez * wy
            ny = ez * wx - ex * wz
            nz = ex * wy - ey * wx
            old = np.sqrt(ox * ox + oy * oy + oz * oz)
            new = np.sqrt(nx * nx + ny * ny + nz * nz)
            side = ex * ex + ey * ey + ez * ez
            fx = p[0] - position[c, 0]
            fy = p[1] - position[c, 1]
            fz = p[2] - position[c, 2]
            gx = position[v, 0] - position[c, 0]
            gy = position[v, 1] - position[c, 1]
            gz = position[v, 2] - position[c, 2]
            after = side + wx * wx + wy * wy + wz * wz + fx * fx + fy * fy + fz * fz
            before = side + ux * ux + uy * uy + uz * uz + gx * gx + gy * gy + gz * gz
            if nx * around[0] + ny * around[1] + nz * around[2] < 0.0:
                return False
            if TWO_ROOT_3 * old < LEAST_QUALITY * before or old < SPECK_AREA * mean:
                if nx * around[0] + ny * around[1] + nz * around[2] <= LEAST_COSINE * new * mean:
                    return False
            elif ox * nx + oy * ny + oz * nz <= LEAST_COSINE * old * new:
                return False
            if TWO_ROOT_3 * new < floor * after:
                return False
        g = _next(opposite[g])
        if g == start:
            return True


@numba.njit(cache=True, nogil=True)
def _keeps_manifold(tail, opposite, h, mark, epoch):  # type: ignore[no-untyped-def]
    """Link condition: the ends of ``h`` share just the two corners beside it, and those keep three neighbours."""
    g = h
    while True:
        mark[tail[_next(g)]] = epoch
        g = _next(opposite[g])
        if g == h:
            break
    shared = 0
    start = opposite[h]
    g = start
    while True:
        if mark[tail[_next(g)]] == epoch:
            shared += 1
        g = _next(opposite[g])
        if g == start:
            break
    if shared != 2:
        return False
    for corner in (_previous(h), _previous(start)):
        count = 0
        g = corner
        while True:
            count += 1
            g = _next(opposite[g])
            if g == corner:
                break
        if count <= 3:
            return False
    return True


@numba.njit(cache=True, nogil=True)
def collapse(position, tail, opposite, tags, wanted):  # type: ignore[no-untyped-def]
    """Collapse edges in place until ``wanted`` triangles are left or none may go; which triangles are left.

    Parameters
    ----------
    position
        Vertices, float64, shape (vertex_count, 3), near the origin.
    tail
        Vertex at which each half-edge starts, int32, shape (3 * triangle_count,).
    opposite
        Opposite half-edges, int32, same shape.
    tags
        Tag of each triangle, int64, shape (triangle_count,).
    wanted
        Triangles to leave.
    """
    quadric = _quadrics(position, tail, opposite, tags)
    triangle_count = len(tail) // 3
    alive = np.ones(triangle_count, np.bool_)
    changed = np.zeros(len(position), np.int32)
    mark = np.full(len(position), -1, np.int32)
    capacity = 3 * len(tail) + 64
    cost = np.empty(capacity)
    edge = np.empty(capacity, np.int32)
    born = np.empty(capacity, np.int32)
    p = np.empty(3)
    around = np.empty(5)
    size = 0
    left = triangle_count
    clock = 0
    left_at_fill = left + 1
    while left > wanted:
        if size == 0:
            if left == left_at_fill:
                break
            left_at_fill = left
            for h in range(len(tail)):
                if alive[h // 3] and h < opposite[h]:
                    cost[size] = _best(quadric, position, tail[h], tail[_next(h)], p)
                    edge[size] = h
                    born[size] = clock
                    size += 1
            for place in range(size // 2 - 1, -1, -1):
                _sift_down(cost, edge, born, size, place)
        h = edge[0]
        birth = born[0]
        size -= 1
        cost[0], edge[0], born[0] = cost[size], edge[size], born[size]
        if size > 0:
            _sift_down(cost, edge, born, size, 0)
        if not alive[h // 3]:
            continue
        u = tail[h]
        v = tail[_next(h)]
        if changed[u] > birth or changed[v] > birth:
            continue
        o = opposite[h]
        _best(quadric, position, u, v, p)
        around[:] = 0.0
        around[3] = _add_normals(position, tail, opposite, h, around)
        around[4] = _add_normals(position, tail, opposite, o, around)
        floor = min(LEAST_QUALITY, around[3], around[4])
        if not _keeps_shape(position, tail, opposite, h, h // 3, o // 3, p, around, floor):
            continue
        if not _keeps_shape(position, tail, opposite, o, h // 3, o // 3, p, around, floor):
            continue
        if not _keeps_manifold(tail, opposite, h, mark, clock):
            clock += 1
            continue
        clock += 1
        near = opposite[_next(h)]
        near_back = opposite[_previous(h)]
        far = opposite[_next(o)]
        far_back = opposite[_previous(o)]
        g = o
        while True:
            tail[g] = u
            g = _next(opposite[g])
            if g == o:
                break
        opposite[near] = near_back
        opposite[near_back] = near
        opposite[far] = far_back
        opposite[far_back] = far
        alive[h // 3] = False
        alive[o // 3] = False
        left -= 2
        for k in range(10):
            quadric[u, k] += quadric[v, k]
        position[u] = p
        changed[u] = clock
        if size + 64 > capacity:
            kept = 0
            for place in range(size):
                e = edge[place]
                if alive[e // 3] and changed[tail[e]] <= born[place] and changed[tail[_next(e)]] <= born[place]:
                    cost[kept], edge[kept], born[kept] = cost[place], edge[place], born[place]
                    kept += 1
            size = kept
            for place in range(size // 2 - 1, -1, -1):
                _sift_down(cost, edge, born, size, place)
        g = near_back
        while True:
            if size < capacity:
                cost[size] = _best(quadric, position, u, tail[_next(g)], p)
                edge[size] = g
                born[size] = clock
                size += 1
                _sift_up(cost, edge, born, size - 1)
            g = _next(opposite[g])
            if g == near_back:
                break
    return alive
