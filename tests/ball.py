"""A small scan, a blood-filled ball of muscle, and a recipe for it."""

from __future__ import annotations

import os

import numpy as np

from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.write_images import write_scan
from heartcase.schemas.geometry import Geometry

INNER_MM, OUTER_MM = 14.0, 20.0

RECIPE = """
heartcase_recipe = 1
name = "ball"
{parts}
[scan]
path = "{scan}"
[[labels]]
value = 1
name = "cavity"
role = "blood"
[[labels]]
value = 2
name = "muscle"
role = "myocardium"
[[strokes]]
label = "cavity"
radius_mm = 2.0
points_mm = [[0, 0, 0], [4, 0, 0]]
[[strokes]]
label = "muscle"
radius_mm = 1.0
points_mm = [
    [17, 0, 0], [12, 12, 0], [0, 17, 0], [-12, 12, 0],
    [-17, 0, 0], [-12, -12, 0], [0, -17, 0], [12, -12, 0], [17, 0, 0],
]
[[strokes]]
label = "background"
radius_mm = 2.0
points_mm = [[-28, -28, -28], [28, -28, -28], [28, 28, -28], [28, 28, 28]]
[[pins]]
position_mm = [0, 0, 20]
radius_mm = 8
[grid]
cell_mm = {cell_mm}
[surface]
triangle_count = 2000
normal_map_size = 128
"""


def write_ball_scan(path):
    """Radius 14 mm inside, 20 mm outside, in 2 mm voxels, with a little noise."""
    geometry = Geometry.of(shape=(32, 32, 32), spacing_mm=(2, 2, 2), origin_mm=(-31, -31, -31))
    k, j, i = np.indices(geometry.shape)
    radius = np.linalg.norm(geometry.index_to_world(np.stack([i, j, k], axis=-1)), axis=-1)
    values = np.where(radius < INNER_MM, 1000.0, np.where(radius < OUTER_MM, 400.0, 100.0))
    values += np.random.Generator(np.random.PCG64(1)).normal(0, 10, values.shape)
    write_scan(Scan(values.astype(np.float32), geometry, "MR"), path)


def write_ball_recipe(scan, path, *, cell_mm=4.0, parts="", more="", surface=""):
    """Write the recipe for a scan of the ball; ``more`` is appended, ``surface`` put among the surface's settings."""
    path.parent.mkdir(exist_ok=True)
    relative = os.path.relpath(scan, path.parent)
    text = RECIPE.format(scan=relative, cell_mm=cell_mm, parts=parts) + more
    path.write_text(text.replace("[surface]\n", f"[surface]\n{surface}"))
    return path
