"""Distances to the shapes of edits, against points that are searched one by one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from heartcase.pipeline.artifacts.serialise import artifact_from_bytes, artifact_to_bytes
from heartcase.pipeline.data import Reshaping, Structures
from heartcase.pipeline.fields.shapes import distance_on_lattice, frame_of, section_distance
from heartcase.schemas.errors import StageError
from heartcase.schemas.labels import LabelTable
from tests.pipeline.lattices import lattice, points_of

UNIT = np.array([0.48, 0.6, 0.64])
LONG = np.array([0.8, -0.6, 0.0]) - (np.array([0.8, -0.6, 0.0]) @ UNIT) * UNIT
LONG /= np.linalg.norm(LONG)
SHORT = np.cross(UNIT, LONG)


def canal(shape, a, b, *, length=8.0, middle=(0.4, -0.2, 0.7)) -> Reshaping:
    """A canal with half diameters a and b."""
    middle = np.array(middle)
    points = [middle - 0.5 * length * UNIT, middle + 0.5 * length * UNIT, middle + a * LONG, middle + b * SHORT]
    return Reshaping(shape, tuple(tuple(map(float, point)) for point in points), a, (), ())


def outline(shape, a, b, count):
    """Points of the cross-section's border."""
    t = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    if shape == "elliptic":
        return np.stack([a * np.cos(t), b * np.sin(t)], axis=1)
    ends = np.stack([b * np.cos(t) + np.sign(np.cos(t)) * (a - b), b * np.sin(t)], axis=1)
    straight = np.linspace(-(a - b), a - b, count)
    sides = [np.stack([straight, np.full(count, s * b)], axis=1) for s in (-1.0, 1.0)]
    return np.concatenate([ends, *sides])


def is_inside(shape, a, b, u, v):
    if shape == "elliptic":
        return (u / a) ** 2 + (v / b) ** 2 < 1.0
    return np.where(np.abs(u) < a - b, np.abs(v) < b, (np.abs(u) - (a - b)) ** 2 + v**2 < b**2)


@pytest.mark.parametrize("shape", ["elliptic", "slit"])
@settings(deadline=None, max_examples=40)
@given(st.floats(0.5, 30.0), st.floats(0.05, 1.0), st.integers(0, 1000))
def test_the_distance_to_a_section_is_that_to_its_nearest_border_point(shape, a, ratio, seed):
    b = ratio * a
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.5 * a, 1.5 * a, (60, 2))
    # The axes and the middle are where an iteration could fail.
    points = np.concatenate([points, points[:5] * [1, 0], points[:5] * [0, 1], np.zeros((1, 2)), [[a, 0.0], [0.0, b]]])
    points = np.concatenate([points, points[:5] * [1.0, 1e-12]])
    border = outline(shape, a, b, 20_000)
    nearest = cKDTree(border).query(points)[0]
    found = section_distance(canal(shape, a, b), points[:, 0], points[:, 1])
    # The border points are up to this far apart; near the border the gap is to first order, beyond to second.
    step = 2.0 * np.pi * a / 20_000
    assert np.abs(np.abs(found) - nearest).max() <= step
    far = nearest > 10.0 * step
    assert (found[far] < 0.0).tolist() == is_inside(shape, a, b, points[far, 0], points[far, 1]).tolist()


@settings(deadline=None, max_examples=40)
@given(st.floats(0.5, 30.0), st.integers(0, 1000))
def test_both_shapes_with_equal_diameters_are_the_round_one(radius, seed):
    points = np.random.default_rng(seed).uniform(-2.0 * radius, 2.0 * radius, (50, 2))
    true = np.hypot(points[:, 0], points[:, 1]) - radius
    for shape in ("elliptic", "slit"):
        found = section_distance(canal(shape, radius, radius), points[:, 0], points[:, 1])
        assert np.abs(found - true).max() < 1e-8 * radius


@pytest.mark.parametrize("shape", ["elliptic", "slit"])
def test_a_canal_is_its_section_with_flat_ends(shape):
    a, b, length = 5.0, 2.0, 8.0
    geometry = lattice("oblique", 24.0)
    one = canal(shape, a, b, length=length)
    found = distance_on_lattice(one, geometry)
    gap = points_of(geometry) - np.array([0.4, -0.2, 0.7])
    u, v, w = gap @ LONG, gap @ SHORT, gap @ UNIT
    # All of the border: the mantle, and both ends, in points 0.1 mm apart.
    line = outline(shape, a, b, 300)
    mantle = np.array([(x, y, z) for z in np.arange(-0.5 * length, 0.501 * length, 0.1) for x, y in line])
    grid = np.stack(np.meshgrid(np.arange(-a, a, 0.1), np.arange(-b, b, 0.1)), axis=-1).reshape(-1, 2)
    disc = grid[is_inside(shape, a, b, grid[:, 0], grid[:, 1])]
    ends = np.concatenate([np.column_stack([disc, np.full(len(disc), z)]) for z in (-0.5 * length, 0.5 * length)])
    nearest = cKDTree(np.concatenate([mantle, ends])).query(np.stack([u, v, w], axis=-1))[0]
    assert np.abs(np.abs(found) - nearest).max() < 0.1
    inside = is_inside(shape, a, b, u, v) & (np.abs(w) < 0.5 * length)
    assert ((found < 0.0) == inside)[nearest > 0.1].all()
    unit, long, short, half_long, half_short = frame_of(one)
    assert np.allclose([unit, long, short], [UNIT, LONG, SHORT])
    assert (half_long, half_short) == pytest.approx((a, b))


@pytest.mark.parametrize("damage", [("slit", 2), ("elliptic", 3), ("cylinder", 1), ("strokes", 0), ("star", 4)])
def test_a_file_with_a_shape_that_is_none_is_refused(damage):
    shape, count = damage
    plain = Structures({0: np.zeros((2, 2, 2), np.float32)}, lattice("even", 4.0), LabelTable(labels=()), 1.0)
    one = Reshaping("slit", ((0.0, 0.0, 0.0),) * 4, 1.0, (), ())
    content = artifact_to_bytes(replace(plain, reshapings=(one,)))
    assert artifact_from_bytes(content, Structures).reshapings == (one,)
    object.__setattr__(plain, "reshapings", (one._replace(shape=shape, points_mm=one.points_mm[:count]),))
    with pytest.raises(StageError, match="was written by another version"):
        artifact_from_bytes(artifact_to_bytes(plain), Structures)


def test_the_least_extent_of_each_shape():
    assert canal("elliptic", 5.0, 2.0).thickness_mm == pytest.approx(4.0)
    assert canal("slit", 5.0, 2.0, length=1.5).thickness_mm == pytest.approx(1.5)
    assert Reshaping("cylinder", ((0, 0, 0), (0, 0, 3)), 4.0, (), ()).thickness_mm == 3.0
    assert Reshaping("strokes", ((0, 0, 0), (0, 0, 1)), 4.0, (), ()).thickness_mm == 8.0
