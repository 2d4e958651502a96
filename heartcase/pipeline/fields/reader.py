"""Reading the structures between voxels: the label at a point, and the distance to the tissue's border.

The stored fields are interpolated; walls and reshapings are then worked out at the point (see
:class:`~heartcase.pipeline.data.Structures`), so a wall or a patch thinner than a voxel is as thick as it should be.

With T the lowest tissue field and V the lowest void field there, the tissue field is the greater in size of T and -V
where the two agree in sign: the depth below the void in tissue, the distance to tissue in the void. Where they do
not, in the hairline gaps and overlaps that interpolated fields leave where three structures meet, it is T - V, so it
is continuous and its zero level is where tissue and void are equally near.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock

import numba
import numpy as np
import numpy.typing as npt

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields.layout import ALL_FIELDS, BLOCK, FieldLayout, layout_of, varying_walls
from heartcase.pipeline.fields.shapes import shape_distance
from heartcase.pipeline.fields.wall_thickness import ThicknessArrays, table_thickness
from heartcase.pipeline.kernels.parallel import every_other
from heartcase.schemas.arrays import Float32, Float64, UInt8
from heartcase.schemas.geometry import Geometry

__all__ = [
    "FieldReader",
    "Ownership",
    "evaluate_owner",
    "forget_layout",
    "ownership_at_points",
    "ownership_on_lattice",
    "scratch",
    "steps_through",
]


NOWHERE_MM = 1e4
"""Field of a label that only a reshaping makes, before it does."""
CHUNK = 4096


@dataclass(frozen=True)
class Ownership:
    """The tissue field and the nearest structures, on a lattice or at points."""

    tissue_mm: Float32
    """Signed distance to the tissue's border, mm, negative in tissue."""
    void_label: UInt8
    """Label of the void (cavity or background) whose field is lowest."""
    tissue_label: UInt8
    """Label of the tissue whose field is lowest."""


@dataclass(frozen=True)
class FieldReader:
    """Structures in the order in which kernels read them: make it once where they are read again and again."""

    structures: Structures
    """What is read."""
    layout: FieldLayout
    """For kernels: stored fields, walls and reshapings."""
    tables: ThicknessArrays
    """For kernels: walls that vary."""

    @classmethod
    def of(cls, structures: Structures | FieldReader) -> FieldReader:
        """Reader of some structures; a reader is returned as it is. Structures stay laid out while they exist."""
        if isinstance(structures, FieldReader):
            return structures
        with _LAYING_OUT:
            if _LAID_OUT not in structures.worked_out:
                structures.worked_out[_LAID_OUT] = layout_of(structures), varying_walls(structures)
            layout, tables = structures.worked_out[_LAID_OUT]
        return cls(structures, layout, tables)

    def serves(self, structures: Structures) -> None:
        """Take what is laid out for other structures too: those of the same fields, walls and reshapings."""
        structures.worked_out[_LAID_OUT] = self.layout, self.tables


_LAID_OUT = "layout and tables"
_LAYING_OUT = Lock()


def forget_layout(structures: Structures) -> None:
    """Free what structures are laid out as, which takes as much memory as their fields; a reader lays them out anew."""
    structures.worked_out.pop(_LAID_OUT, None)


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


@kernel
def _place(x, count):
    """The two voxels around a coordinate, clamped to the lattice, and the second one's weight."""
    x = min(max(x, 0.0), count - 1.0)
    low = min(int(x), max(count - 2, 0))
    return low, min(low + 1, count - 1), np.float32(x - low)


@copied
def _vary(layout, tables, x, y, z, v, thick, scale):
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


@copied
def _grow_walls(layout, v, thick, scale):
    """Give the walls their part of the bare background; ``v`` holds the cavities and the bare background.

    Returns the slot of the wall whose cavity is nearest.
    """
    # what is written to v could be the layout, for all that the compiler knows: it is read before
    wall_cavity, wall_slot = layout.wall_cavity, layout.wall_slot
    count = len(wall_slot)
    bare = v[layout.background]
    outer = np.float32(np.inf)
    nearest = np.float32(np.inf)
    inside = np.float32(np.inf)
    winner = 0
    for w in range(count):
        cavity = v[wall_cavity[w]]
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
        cavity = v[wall_cavity[w]]
        value = max((cavity - thick[w]) * scale[w], bare)
        if inside < np.inf:
            value = max(value, np.float32(0.5) * (cavity - inside))
        v[wall_slot[w]] = value
    v[wall_slot[winner]] = max(outer, bare)
    v[layout.background] = max(bare, -outer)
    return wall_slot[winner]


@copied
def _grow_septa(layout, raw, v):
    """Let the two cavities of each septum give up what lies within half its thickness of the other; ``raw`` as stored.

    The septum ends where a third structure begins; of the background it takes the notch beside the contact, which the
    walls of the two take as well.
    """
    stored_slot, background = layout.stored_slot, layout.background
    for n in range(len(layout.septum_slot)):
        one, other, half = layout.septum_first[n], layout.septum_second[n], layout.septum_half_mm[n]
        value = max(raw[one], raw[other]) - half
        if value > layout.septum_reach_mm:
            continue
        for s in range(len(raw)):
            if s != one and s != other and stored_slot[s] != background:
                value = max(value, -raw[s])
        v[layout.septum_slot[n]] = value
        first, second = stored_slot[one], stored_slot[other]
        v[first] = max(v[first], half - raw[other])
        v[second] = max(v[second], half - raw[one])
        if background >= 0:
            v[background] = max(v[background], -value)


@copied
def _reshape(layout, x, y, z, v):
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
        beside = np.float32(np.inf)
        first = -1
        for s in range(len(v)):
            if source[s]:
                taken = min(taken, v[s])
                v[s] = max(v[s], -shape)
            elif not target[s]:
                beside = min(beside, v[s])
            if target[s]:
                if v[s] < nearest:
                    second = nearest
                    nearest = v[s]
                    first = s
                elif v[s] < second:
                    second = v[s]
        part = max(shape, taken)
        # what is given away ends where another structure begins, and that one ends there
        if beside > np.float32(0.0):
            part = max(part, -beside)
        for s in range(len(v)):
            if not target[s] and not source[s]:
                v[s] = max(v[s], -part)
            if target[s]:
                other = second if s == first else nearest
                gain = part
                if other < np.inf:
                    gain = max(part, np.float32(0.5) * (v[s] - other))
                v[s] = min(v[s], gain)


@kernel
def _evaluate_one(layout, tables, x, y, z, raw, v, thick, scale):
    """Finish a point, given by its index, from the interpolated stored fields ``raw``."""
    stored_slot, labels, tissue_count = layout.stored_slot, layout.labels, layout.tissue_count
    if len(v) > len(raw):
        for s in range(len(v)):
            v[s] = np.float32(NOWHERE_MM)
    for s in range(len(raw)):
        v[stored_slot[s]] = raw[s]
    nearest_wall = -1
    if len(layout.wall_slot) > 0 and layout.background >= 0:
        if len(tables.wall) > 0:
            _vary(layout, tables, x, y, z, v, thick, scale)
        nearest_wall = _grow_walls(layout, v, thick, scale)
    if len(layout.septum_slot) > 0:
        _grow_septa(layout, raw, v)
    if len(layout.shape_kind) > 0:
        _reshape(layout, x, y, z, v)
    lowest_tissue = np.float32(np.inf)
    lowest_void = np.float32(np.inf)
    tissue = np.uint8(0)
    void = np.uint8(0)
    for s in range(tissue_count):
        if v[s] < lowest_tissue:
            lowest_tissue = v[s]
            tissue = labels[s]
    # walls are as near as each other where the background between them is what counts
    if nearest_wall >= 0 and v[nearest_wall] == lowest_tissue:
        tissue = labels[nearest_wall]
    for s in range(tissue_count, len(v)):
        if v[s] < lowest_void:
            lowest_void = v[s]
            void = labels[s]
    if tissue_count == 0:
        return abs(lowest_void), void, tissue
    return _between(lowest_tissue, lowest_void), void, tissue


@kernel
def _between(tissue, void):
    """The tissue field, from the lowest field of a tissue and that of a void."""
    if tissue < 0.0 and void > 0.0:
        return min(tissue, -void)
    if tissue > 0.0 and void < 0.0:
        return max(tissue, -void)
    return tissue - void


@copied
def scratch(layout):
    """What :func:`evaluate_owner` writes into; each thread needs its own."""
    stored, slots, walls = layout.stack.shape[3], len(layout.labels), len(layout.wall_mm)
    spare = np.ones(stored + slots + 2 * walls, np.float32)
    for w in range(walls):
        spare[stored + slots + w] = layout.wall_mm[w]
    return spare


@called
def evaluate_owner(layout, tables, x, y, z, spare):
    """Tissue field, void label and tissue label at one point, given by its index; ``spare`` from scratch().

    For kernels. Layout and tables are lent.
    """
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
        slots, walls = len(layout.labels), len(layout.wall_mm)
        raw, v = spare[:stored], spare[stored : stored + slots]
        thick, scale = spare[stored + slots : stored + slots + walls], spare[stored + slots + walls :]
        for s in range(stored):
            first = flat[a + s] * w00 + flat[b + s] * w01 + flat[c + s] * w10 + flat[d + s] * w11
            second = flat[a + on + s] * w00 + flat[b + on + s] * w01 + flat[c + on + s] * w10 + flat[d + on + s] * w11
            raw[s] = first + fx * (second - first)
        return _evaluate_one(layout, tables, x, y, z, raw, v, thick, scale)
    stored_slot, stored_wall, labels, wall_mm, tissue_count, background = (
        layout.stored_slot,
        layout.stored_wall,
        layout.labels,
        layout.wall_mm,
        layout.tissue_count,
        layout.background,
    )
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
        slot = stored_slot[f]
        if slot < tissue_count:
            if value < lowest_tissue:
                lowest_tissue = value
                tissue_slot = slot
        elif slot == background:
            bare = value
        else:
            if value < lowest_void:
                lowest_void = value
                void_slot = slot
            w = stored_wall[f]
            if w >= 0:
                # as in _grow_walls
                body = value - wall_mm[w]
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
        void_slot = background
    return _between(lowest_tissue, lowest_void), labels[void_slot], labels[tissue_slot]


@loop_kernel
def _evaluate_lattice(layout, tables, start, step, tissue, void_label, tissue_label):
    nz, ny, nx = tissue.shape
    fields, walls = lend(layout), lend(tables)
    for k in numba.prange(nz):
        spare = scratch(fields)
        for j in range(ny):
            y = start[1] + j * step[1]
            z = start[2] + k * step[2]
            for i in range(nx):
                one = evaluate_owner(fields, walls, start[0] + i * step[0], y, z, spare)
                tissue[k, j, i] = one[0]
                void_label[k, j, i] = one[1]
                tissue_label[k, j, i] = one[2]


@loop_kernel
def _evaluate_points(layout, tables, index, tissue, void_label, tissue_label):
    chunks = (len(index) + CHUNK - 1) // CHUNK
    fields, walls = lend(layout), lend(tables)
    for number in numba.prange(chunks):
        chunk = every_other(number, chunks)
        spare = scratch(fields)
        for p in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(index))):
            one = evaluate_owner(fields, walls, index[p, 0], index[p, 1], index[p, 2], spare)
            tissue[p] = one[0]
            void_label[p] = one[1]
            tissue_label[p] = one[2]
