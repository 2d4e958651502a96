"""The edge collapse: the checks that keep the mesh sound, and the sweeps that take most of the edges.

The mesh is half-edges: ``3 t + c`` runs from corner c of triangle t to its next corner. As long as there are many more
triangles than wanted, the cheapest part of all edges is collapsed in the order of the mesh, so that memory is read
along. Parts of the mesh are swept at the same time; what lies between two of them waits for the next sweep, which cuts
the mesh elsewhere. Then a heap takes one edge after the other (:mod:`heartcase.pipeline.mesh.decimation.edge_heap`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from heartcase.compiling.calls import called
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.mesh.decimation.quadrics import (
    best_place,
    edge_costs,
    next_edge,
    previous_edge,
    vertex_quadrics,
    vertices_between,
)
from heartcase.pipeline.mesh.triangles.half_edges import opposites_of_some
from heartcase.schemas.arrays import Bool, Float64, Int32, Int64

__all__ = ["Collapsing", "Joined", "join_ends", "joined", "may_join", "swept"]

LEAST_COSINE = 0.4
LEAST_QUALITY = 0.12
GUARD_COSINE = -0.1
"""Cosine between the normals of two triangles at an edge below which they are a fold."""
SPECK_AREA = 0.01
TWO_ROOT_3 = 2.0 * 3.0**0.5

HEAP_FACTOR = 2.0
"""Times the wanted triangles, from which on edges go one by one."""
SWEEP_SHARE = 0.4
"""Part of the edges, the cheapest, that one sweep may collapse."""
SWEEP_SAMPLE = 7
"""Every so manieth half-edge tells what the cheapest part costs."""
SWEEP_LEAST = 0.01
"""Part of the triangles that a sweep must take away, or it was the last."""
PART_TRIANGLES = 60_000
"""Least size of the parts of the mesh that are swept at the same time."""
MOST_PARTS = 16


@kernel
def _add_normals(position, tail, opposite, start, normal):
    """Add the doubled areas of the triangles around the tail of ``start`` to ``normal``; their least quality."""
    least = 1.0
    g = start
    while True:
        v = tail[g]
        b = tail[next_edge(g)]
        c = tail[previous_edge(g)]
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
        g = next_edge(opposite[g])
        if g == start:
            return least


@kernel
def _keeps_shape(position, tail, opposite, start, gone_a, gone_b, p, around, floor):
    """Whether moving the tail of ``start`` to ``p`` turns over none of its triangles and makes no needle and no fold.

    The normal of a needle or a speck means little: it is held against the mean normal ``around`` instead.
    """
    mean = np.sqrt(around[0] * around[0] + around[1] * around[1] + around[2] * around[2])
    lx, ly, lz, last = 0.0, 0.0, 0.0, 0.0
    is_after = False
    g = start
    while True:
        t = g // 3
        if t not in (gone_a, gone_b):
            v = tail[g]
            b = tail[next_edge(g)]
            c = tail[previous_edge(g)]
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
            # the triangle beyond the edge that stays
            q = opposite[next_edge(g)]
            d = tail[previous_edge(q)]
            hx = position[d, 0] - position[b, 0]
            hy = position[d, 1] - position[b, 1]
            hz = position[d, 2] - position[b, 2]
            mx = hy * ez - hz * ey
            my = hz * ex - hx * ez
            mz = hx * ey - hy * ex
            beyond = np.sqrt(mx * mx + my * my + mz * mz)
            now = nx * mx + ny * my + nz * mz
            if now < GUARD_COSINE * new * beyond and now * old < (ox * mx + oy * my + oz * mz) * new:
                return False
            if is_after and (nx * lx + ny * ly + nz * lz) < GUARD_COSINE * new * last:
                return False
            lx, ly, lz, last = nx, ny, nz, new
            is_after = True
        else:
            is_after = False
        g = next_edge(opposite[g])
        if g == start:
            return True


@kernel
def _keeps_manifold(tail, opposite, h, mark, epoch):
    """Link condition: the ends of ``h`` share just the two corners beside it, and those keep three neighbours."""
    g = h
    while True:
        mark[tail[next_edge(g)]] = epoch
        g = next_edge(opposite[g])
        if g == h:
            break
    shared = 0
    start = opposite[h]
    g = start
    while True:
        if mark[tail[next_edge(g)]] == epoch:
            shared += 1
        g = next_edge(opposite[g])
        if g == start:
            break
    if shared != 2:
        return False
    for corner in (previous_edge(h), previous_edge(start)):
        count = 0
        g = corner
        while True:
            count += 1
            g = next_edge(opposite[g])
            if g == corner:
                break
        if count <= 3:
            return False
    return True


@called
def may_join(position, tail, opposite, h, p, around, mark, epoch):
    """Whether an edge may be collapsed to ``p``; ``around`` and ``mark`` are work space."""
    o = np.int64(opposite[h])
    around[:] = 0.0
    around[3] = _add_normals(position, tail, opposite, h, around)
    around[4] = _add_normals(position, tail, opposite, o, around)
    floor = min(LEAST_QUALITY, around[3], around[4])
    return (
        _keeps_shape(position, tail, opposite, h, h // 3, o // 3, p, around, floor)
        and _keeps_shape(position, tail, opposite, o, h // 3, o // 3, p, around, floor)
        and _keeps_manifold(tail, opposite, h, mark, epoch)
    )


@kernel
def join_ends(position, tail, opposite, quadric, alive, h, p):
    """Collapse an edge into its tail, which goes to ``p``; a half-edge that leaves it."""
    o = opposite[h]
    u = tail[h]
    v = tail[next_edge(h)]
    near = opposite[next_edge(h)]
    near_back = opposite[previous_edge(h)]
    far = opposite[next_edge(o)]
    far_back = opposite[previous_edge(o)]
    g = o
    while True:
        tail[g] = u
        g = next_edge(opposite[g])
        if g == o:
            break
    opposite[near] = near_back
    opposite[near_back] = near
    opposite[far] = far_back
    opposite[far_back] = far
    alive[h // 3] = False
    alive[o // 3] = False
    for k in range(10):
        quadric[u, k] += quadric[v, k]
    position[u] = p
    return near_back


@called
def _sweep_part(position, tail, opposite, quadric, alive, cost, limit, mark, moved, still, begin, end, most):
    """Collapse edges of the triangles from ``begin`` to ``end`` in their order; returns how many triangles go."""
    p = np.empty(3)
    around = np.empty(5)
    gone = 0
    for h in range(3 * begin, 3 * end):
        if cost[h] > limit or not alive[h // 3]:
            continue
        if gone + 2 > most:
            break
        u, v = tail[h], tail[next_edge(h)]
        if moved[u] or moved[v] or still[u] or still[v]:
            continue
        best_place(quadric, position, u, v, p)
        if may_join(position, tail, opposite, h, p, around, mark, h):
            join_ends(position, tail, opposite, quadric, alive, h, p)
            moved[u] = True
            gone += 2
    return gone


@loop_kernel
def _sweep(position, tail, opposite, quadric, alive, cost, limit, mark, moved, still, parts, most, gone):
    """Collapse edges of at most the cost ``limit``, but none beside a vertex that has moved already.

    ``still`` are vertices that stay, ``parts`` the bounds of the parts of the mesh, ``most`` how many triangles each
    may lose, and ``gone`` how many do; ``mark`` is work space that holds -1.
    """
    for part in numba.prange(len(most)):
        gone[part] = _sweep_part(
            position, tail, opposite, quadric, alive, cost, limit, mark, moved, still,
            parts[part], parts[part + 1], most[part],
        )  # fmt: skip


@dataclass(frozen=True)
class Collapsing:
    """A mesh while its edges are collapsed."""

    position: Float64
    """Vertices, shape (vertex_count, 3), near the origin; those that are gone stay as they were."""
    tail: Int32
    """Vertex at which each half-edge starts, shape (3 * triangle_count,)."""
    opposite: Int32
    """Opposite half-edges, same shape."""
    quadric: Float64
    """Of each vertex, shape (vertex_count, 10)."""
    alive: Bool
    """Triangles that are left, shape (triangle_count,)."""
    source: Int32
    """Number of each triangle in the mesh that it was, same shape."""
    vertex_source: Int32
    """Number of each vertex in the mesh that it was, shape (vertex_count,)."""


def swept(
    position: Float64,
    tail: Int32,
    opposite: Int32,
    tags: Int64,
    wanted: int,
    care: Float64 | None = None,
) -> Collapsing:
    """Collapse cheap edges, sweep by sweep, until about twice the wanted triangles are left.

    Parameters
    ----------
    position, tail, opposite
        As in :class:`Collapsing`; changed in place.
    tags
        Tag of each triangle, shape (triangle_count,).
    wanted
        Triangles that are wanted in the end.
    care
        Factor on the error of each vertex, shape (vertex_count,).

    Returns
    -------
    Collapsing
        What is left, without gaps.
    """
    alive = np.ones(len(tail) // 3, np.bool_)
    parts = _parts_of(alive, turn=0)[0]
    quadric = vertex_quadrics(
        position, tail, opposite, tags, vertices_between(tail, opposite, alive, parts, False), parts
    )
    if care is not None:
        quadric *= care[:, None]
    left, before = len(alive), 2 * len(alive)
    until = max(int(HEAP_FACTOR * wanted), wanted)
    cost = np.empty(len(tail), np.float32)
    turn = 0
    while left > until and before - left > SWEEP_LEAST * before:
        edge_costs(position, tail, opposite, quadric, alive, cost)
        sample = cost[::SWEEP_SAMPLE]
        sample = sample[np.isfinite(sample)]
        cheap = int(SWEEP_SHARE * (len(sample) - 1))
        before = left
        limit = np.partition(sample, cheap)[cheap]
        parts, size = _parts_of(alive, turn=turn)
        most = np.diff(np.cumsum(size, dtype=np.int64) * (left - until) // left, prepend=0)
        still = vertices_between(tail, opposite, alive, parts, True)
        mark, moved = np.full(len(position), -1, np.int32), np.zeros(len(position), np.bool_)
        gone = np.empty_like(most)
        _sweep(position, tail, opposite, quadric, alive, cost, limit, mark, moved, still, parts, most, gone)
        left -= int(gone.sum())
        turn += 1
    return _packed(position, tail, opposite, quadric, alive)


def _packed(
    position: Float64,
    tail: Int32,
    opposite: Int32,
    quadric: Float64,
    alive: Bool,
) -> Collapsing:
    """What is left, in the same order: a tenth of the memory, for a heap that jumps about in it."""
    source = np.flatnonzero(alive)
    left = tail.reshape(-1, 3)[source]
    used = np.zeros(len(position), np.bool_)
    used[left] = True
    vertex = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return Collapsing(
        position[used],
        vertex[left].ravel(),
        opposites_of_some(opposite, alive),
        quadric[used],
        np.ones(len(source), np.bool_),
        source.astype(np.int32),
        np.flatnonzero(used).astype(np.int32),
    )


def _parts_of(alive: Bool, *, turn: int) -> tuple[Int64, Int64]:
    """Bounds of parts with about as many triangles that are left each, and how many; every other turn half a part on.

    The number of parts depends on the mesh alone, so that the result does not depend on the number of threads.
    """
    there = np.flatnonzero(alive)
    count = min(max(len(there) // PART_TRIANGLES, 1), MOST_PARTS)
    share = (np.arange(1, count + turn % 2) - 0.5 * (turn % 2)) / count if count > 1 else np.zeros(0)
    place = np.concatenate([[0], (share * len(there)).astype(np.int64), [len(there)]])
    return np.concatenate([[0], there[place[1:-1]], [len(alive)]]), np.diff(place)


class Joined(NamedTuple):
    """A mesh after a collapse."""

    vertices: Float64
    """Shape (vertex_count, 3), one less."""
    triangles: Int32
    """Shape (triangle_count, 3), two less, in their order."""
    kept: Bool
    """Which triangles of the mesh before are left."""
    moved: Bool
    """Which triangles have the vertex at which the edge's ends met, shape (triangle_count,)."""


def joined(
    vertices: Float64,
    triangles: Int32,
    opposite: Int32,
    half_edge: int,
    share: float,
) -> Joined | None:
    """A mesh with one edge collapsed to the point at a share of its length; None where that would not be manifold."""
    tail, opposite = triangles.astype(np.int32).ravel(), opposite.copy()
    if not _keeps_manifold(tail, opposite, half_edge, np.full(len(vertices), -1, np.int32), 0):
        return None
    alive = np.ones(len(triangles), np.bool_)
    u, v = triangles.ravel()[half_edge], triangles[half_edge // 3, (half_edge % 3 + 1) % 3]
    place = (1.0 - share) * vertices[u] + share * vertices[v]
    position = vertices.copy()
    join_ends(position, tail, opposite, np.zeros((len(vertices), 10)), alive, half_edge, place)
    left = tail.reshape(-1, 3)[alive]
    return Joined(np.delete(position, v, axis=0), left - (left > v).astype(np.int32), alive, (left == u).any(axis=1))
