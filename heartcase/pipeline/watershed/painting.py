"""Painting of the labels: of all voxels, or of those of the basins that changed."""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.marks import mark_below
from heartcase.schemas.arrays import Int32, Int64, UInt8

__all__ = ["TILE", "count_labels", "paint_basins", "paint_boxes", "paint_rows", "tiles_of"]

TILE = 32
"""Voxels along a side of the tiles that labels may be put off in."""

_COUNTED_CHUNKS = 64

MARKED_BASIN = 254
"""In the table of the feet's labels: look at the voxel itself."""


@kernel
def paint_basins(changed, first_voxel, voxel_list, direction, offsets, marks, lowest_mark, foot_label, labels, shape):
    """Label the voxels of some basins anew; lowest and highest (z, y, x) at which that changed something."""
    nz, ny, nx = shape
    low_k, low_j, low_i = np.int64(nz), np.int64(ny), np.int64(nx)
    high_k, high_j, high_i = np.int64(-1), np.int64(-1), np.int64(-1)
    # exact for any index below 2^29, and much quicker than a division of integers
    per_slice, per_row = 1.0 / (nx * ny), 1.0 / nx
    for b in changed:
        is_marked = lowest_mark[b] >= 0
        foot = foot_label[b]
        for n in range(first_voxel[b], first_voxel[b + 1]):
            v = np.int64(voxel_list[n])
            label = foot
            if is_marked:
                mark = mark_below(v, direction, offsets, marks)
                if mark != UNMARKED:
                    label = mark
            if labels[v] != label:
                labels[v] = label
                k = np.int64((v + 0.5) * per_slice)
                rest = v - k * (nx * ny)
                j = np.int64((rest + 0.5) * per_row)
                i = rest - j * nx
                low_k, low_j, low_i = min(low_k, k), min(low_j, j), min(low_i, i)
                high_k, high_j, high_i = max(high_k, k), max(high_j, j), max(high_i, i)
    return np.array([low_k, low_j, low_i]), np.array([high_k, high_j, high_i])


@copied
def _label_of(v, basin, table, direction, offsets, marks, foot_label):
    """Label of a voxel: that of its basin, or of the mark below it where the basin holds marks."""
    label = table[basin[v]]
    if label == MARKED_BASIN:
        mark = mark_below(v, direction, offsets, marks)
        label = mark if mark != UNMARKED else foot_label[basin[v]]
    return label


@copied
def _paint_row(row, begin, basin, table, direction, offsets, marks, foot_label):
    """Label a row; the first and the last place at which that changed something."""
    first = len(row)
    last = -1
    for i in range(len(row)):
        label = _label_of(begin + i, basin, table, direction, offsets, marks, foot_label)
        if row[i] != label:
            row[i] = label
            first = min(first, i)
            last = i
    return first, last


def paint_rows(
    rows: Int64,
    direction: UInt8,
    basin: Int32,
    offsets: Int64,
    marks: UInt8,
    lowest_mark: Int64,
    foot_label: UInt8,
    labels: UInt8,
) -> tuple[Int64, Int64]:
    """Label all voxels; for each chunk of rows the lowest and highest (z, y, x) at which that changed something."""
    low = np.tile(np.array(labels.shape, np.int64), (len(rows) - 1, 1))
    high = np.full((len(rows) - 1, 3), -1, np.int64)
    table = np.where(lowest_mark >= 0, np.uint8(MARKED_BASIN), foot_label)
    _paint_chunks(rows, table, direction, basin, offsets, marks, foot_label, labels, low, high)
    return low, high


@loop_kernel
def _paint_chunks(rows, table, direction, basin, offsets, marks, foot_label, labels, low, high):
    """The same with a table of the basins' labels; ``low`` holds the volume's shape, and ``high`` -1."""
    _, ny, nx = labels.shape
    for c in numba.prange(len(rows) - 1):
        for line in range(rows[c], rows[c + 1]):
            k = line // ny
            j = line - k * ny
            first, last = _paint_row(labels[k, j], line * nx, basin, table, direction, offsets, marks, foot_label)
            if last >= 0:
                low[c, 0], low[c, 1], low[c, 2] = min(low[c, 0], k), min(low[c, 1], j), min(low[c, 2], first)
                high[c, 0], high[c, 1], high[c, 2] = max(high[c, 0], k), max(high[c, 1], j), max(high[c, 2], last)


@loop_kernel
def paint_boxes(low, high, table, direction, basin, offsets, marks, foot_label, labels, is_changed):
    """Label the voxels of boxes, from ``low`` to ``high`` - 1 (z, y, x); notes tiles in which that changed any."""
    _, ny, nx = labels.shape
    for n in numba.prange(len(low)):
        for k in range(low[n, 0], high[n, 0]):
            for j in range(low[n, 1], high[n, 1]):
                row = labels[k, j]
                begin = (k * ny + j) * nx
                for i in range(low[n, 2], high[n, 2]):
                    label = _label_of(begin + i, basin, table, direction, offsets, marks, foot_label)
                    if row[i] != label:
                        row[i] = label
                        # several threads may write the same
                        is_changed[k // TILE, j // TILE, i // TILE] = True


@kernel
def tiles_of(changed, first_voxel, voxel_list, shape, is_in):
    """Note the tiles that hold a voxel of some basins."""
    _, ny, nx = shape
    per_slice, per_row = 1.0 / (nx * ny), 1.0 / nx
    for b in changed:
        for n in range(first_voxel[b], first_voxel[b + 1]):
            v = np.int64(voxel_list[n])
            k = np.int64((v + 0.5) * per_slice)
            rest = v - k * (nx * ny)
            j = np.int64((rest + 0.5) * per_row)
            is_in[k // TILE, j // TILE, (rest - j * nx) // TILE] = True


def count_labels(
    first_voxel: Int64,
    voxel_list: Int32,
    direction: UInt8,
    offsets: Int64,
    marks: UInt8,
    lowest_mark: Int64,
    foot_label: UInt8,
) -> Int64:
    """How many voxels have each label, int64, shape (256,): what painting gives, whether or not it is done."""
    chunks = np.searchsorted(first_voxel, np.linspace(0, len(voxel_list), _COUNTED_CHUNKS + 1))
    counts = np.zeros((_COUNTED_CHUNKS, 256), np.int64)
    _count_chunks(chunks, first_voxel, voxel_list, direction, offsets, marks, lowest_mark, foot_label, counts)
    total: Int64 = counts.sum(axis=0)
    return total


@loop_kernel
def _count_chunks(chunks, first_voxel, voxel_list, direction, offsets, marks, lowest_mark, foot_label, counts):
    """Count the labels of each chunk of basins, int64, shape (chunks, 256)."""
    for c in numba.prange(len(chunks) - 1):
        for b in range(chunks[c], chunks[c + 1]):
            if lowest_mark[b] < 0:
                counts[c, foot_label[b]] += first_voxel[b + 1] - first_voxel[b]
                continue
            for n in range(first_voxel[b], first_voxel[b + 1]):
                mark = mark_below(np.int64(voxel_list[n]), direction, offsets, marks)
                counts[c, mark if mark != UNMARKED else foot_label[b]] += 1
