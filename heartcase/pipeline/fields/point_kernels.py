"""Kernels that read the structures at one point: the fields between voxels, then walls, septa and reshapings."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import kernel
from heartcase.compiling.tuple_addresses import uncounted
from heartcase.pipeline.fields.layout import ALL_FIELDS, BLOCK
from heartcase.pipeline.fields.shapes import shape_distance
from heartcase.pipeline.fields.wall_thickness import table_thickness

__all__ = ["between", "distance_to_shape", "evaluate_owner", "is_in_reach", "place", "scratch"]

NOWHERE_MM = 1e4
"""Field of a label that only a reshaping makes, before it does."""


@kernel
def place(x, count):
    """The two voxels around a coordinate, clamped to the lattice, and the second one's weight."""
    x = min(max(x, 0.0), count - 1.0)
    low = min(int(x), max(count - 2, 0))
    return low, min(low + 1, count - 1), np.float32(x - low)


@copied
def _to_world(layout, x, y, z):
    m = layout.to_world
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3],
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3],
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3],
    )


@copied
def is_in_reach(layout, n, x, y, z):
    """Whether a point, given by its index, lies in the box that a reshaping reaches."""
    low, high = layout.shape_low, layout.shape_high
    if x < low[n, 0] or y < low[n, 1] or z < low[n, 2]:
        return False
    return x <= high[n, 0] and y <= high[n, 1] and z <= high[n, 2]


@copied
def distance_to_shape(layout, n, x, y, z):
    """Signed distance of a point, given by its index, to the shape of a reshaping, mm."""
    wx, wy, wz = _to_world(layout, x, y, z)
    points = layout.shape_points[layout.shape_first[n] : layout.shape_first[n + 1]]
    return np.float32(shape_distance(layout.shape_kind[n], points, layout.shape_radius[n], wx, wy, wz))


@copied
def _vary(layout, tables, x, y, z, v, thick, scale):
    """Thickness at a point, given by its index, of the walls that have a table, and what makes a distance of it."""
    for n in range(len(tables.wall)):
        w = tables.wall[n]
        cavity = v[layout.wall_cavity[w]]
        thick[w] = layout.wall_mm[w]
        scale[w] = np.float32(1.0)
        if tables.nearest_mm <= cavity <= tables.farthest_mm:
            wx, wy, wz = _to_world(layout, x, y, z)
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
    for n in range(len(layout.shape_kind)):
        if not is_in_reach(layout, n, x, y, z):
            continue
        shape = distance_to_shape(layout, n, x, y, z)
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
    return between(lowest_tissue, lowest_void), void, tissue


@kernel
def between(tissue, void):
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
    spare = uncounted(spare)
    nz, ny, nx, stored = layout.stack.shape
    i, i1, fx = place(x, nx)
    j, j1, fy = place(y, ny)
    k, k1, fz = place(z, nz)
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
    return between(lowest_tissue, lowest_void), labels[void_slot], labels[tissue_slot]
