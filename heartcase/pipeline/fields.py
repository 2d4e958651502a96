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
    return _Layout(
        stack,
        np.array([slot[value] for value in stored], np.int32),
        np.array(labels, np.uint8),
        len(tissues),
        slot.get(BACKGROUND, -1),
        np.array([slot[value] for _, value, _ in walls], np.int32),
        np.array([slot[cavity] for cavity, _, _ in walls], np.int32),
        np.array([thickness for *_, thickness in walls], np.float32),
        np.ascontiguousarray(structures.geometry.affine[:3]),
        *_shapes(structures, slot),
    )


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


@numba.njit(cache=True, nogil=True)
def _lerp(first, second, weight, out):  # type: ignore[no-untyped-def]
    for s in range(len(out)):
        out[s] = first[s] + weight * (second[s] - first[s])


@numba.njit(cache=True, nogil=True)
def _row(stack, y, z, low, high, row):  # type: ignore[no-untyped-def]
    """Interpolate along y and z: all stored fields at voxels ``low`` to ``high`` of a row along x."""
    j, j1, fy = _place(y, stack.shape[1])
    k, k1, fz = _place(z, stack.shape[0])
    one = np.float32(1.0)
    w00 = (one - fz) * (one - fy)
    w01 = (one - fz) * fy
    w10 = fz * (one - fy)
    w11 = fz * fy
    a = stack[k, j, low : high + 1].reshape(-1)
    b = stack[k, j1, low : high + 1].reshape(-1)
    c = stack[k1, j, low : high + 1].reshape(-1)
    d = stack[k1, j1, low : high + 1].reshape(-1)
    for n in range(len(a)):
        row[n] = a[n] * w00 + b[n] * w01 + c[n] * w10 + d[n] * w11


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
    """Give the walls their part of the bare background; ``v`` holds the cavities and the bare background."""
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
    if len(layout.wall_slot) > 0 and layout.background >= 0:
        if len(tables.wall) > 0:
            _vary(layout, tables, x, y, z, v, thick, scale)
        _grow_walls(layout, v, thick, scale)
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
    for s in range(layout.tissue_count, len(v)):
        if v[s] < lowest_void:
            lowest_void = v[s]
            void = layout.labels[s]
    if layout.tissue_count == 0:
        return abs(lowest_void), void, tissue
    if lowest_tissue < 0.0 and lowest_void > 0.0:
        return min(lowest_tissue, -lowest_void), void, tissue
    if lowest_tissue > 0.0 and lowest_void < 0.0:
        return max(lowest_tissue, -lowest_void), void, tissue
    return lowest_tissue - lowest_void, void, tissue


@numba.njit(cache=True, nogil=True, inline="always")
def _interpolate(stack, x, y, z, raw):  # type: ignore[no-untyped-def]
    """All stored fields at one point, by the same steps as :func:`_row` and :func:`_lerp`."""
    nz, ny, nx, stored = stack.shape
    i, i1, fx = _place(x, nx)
    j, j1, fy = _place(y, ny)
    k, k1, fz = _place(z, nz)
    one = np.float32(1.0)
    w00 = (one - fz) * (one - fy)
    w01 = (one - fz) * fy
    w10 = fz * (one - fy)
    w11 = fz * fy
    flat = stack.reshape(-1)
    a, b = ((k * ny + j) * nx + i) * stored, ((k * ny + j1) * nx + i) * stored
    c, d = ((k1 * ny + j) * nx + i) * stored, ((k1 * ny + j1) * nx + i) * stored
    on = (i1 - i) * stored
    for s in range(stored):
        first = flat[a + s] * w00 + flat[b + s] * w01 + flat[c + s] * w10 + flat[d + s] * w11
        second = flat[a + on + s] * w00 + flat[b + on + s] * w01 + flat[c + on + s] * w10 + flat[d + on + s] * w11
        raw[s] = first + fx * (second - first)


@numba.njit(cache=True, nogil=True)
def scratch(layout):  # type: ignore[no-untyped-def]
    """What :func:`evaluate_tissue` writes into; each thread needs its own."""
    raw = np.empty(layout.stack.shape[3], np.float32)
    v = np.empty(len(layout.labels), np.float32)
    return raw, v, layout.wall_mm.copy(), np.ones(len(layout.wall_mm), np.float32)


@numba.njit(cache=True, nogil=True, inline="always")
def evaluate_owner(layout, tables, x, y, z, spare):  # type: ignore[no-untyped-def]
    """Tissue field, void label and tissue label at one point, given by its index; ``spare`` from scratch()."""
    raw, v, thick, scale = spare
    _interpolate(layout.stack, x, y, z, raw)
    return _evaluate_one(layout, tables, x, y, z, raw, v, thick, scale)


@numba.njit(cache=True, nogil=True)
def evaluate_tissue(layout, tables, x, y, z, spare):  # type: ignore[no-untyped-def]
    """Tissue field at one point, given by its index (x, y, z) among the fields' voxels; ``spare`` from scratch()."""
    return evaluate_owner(layout, tables, x, y, z, spare)[0]


@numba.njit(cache=True, nogil=True, parallel=True)
def _evaluate_lattice(layout, tables, start, step, tissue, void_label, tissue_label):  # type: ignore[no-untyped-def]
    nz, ny, nx = tissue.shape
    count = layout.stack.shape[2]
    stored = layout.stack.shape[3]
    first = _place(min(start[0], start[0] + (nx - 1) * step[0]), count)[0]
    last = _place(max(start[0], start[0] + (nx - 1) * step[0]), count)[1]
    for k in numba.prange(nz):
        row = np.empty((last - first + 1) * stored, np.float32)
        raw = np.empty(stored, np.float32)
        v = np.empty(len(layout.labels), np.float32)
        thick = layout.wall_mm.copy()
        scale = np.ones(len(thick), np.float32)
        for j in range(ny):
            y = start[1] + j * step[1]
            z = start[2] + k * step[2]
            _row(layout.stack, y, z, first, last, row)
            for i in range(nx):
                x = start[0] + i * step[0]
                i0, i1, fx = _place(x, count)
                a = (i0 - first) * stored
                b = (i1 - first) * stored
                _lerp(row[a : a + stored], row[b : b + stored], fx, raw)
                one = _evaluate_one(layout, tables, x, y, z, raw, v, thick, scale)
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
