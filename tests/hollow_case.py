"""A box of cells with two rooms and a hole in the wall between them: what is seen through an incision of its lid."""

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
from heartcase.pipeline.mesh.triangles.thickness import vertex_normals
from heartcase.schemas.bundle.format import StageRecord
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.settings import MaterialsSettings
from tests.factories import TABLE, block_surface, grid_of_cells

SIZE = (12, 10, 8)
CELL_MM = 3.0
WALL = 3
"""Layer of the wall between the rooms."""
HOLE = (slice(4, 8), slice(3, 7))
"""Its hole."""


def hollow_case(name="hollow") -> BundleContent:
    """The case: a planned incision ``lid`` along the middle of the lid, the ring ``hole``, and a vessel on the lid."""
    is_tissue = np.ones(SIZE, bool)
    is_tissue[1:-1, 1:-1, 1:-1] = False
    is_tissue[:, :, WALL] = True
    is_tissue[(*HOLE, WALL)] = False
    cells = np.argwhere(is_tissue).astype(np.int32)
    cells = cells[np.lexsort(cells.T)]
    grid = grid_of_cells(cells, SIZE, cell_mm=CELL_MM)
    bare = block_surface(grid)[0]
    normals = vertex_normals(bare.vertices_mm, bare.triangles)
    surface, grid_map, picking = block_surface(grid, normals)

    def at(i: float, j: float, k: float) -> tuple[float, float, float]:
        x, y, z = (grid.geometry.index_to_world(np.array([i, j, k], float) - 0.5)).tolist()
        return x, y, z

    top = SIZE[2]
    low, high = (HOLE[0].start, HOLE[1].start), (HOLE[0].stop, HOLE[1].stop)
    ring = [at(low[0], low[1], WALL + 1), at(high[0], low[1], WALL + 1), at(high[0], high[1], WALL + 1)]
    ring.append(at(low[0], high[1], WALL + 1))
    middle = 0.5 * SIZE[1] + 0.1
    landmarks = (
        Landmark(
            name="lid",
            kind="polyline",
            points_mm=tuple(at(i, middle, top) for i in (2.6, 4.3, 6.1, 7.8, 9.4)),
            depth_mm=1.6 * CELL_MM,
        ),
        Landmark(name="hole", kind="ring", points_mm=tuple(ring)),
        Landmark(name="vessel", kind="polyline", points_mm=(at(2, 9, top), at(10, 9, top)), radius_mm=1.0),
    )
    return assemble_bundle(
        BundleParts(grid=grid, surface=surface, grid_map=grid_map, picking=picking),
        resolve_materials(MaterialsSettings(), TABLE),
        BundleSource(geometry=grid.geometry, sha256="0" * 64),
        BundleRecord(
            name=name,
            stages=(StageRecord(stage="grid", version=1, settings={}, output_sha256="1" * 64),),
            landmarks=landmarks,
        ),
    )
