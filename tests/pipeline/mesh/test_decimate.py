"""Which vertices the decimation takes more care of, against all distances in plain NumPy."""

import numpy as np
import pytest

from heartcase.pipeline.mesh.decimation.decimate import _within


@pytest.mark.parametrize("seed", range(5))
def test_vertices_near_places_are_those_of_all_distances(seed):
    generator = np.random.default_rng(seed)
    vertices = generator.normal(size=(400, 3)) * 10.0
    middles = generator.normal(size=(30, 3)) * 10.0
    middles = middles[np.argsort(middles[:, 2], kind="stable")]
    reaches = generator.uniform(0.5, 6.0, len(middles))
    apart = np.linalg.norm(vertices[:, None] - middles, axis=2)
    near = (apart <= reaches).any(axis=1)
    assert near.any()
    assert not near.all()
    np.testing.assert_array_equal(_within(vertices, middles, reaches), near)
