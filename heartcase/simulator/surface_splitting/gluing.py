"""Which corners of faces are one vertex of the split surface: kernels.

Around each edge of the arrangement its faces stand in a circle, with tissue or void between two that follow one
another. What bounds the same tissue is glued. So each side of each face is glued to one other along each edge, and what
comes out is closed, whatever faces there are.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.lattice.disjoint_sets import join_two, root_of

__all__ = [
    "glue_around",
    "has_double_edges",
    "join_sets",
    "join_triangles",
    "list_outlines",
    "measure_parts",
    "number_parts",
]


@kernel
def join_sets(parents, pairs):
    """Join the sets of pairs of members, and let each member know its set."""
    for n in range(len(pairs)):
        join_two(parents, pairs[n, 0], pairs[n, 1])
    for one in range(len(parents)):
        parents[one] = root_of(parents, one)


@kernel
def glue_around(first, is_circle, halves, backwards, copies, following, parents, partner):
    """Glue what follows one another around each edge.

    Parameters
    ----------
    first, is_circle
        Where the half-edges at each edge begin, shape (edge_count + 1,), and whether the last is followed by the first.
    halves, backwards, copies
        Half-edges in their order around the edge; whether each runs against it; and which copy of its face, 0 or 1,
        looks back and which looks ahead, shape (count, 2).
    following
        The half-edge that follows each in its face.
    parents
        Sets of corners, shape (2 half_count,): first those of all faces' copy 0, then of copy 1; joined.
    partner
        Half-edge, with its copy, that each is glued to, shape (2 half_count,); written.
    """
    half_count = len(following)
    for edge in range(len(first) - 1):
        count = first[edge + 1] - first[edge]
        for n in range(count if is_circle[edge] else count - 1):
            one, other = first[edge] + n, first[edge] + (n + 1) % count
            a, b = halves[one], halves[other]
            of_a, of_b = copies[one, 1] * half_count, copies[other, 0] * half_count
            partner[of_a + a], partner[of_b + b] = of_b + b, of_a + a
            start_a, end_a = of_a + a, of_a + following[a]
            start_b, end_b = of_b + b, of_b + following[b]
            if backwards[one] == backwards[other]:
                join_two(parents, start_a, start_b)
                join_two(parents, end_a, end_b)
            else:
                join_two(parents, start_a, end_b)
                join_two(parents, end_a, start_b)


@kernel
def number_parts(triangles, vertex_count):
    """Number of what each triangle, or cell, hangs together with, by the first of each, int32, shape (count,)."""
    parents = np.arange(vertex_count)
    for n in range(len(triangles)):
        for corner in range(1, triangles.shape[1]):
            join_two(parents, triangles[n, 0], triangles[n, corner])
    numbers = np.full(vertex_count, -1, np.int32)
    part = np.empty(len(triangles), np.int32)
    count = 0
    for n in range(len(triangles)):
        root = root_of(parents, triangles[n, 0])
        if numbers[root] < 0:
            numbers[root] = count
            count += 1
        part[n] = numbers[root]
    return part


@kernel
def measure_parts(places, triangles, part, volumes, areas):
    """Add up six times the volume and twice the area of each part of a surface."""
    middle = places[triangles[0, 0]]
    p, q, r = np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(triangles)):
        for axis in range(3):
            p[axis] = places[triangles[n, 0], axis] - middle[axis]
            q[axis] = places[triangles[n, 1], axis] - middle[axis] - p[axis]
            r[axis] = places[triangles[n, 2], axis] - middle[axis] - p[axis]
        x, y, z = q[1] * r[2] - q[2] * r[1], q[2] * r[0] - q[0] * r[2], q[0] * r[1] - q[1] * r[0]
        volumes[part[n]] += x * p[0] + y * p[1] + z * p[2]
        areas[part[n]] += np.sqrt(x * x + y * y + z * z)


@kernel
def join_triangles(uncut, crossed, added, added_origin, added_sheet, triangles, origin, sheet):
    """Write the triangles that are left of the uncut surface, then those that are there instead of the others.

    Parameters
    ----------
    uncut, crossed
        Triangles of the uncut surface, shape (uncut_count, 3), and which of them are not there any more, ascending.
    added, added_origin, added_sheet
        Triangles that are there instead, which of the uncut ones they are a part of, or -1, and their sheet, or -1.
    triangles, origin, sheet
        Written, int32, shapes (count, 3), (count,) and (count,).
    """
    at, start = 0, 0
    for n in range(len(crossed) + 1):
        stop = crossed[n] if n < len(crossed) else len(uncut)
        for one in range(start, stop):
            triangles[at, 0], triangles[at, 1], triangles[at, 2] = uncut[one, 0], uncut[one, 1], uncut[one, 2]
            origin[at], sheet[at] = one, -1
            at += 1
        start = stop + 1
    for n in range(len(added)):
        triangles[at, 0], triangles[at, 1], triangles[at, 2] = added[n, 0], added[n, 1], added[n, 2]
        origin[at], sheet[at] = added_origin[n], added_sheet[n]
        at += 1


@kernel
def has_double_edges(triangles, vertices):
    """Whether more than two sides of triangles have both their vertices in common.

    Parameters
    ----------
    triangles, vertices
        Corners of the triangles, shape (count, 3), and the vertex of each corner.
    """
    size = 16
    while size < 6 * len(triangles):
        size *= 2
    keys, counts = np.full(size, -1), np.zeros(size, np.int8)
    for n in range(len(triangles)):
        for corner in range(3):
            one, other = vertices[triangles[n, corner]], vertices[triangles[n, (corner + 1) % 3]]
            key = min(one, other) << 32 | max(one, other)
            at = ((key ^ (key >> 29)) * 0x1E3779B97F4A7C15 >> 20) & (size - 1)
            while keys[at] >= 0 and keys[at] != key:
                at = (at + 1) & (size - 1)
            keys[at] = key
            counts[at] += 1
            if counts[at] > 2:
                return True
    return False


@kernel
def list_outlines(halves, corners, facet_edges, outlines, pieces, is_backwards):
    """List the half-edges along the edges of facets; returns how many there are.

    Parameters
    ----------
    halves
        Of :class:`heartcase.simulator.mesh_arrangement.arrange.Faces`.
    corners, facet_edges
        Of the facets.
    outlines, pieces, is_backwards
        Half-edges, ascending, the piece of an edge that each is, and whether it runs backwards; room for all; written.
    """
    count, most = 0, 1
    start = 0
    for half in range(len(halves)):
        kind = halves[half, 3]
        if kind >= 0 or kind < -3 * len(corners):
            continue
        if count > start and halves[outlines[start], 3] != kind:
            start = count
        outlines[count] = half
        count += 1
        most = max(most, count - start)
    start = 0
    while start < count:
        side = -1 - halves[outlines[start], 3]
        stop = start
        while stop < count and -1 - halves[outlines[stop], 3] == side:
            stop += 1
        facet, corner = side // 3, side % 3
        runs_back = corners[facet, corner] > corners[facet, (corner + 1) % 3]
        for at in range(start, stop):
            rank = stop - 1 - at if runs_back else at - start
            pieces[at] = facet_edges[facet, corner] * most + rank
            is_backwards[at] = runs_back
        start = stop
    return count
