"""A UV atlas: the surface cut into charts that lie flat in one square picture without overlapping.

The charts are cut in :mod:`heartcase.pipeline.mesh.texture.charts` and put side by side in
:mod:`heartcase.pipeline.mesh.texture.packing`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from heartcase.pipeline.mesh.texture.charts import cut_into_charts, project
from heartcase.pipeline.mesh.texture.packing import GUTTER_TEXELS, pack, turned
from heartcase.schemas.arrays import Float, Float32, Float64, Int32

__all__ = ["Atlas", "make_atlas", "tangents"]


@dataclass(frozen=True)
class Atlas:
    """Render vertices and their texture coordinates."""

    render_to_welded: Int32
    """Welded vertex of each render vertex, ascending, shape (render_vertex_count,)."""
    triangles: Int32
    """Render vertices of each triangle, shape (triangle_count, 3)."""
    uv: Float32
    """Texture coordinates, v down, shape (render_vertex_count, 2)."""
    chart_count: int
    """Number of charts."""
    texels_per_mm: float
    """Scale of the charts in the picture."""
    used: float
    """Fraction of the picture that triangles cover."""


def make_atlas(
    vertices_mm: Float64, triangles: Int32, *, size: int, method: Literal["cone", "xatlas"] = "cone"
) -> Atlas:
    """Cut a closed mesh into charts and pack them into a square picture.

    Parameters
    ----------
    vertices_mm, triangles
        A closed manifold mesh.
    size
        Edge of the picture in texels; charts keep two texels from each other's gutters and from its border.
    method
        ``cone``: charts grown greedily in a cone of 45 degrees and projected. ``xatlas``: the library, slower.

    Returns
    -------
    Atlas
        Charts do not overlap.

    Raises
    ------
    StageError
        The picture is too small for the number of charts.
    """
    if method == "xatlas":
        return _xatlas(vertices_mm, triangles, size)
    chart, axes = cut_into_charts(vertices_mm, triangles)
    count = len(axes)
    key = triangles.astype(np.int64) * count + chart[:, None]
    unique, inverse = np.unique(key.ravel(), return_inverse=True)
    render_triangles = inverse.reshape(-1, 3).astype(np.int32)
    welded = (unique // count).astype(np.int32)
    render_chart = (unique % count).astype(np.int32)
    flat = project(vertices_mm[welded], axes, render_chart)
    flat, low, high = turned(flat, render_chart, count)
    place, scale = pack(high - low, size)
    texel = (flat - low[render_chart]) * scale + place[render_chart] + GUTTER_TEXELS
    uv = (texel / size).astype(np.float32)
    return Atlas(welded, render_triangles, uv, count, float(scale), _used(uv, render_triangles))


def tangents(atlas: Atlas, vertices_mm: Float, normals: Float) -> Float32:
    """Tangents as glTF 2.0 wants them (section 3.7.2.1): along growing u, at right angles to the normal.

    Parameters
    ----------
    atlas
        The atlas.
    vertices_mm, normals
        Welded vertices and their unit normals, shape (vertex_count, 3).

    Returns
    -------
    Float32
        Shape (render_vertex_count, 4): unit tangent and handedness; ``cross(normal, tangent) * handedness`` points up
        in the picture, to smaller v.
    """
    position = np.asarray(vertices_mm, dtype=np.float64)[atlas.render_to_welded]
    normal = np.asarray(normals, dtype=np.float64)[atlas.render_to_welded]
    corner = position[atlas.triangles]
    uv = atlas.uv.astype(np.float64)[atlas.triangles]
    edge = corner[:, 1:] - corner[:, :1]
    turn = uv[:, 1:] - uv[:, :1]
    determinant = turn[:, 0, 0] * turn[:, 1, 1] - turn[:, 0, 1] * turn[:, 1, 0]
    sign = np.where(determinant < 0.0, -1.0, 1.0)
    along = sign[:, None] * (turn[:, 1, 1, None] * edge[:, 0] - turn[:, 0, 1, None] * edge[:, 1])
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-30)[:, None]
    along *= np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1)[:, None]
    total = np.zeros_like(position)
    hand = np.zeros(len(position))
    for k in range(3):
        np.add.at(total, atlas.triangles[:, k], along)
        np.add.at(hand, atlas.triangles[:, k], -sign)
    tangent = total - (total * normal).sum(axis=1)[:, None] * normal
    length = np.linalg.norm(tangent, axis=1)
    lost = length < 1e-6 * np.maximum(np.linalg.norm(total, axis=1), 1e-30)
    if lost.any():
        other = np.eye(3)[np.abs(normal[lost]).argmin(axis=1)]
        tangent[lost] = np.cross(normal[lost], other)
        length[lost] = np.linalg.norm(tangent[lost], axis=1)
    # a vertex without a normal, which only a broken mesh has, gets no tangent
    tangent /= np.maximum(length, 1e-30)[:, None]
    return np.column_stack([tangent, np.where(hand < 0.0, -1.0, 1.0)]).astype(np.float32)


def _xatlas(vertices_mm: Float64, triangles: Int32, size: int) -> Atlas:
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(vertices_mm.astype(np.float32), triangles.astype(np.uint32))
    pack = xatlas.PackOptions()
    pack.resolution = size
    pack.padding = 2 * GUTTER_TEXELS
    pack.bilinear = True
    atlas.generate(xatlas.ChartOptions(), pack)
    source, corners, uv = atlas[0]
    order = np.argsort(source, kind="stable")
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    uv = np.ascontiguousarray(uv[order], dtype=np.float32)
    uv[:, 1] = 1.0 - uv[:, 1]
    render = number[corners.astype(np.int64)]
    return Atlas(
        source[order].astype(np.int32),
        render,
        uv,
        int(atlas.chart_count),
        float(atlas.texels_per_unit),
        _used(uv, render),
    )


def _used(uv: Float32, triangles: Int32) -> float:
    corner = uv.astype(np.float64)[triangles]
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    return float(0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
