"""The surface on a CUDA device against the CPU's over the same nodes."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.deform import deform
from tests.simulator.lattices import EPS, block, oblique_geometry, random_field
from tests.simulator.surface.test_cell_vertices import with_cells
from tests.simulator.surface.test_surface import hung_surface


@pytest.mark.parametrize("tangents", [False, True])
@pytest.mark.parametrize("mode", ["none", "all", "flagged", "in cells"])
def test_device_shows_the_surface_of_the_cpu(mode, tangents):
    model = block(4, 3, 2, geometry=oblique_geometry())
    is_in_cells = mode == "in cells"
    surface, _ = hung_surface(model, "flagged" if is_in_cells else mode, count=40, tangents=tangents)
    if is_in_cells:
        # at a size at which no cell is flat, so that all directions are told
        surface, _ = with_cells(model, surface, 5)
    simulation = Simulation(model, surface=surface, backend="cuda")
    simulation.prepare()
    still = random_field(model, 1, 0.0)
    for displacement in (random_field(model, 7, 0.1 if is_in_cells else 0.3), still):
        simulation.restore(State(displacement, still))
        now, expected = simulation.surface_now(), deform(model, surface, displacement)
        # Roots and divisions are rounded otherwise on a device; positions are up to 400 mm.
        np.testing.assert_allclose(now.vertices_mm, expected.vertices_mm, atol=2 * EPS * 400)
        np.testing.assert_allclose(now.normals, expected.normals, atol=100 * EPS)
        assert (now.tangents is None) == (not tangents)
        if tangents:
            np.testing.assert_allclose(now.tangents, expected.tangents, atol=100 * EPS)
