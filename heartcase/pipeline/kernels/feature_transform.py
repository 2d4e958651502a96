"""The nearest marked node of every node of a lattice, or its distance, exactly.

Felzenszwalb and Huttenlocher, Distance transforms of sampled functions, Theory of Computing 8, 2012: axis by axis, the
lower envelope of parabolas. It is serial, so the result depends on nothing but the input, and several can be worked
out at the same time.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel

__all__ = ["distance_to_marked", "nearest_seeds"]


@copied
def _lower_envelope(cost, count, width, last, bound):
    """Lower envelope of the parabolas of a line, ``cost`` plus the squared way along it; none where that is infinite.

    ``last`` receives the places of the parabolas that are lowest somewhere, ``bound`` where each of them begins to be,
    and an infinite bound after them. Returns how many there are.
    """
    square = width * width
    top = -1
    for q in range(count):
        if cost[q] == np.inf:
            continue
        start = -np.inf
        while top >= 0:
            p = last[top]
            start = ((cost[q] + square * q * q) - (cost[p] + square * p * p)) / (2.0 * square * (q - p))
            if start > bound[top]:
                break
            top -= 1
        if top < 0:
            start = -np.inf
        top += 1
        last[top] = q
        bound[top] = start
    bound[top + 1] = np.inf
    return top + 1


@copied
def _nearest_entries(cost, here, count, width, last, bound, out):
    """For each place of a line the entry of ``here`` with the lowest parabola, -1 where there is none."""
    if _lower_envelope(cost, count, width, last, bound) == 0:
        out[:count] = -1
        return
    n = 0
    for q in range(count):
        while bound[n + 1] < q:
            n += 1
        out[q] = here[last[n]]


@copied
def _lowest_values(cost, count, width, last, bound, out):
    """For each place of a line the value of the lowest parabola, infinite where there is none."""
    if _lower_envelope(cost, count, width, last, bound) == 0:
        out[:count] = np.inf
        return
    n = 0
    for q in range(count):
        while bound[n + 1] < q:
            n += 1
        p = last[n]
        out[q] = cost[p] + width * width * (q - p) * (q - p)


@copied
def nearest_seeds(seed, place, h, reach):
    """Turn numbers of nodes, -1 elsewhere, into the number of the nearest such node, where one may lie in reach.

    Parameters
    ----------
    seed
        Number of each node, or -1, int32, shape [z, y, x]; changed in place.
    place
        Node (z, y, x) of each number, shape (seed_count, 3).
    h
        Spacing along z, y, x, mm.
    reach
        Distance in mm beyond which no node need be found.
    """
    nz, ny, nx = seed.shape
    longest = max(nz, ny, nx)
    far = reach * reach
    cost = np.empty(longest)
    here = np.empty(longest, np.int32)
    out = np.empty(longest, np.int32)
    last = np.empty(longest, np.int32)
    bound = np.empty(longest + 1)
    plane = np.empty((ny, nx), np.int32)
    for k in range(nz):
        any_here = False
        for j in range(ny):
            nearest = -1
            for i in range(nx):
                if seed[k, j, i] >= 0:
                    nearest = seed[k, j, i]
                plane[j, i] = nearest
            any_here |= nearest >= 0
            if nearest < 0:
                continue
            nearest = -1
            for i in range(nx - 1, -1, -1):
                if seed[k, j, i] >= 0:
                    nearest = seed[k, j, i]
                before = plane[j, i]
                if nearest >= 0 and (before < 0 or place[nearest, 2] - i < i - place[before, 2]):
                    plane[j, i] = nearest
        if not any_here:
            continue
        for i in range(nx):
            for j in range(ny):
                n = plane[j, i]
                here[j] = n
                cost[j] = ((place[n, 2] - i) * h[2]) ** 2 if n >= 0 else np.inf
                if cost[j] > far:
                    cost[j] = np.inf
            _nearest_entries(cost, here, ny, h[1], last, bound, out)
            for j in range(ny):
                seed[k, j, i] = out[j]
    slab = np.empty((nx, nz), np.int32)
    for j in range(ny):
        for k in range(nz):
            for i in range(nx):
                slab[i, k] = seed[k, j, i]
        for i in range(nx):
            for k in range(nz):
                n = slab[i, k]
                here[k] = n
                cost[k] = np.inf
                if n >= 0:
                    cost[k] = ((place[n, 2] - i) * h[2]) ** 2 + ((place[n, 1] - j) * h[1]) ** 2
                if cost[k] > far:
                    cost[k] = np.inf
            _nearest_entries(cost, here, nz, h[0], last, bound, out)
            for k in range(nz):
                slab[i, k] = out[k]
        for k in range(nz):
            for i in range(nx):
                seed[k, j, i] = slab[i, k]


@kernel
def distance_to_marked(marked, h, distance):
    """Distance of every node to the nearest marked one.

    Parameters
    ----------
    marked
        Shape [z, y, x].
    h
        Spacing along z, y, x, mm.
    distance
        float32, same shape: receives mm; 0 at marked nodes, infinity where none is marked.
    """
    nz, ny, nx = marked.shape
    longest = max(nz, ny, nx)
    last = np.empty(longest, np.int32)
    bound = np.empty(longest + 1)
    out = np.empty(longest)
    plane = np.empty((nx, ny))
    for k in range(nz):
        any_here = False
        for j in range(ny):
            steps = np.inf
            for i in range(nx):
                steps = 0.0 if marked[k, j, i] else steps + 1.0
                plane[i, j] = steps
            any_here |= steps < np.inf
            steps = np.inf
            for i in range(nx - 1, -1, -1):
                steps = 0.0 if marked[k, j, i] else steps + 1.0
                way = min(steps, plane[i, j]) * h[2]
                plane[i, j] = way * way
        for i in range(nx):
            if any_here:
                _lowest_values(plane[i], ny, h[1], last, bound, out)
                for j in range(ny):
                    plane[i, j] = out[j]
        for j in range(ny):
            for i in range(nx):
                distance[k, j, i] = plane[i, j]
    slab = np.empty((nx, nz))
    for j in range(ny):
        for k in range(nz):
            for i in range(nx):
                slab[i, k] = distance[k, j, i]
        for i in range(nx):
            _lowest_values(slab[i], nz, h[0], last, bound, out)
            for k in range(nz):
                slab[i, k] = out[k]
        for k in range(nz):
            for i in range(nx):
                distance[k, j, i] = np.sqrt(slab[i, k])
