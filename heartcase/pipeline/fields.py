"""Reading the structures between voxels: who owns a point, and how far the tissue's border is.

The stored fields are interpolated; walls and reshapings are then worked out at the point (see
:class:`~heartcase.pipeline.data.Structures`), so a wall or a patch thinner than a voxel is as thick as it should be.

With T the lowest tissue field and V the lowest void field there, the tissue field is the greater in size of T and -V
where the two agree in sign: the depth below the void in tissue, the distance to tissue in the void. Where they do
not, in the hairline gaps and overlaps that interpolated fields leave where three structures meet, it is T - V, so it
is continuous and its zero level is where tissue and void are equally near.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Structures
from heartcase.pipeline.shapes import SHAPE_KINDS, shape_distance
from heartcase.pipeline.wall_thickness import ThicknessArrays, table_thickness, thickness_arrays
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND

__all__ = [
    "FieldReader",
    "Ownership",
    "evaluate_owner",
    "evaluate_tissue",
    "ownership_at_points",
    "ownership_on_lattice",
    "scratch",
    "steps_through",
]

Bool = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]

NOWHERE_MM = 1e4
"""Field of a label that only a reshaping makes, before it does."""
CHUNK = 4096
INTERLEAVED_PLANES = 2
BLOCK = 4
"""Edge, in lattice cells, of the blocks for which it is known which fields matter in them."""
ALL_FIELDS = 255


@dataclass(frozen=True)
class Ownership:
    """The tissue field and the nearest structures, on a lattice or at points."""

    tissue_mm: Float32
    """Signed distance to the tissue's border, mm, negative in tissue."""
    void_label: UInt8
    """Label of the void (cavity or background) whose field is lowest."""
    tissue_label: UInt8
    """Label of the tissue whose field is lowest."""


class _Layout(NamedTuple):
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
    """Number of :data:`~heartcase.pipeline.shapes.SHAPE_KINDS`; one per reshaping."""
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
    block_count: UInt8
    """How many stored fields matter in each block of lattice cells, shape (z, y, x); 255 where all may."""
    block_fields: UInt8
    """Which, ascending, shape (z, y, x, stored)."""


@dataclass(frozen=True)
class FieldReader:
    """Structures in the order in which kernels read them: make it once where they are read again and again."""

    structures: Structures
    """What is read."""
    layout: _Layout
    """For kernels: stored fields, walls and reshapings."""
    tables: ThicknessArrays
    """For kernels: walls that vary."""

    @classmethod
    def of(cls, structures: Structures | FieldReader) -> FieldReader:
        """Reader of some structures; a reader is returned as it is."""
        if isinstance(structures, FieldReader):
            return structures
        return cls(structures, _layout(structures), _varying(structures))


def ownership_on_lattice(structures: Structures | FieldReader, lattice: Geometry) -> Ownership:
    """Evaluate the structures at every point of a lattice parallel to their own.

    Parameters
    ----------
    structures
        The structures, or their reader.
    lattice
        Points to evaluate at; any spacing and origin, axes parallel to the fields'. Points outside take the value
        of the nearest point of the fields' lattice.

    Returns
    -------
    Ownership
        Arrays of shape ``lattice.shape``.
    """
    reader = FieldReader.of(structures)
    start, step = steps_through(reader.structures.geometry, lattice)
    tissue = np.empty(lattice.shape, np.float32)
    void_label = np.empty(lattice.shape, np.uint8)
    tissue_label = np.empty(lattice.shape, np.uint8)
    _evaluate_lattice(reader.layout, reader.tables, start, step, tissue, void_label, tissue_label)
    return Ownership(tissue, void_label, tissue_label)


def steps_through(geometry: Geometry, lattice: Geometry) -> tuple[Float64, Float64]:
    """Index of a lattice's first point among a geometry's voxels, and the steps to the next along i, j, k.

    Raises
    ------
    ValueError
        They are not parallel.
    """
    start: Float64 = geometry.world_to_index(lattice.index_to_world((0.0, 0.0, 0.0)))
    steps = np.linalg.inv(geometry.index_to_world_matrix) @ lattice.index_to_world_matrix
    step: Float64 = np.diag(steps).copy()
    if not np.allclose(steps, np.diag(step), atol=1e-6 * np.abs(step).max()):
        raise ValueError("the lattice must be parallel to the fields' own")
    return start, step


def ownership_at_points(structures: Structures | FieldReader, points_mm: npt.ArrayLike) -> Ownership:
    """Evaluate structures, or their reader, at world points, shape (n, 3) in mm; arrays of shape (n,)."""
    reader = FieldReader.of(structures)
    index = np.ascontiguousarray(reader.structures.geometry.world_to_index(points_mm)).reshape(-1, 3)
    tissue = np.empty(len(index), np.float32)
    void_label = np.empty(len(index), np.uint8)
    tissue_label = np.empty(len(index), np.uint8)
    _evaluate_points(reader.layout, reader.tables, index, tissue, void_label, tissue_label)
    return Ownership(tissue, void_label, tissue_label)


def _layout(structures: Structures) -> _Layout:
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
    nz, ny, nx = (max(-(-(n - 1) // BLOCK), 1) for n in structures.geometry.shape)
    layout = _Layout(
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
        np.full((nz, ny, nx), ALL_FIELDS, np.uint8),
        np.zeros((nz, ny, nx, len(stored)), np.uint8),
    )
    has_tissue = any(value in stored for value in tissues) or len(walls) > 0
    if has_tissue and BACKGROUND in stored and not structures.thickness_tables:
        _find_fields_of_blocks(layout, layout.block_count, layout.block_fields)
    return layout


def _varying(structures: Structures) -> ThicknessArrays:
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

    with ThreadPoolExecutor(max_workers=2) as pool:
        list(pool.map(part, range(0, len(stack), INTERLEAVED_PLANES)))


@numba.njit(cache=True, nogil=True)
def _place(x, count):  # type: ignore[no-untyped-def]
    """The two voxels around a coordinate, clamped to the lattice, and the second one's weight."""
    x = min(max(x, 0.0), count - 1.0)
    low = min(int(x), max(count - 2, 0))
    return low, min(low + 1, count - 1), np.float32(x - low)


@numba.njit(cache=True, nogil=True, parallel=True)
def _find_fields_of_blocks(layout, block_count, block_fields):  # type: ignore[no-untyped-def]
    """Find the fields that can be lowest anywhere in each block, in blocks that no reshaping reaches.

    A tissue, or a cavity, whose least value exceeds the greatest one of another is not the lowest anywhere. A cavity
    matters to the walls where it is not farther, its wall's thickness taken off, than another one is everywhere, and
    where its own wall may be. The background always matters.
    """
    nz, ny, nx, stored = layout.stack.shape
    for bk in numba.prange(block_count.shape[0]):
        low, high = np.empty(stored, np.float32), np.empty(stored, np.float32)
        for bj in range(block_count.shape[1]):
            for bi in range(block_count.shape[2]):
                if _is_reshaped(layout, bk, bj, bi):
                    continue
                low[:] = np.inf
                high[:] = -np.inf
                for k in range(bk * BLOCK, min(bk * BLOCK + BLOCK + 1, nz)):
                    for j in range(bj * BLOCK, min(bj * BLOCK + BLOCK + 1, ny)):
                        for i in range(bi * BLOCK, min(bi * BLOCK + BLOCK + 1, nx)):
                            row = layout.stack[k, j, i]
                            for s in range(stored):
                                low[s] = min(low[s], row[s])
                                high[s] = max(high[s], row[s])
                tissue, void, body = np.float32(np.inf), np.float32(np.inf), np.float32(np.inf)
                for s in range(stored):
                    slot = layout.stored_slot[s]
                    if slot < layout.tissue_count:
                        tissue = min(tissue, high[s])
                    elif slot != layout.background:
                        void = min(void, high[s])
                        if layout.stored_wall[s] >= 0:
                            body = min(body, high[s] - layout.wall_mm[layout.stored_wall[s]])
                # what is interpolated may differ in its last digits
                slack = np.float32(1e-3)
                count = 0
                for s in range(stored):
                    slot = layout.stored_slot[s]
                    if slot < layout.tissue_count:
                        matters = low[s] <= tissue + slack
                    else:
                        matters = slot == layout.background or low[s] <= void + slack
                        if layout.stored_wall[s] >= 0:
                            nearest = low[s] - layout.wall_mm[layout.stored_wall[s]]
                            matters |= nearest <= max(body, np.float32(0.0)) + slack
                    if matters:
                        block_fields[bk, bj, bi, count] = s
                        count += 1
                block_count[bk, bj, bi] = count


@numba.njit(cache=True, nogil=True)
def _is_reshaped(layout, bk, bj, bi):  # type: ignore[no-untyped-def]
    """Whether a reshaping may reach into a block; those at the border hold all that lies beyond."""
    blocks = layout.block_count.shape
    for n in range(len(layout.shape_kind)):
        apart = False
        for axis in range(3):
            b = bi if axis == 0 else (bj if axis == 1 else bk)
            last = blocks[2 - axis] - 1
            apart |= b < last and b * BLOCK + BLOCK < layout.shape_low[n, axis]
            apart |= b > 0 and b * BLOCK > layout.shape_high[n, axis]
        if not apart:
            return True
    return False


@numba.njit(cache=True, nogil=True)
def _vary(layout, tables, x, y, z, v, thick, scale):  # type: ignore[no-untyped-def]
    """Thickness at a point, given by its index, of the walls that have a table, and what makes a distance of it."""
    m = layout.to_world
    for n in range(len(tables.wall)):
        w = tables.wall[n]
        cavity = v[layout.wall_cavity[w]]
        thick[w] = layout.wall_mm[w]
        scale[w] = np.float32(1.0)
        if tables.nearest_mm <= cavity <= tables.farthest_mm:
            wx = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
            wy = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
            wz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
            value, slope = table_thickness(tables, n, wx, wy, wz)
            thick[w] = np.float32(value)
            scale[w] = np.float32(1.0 / np.sqrt(1.0 + slope * slope))


@numba.njit(cache=True, nogil=True, inline="always")
def _grow_walls(layout, v, thick, scale):  # type: ignore[no-untyped-def]
    """Give the walls their part of the bare background; ``v`` holds the cavities and the bare background.

    Returns the slot of the wall whose cavity is nearest.
    """
    count = len(layout.wall_slot)
    bare = v[layout.background]
    outer = np.float32(np.inf)
    nearest = np.float32(np.inf)
    inside = np.float32(np.inf)
    winner = 0
    for w in range(count):
        cavity = v[layout.wall_cavity[w]]
        body = (cavity - thick[w]) * scale[w]
        if body < np.float32(0.0):
            if cavity < inside:
                inside = cavity
                winner = w
        elif inside == np.inf and body < nearest:
            winner = w
        nearest = min(nearest, body)
    outer = nearest
    for w in range(count):
        cavity = v[layout.wall_cavity[w]]
        value = max((cavity - thick[w]) * scale[w], bare)
        if inside < np.inf:
            value = max(value, np.float32(0.5) * (cavity - inside))
        v[layout.wall_slot[w]] = value
    v[layout.wall_slot[winner]] = max(outer, bare)
    v[layout.background] = max(bare, -outer)
    return layout.wall_slot[winner]


@numba.njit(cache=True, nogil=True, inline="always")
def _reshape(layout, x, y, z, v):  # type: ignore[no-untyped-def]
    """Carry out the reshapings at a point, given by its index."""
    m = layout.to_world
    for n in range(len(layout.shape_kind)):
        if x < layout.shape_low[n, 0] or y < layout.shape_low[n, 1] or z < layout.shape_low[n, 2]:
            continue
        if x > layout.shape_high[n, 0] or y > layout.shape_high[n, 1] or z > layout.shape_high[n, 2]:
            continue
        wx = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        wy = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        wz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        points = layout.shape_points[layout.shape_first[n] : layout.shape_first[n + 1]]
        shape = np.float32(shape_distance(layout.shape_kind[n], points, layout.shape_radius[n], wx, wy, wz))
        source = layout.source[n]
        target = layout.target[n]
        taken = np.float32(np.inf)
        nearest = np.float32(np.inf)
        second = np.float32(np.inf)
        first = -1
        for s in range(len(v)):
            if source[s]:
                taken = min(taken, v[s])
                v[s] = max(v[s], -shape)
            if target[s]:
                if v[s] < nearest:
                    second = nearest
                    nearest = v[s]
                    first = s
                elif v[s] < second:
                    second = v[s]
        part = max(shape, taken)
        for s in range(len(v)):
            if target[s]:
                other = second if s == first else nearest
                gain = part
                if other < np.inf:
                    gain = max(part, np.float32(0.5) * (v[s] - other))
                v[s] = min(v[s], gain)


@numba.njit(cache=True, nogil=True, inline="always")
def _evaluate_one(layout, tables, x, y, z, raw, v, thick, scale):  # type: ignore[no-untyped-def]
    """Finish a point, given by its index, from the interpolated stored fields ``raw``."""
    if len(v) > len(raw):
        for s in range(len(v)):
            v[s] = np.float32(NOWHERE_MM)
    for s in range(len(raw)):
        v[layout.stored_slot[s]] = raw[s]
    nearest_wall = -1
    if len(layout.wall_slot) > 0 and layout.background >= 0:
        if len(tables.wall) > 0:
            _vary(layout, tables, x, y, z, v, thick, scale)
        nearest_wall = _grow_walls(layout, v, thick, scale)
    if len(layout.shape_kind) > 0:
        _reshape(layout, x, y, z, v)
    lowest_tissue = np.float32(np.inf)
    lowest_void = np.float32(np.inf)
    tissue = np.uint8(0)
    void = np.uint8(0)
    for s in range(layout.tissue_count):
        if v[s] < lowest_tissue:
            lowest_tissue = v[s]
            tissue = layout.labels[s]
    # walls are as near as each other where the background between them is what counts
    if nearest_wall >= 0 and v[nearest_wall] == lowest_tissue:
        tissue = layout.labels[nearest_wall]
    for s in range(layout.tissue_count, len(v)):
        if v[s] < lowest_void:
            lowest_void = v[s]
            void = layout.labels[s]
    if layout.tissue_count == 0:
        return abs(lowest_void), void, tissue
    return _between(lowest_tissue, lowest_void), void, tissue


@numba.njit(cache=True, nogil=True, inline="always")
def _between(tissue, void):  # type: ignore[no-untyped-def]
    """The tissue field, from the lowest field of a tissue and that of a void."""
    if tissue < 0.0 and void > 0.0:
        return min(tissue, -void)
    if tissue > 0.0 and void < 0.0:
        return max(tissue, -void)
    return tissue - void


@numba.njit(cache=True, nogil=True)
def scratch(layout):  # type: ignore[no-untyped-def]
    """What :func:`evaluate_tissue` writes into; each thread needs its own."""
    raw = np.empty(layout.stack.shape[3], np.float32)
    v = np.empty(len(layout.labels), np.float32)
    return raw, v, layout.wall_mm.copy(), np.ones(len(layout.wall_mm), np.float32)


@numba.njit(cache=True, nogil=True, inline="always")
def evaluate_owner(layout, tables, x, y, z, spare):  # type: ignore[no-untyped-def]
    """Tissue field, void label and tissue label at one point, given by its index; ``spare`` from scratch()."""
    nz, ny, nx, stored = layout.stack.shape
    i, i1, fx = _place(x, nx)
    j, j1, fy = _place(y, ny)
    k, k1, fz = _place(z, nz)
    one = np.float32(1.0)
    w00 = (one - fz) * (one - fy)
    w01 = (one - fz) * fy
    w10 = fz * (one - fy)
    w11 = fz * fy
    flat = layout.stack.reshape(-1)
    a, b = ((k * ny + j) * nx + i) * stored, ((k * ny + j1) * nx + i) * stored
    c, d = ((k1 * ny + j) * nx + i) * stored, ((k1 * ny + j1) * nx + i) * stored
    on = (i1 - i) * stored
    count = layout.block_count[k // BLOCK, j // BLOCK, i // BLOCK]
    if count == ALL_FIELDS:
        raw, v, thick, scale = spare
        for s in range(stored):
            first = flat[a + s] * w00 + flat[b + s] * w01 + flat[c + s] * w10 + flat[d + s] * w11
            second = flat[a + on + s] * w00 + flat[b + on + s] * w01 + flat[c + on + s] * w10 + flat[d + on + s] * w11
            raw[s] = first + fx * (second - first)
        return _evaluate_one(layout, tables, x, y, z, raw, v, thick, scale)
    fields = layout.block_fields[k // BLOCK, j // BLOCK, i // BLOCK]
    lowest_tissue, lowest_void = np.float32(np.inf), np.float32(np.inf)
    tissue_slot, void_slot = -1, -1
    bare, nearest, inside = np.float32(np.inf), np.float32(np.inf), np.float32(np.inf)
    winner = -1
    for n in range(count):
        f = np.int64(fields[n])
        first = flat[a + f] * w00 + flat[b + f] * w01 + flat[c + f] * w10 + flat[d + f] * w11
        second = flat[a + on + f] * w00 + flat[b + on + f] * w01 + flat[c + on + f] * w10 + flat[d + on + f] * w11
        value = first + fx * (second - first)
        slot = layout.stored_slot[f]
        if slot < layout.tissue_count:
            if value < lowest_tissue:
                lowest_tissue = value
                tissue_slot = slot
        elif slot == layout.background:
            bare = value
        else:
            if value < lowest_void:
                lowest_void = value
                void_slot = slot
            w = layout.stored_wall[f]
            if w >= 0:
                # as in _grow_walls
                body = value - layout.wall_mm[w]
                if body < np.float32(0.0):
                    if value < inside:
                        inside = value
                        winner = w
                elif inside == np.inf and body < nearest:
                    winner = w
                nearest = min(nearest, body)
    if winner >= 0:
        value = max(nearest, bare)
        if value <= lowest_tissue:
            lowest_tissue = value
            tissue_slot = layout.wall_slot[winner]
        bare = max(bare, -nearest)
    if bare <= lowest_void:
        lowest_void = bare
        void_slot = layout.background
    return _between(lowest_tissue, lowest_void), layout.labels[void_slot], layout.labels[tissue_slot]


@numba.njit(cache=True, nogil=True)
def evaluate_tissue(layout, tables, x, y, z, spare):  # type: ignore[no-untyped-def]
    """Tissue field at one point, given by its index (x, y, z) among the fields' voxels; ``spare`` from scratch()."""
    return evaluate_owner(layout, tables, x, y, z, spare)[0]


@numba.njit(cache=True, nogil=True, parallel=True)
def _evaluate_lattice(layout, tables, start, step, tissue, void_label, tissue_label):  # type: ignore[no-untyped-def]
    nz, ny, nx = tissue.shape
    for k in numba.prange(nz):
        spare = scratch(layout)
        for j in range(ny):
            y = start[1] + j * step[1]
            z = start[2] + k * step[2]
            for i in range(nx):
                one = evaluate_owner(layout, tables, start[0] + i * step[0], y, z, spare)
                tissue[k, j, i] = one[0]
                void_label[k, j, i] = one[1]
                tissue_label[k, j, i] = one[2]


@numba.njit(cache=True, nogil=True, parallel=True)
def _evaluate_points(layout, tables, index, tissue, void_label, tissue_label):  # type: ignore[no-untyped-def]
    for chunk in numba.prange((len(index) + CHUNK - 1) // CHUNK):
        spare = scratch(layout)
        for p in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(index))):
            one = evaluate_owner(layout, tables, index[p, 0], index[p, 1], index[p, 2], spare)
            tissue[p] = one[0]
            void_label[p] = one[1]
            tissue_label[p] = one[2]
