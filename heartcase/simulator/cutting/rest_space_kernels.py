"""Places of deformed tissue at rest: kernels of :mod:`heartcase.simulator.cutting.rest_space`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Float64, Int32, Int64
from heartcase.simulator.cutting.crossings import SAMPLES

__all__ = ["Tissue", "follow_back"]

_CANDIDATES = 16
"""Cells nearest to a place in which it is looked for."""
_AVERAGED = 8
"""The nearest of these, as which a place beside the tissue moves."""
_BESIDE = 0.6
"""How far from its centre along an axis a place still belongs to a cell [edges]."""
_ROUNDS = 6
"""Of Newton's method."""
_TOUCHING = 0.1
"""How far from the tissue of a piece a place still belongs to it [edges]."""


class Tissue(NamedTuple):
    """Cells, how their nodes have moved, and of those that were parted which samples are theirs."""

    centres: Float64
    """Of each cell at rest [cells], shape (cell_count, 3)."""
    corners: Int32
    """Shape (cell_count, 8)."""
    displacement: Float32
    """Of each node [cells], shape (node_count, 3)."""
    offsets: Float64
    """Of a cell's corners from its centre, shape (8, 3)."""
    piece_cells: Int64
    """Cells that were parted, as places among ``piece_samples``, -1 where a cell is whole, shape (cell_count,)."""
    piece_numbers: Int64
    """Which of the pieces there each cell is, shape (cell_count,)."""
    piece_samples: Int32
    """Piece of each sample of cells that were parted, shape (any, SAMPLES^3)."""


@kernel(cached=False)
def _solve(matrix, gap, local):
    """Take the solution of three equations from a place; whether there is one."""
    a, b, c = matrix[0], matrix[1], matrix[2]
    x0, x1, x2 = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
    determinant = a[0] * x0 + a[1] * x1 + a[2] * x2
    if abs(determinant) < 1e-9:
        return False
    y0, y1, y2 = c[1] * a[2] - c[2] * a[1], c[2] * a[0] - c[0] * a[2], c[0] * a[1] - c[1] * a[0]
    z0, z1, z2 = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    local[0] -= (x0 * gap[0] + y0 * gap[1] + z0 * gap[2]) / determinant
    local[1] -= (x1 * gap[0] + y1 * gap[1] + z1 * gap[2]) / determinant
    local[2] -= (x2 * gap[0] + y2 * gap[1] + z2 * gap[2]) / determinant
    return True


@kernel(cached=False)
def _local_place(point, tissue, cell, local):
    """Place in a cell from its centre at rest, and the largest of its components: inside up to one half."""
    centre, nodes, displacement, corners = (
        tissue.centres[cell],
        tissue.corners[cell],
        tissue.displacement,
        tissue.offsets,
    )
    local[:] = 0.0
    matrix = np.empty((3, 3))
    gap = np.empty(3)
    for _ in range(_ROUNDS):
        for axis in range(3):
            gap[axis] = centre[axis] + local[axis] - point[axis]
            for along in range(3):
                matrix[axis, along] = 1.0 if axis == along else 0.0
        for corner in range(8):
            fx, fy, fz = (
                0.5 + 2.0 * corners[corner, 0] * local[0],
                0.5 + 2.0 * corners[corner, 1] * local[1],
                0.5 + 2.0 * corners[corner, 2] * local[2],
            )
            sx, sy, sz = 2.0 * corners[corner, 0], 2.0 * corners[corner, 1], 2.0 * corners[corner, 2]
            for axis in range(3):
                u = displacement[nodes[corner], axis]
                gap[axis] += fx * fy * fz * u
                matrix[axis, 0] += sx * fy * fz * u
                matrix[axis, 1] += fx * sy * fz * u
                matrix[axis, 2] += fx * fy * sz * u
        if not _solve(matrix, gap, local):
            return np.inf
        if max(abs(local[0]), abs(local[1]), abs(local[2])) > 1.0:
            # Beside the cell its displacements are no guide.
            return np.inf
    return max(abs(local[0]), abs(local[1]), abs(local[2]))


@kernel(cached=False)
def _away_from_tissue(local, samples, number):
    """Distance of a place in a cell from the samples of one of its pieces along the axis where it is largest."""
    least = np.inf
    half = 0.5 / SAMPLES
    for sample in range(len(samples)):
        if samples[sample] != number:
            continue
        x = abs(local[0] + 0.5 - (sample % SAMPLES + 0.5) / SAMPLES)
        y = abs(local[1] + 0.5 - (sample // SAMPLES % SAMPLES + 0.5) / SAMPLES)
        z = abs(local[2] + 0.5 - (sample // SAMPLES**2 + 0.5) / SAMPLES)
        least = min(least, max(max(x, y, z) - half, 0.0))
    return least


@kernel(cached=False)
def _find_nearest(point, now, listed, nearest, away):
    """Write the cells among some whose middles are nearest to a point, and the squares of how far, else infinity."""
    away[:] = np.inf
    nearest[:] = -1
    for cell in listed:
        x, y, z = point[0] - now[cell, 0], point[1] - now[cell, 1], point[2] - now[cell, 2]
        square = x * x + y * y + z * z
        if square < away[_CANDIDATES - 1]:
            place = _CANDIDATES - 1
            while place > 0 and away[place - 1] > square:
                away[place], nearest[place] = away[place - 1], nearest[place - 1]
                place -= 1
            away[place], nearest[place] = square, cell


@kernel
def follow_back(points, tissue, reach, result, is_open):
    """Write the place at rest of each point, from the cells around it, and whether it lies in no tissue.

    Cells within ``reach`` of the box around all points are looked at first, in case they are enough; the result is the
    same whatever it is.
    """
    cell_count = len(tissue.centres)
    now = np.empty((cell_count, 3))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for point in range(len(points)):
        for axis in range(3):
            low[axis] = min(low[axis], points[point, axis] - reach)
            high[axis] = max(high[axis], points[point, axis] + reach)
    near, every = np.empty(cell_count, np.int64), np.arange(cell_count)
    count = 0
    for cell in range(cell_count):
        inside = True
        for axis in range(3):
            total = 0.0
            for corner in range(8):
                total += tissue.displacement[tissue.corners[cell, corner], axis]
            now[cell, axis] = tissue.centres[cell, axis] + total / 8.0
            inside &= low[axis] <= now[cell, axis] <= high[axis]
        if inside:
            near[count] = cell
            count += 1
    nearest, away = np.empty(_CANDIDATES, np.int64), np.empty(_CANDIDATES)
    local, best = np.empty(3), np.empty(3)
    for point in range(len(points)):
        _find_nearest(points[point], now, near[:count], nearest, away)
        # A cell beyond the box is further away than it reaches, whatever was rounded.
        if away[_CANDIDATES - 1] >= 0.999 * reach * reach:
            _find_nearest(points[point], now, every, nearest, away)
        # A cell that was parted takes up its cube with others: a place there belongs to it where its own tissue is.
        least, is_parted, size_there = np.inf, False, np.inf
        for candidate in range(_CANDIDATES):
            cell = nearest[candidate]
            if cell < 0:
                break
            size = _local_place(points[point], tissue, cell, local)
            if size == np.inf:
                continue
            off, place = max(size - 0.5, 0.0), tissue.piece_cells[cell]
            if place >= 0:
                off = _away_from_tissue(local, tissue.piece_samples[place], tissue.piece_numbers[cell])
            if off < least:
                least, is_parted, size_there = off, place >= 0, size
                best[:] = tissue.centres[cell] + local
            if least <= 0.0:
                break
        is_open[point] = least > _TOUCHING if is_parted else least == np.inf
        if is_parted or size_there <= _BESIDE:
            result[point] = best
            continue
        # Beside the tissue: as the nearest cells have moved, on average, so that no two places near each other part.
        total = 0.0
        best[:] = 0.0
        for candidate in range(_AVERAGED):
            if nearest[candidate] >= 0:
                weight = 1.0 / (away[candidate] + 1e-6)
                total += weight
                best += weight * (now[nearest[candidate]] - tissue.centres[nearest[candidate]])
        result[point] = points[point] - best / total
