"""Exact distance from points to a triangle mesh, by a lattice of boxes."""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import called
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.kernels.vectors import square_to_triangle
from heartcase.pipeline.mesh.triangles.triangle_grid import TriangleGrid
from heartcase.schemas.arrays import Float64

__all__ = ["mesh_distance_mm", "nearest_on_mesh"]


SLACK = 1.0 + 1e-9
"""Boxes are taken to be nearer by this factor, so that rounding leaves none out."""


def mesh_distance_mm(points_mm: Float64, mesh: TriangleGrid) -> Float64:
    """Distance of each point to the nearest point of a mesh.

    Parameters
    ----------
    points_mm
        Shape (n, 3).
    mesh
        From :func:`~heartcase.pipeline.mesh.triangles.triangle_grid.triangle_grid`.

    Returns
    -------
    Float64
        Shape (n,), in mm.
    """
    distance = np.empty(len(points_mm))
    _query(np.ascontiguousarray(points_mm, dtype=np.float64), mesh, distance)
    return distance


@kernel(inline="always")
def _outside(place, begin, width):
    """How far a place is outside a stretch."""
    return max(begin - place, place - begin - width, 0.0)


@called
def nearest_on_mesh(grid, x, y, z, facing, way, least, farthest):
    """Nearest triangle to a point: its number, -1 where there is none, the square of the distance, two weights.

    ``facing`` are the unit normals of the triangles, and only those are looked at whose cosine with ``way`` is at least
    ``least``; without any normals all are. The grid is lent. Nothing need be found beyond ``farthest`` mm.
    """
    corner, origin, cell, size, start, item = grid.corner, grid.origin, grid.edge, grid.size, grid.start, grid.item
    i = min(max(int(np.floor((x - origin[0]) / cell)), 0), size[0] - 1)
    j = min(max(int(np.floor((y - origin[1]) / cell)), 0), size[1] - 1)
    k = min(max(int(np.floor((z - origin[2]) / cell)), 0), size[2] - 1)
    best, found, best_v, best_w = np.inf, -1, 0.0, 0.0
    for ring in range(size[0] + size[1] + size[2]):
        for kk in range(max(k - ring, 0), min(k + ring, size[2] - 1) + 1):
            from_layer = _outside(z - origin[2], kk * cell, cell) ** 2
            if from_layer > SLACK * best:
                continue
            for jj in range(max(j - ring, 0), min(j + ring, size[1] - 1) + 1):
                inner = abs(kk - k) < ring and abs(jj - j) < ring
                from_line = from_layer + _outside(y - origin[1], jj * cell, cell) ** 2
                if from_line > SLACK * best:
                    continue
                for ii in range(max(i - ring, 0), min(i + ring, size[0] - 1) + 1):
                    if inner and abs(ii - i) < ring:
                        continue
                    if from_line + _outside(x - origin[0], ii * cell, cell) ** 2 > SLACK * best:
                        continue
                    c = (kk * size[1] + jj) * size[0] + ii
                    for e in range(start[c], start[c + 1]):
                        t = item[e]
                        if len(facing) and (
                            facing[t, 0] * way[0] + facing[t, 1] * way[1] + facing[t, 2] * way[2] < least
                        ):
                            continue
                        square, v, w = square_to_triangle(x, y, z, corner[t, 0], corner[t, 1], corner[t, 2])
                        if square < best:
                            best, found, best_v, best_w = square, t, v, w
        free = min(
            x - (origin[0] + (i - ring) * cell), origin[0] + (i + ring + 1) * cell - x,
            y - (origin[1] + (j - ring) * cell), origin[1] + (j + ring + 1) * cell - y,
            z - (origin[2] + (k - ring) * cell), origin[2] + (k + ring + 1) * cell - z,
        )  # fmt: skip
        if free > 0.0 and (best <= free * free or free > farthest):
            break
    return found, best, best_v, best_w


@loop_kernel
def _query(points, grid, distance):
    none, boxes = np.empty((0, 3)), lend(grid)
    for p in numba.prange(len(points)):
        found = nearest_on_mesh(boxes, points[p, 0], points[p, 1], points[p, 2], none, points[p], -1.0, np.inf)
        distance[p] = np.sqrt(found[1])
