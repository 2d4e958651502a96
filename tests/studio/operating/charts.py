"""A block whose surface lies in two charts on a normal map, with tangents of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from heartcase.pipeline.bundle.glb import glb_bytes
from heartcase.pipeline.bundle.write_bundle import (
    BundleParts,
    BundleRecord,
    BundleSource,
    assemble_bundle,
    resolve_materials,
    write_bundle,
)
from heartcase.schemas.bundle.format import StageRecord
from heartcase.schemas.recipe.settings import MaterialsSettings
from heartcase.simulator.surface.deform import triangle_basis
from tests.factories import TABLE, block_grid, block_surface


def write_charted(folder):
    """The case, and its surface as it was written."""
    grid = block_grid((8, 5, 4))
    surface, grid_map, picking = block_surface(grid)
    random, count = np.random.default_rng(11), len(surface.vertices_mm)
    welded = np.concatenate([np.arange(count), np.arange(count)]).astype(np.int32)
    is_second = (np.arange(len(surface.triangles)) % 2 == 1)[:, None]
    across = np.cross(surface.normals[welded], random.normal(size=(2 * count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    tangents = np.column_stack([across, random.choice([-1.0, 1.0], 2 * count)]).astype(np.float32)
    positions = grid.node_positions_mm()[grid_map.triangle_nodes]
    basis = triangle_basis(positions[:, 1:] - positions[:, :1])[welded]
    along = np.einsum("vbx,vx->vb", basis, tangents[:, :3])
    surface = replace(
        surface,
        render_to_welded=welded,
        render_triangles=np.where(is_second, count + surface.triangles, surface.triangles).astype(np.int32),
        render_uv=random.uniform(0.05, 0.95, (2 * count, 2)).astype(np.float32),
        render_tangents=tangents,
        normal_map=np.full((16, 16, 3), (200, 128, 200), np.uint8),
    )
    grid_map = replace(grid_map, tangent=np.column_stack([along, tangents[:, 3]]).astype(np.float32))
    stages = (StageRecord(stage="grid", version=1, settings={}, output_sha256="1" * 64),)
    content = assemble_bundle(
        BundleParts(grid=grid, surface=surface, grid_map=grid_map, picking=picking, glbs=(glb_bytes(surface),)),
        resolve_materials(MaterialsSettings(), TABLE),
        BundleSource(geometry=grid.geometry, sha256="0" * 64),
        BundleRecord(name="charted", stages=stages),
    )
    path = folder / "charted.case"
    write_bundle(path, content)
    return path, surface
