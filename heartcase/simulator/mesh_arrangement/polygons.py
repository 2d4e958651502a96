"""Triangles of a polygon by cutting off its best ears: kernels.

Whatever the places of the corners are, a polygon of n corners gives n - 2 triangles that fill it as a disc: numbers
that are a little off may make a triangle poor, but never a hole.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = ["flip", "triangulate", "turn"]

_SEARCHED_MAX = 48
"""Corners up to which the best ear is looked for; of more the first good one is taken."""
_GOOD = 0.3


@kernel(cached=False)
def turn(a, b, c):
    """Twice the area of a triangle, above zero where it turns counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@kernel(cached=False)
def _shape(a, b, c):
    """Quality of a triangle: 1 if all edges are equal, 0 if it has no area."""
    squares = 0.0
    for axis in range(2):
        squares += (b[axis] - a[axis]) ** 2 + (c[axis] - b[axis]) ** 2 + (a[axis] - c[axis]) ** 2
    if squares == 0.0:
        return 0.0
    return 2.0 * sqrt(3.0) * turn(a, b, c) / squares


@kernel(cached=False)
def _same(a, b):
    return a[0] == b[0] and a[1] == b[1]


@kernel(cached=False)
def _is_free(polygon, count, at, nodes, places):
    """Whether nothing of the polygon lies in the ear at a corner."""
    before, here, after = polygon[(at - 1) % count], polygon[at], polygon[(at + 1) % count]
    a, b, c = places[before], places[here], places[after]
    for n in range(count):
        one, other = polygon[n], polygon[(n + 1) % count]
        p, q = places[one], places[other]
        is_corner = nodes[one] == nodes[before] or nodes[one] == nodes[here] or nodes[one] == nodes[after]
        is_corner = is_corner or _same(p, a) or _same(p, b) or _same(p, c)
        if not is_corner and turn(a, b, p) >= 0.0 and turn(b, c, p) >= 0.0 and turn(c, a, p) >= 0.0:
            return False
        touches = nodes[one] == nodes[before] or nodes[one] == nodes[after]
        if touches or nodes[other] == nodes[before] or nodes[other] == nodes[after]:
            continue
        if (turn(a, c, p) > 0.0) != (turn(a, c, q) > 0.0) and (turn(p, q, a) > 0.0) != (turn(p, q, c) > 0.0):
            return False
    return True


@kernel(cached=False)
def _ear(polygon, count, nodes, places):
    """Corner whose ear is cut off next."""
    best, found = 0.0, -1
    spare, most, any_way = -1, -np.inf, 0
    for at in range(count):
        before, here, after = polygon[(at - 1) % count], polygon[at], polygon[(at + 1) % count]
        if nodes[before] == nodes[after] or nodes[before] == nodes[here] or nodes[here] == nodes[after]:
            continue
        quality = _shape(places[before], places[here], places[after])
        any_way = at
        if quality > most:
            spare, most = at, quality
        if quality > best and _is_free(polygon, count, at, nodes, places):
            best, found = quality, at
            if count > _SEARCHED_MAX and quality > _GOOD:
                break
    if found >= 0:
        return found
    return spare if spare >= 0 else any_way


@kernel(cached=False)
def triangulate(polygon, count, nodes, places, triangles, first):
    """Write triangles of a polygon from row ``first`` on; returns the row after them.

    Parameters
    ----------
    polygon, count
        Corners, counter-clockwise; written over.
    nodes, places
        Node and place of every corner; a node may be there more than once.
    triangles
        Three corners in each row, written.
    """
    while count >= 3:
        at = _ear(polygon, count, nodes, places) if count > 3 else 1
        triangles[first, 0] = polygon[(at - 1) % count]
        triangles[first, 1] = polygon[at]
        triangles[first, 2] = polygon[(at + 1) % count]
        first += 1
        for n in range(at, count - 1):
            polygon[n] = polygon[n + 1]
        count -= 1
    return first


@kernel(cached=False)
def flip(triangles, first, last, nodes, places):
    """Turn edges between two triangles of a face where that makes the worse of the two better, in some rows.

    Parameters
    ----------
    triangles, first, last
        Three corners in each row; which rows are of the face; changed.
    nodes, places
        Node and place of every corner.
    """
    for _ in range(4 * (last - first)):
        is_done = True
        for one in range(first, last):
            for side in range(3):
                a, b, c = triangles[one, side], triangles[one, (side + 1) % 3], triangles[one, (side + 2) % 3]
                for other in range(one + 1, last):
                    there = -1
                    for n in range(3):
                        if triangles[other, n] == b and triangles[other, (n + 1) % 3] == a:
                            there = n
                    if there < 0:
                        continue
                    d = triangles[other, (there + 2) % 3]
                    if nodes[c] == nodes[d] or nodes[a] == nodes[d] or nodes[b] == nodes[d]:
                        break
                    now = min(_shape(places[a], places[b], places[c]), _shape(places[b], places[a], places[d]))
                    turned = min(_shape(places[c], places[a], places[d]), _shape(places[d], places[b], places[c]))
                    if turned > now + 1e-9 and turned > 0.0:
                        triangles[one, 0], triangles[one, 1], triangles[one, 2] = c, a, d
                        triangles[other, 0], triangles[other, 1], triangles[other, 2] = d, b, c
                        is_done = False
                        a, b, c = triangles[one, side], triangles[one, (side + 1) % 3], triangles[one, (side + 2) % 3]
                    break
        if is_done:
            return
