"""Borders between tags of triangles are made shorter, within a few triangles of where they were."""

from __future__ import annotations

import numpy as np
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from heartcase.pipeline.mesh.extraction.triangle_tags import BORDER_ROUNDS, CUT, shorter_borders
from heartcase.pipeline.mesh.triangles.half_edges import opposites


def ball(subdivisions=4):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)


VERTICES, TRIANGLES = ball()
OPPOSITE = opposites(TRIANGLES)
NONE_KEPT = np.zeros(len(TRIANGLES), bool)


def border_length(tag):
    """Length of all edges between two tags, a Python loop over the edges."""
    total = 0.0
    for edge, other in enumerate(OPPOSITE):
        if edge < other and tag[edge // 3] != tag[other // 3]:
            tail, head = TRIANGLES[edge // 3, edge % 3], TRIANGLES[edge // 3, (edge % 3 + 1) % 3]
            total += float(np.linalg.norm(VERTICES[head] - VERTICES[tail]))
    return total


def rings_from_border(tag):
    """How many edges a triangle is away from the next border; 1 where it is at one."""
    beside = OPPOSITE.reshape(-1, 3) // 3
    rings = np.where((tag[beside] != tag[:, None]).any(axis=1), 1, len(tag))
    for _ in range(2 * BORDER_ROUNDS):
        rings = np.minimum(rings, rings[beside].min(axis=1) + 1)
    return rings


def test_teeth_of_a_border_are_taken_off():
    height = VERTICES[TRIANGLES].mean(axis=1) @ np.array([0.36, 0.48, 0.8])
    tag = np.where(height > 0.1, 7, 3)
    made = shorter_borders(tag, NONE_KEPT, VERTICES, TRIANGLES, OPPOSITE)
    circle = 2 * np.pi * np.sqrt(1 - 0.1**2)
    before, after = border_length(tag) / circle, border_length(made) / circle
    assert before > 1.25
    assert 1.0 <= after < 1.2
    assert np.abs(height[made != tag] - 0.1).max() < 0.05  # half an edge
    assert set(made) == {3, 7}


def test_what_is_kept_stays_and_is_not_handed_on():
    height = VERTICES[TRIANGLES].mean(axis=1) @ np.array([0.36, 0.48, 0.8])
    tag = np.where(height > 0.1, CUT, 3)
    made = shorter_borders(tag, tag == CUT, VERTICES, TRIANGLES, OPPOSITE)
    np.testing.assert_array_equal(made, tag)


@given(seed=st.integers(0, 2**32 - 1), tags=st.integers(2, 5), kept=st.booleans())
def test_no_border_grows_and_none_moves_far(seed, tags, kept):
    rng = np.random.default_rng(seed)
    seeds = rng.normal(size=(3 * tags, 3))
    middle = VERTICES[TRIANGLES].mean(axis=1)
    noisy = middle + rng.normal(scale=0.03, size=middle.shape)
    tag = (noisy @ (seeds / np.linalg.norm(seeds, axis=1)[:, None]).T).argmax(axis=1) % tags
    is_kept = (tag == 0) & kept
    made = shorter_borders(tag, is_kept, VERTICES, TRIANGLES, OPPOSITE)
    assert border_length(made) <= border_length(tag)
    assert (rings_from_border(tag)[made != tag] <= BORDER_ROUNDS).all()
    np.testing.assert_array_equal(made[is_kept], tag[is_kept])
    if kept:
        assert (made[made != tag] != 0).all()
    again = shorter_borders(tag, is_kept, VERTICES, TRIANGLES, OPPOSITE)
    np.testing.assert_array_equal(made, again)


def test_a_border_along_edges_that_is_short_stays():
    octahedron = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]], np.int32)
    tag = np.array([1, 1, 1, 1, 2, 2, 2, 2])
    made = shorter_borders(tag, np.zeros(8, bool), octahedron, faces, opposites(faces))
    np.testing.assert_array_equal(made, tag)
