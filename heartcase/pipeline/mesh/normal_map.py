"""The normals of the fields themselves, baked into a tangent-space normal map (thesis 11.2.2), and at the vertices.

A texel's point on the coarse triangle is drawn to the root of the tissue field; how the field rises along the surface
there, over two voxels to all sides, tilts the interpolated normal. The gradient at the point itself would show the
steps of the voxels: against the truth it is worse than no map. No full-resolution mesh takes part.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields import FieldReader, evaluate_tissue, scratch
from heartcase.pipeline.mesh.atlas import Atlas

__all__ = ["bake_normal_map", "draw_to_surface", "gradient_step_mm"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]

CHUNK = 1024
FLAT = (128, 128, 255)
DILATION_TEXELS = 8
RING_WAYS = 4
"""Directions along the surface in which a texel's normal is looked for, each both ways."""
SPAN_VOXELS = 2.0
"""Labels of voxels leave steps in the fields that are about so long: ``heartcase bench geometry-chain`` shows it."""


def gradient_step_mm(structures: Structures) -> float:
    """Half-width in mm of the central differences: half a voxel, but within a third of the thinnest wall."""
    half = 0.5 * float(np.min(structures.geometry.spacing_mm))
    wall = structures.thinnest_layer_mm
    return half if wall is None else min(half, 0.35 * wall)


def span_mm(structures: Structures) -> float:
    """How far along the surface the normal map's normals look to all sides, mm: two voxels."""
    return SPAN_VOXELS * float(np.mean(structures.geometry.spacing_mm))


def draw_to_surface(
    reader: FieldReader, points_mm: Float64, *, step_mm: float, reach_mm: float
) -> tuple[Float64, Float64]:
    """Draw points to the nearest root of the tissue field, and give the outward normals there.

    Two Newton steps along the first point's gradient, together at most ``reach_mm`` long.

    Parameters
    ----------
    reader
        The structures.
    points_mm
        World points, shape (n, 3).
    step_mm
        Half-width of the differences.
    reach_mm
        Longest way.

    Returns
    -------
    points : Float64
        The drawn points, shape (n, 3).
    normals : Float64
        Unit gradients there, shape (n, 3); zero where the field has none.
    """
    points, normals = np.empty_like(points_mm), np.empty_like(points_mm)
    to_index = np.ascontiguousarray(np.linalg.inv(reader.structures.geometry.affine)[:3])
    _draw_points(reader.layout, reader.tables, to_index, points_mm, step_mm, reach_mm, points, normals)
    return points, normals


def bake_normal_map(
    reader: FieldReader,
    atlas: Atlas,
    vertices_mm: Float32,
    normals: Float32,
    tangents: Float32,
    flat_triangles: npt.NDArray[np.bool_],
    *,
    size: int,
    reach_mm: float,
) -> UInt8:
    """Bake the tangent-space normal map.

    A texel's point on the coarse triangle is drawn to the root of the field along the interpolated normal, by two
    Newton steps for a slope of one.

    Parameters
    ----------
    reader
        The structures.
    atlas
        Render vertices.
    vertices_mm, normals
        Welded vertices and their unit normals, shape (vertex_count, 3).
    tangents
        Of the render vertices, shape (render_vertex_count, 4).
    flat_triangles
        Triangles whose own normal is the true one (cut faces), shape (triangle_count,).
    size
        Edge of the map in texels.
    reach_mm
        How far from the mesh the true surface may lie.

    Returns
    -------
    UInt8
        Shape (size, size, 3): x, y, z along tangent, bitangent and normal, as glTF 2.0 maps them; charts are continued
        eight texels outward, the rest is flat.
    """
    owner = np.full((size, size), -1, np.int32)
    _rasterise(atlas.uv.astype(np.float64), atlas.triangles, owner)
    corners = np.ascontiguousarray(atlas.render_to_welded[atlas.triangles])
    picture = np.empty((size, size, 3), np.uint8)
    picture[:] = FLAT
    _bake_rows(
        reader.layout,
        reader.tables,
        np.ascontiguousarray(np.linalg.inv(reader.structures.geometry.affine)[:3]),
        owner,
        atlas.uv.astype(np.float64) * size,
        atlas.triangles,
        corners,
        vertices_mm.astype(np.float64),
        normals.astype(np.float64),
        tangents.astype(np.float64),
        flat_triangles,
        span_mm(reader.structures),
        reach_mm,
        picture,
    )
    _dilate(picture, owner >= 0, DILATION_TEXELS)
    return picture


@numba.njit(cache=True, nogil=True, inline="always")
def _value(layout, tables, m, p, spare):  # type: ignore[no-untyped-def]
    """Tissue field at a world point; ``m`` maps world to index."""
    x = m[0, 0] * p[0] + m[0, 1] * p[1] + m[0, 2] * p[2] + m[0, 3]
    y = m[1, 0] * p[0] + m[1, 1] * p[1] + m[1, 2] * p[2] + m[1, 3]
    z = m[2, 0] * p[0] + m[2, 1] * p[1] + m[2, 2] * p[2] + m[2, 3]
    return np.float64(evaluate_tissue(layout, tables, x, y, z, spare))


@numba.njit(cache=True, nogil=True)
def _gradient(layout, tables, m, p, step, spare, out):  # type: ignore[no-untyped-def]
    """Gradient of the tissue field in world space by central differences."""
    for axis in range(3):
        middle = p[axis]
        p[axis] = middle + step
        above = _value(layout, tables, m, p, spare)
        p[axis] = middle - step
        below = _value(layout, tables, m, p, spare)
        p[axis] = middle
        out[axis] = (above - below) / (2.0 * step)


@numba.njit(cache=True, nogil=True, inline="always")
def _tilt(layout, tables, m, p, normal, tangent, span, spare, first, second, out):  # type: ignore[no-untyped-def]
    """Unit normal at a point of the surface: the slope of the field along it, fitted on a ring of radius ``span``.

    The ring reaches as far as voxels make steps, and across the thinnest wall not at all.
    """
    along = _dot(tangent, normal)
    for axis in range(3):
        first[axis] = tangent[axis] - along * normal[axis]
    _make_unit(first, 1e-30)
    _cross(normal, first, second)
    rise_first = 0.0
    rise_second = 0.0
    for n in range(RING_WAYS):
        angle = np.pi * n / RING_WAYS
        cosine, sine = np.cos(angle), np.sin(angle)
        for axis in range(3):
            out[axis] = cosine * first[axis] + sine * second[axis]
        rise = _rise(layout, tables, m, p, out, span, spare)
        rise_first += 2.0 / RING_WAYS * cosine * rise
        rise_second += 2.0 / RING_WAYS * sine * rise
    rest = np.sqrt(max(1.0 - rise_first * rise_first - rise_second * rise_second, 0.1))
    for axis in range(3):
        out[axis] = rest * normal[axis] + rise_first * first[axis] + rise_second * second[axis]


@numba.njit(cache=True, nogil=True, inline="always")
def _rise(layout, tables, m, p, way, span, spare):  # type: ignore[no-untyped-def]
    """Slope of the field along a direction by central differences."""
    x, y, z = p[0], p[1], p[2]
    for axis in range(3):
        p[axis] += span * way[axis]
    above = _value(layout, tables, m, p, spare)
    for axis in range(3):
        p[axis] -= 2.0 * span * way[axis]
    below = _value(layout, tables, m, p, spare)
    p[0], p[1], p[2] = x, y, z
    return (above - below) / (2.0 * span)


@numba.njit(cache=True, nogil=True, inline="always")
def _walk(layout, tables, m, here, way, square, reach, spare, there):  # type: ignore[no-untyped-def]
    """Two Newton steps from ``here`` along ``way``, the field's gradient or near it, of squared length ``square``."""
    limit = reach / np.sqrt(square)
    length = 0.0
    there[:] = here
    for _ in range(2):
        length -= _value(layout, tables, m, there, spare) / square
        length = min(max(length, -limit), limit)
        for axis in range(3):
            there[axis] = here[axis] + length * way[axis]


@numba.njit(cache=True, nogil=True)
def _make_unit(v, least):  # type: ignore[no-untyped-def]
    """Divide a vector by its length, or make it zero where that is too small."""
    length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    factor = 1.0 / length if length > least else 0.0
    for axis in range(3):
        v[axis] *= factor
    return factor > 0.0


@numba.njit(cache=True, nogil=True, parallel=True)
def _draw_points(layout, tables, m, points, step, reach, drawn, normals):  # type: ignore[no-untyped-def]
    for chunk in numba.prange((len(points) + CHUNK - 1) // CHUNK):
        spare = scratch(layout)
        here, there, way = np.empty(3), np.empty(3), np.empty(3)
        for n in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(points))):
            here[:] = points[n]
            _gradient(layout, tables, m, here, step, spare, way)
            square = max(way[0] * way[0] + way[1] * way[1] + way[2] * way[2], 0.25)
            _walk(layout, tables, m, here, way, square, reach, spare, there)
            drawn[n] = there
            _gradient(layout, tables, m, there, step, spare, way)
            _make_unit(way, 1e-3)
            normals[n] = way


@numba.njit(cache=True, nogil=True)
def _mix(weights, values, which, out):  # type: ignore[no-untyped-def]
    """Weighted sum of the three vectors ``values[which]``."""
    a, b, c = which[0], which[1], which[2]
    for axis in range(3):
        out[axis] = weights[0] * values[a, axis] + weights[1] * values[b, axis] + weights[2] * values[c, axis]


@numba.njit(cache=True, nogil=True)
def _cross(a, b, out):  # type: ignore[no-untyped-def]
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True, nogil=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, nogil=True)
def _corner_weights(texel, which, x, y, weights):  # type: ignore[no-untyped-def]
    """Weights of the corners at a point of the picture, clipped to the triangle."""
    ax, ay = texel[which[0], 0], texel[which[0], 1]
    ux, uy = texel[which[1], 0] - ax, texel[which[1], 1] - ay
    vx, vy = texel[which[2], 0] - ax, texel[which[2], 1] - ay
    wx, wy = x - ax, y - ay
    turn = ux * vy - uy * vx
    if turn == 0.0:
        turn = 1.0
    second = (wx * vy - wy * vx) / turn
    third = (ux * wy - uy * wx) / turn
    weights[0] = min(max(1.0 - second - third, 0.0), 1.0)
    weights[1] = min(max(second, 0.0), 1.0)
    weights[2] = min(max(third, 0.0), 1.0)
    total = weights[0] + weights[1] + weights[2]
    for k in range(3):
        weights[k] /= total


@numba.njit(cache=True, nogil=True, parallel=True)
def _bake_rows(  # type: ignore[no-untyped-def]
    layout, tables, m, owner, texel, triangles, corners, vertices, normals, tangents, flat, span, reach, picture
):
    for row in numba.prange(owner.shape[0]):
        spare = scratch(layout)
        weights, here, there, true = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
        normal, tangent, bitangent, face = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
        side, other = np.empty(3), np.empty(3)
        for column in range(owner.shape[1]):
            t = owner[row, column]
            if t < 0:
                continue
            _corner_weights(texel, triangles[t], column + 0.5, row + 0.5, weights)
            _mix(weights, vertices, corners[t], here)
            _mix(weights, normals, corners[t], normal)
            _mix(weights, tangents, triangles[t], tangent)
            _make_unit(normal, 1e-30)
            _make_unit(tangent, 1e-30)
            _cross(normal, tangent, bitangent)
            _make_unit(bitangent, 1e-30)
            hand = tangents[triangles[t, 0], 3]
            for axis in range(3):
                bitangent[axis] *= hand
                side[axis] = vertices[corners[t, 1], axis] - vertices[corners[t, 0], axis]
                other[axis] = vertices[corners[t, 2], axis] - vertices[corners[t, 0], axis]
            _cross(side, other, face)
            _make_unit(face, 1e-30)
            if flat[t]:
                true[:] = face
            else:
                _walk(layout, tables, m, here, normal, 1.0, reach, spare, there)
                _tilt(layout, tables, m, there, normal, tangent, span, spare, side, other, true)
                # a field that is creased here tells nothing
                if not _make_unit(true, 1e-3) or _dot(true, face) < 0.2:
                    true[:] = normal
            _cross(bitangent, normal, side)
            volume = _dot(tangent, side)
            if abs(volume) < 1e-6:
                continue
            # along tangent, bitangent and normal, which need not be at right angles between the vertices
            x = _dot(true, side) / volume
            _cross(normal, tangent, side)
            y = _dot(true, side) / volume
            _cross(tangent, bitangent, side)
            z = max(_dot(true, side) / volume, 0.02)
            length = np.sqrt(x * x + y * y + z * z)
            picture[row, column, 0] = np.uint8(np.rint((x / length + 1.0) * 127.5))
            picture[row, column, 1] = np.uint8(np.rint((y / length + 1.0) * 127.5))
            picture[row, column, 2] = np.uint8(np.rint((z / length + 1.0) * 127.5))


@numba.njit(cache=True, nogil=True)
def _rasterise(uv, triangles, owner):  # type: ignore[no-untyped-def]
    """Lowest triangle that holds each texel's centre."""
    size = owner.shape[0]
    for t in range(len(triangles)):
        ax, ay = uv[triangles[t, 0]] * size - 0.5
        bx, by = uv[triangles[t, 1]] * size - 0.5
        cx, cy = uv[triangles[t, 2]] * size - 0.5
        turn = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if turn == 0.0:
            continue
        sign = 1.0 if turn > 0.0 else -1.0
        i0 = max(int(np.ceil(min(ax, bx, cx))), 0)
        i1 = min(int(np.floor(max(ax, bx, cx))), size - 1)
        j0 = max(int(np.ceil(min(ay, by, cy))), 0)
        j1 = min(int(np.floor(max(ay, by, cy))), size - 1)
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                if (
                    owner[j, i] < 0
                    and sign * ((bx - ax) * (j - ay) - (by - ay) * (i - ax)) >= 0.0
                    and sign * ((cx - bx) * (j - by) - (cy - by) * (i - bx)) >= 0.0
                    and sign * ((ax - cx) * (j - cy) - (ay - cy) * (i - cx)) >= 0.0
                ):
                    owner[j, i] = t


@numba.njit(cache=True, nogil=True)
def _dilate(picture, filled, rounds):  # type: ignore[no-untyped-def]
    """Continue the filled texels outward, each round by the mean of the filled neighbours."""
    rows, columns = filled.shape
    seen = filled.copy()
    edge = np.empty((rows * columns, 2), np.int32)
    first, last = 0, 0
    for j in range(rows):
        for i in range(columns):
            if filled[j, i]:
                last = _unfilled_around(filled, seen, j, i, edge, last)
    for _ in range(rounds):
        for n in range(first, last):
            j, i = edge[n]
            neighbours = 0
            total = np.zeros(3, np.int64)
            for dj in range(max(j - 1, 0), min(j + 2, rows)):
                for di in range(max(i - 1, 0), min(i + 2, columns)):
                    if filled[dj, di]:
                        neighbours += 1
                        for k in range(3):
                            total[k] += picture[dj, di, k]
            for k in range(3):
                picture[j, i, k] = (2 * total[k] + neighbours) // (2 * neighbours)
        for n in range(first, last):
            filled[edge[n, 0], edge[n, 1]] = True
        begin, first = first, last
        for n in range(begin, first):
            last = _unfilled_around(filled, seen, edge[n, 0], edge[n, 1], edge, last)


@numba.njit(cache=True, nogil=True)
def _unfilled_around(filled, seen, j, i, edge, count):  # type: ignore[no-untyped-def]
    """List the unfilled neighbours of a texel that are not listed yet."""
    rows, columns = filled.shape
    for dj in range(max(j - 1, 0), min(j + 2, rows)):
        for di in range(max(i - 1, 0), min(i + 2, columns)):
            if not seen[dj, di]:
                seen[dj, di] = True
                edge[count, 0] = dj
                edge[count, 1] = di
                count += 1
    return count
