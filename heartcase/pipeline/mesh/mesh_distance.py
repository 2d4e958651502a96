"""Exact distance from points to a triangle mesh, by a lattice of boxes."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.mesh.triangle_grid import TriangleGrid

__all__ = ["mesh_distance_mm", "nearest_on_mesh"]

Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]


def mesh_distance_mm(points_mm: Float64, mesh: TriangleGrid) -> Float64:
    """Distance of each point to the nearest point of a mesh.

    Parameters
    ----------
    points_mm
        Shape (n, 3).
    mesh
        From :func:`~heartcase.pipeline.mesh.triangle_grid.triangle_grid`.

    Returns
    -------
    Float64
        Shape (n,), in mm.
    """
    distance = np.empty(len(points_mm))
    _query(np.ascontiguousarray(points_mm, dtype=np.float64), mesh, distance)
    return distance


@numba.njit(cache=True, nogil=True)
def _square_to_triangle(px, py, pz, a, b, c):  # type: ignore[no-untyped-def]
    """Square of the distance, and the weights of the second and third corner at the nearest point.

    Ericson, Real-Time Collision Detection, 2005, section 5.1.5.
    """
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    apx, apy, apz = px - a[0], py - a[1], pz - a[2]
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    v = w = 0.0
    if not (d1 <= 0.0 and d2 <= 0.0):
        bpx, bpy, bpz = px - b[0], py - b[1], pz - b[2]
        d3 = abx * bpx + aby * bpy + abz * bpz
        d4 = acx * bpx + acy * bpy + acz * bpz
        cpx, cpy, cpz = px - c[0], py - c[1], pz - c[2]
        d5 = abx * cpx + aby * cpy + abz * cpz
        d6 = acx * cpx + acy * cpy + acz * cpz
        va = d3 * d6 - d5 * d4
        vb = d5 * d2 - d1 * d6
        vc = d1 * d4 - d3 * d2
        if d3 >= 0.0 and d4 <= d3:
            v = 1.0
        elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
            v = d1 / (d1 - d3) if d1 != d3 else 0.0
        elif d6 >= 0.0 and d5 <= d6:
            w = 1.0
        elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
            w = d2 / (d2 - d6) if d2 != d6 else 0.0
        elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
            w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
            v = 1.0 - w
        else:
            v = vb / (va + vb + vc)
            w = vc / (va + vb + vc)
    x = apx - v * abx - w * acx
    y = apy - v * aby - w * acy
    z = apz - v * abz - w * acz
    return x * x + y * y + z * z, v, w


@numba.njit(cache=True, nogil=True)
def nearest_on_mesh(grid, x, y, z, facing, way, least, farthest):  # type: ignore[no-untyped-def]
    """Nearest triangle to a point: its number, -1 where there is none, the square of the distance, two weights.

    ``facing`` are the unit normals of the triangles, and only those are looked at whose cosine with ``way`` is at least
    ``least``; without any normals all are. Nothing need be found beyond ``farthest`` mm.
    """
    corner, origin, cell, size, start, item = grid.corner, grid.origin, grid.edge, grid.size, grid.start, grid.item
    i = min(max(int(np.floor((x - origin[0]) / cell)), 0), size[0] - 1)
    j = min(max(int(np.floor((y - origin[1]) / cell)), 0), size[1] - 1)
    k = min(max(int(np.floor((z - origin[2]) / cell)), 0), size[2] - 1)
    best, found, best_v, best_w = np.inf, -1, 0.0, 0.0
    for ring in range(size[0] + size[1] + size[2]):
        for kk in range(max(k - ring, 0), min(k + ring, size[2] - 1) + 1):
            for jj in range(max(j - ring, 0), min(j + ring, size[1] - 1) + 1):
                inner = abs(kk - k) < ring and abs(jj - j) < ring
                for ii in range(max(i - ring, 0), min(i + ring, size[0] - 1) + 1):
                    if inner and abs(ii - i) < ring:
                        continue
                    c = (kk * size[1] + jj) * size[0] + ii
                    for e in range(start[c], start[c + 1]):
                        t = item[e]
                        if len(facing) and (
                            facing[t, 0] * way[0] + facing[t, 1] * way[1] + facing[t, 2] * way[2] < least
                        ):
                            continue
                        square, v, w = _square_to_triangle(x, y, z, corner[t, 0], corner[t, 1], corner[t, 2])
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


@numba.njit(cache=True, nogil=True, parallel=True)
def _query(points, grid, distance):  # type: ignore[no-untyped-def]
    none = np.empty((0, 3))
    for p in numba.prange(len(points)):
        found = nearest_on_mesh(grid, points[p, 0], points[p, 1], points[p, 2], none, points[p], -1.0, np.inf)
        distance[p] = np.sqrt(found[1])
