"""Self-intersections of a triangle mesh.

Two triangles count as intersecting when an edge of one strictly crosses the inside of the other. Neighbours that share
an edge or a vertex are judged by the same rule: what they share lies in both planes, so it crosses neither. Triangles
that only touch, or overlap within one plane, do not count; folds are found by their normals.

Signs of volumes are taken in float64 with a forward error bound (Shewchuk, "Adaptive precision floating-point
arithmetic and fast robust geometric predicates", Discrete & Computational Geometry 18, 1997): what is not certain
counts as touching.
"""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.mesh.triangles.triangle_grid import triangle_grid
from heartcase.schemas.arrays import Bool, Float, Int32

__all__ = ["self_intersections"]


_ERROR_BOUND = (7.0 + 56.0 * 2.0**-53) * 2.0**-53
"""Of a volume's sign, in units of the sum of its products' sizes: Shewchuk's o3derrboundA."""


def self_intersections(vertices: Float, triangles: Int32, *, among: Bool | None = None) -> Int32:
    """Find all pairs of triangles that cross.

    Parameters
    ----------
    vertices
        Shape (vertex_count, 3).
    triangles
        Shape (triangle_count, 3).
    among
        Where only pairs with one of some triangles are wanted: which, shape (triangle_count,).

    Returns
    -------
    Int32
        Shape (pair_count, 2), lower triangle first, ascending.
    """
    if not len(triangles) or (among is not None and not among.any()):
        return np.zeros((0, 2), np.int32)
    if among is not None:
        return _pairs_among(vertices, triangles, among)
    grid = triangle_grid(vertices, triangles)
    low, high = grid.corner.min(axis=1), grid.corner.max(axis=1)
    counts = np.empty(len(triangles), np.int64)
    _cross_count(grid, low, high, counts)
    begin = np.concatenate([[0], np.cumsum(counts)])
    pairs = np.empty((int(begin[-1]), 2), np.int32)
    _cross_list(grid, low, high, begin, pairs)
    return pairs


def _pairs_among(vertices: Float, triangles: Int32, among: Bool) -> Int32:
    """Pairs with one of some triangles, which alone are sorted into boxes."""
    which = np.flatnonzero(among)
    grid = triangle_grid(vertices, triangles[which])
    corner = np.ascontiguousarray(vertices, np.float64)[triangles]
    low, high = corner.min(axis=1), corner.max(axis=1)
    far = grid.origin + grid.edge * grid.size
    near = np.flatnonzero(((low <= far) & (high >= grid.origin)).all(axis=1))
    counts = np.empty(len(near), np.int64)
    _cross_some_count(grid, corner, low, high, near, which, counts)
    begin = np.concatenate([[0], np.cumsum(counts)])
    pairs = np.empty((int(begin[-1]), 2), np.int32)
    _cross_some_list(grid, corner, low, high, near, which, begin, pairs)
    pairs.sort(axis=1)
    return np.unique(pairs, axis=0) if len(pairs) else pairs


@copied
def _side(a, b, c, d):
    """Sign of the volume of (a, b, c, d): 1, -1, or 0 where it is not certain."""
    ax, ay, az = a[0] - d[0], a[1] - d[1], a[2] - d[2]
    bx, by, bz = b[0] - d[0], b[1] - d[1], b[2] - d[2]
    cx, cy, cz = c[0] - d[0], c[1] - d[1], c[2] - d[2]
    bxcy, cxby = bx * cy, cx * by
    cxay, axcy = cx * ay, ax * cy
    axby, bxay = ax * by, bx * ay
    volume = az * (bxcy - cxby) + bz * (cxay - axcy) + cz * (axby - bxay)
    most = (abs(bxcy) + abs(cxby)) * abs(az) + (abs(cxay) + abs(axcy)) * abs(bz) + (abs(axby) + abs(bxay)) * abs(cz)
    bound = _ERROR_BOUND * most
    return 1 if volume > bound else (-1 if volume < -bound else 0)


@copied
def _edge_crosses(p, q, t):
    """Whether the segment from p to q strictly crosses the inside of a triangle."""
    side = _side(t[0], t[1], t[2], p)
    if side == 0 or side != -_side(t[0], t[1], t[2], q):
        return False
    way = _side(p, q, t[0], t[1])
    return way != 0 and way == _side(p, q, t[1], t[2]) and way == _side(p, q, t[2], t[0])


@kernel
def _crosses(a, b):
    for k in range(3):
        m = (k + 1) % 3
        if _edge_crosses(a[k], a[m], b) or _edge_crosses(b[k], b[m], a):
            return True
    return False


@kernel
def _are_apart(low, high, t, u):
    """Whether the boxes around two triangles do not meet."""
    return (
        low[t, 0] > high[u, 0]
        or low[u, 0] > high[t, 0]
        or low[t, 1] > high[u, 1]
        or low[u, 1] > high[t, 1]
        or low[t, 2] > high[u, 2]
        or low[u, 2] > high[t, 2]
    )


@called
def _crossed_by(t, grid, low, high, found):
    """Higher triangles that cross triangle ``t``, into ``found`` as far as it reaches; how many there are."""
    corner, first, last, size = grid.corner, grid.first, grid.last, grid.size
    count = 0
    for k in range(first[t, 2], last[t, 2] + 1):
        for j in range(first[t, 1], last[t, 1] + 1):
            for i in range(first[t, 0], last[t, 0] + 1):
                c = (k * size[1] + j) * size[0] + i
                for at in range(grid.start[c], grid.start[c + 1]):
                    u = grid.item[at]
                    # a pair is looked at in the first box that both reach into
                    if (
                        u <= t
                        or i != max(first[t, 0], first[u, 0])
                        or j != max(first[t, 1], first[u, 1])
                        or k != max(first[t, 2], first[u, 2])
                        or _are_apart(low, high, t, u)
                    ):
                        continue
                    if _crosses(corner[t], corner[u]):
                        if count < len(found):
                            found[count] = u
                        count += 1
    return count


@loop_kernel
def _cross_count(grid, low, high, counts):
    boxes = lend(grid)
    for t in numba.prange(len(low)):
        counts[t] = _crossed_by(t, boxes, low, high, np.empty(0, np.int32))


@loop_kernel
def _cross_list(grid, low, high, begin, pairs):
    boxes = lend(grid)
    for t in numba.prange(len(low)):
        count = begin[t + 1] - begin[t]
        if count > 0:
            found = np.empty(count, np.int32)
            _crossed_by(t, boxes, low, high, found)
            found.sort()
            for n in range(count):
                pairs[begin[t] + n, 0], pairs[begin[t] + n, 1] = t, found[n]


@called
def _crossed_by_some(t, grid, corner, low, high, which, found):
    """Triangles of ``which``, those of the grid, that cross triangle ``t``, into ``found``; how many there are."""
    size = grid.size
    begin, end = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        begin[axis] = max(int(np.floor((low[t, axis] - grid.origin[axis]) / grid.edge)), 0)
        end[axis] = min(int(np.floor((high[t, axis] - grid.origin[axis]) / grid.edge)), size[axis] - 1)
    count = 0
    for k in range(begin[2], end[2] + 1):
        for j in range(begin[1], end[1] + 1):
            for i in range(begin[0], end[0] + 1):
                c = (k * size[1] + j) * size[0] + i
                for at in range(grid.start[c], grid.start[c + 1]):
                    n = grid.item[at]
                    u = which[n]
                    # a pair is looked at in the first box that both reach into
                    if (
                        u == t
                        or i != max(begin[0], grid.first[n, 0])
                        or j != max(begin[1], grid.first[n, 1])
                        or k != max(begin[2], grid.first[n, 2])
                        or _are_apart(low, high, t, u)
                    ):
                        continue
                    if _crosses(corner[min(t, u)], corner[max(t, u)]):
                        if count < len(found):
                            found[count] = u
                        count += 1
    return count


@loop_kernel
def _cross_some_count(grid, corner, low, high, near, which, counts):
    boxes = lend(grid)
    for n in numba.prange(len(near)):
        counts[n] = _crossed_by_some(near[n], boxes, corner, low, high, which, np.empty(0, np.int32))


@loop_kernel
def _cross_some_list(grid, corner, low, high, near, which, begin, pairs):
    boxes = lend(grid)
    for n in numba.prange(len(near)):
        count = begin[n + 1] - begin[n]
        if count > 0:
            found = np.empty(count, np.int32)
            _crossed_by_some(near[n], boxes, corner, low, high, which, found)
            for m in range(count):
                pairs[begin[n] + m, 0], pairs[begin[n] + m, 1] = near[n], found[m]
