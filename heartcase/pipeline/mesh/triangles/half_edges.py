"""A closed triangle mesh as half-edges: ``3 t + c`` runs from corner c of triangle t to its next corner."""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Bool, Int32

__all__ = ["connected_parts", "opposites", "opposites_of_some"]


def opposites(triangles: Int32) -> Int32:
    """Opposite half-edge of each half-edge of a closed manifold mesh.

    Half-edge ``3 t + c`` goes from corner c of triangle t to its next corner.

    Returns
    -------
    Int32
        Shape (3 * triangle_count,).

    Raises
    ------
    ValueError
        An edge has not exactly one half-edge in each direction.
    """
    tail = np.ascontiguousarray(triangles, np.int32).ravel()
    opposite = np.empty(len(tail), np.int32)
    start, leaving = _leaving_half_edges(tail, int(triangles.max(initial=-1)) + 1)
    _pair_half_edges(tail, start, leaving, opposite)
    if opposite.min(initial=0) < 0:
        raise ValueError("the mesh is not closed and manifold")
    return opposite


def opposites_of_some(opposite: Int32, kept: Bool) -> Int32:
    """Opposite half-edges where only some triangles are kept, numbered anew in the same order.

    Parameters
    ----------
    opposite
        Opposite half-edges of all triangles.
    kept
        Triangles that are kept, shape (triangle_count,); no edge joins one of them to another.
    """
    number = np.cumsum(kept, dtype=np.int32) - np.int32(1)
    beside = opposite.reshape(-1, 3)[kept]
    three = np.int32(3)
    renumbered: Int32 = three * number[beside // three] + beside % three
    return renumbered.ravel()


@kernel
def _leaving_half_edges(tail, vertex_count):
    """Half-edges that leave each vertex: ``leaving[start[v]:start[v + 1]]`` for vertex ``v``."""
    start = np.zeros(vertex_count + 1, np.int32)
    for h in range(len(tail)):
        start[tail[h] + 1] += 1
    for v in range(vertex_count):
        start[v + 1] += start[v]
    leaving = np.empty(len(tail), np.int32)
    place = start[:-1].copy()
    for h in range(len(tail)):
        leaving[place[tail[h]]] = h
        place[tail[h]] += 1
    return start, leaving


@loop_kernel
def _pair_half_edges(tail, start, leaving, opposite):
    """Pair each half-edge with the one that runs the other way; -1 where it has not exactly one."""
    for h in numba.prange(len(tail)):
        u = tail[h]
        v = tail[h - 2 if h % 3 == 2 else h + 1]
        found = -1
        count = 0
        for at in range(start[v], start[v + 1]):
            o = leaving[at]
            if tail[o - 2 if o % 3 == 2 else o + 1] == u:
                found = o
                count += 1
        opposite[h] = found if count == 1 and u != v else -1


@kernel
def connected_parts(key, opposite):
    """Number of the connected part of equal keys that each triangle is in, and how many triangles each part has.

    Parts are numbered by their first triangle; triangles are connected over edges. ``key`` is int64, shape
    (triangle_count,).
    """
    part = np.full(len(key), -1, np.int32)
    sizes = np.empty(len(key), np.int64)
    queue = np.empty(len(key), np.int32)
    count = 0
    for seed in range(len(key)):
        if part[seed] >= 0:
            continue
        part[seed] = count
        queue[0] = seed
        first, last = 0, 1
        while first < last:
            t = queue[first]
            first += 1
            for k in range(3):
                o = opposite[3 * t + k] // 3
                if part[o] < 0 and key[o] == key[t]:
                    part[o] = count
                    queue[last] = o
                    last += 1
        sizes[count] = last
        count += 1
    return part, sizes[:count]
