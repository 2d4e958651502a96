"""Kernels: whether a straight shaft touches a surface, and how near a segment comes to a triangle.

A shaft is a segment with a radius: it touches a triangle that is nearer to the segment than that. A line of sight is a
shaft without one. The distance of a segment to a triangle is zero where it goes through it (Moller and Trumbore, J.
Graphics Tools 2, 1997), else the least of its ends' distances to the triangle and its distances to the three edges
(Ericson, Real-Time Collision Detection, 2005, 5.1).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import prange

from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Bool, Float64, Int64
from heartcase.simulator.incisions.triangle_tree import LEAF_TRIANGLES, TriangleTree

__all__ = ["can_stand", "nearest_triangles", "touches"]

_LEANS = 5
"""Directions between the axis and the middle of an opening that are tried first."""
_DEEPEST = 64
"""Nodes that wait to be looked at: more than two for each level of any tree that fits in memory."""


def touches(tree: TriangleTree, starts_mm: npt.ArrayLike, ends_mm: npt.ArrayLike, radius_mm: float = 0.0) -> Bool:
    """Whether shafts touch a surface.

    Parameters
    ----------
    tree
        The surface.
    starts_mm, ends_mm
        Ends of each shaft's axis, mm, shape (count, 3).
    radius_mm
        Radius of the shafts, mm; lines where it is 0.

    Returns
    -------
    ndarray
        Shape (count,).
    """
    starts, ends = (np.ascontiguousarray(np.asarray(one, dtype=float).reshape(-1, 3)) for one in (starts_mm, ends_mm))
    touched = np.zeros(len(starts), np.bool_)
    _touched(starts, ends, float(radius_mm), *tree.arrays, touched)
    return touched


def can_stand(
    tree: TriangleTree,
    tips_mm: Float64,
    gates_mm: Float64,
    fan_mm: Float64,
    axis: Float64,
    half_angle_deg: float,
    length_mm: float,
    radius_mm: float,
) -> Bool:
    """Whether a shaft can stand through an opening with its tip at a place.

    Tried are directions between the axis and the middle of the opening, then those through points of the opening.

    Parameters
    ----------
    tree
        The surface.
    tips_mm
        Tips, mm, shape (tip_count, 3).
    gates_mm
        Points of the opening, the first its middle, mm, shape (gate_count, 3).
    fan_mm
        Triangles that fill the opening, mm, shape (count, 3, 3).
    axis
        From the tip outward, in the middle of how the shaft may stand, unit length, shape (3,).
    half_angle_deg
        How far it may lean from there, degrees.
    length_mm
        Length of the shaft, mm.
    radius_mm
        Its radius, mm.

    Returns
    -------
    ndarray
        Shape (tip_count,).
    """
    found = np.zeros(len(tips_mm), np.bool_)
    arrays = (np.ascontiguousarray(one, dtype=np.float64) for one in (tips_mm, gates_mm, fan_mm, axis))
    _can_stand(*arrays, np.radians(half_angle_deg), float(length_mm), float(radius_mm), *tree.arrays, found)
    return found


def nearest_triangles(starts_mm: Float64, ends_mm: Float64, corners_mm: Float64) -> tuple[Float64, Int64]:
    """Distance of each segment to the nearest of some triangles, mm, and that triangle's number; shape (count,) each.

    Parameters
    ----------
    starts_mm, ends_mm
        Ends of the segments, mm, shape (count, 3).
    corners_mm
        Corners of the triangles, mm, shape (triangle_count, 3, 3); at least one.
    """
    square, number = np.full(len(starts_mm), np.inf), np.zeros(len(starts_mm), np.int64)
    arguments = (np.ascontiguousarray(one, dtype=np.float64) for one in (starts_mm, ends_mm, corners_mm))
    _nearest(*arguments, square, number)
    return np.sqrt(square), number


@kernel(cached=False)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(cached=False)
def _minus(a, b):
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@kernel(cached=False)
def _along(a, d, t):
    return (a[0] + t * d[0], a[1] + t * d[1], a[2] + t * d[2])


@kernel(cached=False)
def _cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel(cached=False)
def _clamped(x):
    return min(max(x, 0.0), 1.0)


@kernel(cached=False)
def _goes_through(p, q, a, b, c):
    """Whether the segment from p to q meets the triangle, its rim included."""
    d, e, f = _minus(q, p), _minus(b, a), _minus(c, a)
    h = _cross(d, f)
    det = _dot(e, h)
    if abs(det) < 1e-300:
        return False
    s = _minus(p, a)
    u = _dot(s, h) / det
    g = _cross(s, e)
    v = _dot(d, g) / det
    t = _dot(f, g) / det
    return u >= 0.0 and v >= 0.0 and u + v <= 1.0 and t >= 0.0 and t <= 1.0


@kernel(cached=False)
def _square_to_edge(p, q, a, b):
    """Square of the distance between the segments p q and a b."""
    d, e, r = _minus(q, p), _minus(b, a), _minus(p, a)
    dd, ee, de = _dot(d, d), _dot(e, e), _dot(d, e)
    dr, er = _dot(d, r), _dot(e, r)
    det = dd * ee - de * de
    s = 0.0
    if det > 1e-12 * dd * ee:
        s = _clamped((de * er - dr * ee) / det)
    t = 0.0
    if ee > 0.0:
        t = (de * s + er) / ee
        if t < 0.0 or t > 1.0:
            t = _clamped(t)
            if dd > 0.0:
                s = _clamped((de * t - dr) / dd)
    elif dd > 0.0:
        s = _clamped(-dr / dd)
    gap = _minus(_along(p, d, s), _along(a, e, t))
    return _dot(gap, gap)


@kernel(cached=False)
def _square_to_face(p, a, b, c):
    """Square of the distance of a point to the plane of a triangle, where its foot lies inside; else infinite."""
    n = _cross(_minus(b, a), _minus(c, a))
    nn = _dot(n, n)
    if nn <= 0.0:
        return np.inf
    inside = (
        _dot(_cross(_minus(b, a), _minus(p, a)), n) >= 0.0
        and _dot(_cross(_minus(c, b), _minus(p, b)), n) >= 0.0
        and _dot(_cross(_minus(a, c), _minus(p, c)), n) >= 0.0
    )
    if not inside:
        return np.inf
    height = _dot(_minus(p, a), n)
    return height * height / nn


@kernel(cached=False)
def _square_to_triangle(p, q, a, b, c):
    """Square of the distance of the segment p q to a triangle."""
    if _goes_through(p, q, a, b, c):
        return 0.0
    square = min(_square_to_face(p, a, b, c), _square_to_face(q, a, b, c))
    square = min(square, _square_to_edge(p, q, a, b))
    square = min(square, _square_to_edge(p, q, b, c))
    return min(square, _square_to_edge(p, q, c, a))


@kernel(cached=False)
def _corner(corners, triangle, number):
    return (corners[triangle, number, 0], corners[triangle, number, 1], corners[triangle, number, 2])


@kernel(cached=False)
def _passes_box(p, d, boxes, node, radius):
    """Whether the segment from p along d comes into a box that is larger by the radius on every side."""
    enters, leaves = 0.0, 1.0
    for axis in range(3):
        low, high = boxes[node, 0, axis] - radius, boxes[node, 1, axis] + radius
        if d[axis] == 0.0:
            if p[axis] < low or p[axis] > high:
                return False
        else:
            first, second = (low - p[axis]) / d[axis], (high - p[axis]) / d[axis]
            enters, leaves = max(enters, min(first, second)), min(leaves, max(first, second))
    return enters <= leaves


@kernel(cached=False)
def _is_touched(p, q, radius, corners, boxes, leaf_start):
    d = _minus(q, p)
    square = radius * radius
    waiting = np.empty(_DEEPEST, np.int64)
    waiting[0], count = 0, 1
    while count > 0:
        count -= 1
        node = waiting[count]
        if boxes[node, 0, 0] > boxes[node, 1, 0] or not _passes_box(p, d, boxes, node, radius):
            continue
        if node < leaf_start:
            waiting[count], waiting[count + 1] = 2 * node + 1, 2 * node + 2
            count += 2
            continue
        first = (node - leaf_start) * LEAF_TRIANGLES
        for triangle in range(first, min(first + LEAF_TRIANGLES, len(corners))):
            a, b, c = _corner(corners, triangle, 0), _corner(corners, triangle, 1), _corner(corners, triangle, 2)
            if radius > 0.0:
                if _square_to_triangle(p, q, a, b, c) <= square:
                    return True
            elif _goes_through(p, q, a, b, c):
                return True
    return False


@loop_kernel
def _touched(starts, ends, radius, corners, boxes, leaf_start, touched):
    for number in prange(len(starts)):
        p = (starts[number, 0], starts[number, 1], starts[number, 2])
        q = (ends[number, 0], ends[number, 1], ends[number, 2])
        touched[number] = _is_touched(p, q, radius, corners, boxes, leaf_start)


@kernel(cached=False)
def _is_free(p, q, radius, corners, boxes, leaf_start):
    # Most shafts that touch do so with their axis, which is quicker to see.
    if _is_touched(p, q, 0.0, corners, boxes, leaf_start):
        return False
    return radius == 0.0 or not _is_touched(p, q, radius, corners, boxes, leaf_start)


@kernel(cached=False)
def _leans_free(p, towards, axis, fan, lean, length, radius, corners, boxes, leaf_start):
    """Whether a shaft stands free that leans from the axis towards a place, as far as it may or less."""
    along = _dot(towards, axis)
    side = _minus(towards, (along * axis[0], along * axis[1], along * axis[2]))
    size = np.sqrt(_dot(side, side))
    most = min(np.arctan2(size, along), lean)
    if size == 0.0:
        size, most = 1.0, 0.0
    for number in range(_LEANS):
        angle = most * (_LEANS - 1 - number) / (_LEANS - 1)
        q = _along(_along(p, axis, length * np.cos(angle)), side, length * np.sin(angle) / size)
        passes = False
        for one in range(len(fan)):
            if _goes_through(p, q, _corner(fan, one, 0), _corner(fan, one, 1), _corner(fan, one, 2)):
                passes = True
                break
        if passes and _is_free(p, q, radius, corners, boxes, leaf_start):
            return True
    return False


@loop_kernel
def _can_stand(tips, gates, fan, axis, lean, length, radius, corners, boxes, leaf_start, found):
    least_cosine = np.cos(lean)
    upward = (axis[0], axis[1], axis[2])
    for tip in prange(len(tips)):
        p = (tips[tip, 0], tips[tip, 1], tips[tip, 2])
        # A tip that is itself in touch with tissue is no place to be, whichever way the shaft stands.
        if _is_touched(p, _along(p, upward, 1e-9), radius, corners, boxes, leaf_start):
            continue
        middle = (gates[0, 0] - p[0], gates[0, 1] - p[1], gates[0, 2] - p[2])
        if _leans_free(p, middle, upward, fan, lean, length, radius, corners, boxes, leaf_start):
            found[tip] = True
            continue
        for gate in range(len(gates)):
            way = (gates[gate, 0] - p[0], gates[gate, 1] - p[1], gates[gate, 2] - p[2])
            size = np.sqrt(_dot(way, way))
            if size > length or size == 0.0 or _dot(way, upward) < least_cosine * size:
                continue
            if _is_free(p, _along(p, way, length / size), radius, corners, boxes, leaf_start):
                found[tip] = True
                break


@loop_kernel
def _nearest(starts, ends, corners, square, number):
    for one in prange(len(starts)):
        p = (starts[one, 0], starts[one, 1], starts[one, 2])
        q = (ends[one, 0], ends[one, 1], ends[one, 2])
        for triangle in range(len(corners)):
            a, b, c = _corner(corners, triangle, 0), _corner(corners, triangle, 1), _corner(corners, triangle, 2)
            here = _square_to_triangle(p, q, a, b, c)
            if here < square[one]:
                square[one] = here
                number[one] = triangle
