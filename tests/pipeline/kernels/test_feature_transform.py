"""Distances to the nearest marked node, against scipy's."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.ndimage import distance_transform_edt

from heartcase.pipeline.kernels.feature_transform import distance_to_marked


@settings(max_examples=60, deadline=None)
@given(
    marked=hnp.arrays(bool, st.tuples(*(3 * [st.integers(1, 9)])), elements=st.sampled_from([True, *7 * [False]])),
    spacing=st.tuples(*(3 * [st.floats(0.3, 4.0)])),
)
def test_distances_are_exact(marked, spacing):
    distance = np.empty(marked.shape, np.float32)
    distance_to_marked(marked, np.array(spacing), distance)
    if not marked.any():
        assert np.isinf(distance).all()
        return
    expected = distance_transform_edt(~marked, sampling=spacing)
    np.testing.assert_allclose(distance, expected, rtol=1e-6, atol=1e-6)


def test_distances_of_a_large_volume_are_exact():
    random = np.random.default_rng(5)
    marked = random.random((31, 47, 64)) < 3e-4
    distance = np.empty(marked.shape, np.float32)
    distance_to_marked(marked, np.array([2.1, 0.7, 1.3]), distance)
    np.testing.assert_allclose(distance, distance_transform_edt(~marked, sampling=(2.1, 0.7, 1.3)), rtol=1e-6)
