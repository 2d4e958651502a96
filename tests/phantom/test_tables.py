import numba
import numpy as np
import pytest

from heartcase.phantom.anatomy.shapes import Capsule, Ellipsoid, Shape, Union
from heartcase.phantom.anatomy.tables import DistanceTables, tabulate


class Squeezed:
    """A shape whose value is not its distance: 0.6 of it, so that the table must find the distance itself."""

    def __init__(self, shape: Shape) -> None:
        self.shape = shape

    def distance(self, points):
        return 0.6 * self.shape.distance(points)


def table_of(shape, reach=20.0, spacing=1.0):
    corner = np.full(3, reach)
    return tabulate(shape, -corner, corner, spacing_mm=spacing, band_mm=6.0, margin_mm=6.0)


# The nearest sample is within 0.87 steps of the foot. What the second-order patch leaves is of third order,
# (0.87 / 12)^3 of 12 mm, and where a capsule's curvature jumps from 1/6 to 0 half of that times 0.87 squared.
@pytest.mark.parametrize(
    ("shape", "tolerance_mm"),
    [
        (Ellipsoid((0.2, 0.1, 0.3), (12.0, 12.0, 12.0)), 0.01),
        (Capsule((-9.0, 3.0, 0.0), (7.0, -2.0, 4.0), 6.0), 0.063),
    ],
)
def test_table_is_the_distance_though_the_shape_is_not(shape, tolerance_mm):
    points = np.random.default_rng(1).uniform(-18.0, 18.0, (20000, 3))
    true = shape.distance(points)
    found = table_of(Squeezed(shape)).distance(points)
    near = (true > -2.5) & (true < 6.0)
    assert np.abs(found - true)[near].max() < tolerance_mm
    assert np.percentile(np.abs(found - true)[near], 95) < 0.01
    assert np.abs(found - true)[true > 6.0].max() < 0.15
    assert np.all((found < 0.0) == (true < 0.0))


def test_table_of_a_blend_is_the_distance_to_its_own_surface():
    shape = Union([Ellipsoid((-5.0, 0.0, 0.0), (8.0, 8.0, 8.0)), Ellipsoid((6.0, 0.0, 0.0), (6.0, 6.0, 6.0))], 4.0)
    table = table_of(shape)
    points = np.random.default_rng(2).uniform(-15.0, 15.0, (4000, 3))
    value = table.distance(points)
    near = np.abs(value) < 2.0
    points, value = points[near], value[near]
    step = 1e-3
    gradient = np.stack(
        [(table.distance(points + e) - table.distance(points - e)) / (2.0 * step) for e in step * np.eye(3)], axis=1
    )
    length = np.linalg.norm(gradient, axis=1)
    # All but the points beside the groove between the two balls, where two feet are equally near.
    assert np.percentile(np.abs(length - 1.0), 95) < 0.02
    foot = points - value[:, None] * gradient / length[:, None]
    assert np.percentile(np.abs(table.distance(foot)), 95) < 0.01


def test_tables_join_and_reach_beyond_their_lattice():
    small, large = (table_of(Ellipsoid((0.0, 0.0, 0.0), (r, r, r))) for r in (5.0, 9.0))
    both = DistanceTables.joined([small, large])
    points = np.random.default_rng(3).uniform(-60.0, 60.0, (500, 3))
    np.testing.assert_array_equal(both.evaluate(points)[:, 0], small.distance(points))
    np.testing.assert_array_equal(both.evaluate(points)[:, 1], large.distance(points))
    outside = np.abs(points).max(axis=1) > 30.0
    assert np.all(both.evaluate(points)[outside, 0] > 12.0)


def test_a_box_that_does_not_hold_the_shape_is_refused():
    with pytest.raises(ValueError, match="does not hold the shape"):
        table_of(Ellipsoid((0.0, 0.0, 0.0), (24.0, 5.0, 5.0)))


def test_table_does_not_depend_on_the_number_of_threads():
    shape = Capsule((-9.0, 3.0, 0.0), (7.0, -2.0, 4.0), 6.0)
    threads = numba.get_num_threads()
    several = table_of(shape).coefficients
    numba.set_num_threads(1)
    try:
        one = table_of(shape).coefficients
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(several, one)
