"""Which links between samples triangles cross, in whole numbers: kernels.

A sample that lies on a triangle counts as moved by less than any number, first along y, then z, then x
(:mod:`heartcase.simulator.cutting.blade_sheet`).
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = ["QUANTA", "SAMPLES", "crossing_keys"]

SAMPLES = 8
"""Samples along each edge of a cell."""
QUANTA = 4096
"""Whole numbers along each edge of a cell."""
_PITCH = QUANTA // SAMPLES
_FIRST = _PITCH // 2
_OFFSET = 1 << 20


@kernel(cached=False)
def _sign(value, then, last):
    """Sign of the first number that is not zero."""
    chosen = value if value != 0 else then if then != 0 else last
    return 1 if chosen > 0 else -1 if chosen < 0 else 0


@kernel(cached=False)
def _side(p, q, b, c, at_b, at_c):
    """Side of the line through p and q on which a moved sample lies, seen along the third axis."""
    along_b, along_c = q[b] - p[b], q[c] - p[c]
    area = along_b * (at_c - p[c]) - along_c * (at_b - p[b])
    # Of the two axes, y moves most, then z.
    if b == 1 or (b == 2 and c == 0):
        return _sign(area, -along_c, along_b)
    return _sign(area, along_b, -along_c)


@kernel(cached=False)
def _normal(triangle, axis):
    """Component of the normal along an axis."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    p, q, r = triangle[0], triangle[1], triangle[2]
    return (q[b] - p[b]) * (r[c] - p[c]) - (q[c] - p[c]) * (r[b] - p[b])


@kernel(cached=False)
def _first_line(low):
    return -((_FIRST - low) // _PITCH)


@kernel(cached=False)
def _last_line(high):
    return (high - _FIRST) // _PITCH


@kernel(cached=False)
def _meets(triangle, b, c, facing, at_b, at_c):
    """Whether the line of samples at (b, c) goes through a triangle that faces it."""
    p, q, r = triangle[0], triangle[1], triangle[2]
    if _side(p, q, b, c, at_b, at_c) != facing or _side(q, r, b, c, at_b, at_c) != facing:
        return False
    return _side(r, p, b, c, at_b, at_c) == facing


@kernel(cached=False)
def _plane(triangle, axis):
    """Normal of a triangle, turned along an axis and the two after it, and whether a sample on it lies behind it."""
    n_a, n_b, n_c = _normal(triangle, axis), _normal(triangle, (axis + 1) % 3), _normal(triangle, (axis + 2) % 3)
    if n_a < 0:
        n_a, n_b, n_c = -n_a, -n_b, -n_c
    normal = (n_a, n_b, n_c)
    n_y, n_z, n_x = normal[(1 - axis) % 3], normal[(2 - axis) % 3], normal[(3 - axis) % 3]
    return n_a, n_b, n_c, _sign(n_y, n_z, n_x) > 0


@kernel(cached=False)
def _reach(triangle, b, c, at_b):
    """Least and largest number along one axis of a triangle where it is met by a line along the other."""
    low, high = triangle[:, c].max(), triangle[:, c].min()
    for corner in range(3):
        p, q = triangle[corner], triangle[(corner + 1) % 3]
        if p[b] > q[b]:
            p, q = q, p
        if not p[b] <= at_b <= q[b]:
            continue
        if p[b] == q[b]:
            low, high = min(low, p[c], q[c]), max(high, p[c], q[c])
            continue
        there = p[c] + (at_b - p[b]) * (q[c] - p[c]) // (q[b] - p[b])
        low, high = min(low, there), max(high, there + 1)
    return low - 1, high + 1


@kernel
def crossing_keys(triangles, axis, low, high):
    """Links between samples along an axis that triangles cross, as often as they do, in no order.

    Parameters
    ----------
    triangles
        Corners, shape (count, 3, 3).
    axis
        0, 1 or 2.
    low, high
        Lines of samples that are asked for lie from one index (i, j, k) to the other, shape (3,).

    Returns
    -------
    ndarray
        The key (:func:`heartcase.schemas.bundle.lattice.lattice_keys`) of each link's lower sample, int64.
    """
    b, c = (axis + 1) % 3, (axis + 2) % 3
    keys, count = np.empty(256 + 64 * len(triangles), np.int64), 0
    for number in range(len(triangles)):
        triangle = triangles[number]
        facing = _sign(_normal(triangle, axis), 0, 0)
        if facing == 0:
            continue
        n_a, n_b, n_c, is_behind = _plane(triangle, axis)
        p_a, p_b, p_c = triangle[0, axis], triangle[0, b], triangle[0, c]
        start, rest = (p_a - _FIRST) // _PITCH, (p_a - _FIRST) % _PITCH
        first, last = _first_line(triangle[:, b].min()), _last_line(triangle[:, b].max())
        for line_b in range(max(first, low[b]), min(last, high[b]) + 1):
            at_b = _FIRST + _PITCH * line_b
            least, most = _reach(triangle, b, c, at_b)
            line, last_line = max(_first_line(least), low[c]), min(_last_line(most), high[c])
            # A triangle is convex: what it meets of the lines of a row lies between the first and the last of them.
            while line <= last_line and not _meets(triangle, b, c, facing, at_b, _FIRST + _PITCH * line):
                line += 1
            while line <= last_line and not _meets(triangle, b, c, facing, at_b, _FIRST + _PITCH * last_line):
                last_line -= 1
            while count + last_line + 1 - line > len(keys):
                keys = np.append(keys, np.empty(len(keys), np.int64))
            for line_c in range(line, last_line + 1):
                # The last sample of a line before the triangle that the line goes through.
                way = rest * n_a - n_b * (at_b - p_b) - n_c * (_FIRST + _PITCH * line_c - p_c)
                steps = way // (_PITCH * n_a)
                if is_behind and way == steps * (_PITCH * n_a):
                    steps -= 1
                link = (start + steps + _OFFSET) << 21 * axis
                link |= (line_b + _OFFSET) << 21 * b | (line_c + _OFFSET) << 21 * c
                keys[count] = link
                count += 1
    return keys[:count].copy()
