"""Where triangles of a surface and of sheets cross: kernels.

Two triangles that cross do so along a piece of a line, an arc. Each of its two ends lies where an edge of one of them
goes through the other: on an edge of the surface, or on one of a sheet. An arc runs along the cross product of the
normals of surface and sheet: then the tissue is on the right of it on the sheet, and what the sheet has on its back is
on the left of it on the surface.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.mesh_arrangement.exact_sides import line_side, sheet_side, tissue_side, volume

__all__ = ["cross_surface", "fill_buckets", "is_inside", "renumber_ends"]


@kernel
def fill_buckets(vertices, triangles, shift, low, size, first, members):
    """List the triangles that reach into each bucket, of 2^shift along each edge; counts alone where there is no room.

    ``first``, shape (bucket_count + 1,), holds where each bucket begins, once ``members`` has room.
    """
    is_counting = len(members) == 0
    if is_counting:
        first[:] = 0
    at = first[:-1].copy()
    corners = np.empty((2, 3), np.int64)
    for number in range(len(triangles)):
        _reach(vertices, triangles[number], shift, low, size, corners)
        for k in range(corners[0, 2], corners[1, 2] + 1):
            for j in range(corners[0, 1], corners[1, 1] + 1):
                for i in range(corners[0, 0], corners[1, 0] + 1):
                    bucket = (k * size[1] + j) * size[0] + i
                    if is_counting:
                        first[bucket + 1] += 1
                    else:
                        members[at[bucket]] = number
                        at[bucket] += 1
    if is_counting:
        for bucket in range(len(first) - 1):
            first[bucket + 1] += first[bucket]


@kernel(cached=False)
def _reach(vertices, triangle, shift, low, size, corners):
    """First and last bucket along each axis that a triangle reaches into."""
    for axis in range(3):
        a, b, c = vertices[triangle[0], axis], vertices[triangle[1], axis], vertices[triangle[2], axis]
        corners[0, axis] = max((min(a, b, c) >> shift) - low[axis], 0)
        corners[1, axis] = min((max(a, b, c) >> shift) - low[axis], size[axis] - 1)


@kernel(cached=False)
def _apart(one, of_one, other, of_other):
    """Whether the boxes around two triangles are apart."""
    for axis in range(3):
        a = one[of_one[0], axis], one[of_one[1], axis], one[of_one[2], axis]
        b = other[of_other[0], axis], other[of_other[1], axis], other[of_other[2], axis]
        if max(a) < min(b) or max(b) < min(a):
            return True
    return False


@kernel(cached=False)
def _write_end(side, ends, weights, count, key, on_surface, on_sheet):
    """Write the first (1) or last (-1) end of an arc."""
    row = 0 if side > 0 else 1
    ends[count, row] = key
    weights[count, row, 0, :] = on_surface
    weights[count, row, 1, :] = on_sheet


@kernel(cached=False)
def _shares(one, two, three):
    total = one + two + three
    if total == 0.0:
        return 1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0
    return one / total, two / total, three / total


@kernel(cached=False)
def _between(side, share):
    """Weights of a place on the edge from corner ``side`` on, at ``share`` of it."""
    weights = np.zeros(3)
    weights[side] = 1.0 - share
    weights[(side + 1) % 3] = share
    return weights


@kernel(cached=False)
def _cross_two(surface, of_surface, surface_edges, sheet, of_sheet, sheet_edges, numbers, ends, weights, count):
    """Write the arc of two triangles; returns how many ends it has (two, or none)."""
    corners, others = surface[of_surface], sheet[of_sheet]
    p, q, r = others[0], others[1], others[2]
    a, b, c = corners[0], corners[1], corners[2]
    sides = np.empty(3, np.int64)
    for n in range(3):
        sides[n] = tissue_side(p, q, r, corners[n])
    if sides[0] == sides[1] == sides[2] and sides[0] != 0:
        return 0
    others_sides = np.empty(3, np.int64)
    for n in range(3):
        others_sides[n] = sheet_side(a, b, c, others[n])
    if others_sides[0] == others_sides[1] == others_sides[2] and others_sides[0] != 0:
        return 0
    # On which side edge m of the surface passes edge n of the sheet.
    pass_side = np.empty((3, 3), np.int64)
    for m in range(3):
        for n in range(3):
            pass_side[m, n] = line_side(corners[m], corners[(m + 1) % 3], others[n], others[(n + 1) % 3])
    found = 0
    for m in range(3):
        one, other = m, (m + 1) % 3
        if sides[one] == sides[other] or sides[one] == 0 or sides[other] == 0:
            continue
        if not (pass_side[m, 0] == pass_side[m, 1] == pass_side[m, 2] and pass_side[m, 0] != 0):
            continue
        there, beyond = float(volume(p, q, r, corners[one])), float(volume(p, q, r, corners[other]))
        share = there / (there - beyond) if there != beyond else 0.5
        volumes = np.empty(3)
        for n in range(3):
            volumes[n] = abs(float(volume(corners[one], corners[other], others[n], others[(n + 1) % 3])))
        third, first, second = _shares(volumes[0], volumes[1], volumes[2])
        on_sheet = np.array([first, second, third])
        key = (np.int64(surface_edges[m]) << 31) | np.int64(numbers[1])
        _write_end(-sides[one], ends, weights, count, key, _between(m, share), on_sheet)
        found += 1
    for n in range(3):
        one, other = n, (n + 1) % 3
        if others_sides[one] == others_sides[other] or others_sides[one] == 0 or others_sides[other] == 0:
            continue
        if not (pass_side[0, n] == pass_side[1, n] == pass_side[2, n] and pass_side[0, n] != 0):
            continue
        there, beyond = float(volume(a, b, c, others[one])), float(volume(a, b, c, others[other]))
        share = there / (there - beyond) if there != beyond else 0.5
        volumes = np.empty(3)
        for m in range(3):
            volumes[m] = abs(float(volume(corners[m], corners[(m + 1) % 3], others[one], others[other])))
        third, first, second = _shares(volumes[0], volumes[1], volumes[2])
        on_surface = np.array([first, second, third])
        key = (np.int64(1) << 62) | (np.int64(sheet_edges[n]) << 31) | np.int64(numbers[0])
        _write_end(others_sides[one], ends, weights, count, key, on_surface, _between(n, share))
        found += 1
    return found


@kernel
def cross_surface(
    vertices, triangles, edges, buckets, sheet_vertices, sheet_triangles, sheet_edges, asked, pairs, ends, weights
):
    """Write the arcs of a surface and triangles of a sheet as long as there is room; returns how many there are.

    Parameters
    ----------
    vertices, triangles, edges
        Of the surface: whole numbers, vertex numbers, and the number of the edge that follows each corner.
    buckets
        ``(shift, low, size, first, members)`` of :func:`fill_buckets`.
    sheet_vertices, sheet_triangles, sheet_edges
        The same of the sheet.
    asked
        Which triangles of the sheet are asked for.
    pairs
        Triangle of the surface and of the sheet of each arc, shape (room, 2), written.
    ends
        Key of each arc's first and last end, shape (room, 2), written: edge of the surface << 31 | triangle of the
        sheet, or 1 << 62 | edge of the sheet << 31 | triangle of the surface.
    weights
        Barycentric place of both ends in both triangles, shape (room, 2, 2, 3): end, surface or sheet, corner; written.
    """
    shift, low, size, first, members = buckets
    count = 0
    reach = np.empty((2, 3), np.int64)
    own = np.empty((2, 3), np.int64)
    # Where there is no room ends are written over one another.
    spare_ends, spare_weights = np.empty((1, 2), np.int64), np.empty((1, 2, 2, 3))
    for number in asked:
        of_sheet = sheet_triangles[number]
        _reach(sheet_vertices, of_sheet, shift, low, size, reach)
        for k in range(reach[0, 2], reach[1, 2] + 1):
            for j in range(reach[0, 1], reach[1, 1] + 1):
                for i in range(reach[0, 0], reach[1, 0] + 1):
                    bucket = (k * size[1] + j) * size[0] + i
                    for at in range(first[bucket], first[bucket + 1]):
                        triangle = members[at]
                        of_surface = triangles[triangle]
                        if _apart(vertices, of_surface, sheet_vertices, of_sheet):
                            continue
                        # Two that share buckets meet in the first of them alone.
                        _reach(vertices, of_surface, shift, low, size, own)
                        if (
                            max(own[0, 0], reach[0, 0]) != i
                            or max(own[0, 1], reach[0, 1]) != j
                            or max(own[0, 2], reach[0, 2]) != k
                        ):
                            continue
                        has_room = count < len(pairs)
                        found = _cross_two(
                            vertices,
                            of_surface,
                            edges[triangle],
                            sheet_vertices,
                            of_sheet,
                            sheet_edges[number],
                            (triangle, number),
                            ends if has_room else spare_ends,
                            weights if has_room else spare_weights,
                            count if has_room else 0,
                        )
                        if found:
                            if has_room:
                                pairs[count, 0], pairs[count, 1] = triangle, number
                            count += 1
    return count


@kernel
def renumber_ends(ends, triangles, edges):
    """Let keys of ends name triangles and edges of sheets by their new numbers."""
    mask, of_sheet = np.int64(0x7FFFFFFF), np.int64(1) << 62
    for n in range(len(ends)):
        for end in range(2):
            key = ends[n, end]
            if key < 0:
                key = -1 - key
                ends[n, end] = -1 - ((edges[key >> 31] << 31) | triangles[key & mask])
            elif key >= of_sheet:
                key ^= of_sheet
                ends[n, end] = of_sheet | (edges[key >> 31] << 31) | (key & mask)
            else:
                ends[n, end] = (key & ~mask) | triangles[key & mask]


@kernel
def is_inside(vertices, triangles, buckets, point):
    """Whether a corner of a sheet lies inside a closed surface: by what a ray along x crosses."""
    shift, low, size, first, members = buckets
    far, own = np.empty(3, np.int64), np.empty((2, 3), np.int64)
    i, j, k = (point[0] >> shift) - low[0], (point[1] >> shift) - low[1], (point[2] >> shift) - low[2]
    if j < 0 or k < 0 or j >= size[1] or k >= size[2]:
        return False
    crossings, start = 0, max(i, 0)
    for bucket in range((k * size[1] + j) * size[0] + start, (k * size[1] + j + 1) * size[0]):
        for at in range(first[bucket], first[bucket + 1]):
            number = members[at]
            # Of the buckets along the ray that a triangle reaches into, it counts in the first.
            _reach(vertices, triangles[number], shift, low, size, own)
            if max(own[0, 0], start) != bucket % size[0]:
                continue
            a, b, c = vertices[triangles[number, 0]], vertices[triangles[number, 1]], vertices[triangles[number, 2]]
            most = max(a[0], b[0], c[0])
            if most < point[0] or min(a[1], b[1], c[1]) > point[1] or max(a[1], b[1], c[1]) < point[1]:
                continue
            if min(a[2], b[2], c[2]) > point[2] or max(a[2], b[2], c[2]) < point[2]:
                continue
            far[0], far[1], far[2] = most + 1, point[1], point[2]
            if sheet_side(a, b, c, point) == sheet_side(a, b, c, far):
                continue
            one = line_side(a, b, point, far)
            if one != 0 and one == line_side(b, c, point, far) and one == line_side(c, a, point, far):
                crossings += 1
    return crossings % 2 == 1
