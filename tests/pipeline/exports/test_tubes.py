"""Vessels as surfaces of their own: at their radius from their line, closed, and never twisted."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from heartcase.phantom.anatomy.shapes import Tube
from heartcase.pipeline.exports.tubes import tube_mesh, vessel_tubes
from heartcase.schemas.landmarks import Landmark


def helix(count, turns=1.0):
    angle = np.linspace(0.0, 2.0 * np.pi * turns, count)
    return np.stack([20.0 * np.cos(angle), 20.0 * np.sin(angle), 6.0 * angle], axis=1)


def solid_of(tube):
    return trimesh.Trimesh(tube.vertices_mm, tube.triangles, process=False)


@pytest.mark.parametrize("side_count", [12, 16, 48])
def test_a_helix_has_the_volume_and_the_area_of_a_pipe_with_round_ends(side_count):
    tube = tube_mesh(helix(60), 1.5, side_count=side_count)
    solid = solid_of(tube)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    length = 2.0 * np.pi * np.hypot(20.0, 6.0)
    volume, area = np.pi * 1.5**2 * length + 4.0 / 3.0 * np.pi * 1.5**3, 2.0 * np.pi * 1.5 * length + np.pi * 9.0
    # What a regular polygon lacks of its circle, and as much again for the steps along the line.
    lacking = 1.0 - np.sin(2.0 * np.pi / side_count) / (2.0 * np.pi / side_count)
    assert 0.0 < 1.0 - solid.volume / volume < 2.0 * lacking
    assert 0.0 < 1.0 - solid.area / area < 2.0 * lacking
    dense = helix(40_001)
    apart, _ = cKDTree(dense).query(tube.vertices_mm)
    np.testing.assert_allclose(apart, 1.5, atol=2e-3)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 12), st.floats(0.2, 2.0), st.sampled_from([3, 8, 12, 16]))
def test_a_vessel_lies_at_its_radius_from_its_line(seed, count, radius, side_count):
    random = np.random.default_rng(seed)
    # Steps of 8 mm that turn by up to half a radian: a line that bends no sharper than the largest radius.
    way, points = random.normal(size=3), [random.uniform(-50.0, 50.0, 3)]
    way /= np.linalg.norm(way)
    for _ in range(count - 1):
        points.append(points[-1] + 8.0 * way)
        way = way + 0.5 * random.uniform(-1.0, 1.0, 3) / np.sqrt(3.0)
        way /= np.linalg.norm(way)
    tube = tube_mesh(points, radius, side_count=side_count)
    assert solid_of(tube).is_watertight
    np.testing.assert_allclose(np.linalg.norm(tube.normals, axis=1), 1.0, atol=1e-6)
    exact = Tube(np.array(points), np.full(count, radius))
    np.testing.assert_allclose(exact.distance(tube.vertices_mm.astype(float)), 0.0, atol=1e-4)
    outward = exact.distance(tube.vertices_mm + 0.05 * tube.normals.astype(float))
    np.testing.assert_allclose(outward, 0.05, atol=1e-4)
    corners = tube.vertices_mm[tube.triangles].astype(float)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", across, tube.normals[tube.triangles].sum(axis=1).astype(float)) > 0.0).all()


def test_a_straight_vessel_is_not_twisted():
    tube = tube_mesh([(0, 0, 0), (0, 0, 10), (0, 0, 40)], 1.0, side_count=8)
    side = tube.normals[np.abs(tube.normals[:, 2]) < 1e-6]
    assert len(np.unique(side.round(5), axis=0)) == 8


def test_vessels_are_the_lines_with_a_radius():
    line = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 9.0))
    landmarks = (
        Landmark(name="artery", kind="polyline", points_mm=line, radius_mm=1.0),
        Landmark(name="no length", kind="polyline", points_mm=line[:2], radius_mm=1.0),
        Landmark(name="incision", kind="polyline", points_mm=line, depth_mm=3.0),
        Landmark(name="valve", kind="ring", points_mm=line[:1], axis=(0.0, 0.0, 1.0), radius_mm=8.0),
    )
    tubes = vessel_tubes(landmarks)
    assert list(tubes) == ["artery"]
    assert tubes["artery"].vertices_mm[:, 2].min() == pytest.approx(-1.0)
    assert tubes["artery"].vertices_mm[:, 2].max() == pytest.approx(10.0)
