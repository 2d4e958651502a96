"""Tying the visible surface to the simulation grid (thesis 9.3.2 and 9.3.3).

Each vertex follows a triangle of boundary nodes: a reference point inside the triangle, given by weights, and an
offset along the triangle's own basis (T, N, B). The bases are normalised, where equations (9.6) and (9.8) as printed
are not, so the surface is exact at rest and under every rigid motion. Vertices and triangles go together by the void
beside them, and no way from a vertex to its triangle leads through a wall. Where the void is too narrow for a cell
there is no such triangle: a vertex there follows a face between the tissue cells around it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numba
import numpy as np
from scipy.spatial import cKDTree

from heartcase.pipeline.cells.build_grid import FACE_CORNERS
from heartcase.pipeline.cells.curvature import curvature_errors, grid_springs, node_neighbours
from heartcase.pipeline.cells.picking import split_faces
from heartcase.pipeline.cells.ties import Check, NodeTriangles, TieChooser, closest_weights
from heartcase.pipeline.data import GridMap, SimulationGrid, Structures, Surface
from heartcase.pipeline.fields.reader import FieldReader, steps_through
from heartcase.pipeline.kernels.parallel import all_side_by_side, side_by_side
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.arrays import Bool, Float32, Float64, Int32, Int64, UInt8
from heartcase.schemas.bundle.lattice import cell_nodes, lattice_keys
from heartcase.schemas.errors import Problem, StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import MapSettings

__all__ = [
    "CURVATURE_ALIGNMENT",
    "CURVATURE_GAIN",
    "FAR_CELLS",
    "NEAR_CELLS",
    "OTHER_LABEL_SHARE",
    "map_surface",
    "triangle_basis",
]


NEAR_CELLS = 1.25
"""A boundary face of the vertex's own void within this many cells is taken; else a nearer face between cells, where
there is one. Farther faces, of the rim of a gap that no cell keeps open, lead the vertex ten times worse."""

FAR_CELLS = 2.0
"""A face of the vertex's own label may be this many cells farther off than the nearest of any label."""

CURVATURE_GAIN = 0.8
"""Curvature correction is used where it brings the error under bending below this part of the flat basis' error."""

CURVATURE_ALIGNMENT = 0.9
"""And only where the interpolated normal is this close (cosine) to the triangle's, as eq. (9.8) assumes."""


OTHER_LABEL_SHARE = 1e-3
"""Vertices that have no face of their own void in reach are warned of beyond this part of all."""

_CLUSTER_CELLS = 5.0


def map_surface(surface: Surface, grid: SimulationGrid, structures: Structures, settings: MapSettings) -> GridMap:
    """Tie each vertex of the surface to a triangle of boundary nodes of its own label (thesis 9.3.3).

    Parameters
    ----------
    surface
        The surface; its render arrays may be empty.
    grid
        The grid.
    structures
        What both were made from: their fields say where walls and gaps are.
    settings
        Candidates and the penalty for triangles that face away.

    Returns
    -------
    GridMap
        ``quality`` counts vertices that had to take a face between tissue cells or one of another label, and says
        how far vertices lie from their reference points, in cells. Coarser levels of detail are tied likewise.

    Raises
    ------
    StageError
        A vertex or a normal is not a number; surface, grid and structures are not of one case.
    """
    problems = _not_numbers(surface, "")
    for n, level in enumerate(surface.levels, start=1):
        problems += _not_numbers(level, f"levels.{n}.")
    if not surface.table == grid.table == structures.table:
        problems.append(
            Problem(
                "structures", "surface, grid and structures are not of one case: give those that both were made from"
            )
        )
    elif not _is_parallel(grid.geometry, structures.geometry):
        problems.append(
            Problem("structures", "the grid was not made from them: its axes are others; give those it was made from")
        )
    if problems:
        raise StageError(problems)
    reader = FieldReader.of(structures)
    cells = _Cells.of(grid)
    # the finest, which takes longest, beside the others
    finest, *levels = all_side_by_side(
        [partial(_map_level, level, cells, reader, settings) for level in (surface, *surface.levels)]
    )
    return replace(finest, levels=tuple(levels))


@dataclass(frozen=True)
class _Cells:
    """What all levels of detail are tied to."""

    grid: SimulationGrid
    positions_mm: Float64
    """Of its nodes, shape (node_count, 3)."""
    neighbours: Int32
    """Nodes that springs join to each, shape (node_count, 18)."""
    triangles: Int32
    """Nodes of the halves of its boundary's faces, shape (any, 3)."""
    boundary: NodeTriangles
    """The same where they are."""
    label: UInt8
    """Which void each half looks into."""

    @staticmethod
    def of(grid: SimulationGrid) -> _Cells:
        """Of a grid."""
        triangles = split_faces(grid.faces)
        positions = grid.node_positions_mm()
        boundary, neighbours = side_by_side(
            lambda: _triangles_of(grid, triangles, np.repeat(grid.cells[grid.face_cell], 2, axis=0)),
            lambda: node_neighbours(grid_springs(grid), len(positions)),
        )
        return _Cells(grid, positions, neighbours, triangles, boundary, np.repeat(grid.face_label, 2))


def _triangles_of(grid: SimulationGrid, nodes: Int32, cells: Int32) -> NodeTriangles:
    """Triangles of nodes, and the cell behind each."""
    corners = grid.nodes[nodes].astype(np.float64)
    return NodeTriangles(corners, triangle_basis(corners)[:, 1], cells)


def _not_numbers(surface: Surface, place: str) -> list[Problem]:
    """What is wrong with vertices or normals that are no numbers."""
    return [
        Problem(
            place + name,
            f"{bad.sum()} of {len(bad)} are not numbers, the first at vertex {bad.argmax()}: make the surface again",
        )
        for name in ("vertices_mm", "normals")
        if (bad := ~np.isfinite(getattr(surface, name)).all(axis=1)).any()
    ]


def _is_parallel(cells: Geometry, fields: Geometry) -> bool:
    """Whether two lattices have the same axes, but for their order along each."""
    try:
        steps_through(fields, cells)
    except ValueError:
        return False
    return True


def _map_level(surface: Surface, cells: _Cells, reader: FieldReader, settings: MapSettings) -> GridMap:
    """Tie one level of detail."""
    grid, positions = cells.grid, cells.positions_mm
    vertices = surface.vertices_mm.astype(np.float64)
    normals = surface.normals.astype(np.float64)
    (triangles, is_inner, is_narrow), nearest_node = side_by_side(
        lambda: _choose_triangles(surface, cells, reader, settings), lambda: _nearest_nodes(surface, grid, positions)
    )

    corners = positions[triangles]
    weights = closest_weights(vertices, corners)
    reference = np.einsum("vc,vcx->vx", weights.astype(np.float64), corners)
    basis = triangle_basis(corners)
    offset = np.einsum("vbx,vx->vb", basis, vertices - reference)
    flat, curved, aligned = curvature_errors(grid, cells.neighbours, vertices, normals, triangles, weights)
    curvature = ((curved < CURVATURE_GAIN * flat) & (aligned > CURVATURE_ALIGNMENT)).astype(np.uint8)
    far = np.linalg.norm(vertices - reference, axis=1) / grid.geometry.spacing_mm[0]
    warnings: tuple[CaseWarning, ...] = ()
    if is_narrow.sum() > OTHER_LABEL_SHARE * len(vertices):
        x, y, z = _densest(vertices[is_narrow], _CLUSTER_CELLS * grid.geometry.spacing_mm[0])
        warnings = (
            CaseWarning(
                sentence(
                    "surface-too-narrow",
                    percent=f"{100.0 * is_narrow.mean():.1f}",
                    place=f"({x:.1f}, {y:.1f}, {z:.1f})",
                )
            ),
        )
    return GridMap(
        triangle_nodes=triangles,
        weights=weights,
        offset_mm=offset.astype(np.float32),
        normal=_unit(np.einsum("vbx,vx->vb", basis, normals)).astype(np.float32),
        curvature=curvature,
        tangent=_tangents(surface, basis),
        nearest_node=nearest_node,
        quality=_quality(far, is_inner, is_narrow & ~is_inner, curvature),
        warnings=warnings,
    )


def _densest(points: Float64, width_mm: float) -> Float64:
    """Mean of the points in the fullest box of a lattice (ties: the first box)."""
    _, box, count = np.unique(np.floor(points / width_mm), axis=0, return_inverse=True, return_counts=True)
    centre: Float64 = points[box.ravel() == count.argmax()].mean(axis=0)
    return centre


def triangle_basis(corners: Float64) -> Float64:
    """Orthonormal basis (T, N, B) of triangles: eq. (9.6) with each vector normalised.

    Parameters
    ----------
    corners
        Corner positions, shape (n, 3, 3): corner, then x, y, z.

    Returns
    -------
    float64, shape (n, 3, 3)
        Rows T, N, B.
    """
    tangent = _unit(corners[:, 1] - corners[:, 0])
    normal = _unit(np.cross(tangent, _unit(corners[:, 2] - corners[:, 0])))
    return np.stack((tangent, normal, np.cross(normal, tangent)), axis=1)


def _choose_triangles(
    surface: Surface, cells: _Cells, reader: FieldReader, settings: MapSettings
) -> tuple[Int32, Bool, Bool]:
    """The triangle of each vertex, whether it lies between cells, and whether no face of its own void is in reach."""
    grid, triangles, at_boundary, label = cells.grid, cells.triangles, cells.boundary, cells.label
    penalty, tries = settings.normal_penalty, settings.candidate_count
    chooser = TieChooser(surface, reader, grid.geometry, penalty=penalty, tries=tries)
    everyone = np.arange(len(surface.vertices_mm))
    chosen, own_score = np.full(len(everyone), -1), np.full(len(everyone), np.inf)

    def take_own(who: Int64, most: Float64) -> Int64:
        """Give vertices a triangle of their own void within reach; returns those that have none."""
        for value in np.unique(surface.vertex_label[who]):
            among = np.flatnonzero(label == value)
            mine = np.flatnonzero(surface.vertex_label[who] == value)
            if len(among):
                chosen[who[mine]], own_score[who[mine]] = chooser.nearest(
                    who[mine], at_boundary, among, most=most[mine]
                )
        return who[chosen[who] < 0]

    left = take_own(everyone, np.full(len(everyone), FAR_CELLS))
    nearest, score = chooser.nearest(left, at_boundary, np.arange(len(triangles)), check=Check.NOTHING)
    # A cavity too narrow for a cell has no faces there: its far ones would drag the vertex along.
    narrow = take_own(left, score + FAR_CELLS)
    chosen[narrow] = nearest[np.isin(left, narrow)]
    nodes = triangles[chosen]
    is_inner = np.zeros(len(everyone), np.bool_)
    far = np.flatnonzero(own_score > NEAR_CELLS)
    inner, behind = _inner_triangles(grid, surface.vertices_mm[far].astype(np.float64))
    if len(inner):
        between, among = _triangles_of(grid, inner, behind), np.arange(len(inner))
        own, score = chooser.nearest(far, between, among, check=Check.WALLS_GAPS)
        # The cells around a sliver of tissue that fills none of its own carry it too.
        lost = np.flatnonzero((own < 0) & (own_score[far] > FAR_CELLS))
        own[lost], score[lost] = chooser.nearest(far[lost], between, among, check=Check.NOTHING)
        nearer = score < np.minimum(own_score[far], FAR_CELLS)
        nodes[far[nearer]] = inner[own[nearer]]
        is_inner[far[nearer]] = True
    return nodes, is_inner, ~np.isfinite(own_score)


def _inner_triangles(grid: SimulationGrid, points: Float64) -> tuple[Int32, Int32]:
    """Triangles of the faces between tissue cells near some points, seen from both sides, and the cell behind each."""
    if len(points) == 0:
        return np.zeros((0, 3), np.int32), np.zeros((0, 3), np.int32)
    reach = (FAR_CELLS + 1.0) * grid.geometry.spacing_mm[0]
    centres = grid.geometry.index_to_world(grid.cells)
    near = np.isfinite(cKDTree(points).query(centres, distance_upper_bound=reach, workers=1)[0])
    steps = np.array([(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)])
    beside = lattice_keys(grid.cells[near][:, None, :] + steps)
    cell, side = np.nonzero(np.isin(beside, lattice_keys(grid.cells)))
    corners = cell_nodes(grid.cells)[1][near]
    return split_faces(corners[cell[:, None], FACE_CORNERS[side]]), np.repeat(grid.cells[near][cell], 2, axis=0)


def _tangents(surface: Surface, basis: Float64) -> Float32:
    """Tangents of the render vertices in the basis of their welded vertex; zero where the surface has none."""
    world = surface.render_tangents.reshape(-1, 4).astype(np.float64)
    tangent = np.zeros((len(world), 4), np.float32)
    tangent[:, :3] = np.einsum("vbx,vx->vb", basis[surface.render_to_welded], world[:, :3])
    tangent[:, 3] = world[:, 3]
    return tangent


def _nearest_nodes(surface: Surface, grid: SimulationGrid, positions: Float64) -> Int32:
    """Nearest boundary node beside the vertex's own void; of all boundary nodes where none is within reach."""
    vertices = surface.vertices_mm.astype(np.float64)
    boundary = np.unique(grid.faces)
    any_distance, any_at = _query(positions[boundary], vertices)
    nearest = boundary[any_at]
    reach = FAR_CELLS * grid.geometry.spacing_mm[0]
    for value in np.unique(surface.vertex_label):
        mine = np.unique(grid.faces[grid.face_label == value])
        who = np.flatnonzero(surface.vertex_label == value)
        if len(mine) == 0:
            continue
        distance, at = _query(positions[mine], vertices[who])
        near = distance <= any_distance[who] + reach
        nearest[who[near]] = mine[at[near]]
    return nearest


def _query(points: Float64, places: Float64) -> tuple[Float64, Int64]:
    distance, at = cKDTree(points).query(places, workers=numba.get_num_threads())
    return np.asarray(distance, np.float64), np.asarray(at, np.int64)


def _quality(far: Float64, is_inner: Bool, is_other: Bool, curvature: UInt8) -> dict[str, Any]:
    count = len(far)
    p50, p95, most = np.percentile(far, [50, 95, 100]) if count else (0.0, 0.0, 0.0)
    return {
        "vertex_count": count,
        "inner_face_count": int(is_inner.sum()),
        "other_label_count": int(is_other.sum()),
        "curvature_share": float(curvature.mean()) if count else 0.0,
        "offset_cells": {"p50": float(p50), "p95": float(p95), "max": float(most)},
    }


def _unit(vectors: Float64) -> Float64:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Float64 = vectors / np.where(length > 0.0, length, 1.0)
    return unit
