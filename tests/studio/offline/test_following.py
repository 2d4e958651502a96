"""Landmarks and vessels in a page go with the tissue: what their points hang on, against the field that moves it."""

import numpy as np

from heartcase.studio.offline.following import hung_points
from tests.simulator.lattices import block


def test_points_inside_hang_where_they_are_and_others_on_the_nearest_cell():
    model = block(6, 5, 4, cell_mm=2.5)
    rng = np.random.default_rng(7)
    index = rng.uniform(-0.49, [5.49, 4.49, 3.49], (200, 3))
    outside = np.array([[-3.0, 2.0, 1.0], [9.0, 9.0, 9.0]])
    points = model.geometry.index_to_world(np.vstack([index, outside]))
    found = hung_points(model, points)
    corner = np.stack([np.arange(8) & 1, np.arange(8) >> 1 & 1, np.arange(8) >> 2], axis=1)
    local = found["local"][:, None].astype(float)
    share = np.where(corner == 1, local, 1.0 - local).prod(axis=2)
    np.testing.assert_allclose(share.sum(axis=1), 1.0, atol=1e-6)
    cells = model.cells[found["cell"]]
    # each cell's corners lie half a cell around its middle
    places = (share[:, :, None] * (cells[:, None] + corner - 0.5)).sum(axis=1)
    np.testing.assert_allclose(places[:200], index, atol=1e-5)
    np.testing.assert_allclose(places[200:], [[-0.5, 2.0, 1.0], [5.5, 4.5, 3.5]], atol=1e-5)
    np.testing.assert_array_equal(found["at_mm"], points.astype(np.float32))
    assert len(hung_points(model, [])["cell"]) == 0
