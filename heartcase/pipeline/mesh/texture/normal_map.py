"""The normals of the fields themselves, baked into a tangent-space normal map (thesis 11.2.2).

Each coarse triangle is covered by points, half a ring apart, where
:mod:`heartcase.pipeline.mesh.extraction.field_normals` fits the normals; its texels lie between them, and no
full-resolution mesh takes part. The exact baker looks, for every texel, for the nearest point of the full-resolution
mesh that faces the same way, and takes the normal fitted there.
"""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.fields.point_kernels import scratch
from heartcase.pipeline.fields.reader import FieldReader
from heartcase.pipeline.kernels.parallel import every_other, side_by_side
from heartcase.pipeline.kernels.vectors import cross, dot, make_unit, put
from heartcase.pipeline.mesh.extraction.field_normals import fit_normal, fitted_normals, rings_of, to_index_matrix
from heartcase.pipeline.mesh.texture.atlas import Atlas
from heartcase.pipeline.mesh.texture.dilation import dilate
from heartcase.pipeline.mesh.triangles.half_edges import opposites
from heartcase.pipeline.mesh.triangles.mesh_distance import nearest_on_mesh
from heartcase.pipeline.mesh.triangles.triangle_grid import TriangleGrid
from heartcase.schemas.arrays import Bool, Float32, Float64, Int32, Int64, UInt8

__all__ = ["bake_normal_map"]


CHUNK = 64
FLAT = (128, 128, 255)
DILATION_TEXELS = 8
POINT_RINGS = 0.45
"""Distance of the points where normals are fitted, over the widest ring's radius: between them they hardly bend."""
MOST_PARTS = 64
LEAST_FACING = 0.5
"""Cosine of a texel's normal with that of a triangle of the full mesh below which it is another side of the tissue."""


def bake_normal_map(
    reader: FieldReader,
    atlas: Atlas,
    vertices_mm: Float32,
    normals: Float32,
    tangents: Float32,
    flat_triangles: Bool,
    *,
    size: int,
    reach_mm: float,
    full: tuple[Float64, Int32, TriangleGrid] | None = None,
) -> UInt8:
    """Bake the tangent-space normal map.

    Points on the coarse triangle are drawn to the root of the field along the interpolated normal, by two Newton steps
    for a slope of one, and the normal is fitted there; at the triangle's corners it is the vertices' own.

    Parameters
    ----------
    reader
        The structures.
    atlas
        Render vertices.
    vertices_mm, normals
        Welded vertices and their unit normals, fitted where they can be, shape (vertex_count, 3).
    tangents
        Of the render vertices, shape (render_vertex_count, 4).
    flat_triangles
        Triangles whose own normal is the true one (cut faces), shape (triangle_count,).
    size
        Edge of the map in texels.
    reach_mm
        How far from the mesh the true surface may lie.
    full
        Vertices (mm) and triangles of the full-resolution mesh, and where they lie, for the exact baker.

    Returns
    -------
    UInt8
        Shape (size, size, 3): x, y, z along tangent, bitangent and normal, as glTF 2.0 maps them; charts are continued
        eight texels outward, the rest is flat.
    """
    corners = np.ascontiguousarray(atlas.render_to_welded[atlas.triangles])
    vertices, unit = vertices_mm.astype(np.float64), normals.astype(np.float64)
    texel = atlas.uv.astype(np.float64) * size
    given = np.zeros((0, 0, 3), np.float32)
    if full is None:
        (parts, start, known), owner = side_by_side(
            lambda: _fitted_between(reader, corners, vertices, unit, flat_triangles, reach_mm),
            lambda: _rasterised(atlas, size),
        )
    else:
        owner = _rasterised(atlas, size)
        parts, start, known = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3), np.float32)
        given = np.zeros((size, size, 3), np.float32)
        _look_up(reader, owner, texel, atlas.triangles, corners, vertices, unit, full, reach_mm, given)
    picture = np.empty((size, size, 3), np.uint8)
    picture[:] = FLAT
    _bake_rows(
        owner,
        texel,
        atlas.triangles,
        corners,
        vertices,
        unit,
        tangents.astype(np.float64),
        flat_triangles,
        parts,
        start,
        known,
        given,
        picture,
    )
    dilate(picture, owner >= 0, DILATION_TEXELS)
    return picture


def _rasterised(atlas: Atlas, size: int) -> Int32:
    """Triangle that holds each texel's centre, -1 where there is none."""
    owner = np.full((size, size), -1, np.int32)
    _rasterise(atlas.uv.astype(np.float64), atlas.triangles, owner)
    return owner


def _fitted_between(
    reader: FieldReader,
    corners: Int32,
    vertices: Float64,
    normals: Float64,
    flat: Bool,
    reach_mm: float,
) -> tuple[Int64, Int64, Float32]:
    """Parts of each triangle's edge, where its points begin, and the normals at all points."""
    rings, to_index = rings_of(reader), to_index_matrix(reader)
    apart = POINT_RINGS * rings.spans_mm[0]
    edge = np.linalg.norm(vertices[np.roll(corners, -1, axis=1)] - vertices[corners], axis=2).max(axis=1)
    parts = np.clip(np.ceil(edge / apart), 1, MOST_PARTS).astype(np.int64)
    start = np.concatenate([[0], np.cumsum((parts + 1) * (parts + 2) // 2)])
    known = np.empty((int(start[-1]), 3), np.float32)
    opposite = opposites(corners)
    _fit_lattices(
        reader.layout,
        reader.tables,
        to_index,
        corners,
        vertices,
        normals,
        flat,
        opposite,
        parts,
        start,
        rings,
        reach_mm,
        known,
    )
    _take_given(flat, opposite, parts, start, known)
    return parts, start, known


def _look_up(
    reader: FieldReader,
    owner: Int32,
    texel: Float64,
    triangles: Int32,
    corners: Int32,
    vertices: Float64,
    normals: Float64,
    full: tuple[Float64, Int32, TriangleGrid],
    reach_mm: float,
    given: Float32,
) -> None:
    """Normals of the full mesh at its points nearest to the texels; zero where none is near."""
    points, faces, grid = full
    doubled = np.cross(grid.corner[:, 1] - grid.corner[:, 0], grid.corner[:, 2] - grid.corner[:, 0])
    rough: Float64 = np.empty(points.shape)
    for axis in range(3):
        rough[:, axis] = np.bincount(faces.ravel(), np.repeat(doubled[:, axis], 3), len(points))
    rough /= np.maximum(np.linalg.norm(rough, axis=1), 1e-30)[:, None]
    facing = doubled / np.maximum(np.linalg.norm(doubled, axis=1), 1e-30)[:, None]
    _, fitted, _ = fitted_normals(reader, points, rough, reach_mm=reach_mm)
    is_creased = (fitted * rough).sum(axis=1) < LEAST_FACING
    fitted[is_creased] = rough[is_creased]
    _look_up_rows(owner, texel, triangles, corners, vertices, normals, grid, facing, faces, fitted, reach_mm, given)


@loop_kernel
def _look_up_rows(owner, texel, triangles, corners, vertices, normals, grid, facing, faces, fitted, reach, given):
    boxes = lend(grid)
    for row in numba.prange(owner.shape[0]):
        weights, here, normal, out = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
        for column in range(owner.shape[1]):
            t = owner[row, column]
            if t < 0:
                continue
            _corner_weights(texel, triangles[t], column + 0.5, row + 0.5, weights)
            _mix(weights, vertices, corners[t], here)
            _mix(weights, normals, corners[t], normal)
            make_unit(normal, 1e-30)
            found, square, v, w = nearest_on_mesh(
                boxes, here[0], here[1], here[2], facing, normal, LEAST_FACING, 4.0 * reach
            )
            if found >= 0 and square <= 16.0 * reach * reach:
                weights[0], weights[1], weights[2] = 1.0 - v - w, v, w
                _mix(weights, fitted, faces[found], out)
                make_unit(out, 1e-3)
                put(out, given[row, column])


@copied
def _mix(weights, values, which, out):
    """Weighted sum of the three vectors ``values[which]``."""
    a, b, c = which[0], which[1], which[2]
    for axis in range(3):
        out[axis] = weights[0] * values[a, axis] + weights[1] * values[b, axis] + weights[2] * values[c, axis]


@copied
def _corner_weights(texel, which, x, y, weights):
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


@kernel(inline="always")
def _number(i, j, parts):
    """Place of a triangle's point, ``i`` steps towards its second corner and ``j`` towards its third."""
    return j * (parts + 1) - (j * (j - 1)) // 2 + i


@kernel(inline="always")
def _place_on_edge(edge, step, parts):
    """Place of a triangle's point that is so many steps along an edge; edge 0 goes from corner 0 to corner 1."""
    if edge == 0:
        return _number(step, 0, parts)
    return _number(parts - step, step, parts) if edge == 1 else _number(0, parts - step, parts)


@kernel(inline="always")
def _giver(t, edge, parts, flat, opposite):
    """Half-edge whose triangle fits the points that both have on an edge; -1 where triangle ``t`` does so itself."""
    other = opposite[3 * t + edge]
    return other if other // 3 < t and parts[other // 3] == parts[t] and not flat[other // 3] else -1


@called
def _fit_some_lattices(
    fields, walls, m, corners, vertices, normals, flat, opposite, parts, start, rings, reach, known, chunk
):
    """Fit those of a chunk of the triangles that no other one gives."""
    spare = scratch(fields)
    weights, here, there, normal, out = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    work = np.empty((3, 8))
    for t in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(corners))):
        if flat[t]:
            continue
        count = parts[t]
        for j in range(count + 1):
            for i in range(count + 1 - j):
                is_corner = i == count or j == count or i + j == 0
                if not is_corner and (
                    (j == 0 and _giver(t, 0, parts, flat, opposite) >= 0)
                    or (i + j == count and _giver(t, 1, parts, flat, opposite) >= 0)
                    or (i == 0 and _giver(t, 2, parts, flat, opposite) >= 0)
                ):
                    continue
                weights[1], weights[2] = i / count, j / count
                weights[0] = (count - i - j) / count
                _mix(weights, normals, corners[t], normal)
                make_unit(normal, 1e-30)
                put(normal, out)
                if not is_corner:
                    _mix(weights, vertices, corners[t], here)
                    fit_normal(fields, walls, m, here, normal, rings, reach, spare, work, there, out)
                put(out, known[start[t] + _number(i, j, count)])


@loop_kernel
def _fit_lattices(layout, tables, m, corners, vertices, normals, flat, opposite, parts, start, rings, reach, known):
    """Fit normals at the points of every triangle that is not flat, without those that another one gives."""
    chunks = (len(corners) + CHUNK - 1) // CHUNK
    fields, walls, wide_to_narrow = lend(layout), lend(tables), lend(rings)
    for number in numba.prange(chunks):
        _fit_some_lattices(
            fields,
            walls,
            m,
            corners,
            vertices,
            normals,
            flat,
            opposite,
            parts,
            start,
            wide_to_narrow,
            reach,
            known,
            every_other(number, chunks),
        )


@loop_kernel
def _take_given(flat, opposite, parts, start, known):
    """Put the normals on edges where other triangles fitted them."""
    for t in numba.prange(len(flat)):
        for edge in range(3):
            giver = _giver(t, edge, parts, flat, opposite)
            if flat[t] or giver < 0:
                continue
            for step in range(1, parts[t]):
                theirs = start[giver // 3] + _place_on_edge(giver % 3, parts[t] - step, parts[t])
                put(known[theirs], known[start[t] + _place_on_edge(edge, step, parts[t])])


@kernel(inline="always")
def _between(known, start, parts, weights, out):
    """Unit normal between the three points of a triangle around a place given by its corners' weights."""
    x, y = weights[1] * parts, weights[2] * parts
    i, j = min(int(x), parts - 1), min(int(y), parts - 1)
    if i + j > parts - 1:
        i = parts - 1 - j
    u, v = x - i, y - j
    b, c = start + _number(i + 1, j, parts), start + _number(i, j + 1, parts)
    if u + v <= 1.0 or i + j == parts - 1:
        a = start + _number(i, j, parts)
        p, q, r = 1.0 - u - v, u, v
    else:
        a = start + _number(i + 1, j + 1, parts)
        p, q, r = u + v - 1.0, 1.0 - v, 1.0 - u
    for axis in range(3):
        out[axis] = p * known[a, axis] + q * known[b, axis] + r * known[c, axis]
    return make_unit(out, 1e-3)


@loop_kernel
def _bake_rows(
    owner, texel, triangles, corners, vertices, normals, tangents, flat, parts, start, known, given, picture
):
    for row in numba.prange(owner.shape[0]):
        weights, true, side, other = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
        normal, tangent, bitangent, face = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
        for column in range(owner.shape[1]):
            t = owner[row, column]
            if t < 0:
                continue
            _corner_weights(texel, triangles[t], column + 0.5, row + 0.5, weights)
            _mix(weights, normals, corners[t], normal)
            _mix(weights, tangents, triangles[t], tangent)
            make_unit(normal, 1e-30)
            make_unit(tangent, 1e-30)
            cross(normal, tangent, bitangent)
            make_unit(bitangent, 1e-30)
            hand = tangents[triangles[t, 0], 3]
            for axis in range(3):
                bitangent[axis] *= hand
                side[axis] = vertices[corners[t, 1], axis] - vertices[corners[t, 0], axis]
                other[axis] = vertices[corners[t, 2], axis] - vertices[corners[t, 0], axis]
            cross(side, other, face)
            make_unit(face, 1e-30)
            if flat[t]:
                put(face, true)
            else:
                if len(given):
                    put(given[row, column], true)
                    is_known = make_unit(true, 0.5)
                else:
                    is_known = _between(known, start[t], parts[t], weights, true)
                # a field that is creased here tells nothing
                if not is_known or dot(true, face) < 0.2:
                    put(normal, true)
            cross(bitangent, normal, side)
            volume = dot(tangent, side)
            if abs(volume) < 1e-6:
                continue
            # along tangent, bitangent and normal, which need not be at right angles between the vertices
            x = dot(true, side) / volume
            cross(normal, tangent, side)
            y = dot(true, side) / volume
            cross(tangent, bitangent, side)
            z = max(dot(true, side) / volume, 0.02)
            length = np.sqrt(x * x + y * y + z * z)
            picture[row, column, 0] = np.uint8(np.rint((x / length + 1.0) * 127.5))
            picture[row, column, 1] = np.uint8(np.rint((y / length + 1.0) * 127.5))
            picture[row, column, 2] = np.uint8(np.rint((z / length + 1.0) * 127.5))


@kernel
def _rasterise(uv, triangles, owner):
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
