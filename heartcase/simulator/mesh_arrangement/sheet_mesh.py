"""All sheets as one mesh: corners in one place are one vertex, so that a sheet that comes back to itself closes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from heartcase.schemas.arrays import Float64, Int64
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.mesh_arrangement.merged_rows import merge_rows
from heartcase.simulator.mesh_arrangement.sheet_sides import order_around

__all__ = ["NO_SHEETS", "Merged", "SheetMesh", "merged_mesh", "sheet_mesh"]


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


class Merged(NamedTuple):
    """A mesh that goes on from another, and what became of this."""

    mesh: SheetMesh
    vertices: Int64
    """Number of each vertex that was there, ascending."""
    triangles: Int64
    """Number of each triangle that was there, ascending."""
    edges: Int64
    """Number of each edge that was there, ascending."""
    added: Int64
    """Triangles that were not there, ascending."""


NO_SHEETS = SheetMesh(
    np.zeros((0, 3), np.int64),
    np.zeros((0, 3), np.int64),
    np.zeros((0, 3), np.int64),
    np.zeros((0, 2), np.int64),
    np.zeros((0, 3), np.int64),
    np.zeros((0, 3, 2)),
    np.zeros(0, np.int64),
)
"""The mesh of no sheets."""


def sheet_mesh(sheets: Sequence[Sheet]) -> SheetMesh:
    """Join sheets to one mesh."""
    return merged_mesh(NO_SHEETS, sheets, 0).mesh


def merged_mesh(before: SheetMesh, sheets: Sequence[Sheet], first: int) -> Merged:
    """Join more sheets to a mesh: what comes out is that of all sheets together.

    Parameters
    ----------
    before
        The mesh of the first sheets.
    sheets
        All sheets.
    first
        How many of them the mesh is of.
    """
    more = sheets[first:]
    corners = np.concatenate([np.zeros((0, 3, 3), np.int64), *(sheet.triangles for sheet in more)])
    flat = np.concatenate([np.zeros((0, 3, 2)), *(sheet.laid_out() for sheet in more)])
    sheet = first + np.repeat(np.arange(len(more)), [len(each.triangles) for each in more])
    vertices, of_vertex, numbers = _together(before.vertices, corners.reshape(-1, 3))
    new = numbers.reshape(-1, 3)
    ordered = np.sort(new, axis=1)
    kept = np.flatnonzero((ordered[:, 0] < ordered[:, 1]) & (ordered[:, 1] < ordered[:, 2]))
    new, ordered, flat, sheet = new[kept], ordered[kept], flat[kept], sheet[kept]
    old = of_vertex[before.triangles]
    # By their vertices, so that it does not matter in which order and in how many parts they were swept.
    old_ordered = np.sort(old, axis=1)
    of_triangle, number = np.empty(len(old), np.int64), np.empty(len(new), np.int64)
    source = np.empty(len(old) + len(new), np.int64)
    source = source[: merge_rows(old_ordered, ordered, of_triangle, number, source)]
    added = np.flatnonzero(source < 0)
    first_rows = -1 - source[added]
    triangles = _placed(old, of_triangle, new[first_rows], added)
    pairs = np.sort(np.stack([triangles[added], triangles[added][:, [1, 2, 0]]], axis=2).reshape(-1, 2), axis=1)
    edge_vertices, of_edge, edge_numbers = _together(of_vertex[before.edge_vertices], pairs)
    edges = _placed(of_edge[before.edges], of_triangle, edge_numbers.reshape(-1, 3), added)
    ranks = np.zeros((len(triangles), 3), np.int64)
    order_around(vertices, triangles, edges, edge_vertices, ranks)
    mesh = SheetMesh(
        vertices,
        triangles,
        edges,
        edge_vertices,
        ranks,
        _placed(before.flat, of_triangle, flat[first_rows], added),
        _placed(before.sheet, of_triangle, sheet[first_rows], added),
    )
    return Merged(mesh, of_vertex, of_triangle, of_edge, added)


def _together(old: Int64, new: Int64) -> tuple[Int64, Int64, Int64]:
    """Rows of both, each once and ascending, and the number that each of both has among them."""
    old_number, new_number = np.empty(len(old), np.int64), np.empty(len(new), np.int64)
    source = np.empty(len(old) + len(new), np.int64)
    source = source[: merge_rows(old, new, old_number, new_number, source)]
    rows = np.empty((len(source), old.shape[1]), np.int64)
    rows[old_number], rows[new_number] = old, new
    return rows, old_number, new_number


def _placed(old: Any, old_at: Int64, new: Any, new_at: Int64) -> Any:
    """Rows of both in their places."""
    found = np.empty((len(old_at) + len(new_at), *old.shape[1:]), old.dtype)
    found[old_at], found[new_at] = old, new
    return found
