"""What is seen and reached through a hole in a plate: formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.incisions.directions import cone_directions, divided, patches, points_in
from heartcase.simulator.incisions.surgical_freedom import Shaft, freedom_at_target_mm3, reach
from heartcase.simulator.incisions.triangle_tree import triangle_tree
from heartcase.simulator.incisions.visibility import View, visibility
from tests.simulator.incisions.scenes import circle, cone_sr, plate

UP = (0.0, 0.0, 1.0)
ON_AXIS = View(UP, half_angle_deg=0.01, distance_mm=100.0, eye_count=1, spacing_mm=0.25, stop_short_mm=0.0)


def test_a_disc_behind_a_wide_hole_is_seen_whole():
    found = visibility(triangle_tree(*plate(20.0, z=30.0)), circle(10.0), ON_AXIS)
    assert found.rim_seen == 1.0
    assert found.rim_seen_mean == pytest.approx(1.0)
    assert found.solid_angle_sr == pytest.approx(cone_sr(np.arctan(10.0 / 100.0)), rel=1e-3)
    np.testing.assert_allclose(found.best_direction, UP, atol=1e-3)


def test_a_disc_behind_a_narrow_hole_looks_as_large_as_the_hole_and_its_rim_is_hidden():
    found = visibility(triangle_tree(*plate(4.0, z=30.0)), circle(10.0), ON_AXIS)
    assert found.rim_seen == 0.0
    assert found.solid_angle_sr == pytest.approx(cone_sr(np.arctan(4.0 / 70.0)), rel=0.02)


def test_a_disc_that_is_half_covered_is_half_seen():
    vertices = np.array([[0.0, -99, 30], [0, 99, 30], [99, 0, 30]])
    found = visibility(triangle_tree(vertices, [[0, 1, 2]]), circle(10.0), ON_AXIS)
    assert found.rim_seen_best == pytest.approx(0.5, abs=0.01)
    assert found.solid_angle_sr == pytest.approx(cone_sr(np.arctan(0.1)) / 2, rel=0.02)
    assert (found.pieces_mm[found.is_seen][:, 0] <= 0.05).all()


def test_another_eye_sees_what_one_cannot():
    """Looked at from all around, the two halves are seen from two sides."""
    vertices = np.array([[0.0, -99, 30], [0, 99, 30], [99, 0, 30]])
    found = visibility(triangle_tree(vertices, [[0, 1, 2]]), circle(5.0), View(UP, 40.0, 100.0, 100, stop_short_mm=0.0))
    assert found.rim_seen == 1.0
    assert 0.3 < found.rim_seen_mean < 0.7


def test_the_directions_from_which_the_middle_is_seen_are_a_cone():
    view = View(UP, half_angle_deg=60.0, distance_mm=300.0, eye_count=4000, spacing_mm=5.0)
    found = visibility(triangle_tree(*plate(10.0, z=20.0)), circle(1.0), view)
    assert found.middle_seen_sr == pytest.approx(cone_sr(np.arctan(10.0 / 20.0)), rel=0.01)


def test_nothing_is_seen_through_a_closed_wall_and_all_where_nothing_is():
    view = View(UP, half_angle_deg=30.0, distance_mm=50.0, eye_count=20)
    wall = np.array([[-500.0, -500, 10], [500, -500, 10], [0, 900, 10]])
    hidden = visibility(triangle_tree(wall, [[0, 1, 2]]), circle(5.0), view)
    assert (hidden.rim_seen, hidden.solid_angle_sr, hidden.middle_seen_sr) == (0.0, 0.0, 0.0)
    free = visibility(triangle_tree(np.zeros((0, 3)), np.zeros((0, 3), int)), circle(5.0), view)
    assert free.rim_seen_mean == pytest.approx(1.0)
    assert free.middle_seen_sr == pytest.approx(cone_sr(np.pi / 6))


def test_a_rim_that_lies_in_the_surface_is_seen_where_sight_stops_short():
    vertices, triangles = plate(10.0)
    tree = triangle_tree(vertices, triangles)
    assert (
        visibility(tree, vertices[: len(vertices) // 2], View(UP, 20.0, 100.0, 10, stop_short_mm=0.5)).rim_seen == 1.0
    )


@pytest.mark.parametrize("radius", [0.0, 3.0])
def test_freedom_at_a_target_under_a_hole_is_a_cone(radius):
    """The shaft leans until its side meets the hole's edge: a cos(x) - h sin(x) = r."""
    hole, depth, length = 10.0, 25.0, 80.0
    lean = np.arctan2(hole, depth) - np.arcsin(radius / np.hypot(hole, depth))
    shaft = Shaft(UP, half_angle_deg=50.0, length_mm=length, radius_mm=radius, direction_count=6000)
    found = freedom_at_target_mm3(triangle_tree(*plate(hole, z=depth)), (0, 0, 0), shaft, tip_free_mm=5.0)
    assert found == pytest.approx(cone_sr(lean) * length**3 / 3, rel=0.01)


@pytest.mark.parametrize(("lean", "radius"), [(25.0, 0.0), (40.0, 0.0), (5.0, 2.0)])
def test_a_shaft_reaches_a_widening_cone_under_a_hole(lean, radius):
    """A shaft of a radius that hardly leans passes where its axis is a radius away from the hole's edge."""
    hole, depth = 6.0, 15.0
    shaft = Shaft(UP, half_angle_deg=lean, length_mm=60.0, radius_mm=radius)
    found = reach(triangle_tree(*plate(hole)), circle(hole), shaft, depth_mm=depth, spacing_mm=0.75, gate_count=1000)

    def area(z):
        return np.pi * min(hole - radius + z * np.tan(np.radians(lean)), np.sqrt(depth**2 - z**2)) ** 2

    assert found.volume_mm3 == pytest.approx(quad(area, 0.0, depth, limit=200)[0], rel=0.03)
    assert (found.tips_mm[:, 2] < 0.0).all()


def test_a_shaft_that_is_too_thick_reaches_nothing():
    shaft = Shaft(UP, half_angle_deg=40.0, length_mm=60.0, radius_mm=5.5, direction_count=100)
    assert reach(triangle_tree(*plate(5.0)), circle(5.0), shaft, depth_mm=10.0).volume_mm3 == 0.0


def test_directions_are_even_and_within_the_cone():
    directions = cone_directions((1.0, 2.0, -3.0), 35.0, 3000)
    axis = np.array([1.0, 2.0, -3.0]) / 14**0.5
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    height = directions @ axis
    assert height.min() >= np.cos(np.radians(35.0))
    for part in (0.1, 0.5, 0.8):
        inside = 1.0 - part * (1.0 - np.cos(np.radians(35.0)))
        assert (height > inside).mean() == pytest.approx(part, abs=2e-3)
    np.testing.assert_allclose(directions.mean(axis=0), axis * height.mean(), atol=2e-3)


def test_an_opening_is_filled():
    square = np.array([[0, 0, 1], [4.0, 0, 1], [4, 2, 1], [0, 2, 1]])
    filling = patches(square, 0.3)
    areas = 0.5 * np.linalg.norm(np.cross(filling[:, 1] - filling[:, 0], filling[:, 2] - filling[:, 0]), axis=1)
    assert areas.sum() == pytest.approx(8.0)
    points = points_in(circle(3.0, count=40), 4000)
    radius = np.hypot(points[:, 0], points[:, 1])
    for part in (0.2, 0.5, 0.9):
        assert (radius < 3.0 * np.sqrt(part)).mean() == pytest.approx(part, abs=0.01)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.02)


def test_curves_are_divided_evenly():
    square = np.array([[0, 0, 0], [4.0, 0, 0], [4, 1, 0], [0, 1, 0]])
    points, lengths = divided(square, 0.7, is_closed=True)
    assert lengths.sum() == pytest.approx(10.0)
    assert lengths.max() <= 0.7
    assert len(points) == 2 * (6 + 2)
    assert divided(square, 0.7, is_closed=False)[1].sum() == pytest.approx(9.0)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: visibility(triangle_tree(*plate(1.0)), [[0, 0, 0], [1, 0, 0]], View(UP)),
        lambda: visibility(triangle_tree(*plate(1.0)), circle(1.0), View((0.0, 0.0, 0.0))),
        lambda: visibility(triangle_tree(*plate(1.0)), circle(1.0), View(UP, half_angle_deg=0.0)),
        lambda: visibility(triangle_tree(*plate(1.0)), circle(1.0), View(UP, distance_mm=-1.0)),
        lambda: Shaft(UP, length_mm=0.0),
        lambda: Shaft((0.0, 0.0, 0.0)),
        lambda: reach(triangle_tree(*plate(1.0)), circle(1.0), Shaft(UP), depth_mm=0.0),
    ],
)
def test_what_cannot_be_is_refused(wrong):
    with pytest.raises(SimulationError):
        wrong()
