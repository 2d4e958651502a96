"""Self-intersections: against exact rational arithmetic, and against meshes whose answer is known."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trimesh.creation import icosphere

from heartcase.pipeline.mesh.intersections import self_intersections


def exact_volume(a, b, c, d):
    a, b, c = ([x - y for x, y in zip(one, d, strict=True)] for one in (a, b, c))
    return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])


def sign(value):
    return (value > 0) - (value < 0)


def exact_edge_crosses(p, q, triangle):
    a, b, c = triangle
    sides = sign(exact_volume(a, b, c, p)), sign(exact_volume(a, b, c, q))
    ways = {sign(exact_volume(p, q, *pair)) for pair in ((a, b), (b, c), (c, a))}
    return 0 not in sides and sides[0] != sides[1] and len(ways) == 1 and 0 not in ways


def exact_pairs(vertices, triangles):
    exact = [[Fraction(float(x)) for x in vertex] for vertex in vertices]
    corners = [[exact[v] for v in triangle] for triangle in triangles]
    found = []
    for (s, one), (t, other) in itertools.combinations(enumerate(corners), 2):
        edges = [(a, b, other) for a, b in zip(one, one[1:] + one[:1], strict=True)]
        edges += [(a, b, one) for a, b in zip(other, other[1:] + other[:1], strict=True)]
        if any(exact_edge_crosses(*edge) for edge in edges):
            found.append((s, t))
    return found


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    vertex_count=st.integers(4, 14),
    triangle_count=st.integers(2, 12),
    steps=st.sampled_from([2, 3, 5, 1 << 20]),
)
def test_pairs_are_those_of_exact_arithmetic(seed, vertex_count, triangle_count, steps):
    # few steps: many points of one plane or line, and triangles that share vertices
    random = np.random.default_rng(seed)
    vertices = (random.integers(0, steps, (vertex_count, 3)) / steps).astype(np.float32)
    triangles = np.array([random.choice(vertex_count, 3, replace=False) for _ in range(triangle_count)], np.int32)
    assert [tuple(pair) for pair in self_intersections(vertices, triangles).tolist()] == exact_pairs(
        vertices, triangles.tolist()
    )


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    vertex_count=st.integers(4, 30),
    triangle_count=st.integers(2, 40),
    share=st.floats(0.0, 1.0),
    steps=st.sampled_from([3, 1 << 20]),
)
def test_pairs_among_some_triangles_are_those_of_all_that_have_one(seed, vertex_count, triangle_count, share, steps):
    random = np.random.default_rng(seed)
    vertices = random.integers(0, steps, (vertex_count, 3)) / steps
    triangles = np.array([random.choice(vertex_count, 3, replace=False) for _ in range(triangle_count)], np.int32)
    among = random.random(triangle_count) < share
    every = self_intersections(vertices, triangles)
    np.testing.assert_array_equal(self_intersections(vertices, triangles, among=among), every[among[every].any(axis=1)])


def sphere(subdivisions):
    mesh = icosphere(subdivisions=subdivisions)
    return np.array(mesh.vertices), np.array(mesh.faces, np.int32)


def test_a_sphere_does_not_cross_itself_and_two_that_overlap_do():
    vertices, triangles = sphere(3)
    assert len(self_intersections(vertices, triangles)) == 0
    shifted = vertices + np.array([0.7, 0.1, 0.2])
    both = np.concatenate([vertices, shifted])
    pairs = self_intersections(both, np.concatenate([triangles, triangles + len(vertices)]).astype(np.int32))
    # they cross along one circle: each pair has a triangle of either
    assert len(pairs) > 50
    assert ((pairs[:, 0] < len(triangles)) & (pairs[:, 1] >= len(triangles))).all()
    middle = both[np.concatenate([triangles, triangles + len(vertices)])[pairs]].mean(axis=2)
    plane = np.array([0.7, 0.1, 0.2])
    assert np.abs((middle - plane / 2) @ plane / np.linalg.norm(plane)).max() < 0.2


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_a_vertex_that_is_pushed_through_the_other_side_is_found(scale):
    vertices, triangles = sphere(2)
    vertices = vertices.copy()
    vertices[7] *= -1.3
    pairs = self_intersections(vertices * scale, triangles)
    fan = set(np.flatnonzero((triangles == 7).any(axis=1)).tolist())
    assert len(pairs)
    assert all(fan & set(pair) for pair in pairs.tolist())


def test_an_empty_mesh_has_none():
    assert self_intersections(np.zeros((0, 3)), np.zeros((0, 3), np.int32)).shape == (0, 2)
