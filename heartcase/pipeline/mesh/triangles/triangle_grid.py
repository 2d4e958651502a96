"""A spatial index of triangles: a lattice of boxes, each with the triangles near it."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Float, Float64, Int32, Int64

__all__ = ["TriangleGrid", "triangle_grid"]


_EDGES_PER_BOX = 1.5
_BOX_COUNT = 8_000_000
_CHUNK = 4096


class TriangleGrid(NamedTuple):
    """Which triangles reach into each box; box (i, j, k) has the number (k * size[1] + j) * size[0] + i."""

    corner: Float64
    """Corners of the triangles, mm, shape (triangle_count, 3, 3)."""
    origin: Float64
    """Lower corner of box (0, 0, 0), mm."""
    edge: float
    """Edge of a box, mm."""
    size: Int64
    """Boxes along x, y, z."""
    first: Int32
    """Lowest box (i, j, k) that each triangle reaches into, shape (triangle_count, 3)."""
    last: Int32
    """Highest one."""
    start: Int64
    """Where each box begins in ``item``, and the end of the last."""
    item: Int32
    """Triangles of each box, ascending."""


def triangle_grid(vertices_mm: Float, triangles: Int32) -> TriangleGrid:
    """Sort the triangles of a mesh into boxes about as large as one and a half of them.

    Parameters
    ----------
    vertices_mm
        Shape (vertex_count, 3).
    triangles
        Shape (triangle_count, 3); at least one.
    """
    vertices = np.ascontiguousarray(vertices_mm, np.float64)
    corner = np.empty((len(triangles), 3, 3))
    chunks = -(-len(triangles) // _CHUNK)
    low, high, widths = np.empty((chunks, 3)), np.empty((chunks, 3)), np.empty(chunks)
    _take_corners(vertices, triangles, corner, low, high, widths)
    origin, extent = low.min(axis=0), high.max(axis=0) - low.min(axis=0)
    edge = max(_EDGES_PER_BOX * float(widths.sum()) / len(triangles), 1e-9 * float(extent.max()), 1e-12)
    edge = max(edge, float(np.cbrt((extent + edge).prod() / _BOX_COUNT)))
    size = np.floor(extent / edge).astype(np.int64) + 1
    first, last = np.empty((len(triangles), 3), np.int32), np.empty((len(triangles), 3), np.int32)
    _find_boxes(corner, origin, edge, size, first, last)
    return TriangleGrid(corner, origin, edge, size, first, last, *_fill(first, last, size))


@loop_kernel
def _take_corners(vertices, triangles, corner, low, high, widths):
    """Corners of all triangles; lowest and highest place, and sum of the triangles' widths, of each chunk of them."""
    for chunk in numba.prange(len(widths)):
        lowest, highest, total = np.full(3, np.inf), np.full(3, -np.inf), 0.0
        for t in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, len(triangles))):
            width = 0.0
            for axis in range(3):
                a, b, c = (
                    vertices[triangles[t, 0], axis], vertices[triangles[t, 1], axis], vertices[triangles[t, 2], axis],
                )  # fmt: skip
                corner[t, 0, axis], corner[t, 1, axis], corner[t, 2, axis] = a, b, c
                least, most = min(a, b, c), max(a, b, c)
                lowest[axis], highest[axis] = min(lowest[axis], least), max(highest[axis], most)
                width = max(width, most - least)
            total += width
        low[chunk], high[chunk], widths[chunk] = lowest, highest, total


@loop_kernel
def _find_boxes(corner, origin, edge, size, first, last):
    for chunk in numba.prange((len(corner) + _CHUNK - 1) // _CHUNK):
        for t in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, len(corner))):
            for axis in range(3):
                a, b, c = corner[t, 0, axis], corner[t, 1, axis], corner[t, 2, axis]
                first[t, axis] = min(int(np.floor((min(a, b, c) - origin[axis]) / edge)), size[axis] - 1)
                last[t, axis] = min(int(np.floor((max(a, b, c) - origin[axis]) / edge)), size[axis] - 1)


@kernel
def _fill(first, last, size):
    start = np.zeros(size[0] * size[1] * size[2] + 1, np.int64)
    for turn in range(2):
        if turn == 1:
            for c in range(len(start) - 1):
                start[c + 1] += start[c]
            item = np.empty(start[-1], np.int32)
            place = start[:-1].copy()
        for t in range(len(first)):
            for k in range(first[t, 2], last[t, 2] + 1):
                for j in range(first[t, 1], last[t, 1] + 1):
                    for i in range(first[t, 0], last[t, 0] + 1):
                        c = (k * size[1] + j) * size[0] + i
                        if turn == 0:
                            start[c + 1] += 1
                        else:
                            item[place[c]] = t
                            place[c] += 1
    return start, item
