"""Stretch and stress against Hooke's law and the slopes of the energy."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.forces.reference import elastic_energy
from heartcase.simulator.incisions.strain import (
    cell_strain,
    peak,
    values_at_nodes,
    values_at_vertices,
    vertex_colours,
)
from heartcase.simulator.lattice.moduli import ForceLaw
from tests.simulator.lattices import block

LAWS = [ForceLaw("springs"), ForceLaw("springs", 0.4), ForceLaw("element"), ForceLaw("element", 0.4)]


def under(model, F):
    """Displacements of a uniform deformation."""
    return model.node_index @ (np.asarray(F, dtype=float) - np.eye(3)).T


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_a_small_pull_is_hookes(law):
    model = block(3, 2, 2, stiffness_kpa=42.0, coverage=0.6, law=law)
    pull = 1e-4
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    F = turn @ np.diag([1 + pull, 1 - law.poissons_ratio * pull, 1 - law.poissons_ratio * pull]) @ turn.T
    found = cell_strain(model, under(model, F))
    np.testing.assert_allclose(found.stress_kpa[:, 0], 42.0 * pull, rtol=2e-3)
    assert np.abs(found.stress_kpa[:, 1:]).max() < 2e-3 * 42.0 * pull
    np.testing.assert_allclose(found.stretches[:, 0], 1 + pull, rtol=1e-7)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_stretches_are_singular_values_and_rotation_changes_nothing(law):
    model = block(2, 2, 2, law=law)
    rng = np.random.default_rng(4)
    F = np.eye(3) + 0.2 * rng.normal(size=(3, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    found, turned = cell_strain(model, under(model, F)), cell_strain(model, under(model, turn @ F))
    np.testing.assert_allclose(found.stretches, np.tile(np.linalg.svd(F)[1], (model.cell_count, 1)))
    np.testing.assert_allclose(turned.stretches, found.stretches)
    np.testing.assert_allclose(turned.stress_kpa, found.stress_kpa, atol=1e-9)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_stress_does_the_work_that_the_energy_stores(law):
    """dW = V tr(sigma D): stretched along the principal axes, where sigma and D are known."""
    model = block(2, 3, 2, stiffness_kpa=20.0, law=law)
    stretches, step = np.array([1.4, 1.1, 0.85]), 1e-5
    stress = cell_strain(model, under(model, np.diag(stretches))).stress_kpa[0]
    volume_m3 = model.tissue_volume_ml * 1e-6 * stretches.prod()
    rates = np.array([1.0, 0.3, -0.5])
    energy = [
        elastic_energy(model, under(model, np.diag(stretches * (1 + sign * step * rates)))) * model.units.energy_j
        for sign in (-1, 1)
    ]
    assert stress @ rates * 1e3 * volume_m3 == pytest.approx((energy[1] - energy[0]) / (2 * step), rel=1e-5)


def test_a_cell_inside_out_and_a_flat_one_are_told():
    model = block(1, 1, 1)
    assert cell_strain(model, under(model, np.diag([1.0, 1.0, -0.5]))).stretches[0, 2] == pytest.approx(-0.5)
    assert np.isfinite(cell_strain(model, under(model, np.diag([1.0, 1.0, 0.0]))).stress_kpa).all()


def test_the_peak_is_where_the_tissue_is_pulled():
    model = block(6, 3, 3)
    displacement = np.zeros((model.node_count, 3))
    displacement[:, 0] = 0.05 * np.maximum(model.node_index[:, 0] - 4, 0) ** 2
    strain = cell_strain(model, displacement)
    found = peak(model, displacement, strain.stretches[:, 0], strain.is_known)
    assert found.value == pytest.approx(1.15)
    assert model.cells[found.cell, 0] == 5
    j, k = model.cells[found.cell, 1:]
    corners = model.cell_corners[found.cell]
    np.testing.assert_allclose(
        found.place_mm, (model.rest_positions_mm() + model.to_mm(displacement))[corners].mean(axis=0)
    )
    assert found.high <= found.value
    cut = model.without_springs((model.spring_nodes == model.cell_corners[found.cell, 7]).any(axis=1))
    again = cell_strain(cut, displacement)
    assert not again.is_known[found.cell]
    assert peak(cut, displacement, again.stretches[:, 0], again.is_known).cell != found.cell
    with pytest.raises(SimulationError):
        peak(model, displacement, strain.stretches[:, 0], np.zeros(model.cell_count, bool))
    assert (j, k) == (0, 0)


def test_values_go_to_vertices_by_their_weights():
    model = block(3, 2, 2)
    values = np.full(model.cell_count, 1.7)
    is_known = np.ones(model.cell_count, bool)
    is_known[0] = False
    values[0] = 99.0
    at_nodes = values_at_nodes(model, values, is_known)
    lone = model.cell_corners[0, 0]
    np.testing.assert_allclose(np.delete(at_nodes, lone), 1.7)
    assert at_nodes[lone] == 0.0
    nodes = np.array([[5, 6, 7], [1, 2, lone]], np.int32)
    at_vertices = values_at_vertices(nodes, [[0.2, 0.3, 0.5], [0.5, 0.25, 0.25]], at_nodes)
    np.testing.assert_allclose(at_vertices, [1.7, 0.75 * 1.7])


def test_colours_run_from_blue_to_red():
    colours = vertex_colours(np.array([-5.0, 1.0, 1.5, 2.0, 9.0]), 1.0, 2.0)
    assert colours.dtype == np.uint8
    np.testing.assert_array_equal(colours[0], colours[1])
    np.testing.assert_array_equal(colours[3], colours[4])
    assert colours[1, 2] > colours[1, 0]
    assert colours[3, 0] > colours[3, 2]
    with pytest.raises(SimulationError):
        vertex_colours(np.zeros(2), 1.0, 1.0)
