"""The same bytes from labels to mapping with one thread and with two."""

import numba
import numpy as np
import pytest

from heartcase.pipeline.artifacts.serialise import artifact_to_bytes
from heartcase.pipeline.cells.build_grid import build_grid
from heartcase.pipeline.cells.map_surface import map_surface
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.kernels.parallel import side_by_side
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.mesh.decimation import collapse
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import EndMarker, GridSettings, MapSettings, SurfaceSettings, WallsSettings

TABLE = LabelTable(
    labels=(
        Label(value=1, name="left ventricle", role=Role.BLOOD, wall_thickness_mm=2.0),
        Label(value=2, name="right ventricle", role=Role.BLOOD, wall_thickness_mm=2.0),
        Label(value=3, name="aorta", role=Role.VESSEL_LUMEN, wall_thickness_mm=1.5),
        Label(value=9, name="myocardium", role=Role.MYOCARDIUM),
    )
)


def segmentation() -> Segmentation:
    """Two ventricles that share a wall of muscle, and a vessel that is cut off."""
    geometry = Geometry.of(shape=(40, 36, 44), origin_mm=(-26.0, -21.0, -23.0), spacing_mm=(1.2, 1.2, 1.2))
    k, j, i = np.indices(geometry.shape)
    p = geometry.index_to_world(np.stack([i, j, k], axis=-1).astype(float))
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    labels = np.zeros(geometry.shape, np.uint8)
    labels[(x + 6.0) ** 2 + y**2 + z**2 < 14.0**2] = 9
    labels[(x - 7.0) ** 2 + y**2 + z**2 < 8.0**2] = 2
    labels[(x + 7.0) ** 2 + y**2 + z**2 < 7.0**2] = 1
    labels[((x + 7.0) ** 2 + y**2 < 3.5**2) & (z > 5.0) & (z < 18.0)] = 3
    return Segmentation(labels, geometry, TABLE)


def chain() -> dict[str, bytes]:
    end = EndMarker(label="aorta", position_mm=(-7.0, 0.0, 16.0), axis=(0.0, 0.0, 1.0), radius_mm=7.0)
    structures = grow_walls(segmentation(), WallsSettings(), [end])
    settings = SurfaceSettings(triangle_count=6000, level_counts=(2000,), normal_map_size=256)
    surface, grid = side_by_side(
        lambda: build_surface(structures, settings), lambda: build_grid(structures, GridSettings(node_count=4000))
    )
    mapped = map_surface(surface, grid, structures, MapSettings())
    outputs = {"walls": structures, "surface": surface, "grid": grid, "map": mapped}
    return {name: artifact_to_bytes(output) for name, output in outputs.items()}


@pytest.mark.parametrize("part_triangles", [collapse.PART_TRIANGLES, 2000])
def test_one_and_two_threads_give_the_same_bytes(monkeypatch, part_triangles):
    # so small a mesh would be swept in one part
    monkeypatch.setattr(collapse, "PART_TRIANGLES", part_triangles)
    before = numba.get_num_threads()
    found = []
    try:
        for threads in (1, min(2, before)):
            numba.set_num_threads(threads)
            found.append(chain())
    finally:
        numba.set_num_threads(before)
    for name, one in found[0].items():
        assert one == found[1][name], name
