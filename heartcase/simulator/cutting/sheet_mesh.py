"""All sheets as one mesh: corners that lie in one place are one vertex, so that a sheet that comes back to itself closes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float64, Int64
from heartcase.simulator.cutting.blade_sheet import Sheet

__all__ = ["SheetMesh", "sheet_mesh"]


@dataclass(frozen=True)
class SheetMesh:
    """Triangles of all sheets; none is there twice, and none has a corner twice."""

    vertices: Int64
    """Places in QUANTA to a cell, in the frame of the nodes, shape (vertex_count, 3)."""
    triangles: Int64
    """Vertex numbers, shape (triangle_count, 3)."""
    edges: Int64
    """Number of the edge from each corner to the next, shape (triangle_count, 3)."""
    edge_vertices: Int64
    """Lower and higher vertex of each edge, shape (edge_count, 2)."""
    angles: Float64
    """Direction in which each triangle lies around the edge that follows a corner, counter-clockwise seen against the
    way from the edge's lower to its higher vertex, shape (triangle_count, 3)."""
    flat: Float64
    """Place of each corner on the sheet laid out flat [cells], shape (triangle_count, 3, 2)."""
    sheet: Int64
    """Number of the sheet that each triangle is of, shape (triangle_count,)."""


def sheet_mesh(sheets: Sequence[Sheet]) -> SheetMesh:
    """Join sheets to one mesh."""
    corners = np.concatenate([np.zeros((0, 3, 3), np.int64), *(sheet.triangles for sheet in sheets)])
    flat = np.concatenate([np.zeros((0, 3, 2)), *(sheet.laid_out() for sheet in sheets)])
    sheet = np.repeat(np.arange(len(sheets)), [len(each.triangles) for each in sheets])
    vertices, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    triangles = number.reshape(-1, 3)
    ordered = np.sort(triangles, axis=1)
    has_three = (np.diff(ordered, axis=1) > 0).all(axis=1)
    _, once = np.unique(ordered, axis=0, return_index=True)
    kept = np.sort(once[has_three[once]])
    triangles = triangles[kept].astype(np.int64)
    pairs = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edge_vertices, edges = np.unique(pairs, axis=0, return_inverse=True)
    return SheetMesh(
        vertices.astype(np.int64),
        triangles,
        edges.reshape(-1, 3).astype(np.int64),
        edge_vertices.reshape(-1, 2).astype(np.int64),
        _angles(vertices.astype(np.float64), triangles, edge_vertices[edges.ravel()].reshape(-1, 3, 2)),
        flat[kept],
        sheet[kept].astype(np.int64),
    )


def _angles(vertices: Float64, triangles: Int64, of_edges: Int64) -> Float64:
    start = vertices[of_edges[..., 0]]
    way = vertices[of_edges[..., 1]] - start
    third = vertices[np.roll(triangles, -2, axis=1)] - start
    across = np.zeros_like(way)
    # A direction across the edge, the same for all of its triangles: away from its least component.
    np.put_along_axis(across, np.abs(way).argmin(axis=2)[..., None], 1.0, axis=2)
    one = np.cross(way, across)
    other = np.cross(way, one) / np.linalg.norm(way, axis=2)[..., None]
    return np.arctan2(np.einsum("tcx,tcx->tc", third, other), np.einsum("tcx,tcx->tc", third, one))
