"""Shafts and surfaces: the tree against all triangles, distances against trimesh's."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.incisions.segments import nearest_triangles, touches
from heartcase.simulator.incisions.triangle_tree import triangle_tree
from tests.simulator.incisions.scenes import random_mesh


def crossed(p, q, corners) -> bool:
    """Whether a segment goes through any of the triangles: signs of volumes, in plain NumPy."""
    a, b, c = np.moveaxis(corners, 1, 0)

    def volume(x, y, z, w):
        return np.einsum("...i,...i->...", y - x, np.cross(z - x, w - x))

    sides = volume(a, b, c, p) * volume(a, b, c, q) <= 0
    edges = np.stack([volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)])
    is_flat = (np.cross(b - a, c - a) == 0).all(axis=1)
    return bool((sides & ((edges >= 0).all(axis=0) | (edges <= 0).all(axis=0)) & ~is_flat).any())


def segments(seed: int, count: int = 300):
    rng = np.random.default_rng(seed)
    starts = rng.uniform(-20, 20, (count, 3))
    return starts, starts + rng.normal(size=(count, 3)) * rng.choice([1.0, 10.0, 30.0], (count, 1))


@pytest.mark.parametrize("seed", range(3))
def test_lines_are_stopped_by_what_they_cross(seed):
    vertices, triangles = random_mesh(seed)
    starts, ends = segments(seed)
    found = touches(triangle_tree(vertices, triangles), starts, ends)
    expected = [crossed(p, q, vertices[triangles]) for p, q in zip(starts, ends, strict=True)]
    np.testing.assert_array_equal(found, expected)
    assert 20 < found.sum() < 280


@pytest.mark.parametrize("seed", range(3))
def test_distances_are_those_of_trimesh(seed):
    """Points along each segment: the nearest of them is at most half a spacing farther than the segment itself."""
    vertices, triangles = random_mesh(seed, 60)
    corners = vertices[triangles]
    corners = corners[
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 0
    ]
    starts, ends = segments(seed, 40)
    found, number = nearest_triangles(starts, ends, corners)
    for one in range(len(starts)):
        along = starts[one] + np.linspace(0, 1, 400)[:, None] * (ends[one] - starts[one])
        spacing = np.linalg.norm(ends[one] - starts[one]) / 399
        at = [np.repeat(corner[None], len(along), axis=0) for corner in corners]
        gaps = [np.linalg.norm(trimesh.triangles.closest_point(c, along) - along, axis=1).min() for c in at]
        assert min(gaps) - spacing / 2 - 1e-9 <= found[one] <= min(gaps) + 1e-9
        assert gaps[number[one]] <= min(gaps) + spacing / 2 + 1e-9


@pytest.mark.parametrize("radius", [0.05, 0.7, 4.0])
def test_shafts_touch_what_is_nearer_than_their_radius(radius):
    vertices, triangles = random_mesh(5, 80)
    starts, ends = segments(6)
    found = touches(triangle_tree(vertices, triangles), starts, ends, radius)
    distance, _ = nearest_triangles(starts, ends, vertices[triangles])
    np.testing.assert_array_equal(found, distance <= radius)
    assert 0 < found.sum() < len(found)


@pytest.mark.parametrize("count", [0, 1, 4, 5, 17])
def test_surfaces_of_any_size(count):
    vertices = np.array([[i, j, 0.0] for i in range(count) for j in (0.0, 1.0)] + [[count, 0, 0], [count, 1, 0.0]])
    triangles = np.array([[2 * i, 2 * i + 1, 2 * i + 2] for i in range(count)]).reshape(-1, 3)
    starts = np.array([[i + 0.1, 0.5, 1.0] for i in range(20)])
    found = touches(triangle_tree(vertices, triangles), starts, starts - [0, 0, 2.0])
    np.testing.assert_array_equal(found, np.arange(20) < count)


def test_broken_surfaces_are_refused():
    with pytest.raises(SimulationError) as found:
        triangle_tree([[0, 0, np.nan]], [[0, 0, 7]])
    assert [problem.place for problem in found.value.problems] == ["vertices_mm", "triangles"]
