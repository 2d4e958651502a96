import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from heartcase.phantom.anatomy.shapes import (
    Capsule,
    Ellipsoid,
    HalfSpace,
    Intersection,
    Offset,
    Shell,
    Tube,
    Union,
    complement,
    smooth_max,
    smooth_min,
)


def points_around(count, reach, seed=1):
    return np.random.default_rng(seed).uniform(-reach, reach, (count, 3))


def test_ellipsoid_with_equal_axes_is_a_sphere():
    points = points_around(500, 20.0)
    expected = np.linalg.norm(points - [1.0, 2.0, 3.0], axis=1) - 7.0
    np.testing.assert_allclose(Ellipsoid((1.0, 2.0, 3.0), (7.0, 7.0, 7.0)).distance(points), expected, atol=1e-7)


def test_ellipsoid_distance_is_the_least_over_its_surface():
    radii = np.array([9.0, 4.0, 2.5])
    points = points_around(12, 12.0, seed=3)
    found = np.abs(Ellipsoid((0.0, 0.0, 0.0), radii).distance(points))
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 200), np.linspace(0.0, np.pi, 100))
    surface = radii * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)

    def gap(angles, point):
        a, b = angles
        return np.sum((radii * [np.cos(a) * np.sin(b), np.sin(a) * np.sin(b), np.cos(b)] - point) ** 2)

    for point, distance in zip(points, found, strict=True):
        start = np.unravel_index(np.argmin(np.linalg.norm(surface - point, axis=-1)), u.shape)
        best = minimize(gap, (u[start], v[start]), args=(point,), method="Nelder-Mead", options={"xatol": 1e-9})
        assert distance == pytest.approx(np.sqrt(best.fun), abs=1e-6)


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (3.0, 0.0, 0.0), (0.0, 4.0, 0.0)])
def test_ellipsoid_distance_on_the_axes(point):
    # Inside on the long axes the nearest point lies off the axis; the surface sampled densely says where.
    radii = np.array([9.0, 4.0, 2.5])
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 2001), np.linspace(0.0, np.pi, 1001))
    surface = radii * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)
    brute = np.linalg.norm(surface - point, axis=-1).min()
    found = Ellipsoid((0.0, 0.0, 0.0), radii).distance(np.array([point]))[0]
    assert abs(found) == pytest.approx(brute, abs=1e-4)


def test_oblique_ellipsoid_turns_with_its_axes():
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    points = points_around(100, 10.0)
    straight = Ellipsoid((0.0, 0.0, 0.0), (6.0, 3.0, 2.0)).distance(points @ turn.T)
    np.testing.assert_allclose(Ellipsoid((0.0, 0.0, 0.0), (6.0, 3.0, 2.0), turn).distance(points), straight, atol=1e-9)


def test_straight_tube_is_a_capsule_and_its_flat_end_a_disc():
    line = [(0.0, 0.0, 0.0), (0.0, 0.0, 10.0), (0.0, 0.0, 30.0)]
    points = points_around(400, 40.0)
    capsule = Capsule(line[0], line[-1], 4.0)
    np.testing.assert_allclose(Tube(line, 4.0).distance(points), capsule.distance(points), atol=1e-6)
    flat = Tube(line, 4.0, flat_end=True)
    at = np.array([[0.0, 0.0, 31.0], [6.0, 0.0, 31.0], [5.0, 0.0, 15.0], [0.0, 0.0, 29.5]])
    np.testing.assert_allclose(flat.distance(at), [1.0, np.hypot(2.0, 1.0), 1.0, -0.5], atol=1e-6)
    trimmed = Tube(line, 4.0, trim_mm=5.0)
    np.testing.assert_allclose(trimmed.distance(np.array([[0.0, 0.0, 30.0]])), [1.0], atol=1e-6)


def test_bent_tube_follows_a_circle():
    angle = np.linspace(0.0, np.pi, 25)
    tube = Tube(30.0 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1), 5.0)
    at = np.random.default_rng(2).uniform(0.3, np.pi - 0.3, 50)
    ring, height = 30.0 + np.linspace(-8.0, 8.0, 50), np.linspace(7.0, -7.0, 50)
    points = np.stack([ring * np.cos(at), ring * np.sin(at), height], axis=1)
    # A cubic spline through 25 points of a half circle is off by (pi / 24)^4 * 5 / 384 of its radius at most.
    np.testing.assert_allclose(tube.distance(points), np.hypot(ring - 30.0, height) - 5.0, atol=2e-3)


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.1, 4))
def test_smooth_minimum_lies_just_below_the_minimum(a, b, blend):
    blended = float(smooth_min(np.array(a), np.array(b), blend))
    assert min(a, b) - blend / 6.0 - 1e-12 <= blended <= min(a, b) + 1e-12
    if abs(a - b) >= blend:
        assert blended == min(a, b)
    assert float(smooth_max(np.array(-a), np.array(-b), blend)) == pytest.approx(-blended)


def test_combinations_of_half_spaces():
    points = points_around(200, 5.0)
    left, low = HalfSpace((1.0, 0.0, 0.0), (2.0, 0.0, 0.0)), HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    x, z = points[:, 0] - 1.0, points[:, 2]
    np.testing.assert_allclose(Union([left, low]).distance(points), np.minimum(x, z))
    np.testing.assert_allclose(Intersection([left, low]).distance(points), np.maximum(x, z))
    np.testing.assert_allclose(Offset(left, 0.5).distance(points), x - 0.5)
    np.testing.assert_allclose(complement(left, gap_mm=0.5).distance(points), 0.5 - x)
    np.testing.assert_allclose(Shell(left, 2.0).distance(points), np.maximum(x - 2.0, -x))
