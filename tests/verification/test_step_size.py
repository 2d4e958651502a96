"""The stability bound against the true highest frequency, from a dense eigenvalue solver."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.linalg import eigsh

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.dynamics.step_size import StepSizes, checked_step, default_step, own_step_limit, step_limit
from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.simulation import Simulation
from tests.examples import few_and_many, hold_for
from tests.simulator.lattices import block, random_field, random_models, stiffness_matrix


def omega_max(model, *, fixed=True):
    """Highest angular frequency, 1/s."""
    root = np.repeat(1 / np.sqrt(model.node_mass.astype(float)), 3)
    free = np.repeat(~model.node_is_fixed, 3) if fixed else slice(None)
    A = (root[:, None] * stiffness_matrix(model) * root)[free][:, free]
    return np.sqrt(np.linalg.eigvalsh((A + A.T) / 2).max(initial=0.0)) / model.units.time_s


@few_and_many(5, 50)
def test_true_frequency_never_exceeds_the_bound(count):
    hold_for(count, true_frequency_is_within_the_bound, random_models())


def true_frequency_is_within_the_bound(model):
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
    limit = own_step_limit(model)
    with pytest.raises(SimulationError, match=f"{limit:.6g}"):
        Simulation(model, step_s=factor * limit)


def test_step_at_the_bound_is_taken():
    model = block(2, 2, 2)
    for limit in (step_limit(model), own_step_limit(model)):
        assert checked_step(StepSizes(model), limit) == limit


@few_and_many(40, 200)
def test_own_limit_is_hardly_below_the_true_one_and_never_above(count):
    """On so many shapes, springs removed from most of them, against a sparse eigenvalue solver."""
    hold_for(count, own_limit_is_near_the_true_one, random_models(), st.floats(0.0, 1.0), st.integers(0, 2**32 - 1))


def own_limit_is_near_the_true_one(model, cut, seed):
    random = np.random.default_rng(seed)
    model = model.without_springs(random.random(model.spring_count) < cut * random.random())
    o = model.spring_offset / model.spring_length[:, None]
    matrix = stiffness_over_mass(model, model.spring_weight[:, None, None] * o[:, :, None] * o[:, None, :])
    if matrix.shape[0] < 3 or matrix.nnz == 0:
        return
    true = 2.0 / np.sqrt(highest(matrix)) * model.units.time_s
    own = own_step_limit(model)
    assert own <= true * (1.0 + 1e-9) or own == step_limit(model)
    assert own >= 0.97 * true
    found = largest_eigenvalue(model)
    assert found.lower <= highest(matrix) * (1.0 + 1e-9) <= found.upper * (1.0 + 2e-9)


def stiffness_over_mass(model, blocks):
    """Springs of stiffness ``blocks``, (spring_count, 3, 3), over the roots of the masses of the free nodes, sparse."""
    rows, columns = np.meshgrid(range(3), range(3), indexing="ij")
    parts = []
    for a, b, sign in ((0, 0, 1.0), (1, 1, 1.0), (0, 1, -1.0), (1, 0, -1.0)):
        i = 3 * model.spring_nodes[:, a, None, None] + rows
        j = 3 * model.spring_nodes[:, b, None, None] + columns
        parts.append((sign * blocks, i + 0 * j, j + 0 * i))
    values, i, j = (np.concatenate([np.ravel(part[n]) for part in parts]) for n in range(3))
    count = 3 * model.node_count
    root = np.repeat(1.0 / np.sqrt(model.node_mass.astype(float)), 3)
    whole = sparse.diags(root) @ sparse.coo_array((values, (i, j)), shape=(count, count)).tocsr() @ sparse.diags(root)
    free = np.flatnonzero(np.repeat(~model.node_is_fixed, 3))
    return whole[free][:, free]


def highest(matrix):
    """Largest eigenvalue."""
    if matrix.shape[0] < 400:
        return float(np.linalg.eigvalsh(matrix.toarray())[-1])
    return float(eigsh(matrix, k=1, which="LA", tol=1e-12, return_eigenvectors=False)[0])


@settings(max_examples=30, deadline=None)
@given(random_models(size_max=(6, 3, 3)), st.integers(0, 2**32 - 1), st.sampled_from([0.1, 1.0, 10.0]))
def test_no_deformation_exceeds_the_bound_of_the_default_step(model, seed, scale):
    """Tangent stiffness w [(1 - L/l) (I - n n) + n n] of each spring, after Hooke, against a dense solver."""
    moved = (
        model.spring_offset + np.diff(random_field(model, seed, scale).astype(float)[model.spring_nodes], axis=1)[:, 0]
    )
    length = np.linalg.norm(moved, axis=1)
    n = moved / length[:, None]
    along = n[:, :, None] * n[:, None, :]
    across = (1.0 - model.spring_length / length)[:, None, None] * (np.eye(3) - along)
    matrix = stiffness_over_mass(model, model.spring_weight[:, None, None] * (along + across)).toarray()
    if len(matrix):
        rate = (model.cell_stiffness / model.cell_density).max()
        assert np.linalg.eigvalsh(matrix)[-1] <= 24.0 * rate * (1 + 1e-6)


def test_nothing_that_can_move_has_no_limit():
    cells = [(0, 0, 0)]
    assert own_step_limit(make_model(cells, fixed=True)) == np.inf


def test_a_bulk_may_take_longer_steps_than_a_lone_cell():
    """omega^2 = 12 k/m in an endless lattice, 20 k/m in a lone cell."""
    lone, bulk = block(1, 1, 1), block(12, 12, 12, fix_base=True)
    assert own_step_limit(lone) == pytest.approx(step_limit(lone), rel=1e-6)
    assert own_step_limit(bulk) > 1.1 * step_limit(bulk)
