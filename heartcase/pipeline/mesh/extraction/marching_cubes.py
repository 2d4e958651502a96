"""Kernels of the extraction: the tissue field where its border may be, and marching cubes over it.

The lattice has a layer of points more at every end, where the field is that of the volume's outermost points made
positive, so that the mesh is closed in the outer faces of the voxels. Planes are worked on in parallel: what a plane
adds to the mesh is counted first, so every vertex and triangle has its place before any is made.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.fields.point_kernels import evaluate_owner, scratch
from heartcase.pipeline.fields.reader import FieldReader, steps_through
from heartcase.pipeline.mesh.extraction.marching_cubes_cases import cube_cases
from heartcase.schemas.arrays import Float32, Float64, Int32, UInt8
from heartcase.schemas.geometry import Geometry

__all__ = ["PaddedField", "padded_field", "triangulated_border"]


ROOT_MARGIN = 0.004
"""Part of a lattice edge that vertices keep from its ends."""
ROOT_STEPS = 4
ROOT_TOLERANCE = 1e-3
"""Of the field at a vertex, in lattice spacings."""
STEEPEST = 1.3
"""Assumed of the field: it changes by at most this much per mm, so a block whose middle is farther from zero is passed
over. A distance changes by one; interpolation, and gaps where three structures meet, add to it. The tests compare with
the dense field."""
BLOCK = 4
"""Edge of a block in points; its eight halves are looked at where its middle leaves it open."""
FAR_MM = np.float32(1e4)
"""Field where a block was passed over, with its sign."""


class PaddedField(NamedTuple):
    """The tissue field on a lattice and a layer of points around it, exact wherever a lattice edge may cross zero."""

    tissue_mm: Float32
    """Signed mm, shape ``lattice.shape`` + 2; plus or minus 1e4 mm where no neighbour has another sign. No value is
    nearer to zero than 0.004 of the smallest spacing."""
    void_label: UInt8
    """Label of the nearest void, same shape; where ``tissue_mm`` is plus or minus 1e4 mm, 0
    in the layer around the lattice and anything inside."""


def padded_field(reader: FieldReader, lattice: Geometry) -> PaddedField:
    """Evaluate the structures around the tissue's border.

    Parameters
    ----------
    reader
        The structures.
    lattice
        Parallel to the fields' own.

    """
    start, step = steps_through(reader.structures.geometry, lattice)
    z, y, x = lattice.shape
    field = PaddedField(np.empty((z + 2, y + 2, x + 2), np.float32), np.empty((z + 2, y + 2, x + 2), np.uint8))
    spacing = np.array(lattice.spacing_mm)
    # to the middle of a block's half from its points, and on to their neighbours
    reach = [STEEPEST * (0.5 * (n - 1) * float(np.linalg.norm(spacing)) + float(spacing.max())) for n in (BLOCK, 2)]
    least = np.float32(ROOT_MARGIN * spacing.min())
    _fill_blocks(reader.layout, reader.tables, start, step, np.array(reach, np.float32), least, *field)
    return field


def triangulated_border(reader: FieldReader, lattice: Geometry, field: PaddedField) -> tuple[Float64, UInt8, Int32]:
    """Marching cubes on a field of :func:`padded_field`; vertices are drawn along their edge to the field's root.

    Parameters
    ----------
    reader
        The structures.
    lattice
        The field's lattice, without the layer around it.
    field
        The field.

    Returns
    -------
    index : Float64
        Index (i, j, k) of each vertex on the lattice, shape (vertex_count, 3).
    void_label : UInt8
        Label of the void at the lattice point beyond each vertex.
    triangles : Int32
        Closed and manifold, counter-clockwise from outside the tissue in a right-handed lattice.
    """
    start, step = steps_through(reader.structures.geometry, lattice)
    cases = cube_cases()
    counts = np.empty((2, len(field.tissue_mm)), np.int64)
    _count_in_planes(field.tissue_mm, cases.triangle_count, *counts)
    vertex_start, triangle_start = (np.concatenate([[0], np.cumsum(some)]) for some in counts)
    index = np.empty((int(vertex_start[-1]), 3))
    label = np.empty(len(index), np.uint8)
    triangles = np.empty((int(triangle_start[-1]), 3), np.int32)
    tolerance = np.float32(ROOT_TOLERANCE * min(lattice.spacing_mm))
    _place_vertices(reader.layout, reader.tables, start, step, tolerance, *field, vertex_start, index, label)
    _fill_triangles(field.tissue_mm, cases.triangle_count, cases.edges, vertex_start, triangle_start, triangles)
    return index, label, triangles


@copied
def _owner(layout, tables, start, step, size, k, j, i, spare):
    """Tissue field, void label and tissue label at a place of the padded lattice; clamped to the volume's points."""
    x = min(max(i - 1.0, 0.0), size[2] - 3.0)
    y = min(max(j - 1.0, 0.0), size[1] - 3.0)
    z = min(max(k - 1.0, 0.0), size[0] - 3.0)
    return evaluate_owner(layout, tables, start[0] + x * step[0], start[1] + y * step[1], start[2] + z * step[2], spare)


@copied
def _is_outside(n, count):
    return n == 0 or n == count - 1


@copied
def _fill_far(field, label, k0, k1, j0, j1, i0, i1, value):
    """One value in a block, but positive, and the outside's, in the layer around the lattice."""
    nz, ny, nx = field.shape
    for k in range(k0, k1):
        for j in range(j0, j1):
            edge = _is_outside(k, nz) or _is_outside(j, ny)
            for i in range(i0, i1):
                field[k, j, i] = value
                if edge or _is_outside(i, nx):
                    field[k, j, i] = abs(value)
                    label[k, j, i] = 0


@copied
def _fill_exact(layout, tables, start, step, least, field, label, k0, k1, j0, j1, i0, i1, spare):
    nz, ny, nx = field.shape
    for k in range(k0, k1):
        for j in range(j0, j1):
            edge = _is_outside(k, nz) or _is_outside(j, ny)
            for i in range(i0, i1):
                owner = _owner(layout, tables, start, step, field.shape, k, j, i, spare)
                value = owner[0]
                label[k, j, i] = owner[1]
                if abs(value) < least:
                    value = -least if value < 0.0 else least
                field[k, j, i] = abs(value) if edge or _is_outside(i, nx) else value


@called
def _fill_slab(fields, walls, start, step, reach, least, field, label, slab):
    """Fill one layer of blocks."""
    nz, ny, nx = field.shape
    half = BLOCK // 2
    spare = scratch(fields)
    k0 = slab * BLOCK
    k1 = min(k0 + BLOCK, nz)
    for j0 in range(0, ny, BLOCK):
        j1 = min(j0 + BLOCK, ny)
        for i0 in range(0, nx, BLOCK):
            i1 = min(i0 + BLOCK, nx)
            middle = 0.5 * (BLOCK - 1)
            value = _owner(fields, walls, start, step, field.shape, k0 + middle, j0 + middle, i0 + middle, spare)[0]
            if abs(value) > reach[0]:
                _fill_far(field, label, k0, k1, j0, j1, i0, i1, FAR_MM if value > 0.0 else -FAR_MM)
                continue
            for part in range(8):
                k2 = k0 + half * (part >> 2)
                j2 = j0 + half * (part >> 1 & 1)
                i2 = i0 + half * (part & 1)
                k3, j3, i3 = min(k2 + half, k1), min(j2 + half, j1), min(i2 + half, i1)
                if k2 >= k3 or j2 >= j3 or i2 >= i3:
                    continue
                value = _owner(fields, walls, start, step, field.shape, k2 + 0.5, j2 + 0.5, i2 + 0.5, spare)[0]
                if abs(value) > reach[1]:
                    _fill_far(field, label, k2, k3, j2, j3, i2, i3, FAR_MM if value > 0.0 else -FAR_MM)
                else:
                    _fill_exact(fields, walls, start, step, least, field, label, k2, k3, j2, j3, i2, i3, spare)


@loop_kernel
def _fill_blocks(layout, tables, start, step, reach, least, field, label):
    fields, walls = lend(layout), lend(tables)
    for slab in numba.prange((len(field) + BLOCK - 1) // BLOCK):
        _fill_slab(fields, walls, start, step, reach, least, field, label, slab)


@copied
def _case(field, k, j, i):
    """Number of a cube's case: which of its corners are tissue."""
    return (
        (field[k, j, i] < 0.0)
        | (field[k, j, i + 1] < 0.0) << 1
        | (field[k, j + 1, i] < 0.0) << 2
        | (field[k, j + 1, i + 1] < 0.0) << 3
        | (field[k + 1, j, i] < 0.0) << 4
        | (field[k + 1, j, i + 1] < 0.0) << 5
        | (field[k + 1, j + 1, i] < 0.0) << 6
        | (field[k + 1, j + 1, i + 1] < 0.0) << 7
    )


@called
def _counts_of_plane(field, triangle_count, k):
    """Vertices on the edges that start in a plane of points, and triangles of the cubes above it."""
    nz, ny, nx = field.shape
    vertex_total = 0
    triangle_total = 0
    for j in range(ny):
        for i in range(nx):
            is_tissue = field[k, j, i] < 0.0
            if i + 1 < nx:
                vertex_total += is_tissue != (field[k, j, i + 1] < 0.0)
            if j + 1 < ny:
                vertex_total += is_tissue != (field[k, j + 1, i] < 0.0)
            if k + 1 < nz:
                vertex_total += is_tissue != (field[k + 1, j, i] < 0.0)
                if i + 1 < nx and j + 1 < ny:
                    triangle_total += triangle_count[_case(field, k, j, i)]
    return vertex_total, triangle_total


@loop_kernel
def _count_in_planes(field, triangle_count, vertices, triangles):
    """Count the vertices on the edges that start in each plane of points, and the triangles of the cubes above each."""
    for k in numba.prange(len(field)):
        vertices[k], triangles[k] = _counts_of_plane(field, triangle_count, k)


@copied
def _root(layout, tables, start, step, size, tolerance, k, j, i, axis, low_value, high_value, spare):
    """Part of a lattice edge at which the field is zero (regula falsi, Illinois variant; ends have unlike signs)."""
    low, high = 0.0, 1.0
    f_low, f_high = np.float64(low_value), np.float64(high_value)
    at = f_low / (f_low - f_high)
    side = 0
    for _ in range(ROOT_STEPS):
        x = i + at if axis == 0 else float(i)
        y = j + at if axis == 1 else float(j)
        z = k + at if axis == 2 else float(k)
        value = np.float64(_owner(layout, tables, start, step, size, z, y, x, spare)[0])
        if abs(value) <= tolerance:
            break
        if (value < 0.0) == (f_low < 0.0):
            if side == -1:
                f_high *= 0.5
            low, f_low, side = at, value, -1
        else:
            if side == 1:
                f_low *= 0.5
            high, f_high, side = at, value, 1
        at = low + (high - low) * f_low / (f_low - f_high)
    return min(max(at, ROOT_MARGIN), 1.0 - ROOT_MARGIN)


@called
def _place_vertices_of_plane(fields, walls, start, step, tolerance, field, void, first, index, label, k):
    """Place the vertices on the edges that start in a plane; ``first`` is the number of the first one."""
    nz, ny, nx = field.shape
    spare = scratch(fields)
    n = first
    for j in range(ny):
        for i in range(nx):
            here = field[k, j, i]
            for axis in range(3):
                i1, j1, k1 = i + (axis == 0), j + (axis == 1), k + (axis == 2)
                if i1 == nx or j1 == ny or k1 == nz:
                    continue
                there = field[k1, j1, i1]
                if (here < 0.0) == (there < 0.0):
                    continue
                at = 0.5
                low_outside = _is_outside(i, nx) or _is_outside(j, ny) or _is_outside(k, nz)
                if not (low_outside or _is_outside(i1, nx) or _is_outside(j1, ny) or _is_outside(k1, nz)):
                    at = _root(fields, walls, start, step, field.shape, tolerance, k, j, i, axis, here, there, spare)
                label[n] = void[k, j, i] if there < 0.0 else void[k1, j1, i1]
                index[n, 0] = i - 1.0 + (at if axis == 0 else 0.0)
                index[n, 1] = j - 1.0 + (at if axis == 1 else 0.0)
                index[n, 2] = k - 1.0 + (at if axis == 2 else 0.0)
                n += 1


@loop_kernel
def _place_vertices(layout, tables, start, step, tolerance, field, void, vertex_start, index, label):
    fields, walls = lend(layout), lend(tables)
    for k in numba.prange(len(field)):
        _place_vertices_of_plane(fields, walls, start, step, tolerance, field, void, vertex_start[k], index, label, k)


@copied
def _number_plane(field, k, first, along_x, along_y, along_z):
    """Numbers of the vertices on the edges that start in a plane, in the order in which they are placed."""
    nz, ny, nx = field.shape
    n = first
    for j in range(ny):
        for i in range(nx):
            is_tissue = field[k, j, i] < 0.0
            if i + 1 < nx and is_tissue != (field[k, j, i + 1] < 0.0):
                along_x[j, i] = n
                n += 1
            if j + 1 < ny and is_tissue != (field[k, j + 1, i] < 0.0):
                along_y[j, i] = n
                n += 1
            if k + 1 < nz and is_tissue != (field[k + 1, j, i] < 0.0):
                along_z[j, i] = n
                n += 1


@called
def _fill_triangles_of_plane(field, triangle_count, edges, vertex_start, triangle_start, triangles, k):
    """Make the triangles of the cubes above a plane."""
    ny, nx = field.shape[1:]
    # which vertex lies on each edge along x, y and z from the points of this plane, and of the next
    number = np.empty((2, 3, ny, nx), np.int32)
    for plane in range(2):
        _number_plane(field, k + plane, vertex_start[k + plane], number[plane, 0], number[plane, 1], number[plane, 2])
    n = triangle_start[k]
    for j in range(ny - 1):
        for i in range(nx - 1):
            case = _case(field, k, j, i)
            for t in range(triangle_count[case]):
                for c in range(3):
                    edge = edges[case, t, c]
                    axis = edge // 4
                    one, two = edge & 1, edge >> 1 & 1
                    if axis == 0:
                        triangles[n, c] = number[two, 0, j + one, i]
                    elif axis == 1:
                        triangles[n, c] = number[two, 1, j, i + one]
                    else:
                        triangles[n, c] = number[0, 2, j + two, i + one]
                n += 1


@loop_kernel
def _fill_triangles(field, triangle_count, edges, vertex_start, triangle_start, triangles):
    for k in numba.prange(len(field) - 1):
        _fill_triangles_of_plane(field, triangle_count, edges, vertex_start, triangle_start, triangles, k)
