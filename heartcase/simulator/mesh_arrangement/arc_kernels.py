"""Where arcs begin and end on facets, and how they lie in them: kernels."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.mesh_arrangement.merged_rows import order_rows

__all__ = ["end_turns", "flat_corners", "lay_arcs", "list_on_edges", "meet_in_points", "order_on_edges", "place_nodes"]

_OF_SHEETS = 1 << 62
_MASK = 0x7FFFFFFF


@kernel(cached=False)
def _goes_forward(triangle, side):
    return triangle[side] < triangle[(side + 1) % 3]


@kernel
def end_turns(triangles, edges, ranks, edge_count, facets, keys, turns):
    """Write the place of each end of each arc in the order around the sheet's edge that it is on, shape (count, 2).

    Parameters
    ----------
    triangles, edges, ranks, edge_count
        Of the sheets' mesh, and the number of its edges.
    facets, keys
        Both triangles of each arc, where they are of sheets, and the keys of both ends, shape (count, 2) each.
    turns
        Not a number where an end is on no such edge; written.
    """
    count = np.zeros(edge_count, np.int64)
    for one in range(len(edges)):
        for corner in range(3):
            count[edges[one, corner]] += 1
    for arc in range(len(facets)):
        for end in range(2):
            key = keys[arc, end]
            turns[arc, end] = np.nan
            if 0 <= key < _OF_SHEETS:
                continue
            edge = ((-1 - key if key < 0 else key) & ~_OF_SHEETS) >> 31
            for which in range(0 if key < 0 else 1, 2):
                one = facets[arc, which]
                for side in range(3):
                    if edges[one, side] == edge:
                        # Seen from before the other facet the edge comes towards one, or goes away.
                        is_towards = (end == which) == _goes_forward(triangles[one], side)
                        turn = 2.0 * pi * ranks[one, side] / count[edge]
                        turns[arc, end] = turn if is_towards else -turn
                        break


@kernel(cached=False)
def _cross(a, b, found):
    found[0], found[1] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2]
    found[2] = a[0] * b[1] - a[1] * b[0]


@kernel(cached=False)
def _dot(a, b):
    return 0.0 + a[0] * b[0] + a[2] * b[2] + a[1] * b[1]


@kernel(cached=False)
def _length(a):
    return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@kernel(cached=False)
def _normal(corners, normal):
    """Write the normal of a facet as its whole numbers have it, twice the area long."""
    a, b = corners[1] - corners[0], corners[2] - corners[0]
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    normal[0], normal[1], normal[2] = x, y, z


@kernel
def order_on_edges(keys, first_node, arc_nodes, arc_facets, weights, corners, facet_edges, ints, edge_count, scale, at):
    """Say where each node is on the edge that it is on, and in which order they are along them.

    Parameters
    ----------
    keys, first_node
        Of all ends of arcs, ascending, and the number of the node of the first.
    arc_nodes, arc_facets, weights
        Of the arcs, as they cross.
    corners, facet_edges, ints, edge_count
        Nodes and edges of the facets, whole-number places of their corners, and the number of the surface's edges.
    scale
        Shares of an edge that are the same when rounded by this are in the order of the movement.
    at
        ``(edges, shares, facets, sides, kinds)``: the edge that each node is on; how far along it lies; the facet of
        which the edge is, and the other one, shape (count, 2); which side of it; and whether the edge is of the
        surface (0), of a sheet and meets the surface (1), or a sheet (2); written.

    Returns
    -------
    order, is_tie
        Nodes along the edges, and whether each and the next are in one place.
    """
    edges, shares, facets, sides, kinds = at
    count = len(keys)
    rows = np.full(count, 2 * len(arc_nodes) - 1)
    for arc in range(len(arc_nodes) - 1, -1, -1):
        for end in (1, 0):
            node = arc_nodes[arc, end] - first_node
            if node >= 0:
                rows[node] = 2 * arc + end
    moved, rounded = np.zeros((count, 3)), np.empty(count)
    normal, way = np.empty(3), np.empty(3)
    for n in range(count):
        arc, end, key = rows[n] // 2, rows[n] % 2, keys[n]
        kind = 0 if 0 <= key < _OF_SHEETS else 1 if key >= 0 else 2
        edge = key >> 31 if kind == 0 else edge_count + (((-1 - key if key < 0 else key) & ~_OF_SHEETS) >> 31)
        which = 0 if kind == 0 else 1
        if kind == 2:
            which = 0
            for side in range(3):
                if facet_edges[arc_facets[arc, 1], side] == edge:
                    which = 1
        facet, other, side = arc_facets[arc, which], arc_facets[arc, 1 - which], 0
        while side < 2 and facet_edges[facet, side] != edge:
            side += 1
        if facet_edges[facet, side] != edge:
            side = 0
        share = weights[arc, end, which, (side + 1) % 3]
        is_forward = _goes_forward(corners[facet], side)
        share = share if is_forward else 1.0 - share
        edges[n], shares[n], facets[n, 0], facets[n, 1], sides[n], kinds[n] = edge, share, facet, other, side, kind
        rounded[n] = np.round(share * scale)
        # The surface is moved against the sheets: what is in one place goes apart as the sheets' normals say.
        _normal(ints[other], normal)
        for axis in range(3):
            along = ints[facet, (side + 1) % 3, axis] - ints[facet, side, axis]
            way[axis] = along if is_forward else -along
        along = _dot(normal, way)
        if kind != 2 and along != 0.0:
            for axis in range(3):
                moved[n, axis] = -normal[axis] / along if kind == 0 else normal[axis] / along
    # Along edges; what is in one place of an edge goes by how it moves. Numbers of edges are whole in float64.
    along_edges = np.empty((count, 5))
    for n in range(count):
        along_edges[n, 0], along_edges[n, 1] = edges[n], rounded[n]
        along_edges[n, 2], along_edges[n, 3], along_edges[n, 4] = moved[n, 1], moved[n, 2], moved[n, 0]
    order = order_rows(along_edges)
    is_tie = np.zeros(max(count - 1, 0), np.bool_)
    for n in range(count - 1):
        one, other = order[n], order[n + 1]
        is_tie[n] = (
            edges[one] == edges[other]
            and rounded[one] == rounded[other]
            and kinds[one] == kinds[other]
            and kinds[other] != 1
        )
    return order, is_tie


@kernel
def list_on_edges(corners, facet_edges, order, edges, shares, first_node, first, nodes, along):
    """List the nodes on each edge of each facet, in its order; returns how many there are, and room is needed for.

    Parameters
    ----------
    corners, facet_edges
        Of the facets.
    order, edges, shares
        Of the nodes (:func:`order_on_edges`).
    first_node
        Number of the first of these nodes.
    first
        Where the nodes of each edge of each facet begin, shape (3 facet_count + 1,); written.
    nodes, along
        The nodes, and how far along they lie; written as far as there is room.
    """
    count = 0
    for facet in range(len(corners)):
        for side in range(3):
            edge = facet_edges[facet, side]
            low, high = 0, len(order)
            while low < high:
                middle = (low + high) // 2
                if edges[order[middle]] < edge:
                    low = middle + 1
                else:
                    high = middle
            stop = low
            while stop < len(order) and edges[order[stop]] == edge:
                stop += 1
            is_forward = _goes_forward(corners[facet], side)
            first[3 * facet + side] = count
            for n in range(stop - low):
                at = order[low + n] if is_forward else order[stop - 1 - n]
                if count < len(nodes):
                    nodes[count] = first_node + at
                    along[count] = shares[at] if is_forward else 1.0 - shares[at]
                count += 1
    first[3 * len(corners)] = count
    return count


@kernel
def flat_corners(places, flat):
    """Write the corners of facets in their planes, first along x, shape (facet_count, 3, 2)."""
    normal = np.empty(3)
    for n in range(len(places)):
        one, other = places[n, 1] - places[n, 0], places[n, 2] - places[n, 0]
        _cross(one, other, normal)
        length, area = _length(one), _length(normal)
        flat[n] = 0.0
        is_fine = length > 0.0 and area > 0.0
        flat[n, 1, 0] = length if is_fine else 1.0
        flat[n, 2, 0] = _dot(one, other) / length if is_fine else 0.0
        flat[n, 2, 1] = area / length if is_fine else 1.0


@kernel
def lay_arcs(facets, weights, turns, own_turns, ints, places, flat, lists, first, ends, ways, around):
    """Lay the arcs into their facets.

    Parameters
    ----------
    facets, weights, turns, own_turns
        Of the arcs.
    ints, places, flat
        Corners of the facets: whole numbers, places [cells], and in their planes.
    lists, first
        Arcs facet by facet, 2 arc + which of its facets, and where those of each begin; written.
    ends, ways, around
        Of each of these: places of both ends, the direction in which it is straight, and the angle in the order around
        each end; written.
    """
    for arc in range(len(facets)):
        for which in range(2):
            first[facets[arc, which] + 1] += 1
    for facet in range(len(first) - 1):
        first[facet + 1] += first[facet]
    filled = first[:-1].copy()
    for arc in range(len(facets)):
        for which in range(2):
            facet = facets[arc, which]
            lists[filled[facet]] = 2 * arc + which
            filled[facet] += 1
    normals = np.empty((len(ints), 3))
    for facet in range(len(ints)):
        _normal(ints[facet], normals[facet])
    way, second = np.empty(3), np.empty(3)
    for row in range(len(lists)):
        arc, which = lists[row] // 2, lists[row] % 2
        facet = facets[arc, which]
        for end in range(2):
            for axis in range(2):
                total = 0.0
                for corner in range(3):
                    total += weights[arc, end, which, corner] * flat[facet, corner, axis]
                ends[row, end, axis] = total
            is_own = which == 0 and not np.isnan(own_turns[arc, end])
            around[row, end] = own_turns[arc, end] if is_own else turns[arc, end]
        _cross(normals[facets[arc, 0]], normals[facets[arc, 1]], way)
        along = places[facet, 1] - places[facet, 0]
        _cross(normals[facet], along, second)
        length, width = _length(along), _length(second)
        ways[row, 0] = _dot(way, along) / (length if length > 0.0 else 1.0)
        ways[row, 1] = _dot(way, second) / (width if width > 0.0 else 1.0)
        if ways[row, 0] == 0.0 and ways[row, 1] == 0.0:
            ways[row, 0], ways[row, 1] = ends[row, 1, 0] - ends[row, 0, 0], ends[row, 1, 1] - ends[row, 0, 1]


@kernel(cached=False)
def _weighed(weights, places, triangle, place):
    for axis in range(3):
        total = 0.0
        for corner in range(3):
            total += weights[corner] * places[triangle[corner], axis]
        place[axis] = total


@kernel
def place_nodes(surface, sheets, crossed, nodes, facets, weights, first_node, places, on_surface, on_weights):
    """Write the places of the ends of arcs, and where on the surface they lie.

    Parameters
    ----------
    surface, sheets
        Places [cells] and triangles of each.
    crossed
        Triangle of the surface of each of the first facets.
    nodes, facets, weights
        Of the arcs.
    first_node
        Number of the sheets' first vertex; their ends follow these.
    places, on_surface, on_weights
        Place of each node from there on, the triangle of the surface that it lies on, or -1, and the barycentric place
        there; those of the sheets' vertices are there; written.
    """
    sheet_count = len(sheets[0])
    for end in (1, 0):
        for arc in range(len(nodes)):
            node = nodes[arc, end] - first_node
            if facets[arc, 0] < len(crossed):
                on_surface[node] = crossed[facets[arc, 0]]
                on_weights[node] = weights[arc, end, 0]
            elif node >= sheet_count:
                _weighed(weights[arc, end, 0], sheets[0], sheets[1][facets[arc, 0] - len(crossed)], places[node])
    for node in range(len(places)):
        if on_surface[node] >= 0:
            _weighed(on_weights[node], surface[0], surface[1][on_surface[node]], places[node])


@kernel
def meet_in_points(ints, meeting, not_zero, places, found):
    """Write where the planes of three facets meet, and whether that is in all of them: 1, or 0; or 2 if it is not sure.

    Parameters
    ----------
    ints, meeting
        Corners of the facets in whole numbers, and three facets for each point, shape (count, 3).
    not_zero
        Distance from the edges of a facet from which on a place is on a side of them for sure.
    places, found
        Shapes (count, 3) and (count,); written.
    """
    normals, crosses, sizes = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    way, inward, away = np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(meeting)):
        for one in range(3):
            _normal(ints[meeting[n, one]], normals[one])
            sizes[one] = _length(normals[one])
        for one in range(3):
            _cross(normals[(one + 1) % 3], normals[(one + 2) % 3], crosses[one])
        scale = _dot(normals[0], crosses[0])
        # From a corner of the first, so that numbers stay small.
        origin = ints[meeting[n, 0], 0]
        for axis in range(3):
            places[n, axis] = 0.0
        for one in range(3):
            for axis in range(3):
                away[axis] = ints[meeting[n, one], 0, axis] - origin[axis]
            offset = _dot(normals[one], away)
            for axis in range(3):
                places[n, axis] += offset * crosses[one, axis]
        for axis in range(3):
            places[n, axis] /= scale if scale != 0.0 else 1.0
        least = not_zero / max(abs(scale) / max(sizes[0] * sizes[1] * sizes[2], 1e-300), 1e-300)
        is_far, is_outside, is_within = True, False, True
        for one in range(3):
            corners = ints[meeting[n, one]]
            for side in range(3):
                for axis in range(3):
                    way[axis] = corners[(side + 1) % 3, axis] - corners[side, axis]
                    away[axis] = places[n, axis] - (corners[side, axis] - origin[axis])
                _cross(normals[one], way, inward)
                size = _length(inward)
                for axis in range(3):
                    inward[axis] /= size if size > 0.0 else 1.0
                height = _dot(inward, away)
                is_far = is_far and abs(height) > least
                is_outside = is_outside or height < -least
                is_within = is_within and height > 0.0
        is_sure = scale != 0.0 and (is_far or is_outside)
        found[n] = 2 if not is_sure else 1 if is_within else 0
        for axis in range(3):
            places[n, axis] += origin[axis]
