"""The force laws against scikit-fem's quadratic hexahedra, Lame and beam theory; `heartcase bench elasticity` has more.

A bound is the error measured at that size of cells, in the comment, and a margin: a law that gets worse fails.
"""

from __future__ import annotations

import functools
import importlib
from types import SimpleNamespace

import numpy as np
import pytest

from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.lattice.moduli import ForceLaw
from tests.simulator.lattices import block_cells
from tests.thoroughly import thoroughly

NAMES = ("statics", "elasticity_scenes", "elasticity_voxels", "elasticity_shells", "elasticity_strips")
THICKNESS_MM = 10.0


@pytest.fixture(scope="module")
def lab():
    """The benchmark's modules that need no scikit-fem."""
    return SimpleNamespace(**{name: importlib.import_module(f"benchmarks.{name}") for name in NAMES})


@pytest.fixture(scope="module")
def truth(lab):
    pytest.importorskip("skfem")
    return importlib.import_module("benchmarks.elasticity_truth")


@pytest.fixture(scope="module")
def over_truth(lab, truth):
    """What a lattice measures over what finite elements do, in small strain; the truth of a scene is made once."""

    @functools.cache
    def finite_elements(name, ratio):
        scene = lab.elasticity_scenes.scene(name, is_large=False)
        return truth.solve_box(scene, "linear", ForceLaw("element", ratio), 2)

    return lambda name, law, cells: measured(lab, name, law, cells) / finite_elements(name, law.poissons_ratio)


def measured(lab, name, law, cells, is_large=False):
    """What a scene measures of the lattice."""
    scene = lab.elasticity_scenes.scene(name, is_large)
    model = lab.elasticity_scenes.lattice_of(scene, cells, law, THICKNESS_MM)
    return lab.elasticity_scenes.solve_lattice(scene, model, cells)


@pytest.mark.parametrize("material", ["neo_hooke", "our_energy"])
def test_both_energies_are_hookes_at_rest(lab, truth, material):
    """Their tangent, put together here, is the matrix that scikit-fem makes of its own form of linear elasticity."""
    law = ForceLaw("element", 0.45)
    solid = truth.Solid(truth.box_mesh(lab.elasticity_scenes.scene("bar", False), 1))
    ours = solid.tangent(np.zeros_like(solid.points), truth.MATERIALS[material], law)
    library = solid.elastic_matrix(law)
    assert abs(ours - library).max() < 1e-12 * abs(library).max()


@pytest.mark.parametrize("ratio", [0.25, 0.45, 0.49])
def test_energies_follow_their_derivatives(truth, ratio):
    """Stress and its slope agree by differences in large strain."""
    law = ForceLaw("element", ratio)
    generator = np.random.default_rng(3)
    F = np.eye(3) + generator.uniform(-0.3, 0.3, (20, 3, 3))
    turn = generator.normal(size=(20, 3, 3))
    for material in truth.MATERIALS.values():
        _, slope = material(F, law.shear_modulus, law.lame_modulus)
        ends = [material(F + sign * 1e-6 * turn, law.shear_modulus, law.lame_modulus)[0] for sign in (1.0, -1.0)]
        expected = np.einsum("nijkl,nkl->nij", slope, turn)
        np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


# Measured: 0.4% and 1.3% too stiff; springs with their volume term are 19% and more.
@pytest.mark.parametrize(("ratio", "bound"), [(0.25, 0.01), (0.49, 0.03)])
def test_elements_bend_two_cells_thick(over_truth, ratio, bound):
    assert over_truth("cantilever", ForceLaw("element", ratio), 2) == pytest.approx(1.0, abs=bound)


# Measured: springs 0.6% and 2.1%, elements 0.3% and 1.0% too stiff: what a clamp of few nodes costs.
@pytest.mark.parametrize(
    ("law", "bound"),
    [
        (ForceLaw("springs", 0.25), 0.01),
        (ForceLaw("springs", 0.45), 0.03),
        (ForceLaw("element", 0.25), 0.005),
        (ForceLaw("element", 0.45), 0.015),
    ],
)
def test_a_clamped_bar_stretches(over_truth, law, bound):
    assert over_truth("bar", law, 2) == pytest.approx(1.0, abs=bound)


# Measured: 7.4% too stiff, and the truth's own mesh leaves 1%; springs 12%.
def test_elements_yield_to_a_punch(over_truth):
    assert over_truth("indentation", ForceLaw("element", 0.25), 3) == pytest.approx(1.0, abs=0.09)


# The warping of a square section, yz^3 - y^3 z, is nil at every node of one or two cells: 1/6 for 0.1406, 18.6%.
@pytest.mark.parametrize(("cells", "excess"), [(2, 0.186), (4, 0.052)])
def test_elements_twist_as_far_as_their_nodes_can_warp(lab, cells, excess):
    scenes = lab.elasticity_scenes
    wanted = scenes.saint_venant_torque(scenes.BAR_LENGTH, scenes.TWIST, 0.45)
    torque = measured(lab, "torsion", ForceLaw("element", 0.45), cells)
    assert torque / wanted - 1.0 == pytest.approx(excess, abs=0.01)


def test_scikit_fem_twists_as_saint_venant_says(lab, truth):
    """The truth has a truth: its mesh leaves 0.12%."""
    scenes = lab.elasticity_scenes
    torque = truth.solve_box(scenes.scene("torsion", is_large=False), "linear", ForceLaw("element", 0.25), 2)
    wanted = scenes.saint_venant_torque(scenes.BAR_LENGTH, scenes.TWIST, 0.25)
    assert torque == pytest.approx(wanted, rel=2e-3)


# Measured: 0.3% and 1% too stiff; with neo-Hooke's energy for ours the first would be 5.5% off.
@pytest.mark.parametrize(("name", "bound"), [("bar", 0.005), ("cantilever", 0.01)])
def test_elements_in_large_strain_follow_their_energy(lab, truth, name, bound):
    """A bar stretched by half, a cantilever whose tip goes aside by half its length, one cell thick."""
    law = ForceLaw("element", 0.25)
    wanted = truth.solve_box(lab.elasticity_scenes.scene(name, is_large=True), "our_energy", law, 1)
    assert measured(lab, name, law, 1, is_large=True) == pytest.approx(wanted, rel=bound)


# Measured, two cells through the wall: apex 1.6% and volume 2.0% too far; springs 18% too far and 8% too little.
def test_a_ventricle_fills(lab, truth):
    shells, law = lab.elasticity_shells, ForceLaw("element", 0.25)
    wanted = truth.solve_ventricle(shells.VENTRICLE_INNER, shells.VENTRICLE_OUTER, law, 2)
    apex, change = np.array(shells.solve_ventricle(shells.ventricle(2, law), 2)) / wanted
    assert apex == pytest.approx(1.0, abs=0.03)
    assert change == pytest.approx(1.0, abs=0.03)


# Measured, too wide: 2.8%, 1.0% and, in a wall half a cell thick around 2.5 cells, 4.8%, as the strain around a node is
# of directions that turn with the wall: 1.1% where it is a cell thick and 5 around. Springs in the first 10% less.
@pytest.mark.parametrize(
    ("wall", "cells", "ratio", "bound"),
    [(0.5, 1, 0.25, 0.03), (0.5, 2, 0.45, 0.015), (0.2, 0.5, 0.45, 0.055), (0.2, 1, 0.45, 0.015)],
)
def test_a_tube_widens_as_lame_says(lab, wall, cells, ratio, bound):
    shells = lab.elasticity_shells
    model = shells.tube(wall, cells, ForceLaw("element", ratio))
    assert shells.solve_tube(model, wall, cells) == pytest.approx(shells.tube_truth(wall, ratio), rel=bound)


@pytest.mark.parametrize("name", ["springs", "element"])
@pytest.mark.parametrize("ratio", [0.25, 0.35, 0.45, 0.49])
def test_tension_has_the_modulus_and_the_ratio_that_were_asked_for(lab, name, ratio):
    """A uniform strain is exact in full cells; moments and spring weights are rounded to float32."""
    model = make_model(block_cells(3, 2, 2), law=ForceLaw(name, ratio))
    is_led, where = model.node_index == 0, np.zeros((model.node_count, 3))
    is_led[model.node_index[:, 0] == 3, 0] = True
    where[model.node_index[:, 0] == 3, 0] = 3e-3
    held = (np.flatnonzero(is_led), where[is_led])
    u, reaction = lab.statics.solve_linear(lab.statics.stiffness(model), np.zeros(where.shape), held)
    i, j, k = model.node_index.T
    assert reaction[i == 3, 0].sum() / 4 / 1e-3 == pytest.approx(model.law.youngs_modulus, rel=1e-6)
    assert -u[j == 2, 1] / 2 / 1e-3 == pytest.approx(ratio, rel=1e-6)
    assert -u[k == 2, 2] / 2 / 1e-3 == pytest.approx(ratio, rel=1e-6)


@pytest.mark.parametrize("thick", [1, 2, 3, 4])
@pytest.mark.parametrize("ratio", [0.25, 0.49])
def test_elements_bend_exactly_under_a_pure_moment(lab, thick, ratio):
    """w = M L^2 / (2 E I) under a linear traction, up to the float32 of the moments: 1e-7 in 1/12."""
    length = 10 * thick
    model = make_model(block_cells(length, thick, thick), law=ForceLaw("element", ratio))
    i, j, k = model.node_index.T
    is_held = np.zeros((model.node_count, 3), np.bool_)
    is_held[i == 0, 0] = True
    is_held[(i == 0) & (j == 0) & (k == 0), 1:] = is_held[(i == 0) & (j == 0) & (k == thick), 1] = True
    corners = model.cell_corners[model.cells[:, 0] == length - 1][:, 1::2]
    # z from the middle: over a cell's face a linear traction gives a corner a quarter of its mean and 1/12 of its slope
    middle = model.cells[model.cells[:, 0] == length - 1, 2] + 0.5 - thick / 2
    load = np.zeros((model.node_count, 3))
    np.add.at(load[:, 0], corners, middle[:, None] / 4 + np.array([-1, -1, 1, 1]) / 24)
    held = (np.flatnonzero(is_held), np.zeros(is_held.sum()))
    u, _ = lab.statics.solve_linear(lab.statics.stiffness(model), load, held)
    # M = I for a traction of z.
    deflection = u[i == 0, 2].mean() - u[i == length, 2].mean()
    assert deflection == pytest.approx(length**2 / (2 * model.law.youngs_modulus), rel=1e-6)


STRIPS = [
    *((cells, angle, 0.0) for cells in (0.3, 0.5, 1, 2, 3) for angle in (0, 10, 20, 30, 45)),
    *((cells, *tilt) for cells in (0.3, 0.5, 1, 2, 3) for tilt in ((40, 30.0), (20, 35.26))),
]
"""Thickness in cells, tilt and roll in degrees."""


# Springs turn 0.05 of what a beam does at 0.3 cells, 0.9 at 3. The worst elements are those of 0.3 cells at 45 degrees:
# 0.54 where springs have 0.06, so that 0.97 of what may be is used.
@pytest.mark.parametrize(("cells", "angle_deg", "roll_deg"), thoroughly(STRIPS, *range(0, len(STRIPS), 4)))
def test_a_wall_askew_bends_with_at_most_half_of_the_springs_error(lab, cells, angle_deg, roll_deg):
    strip = lab.elasticity_strips.Strip(cells, angle_deg, roll_deg)
    model = strip.model(ForceLaw("element", 0.25), THICKNESS_MM / cells)
    error, of_springs = (
        abs(strip.rotation_over_beam(model.with_law(law)) - 1.0)
        for law in (model.law, ForceLaw("springs", guards_corners=False))
    )
    assert error <= 0.5 * of_springs
    assert of_springs > 0.1


# Where only slivers below 0.2% of a cell are left out. Measured: 0.02%.
@pytest.mark.parametrize(("cells", "angle_deg"), [(0.3, 30), (0.3, 45), (0.5, 20), (0.5, 45), (1, 30), (2, 45)])
def test_a_wall_askew_stretches_as_one_that_is_not(lab, cells, angle_deg):
    strip = lab.elasticity_strips.Strip(cells, angle_deg)
    model = strip.model(ForceLaw("element", 0.25), THICKNESS_MM / cells, coverage_min=0.002)
    assert model.shares_strain
    # what samples make of the strip's volume
    volume = model.cell_coverage.sum() / (lab.elasticity_strips.LENGTH * lab.elasticity_strips.WIDTH * cells)
    assert strip.stretch_over_bar(model) * volume == pytest.approx(1.0, abs=0.005)
