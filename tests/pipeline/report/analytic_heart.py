"""A heart of spheres whose shape is known by formula: scan, labels, fields, grid and surface for tests of pictures."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from skimage.measure import marching_cubes

from heartcase.pipeline.data import Scan, Segmentation, SimulationGrid, Structures, Surface
from heartcase.pipeline.mesh.triangles.thickness import vertex_normals
from heartcase.schemas.bundle.lattice import FULL_MOMENTS, cell_nodes
from heartcase.schemas.bundle.surface_kinds import plain_kinds
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable, default_label_table

CAVITIES = {
    1: ((22.0, -12.0, -14.0), (17.0, 17.0, 26.0)),
    2: ((-10.0, -24.0, -10.0), (15.0, 12.0, 22.0)),
    3: ((12.0, 16.0, 24.0), (18.0, 14.0, 14.0)),
    4: ((-26.0, 2.0, 18.0), (14.0, 14.0, 16.0)),
    5: ((2.0, -2.0, 48.0), (9.0, 9.0, 24.0)),
}
"""Cavity -> centre and radii in mm."""


@dataclass(frozen=True)
class AnalyticHeart:
    """Everything that the report wants of a case."""

    scan: Scan
    segmentation: Segmentation
    structures: Structures
    surface: Surface
    grid: SimulationGrid
    table: LabelTable


def ellipsoid_distance(points: np.ndarray, centre: tuple[float, ...], radii: tuple[float, ...]) -> np.ndarray:
    """First-order signed distance to an ellipsoid, exact for a sphere, mm."""
    local = points - np.array(centre)
    scaled = np.linalg.norm(local / np.array(radii), axis=-1)
    slope = np.linalg.norm(local / np.array(radii) ** 2, axis=-1)
    return scaled * (scaled - 1.0) / np.maximum(slope, 1e-9)


def make_heart(*, spacing_mm: tuple[float, float, float] = (2.0, 2.0, 2.0)) -> AnalyticHeart:
    """Five cavities with walls; the left ventricle's is 9 mm of segmented myocardium."""
    table = default_label_table().with_walls()
    size = [int(n / s) for n, s in zip((130.0, 120.0, 160.0), spacing_mm, strict=True)]
    geometry = Geometry.of(shape=tuple(reversed(size)), origin_mm=(-62.0, -62.0, -62.0), spacing_mm=spacing_mm)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1).transpose(2, 1, 0, 3)
    points = geometry.index_to_world(index)
    cavity = {value: ellipsoid_distance(points, *shape) for value, shape in CAVITIES.items()}
    blood = np.minimum.reduce(list(cavity.values()))
    distance = dict(cavity)
    for value, inner in cavity.items():
        wall = 9 if value == 1 else table.wall_value(value)
        thickness = 9.0 if value == 1 else table[value].wall_thickness_mm + 1.0
        distance[wall] = np.maximum(inner - thickness, -blood)
        nearer = [distance[w] for w in distance if w not in cavity and w != wall]
        if nearer:
            distance[wall] = np.maximum(distance[wall], -np.minimum.reduce(nearer))
    distance[0] = -np.minimum.reduce(list(distance.values()))
    fields = {value: distance[value].astype(np.float32) for value in sorted(distance)}
    keys = np.array(list(fields), np.uint8)
    labels = keys[np.argmin(np.stack(list(fields.values())), axis=0)]
    noise = np.random.default_rng(5).normal(0.0, 12.0, labels.shape)
    brightness = np.where(np.isin(labels, table.blood_values), 320.0, np.where(labels > 0, 110.0, -60.0))
    scan = Scan((brightness + noise).astype(np.float32), geometry, "CT")
    structures = Structures(fields, geometry, table, 20.0)
    return AnalyticHeart(
        scan,
        Segmentation(labels, geometry, table),
        structures,
        surface_of(fields, geometry, table),
        grid_of(labels, geometry, table),
        table,
    )


def surface_of(fields: dict[int, np.ndarray], geometry: Geometry, table: LabelTable) -> Surface:
    """Marching cubes of the tissue field, tagged by the nearest void and tissue."""
    tissues = [value for value in fields if value in table.tissue_values]
    voids = [value for value in fields if value not in table.tissue_values]
    tissue = np.minimum.reduce([fields[value] for value in tissues])
    void = np.minimum.reduce([fields[value] for value in voids])
    field = np.pad(0.5 * (tissue - void), 1, constant_values=1.0)
    zyx, triangles, _, _ = marching_cubes(field, 0.0)
    index, triangles = zyx[:, ::-1] - 1.0, triangles[:, ::-1]
    vertices = geometry.index_to_world(index)
    centre = index[triangles].mean(axis=1)[:, ::-1].T
    nearest = {value: map_coordinates(fields[value], centre, order=1, mode="nearest") for value in fields}
    triangle_label = np.array(voids, np.uint8)[np.argmin(np.stack([nearest[v] for v in voids]), axis=0)]
    triangle_tissue = np.array(tissues, np.uint8)[np.argmin(np.stack([nearest[v] for v in tissues]), axis=0)]
    count = len(vertices)
    return Surface(
        vertices_mm=vertices.astype(np.float32),
        triangles=triangles.astype(np.int32),
        triangle_label=triangle_label,
        triangle_tissue=triangle_tissue,
        triangle_is_cut=np.zeros(len(triangles), np.uint8),
        triangle_kind=plain_kinds(triangle_label, triangle_tissue, np.zeros(len(triangles)), table),
        normals=vertex_normals(vertices, triangles).astype(np.float32),
        vertex_label=np.zeros(count, np.uint8),
        table=table,
        render_to_welded=np.arange(count, dtype=np.int32),
        render_triangles=triangles.astype(np.int32),
        render_uv=np.zeros((count, 2), np.float32),
        render_tangents=np.zeros((count, 4), np.float32),
        normal_map=np.zeros((0, 0, 3), np.uint8),
        quality={"triangle_count": len(triangles), "distance_max_mm": 0.12, "open_edge_count": 0},
    )


def grid_of(labels: np.ndarray, geometry: Geometry, table: LabelTable) -> SimulationGrid:
    """One cell per tissue voxel."""
    cells = np.argwhere(np.isin(labels, table.tissue_values))[:, ::-1].astype(np.int32)
    nodes, _ = cell_nodes(cells)
    return SimulationGrid(
        geometry=geometry,
        cells=np.ascontiguousarray(cells),
        cell_coverage=np.ones(len(cells), np.float32),
        cell_moments=np.tile(FULL_MOMENTS, (len(cells), 1)),
        cell_label=labels[tuple(cells[:, ::-1].T)],
        nodes=nodes,
        fixed=np.zeros(len(nodes), np.uint8),
        faces=np.zeros((0, 4), np.int32),
        face_label=np.zeros(0, np.uint8),
        face_cell=np.zeros(0, np.int32),
        table=table,
        quality={"volume_error_percent": 0.4, "betti_tissue": {"full_resolution": [1, 0, 5], "grid": [1, 0, 5]}},
    )
