"""Whether a case's surfaces are closed, face outwards, and lie at rest where the mapping puts them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from heartcase.schemas.arrays import Float64, Int32, Int64
from heartcase.schemas.bundle.format import CaseManifest, FileRole
from heartcase.schemas.bundle.lattice import cell_nodes
from heartcase.schemas.bundle.manifest import stated
from heartcase.schemas.bundle.surface_kinds import SurfaceKind, plain_kinds
from heartcase.schemas.bundle.values import Arrays, Parts
from heartcase.schemas.errors import BundleError, Problem
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable

__all__ = ["mapping_problems", "picking_problems", "rest_basis", "surface_problems"]


REST_TOLERANCE_MM = 1e-2
"""How far the mapping may put a vertex from where the surface has it, at rest."""
WEIGHT_TOLERANCE = 1e-4
"""How far weights may sum from one."""
DIRECTION_TOLERANCE = 1e-3
"""How far a component of a unit vector may be off."""
NEAREST_EXCESS_CELLS = 2.0
"""A node beside the vertex's own void counts as nearest though one elsewhere is nearer by this many cells."""
NEAREST_SAMPLES = 128


def surface_problems(manifest: CaseManifest, parts: Parts) -> Iterable[Problem]:
    """The visible surface by itself: closed, outwards, its normals unit and outwards too."""
    surface = parts.get(FileRole.SURFACE, {})
    vertices, triangles, normals = (surface.get(name) for name in ("vertices", "triangles", "normals"))
    yield from _kind_problems(manifest, surface)
    if normals is not None and len(normals):
        lengths = np.linalg.norm(normals.astype(np.float64), axis=1)
        if np.abs(lengths - 1.0).max() > DIRECTION_TOLERANCE:
            yield Problem("surface.normals", "are not all of length one")
    if triangles is not None and len(triangles) and not _is_closed(triangles):
        yield Problem("surface.triangles", "leave the surface open: not every edge has a triangle on either side")
    if vertices is None or triangles is None or not len(triangles):
        return
    points = vertices.astype(np.float64)
    corners = (points - points[0])[triangles]
    if _six_volumes(corners) <= 0.0:
        yield Problem("surface.triangles", "are turned inside out: the case would be shown mirrored or hollow")
    elif normals is not None:
        facing = np.zeros_like(points)
        faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        for corner in range(3):
            np.add.at(facing, triangles[:, corner], faces)
        if 2 * np.count_nonzero((facing * normals).sum(axis=1) > 0.0) < len(points):
            yield Problem("surface.normals", "point into the tissue: the case would be lit from inside")


def _kind_problems(manifest: CaseManifest, surface: Arrays) -> Iterable[Problem]:
    """The kinds must follow from the labels on both sides; whether a triangle is a defect's rim, nothing else says."""
    names = ("triangle_kind", "triangle_label", "triangle_tissue", "triangle_is_cut")
    labels = stated(manifest, "labels")
    if not isinstance(labels, LabelTable) or not set(names) <= set(surface):
        return
    entries = stated(manifest, "labels.labels")
    if entries is None or any(not {"value", "role", "wall_of"} <= set(label.__dict__) for label in entries):
        return
    kinds, void, tissue, is_cut = (surface[name] for name in names)
    wrong = kinds != plain_kinds(void, tissue, is_cut, labels)
    if (wrong & ((kinds != SurfaceKind.DEFECT_RIM) | (is_cut != 0))).any():
        yield Problem("surface.triangle_kind", "does not fit the labels on both sides of the triangles")


def _is_closed(triangles: Int32) -> bool:
    """Whether every edge is passed as often one way as the other."""
    first, second = triangles.astype(np.int64).ravel(), np.roll(triangles, -1, axis=1).astype(np.int64).ravel()
    count = int(triangles.max()) + 1
    return np.array_equal(np.sort(first * count + second), np.sort(second * count + first))


def _six_volumes(corners: Float64) -> float:
    """Six times the volume inside a closed surface, from the corners of its triangles, shape (n, 3, 3)."""
    return float(np.einsum("tx,tx->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])))


def rest_basis(manifest: CaseManifest, parts: Parts) -> tuple[Float64, Float64] | None:
    """The nodes and the basis that each vertex is tied to, at rest (thesis 9.3.3, equations 9.4 to 9.7).

    Returns
    -------
    positions, basis, or None
        Of the three nodes, mm, float64, shape (vertex_count, 3, 3): node, x. Rows T, N, B, same shape; rows of zeros
        where the nodes lie on one line. None where the grid or the triangles are not sound.
    """
    nodes = parts.get(FileRole.GRID, {}).get("nodes")
    triangle_nodes, geometry = parts.get(FileRole.MAPPING, {}).get("triangle_nodes"), stated(manifest, "grid_geometry")
    if nodes is None or triangle_nodes is None or not isinstance(geometry, Geometry):
        return None
    positions = geometry.index_to_world(nodes - 0.5)[triangle_nodes]
    tangent = _unit(positions[:, 1] - positions[:, 0])
    normal = _unit(np.cross(tangent, positions[:, 2] - positions[:, 0]))
    return positions, np.stack([tangent, normal, np.cross(normal, tangent)], axis=1)


def _unit(vectors: Float64) -> Float64:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: Float64 = np.where(lengths > 1e-9, vectors / np.where(lengths > 1e-9, lengths, 1.0), 0.0)
    return unit


def mapping_problems(manifest: CaseManifest, parts: Parts) -> Iterable[Problem]:
    """The mapping must give back the surface, its normals too, at rest."""
    mapping, surface = parts.get(FileRole.MAPPING, {}), parts.get(FileRole.SURFACE, {})
    weights = mapping.get("weights")
    if weights is not None and len(weights):
        gap = float(np.abs(weights.sum(axis=1, dtype=np.float64) - 1.0).max())
        if gap > WEIGHT_TOLERANCE:
            yield Problem("mapping.weights", f"must sum to one; they miss it by up to {gap:.2g}")
    found = rest_basis(manifest, parts)
    if found is None or not len(found[0]):
        return
    positions, basis = found
    if not np.abs(basis).max(axis=2).all():
        yield Problem("mapping.triangle_nodes", "some are three nodes on one line")
        return
    if weights is not None and "offset" in mapping and "vertices" in surface:
        rest = np.einsum("vi,vix->vx", weights.astype(np.float64), positions)
        rest += np.einsum("vb,vbx->vx", mapping["offset"].astype(np.float64), basis)
        gap = float(np.abs(rest - surface["vertices"]).max())
        if gap > REST_TOLERANCE_MM:
            yield Problem("mapping", f"puts vertices up to {gap:.3g} mm from where the surface has them")
    if "normal" in mapping and "normals" in surface:
        normals = np.einsum("vb,vbx->vx", mapping["normal"].astype(np.float64), basis)
        if np.abs(normals - surface["normals"]).max() > DIRECTION_TOLERANCE:
            yield Problem("mapping.normal", "does not give the normals of the surface at rest")
    if "nearest_node" in mapping and "vertices" in surface:
        yield from _nearest_problems(manifest, parts, positions)


def _nearest_problems(manifest: CaseManifest, parts: Parts, positions: Float64) -> Iterable[Problem]:
    """Each vertex against the nodes of its triangle, a sample of them against all nodes of the boundary."""
    geometry, grid = stated(manifest, "grid_geometry"), parts[FileRole.GRID]
    places = geometry.index_to_world(grid["nodes"] - 0.5)
    vertices = parts[FileRole.SURFACE]["vertices"].astype(np.float64)
    distance = np.linalg.norm(vertices - places[parts[FileRole.MAPPING]["nearest_node"]], axis=1)
    boundary = _boundary_nodes(grid)
    if boundary is None:
        return
    # A vertex may follow a face between cells, with nodes that are not of the boundary.
    is_outer = np.zeros(len(places), np.bool_)
    is_outer[boundary] = True
    least = np.linalg.norm(vertices[:, None] - positions, axis=2)
    least[~is_outer[parts[FileRole.MAPPING]["triangle_nodes"]]] = np.inf
    least = least.min(axis=1)
    outer = places[boundary]
    if len(outer):
        for vertex in np.unique(np.linspace(0, len(vertices) - 1, NEAREST_SAMPLES).astype(int)).tolist():
            least[vertex] = np.linalg.norm(outer - vertices[vertex], axis=1).min()
    if (distance > least + (NEAREST_EXCESS_CELLS + 1e-3) * geometry.spacing_mm[0]).any():
        yield Problem("mapping.nearest_node", "some are far from their vertex, and other nodes are nearer")


def _boundary_nodes(grid: Arrays) -> Int64 | None:
    """Numbers of the nodes that fewer than eight cells share, ascending; None where the grid is not sound."""
    if "cells" not in grid or "nodes" not in grid:
        return None
    try:
        nodes, corners = cell_nodes(grid["cells"])
    except BundleError:
        return None
    if not np.array_equal(nodes, grid["nodes"]):
        return None
    return np.flatnonzero(np.bincount(corners.ravel(), minlength=len(nodes)) < 8)


def picking_problems(manifest: CaseManifest, parts: Parts) -> Iterable[Problem]:
    """The picking surface is the boundary of the cells: its nodes theirs, the volume inside it theirs."""
    picking, grid = parts.get(FileRole.PICKING, {}), parts.get(FileRole.GRID, {})
    numbers, triangles = picking.get("nodes"), picking.get("triangles")
    boundary = _boundary_nodes(grid)
    if numbers is not None and boundary is not None and not np.array_equal(numbers, boundary):
        yield Problem("picking.nodes", "are not the nodes of the cells' boundary, ascending")
    if triangles is None or not len(triangles):
        return
    if not _is_closed(triangles):
        yield Problem("picking.triangles", "leave the surface open: not every edge has a triangle on either side")
    elif numbers is not None and boundary is not None:
        corners = grid["nodes"][numbers][triangles].astype(np.float64)
        if round(_six_volumes(corners - corners[0, 0])) != 6 * len(grid["cells"]):
            yield Problem("picking.triangles", "do not enclose the cells, counter-clockwise from outside")
