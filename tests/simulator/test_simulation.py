"""Hands, time, watchdog: what a caller of the simulation may rely on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.measures import elastic_energy_of, inverted_cells
from heartcase.simulator.forces.cell_energies import energies_in_cells
from heartcase.simulator.forces.cell_forces import cell_energies
from heartcase.simulator.forces.reference import elastic_energy, spring_forces
from heartcase.simulator.instruments.grab import nodes_in_reach
from heartcase.simulator.lattice.model import DIRECTIONS, make_model
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.watchdog import Watch
from tests.simulator.lattices import EPS, block, block_cells, oblique_geometry, random_field, random_models


def still(model):
    return np.zeros((model.node_count, 3), np.float32)


def cut_between(model, layer, *, rows=slice(None)):
    """The model without the springs from i <= layer to i > layer, of the nodes with j in ``rows``."""
    i = model.node_index[model.spring_nodes, 0]
    j = model.node_index[model.spring_nodes, 1]
    in_rows = np.isin(j, np.arange(100)[rows]).any(axis=1)
    return model.without_springs((i.min(axis=1) <= layer) & (i.max(axis=1) > layer) & in_rows)


def test_grab_holds_the_nodes_of_the_sphere():
    model = block(8, 8, 8, geometry=oblique_geometry())
    rest = model.rest_positions_mm()
    centre, radius = rest[300] + 0.1, 2.2 * model.cell_mm
    held = nodes_in_reach(model, still(model), centre, radius)
    np.testing.assert_array_equal(held, np.flatnonzero(np.linalg.norm(rest - centre, axis=1) <= radius))


@pytest.mark.parametrize("side", [-1, 1])
def test_grab_does_not_bridge_a_cut(side):
    model = cut_between(block(9, 5, 5, cell_mm=2.0), layer=4)
    centre = np.array([9.0 + 0.5 * side, 5.0, 5.0])
    held = nodes_in_reach(model, still(model), centre, 5.0)
    i = model.node_index[held, 0]
    assert (i <= 4).all() if side < 0 else (i > 4).all()
    assert len(held) > 20


def test_grab_does_not_reach_around_a_cut():
    """The tissue is still whole beyond the incision, but the way around it is longer than the hand is wide."""
    model = cut_between(block(9, 12, 1, cell_mm=1.0), layer=4, rows=slice(0, 8))
    held = nodes_in_reach(model, still(model), np.array([4.4, 2.0, 0.5]), 2.5)
    assert (model.node_index[held, 0] <= 4).all()
    whole = nodes_in_reach(block(9, 12, 1, cell_mm=1.0), still(model), np.array([4.4, 2.0, 0.5]), 2.5)
    assert (model.node_index[whole, 0] > 4).any()


def test_grab_of_nothing_says_how_far_the_tissue_is():
    model = block(2, 2, 2, cell_mm=1.0)
    with pytest.raises(SimulationError, match=r"8\.0 mm"):
        nodes_in_reach(model, still(model), (10.0, 1.0, 1.0), 3.0)
    with pytest.raises(SimulationError, match="fixed"):
        nodes_in_reach(block(2, 2, 2, fix_base=True, cell_mm=1.0), still(model), (1.0, 1.0, 0.0), 0.5)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_grabbed_nodes_follow_the_hand_and_fixed_ones_stay(backend):
    model = block(5, 4, 4, fix_base=True, geometry=oblique_geometry())
    simulation = Simulation(model, backend=backend)
    top = model.rest_positions_mm()[model.node_index[:, 2] == 4].mean(axis=0)
    grab = simulation.grab(top, 1.5 * model.cell_mm)
    offset = np.array([0.4, -0.7, 0.5])
    for part in (0.5, 1.0):
        simulation.lead(grab, part * offset)
        simulation.step(40)
    moved = simulation.displacement_mm()
    np.testing.assert_allclose(moved[grab.nodes], np.broadcast_to(offset, (len(grab.nodes), 3)), atol=4 * EPS)
    np.testing.assert_array_equal(moved[model.node_is_fixed], 0.0)
    free = ~model.node_is_fixed
    free[grab.nodes] = False
    assert (np.linalg.norm(moved[free], axis=1) > 0).any()


def test_hand_goes_in_a_straight_line():
    """Half the steps bring half the way, to the rounding of adding up the steps."""
    model = block(4, 4, 4, fix_base=True, cell_mm=2.0)
    one, two = (Simulation(model) for _ in range(2))
    grabs = [simulation.grab((4.0, 4.0, 8.0), 3.0) for simulation in (one, two)]
    one.lead(grabs[0], (1.0, 0.0, 0.0))
    one.step(60)
    two.lead(grabs[1], (0.5, 0.0, 0.0))
    two.step(30)
    two.lead(grabs[1], (1.0, 0.0, 0.0))
    two.step(30)
    np.testing.assert_allclose(one.displacement_mm(), two.displacement_mm(), atol=60**2 * EPS)


@settings(max_examples=10, deadline=None)
@given(random_models(), st.integers(0, 2**32 - 1))
def test_force_on_a_hand_is_that_of_the_springs(model, seed):
    simulation = Simulation(model)
    simulation.restore(State(random_field(model, seed, 0.1), still(model)))
    free = np.flatnonzero(~model.node_is_fixed)
    if not len(free):
        return
    position = simulation.positions_mm()[free[0]]
    grab = simulation.grab(position, 0.8 * model.cell_mm)
    expected = spring_forces(model, simulation.state.displacement)[grab.nodes].sum(axis=0) * model.units.force_n
    scale = 18 * 0.4 * model.units.force_n * len(grab.nodes)
    np.testing.assert_allclose(simulation.force_on(grab), expected, atol=40 * EPS * scale)


def test_force_pulls_the_hand_back_with_the_force_of_theory():
    """A bar on a fixed base, stretched slowly by a hand on its whole top: F = E A strain (fixed ends add a little)."""
    model = block(2, 2, 12, fix_base=True, cell_mm=2.0, stiffness_kpa=30.0)
    simulation = Simulation(model, damping_per_s=60.0)
    top = model.node_index[:, 2] == 12
    grab = simulation.grab((2.0, 2.0, 25.8), 3.4)
    np.testing.assert_array_equal(grab.nodes, np.flatnonzero(top))
    simulation.lead(grab, (0.0, 0.0, 0.24))
    simulation.step(2000)
    simulation.step(2000)
    force = simulation.force_on(grab)
    expected = -30e3 * (4e-3) ** 2 * 0.01
    assert force[2] == pytest.approx(expected, rel=0.06)
    assert np.abs(force[:2]).max() < 0.01 * abs(expected)


def test_released_tissue_relaxes_back():
    model = block(5, 5, 5, fix_base=True, cell_mm=3.0)
    simulation = Simulation(model, damping_per_s=60.0)
    grab = simulation.grab((7.5, 7.5, 15.0), 4.5)
    simulation.lead(grab, (1.0, 0.0, 2.0))
    simulation.step(300)
    pulled = np.abs(simulation.displacement_mm()).max()
    assert pulled > 1.9
    simulation.release(grab)
    assert simulation.grabs == []
    simulation.step(6000)
    # The slowest mode of such a block is underdamped: the envelope is exp(-c t / 2), here exp(-52).
    assert np.abs(simulation.displacement_mm()).max() < 1e-3 * pulled
    energy = simulation.energy()
    assert energy.total_j < 1e-6 * model.units.energy_j


def test_two_hands_do_not_share_nodes():
    model = block(6, 3, 3, cell_mm=2.0)
    simulation = Simulation(model)
    left = simulation.grab((4.0, 3.0, 3.0), 3.0)
    right = simulation.grab((7.0, 3.0, 3.0), 3.0)
    assert not set(left.nodes) & set(right.nodes)
    with pytest.raises(SimulationError, match="another hand"):
        simulation.grab((4.0, 2.0, 2.0), 1.0)
    assert simulation.grabs == [left, right]


def test_snapshot_and_restore_repeat_the_same_bytes():
    model = block(6, 5, 4, fix_base=True)
    simulation = Simulation(model)
    simulation.restore(State(random_field(model, 1, 0.05), still(model)))
    simulation.step(50)
    snapshot = simulation.state
    simulation.step(50)
    first = simulation.state
    simulation.restore(snapshot)
    assert simulation.step_count == 50
    simulation.step(50)
    assert simulation.state.displacement.tobytes() == first.displacement.tobytes()
    assert simulation.state.velocity.tobytes() == first.velocity.tobytes()
    assert simulation.time_s == pytest.approx(100 * simulation.step_s)


@pytest.mark.parametrize("backend", ["cpu", "reference", "cuda"])
def test_a_snapshot_brings_back_what_was_cut_and_takes_away_what_was_joined(backend):
    model = block(4, 3, 3, fix_base=True)
    simulation = Simulation(model, backend=backend)
    hand = simulation.grab((0.0, 0.0, 7.5), 3.0)
    simulation.lead(hand, (0.0, 0.0, 2.0))
    simulation.step(5)
    before = simulation.snapshot()
    simulation.release(hand)
    simulation.step(10)
    uncut = simulation.state
    simulation.remove_springs(np.arange(model.spring_count) % 3 == 0)
    simulation.add_springs([[0, model.node_count - 1]], 0.5)
    after = simulation.snapshot()
    simulation.step(10)
    cut = simulation.state
    simulation.restore(before)
    assert simulation.model.spring_count == model.spring_count
    assert simulation.model.explicit.count == 0
    assert simulation.model.cell_is_whole.all()
    assert simulation.grabs == [hand]
    simulation.release(hand)
    simulation.step(10)
    np.testing.assert_array_equal(simulation.state.displacement, uncut.displacement)
    simulation.restore(after)
    assert simulation.model.explicit.count == 1
    simulation.step(10)
    np.testing.assert_array_equal(simulation.state.displacement, cut.displacement)
    assert np.abs(cut.displacement - uncut.displacement).max() > 1e-3


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_snapshot_brings_back_instruments_as_they_were(backend):
    simulation = Simulation(block(6, 5, 4, fix_base=True, cell_mm=2.0), backend=backend)
    hand = simulation.grab((2.0, 4.0, 8.0), 4.0)
    probe = simulation.probe((10.0, 5.0, 12.0), 3.0)
    simulation.lead(hand, (0.5, 0.0, 1.0), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    simulation.step(15)
    simulation.lead(hand, (0.5, 1.0, 1.0))
    simulation.move(probe, (10.0, 5.0, 9.5))
    before = simulation.snapshot()
    held, pose, centre = hand.nodes, hand.pose, probe.centre
    ends = []
    for _ in range(2):
        simulation.step(20)
        ends.append((simulation.state.displacement.tobytes(), simulation.state.velocity.tobytes()))
        simulation.lead(hand, (0.0, 0.0, 0.0))
        simulation.move(probe, (10.0, 5.0, 12.0))
        simulation.release(hand)
        simulation.withdraw(probe)
        other = simulation.grab((11.0, 4.0, 8.0), 3.0, name="other")
        simulation.step(7)
        simulation.restore(before)
        assert simulation.instruments == (hand, probe)
        assert hand.nodes is held
        assert hand.pose is pose
        assert probe.centre is centre
        with pytest.raises(SimulationError, match="has let go"):
            simulation.lead(other, (0.0, 0.0, 0.0))
    assert ends[0] == ends[1]
    simulation.restore(before.state)
    assert simulation.instruments == ()


def test_torque_is_that_of_the_forces_about_the_centre():
    """Against the sum of moments node by node, in mm and N, from the reference's spring forces."""
    model = block(6, 5, 4, fix_base=True, geometry=oblique_geometry())
    simulation = Simulation(model, damping_per_s=0.0)
    rest = model.rest_positions_mm()
    corner = rest[(model.node_index == [0, 2, 4]).all(axis=1)][0]
    up = model.geometry.direction_matrix[:, 2] * model.cell_mm
    hand = simulation.grab(corner + 0.3, 1.6 * model.cell_mm)
    simulation.lead(hand, 0.4 * up + 0.2)
    centre_mm = corner + 0.3 + 0.4 * up + 0.2
    simulation.step(60)
    nodes = hand.nodes
    assert len(nodes) >= 2
    force = spring_forces(model, simulation.state.displacement)[nodes]
    force_n = force @ model.geometry.direction_matrix.T * model.units.force_n
    arms = simulation.positions_mm()[nodes] - centre_mm
    wrench = simulation.wrench_on(hand)
    scale = np.abs(force_n).sum()
    np.testing.assert_allclose(wrench.force_n, force_n.sum(axis=0), atol=1e-5 * scale)
    np.testing.assert_allclose(wrench.torque_n_mm, np.cross(arms, force_n).sum(axis=0), atol=1e-4 * scale)
    assert np.abs(wrench.torque_n_mm).max() > 0.01 * scale


def test_what_is_of_another_lattice_is_not_restored():
    simulation = Simulation(block(4, 3, 3))
    hand = simulation.grab((0.0, 0.0, 0.0), 3.0)
    other = Simulation(block(3, 3, 4))
    taller = Simulation(block(4, 3, 4))
    for point in (other.snapshot(), taller.snapshot(), taller.state):
        with pytest.raises(SimulationError, match="of another lattice"):
            simulation.restore(point)
    assert simulation.grabs == [hand]
    loose = Simulation(simulation.model, step_s=simulation.step_s / 10)
    loose.add_springs([[0, simulation.model.node_count - 1]], 2000.0)
    with pytest.raises(SimulationError, match="not stable"):
        simulation.restore(loose.snapshot())
    assert simulation.model.explicit.count == 0


def test_watchdog_stops_and_goes_back():
    model = block(4, 4, 4, fix_base=True)
    simulation = Simulation(model)
    velocity = still(model)
    velocity[-1] = np.nan
    before = State(still(model), velocity, 7)
    simulation.restore(before)
    with pytest.raises(SimulationError, match="broke down between"):
        simulation.step(10)
    assert simulation.step_count == 7
    np.testing.assert_array_equal(simulation.state.velocity, velocity)


def test_nodes_that_are_held_back_and_cells_inside_out_are_counted():
    model = block(4, 4, 4, fix_base=True)
    simulation = Simulation(model)
    assert simulation.watch() == Watch(0, 0)
    velocity, displacement = still(model), still(model)
    velocity[-1] = 1e4
    simulation.restore(State(displacement, velocity))
    simulation.step()
    assert simulation.watch().hurried_node_count == 1
    assert np.abs(simulation.state.displacement).max() == pytest.approx(0.5, rel=1e-5)
    displacement[-1] = -1.0
    simulation.restore(State(displacement, still(model)))
    assert simulation.watch() == Watch(inverted_cell_count=1, hurried_node_count=0)


@pytest.mark.parametrize("damping", [-1.0, 1e6, np.nan, np.inf])
def test_damping_that_would_turn_velocities_round_is_refused(damping):
    with pytest.raises(SimulationError, match="one over the step"):
        Simulation(block(1, 1, 1), damping_per_s=damping)


def test_inverted_cells_are_found():
    model = block(3, 3, 3)
    assert not inverted_cells(model, still(model)).any()
    pushed = still(model)
    corner = int(np.flatnonzero((model.node_index == 0).all(axis=1))[0])
    # The corner's three neighbours span the plane x + y + z = 1.
    pushed[corner] = 0.33
    assert not inverted_cells(model, pushed).any()
    pushed[corner] = 0.34
    assert inverted_cells(model, pushed).tolist() == [True] + [False] * 26
    mirrored = still(model)
    mirrored[:, 0] = -2 * model.node_index[:, 0]
    assert inverted_cells(model, mirrored).all()


@settings(max_examples=20, deadline=None)
@given(random_models(), st.integers(0, 2**32 - 1))
def test_elastic_energy_is_that_of_the_reference(model, seed):
    displacement = random_field(model, seed, 0.3)
    for law in (model.law, ForceLaw("springs", 0.4), ForceLaw("element", 0.3)):
        model = model.with_law(law)
        assert elastic_energy_of(model, displacement) == pytest.approx(elastic_energy(model, displacement), rel=1e-12)


@settings(max_examples=20, deadline=None)
@given(random_models(), st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.3, 2.0]), st.booleans())
def test_energies_in_cells_are_those_of_the_formulas(model, seed, size, is_masked):
    # cells are turned through where displacements are large
    displacement = random_field(model, seed, size)
    cells = np.random.default_rng(seed).random(model.cell_count) < 0.5 if is_masked else None
    laws = (("springs", 0.25, True), ("springs", 0.4, True), ("element", 0.3, True), ("element", 0.45, False))
    for name, ratio, shares in laws:
        model = model.with_law(ForceLaw(name, ratio, shares_strain=shares))
        expected = cell_energies(model, displacement, cells)
        found = energies_in_cells(model, displacement, cells)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max(initial=0.0))


def test_missing_surface_is_named():
    simulation = Simulation(block(1, 1, 1))
    with pytest.raises(SimulationError, match="surface"):
        simulation.surface_now()
    with pytest.raises(SimulationError, match="picking"):
        simulation.picking_now()


def test_interior_springs_have_weight_one_in_nine_directions():
    model = block(4, 4, 4)
    inner = (np.abs(model.node_index[model.spring_nodes] - 2) <= 1).all(axis=(1, 2))
    np.testing.assert_allclose(model.spring_weight[inner], 1.0)
    assert len(np.unique(model.spring_direction[inner])) == len(DIRECTIONS) == 9
    assert model.spring_weight.sum() == pytest.approx(64 * (12 / 4 + 12 / 2))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cells": np.zeros((0, 3))}, "no tissue cell"),
        ({"cells": [(0, 0, 0), (0, 0, 0)]}, "twice"),
        ({"coverage": 0.0}, "coverage"),
        ({"coverage": 1.5}, "coverage"),
        ({"stiffness_kpa": -1.0}, "Young's modulus"),
        ({"density_kg_m3": np.nan}, "density"),
        ({"fixed": np.zeros(3, bool)}, "8 nodes"),
        ({"geometry": oblique_geometry().flipped(0)}, "right-handed"),
    ],
)
def test_wrong_lattices_are_refused(options, message):
    with pytest.raises(SimulationError, match=message):
        make_model(**{"cells": block_cells(1, 1, 1), **options})
