"""Small, complete inputs made by hand for the tests."""

from __future__ import annotations

import numpy as np

from heartcase.pipeline.bundle.write_bundle import (
    BundleContent,
    BundleParts,
    BundleRecord,
    BundleSource,
    assemble_bundle,
    resolve_materials,
)
from heartcase.pipeline.data import GridMap, PickingSurface, SimulationGrid, Surface
from heartcase.schemas.bundle.format import StageRecord
from heartcase.schemas.bundle.lattice import FULL_MOMENTS, cell_nodes
from heartcase.schemas.bundle.surface_kinds import SurfaceKind
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable, default_label_table
from heartcase.schemas.recipe.settings import MaterialsSettings

TABLE: LabelTable = default_label_table().with_walls()
MYOCARDIUM = 9

# Corner numbers of a cell's six faces, counter-clockwise from outside, with the step to the neighbour.
_FACES = (
    ((-1, 0, 0), (0, 4, 6, 2)),
    ((1, 0, 0), (1, 3, 7, 5)),
    ((0, -1, 0), (0, 1, 5, 4)),
    ((0, 1, 0), (2, 6, 7, 3)),
    ((0, 0, -1), (0, 2, 3, 1)),
    ((0, 0, 1), (4, 5, 7, 6)),
)


def block_grid(size=(3, 2, 2), *, cell_mm=3.0, fixed_layer=True, geometry: Geometry | None = None) -> SimulationGrid:
    """A solid block of full cells; the nodes with the lowest k are fixed."""
    ni, nj, nk = size
    cells = np.array([(i, j, k) for k in range(nk) for j in range(nj) for i in range(ni)], np.int32)
    return grid_of_cells(cells, size, cell_mm=cell_mm, fixed_layer=fixed_layer, geometry=geometry)


def grid_of_cells(cells, size, *, cell_mm=3.0, fixed_layer=True, geometry: Geometry | None = None) -> SimulationGrid:
    """Full cells, shape (cell_count, 3), within a box of so many; the nodes with the lowest k are fixed."""
    ni, nj, nk = size
    nodes, corners = cell_nodes(cells)
    inside = {tuple(c) for c in cells.tolist()}
    faces, owners = [], []
    for number, cell in enumerate(cells.tolist()):
        for step, face in _FACES:
            if tuple(np.add(cell, step)) not in inside:
                faces.append(corners[number][list(face)])
                owners.append(number)
    count = len(cells)
    return SimulationGrid(
        geometry=geometry or Geometry.of(shape=(nk, nj, ni), spacing_mm=(cell_mm,) * 3, origin_mm=(10, -20, 30)),
        cells=cells,
        cell_coverage=np.ones(count, np.float32),
        cell_moments=np.tile(FULL_MOMENTS, (count, 1)),
        cell_label=np.full(count, MYOCARDIUM, np.uint8),
        nodes=nodes,
        fixed=((nodes[:, 2] == 0) & fixed_layer).astype(np.uint8),
        faces=np.array(faces, np.int32),
        face_label=np.zeros(len(faces), np.uint8),
        face_cell=np.array(owners, np.int32),
        table=TABLE,
    )


def block_surface(grid: SimulationGrid, normals=None) -> tuple[Surface, GridMap, PickingSurface]:
    """The block's own boundary as the visible surface, tied to the grid node by node.

    Normals point away from its middle where no others are given, those of its nodes in ascending order.
    """
    nodes, numbers = np.unique(grid.faces, return_inverse=True)
    quads = numbers.reshape(-1, 4).astype(np.int32)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    positions = grid.node_positions_mm()[nodes].astype(np.float32)
    if normals is None:
        outward = positions - positions.mean(axis=0)
        normals = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    normals = np.asarray(normals, np.float32)
    count, triangle_count = len(nodes), len(triangles)
    surface = Surface(
        vertices_mm=positions,
        triangles=triangles,
        triangle_label=np.zeros(triangle_count, np.uint8),
        triangle_tissue=np.full(triangle_count, MYOCARDIUM, np.uint8),
        triangle_is_cut=np.zeros(triangle_count, np.uint8),
        triangle_kind=np.full(triangle_count, SurfaceKind.EPICARDIUM, np.uint8),
        normals=normals,
        vertex_label=np.zeros(count, np.uint8),
        table=TABLE,
        render_to_welded=np.arange(count, dtype=np.int32),
        render_triangles=triangles,
        render_uv=np.zeros((count, 2), np.float32),
        render_tangents=np.zeros((count, 4), np.float32),
        normal_map=np.zeros((0, 0, 3), np.uint8),
    )
    first = {}
    for triangle in triangles:
        for turn in range(3):
            first.setdefault(int(triangle[turn]), np.roll(triangle, -turn))
    corners = np.array([first[v] for v in range(count)])
    p1, p2, p3 = (positions[corners[:, n]].astype(float) for n in range(3))
    tangent = (p2 - p1) / np.linalg.norm(p2 - p1, axis=1, keepdims=True)
    other = (p3 - p1) / np.linalg.norm(p3 - p1, axis=1, keepdims=True)
    normal = np.cross(tangent, other)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    bitangent = np.cross(normal, tangent)
    basis = np.stack([tangent, normal, bitangent], axis=1)
    grid_map = GridMap(
        triangle_nodes=nodes[corners].astype(np.int32),
        weights=np.tile(np.float32([1, 0, 0]), (count, 1)),
        offset_mm=np.zeros((count, 3), np.float32),
        normal=np.einsum("vij,vj->vi", basis, normals).astype(np.float32),
        curvature=np.zeros(count, np.uint8),
        tangent=np.zeros((count, 4), np.float32),
        nearest_node=nodes.astype(np.int32),
    )
    picking = PickingSurface(
        nodes=nodes.astype(np.int32), triangles=triangles, triangle_label=np.zeros(triangle_count, np.uint8)
    )
    return surface, grid_map, picking


def block_case(name="block", size=(3, 2, 2), scan=None, **options) -> BundleContent:
    """A whole case of the block."""
    grid = block_grid(size, **options)
    surface, grid_map, picking = block_surface(grid)
    return assemble_bundle(
        BundleParts(grid=grid, surface=surface, grid_map=grid_map, picking=picking, scan=scan),
        resolve_materials(MaterialsSettings(), TABLE),
        BundleSource(geometry=grid.geometry, sha256="0" * 64),
        BundleRecord(name=name, stages=(StageRecord(stage="grid", version=1, settings={}, output_sha256="1" * 64),)),
    )
