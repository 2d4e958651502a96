"""Normals of the tissue field, free of the steps that labels of voxels leave in it.

A point beside the surface is drawn to the root of the field. There the field's slope along the surface is fitted on a
ring around the point, and tilts the normal that is known roughly. Fields that came from labels hold the voxels' steps:
the wider the ring, the less do they show, so the widest ring is taken on which the field rises like one plane. Fields
without steps are read on a narrow ring, as a wider one flattens what is really there. Against the truth, the gradient
of a stepped field at the point itself is no better than the normals of a coarse mesh
(``heartcase bench geometry-chain``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from heartcase.compiling.calls import called
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.fields.point_kernels import evaluate_owner, scratch
from heartcase.pipeline.fields.reader import FieldReader
from heartcase.pipeline.kernels.parallel import every_other
from heartcase.pipeline.kernels.vectors import cross, make_unit, put
from heartcase.schemas.arrays import Bool, Float64

__all__ = ["Rings", "fit_normal", "fitted_normals", "rings_of", "to_index_matrix"]


CHUNK = 256
STEPPED_SPANS_VOXELS = (3.5, 3.0, 2.5, 2.0, 1.5)
"""Radii of the rings in fields that came from labels, from wide to narrow."""
SMOOTH_SPANS_VOXELS = (0.5,)
"""Radii of the rings in fields without steps."""
RING_WAYS = 4
"""Directions along the surface in which the field's rise is taken, each both ways."""
RING_MISFIT = 0.09
"""Largest misfit of a rise, over the radius in voxels, at which a ring's rises are those of one plane."""
_COSINES = tuple(math.cos(math.pi * way / RING_WAYS) for way in range(RING_WAYS))
_SINES = tuple(math.sin(math.pi * way / RING_WAYS) for way in range(RING_WAYS))


class Rings(NamedTuple):
    """The rings on which normals are fitted."""

    spans_mm: Float64
    """Radii, from wide to narrow."""
    misfits: Float64
    """Largest misfit of a ring's rises at which they are those of one plane."""


def to_index_matrix(reader: FieldReader) -> Float64:
    """World mm to voxel index, shape (3, 4)."""
    return np.ascontiguousarray(np.linalg.inv(reader.structures.geometry.affine)[:3])


def rings_of(reader: FieldReader) -> Rings:
    """The rings for these structures."""
    structures = reader.structures
    voxels = np.array(STEPPED_SPANS_VOXELS if structures.has_voxel_steps else SMOOTH_SPANS_VOXELS)
    return Rings(voxels * float(np.mean(structures.geometry.spacing_mm)), RING_MISFIT / voxels)


def fitted_normals(
    reader: FieldReader, points_mm: Float64, normals: Float64, *, reach_mm: float
) -> tuple[Float64, Float64, Bool]:
    """Draw points to the nearest root of the tissue field along their rough normals, and fit the normals there.

    Parameters
    ----------
    reader
        The structures.
    points_mm
        World points, shape (n, 3).
    normals
        Rough unit normals out of the tissue, shape (n, 3).
    reach_mm
        Longest way to the root.

    Returns
    -------
    points : Float64
        The drawn points, shape (n, 3).
    normals : Float64
        Unit normals, shape (n, 3); where no ring fits, as the narrowest says.
    found : Bool
        Where one does, shape (n,).
    """
    drawn, fitted, found = np.empty_like(points_mm), np.empty_like(points_mm), np.empty(len(points_mm), np.bool_)
    rings = rings_of(reader)
    _fit_points(
        reader.layout, reader.tables, to_index_matrix(reader), points_mm, normals, rings, reach_mm, drawn, fitted, found
    )
    return drawn, fitted, found


@kernel
def _value(layout, tables, m, x, y, z, spare):
    """Tissue field at a world point; ``m`` maps world to index."""
    i = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
    j = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
    k = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    return np.float64(evaluate_owner(layout, tables, i, j, k, spare)[0])


@called
def _slope(layout, tables, m, at, first, second, span, spare, rise):
    """Slope along two unit vectors on a ring, and the largest misfit of a rise to it."""
    along_first = 0.0
    along_second = 0.0
    for way in range(RING_WAYS):
        cosine, sine = _COSINES[way], _SINES[way]
        x = span * (cosine * first[0] + sine * second[0])
        y = span * (cosine * first[1] + sine * second[1])
        z = span * (cosine * first[2] + sine * second[2])
        above = 0.0
        # in one place, as the whole reading of the fields is compiled into it
        for sign in (1.0, -1.0):
            value = _value(layout, tables, m, at[0] + sign * x, at[1] + sign * y, at[2] + sign * z, spare)
            if sign > 0.0:
                above = value
            else:
                rise[way] = (above - value) / (2.0 * span)
        along_first += 2.0 / RING_WAYS * cosine * rise[way]
        along_second += 2.0 / RING_WAYS * sine * rise[way]
    misfit = 0.0
    for way in range(RING_WAYS):
        cosine, sine = _COSINES[way], _SINES[way]
        misfit = max(misfit, abs(rise[way] - cosine * along_first - sine * along_second))
    return along_first, along_second, misfit


@called
def fit_normal(layout, tables, m, here, normal, rings, reach, spare, work, there, out):
    """Draw a point to the field's root along a rough normal, and fit the normal there; returns whether a ring fits.

    ``there`` receives the drawn point, ``out`` the normal; where no ring fits, that of the narrowest.
    ``work`` has shape (3, RING_WAYS). Layout, tables and rings are lent.
    """
    away = 0.0
    put(here, there)
    for _ in range(2):
        away -= _value(layout, tables, m, there[0], there[1], there[2], spare)
        away = min(max(away, -reach), reach)
        for axis in range(3):
            there[axis] = here[axis] + away * normal[axis]
    least = 0
    for axis in range(1, 3):
        if abs(normal[axis]) < abs(normal[least]):
            least = axis
    first, second, rise = work[0], work[1], work[2]
    along = normal[least]
    for axis in range(3):
        first[axis] = (1.0 if axis == least else 0.0) - along * normal[axis]
    make_unit(first, 1e-30)
    cross(normal, first, second)
    u, v, fits = 0.0, 0.0, False
    for n in range(len(rings.spans_mm)):
        u, v, misfit = _slope(layout, tables, m, there, first, second, rings.spans_mm[n], spare, rise)
        fits = misfit < rings.misfits[n]
        if fits:
            break
    rest = np.sqrt(max(1.0 - u * u - v * v, 0.1))
    for axis in range(3):
        out[axis] = rest * normal[axis] + u * first[axis] + v * second[axis]
    make_unit(out, 1e-30)
    return fits


@loop_kernel
def _fit_points(layout, tables, m, points, normals, rings, reach, drawn, fitted, found):
    chunks = (len(points) + CHUNK - 1) // CHUNK
    fields, walls, wide_to_narrow = lend(layout), lend(tables), lend(rings)
    for number in numba.prange(chunks):
        chunk = every_other(number, chunks)
        spare = scratch(fields)
        work = np.empty((3, max(RING_WAYS, 3)))
        for n in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(points))):
            found[n] = fit_normal(
                fields, walls, m, points[n], normals[n], wide_to_narrow, reach, spare, work, drawn[n], fitted[n]
            )
