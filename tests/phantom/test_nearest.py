"""The nearest sample is that of comparing all."""

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from heartcase.phantom.anatomy.nearest import SampleTree


@given(
    seed=st.integers(0, 2**32 - 1),
    sample_count=st.integers(1, 600),
    flat=st.integers(0, 3),
    whole=st.booleans(),
)
def test_it_is_the_nearest_of_all(seed, sample_count, flat, whole):
    """Scattered, on a plane, on a line, all in one place; with many that are as near as one another."""
    rng = np.random.default_rng(seed)
    samples = rng.normal(scale=20.0, size=(sample_count, 3)) + rng.normal(scale=100.0, size=3)
    samples[:, :flat] = samples[0, :flat]
    points = rng.normal(scale=30.0, size=(50, 3)) + samples[0]
    if whole:
        samples, points = np.round(samples / 8.0), np.round(points / 8.0)
    distance, index = SampleTree.of(samples).query(points)
    square = ((points[:, None] - samples) ** 2).sum(axis=2)
    np.testing.assert_array_equal(distance, np.sqrt(square.min(axis=1)))
    np.testing.assert_array_equal(square[np.arange(50), index], square.min(axis=1))


def test_it_is_that_of_a_kd_tree_along_a_lattice_at_any_number_of_threads():
    turn = np.random.default_rng(3).normal(size=(20_000, 3))
    samples = 20.0 * turn / np.linalg.norm(turn, axis=1)[:, None]
    points = np.stack(np.meshgrid(*[np.linspace(-30.0, 30.0, 25)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    tree = SampleTree.of(samples)
    expected = cKDTree(samples).query(points)
    before = numba.get_num_threads()
    try:
        for threads in (1, before):
            numba.set_num_threads(threads)
            distance, index = tree.query(points)
            np.testing.assert_allclose(distance, expected[0], rtol=1e-14)
            np.testing.assert_array_equal(index, expected[1])
    finally:
        numba.set_num_threads(before)


@pytest.mark.parametrize("samples", [np.zeros((0, 3)), np.full((3, 3), np.nan)])
def test_nothing_to_be_near_to_is_refused(samples):
    with pytest.raises(ValueError, match="a tree needs samples"):
        SampleTree.of(samples)
