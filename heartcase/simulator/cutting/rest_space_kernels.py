"""Places of deformed tissue at rest: kernels of :mod:`heartcase.simulator.cutting.rest_space`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Float64, Int32, Int64
from heartcase.simulator.cutting.crossings import SAMPLES

__all__ = ["Near", "Tissue", "draw_in", "find_near", "follow_back"]

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
    """Cells, how their nodes have moved, and which samples are a piece's."""

    cells: Int32
    """Index (i, j, k) of each cell, shape (cell_count, 3)."""
    corners: Int32
    """Shape (cell_count, 8)."""
    displacement: Float32
    """Of each node [cells], shape (node_count, 3)."""
    offsets: Float64
    """Of a cell's corners from its centre, shape (8, 3)."""
    origins: Int32
    """Uncut cell that each cell is, or is a piece of, shape (cell_count,); or none where nothing was cut."""
    looked_at: Int64
    """Uncut cells that sheets came near, ascending, shape (any,)."""
    counts: Int64
    """Pieces of each of these, shape (any,)."""
    first: Int64
    """The first of them, of all, shape (any,)."""
    samples: Int32
    """Piece of each sample of these cells, shape (any, SAMPLES^3)."""


class Near(NamedTuple):
    """Cells near some places now."""

    cells: Int64
    """Ascending, shape (count,)."""
    middles: Float64
    """Where their middles are now [cells], along x, y and z, shape (3, count)."""
    reach: float
    """All are there that are no further than this from one of the places [cells]."""


@kernel(cached=False)
def _local_place(point, tissue, cell, local):
    """Place in a cell from its centre at rest, and the largest of its components: inside up to one half."""
    nodes, displacement, corners = tissue.corners[cell], tissue.displacement, tissue.offsets
    cx, cy, cz = tissue.cells[cell, 0] + 0.5, tissue.cells[cell, 1] + 0.5, tissue.cells[cell, 2] + 0.5
    lx = ly = lz = 0.0
    for _ in range(_ROUNDS):
        gx, gy, gz = cx + lx - point[0], cy + ly - point[1], cz + lz - point[2]
        ax = by = cw = 1.0
        ay = az = bx = bz = cu = cv = 0.0
        for corner in range(8):
            sx, sy, sz = 2.0 * corners[corner, 0], 2.0 * corners[corner, 1], 2.0 * corners[corner, 2]
            fx, fy, fz = 0.5 + sx * lx, 0.5 + sy * ly, 0.5 + sz * lz
            all_f, along_x, along_y, along_z = fx * fy * fz, sx * fy * fz, fx * sy * fz, fx * fy * sz
            node = nodes[corner]
            u, v, w = displacement[node, 0], displacement[node, 1], displacement[node, 2]
            gx += all_f * u
            gy += all_f * v
            gz += all_f * w
            ax += along_x * u
            ay += along_y * u
            az += along_z * u
            bx += along_x * v
            by += along_y * v
            bz += along_z * v
            cu += along_x * w
            cv += along_y * w
            cw += along_z * w
        # Three equations.
        x0, x1, x2 = by * cw - bz * cv, bz * cu - bx * cw, bx * cv - by * cu
        determinant = ax * x0 + ay * x1 + az * x2
        if abs(determinant) < 1e-9:
            return np.inf
        y0, y1, y2 = cv * az - cw * ay, cw * ax - cu * az, cu * ay - cv * ax
        z0, z1, z2 = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        lx -= (x0 * gx + y0 * gy + z0 * gz) / determinant
        ly -= (x1 * gx + y1 * gy + z1 * gz) / determinant
        lz -= (x2 * gx + y2 * gy + z2 * gz) / determinant
        if max(abs(lx), abs(ly), abs(lz)) > 1.0:
            # Beside the cell its displacements are no guide.
            return np.inf
    local[0], local[1], local[2] = lx, ly, lz
    return max(abs(lx), abs(ly), abs(lz))


@kernel(cached=False)
def _away_from_tissue(local, samples, number, away):
    """Distance of a place in a cell from the samples of one of its pieces along the axis where it is largest."""
    for axis in range(3):
        for sample in range(SAMPLES):
            away[axis, sample] = abs(local[axis] + 0.5 - (sample + 0.5) / SAMPLES)
    least = np.inf
    for row in range(SAMPLES * SAMPLES):
        beside = max(away[1, row % SAMPLES], away[2, row // SAMPLES])
        if beside >= least:
            continue
        for sample in range(SAMPLES):
            if samples[SAMPLES * row + sample] == number:
                least = min(least, max(beside, away[0, sample]))
    return max(least - 0.5 / SAMPLES, 0.0)


@kernel(cached=False)
def _piece_of(tissue, cell):
    """Row of a cell that was parted among those looked at, or -1 where it is whole, and which piece of it this is."""
    if not len(tissue.looked_at):
        return -1, 0
    origin = tissue.origins[cell]
    row = np.searchsorted(tissue.looked_at, origin)
    if row == len(tissue.looked_at) or tissue.looked_at[row] != origin or tissue.counts[row] == 1:
        return -1, 0
    # The first piece has the number of its cell; those of further pieces follow all uncut cells.
    further = tissue.counts[-1] + tissue.first[-1] - len(tissue.counts)
    uncut = len(tissue.origins) - further
    return row, 0 if cell < uncut else 1 + cell - uncut - (tissue.first[row] - row)


@kernel(cached=False)
def _middle(tissue, cell, middle):
    """Write where the middle of a cell is now."""
    for axis in range(3):
        total = 0.0
        for corner in range(8):
            total += tissue.displacement[tissue.corners[cell, corner], axis]
        middle[axis] = (tissue.cells[cell, axis] + 0.5) + total / 8.0


@kernel(cached=False, fastmath={"nnan", "nsz"})
def _most_moved(displacement, moved):
    """Write the least and the largest displacement along each axis, zero among them."""
    least_x = least_y = least_z = most_x = most_y = most_z = np.float32(0.0)
    for node in range(len(displacement)):
        x, y, z = displacement[node, 0], displacement[node, 1], displacement[node, 2]
        least_x, least_y, least_z = min(least_x, x), min(least_y, y), min(least_z, z)
        most_x, most_y, most_z = max(most_x, x), max(most_y, y), max(most_z, z)
    moved[0, 0], moved[0, 1], moved[0, 2] = least_x, least_y, least_z
    moved[1, 0], moved[1, 1], moved[1, 2] = most_x, most_y, most_z


@kernel
def find_near(points, tissue, reach):
    """The cells no further than a reach from one of some places now; and some more (:class:`Near`)."""
    low, high, moved = np.full(3, np.inf), np.full(3, -np.inf), np.zeros((2, 3))
    for point in range(len(points)):
        for axis in range(3):
            low[axis] = min(low[axis], points[point, axis] - reach)
            high[axis] = max(high[axis], points[point, axis] + reach)
    _most_moved(tissue.displacement, moved)
    first, last = low - moved[1] - 0.501, high - moved[0] - 0.499
    cells, middles, count = np.empty(1024, np.int64), np.empty((3, 1024)), 0
    middle = np.empty(3)
    for cell in range(len(tissue.cells)):
        # A cell moves no further than the nodes do, but for rounding.
        if not first[2] <= tissue.cells[cell, 2] <= last[2]:
            continue
        if not (first[1] <= tissue.cells[cell, 1] <= last[1] and first[0] <= tissue.cells[cell, 0] <= last[0]):
            continue
        if count == len(cells):
            cells, middles = np.append(cells, cells), np.concatenate((middles, middles), axis=1)
        inside = True
        _middle(tissue, cell, middle)
        for axis in range(3):
            inside &= low[axis] <= middle[axis] <= high[axis]
            middles[axis, count] = middle[axis]
        if inside:
            cells[count] = cell
            count += 1
    return Near(cells[:count].copy(), middles[:, :count].copy(), reach)


@kernel(cached=False)
def _find_nearest(point, middles, squares, nearest, away):
    """Write which of some middles are nearest to a point, and the squares of how far they are, else infinity."""
    away[:] = np.inf
    nearest[:] = -1
    px, py, pz = point[0], point[1], point[2]
    along_x, along_y, along_z = middles[0], middles[1], middles[2]
    for number in range(len(along_x)):
        x, y, z = px - along_x[number], py - along_y[number], pz - along_z[number]
        squares[number] = x * x + y * y + z * z
    furthest = np.inf
    for number in range(len(along_x)):
        square = squares[number]
        if square < furthest:
            place = _CANDIDATES - 1
            while place > 0 and away[place - 1] > square:
                away[place], nearest[place] = away[place - 1], nearest[place - 1]
                place -= 1
            away[place], nearest[place] = square, number
            furthest = away[_CANDIDATES - 1]


@kernel(cached=False)
def _place_back(point, tissue, cells, middles, room, result):
    """Write the place at rest of one point, from the cells nearest to it; and say whether it lies in no tissue."""
    nearest, away, local, best = room.nearest, room.away, room.local, room.best
    # A cell that was parted takes up its cube with others: a place there belongs to it where its own tissue is.
    least, is_parted, size_there = np.inf, False, np.inf
    for candidate in range(_CANDIDATES):
        if nearest[candidate] < 0:
            break
        cell = cells[nearest[candidate]]
        size = _local_place(point, tissue, cell, local)
        if size == np.inf:
            continue
        off = max(size - 0.5, 0.0)
        row, piece = _piece_of(tissue, cell)
        if row >= 0:
            off = _away_from_tissue(local, tissue.samples[row], piece, room.sides)
        if off < least:
            least, is_parted, size_there = off, row >= 0, size
            for axis in range(3):
                best[axis] = (tissue.cells[cell, axis] + 0.5) + local[axis]
        if least <= 0.0:
            break
    if is_parted or size_there <= _BESIDE:
        result[:] = best
        return least > _TOUCHING if is_parted else least == np.inf
    # Beside the tissue: as the nearest cells have moved, on average, so that no two places near each other part.
    total = 0.0
    best[:] = 0.0
    for candidate in range(_AVERAGED):
        number = nearest[candidate]
        if number >= 0:
            weight = 1.0 / (away[candidate] + 1e-6)
            total += weight
            for axis in range(3):
                best[axis] += weight * (middles[axis, number] - (tissue.cells[cells[number], axis] + 0.5))
    for axis in range(3):
        result[axis] = point[axis] - best[axis] / total
    return least == np.inf


class _Room(NamedTuple):
    """Room for what is worked out for one point."""

    nearest: Int64
    away: Float64
    local: Float64
    best: Float64
    sides: Float64


@kernel
def follow_back(points, tissue, near, wider, result, is_open):
    """Write the place at rest of each point, from the cells around it, and whether it lies in no tissue.

    Cells that are near all points are looked at first, in case they are enough, then those of a wider reach; the result
    is the same whatever these are. What was looked at in the end is returned.
    """
    room = _Room(
        np.empty(_CANDIDATES, np.int64), np.empty(_CANDIDATES), np.empty(3), np.empty(3), np.empty((3, SAMPLES))
    )
    squares = np.empty(max(len(near.cells), len(wider.cells)))
    for point in range(len(points)):
        found = near
        while True:
            _find_nearest(points[point], found.middles, squares, room.nearest, room.away)
            # A cell beyond the box is further away than it reaches, whatever was rounded.
            is_enough = room.away[_CANDIDATES - 1] < 0.999 * found.reach * found.reach
            if is_enough or len(found.cells) == len(tissue.cells):
                break
            if found.reach >= wider.reach:
                wider = find_near(points, tissue, 2.0 * found.reach + 1.0)
                squares = np.empty(max(len(near.cells), len(wider.cells)))
            found = wider
        is_open[point] = _place_back(points[point], tissue, found.cells, found.middles, room, result[point])
    return wider


@kernel
def draw_in(points, is_open, around, halvings, tissue, near, wider, result):
    """Draw points that lie in no tissue, beside one that does, near to it until they have just left the tissue.

    Parameters
    ----------
    points, is_open
        Shape (pose_count, point_count, 3), and which lie in no tissue.
    around
        Steps to the poses and points beside each, the nearest first, shape (any, 2).
    halvings
        Of the way between both.
    tissue, near, wider
        As of :func:`follow_back`.
    result
        Their places at rest; NaN is written where there is none.
    """
    room, count = is_open.sum(), 0
    within, outside, at_edge = np.empty((room, 3)), np.empty((room, 3)), np.empty((room, 3))
    places = np.empty((room, 2), np.int64)
    for pose in range(is_open.shape[0]):
        for point in range(is_open.shape[1]):
            if not is_open[pose, point]:
                continue
            for step in range(len(around)):
                row, column = pose + around[step, 0], point + around[step, 1]
                if not (0 <= row < is_open.shape[0] and 0 <= column < is_open.shape[1]) or is_open[row, column]:
                    continue
                within[count], outside[count] = points[row, column], points[pose, point]
                at_edge[count] = result[pose, point]
                places[count, 0], places[count, 1] = pose, point
                count += 1
                break
            result[pose, point] = np.nan
    within, outside, at_edge = within[:count], outside[:count], at_edge[:count]
    found, is_beyond = np.empty((count, 3)), np.empty(count, np.bool_)
    for _ in range(halvings):
        middles = (within + outside) / 2
        follow_back(middles, tissue, near, wider, found, is_beyond)
        for number in range(count):
            if is_beyond[number]:
                outside[number], at_edge[number] = middles[number], found[number]
            else:
                within[number] = middles[number]
    for number in range(count):
        result[places[number, 0], places[number, 1]] = at_edge[number]
