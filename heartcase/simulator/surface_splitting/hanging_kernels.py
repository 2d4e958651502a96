"""Where vertices hang on the three nodes that they are tied to, and the springs of some nodes: kernels."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = ["find_bent", "gather_near", "hang_on", "weigh_one", "write_offsets"]

_PLAIN: dict[str, Any] = {"error_model": "numpy"}
_ORDER = (0, 2, 1)
"""In which sums over the axes are taken: as NumPy's sums of products are."""


@kernel(cached=False, **_PLAIN)
def _clip(value):
    return min(max(value, 0.0), 1.0)


@kernel(cached=False, **_PLAIN)
def weigh_one(point, p, q, r, weights):
    """Write the barycentric weights of the place in a triangle that is closest to a point."""
    uu, uv, vv, wu, wv = 0.0, 0.0, 0.0, 0.0, 0.0
    for axis in _ORDER:
        u, v, w = q[axis] - p[axis], r[axis] - p[axis], point[axis] - p[axis]
        uu, uv, vv, wu, wv = uu + u * u, uv + u * v, vv + v * v, wu + w * u, wv + w * v
    determinant = uu * vv - uv * uv
    one, two = (vv * wu - uv * wv) / determinant, (uu * wv - uv * wu) / determinant
    if not (one >= 0.0 and two >= 0.0 and one + two <= 1.0):
        # On the three edges: the closest of all.
        first, second = _clip(wu / uu), _clip(wv / vv)
        along = _clip((wv - wu + uu - uv) / (uu + vv - 2.0 * uv))
        nearest = np.inf
        for n in range(3):
            a = first if n == 0 else 0.0 if n == 1 else 1.0 - along
            b = 0.0 if n == 0 else second if n == 1 else along
            away = 0.0
            for axis in _ORDER:
                w = point[axis] - p[axis] - a * (q[axis] - p[axis]) - b * (r[axis] - p[axis])
                away += w * w
            if away < nearest:
                one, two, nearest = a, b, away
    weights[0], weights[1], weights[2] = 1.0 - (one + two), one, two


@kernel(**_PLAIN)
def hang_on(points, nodes, node_index, anew_count, weights, edges, basis):
    """Write weights, edges and basis of some vertices over their nodes; returns the least area of their triangles.

    Parameters
    ----------
    points
        Rest places [cells], shape (count, 3).
    nodes, node_index
        Nodes of each, shape (count, 3), and the index (i, j, k) of each node.
    anew_count
        How many of them, the first, get weights; those of the others stay.
    weights, edges
        Of each, float32, shapes (count, 3) and (count, 2, 3); written.
    basis
        Rows T, N, B of each (eq. 9.6), shape (count, 3, 3); written.
    """
    corners, own = np.empty((3, 3)), np.empty(3)
    least = np.inf
    for n in range(len(points)):
        for corner in range(3):
            for axis in range(3):
                corners[corner, axis] = node_index[nodes[n, corner], axis]
        if n < anew_count:
            weigh_one(points[n], corners[0], corners[1], corners[2], own)
            for corner in range(3):
                weights[n, corner] = own[corner]
        for axis in range(3):
            edges[n, 0, axis] = corners[1, axis] - corners[0, axis]
            edges[n, 1, axis] = corners[2, axis] - corners[0, axis]
        ax, ay, az = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
        bx, by, bz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
        length = sqrt(ax * ax + ay * ay + az * az)
        if length > 0.0:
            ax, ay, az = ax / length, ay / length, az / length
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        length = sqrt(nx * nx + ny * ny + nz * nz)
        least = min(least, length)
        if length > 0.0:
            nx, ny, nz = nx / length, ny / length, nz / length
        basis[n, 0, 0], basis[n, 0, 1], basis[n, 0, 2] = ax, ay, az
        basis[n, 1, 0], basis[n, 1, 1], basis[n, 1, 2] = nx, ny, nz
        basis[n, 2, 0], basis[n, 2, 1], basis[n, 2, 2] = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    return least


@kernel(**_PLAIN)
def write_offsets(points, nodes, node_index, weights, basis, facing, offset, normal):
    """Write offset and normal of some vertices along their basis, float32, shape (count, 3) each.

    Parameters
    ----------
    points, nodes, node_index, weights, basis
        As of :func:`hang_on`.
    facing
        Normal of each, shape (count, 3).
    offset, normal
        Written.
    """
    away = np.empty(3)
    for n in range(len(points)):
        for axis in range(3):
            place = 0.0
            for corner in range(3):
                place += np.float64(weights[n, corner]) * node_index[nodes[n, corner], axis]
            away[axis] = points[n, axis] - place
        for row in range(3):
            b = basis[n, row]
            offset[n, row] = 0.0 + b[0] * away[0] + b[2] * away[2] + b[1] * away[1]
            normal[n, row] = 0.0 + b[0] * facing[n, 0] + b[2] * facing[n, 2] + b[1] * facing[n, 1]


@kernel(cached=False)
def _first_from(spring_nodes, node):
    """First spring of which the lower node is not below a node."""
    low, high = 0, len(spring_nodes)
    while low < high:
        middle = (low + high) // 2
        if spring_nodes[middle, 0] < node:
            low = middle + 1
        else:
            high = middle
    return low


@kernel(cached=False)
def _share_out(ways, whole, times):
    """How often each spring of a node counts, so that each way counts alike; returns how often all do together."""
    present = 0
    for at in range(len(ways)):
        present |= 1 << ways[at]
    cut = whole & ~present
    way_count, all_times = 0, 1
    for at in range(len(ways)):
        same, is_first = 0, True
        for other in range(len(ways)):
            if ways[other] == ways[at]:
                same += 1
                is_first = is_first and other >= at
        times[at] = 0 if cut >> (ways[at] ^ 1) & 1 else same
        if times[at]:
            way_count += is_first
            one, other = all_times, same
            while other:
                one, other = other, one % other
            all_times *= same // one
    for at in range(len(ways)):
        if times[at]:
            times[at] = all_times // times[at]
    return all_times * way_count


@kernel
def gather_near(
    spring_nodes, spring_direction, directions, origins, lowest, ways_whole, nodes, first, neighbours, offset
):
    """List the springs of some nodes, node by node, by neighbour; returns how many there are, and room is needed for.

    A normal is the sum of the ways. So that it does not turn towards a cut, where a node has springs to several copies
    of one place, those of each way are listed as often as those of any other, and of two opposite ways of which one was
    cut the other is left out, too: they had cancelled.

    Parameters
    ----------
    spring_nodes, spring_direction, directions
        Both nodes, by the lower, and direction of each spring, and the way of each direction.
    origins, lowest
        Node of the uncut lattice that each node is, or is a copy of, and the lowest node that a spring of the uncut
        lattice joins to each of its nodes, or itself.
    ways_whole
        Ways of the springs of the uncut lattice's nodes: see :func:`heartcase.simulator.surface.deform.ways_of_nodes`.
    nodes
        Those that are asked for, ascending.
    first
        Where each node's neighbours start, int32, shape (count + 1,); written.
    neighbours, offset
        Nodes at the other end, and the way from these to the node at rest; written as far as there is room.
    """
    row = np.full(len(origins), -1, np.int32)
    least, most = len(origins), -1
    for n in range(len(nodes)):
        row[nodes[n]] = n
        origin = origins[nodes[n]]
        least, most = min(least, lowest[origin]), max(most, origin)
    # Only springs from nodes between these, or from copies, can be of these nodes.
    spans = np.empty((2, 2), np.int64)
    spans[0, 0], spans[0, 1] = _first_from(spring_nodes, least), _first_from(spring_nodes, most + 1)
    spans[1, 0] = max(_first_from(spring_nodes, len(lowest)), spans[0, 1])
    spans[1, 1] = len(spring_nodes)
    near = np.empty(spans[0, 1] - spans[0, 0] + spans[1, 1] - spans[1, 0], np.int64)
    count, counts = 0, np.zeros(len(nodes) + 1, np.int64)
    for span in range(2):
        for spring in range(spans[span, 0], spans[span, 1]):
            one, other = row[spring_nodes[spring, 0]], row[spring_nodes[spring, 1]]
            if one >= 0 or other >= 0:
                near[count] = spring
                count += 1
                if one >= 0:
                    counts[one + 1] += 1
                if other >= 0:
                    counts[other + 1] += 1
    for n in range(len(nodes)):
        counts[n + 1] += counts[n]
    total = counts[len(nodes)]
    ends, ways = np.empty(total, np.int64), np.empty(total, np.int64)
    filled = counts.copy()
    for spring in near[:count]:
        for end in range(2):
            n = row[spring_nodes[spring, end]]
            if n < 0:
                continue
            node, way = spring_nodes[spring, 1 - end], 2 * spring_direction[spring] + end
            at = filled[n]
            while at > counts[n] and ends[at - 1] > node:
                ends[at], ways[at] = ends[at - 1], ways[at - 1]
                at -= 1
            ends[at], ways[at] = node, way
            filled[n] += 1
    times = np.empty(total, np.int64)
    first[0] = 0
    for n in range(len(nodes)):
        its = ways[counts[n] : counts[n + 1]]
        first[n + 1] = first[n] + _share_out(its, ways_whole[origins[nodes[n]]], times[counts[n] : counts[n + 1]])
    if first[len(nodes)] > len(neighbours):
        return first[len(nodes)]
    row_of = 0
    for at in range(total):
        along = directions[ways[at] // 2]
        for _ in range(times[at]):
            neighbours[row_of] = ends[at]
            for axis in range(3):
                offset[row_of, axis] = along[axis] if ways[at] % 2 else -along[axis]
            row_of += 1
    return row_of


@kernel
def find_bent(curved, changed, is_tied_anew, triangle_nodes, is_around, is_near, touched):
    """List vertices with an interpolated basis that keep their nodes, of which one is marked; returns how many.

    Parameters
    ----------
    curved
        Vertices with an interpolated basis, ascending.
    changed, is_tied_anew
        Vertices that follow other nodes, ascending, and which of these are tied anew.
    triangle_nodes, is_around
        Nodes of each vertex, and which nodes are marked.
    is_near
        Marked nodes of those that are listed, false at first; written.
    touched
        Room for all; written.
    """
    count, at = 0, 0
    for vertex in curved:
        while at < len(changed) and changed[at] < vertex:
            at += 1
        if at < len(changed) and changed[at] == vertex and is_tied_anew[at]:
            continue
        a, b, c = triangle_nodes[vertex, 0], triangle_nodes[vertex, 1], triangle_nodes[vertex, 2]
        if is_around[a] or is_around[b] or is_around[c]:
            is_near[a], is_near[b], is_near[c] = is_around[a], is_around[b], is_around[c]
            touched[count] = vertex
            count += 1
    return count
