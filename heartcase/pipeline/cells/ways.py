"""Line of sight in the fields from a place on the heart's border to a cell: walls, gaps and other voids between.

The visible surface is decimated, so by itself it says only within its own error where a thin wall or a narrow gap is.
All places are in cells: cell (i, j, k) goes from (i, j, k) on, along the grid's axes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.fields.layout import FieldLayout
from heartcase.pipeline.fields.point_kernels import evaluate_owner
from heartcase.pipeline.fields.reader import FieldReader, steps_through
from heartcase.pipeline.fields.wall_thickness import ThicknessArrays
from heartcase.pipeline.kernels.vectors import dot
from heartcase.schemas.arrays import Float64, Int64
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND

__all__ = [
    "CellLattice",
    "FieldsInCells",
    "Searched",
    "field_at",
    "fields_in_cells",
    "hangs_together",
    "is_beyond_wall",
    "looks_elsewhere",
    "searched",
]


BESIDE = 0.05
"""Cells from the border to where the void beside it, or the tissue behind it, is looked up."""
_BEYOND = 0.25
"""Cells beyond a face to which a way that comes from behind, and ends in tissue, is followed on."""
_DEPTH = 0.08
"""Depth, in cells, from which tissue on a way is a wall; the surface itself is off the fields by some of that."""
_STEP = 0.02
"""Least step along a way, in cells."""
_FINE = 4
"""Samples along a cell's edge for what hangs together."""
_AROUND = 1
"""Cells around those of a vertex and a face within which they must hang together."""
_FARTHEST = 6
"""What is more cells apart does not hang together."""
_EDGE = _FINE * (_FARTHEST + 1 + 2 * _AROUND)


class CellLattice(NamedTuple):
    """How places in cells lie among the fields' voxels."""

    start: Float64
    """Index of the place (0, 0, 0) among the fields' voxels, shape (3,)."""
    step: Float64
    """Voxels to the next cell along each axis, shape (3,)."""
    size: Int64
    """Voxels along i, j, k."""
    spacing: Float64
    """Cells between voxels along i, j, k."""
    cells: Int64
    """Cells along i, j, k."""
    cell_mm: float


class FieldsInCells(NamedTuple):
    """Fields as the kernels read them at places in cells, lent (:func:`~heartcase.compiling.tuple_addresses.lend`)."""

    layout: FieldLayout
    tables: ThicknessArrays
    lattice: CellLattice


def fields_in_cells(reader: FieldReader, cells: Geometry) -> FieldsInCells:
    """Fields as read on a lattice of cubic cells; ValueError where it is not parallel to their own."""
    geometry = reader.structures.geometry
    start, step = steps_through(geometry, cells)
    cell_mm = cells.spacing_mm[0]
    lattice = CellLattice(
        start - 0.5 * step,
        step,
        np.array(geometry.size),
        np.array(geometry.spacing_mm) / cell_mm,
        np.array(cells.size),
        cell_mm,
    )
    return FieldsInCells(reader.layout, reader.tables, lattice)


class Searched(NamedTuple):
    """What :func:`hangs_together` writes into; each thread needs its own."""

    stamp: Int64
    """Number of the last search that came to a sample, shape (1 + samples,); first the number of searches."""
    stack: Int64


@copied
def searched():
    """Room for searches of one thread."""
    return Searched(np.zeros(1 + _EDGE**3, np.int64), np.empty(_EDGE**3, np.int64))


@called
def field_at(fields, x, y, z, spare):
    """Tissue field and void at a place; beyond the scanned volume all is void and background.

    Returns the signed distance to tissue, in cells, the label of the nearest void, and how far, in cells, the edge of
    the scan is at least, where the field jumps.
    """
    lattice = fields.lattice
    i = lattice.start[0] + x * lattice.step[0]
    j = lattice.start[1] + y * lattice.step[1]
    k = lattice.start[2] + z * lattice.step[2]
    beyond = max(-0.5 - i, i - lattice.size[0] + 0.5) * lattice.spacing[0]
    beyond = max(beyond, max(-0.5 - j, j - lattice.size[1] + 0.5) * lattice.spacing[1])
    beyond = max(beyond, max(-0.5 - k, k - lattice.size[2] + 0.5) * lattice.spacing[2])
    if beyond > 0.0:
        return beyond, np.uint8(BACKGROUND), beyond
    one = evaluate_owner(fields.layout, fields.tables, i, j, k, spare)
    return one[0] / lattice.cell_mm, one[1], -beyond


@called
def is_beyond_wall(fields, spare, vertex, normal, facing, to):
    """Whether the way from the void beside a vertex to a point of a face leads through tissue into void again.

    It may end in tissue; where it comes from behind the face, it is then followed on beyond it. A wall or a void that
    is less than a fiftieth of a cell long on the way may be missed.
    """
    begin = vertex + BESIDE * normal
    way = to - begin
    if dot(way, facing) > 0.0 and field_at(fields, to[0], to[1], to[2], spare)[0] < 0.0:
        way = way + _BEYOND * facing
    length = np.sqrt(dot(way, way))
    if length == 0.0:
        return False
    was_in_void, was_in_wall = False, False
    at = 0.0
    while True:
        p = begin + at / length * way
        value, _, edge = field_at(fields, p[0], p[1], p[2], spare)
        # half a step away may be void
        is_void = value >= -0.5 * _STEP
        if is_void and was_in_wall:
            return True
        # the decimated surface may be in tissue
        was_in_void |= is_void or (at == 0.0 and value >= -_DEPTH)
        was_in_wall |= was_in_void and value < -_DEPTH
        if at >= length:
            return False
        # fields are hardly ever steeper than a distance: up to twice, in hairlines where three structures meet
        step = value + _DEPTH if was_in_void and not was_in_wall else -value
        at = min(at + max(min(step, edge), _STEP), length)


@called
def looks_elsewhere(fields, spare, room, vertex, normal, facing, cell):
    """Whether a face of a cell looks into another void than a vertex does.

    One of another label is the same void where the two hang together near both.
    """
    there, here = cell + 0.5 + (0.5 + BESIDE) * facing, vertex + BESIDE * normal
    label = field_at(fields, here[0], here[1], here[2], spare)[1]
    if field_at(fields, there[0], there[1], there[2], spare)[1] == label:
        return False
    beyond = np.empty(3, np.int32)
    for axis in range(3):
        beyond[axis] = min(max(cell[axis] + int(np.rint(facing[axis])), 0), fields.lattice.cells[axis] - 1)
    return not hangs_together(fields, spare, room, vertex, normal, beyond, True)


@called
def hangs_together(fields, spare, room, vertex, normal, cell, is_void):
    """Whether the tissue behind a vertex, or the void before it, and that of a cell hang together near both.

    Judged on samples, four along a cell's edge, within the cells of both and one more to every side; tissue hangs
    together across corners of samples, void does not. Beyond the scan its nearest place counts. Where there is no
    such sample at the vertex or in the cell, they do.
    """
    begin = vertex + (BESIDE if is_void else -BESIDE) * normal
    low, high, at = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        at[axis] = min(max(int(np.floor(begin[axis] * _FINE)), 0), _FINE * fields.lattice.cells[axis] - 1)
        first, last = min(at[axis] // _FINE, cell[axis]), max(at[axis] // _FINE, cell[axis])
        if last - first > _FARTHEST:
            return False
        low[axis] = _FINE * max(first - _AROUND, 0)
        high[axis] = _FINE * min(last + _AROUND + 1, fields.lattice.cells[axis])
    if not is_void and (
        _leads_straight(fields, spare, begin, cell) or _leads_straight(fields, spare, begin - normal / _FINE, cell)
    ):
        return True
    room.stamp[0] += 1
    top, is_there = _add(fields, spare, room, low, high, at, 0, 1, cell, is_void, 3, 0)
    if not is_there:
        top, is_there = _add(fields, spare, room, low, high, at, 1, 2, cell, is_void, 3, top)
    if is_there or top == 0:
        return True
    size = high - low
    while top > 0:
        top -= 1
        sample = room.stack[top]
        at[0] = low[0] + sample % size[0]
        at[1] = low[1] + sample // size[0] % size[1]
        at[2] = low[2] + sample // (size[0] * size[1])
        top, is_there = _add(fields, spare, room, low, high, at, 1, 2, cell, is_void, 1 if is_void else 3, top)
        if is_there:
            return True
    for axis in range(3):
        at[axis] = _FINE * cell[axis]
    return not _add(fields, spare, room, low, high, at, 1, _FINE + 1, cell, is_void, 3 * _FINE, 0)[1]


@kernel
def _leads_straight(fields, spare, begin, cell):
    """Whether all samples from that of a place on, each a step nearer to a cell along every axis, are tissue."""
    cells = fields.lattice.cells
    i = min(max(int(np.floor(begin[0] * _FINE)), 0), _FINE * cells[0] - 1)
    j = min(max(int(np.floor(begin[1] * _FINE)), 0), _FINE * cells[1] - 1)
    k = min(max(int(np.floor(begin[2] * _FINE)), 0), _FINE * cells[2] - 1)
    for _ in range(_EDGE):
        if _sample(fields, i, j, k, spare) >= 0.0:
            return False
        to_i, to_j, to_k = _towards(cell[0], i), _towards(cell[1], j), _towards(cell[2], k)
        if to_i == 0 and to_j == 0 and to_k == 0:
            return True
        i, j, k = i + to_i, j + to_j, k + to_k
    return False


@kernel
def _sample(fields, i, j, k, spare):
    """Tissue field, mm, at a sample; beyond the scan that of its nearest place."""
    start, step = fields.lattice.start, fields.lattice.step
    x = start[0] + (i + 0.5) / _FINE * step[0]
    y = start[1] + (j + 0.5) / _FINE * step[1]
    z = start[2] + (k + 0.5) / _FINE * step[2]
    return evaluate_owner(fields.layout, fields.tables, x, y, z, spare)[0]


@called
def _add(fields, spare, room, low, high, at, before, after, cell, is_void, steps, top):
    """Put the samples of tissue, or of void, around one that this search has not come to on the stack.

    Those in a box, and at most some steps away. Returns the height of the stack, and whether one of them is of the
    cell, to which one sample around it belongs.
    """
    stamp = room.stamp[0]
    for dk in range(before + after):
        # what is nearer to the cell comes last, and is gone on from first
        k = at[2] + (after - 1 - dk if _towards(cell[2], at[2]) < 0 else dk - before)
        for dj in range(before + after):
            j = at[1] + (after - 1 - dj if _towards(cell[1], at[1]) < 0 else dj - before)
            for di in range(before + after):
                i = at[0] + (after - 1 - di if _towards(cell[0], at[0]) < 0 else di - before)
                if not (low[0] <= i < high[0] and low[1] <= j < high[1] and low[2] <= k < high[2]):
                    continue
                sample = ((k - low[2]) * (high[1] - low[1]) + j - low[1]) * (high[0] - low[0]) + i - low[0]
                if room.stamp[1 + sample] == stamp or abs(i - at[0]) + abs(j - at[1]) + abs(k - at[2]) > steps:
                    continue
                room.stamp[1 + sample] = stamp
                if (_sample(fields, i, j, k, spare) >= 0.0) == is_void:
                    if _towards(cell[0], i) == 0 and _towards(cell[1], j) == 0 and _towards(cell[2], k) == 0:
                        return top, True
                    room.stack[top] = sample
                    top += 1
    return top, False


@kernel(inline="always")
def _towards(cell, sample):
    """Step from a sample towards a cell along one axis; 0 where it is of the cell, or next to it."""
    if sample < _FINE * cell - 1:
        return 1
    return -1 if sample > _FINE * (cell + 1) else 0
