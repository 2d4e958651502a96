"""Distance to a region's border, to a stated tolerance, by branch and bound.

The value of a region (:mod:`heartcase.phantom.anatomy.regions`) changes its sign at the border and nowhere else, and
exceeds the distance to it by a factor of at most ``STEEPNESS``. So a cube around c with half diagonal r holds no border
if the value at c is above STEEPNESS * r, and a point of the other sign than the query's bounds the distance from above.
Cubes that may hold a nearer border are halved, nearest first, until none is left that matters. Nothing is assumed of
faces, edges or how they meet. (Branch and bound on Lipschitz functions: Shubert 1972; guaranteed intersections
with implicit surfaces by the same bound: Kalra and Barr 1989.)
"""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.phantom.anatomy.regions import CAVITY_COUNT, region_value

__all__ = ["STEEPNESS", "border_distances"]

STEEPNESS = 1.3
"""No region's value is more than this times the distance to its border (1 but for the splines' interpolation)."""
_PART = 16
"""Points that one task of a parallel loop takes; no result depends on it."""
_STACK = 512
_CHILDREN = (7, 6, 5, 3, 4, 2, 1, 0)
"""Octants from the farthest to the nearest, as seen from the query: the last one on the stack is looked at first."""


@kernel
def _border_distance(
    tables, ends, canals, thickness, wall_label, region, point, upper, tolerance, steepness, stack, d, c
):
    qx, qy, qz = point[0], point[1], point[2]
    inside = region_value(tables, ends, canals, thickness, wall_label, region, qx, qy, qz, d, c) < 0.0
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = qx, qy, qz, upper
    waiting = 1
    while waiting > 0:
        waiting -= 1
        x, y, z, half = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2], stack[waiting, 3]
        gx, gy, gz = max(abs(x - qx) - half, 0.0), max(abs(y - qy) - half, 0.0), max(abs(z - qz) - half, 0.0)
        if np.sqrt(gx * gx + gy * gy + gz * gz) >= upper - tolerance:
            continue
        value = region_value(tables, ends, canals, thickness, wall_label, region, x, y, z, d, c)
        away = np.sqrt((x - qx) ** 2 + (y - qy) ** 2 + (z - qz) ** 2)
        if (value < 0.0) != inside:
            # The ball around this point in which the sign cannot change lies behind the border.
            upper = min(upper, away - abs(value) / steepness)
        diagonal = np.sqrt(3.0) * half
        if abs(value) >= steepness * diagonal:
            continue
        if diagonal < 0.5 * tolerance:
            # Too small to halve. Beside a border the value is the distance but for the splines, so one passes here.
            if abs(value) < diagonal:
                upper = min(upper, away)
            continue
        quarter = 0.5 * half
        towards_x = -quarter if x > qx else quarter
        towards_y = -quarter if y > qy else quarter
        towards_z = -quarter if z > qz else quarter
        for octant in _CHILDREN:
            stack[waiting, 0] = x - towards_x if octant & 1 else x + towards_x
            stack[waiting, 1] = y - towards_y if octant & 2 else y + towards_y
            stack[waiting, 2] = z - towards_z if octant & 4 else z + towards_z
            stack[waiting, 3] = quarter
            waiting += 1
    return upper


@kernel
def _border_distances_part(
    tables, ends, canals, thickness, wall_label, region, points, upper, tolerance, steepness, distances, first, last
):
    d = np.empty(CAVITY_COUNT + 2)
    c = np.empty(CAVITY_COUNT)
    stack = np.empty((_STACK, 4))
    for n in range(first, last):
        distances[n] = _border_distance(
            tables,
            ends,
            canals,
            thickness,
            wall_label,
            region,
            points[n],
            upper[n],
            tolerance,
            steepness,
            stack,
            d,
            c,
        )


@loop_kernel
def border_distances(
    tables, ends, canals, thickness, wall_label, region, points, upper, tolerance, steepness, distances
):
    """Fill ``distances`` with the unsigned distance to a region's border at points, shape (n, 3).

    ``upper`` bounds each from above, mm: any border point's distance. The result is at most ``tolerance`` mm off.
    """
    count = points.shape[0]
    for part in numba.prange((count + _PART - 1) // _PART):
        _border_distances_part(
            tables,
            ends,
            canals,
            thickness,
            wall_label,
            region,
            points,
            upper,
            tolerance,
            steepness,
            distances,
            part * _PART,
            min(count, (part + 1) * _PART),
        )
