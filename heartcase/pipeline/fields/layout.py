"""The layout of structures in memory for kernels, and the fields that matter in each block.

The stored fields lie side by side, so that a point reads them together. Most of them are far from most points: for each
block of lattice cells it is known which ones can be the lowest anywhere in it, and no others are read there.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields.shapes import SHAPE_KINDS, shape_distance
from heartcase.pipeline.fields.wall_thickness import ThicknessArrays, thickness_arrays
from heartcase.pipeline.kernels.parallel import two_workers
from heartcase.schemas.arrays import Bool, Float32, Float64, Int32, UInt8
from heartcase.schemas.labels import BACKGROUND

__all__ = ["ALL_FIELDS", "BLOCK", "FieldLayout", "layout_of", "varying_walls"]


INTERLEAVED_PLANES = 2
SLACK_MM = np.float32(1e-3)
"""Tolerance of comparisons: what is interpolated may differ in its last digits."""
BLOCK = 4
"""Edge, in lattice cells, of the blocks for which it is known which fields matter in them."""
ALL_FIELDS = 255


class FieldLayout(NamedTuple):
    """What the kernels read. A *slot* is a label's place in the list of all labels: tissues first, each ascending."""

    stack: Float32
    """Stored fields, shape (z, y, x, stored)."""
    stored_slot: Int32
    labels: UInt8
    """Label value of each slot."""
    tissue_count: int
    background: int
    """Slot of the background, or -1."""
    wall_slot: Int32
    wall_cavity: Int32
    """Slots of the grown walls and of their cavities, by ascending cavity."""
    wall_mm: Float32
    """Thickness of each wall; the greatest one where a table says how it varies."""
    to_world: Float64
    """Map from index (i, j, k) to world, shape (3, 4)."""
    shape_kind: Int32
    """Number of :data:`~heartcase.pipeline.fields.shapes.SHAPE_KINDS`; one per reshaping."""
    shape_first: Int32
    """First point of each shape, and the number of all points at the end."""
    shape_points: Float64
    shape_radius: Float64
    shape_low: Float64
    shape_high: Float64
    """Box of indices beyond which a shape is farther away than the band."""
    source: Bool
    target: Bool
    """Shape (reshapings, slots)."""
    stored_wall: Int32
    """Number of the wall that is grown around each stored field, or -1."""
    septum_slot: Int32
    """Slot of each grown septum."""
    septum_first: Int32
    septum_second: Int32
    """Numbers of the stored fields of its two cavities."""
    septum_half_mm: Float32
    """Half of its thickness."""
    septum_reach_mm: float
    """Distance from a septum beyond which it is not looked at."""
    block_count: UInt8
    """How many stored fields matter in each block of lattice cells, shape (z, y, x); 255 where all may."""
    block_fields: UInt8
    """Which, ascending, shape (z, y, x, stored)."""


def layout_of(structures: Structures) -> FieldLayout:
    """Lay structures out for kernels."""
    present = structures.values
    tissues = [value for value in structures.table.tissue_values if value in present]
    voids = [value for value in structures.table.void_values if value in present]
    if not voids:
        raise ValueError("the structures hold no background field")
    labels = tissues + voids
    slot = {value: n for n, value in enumerate(labels)}
    stored = [value for value in labels if value in structures.distance_mm]
    stack = np.empty((*structures.geometry.shape, len(stored)), np.float32)
    _interleave(tuple(structures.distance_mm[value] for value in stored), stack)
    walls = sorted((cavity, value, thickness) for value, (cavity, thickness) in structures.grown_walls.items())
    cavities = [cavity for cavity, *_ in walls]
    shapes = _shapes(structures, slot)
    septa = structures.grown_septa
    nz, ny, nx = (max(-(-(n - 1) // BLOCK), 1) for n in structures.geometry.shape)
    layout = FieldLayout(
        stack,
        np.array([slot[value] for value in stored], np.int32),
        np.array(labels, np.uint8),
        len(tissues),
        slot.get(BACKGROUND, -1),
        np.array([slot[value] for _, value, _ in walls], np.int32),
        np.array([slot[cavity] for cavity in cavities], np.int32),
        np.array([thickness for *_, thickness in walls], np.float32),
        np.ascontiguousarray(structures.geometry.affine[:3]),
        *shapes,
        np.array([cavities.index(value) if value in cavities else -1 for value in stored], np.int32),
        np.array([slot[one.value] for one in septa], np.int32),
        np.array([stored.index(one.first) for one in septa], np.int32),
        np.array([stored.index(one.second) for one in septa], np.int32),
        np.array([0.5 * one.thickness_mm for one in septa], np.float32),
        _septum_reach_mm(structures),
        np.full((nz, ny, nx), ALL_FIELDS, np.uint8),
        np.zeros((nz, ny, nx, len(stored)), np.uint8),
    )
    has_tissue = any(value in stored for value in tissues) or len(walls) > 0 or len(septa) > 0
    if has_tissue and BACKGROUND in stored and not structures.thickness_tables:
        # by themselves: what a parallel loop writes to arrays of a tuple was seen to be lost
        _find_fields_of_blocks(layout, layout.block_count, layout.block_fields)
    return layout


def _septum_reach_mm(structures: Structures) -> float:
    """As far as the fields are exact beyond the thickest wall, and at least a voxel."""
    thickest_mm = max((thickness for _, thickness in structures.grown_walls.values()), default=0.0)
    return float(max(structures.band_mm - thickest_mm, *structures.geometry.spacing_mm))


def varying_walls(structures: Structures) -> ThicknessArrays:
    """The tables of the walls that are grown, read as far from the cavity as the fields are exact."""
    grown = sorted(structures.grown_walls.values())
    cavities, thickest_mm = [cavity for cavity, _ in grown], max((t for _, t in grown), default=0.0)
    tables = [table for table in structures.thickness_tables if table.cavity in cavities]
    margin = max(structures.band_mm - thickest_mm, 0.0)
    walls = [cavities.index(table.cavity) for table in tables]
    return thickness_arrays(tables, walls, nearest_mm=-margin, farthest_mm=thickest_mm + margin)


def _shapes(
    structures: Structures, slot: dict[int, int]
) -> tuple[Int32, Int32, Float64, Float64, Float64, Float64, Bool, Bool]:
    names = {label.name: slot[label.value] for label in structures.table if label.value in slot}
    used = [one for one in structures.reshapings if all(name in names for name in (*one.sources, *one.targets))]
    count = len(used)
    first = np.zeros(count + 1, np.int32)
    low, high = np.empty((count, 3)), np.empty((count, 3))
    source, target = np.zeros((count, len(slot)), np.bool_), np.zeros((count, len(slot)), np.bool_)
    for n, one in enumerate(used):
        first[n + 1] = first[n] + len(one.points_mm)
        index = structures.geometry.world_to_index(np.array(one.points_mm))
        reach = (one.radius_mm + structures.band_mm) / np.array(structures.geometry.spacing_mm)
        low[n], high[n] = index.min(axis=0) - reach, index.max(axis=0) + reach
        source[n, [names[name] for name in one.sources]] = True
        target[n, [names[name] for name in one.targets]] = True
    points = [point for one in used for point in one.points_mm]
    return (
        np.array([SHAPE_KINDS[one.shape] for one in used], np.int32),
        first,
        np.array(points, np.float64).reshape(-1, 3),
        np.array([one.radius_mm for one in used], np.float64),
        low,
        high,
        source,
        target,
    )


def _interleave(fields: tuple[Float32, ...], stack: Float32) -> None:
    """Put the fields side by side, a few planes at a time, so that what is written stays in the cache."""

    def part(start: int) -> None:
        for n, field in enumerate(fields):
            stack[start : start + INTERLEAVED_PLANES, ..., n] = field[start : start + INTERLEAVED_PLANES]

    with two_workers() as pool:
        list(pool.map(part, range(0, len(stack), INTERLEAVED_PLANES)))


class _Bounds(NamedTuple):
    """Bounds of the fields that hold everywhere in a block, mm."""

    tissue: np.float32
    """The lowest tissue, walls among them, is at most this."""
    void: np.float32
    """The lowest void is at most this."""
    cavity: np.float32
    """Every tissue, and every void but the background, is at least this."""
    background: np.float32
    """The background is at least this."""
    body: np.float32
    """The nearest cavity with a wall, its wall's thickness taken off, is at most this."""


@copied
def _bounds_of(fields, low, high):
    """Bounds of a block, from the least and the greatest value of each stored field in it."""
    infinite = np.float32(np.inf)
    tissue, cavity, deepest, body, deepest_body = infinite, infinite, infinite, infinite, infinite
    least, most = -infinite, infinite
    for s in range(len(low)):
        slot, wall = fields.stored_slot[s], fields.stored_wall[s]
        if slot == fields.background:
            least, most = low[s], high[s]
            continue
        deepest = min(deepest, low[s])
        if slot < fields.tissue_count:
            tissue = min(tissue, high[s])
        else:
            cavity = min(cavity, high[s])
        if wall >= 0:
            body = min(body, high[s] - fields.wall_mm[wall])
            deepest_body = min(deepest_body, low[s] - fields.wall_mm[wall])
    # A wall is as far as its cavity but for its thickness, and no nearer than the background that it takes.
    return _Bounds(
        min(tissue, max(body, most)),
        min(cavity, max(most, -deepest_body)),
        min(deepest, deepest_body),
        least,
        body,
    )


@called
def _find_fields_of_layer(fields, block_count, block_fields, bk):
    """Find them in one layer of blocks; see :func:`_find_fields_of_blocks`."""
    nz, ny, nx, stored = fields.stack.shape
    low, high = np.empty(stored, np.float32), np.empty(stored, np.float32)
    for bj in range(block_count.shape[1]):
        for bi in range(block_count.shape[2]):
            low[:] = np.inf
            high[:] = -np.inf
            for k in range(bk * BLOCK, min(bk * BLOCK + BLOCK + 1, nz)):
                for j in range(bj * BLOCK, min(bj * BLOCK + BLOCK + 1, ny)):
                    for i in range(bi * BLOCK, min(bi * BLOCK + BLOCK + 1, nx)):
                        row = fields.stack[k, j, i]
                        for s in range(stored):
                            low[s] = min(low[s], row[s])
                            high[s] = max(high[s], row[s])
            if _is_septal(fields, low):
                continue
            bounds = _bounds_of(fields, low, high)
            if _is_reshaped(fields, bk, bj, bi, bounds):
                continue
            count = 0
            for s in range(stored):
                slot = fields.stored_slot[s]
                if slot < fields.tissue_count:
                    matters = low[s] <= bounds.tissue + SLACK_MM
                else:
                    matters = slot == fields.background or low[s] <= bounds.void + SLACK_MM
                    if fields.stored_wall[s] >= 0:
                        nearest = low[s] - fields.wall_mm[fields.stored_wall[s]]
                        matters |= nearest <= max(bounds.body, np.float32(0.0)) + SLACK_MM
                if matters:
                    block_fields[bk, bj, bi, count] = s
                    count += 1
            block_count[bk, bj, bi] = count


@loop_kernel
def _find_fields_of_blocks(layout, block_count, block_fields):
    """Find the fields that can be lowest anywhere in each block, unless a reshaping or a septum may change that.

    A tissue, or a cavity, whose least value exceeds the greatest one of another is not the lowest anywhere. A cavity
    matters to the walls where it is not farther, its wall's thickness taken off, than another one is everywhere, and
    where its own wall may be. The background always matters.
    """
    fields = lend(layout)
    for bk in numba.prange(block_count.shape[0]):
        _find_fields_of_layer(fields, block_count, block_fields, bk)


@copied
def _is_septal(layout, low):
    """Whether a septum is looked at anywhere in a block, from the least value of each stored field in it."""
    for n in range(len(layout.septum_slot)):
        nearest = max(low[layout.septum_first[n]], low[layout.septum_second[n]])
        if nearest - layout.septum_half_mm[n] <= layout.septum_reach_mm + SLACK_MM:
            return True
    return False


@copied
def _is_reshaped(layout, bk, bj, bi, bounds):
    """Whether a reshaping may change what is lowest anywhere in a block, or how low it is.

    See :func:`heartcase.pipeline.fields.lattice_kernels._may_change`, which says it of a point.
    """
    for n in range(len(layout.shape_kind)):
        to_others = False
        for s in range(len(layout.labels)):
            to_others |= layout.target[n, s] and s != layout.background
        to_background = layout.target[n, layout.background] and not layout.source[n, layout.background]
        most = max(bounds.tissue, bounds.void) if to_others else bounds.void
        least = bounds.cavity if to_background and not to_others else min(bounds.cavity, bounds.background)
        nearest = _nearest_in_block(layout, n, bk, bj, bi) - SLACK_MM
        if nearest <= most or nearest < -least:
            return True
    return False


@copied
def _nearest_in_block(layout, n, bk, bj, bi):
    """No point of a block that a reshaping reaches is nearer to its shape, mm; infinite where it reaches none.

    Blocks at the border hold all that lies beyond.
    """
    blocks, m = layout.block_count.shape, layout.to_world
    box = np.empty((2, 3))
    for axis in range(3):
        b = bi if axis == 0 else (bj if axis == 1 else bk)
        low, high = layout.shape_low[n, axis], layout.shape_high[n, axis]
        if b > 0:
            low = max(low, b * BLOCK)
        if b < blocks[2 - axis] - 1:
            high = min(high, b * BLOCK + BLOCK)
        if low > high:
            return np.inf
        box[0, axis], box[1, axis] = 0.5 * (low + high), 0.5 * (high - low)
    # The distance in its middle changes on the way to any of its points by no more than that is long.
    middle, square = np.empty(3), 0.0
    for axis in range(3):
        reach = 0.0
        middle[axis] = m[axis, 3]
        for a in range(3):
            middle[axis] += m[axis, a] * box[0, a]
            reach += abs(m[axis, a]) * box[1, a]
        square += reach * reach
    points = layout.shape_points[layout.shape_first[n] : layout.shape_first[n + 1]]
    distance = shape_distance(layout.shape_kind[n], points, layout.shape_radius[n], middle[0], middle[1], middle[2])
    return distance - np.sqrt(square)
