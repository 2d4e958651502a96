"""Sheets that hide one point from another: where their triangles are, and which lies between: kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float64, Int32, Int64
from heartcase.simulator.cutting.crossings import QUANTA

__all__ = ["SheetBuckets", "hiding_triangle", "lay_planes"]

_EDGE = 1e-9
_MOVED = (1e-9, 1e-5, 1e-7)
"""How far the tissue is moved against the sheets, which decides where it lies on them [cells]."""


class SheetBuckets(NamedTuple):
    """Triangles of sheets by where they lie."""

    low: Int64
    size: Int64
    first: Int64
    members: Int32
    planes: Float64
    """Where each triangle is (:func:`lay_planes`), shape (triangle_count, 13)."""
    boxes: Int64
    """Lowest and highest index of the cells that it reaches into, shape (triangle_count, 2, 3)."""


@kernel
def lay_planes(vertices, triangles, planes, boxes):
    """Write where triangles of sheets are: a corner, both edges from it, the normal, its square; and their cells.

    Parameters
    ----------
    vertices, triangles
        Of the sheets.
    planes, boxes
        Shape (triangle_count, 13), in cells, and lowest and highest index of the cells, (triangle_count, 2, 3);
        written.
    """
    for n in range(len(triangles)):
        p, q, r = vertices[triangles[n, 0]], vertices[triangles[n, 1]], vertices[triangles[n, 2]]
        ax, ay, az = (q[0] - p[0]) / QUANTA, (q[1] - p[1]) / QUANTA, (q[2] - p[2]) / QUANTA
        bx, by, bz = (r[0] - p[0]) / QUANTA, (r[1] - p[1]) / QUANTA, (r[2] - p[2]) / QUANTA
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        plane = planes[n]
        plane[0], plane[1], plane[2] = p[0] / QUANTA, p[1] / QUANTA, p[2] / QUANTA
        plane[3], plane[4], plane[5], plane[6], plane[7], plane[8] = ax, ay, az, bx, by, bz
        plane[9], plane[10], plane[11], plane[12] = nx, ny, nz, nx * nx + ny * ny + nz * nz
        for axis in range(3):
            boxes[n, 0, axis] = min(p[axis], q[axis], r[axis]) // QUANTA
            boxes[n, 1, axis] = max(p[axis], q[axis], r[axis]) // QUANTA


@kernel(cached=False)
def hiding_triangle(start, stop, sheets, reach, last):
    """Triangle of a sheet that lies between two points [cells], or -1; the one that hid another point is tried first.

    Only triangles in cells that the box around both points reaches into count.
    """
    for axis in range(3):
        least, most = min(start[axis], stop[axis]), max(start[axis], stop[axis])
        reach[0, axis] = max(int(np.floor(least)) - sheets.low[axis], 0)
        reach[1, axis] = min(int(np.floor(most)) - sheets.low[axis], sheets.size[axis] - 1)
    if last >= 0:
        is_near = True
        for axis in range(3):
            first, end = sheets.boxes[last, 0, axis] - sheets.low[axis], sheets.boxes[last, 1, axis] - sheets.low[axis]
            is_near = is_near and max(first, 0) <= reach[1, axis] and min(end, sheets.size[axis] - 1) >= reach[0, axis]
        if is_near and _is_between(start, stop, sheets.planes[last]):
            return last
    for k in range(reach[0, 2], reach[1, 2] + 1):
        for j in range(reach[0, 1], reach[1, 1] + 1):
            for i in range(reach[0, 0], reach[1, 0] + 1):
                bucket = (k * sheets.size[1] + j) * sheets.size[0] + i
                for at in range(sheets.first[bucket], sheets.first[bucket + 1]):
                    if _is_between(start, stop, sheets.planes[sheets.members[at]]):
                        return np.int64(sheets.members[at])
    return -1


@kernel(cached=False)
def _is_between(start, stop, plane):
    wx, wy, wz = stop[0] - start[0], stop[1] - start[1], stop[2] - start[2]
    nx, ny, nz = plane[9], plane[10], plane[11]
    sx, sy = start[0] + _MOVED[0] - plane[0], start[1] + _MOVED[1] - plane[1]
    sz = start[2] + _MOVED[2] - plane[2]
    height = nx * sx + ny * sy + nz * sz
    beyond = height + nx * wx + ny * wy + nz * wz
    if (height > 0.0) == (beyond > 0.0):
        return False
    ax, ay, az, bx, by, bz = plane[3], plane[4], plane[5], plane[6], plane[7], plane[8]
    share = height / (height - beyond)
    x, y, z = sx + share * wx, sy + share * wy, sz + share * wz
    second = (nx * (y * bz - z * by) + ny * (z * bx - x * bz) + nz * (x * by - y * bx)) / plane[12]
    third = (nx * (ay * z - az * y) + ny * (az * x - ax * z) + nz * (ax * y - ay * x)) / plane[12]
    return second >= -_EDGE and third >= -_EDGE and second + third <= 1.0 + _EDGE
