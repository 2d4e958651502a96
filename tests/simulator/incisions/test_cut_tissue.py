"""What was cut at rest: its area as a whole and by tissue, and how near it comes to a vessel."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.geometry import Geometry
from heartcase.schemas.landmarks import Landmark
from heartcase.simulator.incisions.cut_tissue import CellTissues, area_by_tissue_mm2, area_mm2, cut_triangles
from heartcase.simulator.incisions.held_open import ShownHeart
from heartcase.simulator.incisions.measure import Scene
from heartcase.simulator.incisions.nearness import to_vessels
from heartcase.simulator.simulation import Simulation
from tests.simulator.surface_splitting.surfaces import block, box, hung

CELL_MM = 2.0
GEOMETRY = Geometry.of(shape=(4, 4, 6), origin_mm=(1.0, 1.0, 1.0), spacing_mm=(CELL_MM,) * 3)


def tissues() -> CellTissues:
    """A block of 12 x 8 x 8 mm whose half below x = 6 mm is muscle, the other scar."""
    cells = np.argwhere(np.ones((6, 4, 4), bool)).astype(np.int32)
    labels = np.where(cells[:, 0] < 3, 11, 12).astype(np.uint8)
    return CellTissues(GEOMETRY, cells, labels, {11: "muscle", 12: "scar"})


def sheet(y: float, x: float, z: float) -> np.ndarray:
    """Both walls of a cut at right angles to y, from x = 0 to x and from z = 0 to z."""
    a, b, c, d = np.array([[0.0, y, 0], [x, y, 0], [x, y, z], [0, y, z]])
    wall = np.array([[a, b, c], [a, c, d]])
    return np.concatenate([wall, wall[:, ::-1]])


def test_the_area_of_a_cut_is_that_of_one_of_its_walls_and_is_shared_by_the_tissues():
    walls = sheet(3.0, 10.0, 7.0)
    assert area_mm2(walls) == pytest.approx(70.0)
    found = area_by_tissue_mm2(walls, tissues())
    assert list(found) == ["muscle", "scar"]
    # Pieces go whole to the cell that their middle lies in.
    assert found["muscle"] == pytest.approx(42.0, rel=0.03)
    assert sum(found.values()) == pytest.approx(70.0)
    assert area_by_tissue_mm2(walls[:0], tissues()) == {}


def test_walls_a_little_outside_of_the_cells_count_with_the_nearest_cell():
    assert area_by_tissue_mm2(sheet(-0.5, 4.0, 4.0), tissues()) == {"muscle": pytest.approx(16.0)}


@pytest.mark.parametrize("count", [1, 2])
def test_every_cut_of_a_block_counts_however_deep_it_goes(count):
    model = block((8, 6, 6))
    edge = model.cell_mm
    size = np.array([8, 6, 6]) * edge
    simulation = Simulation(model, surface=hung(model, *box((8, 6, 6), np.array((8.0, 6.0, 6.0)))))
    for number in range(count):
        x = (2.5 + 3.0 * number) * edge
        simulation.cut(
            [[(x, -5.0, -5.0), (x, -5.0, size[2] + 5.0)], [(x, 2.5 * edge, -5.0), (x, 2.5 * edge, size[2] + 5.0)]]
        )
    split = simulation.split
    heart = ShownHeart.of(split.surface, simulation.surface_now(), split.triangle_is_cut_face)
    scene = Scene(
        simulation.model,
        simulation.state.displacement,
        heart.rest_mm,
        heart.now_mm,
        heart.triangles,
        is_cut_face=heart.is_cut_face,
    )
    assert area_mm2(scene.cut_mm) == pytest.approx(count * 2.5 * edge * size[2], rel=1e-3)
    x = (2.5 + 3.0 * (count - 1)) * edge
    deep = Landmark(
        name="deep", kind="polyline", points_mm=((x, 4.0 * edge, 0.0), (x, 4.0 * edge, size[2])), radius_mm=0.5
    )
    assert to_vessels(scene.cut_mm, [deep])[0].distance_mm == pytest.approx(1.5 * edge - 0.5, abs=1e-3)


def test_only_walls_of_cuts_are_taken():
    rest = np.arange(18.0).reshape(6, 3)
    walls = cut_triangles(rest, np.array([[0, 1, 2], [3, 4, 5]]), np.array([False, True]))
    np.testing.assert_array_equal(walls, [rest[3:]])
