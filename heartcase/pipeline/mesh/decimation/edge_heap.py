"""The end of the edge collapse: a heap takes the cheapest edge, one after the other.

An entry of the heap is stale when one of its ends has changed since it was made; ties in cost go to the lower
half-edge.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.mesh.decimation.collapse import Collapsing, join_ends, may_join
from heartcase.pipeline.mesh.decimation.quadrics import best_place, next_edge
from heartcase.schemas.arrays import Float64

__all__ = ["finished"]


def finished(mesh: Collapsing, wanted: int, care: Float64 | None = None) -> Collapsing:
    """Collapse the cheapest edge again and again, until ``wanted`` triangles are left or none may go.

    The mesh is not changed, so another count, or more care at some vertices (numbered as they were before the sweeps),
    can be tried from it again.
    """
    one = Collapsing(*(array.copy() for array in vars(mesh).values()))
    if care is not None:
        one.quadric[:] *= care[one.vertex_source, None]
    mark = np.empty(len(one.position), np.int32)
    left = int(one.alive.sum())
    _collapse_by_heap(one.position, one.tail, one.opposite, one.quadric, one.alive, mark, left, wanted)
    return one


@copied
def _sift_down(cost, edge, born, size, place):
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


@copied
def _sift_up(cost, edge, born, place):
    c, h, b = cost[place], edge[place], born[place]
    while place > 0:
        parent = (place - 1) // 2
        if cost[parent] < c or (cost[parent] == c and edge[parent] <= h):
            break
        cost[place], edge[place], born[place] = cost[parent], edge[parent], born[parent]
        place = parent
    cost[place], edge[place], born[place] = c, h, b


@kernel
def _collapse_by_heap(position, tail, opposite, quadric, alive, mark, left, wanted):
    """Collapse the cheapest edge, again and again."""
    changed = np.zeros(len(position), np.int32)
    mark[:] = -1
    # an edge for every two half-edges that are left, and room for those that collapses add
    capacity = 4 * left + 64
    cost = np.empty(capacity)
    edge = np.empty(capacity, np.int32)
    born = np.empty(capacity, np.int32)
    p = np.empty(3)
    around = np.empty(5)
    size = 0
    clock = 0
    left_at_fill = left + 1
    while left > wanted:
        if size == 0:
            if left == left_at_fill:
                break
            left_at_fill = left
            for half_edge in range(len(tail)):
                if alive[half_edge // 3] and half_edge < opposite[half_edge]:
                    cost[size] = best_place(quadric, position, tail[half_edge], tail[next_edge(half_edge)], p)
                    edge[size] = half_edge
                    born[size] = clock
                    size += 1
            for place in range(size // 2 - 1, -1, -1):
                _sift_down(cost, edge, born, size, place)
        h = np.int64(edge[0])
        birth = born[0]
        size -= 1
        cost[0], edge[0], born[0] = cost[size], edge[size], born[size]
        if size > 0:
            _sift_down(cost, edge, born, size, np.int64(0))
        if not alive[h // 3]:
            continue
        u = tail[h]
        v = tail[next_edge(h)]
        if changed[u] > birth or changed[v] > birth:
            continue
        best_place(quadric, position, u, v, p)
        is_sound = may_join(position, tail, opposite, h, p, around, mark, clock)
        clock += 1
        if not is_sound:
            continue
        near_back = join_ends(position, tail, opposite, quadric, alive, h, p)
        left -= 2
        changed[u] = clock
        if size + 64 > capacity:
            kept = 0
            for place in range(size):
                e = edge[place]
                if alive[e // 3] and changed[tail[e]] <= born[place] and changed[tail[next_edge(e)]] <= born[place]:
                    cost[kept], edge[kept], born[kept] = cost[place], edge[place], born[place]
                    kept += 1
            size = kept
            for place in range(size // 2 - 1, -1, -1):
                _sift_down(cost, edge, born, size, place)
        g = near_back
        while True:
            if size < capacity:
                cost[size] = best_place(quadric, position, u, tail[next_edge(g)], p)
                edge[size] = g
                born[size] = clock
                size += 1
                _sift_up(cost, edge, born, size - 1)
            g = next_edge(opposite[g])
            if g == near_back:
                break
