"""The stability bound against the true highest frequency, from a dense eigenvalue solver."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.model import make_model
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.step_size import checked_step, default_step, step_limit
from tests.simulator.lattices import block, random_models, stiffness_matrix


def omega_max(model, *, fixed=True):
    """Highest angular frequency, 1/s."""
    root = np.repeat(1 / np.sqrt(model.node_mass.astype(float)), 3)
    free = np.repeat(~model.node_is_fixed, 3) if fixed else slice(None)
    A = (root[:, None] * stiffness_matrix(model) * root)[free][:, free]
    return np.sqrt(np.linalg.eigvalsh((A + A.T) / 2).max(initial=0.0)) / model.units.time_s


@settings(max_examples=25, deadline=None)
@given(random_models())
def test_true_frequency_never_exceeds_the_bound(model):
    if model.node_count > 160:
        model = make_model(
            model.cells[:30], coverage=model.cell_coverage[:30], stiffness_kpa=30 * model.cell_stiffness[:30]
        )
    # The finite differences of the stiffness matrix are good to about 1e-9.
    assert omega_max(model) <= 2 / step_limit(model) * (1 + 1e-6)


def test_bound_is_reached_by_a_lone_cell_and_a_bulk_stays_below():
    """omega^2 = 20 k/m for one cell, 12 k/m in an endless lattice."""
    lone, bulk = block(1, 1, 1), block(4, 4, 4)
    assert omega_max(lone) == pytest.approx(2 / step_limit(lone), rel=1e-6)
    assert omega_max(bulk) ** 2 < 20.0 / bulk.units.time_s**2


def test_default_step_in_seconds():
    """0.8 x 2 / sqrt(24 k/m) with k/m = 0.4 E / (rho h^2): 0.34 ms at 3.5 mm, 0.24 ms at 2.5 mm."""
    for cell_mm in (3.5, 2.5):
        rate = 0.4 * 30e3 / (1060 * (cell_mm * 1e-3) ** 2)
        model = block(2, 1, 1, cell_mm=cell_mm)
        assert default_step(model) == pytest.approx(1.6 / np.sqrt(24 * rate), rel=1e-6)
        assert step_limit(model) == pytest.approx(2 / np.sqrt(20 * rate), rel=1e-6)


def test_quickest_cell_sets_the_bound():
    model = make_model([(0, 0, 0), (9, 0, 0)], stiffness_kpa=[30.0, 90.0], density_kg_m3=[500.0, 1000.0], cell_mm=3.0)
    rate = 0.4 * 90e3 / (1000 * 9e-6)
    assert step_limit(model) == pytest.approx(2 / np.sqrt(20 * rate), rel=1e-6)


@pytest.mark.parametrize("factor", [1.001, 10.0, -0.5, 0.0, np.nan, np.inf])
def test_step_beyond_the_bound_is_refused_and_the_bound_is_stated(factor):
    model = block(2, 2, 2)
    limit = step_limit(model)
    with pytest.raises(SimulationError, match=f"{limit:.6g}"):
        Simulation(model, step_s=factor * limit)


def test_step_at_the_bound_is_taken():
    model = block(2, 2, 2)
    assert checked_step(model, step_limit(model)) == step_limit(model)
