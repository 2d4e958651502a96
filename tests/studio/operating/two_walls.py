"""A block of two walls, of which the surface knows one alone: a cut shows the other."""

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

WALL, INNER = 9, 13
"""Labels of the halves of the block, below and above x = 20.5 mm; the surface knows the first alone."""


def two_walls(source=None, *, landmarks=(), ends=()):
    """A block of 8 x 5 x 4 cells of 3 mm on a fixed base: x 8.5 to 32.5, y -21.5 to -6.5, z 28.5 to 40.5 mm."""
    grid = block_grid((8, 5, 4))
    grid = replace(grid, cell_label=np.where(grid.cells[:, 0] < 4, WALL, INNER).astype(np.uint8))
    surface, grid_map, picking = block_surface(grid)
    parts = BundleParts(grid=grid, surface=surface, grid_map=grid_map, picking=picking)
    settings = {"ends": list(ends)}
    stages = (StageRecord(stage="walls", version=1, settings=settings, output_sha256="1" * 64),)
    source = source or BundleSource(geometry=grid.geometry, sha256="0" * 64)
    record = BundleRecord(name="two walls", stages=stages, landmarks=landmarks)
    return assemble_bundle(parts, resolve_materials(MaterialsSettings(), TABLE), source, record)


def write_two_walls(folder):
    write_bundle(folder / "two.case", two_walls())
    return folder / "two.case"
