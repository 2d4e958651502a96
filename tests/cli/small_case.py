"""A small scan and a small case on disk for the tests of the command line."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import SimpleITK
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from heartcase.pipeline.bundle.write_bundle import (
    BundleParts,
    BundleRecord,
    BundleSource,
    assemble_bundle,
    write_bundle,
)
from heartcase.pipeline.data import GridMap, SimulationGrid, Surface
from heartcase.pipeline.warnings import CaseWarning, worst_first
from heartcase.schemas.bundle.format import Material
from heartcase.simulator.lattice.model import make_model
from tests.pipeline.report.analytic_heart import AnalyticHeart, make_heart

SCAN_DIRECTION = Rotation.from_euler("x", 10.0, degrees=True).as_matrix() @ np.array(
    [[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
)
"""Axes to the right, to the head and to the back, tilted by ten degrees about the patient's left-right axis."""


def write_scan(path: Path) -> Path:
    """An oblique, anisotropic scan of 12 x 10 x 8 voxels with a bright block."""
    values = np.random.default_rng(1).normal(50.0, 5.0, (8, 10, 12)).astype(np.float32)
    values[2:6, 3:7, 4:8] += 100.0
    image = SimpleITK.GetImageFromArray(values)
    image.SetSpacing((1.0, 1.5, 2.5))
    image.SetOrigin((5.0, -7.0, 11.0))
    image.SetDirection(SCAN_DIRECTION.ravel().tolist())
    SimpleITK.WriteImage(image, str(path))
    return path


def tied_to(grid: SimulationGrid, surface: Surface) -> GridMap:
    """Each vertex hangs on three corners of the nearest cell, exactly where it is."""
    model = make_model(grid.cells, geometry=grid.geometry)
    places = model.geometry.index_to_world(model.node_index - 0.5)
    _, nearest = cKDTree(places[model.cell_corners].mean(axis=1)).query(surface.vertices_mm)
    corners = model.cell_corners[nearest][:, [0, 1, 3]]
    p1, p2, p3 = (places[corners[:, n]] for n in range(3))
    tangent = (p2 - p1) / np.linalg.norm(p2 - p1, axis=1, keepdims=True)
    normal = np.cross(tangent, p3 - p1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    basis = np.stack([tangent, normal, np.cross(normal, tangent)], axis=1)
    count = len(surface.vertices_mm)
    return GridMap(
        triangle_nodes=corners.astype(np.int32),
        weights=np.tile(np.float32([1, 0, 0]), (count, 1)),
        offset_mm=np.einsum("vij,vj->vi", basis, surface.vertices_mm - p1).astype(np.float32),
        normal=np.einsum("vij,vj->vi", basis, surface.normals).astype(np.float32),
        curvature=np.zeros(count, np.uint8),
        tangent=np.zeros((len(surface.render_to_welded), 4), np.float32),
        nearest_node=corners[:, 0].astype(np.int32),
        levels=tuple(tied_to(grid, level) for level in surface.levels),
    )


def write_case(
    directory: Path,
    *,
    with_level: bool = False,
    with_map: bool = False,
    warnings: Sequence[CaseWarning] = (CaseWarning("a warning for the reader"),),
) -> tuple[Path, AnalyticHeart]:
    """A case with a grid and a surface, and where asked for a coarser level of it and what ties both to the grid."""
    heart = make_heart(spacing_mm=(3.0, 3.0, 3.0))
    coarse = (make_heart(spacing_mm=(5.0, 5.0, 5.0)).surface,) if with_level else ()
    surface = replace(heart.surface, levels=coarse)
    tied = tied_to(heart.grid, surface) if with_map else None
    content = assemble_bundle(
        BundleParts(grid=heart.grid, surface=surface, grid_map=tied),
        [Material(label=v, youngs_modulus_kpa=30, density_kg_m3=1060) for v in heart.table.tissue_values],
        BundleSource(geometry=heart.scan.geometry, sha256="0" * 64, modality="CT"),
        BundleRecord(
            name="Toy",
            quality={"volumes_ml": {"morphologically left ventricle": 33.0}},
            warnings=worst_first(warnings),
        ),
    )
    path = directory / "Toy.case"
    write_bundle(path, content)
    return path, heart
