"""All sheets as one mesh: corners in one place are one vertex, so that a sheet that comes back to itself closes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float64, Int64
from heartcase.simulator.arrangement.sheet_sides import order_around
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
    ranks: Int64
    """Place of each triangle in the order around the edge that follows a corner, counter-clockwise seen against the way
    from the edge's lower to its higher vertex, shape (triangle_count, 3)."""
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
    has_three = np.asarray((np.diff(ordered, axis=1) > 0).all(axis=1))
    _, once = np.unique(ordered, axis=0, return_index=True)
    # By their vertices, so that it does not matter in which order and in how many parts they were swept.
    kept = once[has_three[once]]
    triangles = triangles[kept].astype(np.int64)
    pairs = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edge_vertices, edges = np.unique(pairs, axis=0, return_inverse=True)
    return SheetMesh(
        vertices.astype(np.int64),
        triangles,
        edges.reshape(-1, 3).astype(np.int64),
        edge_vertices.reshape(-1, 2).astype(np.int64),
        _ranks(vertices.astype(np.int64), triangles, edge_vertices.astype(np.int64), edges.ravel()),
        flat[kept],
        sheet[kept].astype(np.int64),
    )


def _ranks(vertices: Int64, triangles: Int64, edge_vertices: Int64, edges: Int64) -> Int64:
    ranks = np.zeros((len(triangles), 3), np.int64)
    members = np.argsort(edges, kind="stable")
    first = np.append(0, np.cumsum(np.bincount(edges, minlength=len(edge_vertices)))).astype(np.int64)
    order_around(vertices, triangles, edge_vertices, first, members, ranks)
    return ranks
