"""Which way divided triangles and new vertices face, and where walls lie on their sheets: kernels."""

from __future__ import annotations

from math import sqrt

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.surface_splitting.gluing import join_sets

__all__ = ["corner_angles", "face_ways", "lay_out", "sum_directions"]


@kernel(cached=False)
def _place(places, new_places, vertex, axis):
    return places[vertex, axis] if vertex < len(places) else new_places[vertex - len(places), axis]


@kernel
def face_ways(ints, facets, is_back, facing):
    """Write the unit normals of triangles by their facets, turned round where they are at the back, shape (count, 3).

    Parameters
    ----------
    ints, facets
        Corners of the facets in whole numbers, shape (facet_count, 3, 3), and the facet of each, shape (count,).
    is_back
        Whether each looks the other way.
    facing
        Zeros where a facet has no area; written.
    """
    for n in range(len(facets)):
        p, q, r = ints[facets[n], 0], ints[facets[n], 1], ints[facets[n], 2]
        ax, ay, az = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        bx, by, bz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
        x, y, z = float(ay * bz - az * by), float(az * bx - ax * bz), float(ax * by - ay * bx)
        length = sqrt(x * x + y * y + z * z)
        if length > 0.0:
            x, y, z = x / length, y / length, z / length
        if is_back[n]:
            x, y, z = -x, -y, -z
        facing[n, 0], facing[n, 1], facing[n, 2] = x, y, z


@kernel
def lay_out(vertices, triangles, flat, places, of_triangle, laid):
    """Write places on a sheet laid out flat, shape (count, 2).

    Parameters
    ----------
    vertices, triangles, flat
        Of the sheets: places [cells], vertex numbers, and the corners of each triangle laid out flat.
    places, of_triangle
        Points, shape (count, 3), and the triangle in whose plane each lies.
    laid
        Written.
    """
    for n in range(len(places)):
        one = of_triangle[n]
        p, q, r = vertices[triangles[one, 0]], vertices[triangles[one, 1]], vertices[triangles[one, 2]]
        uu, uv, vv, wu, wv = 0.0, 0.0, 0.0, 0.0, 0.0
        for axis in (0, 2, 1):
            u, v, w = q[axis] - p[axis], r[axis] - p[axis], places[n, axis] - p[axis]
            uu, uv, vv, wu, wv = uu + u * u, uv + u * v, vv + v * v, wu + w * u, wv + w * v
        determinant = uu * vv - uv * uv
        second, third = 0.0, 0.0
        if determinant > 0.0:
            second, third = (vv * wu - uv * wv) / determinant, (uu * wv - uv * wu) / determinant
        for axis in range(2):
            along = (1.0 - second - third) * flat[one, 0, axis] + second * flat[one, 1, axis]
            laid[n, axis] = along + third * flat[one, 2, axis]


@kernel
def corner_angles(triangles, places, new_places, one_place, sines, cosines, is_short):
    """Write sine and cosine of the angle at each corner, of any length, and whether an edge is as long as nothing.

    Parameters
    ----------
    triangles, places, new_places
        Vertex numbers, shape (count, 3), and places of the first vertices and of those that follow.
    one_place
        Vertices that are nearer to one another are in one place.
    sines, cosines, is_short
        Of each corner, and of the edge that follows it, shape (count, 3); written.
    """
    corners, ways, lengths = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for n in range(len(triangles)):
        for corner in range(3):
            for axis in range(3):
                corners[corner, axis] = _place(places, new_places, triangles[n, corner], axis)
        for corner in range(3):
            for axis in range(3):
                ways[corner, axis] = corners[(corner + 1) % 3, axis] - corners[corner, axis]
            a = ways[corner]
            lengths[corner] = sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
        for corner in range(3):
            a, before = ways[corner], (corner + 2) % 3
            bx = corners[before, 0] - corners[corner, 0]
            by, bz = corners[before, 1] - corners[corner, 1], corners[before, 2] - corners[corner, 2]
            x, y, z = a[1] * bz - a[2] * by, a[2] * bx - a[0] * bz, a[0] * by - a[1] * bx
            sines[n, corner] = sqrt(x * x + y * y + z * z)
            cosines[n, corner] = 0.0 + a[0] * bx + a[2] * bz + a[1] * by
            is_short[n, corner] = lengths[corner] < one_place


@kernel(cached=False)
def _unit(sums, unit):
    x, y, z = sums[0], sums[1], sums[2]
    length = sqrt(x * x + y * y + z * z)
    unit[0] = unit[1] = unit[2] = 0.0
    if length > 0.0:
        unit[0], unit[1], unit[2] = x / length, y / length, z / length
    return sqrt(unit[0] * unit[0] + unit[1] * unit[1] + unit[2] * unit[2]) > 0.0


@kernel
def sum_directions(triangles, facing, angles, is_short, is_surface, weld, lips, uncut, outward, normals):
    """Write the direction out of the tissue at new vertices, and their normals, shape (new_count, 3) each.

    Parameters
    ----------
    triangles, facing, angles, is_short, is_surface
        Of all triangles that were divided or made: vertices, unit normals, weight at each corner, whether the edge that
        follows a corner is as long as nothing, and which are of the uncut surface.
    weld
        Lowest vertex that is one with each new one, shape (new_count,).
    lips
        ``(on_triangle, on_weights)``: triangle of the uncut surface on which each new vertex lies, or -1, and where.
    uncut
        ``(normals, triangles)`` of the uncut surface.
    outward, normals
        Written.
    """
    on_triangle, on_weights = lips
    uncut_normals, uncut_triangles = uncut
    old_count, new_count = len(uncut_normals), len(weld)
    # Only vertices of these triangles, and new ones, are asked for: first those that were there.
    number = np.full(old_count, -1, np.int64)
    asked = 0
    for n in range(len(triangles)):
        for corner in range(3):
            vertex = triangles[n, corner]
            if vertex < old_count and number[vertex] < 0:
                number[vertex] = asked
                asked += 1
    corners, welded = np.empty((len(triangles), 3), np.int64), np.empty((len(triangles), 3), np.int64)
    for n in range(len(triangles)):
        for corner in range(3):
            vertex = triangles[n, corner]
            if vertex < old_count:
                corners[n, corner] = welded[n, corner] = number[vertex]
            else:
                corners[n, corner] = asked + vertex - old_count
                one = weld[vertex - old_count]
                welded[n, corner] = number[one] if one < old_count else asked + one - old_count
    count = asked + new_count
    # Vertices in one place that hang together see what all of them see.
    pair_count = 0
    for n in range(len(triangles)):
        for corner in range(3):
            pair_count += is_short[n, corner]
    pairs, sets = np.empty((pair_count, 2), np.int64), np.arange(count)
    pair_count = 0
    for n in range(len(triangles)):
        for corner in range(3):
            if is_short[n, corner]:
                pairs[pair_count, 0], pairs[pair_count, 1] = welded[n, corner], welded[n, (corner + 1) % 3]
                pair_count += 1
    join_sets(sets, pairs)
    own, together, first = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    is_lip, is_seen = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    for n in range(len(triangles)):
        for corner in range(3):
            vertex, place = corners[n, corner], sets[welded[n, corner]]
            for axis in range(3):
                weighted = facing[n, axis] * angles[n, corner]
                own[vertex, axis] += weighted
                together[place, axis] += weighted
            is_lip[vertex] = is_lip[vertex] or is_surface[n]
            # Where both walls of a cut meet and cancel out, any of them.
            if not is_seen[vertex]:
                is_seen[vertex] = True
                first[vertex] = facing[n]
    smooth, unit = np.empty(3), np.empty(3)
    for n in range(new_count):
        vertex = asked + n
        one = weld[n]
        _unit(together[sets[number[one] if one < old_count else asked + one - old_count]], outward[n])
        if not _unit(own[vertex], normals[n]):
            normals[n] = first[vertex]
        if on_triangle[n] >= 0 and is_lip[vertex]:
            for axis in range(3):
                smooth[axis] = 0.0
                for corner in range(3):
                    smooth[axis] += on_weights[n, corner] * uncut_normals[uncut_triangles[on_triangle[n], corner], axis]
            if _unit(smooth, unit):
                normals[n] = unit
        for spare in range(2):
            x, y, z = normals[n, 0], normals[n, 1], normals[n, 2]
            if sqrt(x * x + y * y + z * z) > 0.0:
                break
            if spare == 0:
                normals[n] = outward[n]
            else:
                normals[n, 0], normals[n, 1], normals[n, 2] = 0.0, 0.0, 1.0
