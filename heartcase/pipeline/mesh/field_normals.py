"""Normals of the tissue field, free of the steps that labels of voxels leave in it.

A point beside the surface is drawn to the root of the field. There the field's slope along the surface is fitted on a
ring around the point, and tilts the normal that is known roughly. The wider the ring, the less do the voxels' steps
show, but the more of what is really there is flattened, too. So a ring of two voxels is the measure: a wider one is
taken where its rises are those of one plane, and its slope that of the measure but for what the steps explain; a
narrower one where the measure itself is bent. The gradient at the point itself is, against the truth, no better than
the normals of a coarse mesh (``heartcase bench geometry-chain``).
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.fields import FieldReader, evaluate_tissue, scratch

__all__ = ["cross", "dot", "fit_normal", "fitted_normals", "make_unit", "ring_spans_mm", "to_index_matrix"]

Bool = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]

CHUNK = 256
RING_SPANS_VOXELS = (2.0, 3.5, 3.0, 2.5, 1.5)
"""Radii of the rings: the measure, the wider ones, the narrower one."""
RING_WAYS = 4
"""Directions along the surface in which the field's rise is taken, each both ways."""
RING_MISFIT = 0.09
"""Largest misfit of a rise, over the radius in voxels, at which a ring's rises are those of one plane."""
RING_CHANGE = 0.0
"""Largest difference of a wider ring's slope to the measure's; 0 takes no wider ring, as they flatten real detail."""


def to_index_matrix(reader: FieldReader) -> Float64:
    """World mm to voxel index, shape (3, 4)."""
    return np.ascontiguousarray(np.linalg.inv(reader.structures.geometry.affine)[:3])


def ring_spans_mm(reader: FieldReader) -> Float64:
    """Radii of the rings for these structures, mm."""
    return np.array(RING_SPANS_VOXELS) * float(np.mean(reader.structures.geometry.spacing_mm))


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
    spans = ring_spans_mm(reader)
    _fit_points(
        reader.layout, reader.tables, to_index_matrix(reader), points_mm, normals, spans, reach_mm, drawn, fitted, found
    )
    return drawn, fitted, found


@numba.njit(cache=True, nogil=True, inline="always")
def dot(a, b):  # type: ignore[no-untyped-def]
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, nogil=True, inline="always")
def cross(a, b, out):  # type: ignore[no-untyped-def]
    """Vector product."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True, nogil=True)
def make_unit(v, least):  # type: ignore[no-untyped-def]
    """Divide a vector by its length, or make it zero where that is too small; returns whether it is not."""
    length = np.sqrt(dot(v, v))
    factor = 1.0 / length if length > least else 0.0
    for axis in range(3):
        v[axis] *= factor
    return factor > 0.0


@numba.njit(cache=True, nogil=True, inline="always")
def _value(layout, tables, m, x, y, z, spare):  # type: ignore[no-untyped-def]
    """Tissue field at a world point; ``m`` maps world to index."""
    i = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
    j = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
    k = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    return np.float64(evaluate_tissue(layout, tables, i, j, k, spare))


@numba.njit(cache=True, nogil=True, inline="always")
def _slope(layout, tables, m, at, first, second, span, spare, rise):  # type: ignore[no-untyped-def]
    """Slope along two unit vectors on a ring, and the largest misfit of a rise to it."""
    along_first = 0.0
    along_second = 0.0
    for way in range(RING_WAYS):
        cosine, sine = np.cos(np.pi * way / RING_WAYS), np.sin(np.pi * way / RING_WAYS)
        x = span * (cosine * first[0] + sine * second[0])
        y = span * (cosine * first[1] + sine * second[1])
        z = span * (cosine * first[2] + sine * second[2])
        above = _value(layout, tables, m, at[0] + x, at[1] + y, at[2] + z, spare)
        below = _value(layout, tables, m, at[0] - x, at[1] - y, at[2] - z, spare)
        rise[way] = (above - below) / (2.0 * span)
        along_first += 2.0 / RING_WAYS * cosine * rise[way]
        along_second += 2.0 / RING_WAYS * sine * rise[way]
    misfit = 0.0
    for way in range(RING_WAYS):
        cosine, sine = np.cos(np.pi * way / RING_WAYS), np.sin(np.pi * way / RING_WAYS)
        misfit = max(misfit, abs(rise[way] - cosine * along_first - sine * along_second))
    return along_first, along_second, misfit


@numba.njit(cache=True, nogil=True)
def fit_normal(layout, tables, m, here, normal, spans, reach, spare, work, there, out):  # type: ignore[no-untyped-def]
    """Draw a point to the field's root along a rough normal, and fit the normal there; returns whether a ring fits.

    ``there`` receives the drawn point, ``out`` the normal; where no ring fits, that of the narrowest. ``spans`` are the
    radii in mm. ``work`` has shape (3, RING_WAYS).
    """
    away = 0.0
    there[:] = here
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
    u, v, misfit = _slope(layout, tables, m, there, first, second, spans[0], spare, rise)
    fits = misfit < RING_MISFIT / RING_SPANS_VOXELS[0]
    measure_u, measure_v = u, v
    for n in range(1, len(spans)):
        is_wider = spans[n] > spans[0]
        if fits and not is_wider:
            break
        new_u, new_v, misfit = _slope(layout, tables, m, there, first, second, spans[n], spare, rise)
        is_plane = misfit < RING_MISFIT / RING_SPANS_VOXELS[n]
        change = (new_u - measure_u) ** 2 + (new_v - measure_v) ** 2
        if not is_wider or (is_plane and change < RING_CHANGE * RING_CHANGE):
            u, v = new_u, new_v
            fits = is_plane
            break
    rest = np.sqrt(max(1.0 - u * u - v * v, 0.1))
    for axis in range(3):
        out[axis] = rest * normal[axis] + u * first[axis] + v * second[axis]
    make_unit(out, 1e-30)
    return fits


@numba.njit(cache=True, nogil=True, parallel=True)
def _fit_points(layout, tables, m, points, normals, spans, reach, drawn, fitted, found):  # type: ignore[no-untyped-def]
    for chunk in numba.prange((len(points) + CHUNK - 1) // CHUNK):
        spare = scratch(layout)
        work = np.empty((3, max(RING_WAYS, 3)))
        for n in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(points))):
            found[n] = fit_normal(
                layout, tables, m, points[n], normals[n], spans, reach, spare, work, drawn[n], fitted[n]
            )
