"""Self-intersections: against exact rational arithmetic, and against meshes whose answer is known."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from trimesh.creation import icosphere

from heartcase.pipeline.mesh.triangles.intersections import _ERROR_BOUND, self_intersections


def exact_side(a, b, c, d, least=0.0):
    """Sign of the volume of (a, b, c, d); 0 below ``least`` times the sum of its products' sizes."""
    a, b, c = ([x - y for x, y in zip(one, d, strict=True)] for one in (a, b, c))
    parts = [
        sign * a[i] * b[j] * c[k]
        for (i, j, k), sign in zip(itertools.permutations(range(3)), (1, -1, -1, 1, 1, -1), strict=True)
    ]
    volume = sum(parts)
    return ((volume > 0) - (volume < 0)) * (abs(volume) > Fraction(least) * sum(map(abs, parts)))


def exact_edge_crosses(p, q, triangle, least):
    a, b, c = triangle
    sides = exact_side(a, b, c, p, least), exact_side(a, b, c, q, least)
    ways = {exact_side(p, q, *pair, least) for pair in ((a, b), (b, c), (c, a))}
    return 0 not in sides and sides[0] != sides[1] and len(ways) == 1 and 0 not in ways


def exact_pairs(vertices, triangles, least=0.0):
    exact = [[Fraction(float(x)) for x in vertex] for vertex in vertices]
    corners = [[exact[v] for v in triangle] for triangle in triangles]
    found = []
    for (s, one), (t, other) in itertools.combinations(enumerate(corners), 2):
        edges = [(a, b, other) for a, b in zip(one, one[1:] + one[:1], strict=True)]
        edges += [(a, b, one) for a, b in zip(other, other[1:] + other[:1], strict=True)]
        if any(exact_edge_crosses(*edge, least) for edge in edges):
            found.append((s, t))
    return found


def random_triangles(seed, vertex_count, triangle_count, steps):
    """Of few steps many points lie on one plane or line; triangles share vertices."""
    random = np.random.default_rng(seed)
    vertices = (random.integers(0, steps, (vertex_count, 3)) / steps).astype(np.float32)
    return vertices, np.array([random.choice(vertex_count, 3, replace=False) for _ in range(triangle_count)], np.int32)


def pairs_of(vertices, triangles):
    return [tuple(pair) for pair in self_intersections(vertices, triangles).tolist()]


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    vertex_count=st.integers(4, 14),
    triangle_count=st.integers(2, 12),
    steps=st.sampled_from([2, 4, 8, 1 << 20]),
)
def test_pairs_are_those_of_exact_arithmetic(seed, vertex_count, triangle_count, steps):
    """Where coordinates are whole steps: what seems to lie in one plane does."""
    vertices, triangles = random_triangles(seed, vertex_count, triangle_count, steps)
    assert pairs_of(vertices, triangles) == exact_pairs(vertices, triangles.tolist())


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    vertex_count=st.integers(4, 14),
    triangle_count=st.integers(2, 12),
    steps=st.sampled_from([3, 5, 7]),
)
@example(seed=174403, vertex_count=12, triangle_count=6, steps=5)
def test_what_is_missed_crosses_by_no_more_than_rounding(seed, vertex_count, triangle_count, steps):
    """Thirds and fifths are rounded: points lie beside a plane by a part in 10^8, some volumes are a part in 10^16."""
    vertices, triangles = random_triangles(seed, vertex_count, triangle_count, steps)
    found = set(pairs_of(vertices, triangles))
    assert found <= set(exact_pairs(vertices, triangles.tolist()))
    assert found >= set(exact_pairs(vertices, triangles.tolist(), least=3.0 * _ERROR_BOUND))


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
