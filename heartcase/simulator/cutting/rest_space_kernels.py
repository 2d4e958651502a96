"""Places of deformed tissue at rest: kernels of :mod:`heartcase.simulator.cutting.rest_space`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Float64, Int32, Int64
from heartcase.simulator.cutting.crossings import SAMPLES

__all__ = ["Near", "Tissue", "draw_in", "find_near", "follow_back"]

_CANDIDATES = 16
"""Cells nearest to a place in which it is looked for first; then in all that reach so far."""
_REACH_MOST = 3.5
"""How far a cell reaches from its middle at most, to be looked in although it is none of the nearest [cells]."""
_AVERAGED = 8
"""The nearest of these, as which a place beside the tissue moves."""
_BESIDE = 0.6
"""How far from its centre along an axis a place still belongs to a cell [edges]."""
_ROUNDS = 12
"""Of Newton's method at most: a cell in which it is not there by then is taken not to hold the place."""
_OUTSIDE_MOST = 3
"""Steps of it that may go too far, beyond the surroundings of a cell, before it is given up there."""
_STEP_LEAST = 1e-5
"""A step of it after which it is there: the next one would be about its square [edges]."""
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
    sizes: Float64
    """Square of how far their corners are from there at most, up to that of _REACH_MOST [cells^2], shape (count,)."""
    size_most: float
    """The largest of these; zero where there is no cell."""
    reach: float
    """All are there that are no further than this from one of the places [cells]."""


@kernel(cached=False)
def _local_place(point, tissue, cell, local):
    """Place in a cell from its centre at rest, and the largest of its components: inside up to one half."""
    nodes, displacement, corners = tissue.corners[cell], tissue.displacement, tissue.offsets
    cx, cy, cz = tissue.cells[cell, 0] + 0.5, tissue.cells[cell, 1] + 0.5, tissue.cells[cell, 2] + 0.5
    lx = ly = lz = 0.0
    outside = 0
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
        dx = (x0 * gx + y0 * gy + z0 * gz) / determinant
        dy = (x1 * gx + y1 * gy + z1 * gz) / determinant
        dz = (x2 * gx + y2 * gy + z2 * gz) / determinant
        lx, ly, lz = lx - dx, ly - dy, lz - dz
        size = max(abs(lx), abs(ly), abs(lz))
        if size > 1.0:
            # Beside the cell its displacements are no guide: back to its surroundings.
            outside += 1
            if outside > _OUTSIDE_MOST:
                return np.inf
            lx, ly, lz = min(max(lx, -1.0), 1.0), min(max(ly, -1.0), 1.0), min(max(lz, -1.0), 1.0)
        elif max(abs(dx), abs(dy), abs(dz)) < _STEP_LEAST:
            local[0], local[1], local[2] = lx, ly, lz
            return size
    return np.inf


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
def _size_of(tissue, cell, middle):
    """Square of how far a cell reaches from its middle: no point of it is further away than its corners."""
    size = 0.0
    for corner in range(8):
        square, node = 0.0, tissue.corners[cell, corner]
        for axis in range(3):
            at = (tissue.cells[cell, axis] + 0.5) + tissue.offsets[corner, axis] + tissue.displacement[node, axis]
            square += (at - middle[axis]) ** 2
        size = max(size, square)
    # A little more, whatever was rounded.
    return min(1.0001 * size, _REACH_MOST**2)


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
    cells, middles, sizes, count = np.empty(1024, np.int64), np.empty((3, 1024)), np.empty(1024), 0
    middle = np.empty(3)
    for cell in range(len(tissue.cells)):
        # A cell moves no further than the nodes do, but for rounding.
        if not first[2] <= tissue.cells[cell, 2] <= last[2]:
            continue
        if not (first[1] <= tissue.cells[cell, 1] <= last[1] and first[0] <= tissue.cells[cell, 0] <= last[0]):
            continue
        if count == len(cells):
            cells, middles = np.append(cells, cells), np.concatenate((middles, middles), axis=1)
            sizes = np.append(sizes, sizes)
        inside = True
        _middle(tissue, cell, middle)
        for axis in range(3):
            inside &= low[axis] <= middle[axis] <= high[axis]
            middles[axis, count] = middle[axis]
        if inside:
            cells[count], sizes[count] = cell, _size_of(tissue, cell, middle)
            count += 1
    size_most = sizes[:count].max() if count else 0.0
    return Near(cells[:count].copy(), middles[:, :count].copy(), sizes[:count].copy(), size_most, reach)


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


class _Room(NamedTuple):
    """Room for what is worked out for one point."""

    nearest: Int64
    away: Float64
    local: Float64
    best: Float64
    sides: Float64


class _Found(NamedTuple):
    """Where a point was found best."""

    off: float
    """How far from the cell's own tissue, the largest of the components [edges]."""
    size: float
    """Largest component of its place from the cell's centre [edges]."""
    is_parted: bool
    """Whether the cell was parted."""


@kernel(cached=False)
def _look_in(point, tissue, near, numbers, room, found):
    """Look for a point in some of the cells near it, and keep where it is nearest to a cell's own tissue."""
    local, best, sides = room.local, room.best, room.sides
    # A cell that was parted takes up its cube with others: a place there belongs to it where its own tissue is.
    least, size_there, is_parted = found.off, found.size, found.is_parted
    for number in numbers:
        if number < 0 or least <= 0.0:
            break
        cell = near.cells[number]
        size = _local_place(point, tissue, cell, local)
        if size == np.inf:
            continue
        off = max(size - 0.5, 0.0)
        row, piece = _piece_of(tissue, cell)
        if row >= 0:
            off = _away_from_tissue(local, tissue.samples[row], piece, sides)
        if off < least:
            least, size_there, is_parted = off, size, row >= 0
            for axis in range(3):
                best[axis] = (tissue.cells[cell, axis] + 0.5) + local[axis]
    return _Found(least, size_there, is_parted)


@kernel(cached=False)
def _find_others(near, squares, nearest):
    """Further cells that reach as far as a point is from their middles, beside the nearest."""
    others, count = np.empty(len(squares), np.int64), 0
    for number in range(len(near.cells)):
        if squares[number] <= near.sizes[number] and number not in nearest:
            others[count] = number
            count += 1
    return others[:count]


@kernel(cached=False)
def _place_back(point, near, at_rest, room, found, result):
    """Write the place at rest of one point, from where it was found; and say whether it lies in no tissue."""
    if found.is_parted or found.size <= _BESIDE:
        result[:] = room.best
        return found.off > _TOUCHING if found.is_parted else found.off == np.inf
    # Beside the tissue: as the nearest cells have moved, on average, so that no two places near each other part.
    total = 0.0
    room.best[:] = 0.0
    for candidate in range(_AVERAGED):
        number = room.nearest[candidate]
        if number >= 0:
            weight = 1.0 / (room.away[candidate] + 1e-6)
            total += weight
            for axis in range(3):
                moved = near.middles[axis, number] - (at_rest[near.cells[number], axis] + 0.5)
                room.best[axis] += weight * moved
    for axis in range(3):
        result[axis] = point[axis] - room.best[axis] / total
    return found.off == np.inf


@kernel
def follow_back(points, tissue, near, wider, result, is_open):
    """Write the place at rest of each point, from the cells around it, and whether it lies in no tissue.

    Cells that are near all points are looked at first, in case they are enough, then those of a wider reach; the result
    is the same whatever these are. What was looked at in the end is returned.
    """
    room = _Room(
        np.empty(_CANDIDATES, np.int64), np.empty(_CANDIDATES), np.empty(3), np.empty(3), np.empty((3, SAMPLES))
    )
    squares, nowhere = np.empty(max(len(near.cells), len(wider.cells))), _Found(np.inf, np.inf, False)
    for point in range(len(points)):
        here, found = near, nowhere
        while True:
            _find_nearest(points[point], here.middles, squares, room.nearest, room.away)
            # A cell beyond the box is further away than it reaches, whatever was rounded.
            reach, has_all = 0.999 * here.reach, len(here.cells) == len(tissue.cells)
            if has_all or room.away[_CANDIDATES - 1] < reach * reach:
                found = _look_in(points[point], tissue, here, room.nearest, room, nowhere)
                if has_all or found.off <= 0.0 or reach >= _REACH_MOST:
                    break
            if here.reach >= wider.reach:
                wider = find_near(points, tissue, 2.0 * here.reach + 1.0)
                squares = np.empty(max(len(near.cells), len(wider.cells)))
            here = wider
        # Cells that reach no further than the last of the nearest is away are among these.
        if found.off > 0.0 and here.size_most >= room.away[_CANDIDATES - 1]:
            others = _find_others(here, squares, room.nearest)
            found = _look_in(points[point], tissue, here, others, room, found)
        is_open[point] = _place_back(points[point], here, tissue.cells, room, found, result[point])
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
