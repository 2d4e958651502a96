"""Where triangles of sheets cross one another, in whole numbers: kernels.

Each corner counts as moved by less than any number along a direction of its own, those of lower number the further. So
four corners never lie in one plane, and sheets that lie in one another, or meet in their corners, cross like any.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.mesh_arrangement.exact_sides import volume

__all__ = ["cross_triangles", "directions_of", "order_around"]


@kernel(cached=False)
def _determinant(rows):
    """Determinant of four rows of four."""
    total = 0
    for n in range(4):
        a, b, c = rows[(n + 1) % 4], rows[(n + 2) % 4], rows[(n + 3) % 4]
        minor = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
        minor += a[2] * (b[0] * c[1] - b[1] * c[0])
        total += rows[n, 3] * (minor if n % 2 == 1 else -minor)
    return total


@kernel(cached=False)
def _direction(place):
    """Direction in which a corner counts as moved."""
    mixed = np.int64(place[0]) * 73856093 ^ np.int64(place[1]) * 19349663 ^ np.int64(place[2]) * 83492791
    mixed = (mixed ^ (mixed >> 13)) * 1274126177 & 0x7FFFFFFF
    return mixed % 1021 - 510, (mixed >> 10) % 1019 - 509, (mixed >> 20) % 1013 - 506


@kernel
def directions_of(places):
    """Directions in which corners count as moved, shape (count, 3)."""
    found = np.empty((len(places), 3), np.int64)
    for n in range(len(places)):
        found[n, 0], found[n, 1], found[n, 2] = _direction(places[n])
    return found


@kernel(cached=False)
def _side(vertices, p, q, r, m):
    """Side of a triangle on which a corner lies, or on which the edge from p to q passes that from r to m."""
    found = volume(vertices[p], vertices[q], vertices[r], vertices[m])
    if found != 0:
        return 1 if found > 0 else -1
    numbers = np.array([p, q, r, m])
    order = np.argsort(numbers)
    rows, moved = np.empty((4, 4), np.int64), np.empty((4, 4), np.int64)
    for n in range(4):
        x, y, z = _direction(vertices[numbers[n]])
        moved[n, 0], moved[n, 1], moved[n, 2], moved[n, 3] = x, y, z, 0
        for axis in range(3):
            rows[n, axis] = vertices[numbers[n], axis] - vertices[p, axis]
        rows[n, 3] = 1
    for one in range(4):
        changed = rows.copy()
        changed[order[one]] = moved[order[one]]
        found = _determinant(changed)
        if found != 0:
            return -1 if found > 0 else 1
    for one in range(4):
        for other in range(one + 1, 4):
            changed = rows.copy()
            changed[order[one]], changed[order[other]] = moved[order[one]], moved[order[other]]
            found = _determinant(changed)
            if found != 0:
                return -1 if found > 0 else 1
    return 1


@kernel(cached=False)
def _heights(vertices, triangle, a, b):
    """How far two corners lie from a triangle's plane; if both lie in it, how far they are moved from it."""
    p, q, r = triangle[0], triangle[1], triangle[2]
    there = volume(vertices[p], vertices[q], vertices[r], vertices[a])
    beyond = volume(vertices[p], vertices[q], vertices[r], vertices[b])
    if there != 0 or beyond != 0:
        return float(there), float(beyond)
    numbers = np.array([p, q, r, a, b])
    rows = np.empty((5, 4), np.int64)
    for n in range(5):
        for axis in range(3):
            rows[n, axis] = vertices[numbers[n], axis] - vertices[p, axis]
        rows[n, 3] = 1
    for one in np.argsort(numbers):
        changed = rows.copy()
        x, y, z = _direction(vertices[numbers[one]])
        changed[one, 0], changed[one, 1], changed[one, 2], changed[one, 3] = x, y, z, 0
        there = _determinant(changed[:4]) if one < 4 else 0
        changed[3] = changed[4] if one == 4 else rows[4]
        beyond = _determinant(changed[:4]) if one != 3 else 0
        if there != 0 or beyond != 0:
            return float(there), float(beyond)
    return 1.0, -1.0


@kernel(cached=False)
def _shares(vertices, triangle, p, q, share):
    """Barycentric place where the line from p to q goes through a triangle, at a share of its way."""
    volumes = np.empty(3)
    for n in range(3):
        a, b = vertices[triangle[n]], vertices[triangle[(n + 1) % 3]]
        volumes[(n + 2) % 3] = abs(float(volume(vertices[p], vertices[q], a, b)))
    total = volumes.sum()
    if total != 0.0:
        return volumes / total
    place = vertices[p] + share * (vertices[q] - vertices[p])
    one, other = vertices[triangle[1]] - vertices[triangle[0]], vertices[triangle[2]] - vertices[triangle[0]]
    way = place - vertices[triangle[0]]
    aa, ab, bb, wa, wb = 0.0, 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        u, v, w = float(one[axis]), float(other[axis]), way[axis]
        aa, ab, bb, wa, wb = aa + u * u, ab + u * v, bb + v * v, wa + w * u, wb + w * v
    determinant = aa * bb - ab * ab
    volumes[:] = 1.0 / 3.0
    if determinant > 0.0:
        volumes[1], volumes[2] = (bb * wa - ab * wb) / determinant, (aa * wb - ab * wa) / determinant
        volumes[0] = 1.0 - volumes[1] - volumes[2]
    return volumes


@kernel(cached=False)
def _pierce(vertices, triangles, edges, one, other, ends, weights, corners, count, first):
    """Write where edges of triangle ``one`` go through triangle ``other``; returns how many ends the arc then has."""
    found = 0
    of_one, of_other = triangles[one], triangles[other]
    p, q, r = of_other[0], of_other[1], of_other[2]
    for n in range(3):
        a, b = of_one[n], of_one[(n + 1) % 3]
        if a in (p, q, r) or b in (p, q, r):
            continue
        # A line's side is asked for in one way from both triangles that the edge is of.
        low, high = min(a, b), max(a, b)
        side = _side(vertices, p, q, r, a)
        if side == _side(vertices, p, q, r, b):
            continue
        passing = _side(vertices, low, high, p, q)
        if passing != _side(vertices, low, high, q, r) or passing != _side(vertices, low, high, r, p):
            continue
        there, beyond = _heights(vertices, of_other, a, b)
        share = there / (there - beyond) if there != beyond else 0.5
        starts = side < 0 if first == 0 else side > 0
        row = 0 if starts else 1
        ends[count, row] = -1 - ((np.int64(edges[one, n]) << 31) | np.int64(other))
        weights[count, row, first, :] = 0.0
        weights[count, row, first, n], weights[count, row, first, (n + 1) % 3] = 1.0 - share, share
        weights[count, row, 1 - first, :] = _shares(vertices, of_other, a, b, share)
        corners[count, row] = -1
        found += 1
    return found


@kernel(cached=False)
def _shared(triangles, one, other):
    """How many corners two triangles share, and the places of the last of these in both."""
    count, here, there = 0, 0, 0
    for m in range(3):
        for n in range(3):
            if triangles[one, m] == triangles[other, n]:
                count, here, there = count + 1, m, n
    return count, here, there


@kernel(cached=False)
def _is_beside(vertices, one, other, shared):
    """Whether a triangle lies on one side of another's plane, or, sharing a corner, in it."""
    for first, second in ((one, other), (other, one)):
        p, q, r = vertices[first[0]], vertices[first[1]], vertices[first[2]]
        above, below = 0, 0
        for n in range(3):
            height = volume(p, q, r, vertices[second[n]])
            above += height > 0
            below += height < 0
        if above + below + shared == 3 and (above == 0 or below == 0):
            return True
        if above + below == 0 and shared == 1:
            return True
    return False


@kernel(cached=False)
def _reach(vertices, triangle, shift, low, size, box):
    """Lowest and highest corner of a triangle, and the buckets that it reaches into, shape (4, 3)."""
    for axis in range(3):
        a, b, c = vertices[triangle[0], axis], vertices[triangle[1], axis], vertices[triangle[2], axis]
        box[0, axis], box[1, axis] = min(a, b, c), max(a, b, c)
        box[2, axis] = max((box[0, axis] >> shift) - low[axis], 0)
        box[3, axis] = min((box[1, axis] >> shift) - low[axis], size[axis] - 1)


@kernel(cached=False)
def _are_apart(one, other):
    """Whether the boxes around two triangles are apart, or share no bucket."""
    for axis in range(3):
        if one[0, axis] > other[1, axis] or other[0, axis] > one[1, axis]:
            return True
        if one[2, axis] > other[3, axis] or other[2, axis] > one[3, axis]:
            return True
    return False


@kernel
def cross_triangles(vertices, triangles, edges, asked, buckets, pairs, ends, weights, corners):
    """Write the arcs of some triangles of sheets as long as there is room; returns how many there are.

    Parameters
    ----------
    vertices, triangles, edges
        Of :class:`heartcase.simulator.mesh_arrangement.sheet_mesh.SheetMesh`.
    asked
        Triangles that are asked for, ascending: with one another, and with all others.
    buckets
        ``(shift, low, size)``: only triangles that share a bucket of 2^shift along each edge cross.
    pairs, ends, weights
        As of :func:`heartcase.simulator.mesh_arrangement.surface_crossings.cross_surface`; keys of ends are
        -1 - (edge << 31 | triangle).
    corners
        Corner of both triangles in which an arc ends, else -1, shape (room, 2), written.
    """
    shift, low, size = buckets
    count, room = 0, len(pairs)
    spare_ends, spare_corners = np.empty((1, 2), np.int64), np.empty((1, 2), np.int64)
    spare_weights = np.empty((1, 2, 2, 3))
    is_asked = np.zeros(len(triangles), np.bool_)
    for number in asked:
        is_asked[number] = True
    boxes = np.empty((len(triangles), 4, 3), np.int64)
    for number in range(len(triangles)):
        _reach(vertices, triangles[number], shift, low, size, boxes[number])
    for number in asked:
        for second in range(len(triangles)):
            # Two that are asked for meet once.
            if second == number or (is_asked[second] and second < number):
                continue
            if _are_apart(boxes[number], boxes[second]):
                continue
            one, other = min(number, second), max(number, second)
            shared, here, there = _shared(triangles, one, other)
            if shared > 1 or _is_beside(vertices, triangles[one], triangles[other], shared):
                continue
            has_room = count < room
            e, w, c = (ends, weights, corners) if has_room else (spare_ends, spare_weights, spare_corners)
            row = count if has_room else 0
            c[row, 0] = c[row, 1] = -2
            found = _pierce(vertices, triangles, edges, one, other, e, w, c, row, 0)
            found += _pierce(vertices, triangles, edges, other, one, e, w, c, row, 1)
            if found == 1 and shared == 1:
                end = 0 if c[row, 0] == -2 else 1
                e[row, end] = e[row, 1 - end]
                c[row, end] = triangles[one, here]
                w[row, end, :, :] = 0.0
                w[row, end, 0, here] = w[row, end, 1, there] = 1.0
                found = 2
            if found != 2 or c[row, 0] == -2 or c[row, 1] == -2:
                continue
            if has_room:
                pairs[count, 0], pairs[count, 1] = one, other
            count += 1
    return count


@kernel
def order_around(vertices, triangles, edges, ends, ranks):
    """Number the triangles at each edge in their order around it, counter-clockwise seen against its way.

    Parameters
    ----------
    vertices, triangles, edges
        Of the mesh.
    ends
        Lower and higher vertex of each edge, shape (edge_count, 2).
    ranks
        Place in the order, shape (triangle_count, 3), written.
    """
    # Corners before each edge, 3 triangle + corner, edge by edge.
    first = np.zeros(len(ends) + 1, np.int64)
    for triangle in range(len(triangles)):
        for corner in range(3):
            first[edges[triangle, corner] + 1] += 1
    for edge in range(len(ends)):
        first[edge + 1] += first[edge]
    filled, members = first.copy(), np.empty(3 * len(triangles), np.int64)
    for triangle in range(len(triangles)):
        for corner in range(3):
            edge = edges[triangle, corner]
            members[filled[edge]] = 3 * triangle + corner
            filled[edge] += 1
    for edge in range(len(ends)):
        p, q = ends[edge, 0], ends[edge, 1]
        start, stop = first[edge], first[edge + 1]
        zero = triangles[members[start] // 3, (members[start] + 2 - 3 * (members[start] // 3)) % 3]
        for at in range(start, stop):
            triangle, corner = members[at] // 3, members[at] % 3
            third = triangles[triangle, (corner + 2) % 3]
            rank = 0
            for beyond in range(start, stop):
                other = triangles[members[beyond] // 3, (members[beyond] % 3 + 2) % 3]
                if beyond == at or other == third or third == zero:
                    continue
                if other == zero:
                    rank += 1
                    continue
                is_high = _side(vertices, p, q, zero, third) < 0
                other_is_high = _side(vertices, p, q, zero, other) < 0
                if is_high != other_is_high:
                    rank += is_high
                else:
                    rank += _side(vertices, p, q, other, third) > 0
            ranks[triangle, corner] = rank
