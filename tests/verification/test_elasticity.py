"""The cell lattice against linear elasticity: E as given, Poisson's ratio 1/4, for every shape of full cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.forces.reference import elastic_energy
from heartcase.simulator.lattice.model import make_model
from tests.simulator.lattices import block, random_models, stiffness_matrix

E_KPA = 30.0
STRAIN = 1e-3


def stretch(model, size):
    """Static solution in small strain: both i faces led apart, all else free, rigid motion pinned.

    Returns the force on a face [grid units] and the contraction across j and k.
    """
    K = stiffness_matrix(model)
    i, j, k = model.node_index.T
    number = {tuple(index): n for n, index in enumerate(model.node_index.tolist())}
    led = {3 * n: 0.0 for n in np.flatnonzero(i == 0)} | {3 * n: STRAIN * size[0] for n in np.flatnonzero(i == size[0])}
    led |= {3 * number[0, 0, 0] + 1: 0.0, 3 * number[0, 0, 0] + 2: 0.0, 3 * number[0, size[1], 0] + 2: 0.0}
    held = np.array(sorted(led))
    free = np.setdiff1d(np.arange(len(K)), held)
    u = np.zeros(len(K))
    u[held] = [led[dof] for dof in held]
    u[free] = np.linalg.solve(K[np.ix_(free, free)], -K[np.ix_(free, held)] @ u[held])
    u = u.reshape(-1, 3)
    pull = (K @ u.ravel()).reshape(-1, 3)[i == size[0], 0].sum()
    across_j = u[j == size[1], 1].mean() - u[j == 0, 1].mean()
    across_k = u[k == size[2], 2].mean() - u[k == 0, 2].mean()
    return pull, -across_j / (size[1] * STRAIN), -across_k / (size[2] * STRAIN)


@pytest.mark.parametrize("size", [(5, 4, 1), (1, 1, 1), (6, 1, 1), (3, 3, 3), (4, 3, 2)])
def test_uniaxial_stretch_gives_modulus_and_poisson_ratio(size):
    cell_mm = 2.5
    model = block(*size, stiffness_kpa=E_KPA, cell_mm=cell_mm)
    pull, ratio_j, ratio_k = stretch(model, size)
    area_m2 = size[1] * size[2] * (cell_mm * 1e-3) ** 2
    modulus_kpa = pull * model.units.force_n / area_m2 / STRAIN / 1e3
    assert modulus_kpa == pytest.approx(E_KPA, rel=1e-3)
    assert ratio_j == pytest.approx(0.25, rel=1e-3)
    assert ratio_k == pytest.approx(0.25, rel=1e-3)


def test_simple_shear_gives_the_shear_modulus():
    """Force on the top of a block whose boundary follows u_x = gamma z is G gamma per area, G = E / (2 (1 + 1/4))."""
    n = 4
    model = block(n, n, n, stiffness_kpa=E_KPA, cell_mm=3.0)
    K = stiffness_matrix(model)
    gamma = 1e-3
    u = np.zeros((model.node_count, 3))
    u[:, 0] = gamma * model.node_index[:, 2]
    force = (K @ u.ravel()).reshape(-1, 3)
    inside = ((model.node_index > 0) & (model.node_index < n)).all(axis=1)
    np.testing.assert_allclose(force[inside], 0.0, atol=1e-9)
    top = force[model.node_index[:, 2] == n, 0].sum() * model.units.force_n
    shear_kpa = top / (n * n * (3e-3) ** 2) / gamma / 1e3
    assert shear_kpa == pytest.approx(E_KPA / 2.5, rel=1e-3)


@settings(max_examples=40, deadline=None)
@given(random_models(), st.integers(0, 2**32 - 1))
def test_energy_of_any_uniform_strain_is_that_of_an_isotropic_solid(model, seed):
    """W = lambda/2 tr(e)^2 + mu e:e with lambda = mu = 0.4 E, over the tissue's volume, for any cells and coverage."""
    size = 1e-5
    gradient = np.random.default_rng(seed).uniform(-size, size, (3, 3))
    e = (gradient + gradient.T) / 2
    density_per_E = 0.4 * (np.trace(e) ** 2 / 2 + (e * e).sum())
    # In grid units k is 1, so that the stiffest cell's E is 2.5.
    expected = 2.5 * (model.cell_coverage.astype(float) * model.cell_stiffness).sum() * density_per_E
    # The lattice is exact in second order; the third is of the order of the strain.
    assert elastic_energy(model, model.node_index @ gradient.T) == pytest.approx(expected, rel=100 * size)


def test_mass_is_density_times_covered_volume():
    coverage = np.array([1.0, 0.25, 0.5])
    density = np.array([1000.0, 1200.0, 1100.0])
    model = make_model([(0, 0, 0), (1, 0, 0), (5, 5, 5)], coverage=coverage, density_kg_m3=density, cell_mm=2.0)
    assert model.mass_kg == pytest.approx((coverage * density).sum() * 8e-9, rel=1e-6)
    assert model.tissue_volume_ml == pytest.approx(coverage.sum() * 8e-3, rel=1e-6)
