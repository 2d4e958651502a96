"""Which piece of a cut lattice a point belongs to: the nearest tissue that it sees past the sheets: kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float64, Int32, Int64
from heartcase.simulator.cutting.crossings import QUANTA, SAMPLES
from heartcase.simulator.surface_splitting.hiding_sheets import hiding_triangle

__all__ = [
    "NOTHING_SEEN",
    "Answers",
    "CellsByIndex",
    "PieceCells",
    "index_answers",
    "mark_changes",
    "nearest_halves",
    "see_pieces",
]

_TRIES = 48
"""Samples of a cell that are looked for, the nearest first."""
_SAMPLE_COUNT = SAMPLES**3
_STEPS = (0, -1, 1)


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


class CellsByIndex(NamedTuple):
    """Cells of the uncut lattice by their index."""

    low: Int64
    """Lowest index (i, j, k)."""
    numbers: Int32
    """Cell at each index from there on, or -1, three axes."""


class Answers(NamedTuple):
    """What was asked, and what was seen."""

    points: Int64
    """Bits of the points, shape (count, 3)."""
    codes: Int64
    """Which pair of cells each looked for, or -1, shape (count,)."""
    cells: Int64
    """Cell of the uncut lattice that each saw, or -1, shape (count,)."""
    pieces: Int64
    """Which piece of it, shape (count,)."""


NOTHING_SEEN = Answers(np.zeros((0, 3), np.int64), *(np.zeros(0, np.int64) for _ in range(3)))
"""Where nothing was asked before."""


@kernel(cached=False)
def _comes_before(distances, one, other):
    return distances[one] < distances[other] or (distances[one] == distances[other] and one < other)


@kernel(cached=False)
def _sink(distances, order, count, at):
    """Let a sample of a heap go down to its place: the nearest comes first."""
    while True:
        least = 2 * at + 1
        if least >= count:
            return
        if least + 1 < count and _comes_before(distances, order[least + 1], order[least]):
            least += 1
        if not _comes_before(distances, order[least], order[at]):
            return
        order[at], order[least] = order[least], order[at]
        at = least


@kernel(cached=False)
def _see_cell(point, cell, tissue, sheets, limit, reach, place, distances, order):
    """Piece of a cell that a point sees, nearer than the limit, and how far it is; or -1."""
    row = tissue.rows[cell]
    if row < 0:
        distance = 0.0
        for axis in range(3):
            distance += (tissue.middles[cell, axis] - point[axis]) ** 2
        if distance >= limit or hiding_triangle(point, tissue.middles[cell], sheets, reach, -1) >= 0:
            return -1, np.inf
        return 0, distance
    samples = tissue.samples[row]
    count, sample, hidden_by = 0, 0, -1
    for k in range(SAMPLES):
        z = tissue.cells[cell, 2] + (k + 0.5) / SAMPLES - point[2]
        for j in range(SAMPLES):
            y = tissue.cells[cell, 1] + (j + 0.5) / SAMPLES - point[1]
            for i in range(SAMPLES):
                if samples[sample] >= 0:
                    x = tissue.cells[cell, 0] + (i + 0.5) / SAMPLES - point[0]
                    distances[sample] = x * x + y * y + z * z
                    order[count] = sample
                    if count and distances[sample] < distances[order[0]]:
                        order[0], order[count] = order[count], order[0]
                    count += 1
                sample += 1
    for n in range(_TRIES):
        if n == 1:
            # Most see the nearest: only now the others are put in order.
            for at in range(count // 2 - 1, -1, -1):
                _sink(distances, order, count, at)
        if count == 0 or distances[order[0]] >= limit:
            break
        sample = order[0]
        place[0] = tissue.cells[cell, 0] + (sample % SAMPLES + 0.5) / SAMPLES
        place[1] = tissue.cells[cell, 1] + (sample // SAMPLES % SAMPLES + 0.5) / SAMPLES
        place[2] = tissue.cells[cell, 2] + (sample // SAMPLES**2 + 0.5) / SAMPLES
        hidden_by = hiding_triangle(point, place, sheets, reach, hidden_by)
        if hidden_by < 0:
            return tissue.samples[row, sample], distances[sample]
        count -= 1
        order[0] = order[count]
        if n > 0:
            _sink(distances, order, count, 0)
    return -1, np.inf


@kernel(cached=False)
def _cell_at(lattice, i, j, k):
    """Cell of the uncut lattice at an index, or -1."""
    low, numbers = lattice
    i, j, k = i - low[0], j - low[1], k - low[2]
    if i < 0 or j < 0 or k < 0 or i >= numbers.shape[0] or j >= numbers.shape[1] or k >= numbers.shape[2]:
        return -1
    return np.int64(numbers[i, j, k])


@kernel(cached=False)
def _around(point, lattice, found, away):
    """List the cells around a point, that first whose middle is nearest; returns how many there are."""
    x, y, z = np.int64(np.floor(point[0])), np.int64(np.floor(point[1])), np.int64(np.floor(point[2]))
    count = 0
    for a in _STEPS:
        for b in _STEPS:
            for c in _STEPS:
                cell = _cell_at(lattice, x + a, y + b, z + c)
                if cell < 0:
                    continue
                u, v, w = x + a + 0.5 - point[0], y + b + 0.5 - point[1], z + c + 0.5 - point[2]
                distance = u * u + v * v + w * w
                at = count
                while at > 0 and away[at - 1] > distance:
                    away[at], found[at] = away[at - 1], found[at - 1]
                    at -= 1
                away[at], found[at] = distance, cell
                count += 1
    return count


@kernel(cached=False)
def _nearest(point, middles):
    nearest, best = np.inf, 0
    for cell in range(len(middles)):
        distance = 0.0
        for axis in range(3):
            distance += (middles[cell, axis] - point[axis]) ** 2
        if distance < nearest:
            nearest, best = distance, cell
    return best


@kernel(cached=False)
def _slot(table, asked, point, code):
    """Where an answer is in a table, or would be."""
    mixed = point[0] * 0x1E3779B97F4A7C15 ^ (point[1] * 0x3F58476D1CE4E5B9 + code) ^ (point[2] * 0x14D049BB133111EB)
    mixed ^= mixed >> 29
    mixed *= 0x2545F4914F6CDD1D
    at = (mixed >> 20) & (len(table) - 1)
    while table[at] >= 0:
        row = table[at]
        if (
            asked.points[row, 0] == point[0]
            and asked.points[row, 1] == point[1]
            and asked.points[row, 2] == point[2]
            and asked.codes[row] == code
        ):
            return at
        at = (at + 1) & (len(table) - 1)
    return at


@kernel
def index_answers(asked, table):
    """Write where each answer is: a table of a power of two rows, at least twice as many as there are answers."""
    table[:] = -1
    for row in range(len(asked.codes)):
        at = _slot(table, asked, asked.points[row], asked.codes[row])
        if table[at] < 0:
            table[at] = row


@kernel
def mark_changes(vertices, triangles, sheet, first_new, before, now, is_changed, low, marked):
    """Mark where sheets or pieces are other than before.

    Parameters
    ----------
    vertices, triangles, sheet
        Of all sheets' mesh, and the sheet of each triangle.
    first_new
        Number of the first sheet that was not there.
    before, now
        ``(cells, samples)``: cells that sheets come to, ascending, and their samples.
    is_changed
        Whether the pieces of a cell of the uncut lattice changed, false at first; written.
    low, marked
        Index of the first cell of the marks, shape (3,), and the cells that new triangles reach into, false at first;
        written.
    """
    for one in range(len(triangles)):
        if sheet[one] < first_new:
            continue
        p, q, r = vertices[triangles[one, 0]], vertices[triangles[one, 1]], vertices[triangles[one, 2]]
        first, last = np.empty(3, np.int64), np.empty(3, np.int64)
        for axis in range(3):
            first[axis] = max(min(p[axis], q[axis], r[axis]) // QUANTA - low[axis], 0)
            last[axis] = min(max(p[axis], q[axis], r[axis]) // QUANTA - low[axis], marked.shape[axis] - 1)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    marked[i, j, k] = True
    row = 0
    for at in range(len(now[0])):
        while row < len(before[0]) and before[0][row] < now[0][at]:
            is_changed[before[0][row]] = True
            row += 1
        is_same = row < len(before[0]) and before[0][row] == now[0][at]
        if is_same:
            for sample in range(_SAMPLE_COUNT):
                if before[1][row, sample] != now[1][at, sample]:
                    is_same = False
                    break
            row += 1
        if not is_same:
            is_changed[now[0][at]] = True
    for at in range(row, len(before[0])):
        is_changed[before[0][at]] = True


@kernel(cached=False)
def _is_as_before(point, cell, tissue, changes):
    """Whether nothing changed where a point looks for tissue of a cell."""
    is_changed, low, marked = changes
    if is_changed[cell]:
        return False
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        here, there = np.int64(np.floor(point[axis])), np.int64(tissue.cells[cell, axis])
        if tissue.rows[cell] < 0:
            there = np.int64(np.floor(tissue.middles[cell, axis]))
        first[axis], last[axis] = min(here, there) - low[axis], max(here, there) - low[axis]
        if first[axis] < 0 or last[axis] >= marked.shape[axis]:
            return False
    for i in range(first[0], last[0] + 1):
        for j in range(first[1], last[1] + 1):
            for k in range(first[2], last[2] + 1):
                if marked[i, j, k]:
                    return False
    return True


@kernel(cached=False)
def _is_in(point, cell, tissue):
    """Whether a point lies in a cell."""
    x, y, z = np.floor(point[0]), np.floor(point[1]), np.floor(point[2])
    return x == tissue.cells[cell, 0] and y == tissue.cells[cell, 1] and z == tissue.cells[cell, 2]


@kernel(cached=False)
def _is_known(point, pair, code, answer, lattice, tissue, changes, found, away):
    """Whether an answer that a point got before is what it would get now."""
    is_known = True
    if code >= 0:
        for cell in pair:
            is_known = is_known and (cell < 0 or _is_as_before(point, cell, tissue, changes))
        return is_known
    # Of its own cell the middle is nearest.
    if _is_in(point, answer, tissue):
        return _is_as_before(point, answer, tissue, changes)
    for at in range(_around(point, lattice, found, away)):
        is_known = is_known and _is_as_before(point, found[at], tissue, changes)
        # What is behind the one that it sees does not count; but the first may be all that is left.
        if not is_known or (at > 0 and found[at] == answer):
            break
    return is_known


@kernel
def see_pieces(points, bits, codes, pairs, lattice, tissue, sheets, known, table, changes, cells, pieces):
    """Write what each point sees: a cell of the uncut lattice, and the piece of it.

    Parameters
    ----------
    points, bits
        [cells], in the frame of the nodes, shape (count, 3), and the bits of these, int64.
    codes, pairs
        Of each point, which of these pairs of cells it looks for, shape (pair_count, 2): the nearest that it sees, or
        cell -1. At -1 it looks for its own cell or one around it, of which the first that it sees is taken, and the
        nearest if it sees none: then the piece is -1.
    lattice
        Cells by their index.
    tissue, sheets
        Where tissue and sheets are.
    known, table
        What was seen before, and where it is (:func:`index_answers`); none where the table is empty.
    changes
        ``(is_changed, low, marked)``: where other things may be seen now (:func:`mark_changes`).
    cells, pieces
        Shape (count,) each, written.
    """
    reach, place, distances = np.empty((2, 3), np.int64), np.empty(3), np.empty(_SAMPLE_COUNT)
    order, found, away = np.empty(_SAMPLE_COUNT, np.int64), np.empty(27, np.int64), np.empty(27)
    nobody = np.full(2, -1)
    for n in range(len(points)):
        code = codes[n]
        pair = pairs[code] if code >= 0 else nobody
        row = table[_slot(table, known, bits[n], code)] if len(table) else -1
        if row >= 0 and _is_known(points[n], pair, code, known.cells[row], lattice, tissue, changes, found, away):
            cells[n], pieces[n] = known.cells[row], known.pieces[row]
            continue
        cells[n], pieces[n] = -1, 0
        if code >= 0:
            nearest = np.inf
            for at in range(2):
                if pair[at] < 0:
                    continue
                piece, distance = _see_cell(
                    points[n], pair[at], tissue, sheets, nearest, reach, place, distances, order
                )
                if piece >= 0:
                    cells[n], pieces[n], nearest = pair[at], piece, distance
            continue
        # Its own cell is the first of those around it, where there is one.
        x, y, z = np.floor(points[n, 0]), np.floor(points[n, 1]), np.floor(points[n, 2])
        own = _cell_at(lattice, np.int64(x), np.int64(y), np.int64(z))
        if own >= 0:
            pieces[n], _ = _see_cell(points[n], own, tissue, sheets, np.inf, reach, place, distances, order)
        if own >= 0 and pieces[n] >= 0:
            cells[n] = own
            continue
        pieces[n] = -1
        count = _around(points[n], lattice, found, away)
        for at in range(1 if own >= 0 else 0, count):
            piece, _ = _see_cell(points[n], found[at], tissue, sheets, np.inf, reach, place, distances, order)
            if piece >= 0:
                cells[n], pieces[n] = found[at], piece
                break
        if cells[n] < 0:
            cells[n] = found[0] if count else _nearest(points[n], tissue.middles)


@kernel
def nearest_halves(points, cells, indices, corners, halves, offsets, nodes):
    """Write the nodes of the half of a face of its cell that each point is nearest to, shape (count, 3).

    Parameters
    ----------
    points, cells
        Points [cells], in the frame of the nodes, and the cell of each, shapes (count, 3) and (count,).
    indices, corners
        Index (i, j, k) and nodes of all cells, shapes (cell_count, 3) and (cell_count, 8).
    halves, offsets
        Corners of the halves of a cell's faces, the second at a right angle or the first, shape (half_count, 3), and
        the offsets of a cell's corners, shape (8, 3).
    nodes
        Written.
    """
    for n in range(len(points)):
        nearest, chosen = np.inf, 0
        for half in range(len(halves)):
            away = _away(points[n], indices[cells[n]], offsets, halves[half])
            if away < nearest - 1e-12:
                nearest, chosen = away, half
        for corner in range(3):
            nodes[n, corner] = corners[cells[n], halves[chosen, corner]]


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
