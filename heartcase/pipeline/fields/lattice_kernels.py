"""Kernels that read the structures at every point of a lattice, row by row.

Which of several fields is lowest is hard to foresee, so a processor that works out one point after the other waits at
nearly every comparison. Here each field in turn is compared at all points of a row, which takes less than half of the
time. Points that a septum, a wall that varies or a reshaping may change are read one by one.
"""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.fields.layout import ALL_FIELDS, BLOCK
from heartcase.pipeline.fields.point_kernels import (
    between,
    distance_to_shape,
    evaluate_owner,
    is_in_reach,
    place,
    scratch,
)

__all__ = ["count_owners", "evaluate_lattice"]


@called
def _places_along(start, step, voxel_count, low, high, share):
    """Write the two voxels around each point along x, and the second one's weight."""
    for n in range(len(low)):
        low[n], high[n], share[n] = place(start + n * step, voxel_count)


@called
def _interpolate_row(layout, y, z, begin, end, voxels, fields):
    """Write the stored fields between the rows around (y, z), from one voxel to another: by voxel, then by field."""
    nz, ny, nx, stored = layout.stack.shape
    j, j1, fy = place(y, ny)
    k, k1, fz = place(z, nz)
    one = np.float32(1.0)
    w00 = (one - fz) * (one - fy)
    w01 = (one - fz) * fy
    w10 = fz * (one - fy)
    w11 = fz * fy
    flat, length = layout.stack.reshape(-1), (end - begin) * stored
    a, b = ((k * ny + j) * nx + begin) * stored, ((k * ny + j1) * nx + begin) * stored
    c, d = ((k1 * ny + j) * nx + begin) * stored, ((k1 * ny + j1) * nx + begin) * stored
    row_a, row_b, row_c, row_d = flat[a : a + length], flat[b : b + length], flat[c : c + length], flat[d : d + length]
    for n in range(length):
        voxels[n] = row_a[n] * w00 + row_b[n] * w01 + row_c[n] * w10 + row_d[n] * w11
    for s in range(stored):
        field = fields[s, begin:end]
        for i in range(len(field)):
            field[i] = voxels[i * stored + s]


@called
def _lowest_in_row(layout, matters, fields, low, high, share, state, slots):
    """Write the lowest tissue, void and cavity (void but the background) at each point of a row, and two slots.

    Of the fields that matter there. ``state`` is room for six numbers a point, the first three are the result;
    ``slots`` for three, the first two are that of the tissue and of the void.
    """
    count = len(low)
    tissue, void, cavity, bare, nearest, inside = state[0], state[1], state[2], state[3], state[4], state[5]
    tissue_slot, void_slot, winner = slots[0], slots[1], slots[2]
    infinite, nil = np.float32(np.inf), np.float32(0.0)
    state[:] = infinite
    slots[:] = -1
    for f in range(len(matters)):
        if not matters[f]:
            continue
        field, slot = fields[f], np.int32(layout.stored_slot[f])
        if slot == layout.background:
            for n in range(count):
                first = field[low[n]]
                bare[n] = first + share[n] * (field[high[n]] - first)
            continue
        wall = layout.stored_wall[f]
        if slot < layout.tissue_count:
            _compared(field, low, high, share, slot, tissue, tissue_slot)
        elif wall < 0:
            _compared(field, low, high, share, slot, cavity, void_slot)
        else:
            thickness = layout.wall_mm[wall]
            for n in range(count):
                first = field[low[n]]
                value = first + share[n] * (field[high[n]] - first)
                is_lower = value < cavity[n]
                void_slot[n] = slot if is_lower else void_slot[n]
                cavity[n] = value if is_lower else cavity[n]
                # as in point_kernels
                body, deepest, least = value - thickness, inside[n], nearest[n]
                is_deepest = (body < nil) & (value < deepest)
                is_nearest = (body >= nil) & (deepest == infinite) & (body < least)
                winner[n] = np.int32(wall) if is_deepest | is_nearest else winner[n]
                inside[n] = value if is_deepest else deepest
                nearest[n] = body if body < least else least
    for n in range(count):
        if winner[n] >= 0:
            wall_field = max(nearest[n], bare[n])
            if wall_field <= tissue[n]:
                tissue[n] = wall_field
                tissue_slot[n] = layout.wall_slot[winner[n]]
            bare[n] = max(bare[n], -nearest[n])
        is_bare = bare[n] <= cavity[n]
        void[n] = bare[n] if is_bare else cavity[n]
        void_slot[n] = layout.background if is_bare else void_slot[n]


@copied
def _compared(field, low, high, share, slot, lowest, lowest_slot):
    """Take one field at all points of a row where it is lower than those before."""
    for n in range(len(low)):
        first = field[low[n]]
        value = first + share[n] * (field[high[n]] - first)
        is_lower = value < lowest[n]
        lowest_slot[n] = slot if is_lower else lowest_slot[n]
        lowest[n] = value if is_lower else lowest[n]


@called
def _fields_of_row(layout, one_by_one, j, k, low, matters):
    """Write which fields matter to the points of a row; says whether any is read with the row.

    Points of blocks that hold all fields are not where they are read ``one_by_one``.
    """
    matters[:] = False
    in_row, last = False, -1
    for n in range(len(low)):
        block = low[n] // BLOCK
        if block == last:
            continue
        last = block
        count = layout.block_count[k // BLOCK, j // BLOCK, block]
        if count != ALL_FIELDS:
            in_row = True
            for m in range(count):
                matters[layout.block_fields[k // BLOCK, j // BLOCK, block, m]] = True
        elif not one_by_one:
            in_row = True
            matters[:] = True
    return in_row


@called
def _lacks_tissue_or_background(layout):
    """Whether no tissue, or no background, is stored: then what is lowest may be what only a reshaping makes."""
    has_tissue, has_background = len(layout.wall_slot) > 0, False
    for slot in layout.stored_slot:
        has_tissue |= slot < layout.tissue_count
        has_background |= slot == layout.background
    return not (has_tissue and has_background)


@called
def _may_change(layout, x, y, z, tissue, void, cavity):
    """Whether a reshaping may change the lowest tissue and void at a point, given by its index, or how low they are.

    ``cavity`` is the lowest void but the background. A reshaping makes no field that it gives to lower than it is far,
    and raises only fields that are deeper than it is far.
    """
    for n in range(len(layout.shape_kind)):
        if not is_in_reach(layout, n, x, y, z):
            continue
        shape = distance_to_shape(layout, n, x, y, z)
        most, least = void, min(tissue, void)
        if layout.target[n, layout.background] and not layout.source[n, layout.background]:
            least = min(tissue, cavity)
        for s in range(len(layout.labels)):
            if layout.target[n, s] and s != layout.background:
                most, least = max(tissue, void), min(tissue, void)
        if shape <= most or shape < -least:
            return True
    return False


@loop_kernel
def evaluate_lattice(layout, tables, start, step, tissue, void_label, tissue_label):
    """Write tissue field, void label and tissue label at every point of a lattice.

    Layout and tables are those of a reader; ``start`` is the index of the first point among the voxels, ``step`` the
    way to the next along x, y and z, in voxels; what is written has shape (nz, ny, nx).
    """
    nz, ny, nx = tissue.shape
    structures, walls = lend(layout), lend(tables)
    for k in numba.prange(nz):
        sz, sy, sx, stored = structures.stack.shape
        low, high, share = np.empty(nx, np.int32), np.empty(nx, np.int32), np.empty(nx, np.float32)
        _places_along(start[0], step[0], sx, low, high, share)
        begin, end = min(low[0], low[nx - 1]), max(high[0], high[nx - 1]) + 1
        voxels, fields = np.empty(sx * stored, np.float32), np.empty((stored, sx), np.float32)
        state, slots = np.empty((6, nx), np.float32), np.empty((3, nx), np.int32)
        matters, spare = np.empty(stored, np.bool_), scratch(structures)
        one_by_one = len(structures.septum_slot) + len(walls.wall) > 0 or _lacks_tissue_or_background(structures)
        z = start[2] + k * step[2]
        voxel_k = place(z, sz)[0]
        for j in range(ny):
            y = start[1] + j * step[1]
            voxel_j = place(y, sy)[0]
            in_row = _fields_of_row(structures, one_by_one, voxel_j, voxel_k, low, matters)
            if in_row:
                _interpolate_row(structures, y, z, begin, end, voxels, fields)
                _lowest_in_row(structures, matters, fields, low, high, share, state, slots)
            for i in range(nx):
                x = start[0] + i * step[0]
                is_alone = structures.block_count[voxel_k // BLOCK, voxel_j // BLOCK, low[i] // BLOCK] == ALL_FIELDS
                if is_alone and not one_by_one:
                    is_alone = _may_change(structures, x, y, z, state[0, i], state[1, i], state[2, i])
                if is_alone:
                    one = evaluate_owner(structures, walls, x, y, z, spare)
                    tissue[k, j, i], void_label[k, j, i], tissue_label[k, j, i] = one
                else:
                    tissue[k, j, i] = between(state[0, i], state[1, i])
                    void_label[k, j, i] = structures.labels[slots[1, i]]
                    tissue_label[k, j, i] = structures.labels[slots[0, i]]


@kernel
def count_owners(tissue, tissue_label, void_label, counts):
    """Add to ``counts``, shape (256,), how many points each label owns: the tissue where its field is negative."""
    nil = np.float32(0.0)
    for n in range(len(tissue)):
        counts[tissue_label[n] if tissue[n] < nil else void_label[n]] += 1
