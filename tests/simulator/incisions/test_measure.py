"""All figures of an incision together, in a scene that is a formula: a hole in a plate, moved and stretched."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.landmarks import Landmark
from heartcase.simulator.incisions.measure import IncisionPlan, Scene, measured
from heartcase.simulator.incisions.surgical_freedom import Shaft
from heartcase.simulator.incisions.visibility import View
from tests.simulator.incisions.scenes import circle, cone_sr, plate
from tests.simulator.lattices import block

UP = (0.0, 0.0, 1.0)


def scene(hole: float, lifted_mm: float, *, opening=True) -> Scene:
    """A plate 20 mm above the defect, which goes up with all that is on it; and a lattice that is stretched."""
    model = block(4, 3, 3)
    vertices, triangles = plate(hole, z=20.0)
    # The defect has a vertex of its own that carries it, too small to hide anything.
    vertices = np.concatenate([vertices, [[0.0, 0, 0], [1e-6, 0, 0], [0, 1e-6, 0]]])
    triangles = np.concatenate([triangles, [np.arange(3) + len(vertices) - 3]])
    now = vertices + np.array([0.0, 0.0, lifted_mm])
    artery = Landmark(name="artery", kind="polyline", points_mm=((30.0, -50, 20), (30, 50, 20)), radius_mm=2.0)
    return Scene(
        model=model,
        displacement=model.node_index * np.array([0.2, 0.0, 0.0]),
        rest_mm=vertices,
        now_mm=now,
        triangles=triangles,
        landmarks=(artery,),
        opening_mm=circle(hole, 20.0 + lifted_mm) if opening else None,
    )


PLAN = IncisionPlan(
    name="plate",
    curve_mm=np.array([[-10.0, 0, 20], [0, 0, 20], [10, 0, 20]]),
    rim_mm=circle(4.0, count=40),
    view=View(UP, half_angle_deg=20.0, distance_mm=300.0, eye_count=50, stop_short_mm=0.0),
    shaft=Shaft(UP, half_angle_deg=60.0, length_mm=80.0, radius_mm=0.0, direction_count=3000),
    depth_mm=10.0,
)


def test_all_figures_of_an_incision():
    found = measured(PLAN, scene(10.0, 7.0), retraction_n=1.5, stitch_forces_n=(0.5, 1.0), spacing_mm=1.0)
    assert found.rim_seen == 1.0
    assert found.freedom_mm3 == pytest.approx(cone_sr(np.arctan(0.5)) * 80.0**3 / 3, rel=0.02)
    assert found.stretch == pytest.approx(1.2)
    assert found.stress_kpa > 0.0
    # Nothing is cut in the plate: its line is as near as a cut along it would be.
    assert found.nearest_mm == {"artery": pytest.approx(18.0)}
    assert (found.cut_mm2, found.inverted_cell_count) == (None, 0)
    assert found.length_mm == pytest.approx(20.0)
    assert found.retraction_n == 1.5
    assert [one.force_n for one in found.stitches] == [0.5, 1.0]
    assert found.reach_mm3 == pytest.approx(2 / 3 * np.pi * 10.0**3, rel=0.03)
    assert measured(PLAN, scene(10.0, 7.0), spacing_mm=1.0).freedom_mm3 == found.freedom_mm3


def test_before_the_cut_nothing_is_seen_or_reached():
    closed = scene(1e-3, 0.0, opening=False)
    found = measured(PLAN, closed)
    assert (found.rim_seen, found.solid_angle_sr, found.freedom_mm3) == (0.0, 0.0, 0.0)
    assert found.reach_mm3 is None
    assert found.retraction_n is None
