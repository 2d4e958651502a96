"""Which vertices lie near sheets, and on which side their triangles are: kernels of tying a split surface."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = ["add_ways_to_middles", "in_marked_cells"]


@kernel(cached=False)
def _along(places, new_places, vertex, axis):
    return places[vertex, axis] if vertex < len(places) else new_places[vertex - len(places), axis]


@kernel
def add_ways_to_middles(triangles, places, new_places, row, total):
    """Add up the ways from some vertices to the middles of their triangles.

    Parameters
    ----------
    triangles, places, new_places
        Of the surface, shape (triangle_count, 3); of its first vertices, and of those that follow, shape (count, 3).
    row
        Row of each vertex in the totals, or -1, shape (vertex_count,).
    total
        Shape (count, 3), zeros at first; written.
    """
    for triangle in range(len(triangles)):
        a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        if row[a] < 0 and row[b] < 0 and row[c] < 0:
            continue
        for axis in range(3):
            x, y = _along(places, new_places, a, axis), _along(places, new_places, b, axis)
            z = _along(places, new_places, c, axis)
            middle = (x + y + z) / 3.0
            for vertex, here in ((a, x), (b, y), (c, z)):
                if row[vertex] >= 0:
                    total[row[vertex], axis] += middle - here


@kernel
def in_marked_cells(places, low, marked, found):
    """List the places whose cell is marked, ascending; returns how many there are.

    Parameters
    ----------
    places
        Shape (count, 3) [cells].
    low
        Index of the first cell of the marks, shape (3,).
    marked
        Shape (i, j, k).
    found
        Room for all; written.
    """
    count = 0
    for place in range(len(places)):
        i = np.int64(np.floor(places[place, 0])) - low[0]
        j = np.int64(np.floor(places[place, 1])) - low[1]
        k = np.int64(np.floor(places[place, 2])) - low[2]
        if i < 0 or j < 0 or k < 0 or i >= marked.shape[0] or j >= marked.shape[1] or k >= marked.shape[2]:
            continue
        if marked[i, j, k]:
            found[count] = place
            count += 1
    return count
