"""Which vertices the decimation takes more care of, against all distances in plain NumPy."""

import numpy as np
import pytest
import pyvista

from heartcase.pipeline.mesh.decimation.collapse import join_ends
from heartcase.pipeline.mesh.decimation.decimate import _within, decimate


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


def test_both_orders_of_collapses_share_one_machine_code():
    """A kernel that others call with an index of another width is compiled again for it: seconds of a first build."""
    mesh = pyvista.Icosphere(radius=10.0, nsub=3)
    triangles = mesh.regular_faces.astype(np.int32)
    tags = np.zeros(len(triangles), np.int32)
    decimate(np.asarray(mesh.points, float), triangles, tags, triangle_count=300)
    assert {str(types[5]) for types in join_ends.signatures} == {"int64"}
