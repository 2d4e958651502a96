"""Tying the visible surface to the simulation grid (thesis 9.3.2 and 9.3.3).

Each vertex follows a triangle of boundary nodes: a reference point inside the triangle, given by weights, and an
offset along the triangle's own basis (T, N, B). The bases are normalised, where equations (9.6) and (9.8) as printed
are not, so the surface is exact at rest and under every rigid motion. Vertices and triangles go together by the void
beside them, so no vertex is tied across a wall.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from heartcase.pipeline.cells.curvature import curvature_errors
from heartcase.pipeline.data import GridMap, SimulationGrid, Surface
from heartcase.pipeline.picking import split_faces
from heartcase.schemas.settings import MapSettings

__all__ = ["CURVATURE_ALIGNMENT", "CURVATURE_GAIN", "FAR_CELLS", "OTHER_LABEL_SHARE", "map_surface", "triangle_basis"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]

FAR_CELLS = 2.0
"""A face of the vertex's own label may be this many cells farther off than the nearest of any label."""

CURVATURE_GAIN = 0.8
"""Curvature correction is used where it brings the error under bending below this part of the flat basis' error."""

CURVATURE_ALIGNMENT = 0.9
"""And only where the interpolated normal is this close (cosine) to the triangle's, as eq. (9.8) assumes."""


OTHER_LABEL_SHARE = 1e-3
"""Vertices that follow another structure are warned of beyond this part of all."""

_CLUSTER_CELLS = 5.0


def map_surface(surface: Surface, grid: SimulationGrid, settings: MapSettings) -> GridMap:
    """Tie each vertex of the surface to a triangle of boundary nodes of its own label (thesis 9.3.3).

    Parameters
    ----------
    surface
        The surface; its render arrays may be empty.
    grid
        The grid.
    settings
        Candidates and the penalty for triangles that face away.

    Returns
    -------
    GridMap
        ``quality`` counts vertices that had to take a face of another label and says how far vertices lie from
        their reference points, in cells.
    """
    positions = grid.node_positions_mm()
    triangles = split_faces(grid.faces)
    vertices = surface.vertices_mm.astype(np.float64)
    normals = surface.normals.astype(np.float64)
    chosen, is_other = _choose_triangles(surface, grid, settings, positions, triangles)

    corners = positions[triangles[chosen]]
    weights = np.empty((len(vertices), 3), np.float32)
    _closest_weights(vertices, corners, weights)
    reference = np.einsum("vc,vcx->vx", weights.astype(np.float64), corners)
    basis = triangle_basis(corners)
    offset = np.einsum("vbx,vx->vb", basis, vertices - reference)
    flat, curved, aligned = curvature_errors(grid, vertices, normals, triangles[chosen], weights)
    curvature = ((curved < CURVATURE_GAIN * flat) & (aligned > CURVATURE_ALIGNMENT)).astype(np.uint8)
    far = np.linalg.norm(vertices - reference, axis=1) / grid.geometry.spacing_mm[0]
    warnings: tuple[str, ...] = ()
    if is_other.sum() > OTHER_LABEL_SHARE * len(vertices):
        x, y, z = _densest(vertices[is_other], _CLUSTER_CELLS * grid.geometry.spacing_mm[0])
        warnings = (
            f"{100.0 * is_other.mean():.1f}% of the visible surface lies where a cavity or a wall is too narrow for "
            f"the simulation cells, and moves with what is nearest to it instead (most of it near "
            f"({x:.1f}, {y:.1f}, {z:.1f}) mm): make the cells smaller if that place matters",
        )
    return GridMap(
        triangle_nodes=triangles[chosen],
        weights=weights,
        offset_mm=offset.astype(np.float32),
        normal=_unit(np.einsum("vbx,vx->vb", basis, normals)).astype(np.float32),
        curvature=curvature,
        tangent=_tangents(surface, basis),
        nearest_node=_nearest_nodes(surface, grid, positions),
        quality=_quality(far, is_other, curvature),
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
    surface: Surface, grid: SimulationGrid, settings: MapSettings, positions: Float64, triangles: Int32
) -> tuple[Int64, npt.NDArray[np.bool_]]:
    """The triangle of each vertex, and whether it is one of another label."""
    corners = positions[triangles]
    centres = corners.mean(axis=1)
    facing = triangle_basis(corners)[:, 1]
    label = np.repeat(grid.face_label, 2)
    vertices = surface.vertices_mm.astype(np.float64)
    normals = surface.normals.astype(np.float64)
    cell_mm = grid.geometry.spacing_mm[0]
    penalty_mm = settings.normal_penalty * cell_mm

    def nearest(who: Int64, among: Int64) -> tuple[Int64, Float64]:
        count = min(settings.candidate_count, len(among))
        found = cKDTree(centres[among]).query(vertices[who], k=count, workers=1)[1].reshape(len(who), count)
        tried = np.sort(among[found], axis=1)
        best = np.empty(len(who), np.int64)
        score = np.empty(len(who))
        _best_triangle(vertices[who], normals[who], tried, corners, facing, penalty_mm, best, score)
        return best, score

    everyone = np.arange(len(vertices))
    chosen, any_score = nearest(everyone, np.arange(len(triangles)))
    is_other = np.ones(len(vertices), np.bool_)
    for value in np.unique(surface.vertex_label):
        among = np.flatnonzero(label == value)
        who = np.flatnonzero(surface.vertex_label == value)
        if len(among) == 0:
            continue
        own, score = nearest(who, among)
        # A cavity too narrow for a cell has no faces there: its far ones would drag the vertex along.
        near = score <= any_score[who] + FAR_CELLS * cell_mm
        chosen[who[near]] = own[near]
        is_other[who[near]] = False
    return chosen, is_other


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
    distance, at = cKDTree(points).query(places, workers=1)
    return np.asarray(distance, np.float64), np.asarray(at, np.int64)


def _quality(far: Float64, is_other: npt.NDArray[np.bool_], curvature: npt.NDArray[np.uint8]) -> dict[str, Any]:
    count = len(far)
    p50, p95, most = np.percentile(far, [50, 95, 100]) if count else (0.0, 0.0, 0.0)
    return {
        "vertex_count": count,
        "other_label_count": int(is_other.sum()),
        "curvature_share": float(curvature.mean()) if count else 0.0,
        "offset_cells": {"p50": float(p50), "p95": float(p95), "max": float(most)},
    }


def _unit(vectors: Float64) -> Float64:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Float64 = vectors / np.where(length > 0.0, length, 1.0)
    return unit


@numba.njit(cache=True, nogil=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, nogil=True)
def _closest_point(p, a, b, c, weights):  # type: ignore[no-untyped-def]
    """Weights of the point of triangle (a, b, c) that is closest to p; returns the squared distance.

    By the regions of the plane that each corner, edge and the inside own.
    """
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    bp, cp = p - b, p - c
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v, w = 0.0, 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        v = vb / (va + vb + vc)
        w = vc / (va + vb + vc)
    weights[0] = 1.0 - v - w
    weights[1] = v
    weights[2] = w
    away = p - (a + v * ab + w * ac)
    return _dot(away, away)


@numba.njit(cache=True, nogil=True, parallel=True)
def _best_triangle(vertices, normals, tried, corners, facing, penalty, best, score):  # type: ignore[no-untyped-def]
    """The tried triangle (ascending numbers) with the least distance and penalty for facing away; ties: the first."""
    for n in numba.prange(len(vertices)):
        weights = np.empty(3)
        lowest = np.inf
        for t in tried[n]:
            squared = _closest_point(vertices[n], corners[t, 0], corners[t, 1], corners[t, 2], weights)
            value = np.sqrt(squared) + penalty * max(-_dot(normals[n], facing[t]), 0.0)
            if value < lowest:
                lowest = value
                best[n] = t
        score[n] = lowest


@numba.njit(cache=True, nogil=True, parallel=True)
def _closest_weights(vertices, corners, out):  # type: ignore[no-untyped-def]
    """Weights in float32 that are multiples of 2**-24, so that their float32 sum is one in any order."""
    steps = 16777216.0
    for n in numba.prange(len(vertices)):
        weights = np.empty(3)
        _closest_point(vertices[n], corners[n, 0], corners[n, 1], corners[n, 2], weights)
        second = min(max(np.rint(weights[1] * steps), 0.0), steps)
        third = min(max(np.rint(weights[2] * steps), 0.0), steps - second)
        out[n, 0] = (steps - second - third) / steps
        out[n, 1] = second / steps
        out[n, 2] = third / steps
