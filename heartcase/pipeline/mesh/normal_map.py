"""The normals of the fields themselves, baked into a tangent-space normal map (thesis 11.2.2), and at the vertices.

A texel's point on the coarse triangle is drawn to the root of the tissue field by two damped Newton steps; the field's
gradient there, by central differences, is the normal. No full-resolution mesh takes part.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields import ownership_at_points
from heartcase.pipeline.mesh.atlas import Atlas

__all__ = ["bake_normal_map", "draw_to_surface", "field_gradient", "gradient_step_mm"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]

CHUNK = 1 << 19
FLAT = (128, 128, 255)
DILATION_TEXELS = 8


def gradient_step_mm(structures: Structures) -> float:
    """Half-width in mm of the central differences: half a voxel, but within a third of the thinnest wall."""
    half = 0.5 * float(np.min(structures.geometry.spacing_mm))
    wall = structures.thinnest_layer_mm
    return half if wall is None else min(half, 0.35 * wall)


def field_gradient(structures: Structures, points_mm: Float64, step_mm: float) -> Float64:
    """Gradient of the tissue field in world space by central differences, shape (n, 3)."""
    gradient = np.empty((len(points_mm), 3))
    for axis in range(3):
        offset = np.zeros(3)
        offset[axis] = step_mm
        above = ownership_at_points(structures, points_mm + offset).tissue_mm
        below = ownership_at_points(structures, points_mm - offset).tissue_mm
        gradient[:, axis] = (above.astype(np.float64) - below) / (2.0 * step_mm)
    return gradient


def draw_to_surface(
    structures: Structures, points_mm: Float64, *, step_mm: float, reach_mm: float
) -> tuple[Float64, Float64]:
    """Draw points to the nearest root of the tissue field, and give the outward normals there.

    Two Newton steps along the first point's gradient, together at most ``reach_mm`` long.

    Parameters
    ----------
    structures
        The fields.
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
    points = np.empty_like(points_mm)
    normals = np.empty_like(points_mm)
    for start in range(0, len(points_mm), CHUNK):
        part = slice(start, start + CHUNK)
        here = points_mm[part]
        gradient = field_gradient(structures, here, step_mm)
        square = np.maximum((gradient * gradient).sum(axis=1), 0.25)
        value = ownership_at_points(structures, here).tissue_mm.astype(np.float64)
        limit = reach_mm / np.sqrt(square)
        way = np.clip(-value / square, -limit, limit)
        value = ownership_at_points(structures, here + way[:, None] * gradient).tissue_mm.astype(np.float64)
        way = np.clip(way - value / square, -limit, limit)
        points[part] = here + way[:, None] * gradient
        normals[part] = field_gradient(structures, points[part], step_mm)
    length = np.linalg.norm(normals, axis=1)
    normals /= np.where(length < 1e-3, np.inf, length)[:, None]
    return points, normals


def bake_normal_map(
    structures: Structures,
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

    Parameters
    ----------
    structures
        The fields.
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
    rows, columns = np.nonzero(owner >= 0)
    triangle = owner[rows, columns]
    encoded = np.empty((len(rows), 3), np.uint8)
    corners = atlas.render_to_welded[atlas.triangles]
    for start in range(0, len(rows), CHUNK):
        part = slice(start, start + CHUNK)
        t = triangle[part]
        weights = _barycentric(atlas.uv.astype(np.float64) * size, atlas.triangles[t], columns[part], rows[part])
        at = np.einsum("nk,nkd->nd", weights, vertices_mm[corners[t]].astype(np.float64))
        normal = _unit(np.einsum("nk,nkd->nd", weights, normals[corners[t]].astype(np.float64)))
        tangent = _unit(np.einsum("nk,nkd->nd", weights, tangents[atlas.triangles[t], :3].astype(np.float64)))
        hand = tangents[atlas.triangles[t, 0], 3].astype(np.float64)
        bitangent = _unit(np.cross(normal, tangent) * hand[:, None])
        true = draw_to_surface(structures, at, step_mm=gradient_step_mm(structures), reach_mm=reach_mm)[1]
        corner = vertices_mm[corners[t]].astype(np.float64)
        face = _unit(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
        use_face = flat_triangles[t] | ((true * face).sum(axis=1) < 0.2)
        true[use_face] = np.where(flat_triangles[t], 1.0, 0.0)[use_face, None] * face[use_face]
        lost = ~true.any(axis=1)
        true[lost] = normal[lost]
        local = np.linalg.solve(np.stack([tangent, bitangent, normal], axis=2), true[:, :, None])[:, :, 0]
        local[:, 2] = np.maximum(local[:, 2], 0.02)
        encoded[part] = np.round((_unit(local) + 1.0) * 127.5).astype(np.uint8)
    picture = np.empty((size, size, 3), np.uint8)
    picture[:] = FLAT
    picture[rows, columns] = encoded
    _dilate(picture, owner >= 0, DILATION_TEXELS)
    return picture


def _unit(vectors: npt.NDArray[np.floating]) -> Float64:
    unit: Float64 = vectors / np.maximum(np.linalg.norm(vectors, axis=-1), 1e-30)[..., None]
    return unit


def _barycentric(texel: Float64, triangles: Int32, column: npt.NDArray[np.intp], row: npt.NDArray[np.intp]) -> Float64:
    """Weights of the corners at texel centres, clipped to the triangle, shape (n, 3)."""
    a, b, c = texel[triangles[:, 0]], texel[triangles[:, 1]], texel[triangles[:, 2]]
    p = np.column_stack([column + 0.5, row + 0.5])
    u, v, w = b - a, c - a, p - a
    turn = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    turn = np.where(turn == 0.0, 1.0, turn)
    second = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / turn
    third = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / turn
    weights = np.clip(np.column_stack([1.0 - second - third, second, third]), 0.0, 1.0)
    total: Float64 = weights / weights.sum(axis=1)[:, None]
    return total


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
    edge = np.empty((rows * columns, 2), np.int32)
    for _ in range(rounds):
        count = 0
        for j in range(rows):
            for i in range(columns):
                if filled[j, i]:
                    continue
                neighbours = 0
                total = np.zeros(3, np.int64)
                for dj in range(max(j - 1, 0), min(j + 2, rows)):
                    for di in range(max(i - 1, 0), min(i + 2, columns)):
                        if filled[dj, di]:
                            neighbours += 1
                            for k in range(3):
                                total[k] += picture[dj, di, k]
                if neighbours > 0:
                    for k in range(3):
                        picture[j, i, k] = (2 * total[k] + neighbours) // (2 * neighbours)
                    edge[count, 0] = j
                    edge[count, 1] = i
                    count += 1
        for n in range(count):
            filled[edge[n, 0], edge[n, 1]] = True
