"""A block that is a box of twelve triangles at a coarser level of detail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

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
from tests.factories import TABLE, block_grid, block_surface

SIDES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
"""Corners of a box, counter-clockwise from outside; bit a of a corner's number is its side along axis a."""


def write_block_with_a_box(folder):
    """A block of 8 x 5 x 4 cells of 3 mm, and the same as a box."""
    grid = block_grid((8, 5, 4))
    surface, grid_map, picking = block_surface(grid)
    places = surface.vertices_mm
    low, high = places.min(axis=0), places.max(axis=0)
    corners = [np.where([n & 1, n & 2, n & 4], high, low) for n in range(8)]
    picked = [int(np.abs(places - corner).sum(axis=1).argmin()) for corner in corners]
    quads = np.array(SIDES, np.int32)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    per_triangle = ("triangle_label", "triangle_tissue", "triangle_is_cut", "triangle_kind")
    box = replace(
        surface,
        vertices_mm=places[picked],
        triangles=triangles,
        normals=surface.normals[picked],
        vertex_label=surface.vertex_label[picked],
        render_to_welded=np.arange(8, dtype=np.int32),
        render_triangles=triangles,
        render_uv=surface.render_uv[:8],
        render_tangents=surface.render_tangents[:8],
        **{name: getattr(surface, name)[:12] for name in per_triangle},
    )
    per_vertex = ("triangle_nodes", "weights", "offset_mm", "normal", "curvature", "tangent", "nearest_node")
    tie = replace(grid_map, **{name: getattr(grid_map, name)[picked] for name in per_vertex})
    stages = (StageRecord(stage="grid", version=1, settings={}, output_sha256="1" * 64),)
    content = assemble_bundle(
        BundleParts(
            grid=grid,
            surface=replace(surface, levels=(box,)),
            grid_map=replace(grid_map, levels=(tie,)),
            picking=picking,
        ),
        resolve_materials(MaterialsSettings(), TABLE),
        BundleSource(geometry=grid.geometry, sha256="0" * 64),
        BundleRecord(name="block", stages=stages),
    )
    path = folder / "block.case"
    write_bundle(path, content)
    return path
