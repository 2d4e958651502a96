"""Which piece of a cut lattice a point belongs to: the nearest tissue that it sees past the sheets: kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float64, Int32, Int64
from heartcase.simulator.cutting.crossings import QUANTA, SAMPLES

__all__ = ["PieceCells", "SheetBuckets", "nearest_halves", "see_cells"]

_TRIES = 48
"""Samples of a cell that are looked for, the nearest first."""
_SAMPLE_COUNT = SAMPLES**3
_EDGE = 1e-9
_MOVED = (1e-9, 1e-5, 1e-7)
"""How far the tissue is moved against the sheets, which decides where it lies on them [cells]."""


class PieceCells(NamedTuple):
    """What the samples of a cut lattice's cells belong to."""

    cells: Int32
    """Index (i, j, k) of each cell of the uncut lattice, shape (cell_count, 3)."""
    middles: Float64
    """Middle of the tissue of each [cells], shape (cell_count, 3)."""
    rows: Int64
    """Row of each cell in ``samples``, or -1 where no sheet is near, shape (cell_count,)."""
    samples: Int32
    """Piece of each sample, from 0 in each cell, -1 where there is no tissue, shape (row_count, SAMPLES^3)."""
    first: Int64
    """First piece of each row in ``of_piece``, shape (row_count,)."""
    of_piece: Int64
    """Cell of the cut lattice that each piece is, shape (piece_count,)."""


class SheetBuckets(NamedTuple):
    """Triangles of sheets by where they lie."""

    vertices: Int64
    triangles: Int64
    low: Int64
    size: Int64
    first: Int64
    members: Int32


@kernel(cached=False)
def _is_hidden(start, stop, sheets, reach):
    """Whether a triangle of a sheet lies between two points [cells]."""
    for axis in range(3):
        least, most = min(start[axis], stop[axis]), max(start[axis], stop[axis])
        reach[0, axis] = max(int(np.floor(least)) - sheets.low[axis], 0)
        reach[1, axis] = min(int(np.floor(most)) - sheets.low[axis], sheets.size[axis] - 1)
    for k in range(reach[0, 2], reach[1, 2] + 1):
        for j in range(reach[0, 1], reach[1, 1] + 1):
            for i in range(reach[0, 0], reach[1, 0] + 1):
                bucket = (k * sheets.size[1] + j) * sheets.size[0] + i
                for at in range(sheets.first[bucket], sheets.first[bucket + 1]):
                    if _is_between(start, stop, sheets.vertices, sheets.triangles[sheets.members[at]]):
                        return True
    return False


@kernel(cached=False)
def _is_between(start, stop, vertices, triangle):
    wx, wy, wz = stop[0] - start[0], stop[1] - start[1], stop[2] - start[2]
    p, q, r = vertices[triangle[0]], vertices[triangle[1]], vertices[triangle[2]]
    ax, ay, az = (q[0] - p[0]) / QUANTA, (q[1] - p[1]) / QUANTA, (q[2] - p[2]) / QUANTA
    bx, by, bz = (r[0] - p[0]) / QUANTA, (r[1] - p[1]) / QUANTA, (r[2] - p[2]) / QUANTA
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    sx, sy = start[0] + _MOVED[0] - p[0] / QUANTA, start[1] + _MOVED[1] - p[1] / QUANTA
    sz = start[2] + _MOVED[2] - p[2] / QUANTA
    height = nx * sx + ny * sy + nz * sz
    beyond = height + nx * wx + ny * wy + nz * wz
    if (height > 0.0) == (beyond > 0.0):
        return False
    share = height / (height - beyond)
    x, y, z = sx + share * wx, sy + share * wy, sz + share * wz
    area = nx * nx + ny * ny + nz * nz
    second = (nx * (y * bz - z * by) + ny * (z * bx - x * bz) + nz * (x * by - y * bx)) / area
    third = (nx * (ay * z - az * y) + ny * (az * x - ax * z) + nz * (ax * y - ay * x)) / area
    return second >= -_EDGE and third >= -_EDGE and second + third <= 1.0 + _EDGE


@kernel(cached=False)
def _see_cell(point, cell, tissue, sheets, reach, place, distances):
    """Cell of the cut lattice whose tissue, within one of the uncut lattice, a point sees; and how far it is; or -1."""
    row = tissue.rows[cell]
    if row < 0:
        distance = 0.0
        for axis in range(3):
            distance += (tissue.middles[cell, axis] - point[axis]) ** 2
        if _is_hidden(point, tissue.middles[cell], sheets, reach):
            return -1, np.inf
        return cell, distance
    for sample in range(_SAMPLE_COUNT):
        distances[sample] = np.inf
        if tissue.samples[row, sample] >= 0:
            x = tissue.cells[cell, 0] + (sample % SAMPLES + 0.5) / SAMPLES - point[0]
            y = tissue.cells[cell, 1] + (sample // SAMPLES % SAMPLES + 0.5) / SAMPLES - point[1]
            z = tissue.cells[cell, 2] + (sample // SAMPLES**2 + 0.5) / SAMPLES - point[2]
            distances[sample] = x * x + y * y + z * z
    for _ in range(_TRIES):
        sample = distances.argmin()
        if distances[sample] == np.inf:
            break
        place[0] = tissue.cells[cell, 0] + (sample % SAMPLES + 0.5) / SAMPLES
        place[1] = tissue.cells[cell, 1] + (sample // SAMPLES % SAMPLES + 0.5) / SAMPLES
        place[2] = tissue.cells[cell, 2] + (sample // SAMPLES**2 + 0.5) / SAMPLES
        if not _is_hidden(point, place, sheets, reach):
            return tissue.of_piece[tissue.first[row] + tissue.samples[row, sample]], distances[sample]
        distances[sample] = np.inf
    return -1, np.inf


@kernel
def see_cells(points, first, candidates, takes_first, tissue, sheets, seen):
    """Write the cell of the cut lattice that each point sees, or -1.

    Parameters
    ----------
    points
        [cells], in the frame of the nodes, shape (count, 3).
    first, candidates
        Where the cells of the uncut lattice begin that each point looks for, shape (count + 1,), and these.
    takes_first
        Whether the first that is seen is taken, and not the nearest.
    tissue, sheets
        Where tissue and sheets are.
    seen
        Shape (count,), written.
    """
    reach, place, distances = np.empty((2, 3), np.int64), np.empty(3), np.empty(_SAMPLE_COUNT)
    for n in range(len(points)):
        best, nearest = -1, np.inf
        for at in range(first[n], first[n + 1]):
            found, distance = _see_cell(points[n], candidates[at], tissue, sheets, reach, place, distances)
            if found >= 0 and distance < nearest:
                best, nearest = found, distance
                if takes_first:
                    break
        seen[n] = best


@kernel
def nearest_halves(points, cells, halves, offsets, chosen):
    """Write the half of a face of its cell that each point is nearest to.

    Parameters
    ----------
    points, cells
        Points [cells], in the frame of the nodes, and the index (i, j, k) of the cell of each, shape (count, 3).
    halves, offsets
        Corners of the halves of a cell's faces, the second at a right angle or the first, shape (half_count, 3), and
        the offsets of a cell's corners, shape (8, 3).
    chosen
        Shape (count,), written.
    """
    for n in range(len(points)):
        nearest = np.inf
        for half in range(len(halves)):
            away = _away(points[n], cells[n], offsets, halves[half])
            if away < nearest - 1e-12:
                nearest = away
                chosen[n] = half


@kernel(cached=False)
def _away(point, cell, offsets, half):
    """Squared distance of a point to a triangle at corners of a cell."""
    a, b, c = offsets[half[0]], offsets[half[1]], offsets[half[2]]
    nearest = np.inf
    uu, vv, uv, wu, wv, ww = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        u, v = float(b[axis] - a[axis]), float(c[axis] - a[axis])
        w = point[axis] - cell[axis] - a[axis]
        uu, vv, uv, wu, wv, ww = uu + u * u, vv + v * v, uv + u * v, wu + w * u, wv + w * v, ww + w * w
    determinant = uu * vv - uv * uv
    first, second = (vv * wu - uv * wv) / determinant, (uu * wv - uv * wu) / determinant
    if first >= 0.0 and second >= 0.0 and first + second <= 1.0:
        return max(ww - first * wu - second * wv, 0.0)
    along = min(max(wu / uu, 0.0), 1.0)
    nearest = min(nearest, ww - 2.0 * along * wu + along * along * uu)
    along = min(max(wv / vv, 0.0), 1.0)
    nearest = min(nearest, ww - 2.0 * along * wv + along * along * vv)
    along = min(max((wv - wu + uu - uv) / (uu + vv - 2.0 * uv), 0.0), 1.0)
    rest = ww - 2.0 * ((1.0 - along) * wu + along * wv)
    rest += (1.0 - along) ** 2 * uu + along**2 * vv + 2.0 * along * (1.0 - along) * uv
    return min(nearest, rest)
