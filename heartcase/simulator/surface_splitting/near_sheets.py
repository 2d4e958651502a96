"""Which vertices lie near sheets, and on which side their triangles are: kernels of tying a split surface."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.surface_splitting.hanging_kernels import weigh_one

__all__ = [
    "add_ways_near",
    "add_ways_to_middles",
    "copies_of",
    "list_around",
    "near_cells",
    "order_by_reach",
]


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
def add_ways_near(vertices, around, crossed, added, places, new_places, row, total):
    """The same as :func:`add_ways_to_middles`, of vertices of the uncut surface, without going through all triangles.

    Parameters
    ----------
    vertices
        Vertices of the uncut surface, shape (count,), whose row in the totals is their place here.
    around
        ``(triangles, first, members)``: the uncut triangles, and those around each vertex, ascending.
    crossed, added
        Triangles of these that are not there any more, and those that are there instead.
    places, new_places, row, total
        As of :func:`add_ways_to_middles`.
    """
    triangles, first, members = around
    is_crossed = np.zeros(len(triangles), np.bool_)
    for one in crossed:
        is_crossed[one] = True
    for n in range(len(vertices)):
        vertex = vertices[n]
        for at in range(first[vertex], first[vertex + 1]):
            if is_crossed[members[at]]:
                continue
            a, b, c = triangles[members[at], 0], triangles[members[at], 1], triangles[members[at], 2]
            for axis in range(3):
                middle = (places[a, axis] + places[b, axis] + places[c, axis]) / 3.0
                total[n, axis] += middle - places[vertex, axis]
    add_ways_to_middles(added, places, new_places, row, total)


@kernel
def list_around(triangles, first, members):
    """List the triangles around each vertex, ascending.

    Parameters
    ----------
    triangles
        Shape (triangle_count, 3).
    first, members
        Where each vertex begins, zeros at first, shape (vertex_count + 1,), and its triangles; written.
    """
    for one in range(len(triangles)):
        for corner in range(3):
            first[triangles[one, corner] + 1] += 1
    for vertex in range(len(first) - 1):
        first[vertex + 1] += first[vertex]
    filled = first[:-1].copy()
    for one in range(len(triangles)):
        for corner in range(3):
            vertex = triangles[one, corner]
            members[filled[vertex]] = one
            filled[vertex] += 1


@kernel
def near_cells(indices, shape, places, found):
    """List the places whose cell, or one around it, is among some, ascending; returns how many there are.

    Parameters
    ----------
    indices
        Index (i, j, k) of these cells in a box, none in its outermost layer, shape (cell_count, 3).
    shape
        Cells of the box along each axis.
    places
        Number of the cell of each place in the box, or -1, shape (count,).
    found
        Room for all; written.
    """
    marked = np.zeros(shape[0] * shape[1] * shape[2], np.bool_)
    for n in range(len(indices)):
        for i in range(indices[n, 0] - 1, indices[n, 0] + 2):
            for j in range(indices[n, 1] - 1, indices[n, 1] + 2):
                at = (i * shape[1] + j) * shape[2] + indices[n, 2]
                marked[at - 1] = marked[at] = marked[at + 1] = True
    count = 0
    for place in range(len(places)):
        if places[place] >= 0 and marked[places[place]]:
            found[count] = place
            count += 1
    return count


@kernel
def copies_of(corners, origins, cells, nodes, copies):
    """Write the corners of cells of a cut lattice that are, or are copies of, nodes; shape (count, 3).

    Parameters
    ----------
    corners, origins
        Corners of all cells, shape (cell_count, 8), and the node of the uncut lattice that each node is or was.
    cells, nodes
        A cell for each three nodes of the uncut lattice, shapes (count,) and (count, 3).
    copies
        Written.
    """
    for n in range(len(cells)):
        for corner in range(3):
            copies[n, corner] = corners[cells[n], 0]
            for at in range(8):
                if origins[corners[cells[n], at]] == nodes[n, corner]:
                    copies[n, corner] = corners[cells[n], at]
                    break


@kernel
def order_by_reach(points, corners, triangle_nodes, node_index, fineness, order):
    """Order the corners of a triangle by how far a point is from the three nodes that each follows.

    Parameters
    ----------
    points, corners
        Shape (count, 3), and the vertices at the corners of a triangle for each, shape (count, 3).
    triangle_nodes, node_index
        Nodes of each vertex, and the index (i, j, k) of each node.
    fineness
        Distances that are the same when rounded by this are in their order.
    order
        Written, shape (count, 3).
    """
    nodes, weights, away = np.empty((3, 3)), np.empty(3), np.empty(3)
    for n in range(len(points)):
        for corner in range(3):
            for one in range(3):
                for axis in range(3):
                    nodes[one, axis] = node_index[triangle_nodes[corners[n, corner], one], axis]
            weigh_one(points[n], nodes[0], nodes[1], nodes[2], weights)
            total = 0.0
            for axis in range(3):
                place = weights[0] * nodes[0, axis] + weights[1] * nodes[1, axis] + weights[2] * nodes[2, axis]
                total += (place - points[n, axis]) ** 2
            distance = np.round(np.sqrt(total) * fineness)
            at = corner
            while at > 0 and away[at - 1] > distance:
                away[at], order[n, at] = away[at - 1], order[n, at - 1]
                at -= 1
            away[at], order[n, at] = distance, corner
