"""The rim of a defect, felt out on a plate of some thickness with a round hole: both edges are known."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.landmarks import Landmark
from heartcase.simulator.incisions.rim import defect_rim
from heartcase.simulator.incisions.triangle_tree import triangle_tree
from tests.simulator.incisions.scenes import AROUND, circle, plate

HOLE = 5.0
THICK = 4.0


def thick_plate(hole=HOLE):
    """A plate from z = -2 to z = 2 with a hole: both faces and the hole's wall."""
    upper, faces = plate(hole, z=THICK / 2, outer=60.0)
    lower, _ = plate(hole, z=-THICK / 2, outer=60.0)
    count = len(upper)
    here = np.arange(AROUND)
    after = (here + 1) % AROUND
    wall = np.concatenate(
        [np.stack([here, after, here + count], 1), np.stack([after, after + count, here + count], axis=1)]
    )
    return triangle_tree(np.concatenate([upper, lower]), np.concatenate([faces, faces + count, wall]))


def ring(axis=(0.0, 0.0, 1.0), middle=(0.0, 0.0, 0.0), radius=HOLE):
    return Landmark(name="hole", kind="ring", points_mm=(middle,), axis=axis, radius_mm=radius)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
def test_the_rim_is_the_edge_on_the_side_of_the_incision(side, axis):
    found = defect_rim(thick_plate(), ring(axis), (3.0, 40.0, 30.0 * side))
    assert found.part_found == 1.0
    # Slices are a quarter of a millimetre apart.
    assert found.points_mm[:, 2] == pytest.approx(np.full(72, side * THICK / 2), abs=0.26)
    assert np.linalg.norm(found.points_mm[:, :2], axis=1) == pytest.approx(np.full(72, HOLE), abs=0.01)


def test_a_ring_of_points_is_the_rim_as_it_is():
    points = circle(3.0, count=8)
    mark = Landmark(name="hole", kind="ring", points_mm=tuple(tuple(point) for point in points.tolist()))
    assert np.array_equal(defect_rim(thick_plate(), mark, (0.0, 0.0, 9.0)).points_mm, points)


def test_where_there_is_no_hole_it_is_said():
    with pytest.raises(SimulationError, match=r"the surface has no hole of 10.0 mm at hole"):
        defect_rim(thick_plate(hole=15.0), ring(), (0.0, 0.0, 9.0))
    with pytest.raises(SimulationError, match=r"hole is no ring"):
        defect_rim(thick_plate(), Landmark(name="hole", kind="point", points_mm=((0.0, 0.0, 0.0),)), (0.0, 0.0, 9.0))
