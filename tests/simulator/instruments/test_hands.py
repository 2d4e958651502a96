"""Probes, poses, cuts and explicit springs: what a hand does besides pulling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.step_size import default_step, own_step_limit, step_limit
from heartcase.simulator.engine.cuda.intrinsics import IS_SIMULATED
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import EPS, block, oblique_geometry, random_models

ON_A_GPU = pytest.param(
    "cuda", marks=pytest.mark.skipif(IS_SIMULATED, reason="there is no GPU; tests/parity simulates one")
)


def turn_about(axis, angle):
    """Rotation matrix (Rodrigues)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


@pytest.mark.parametrize("backend", ["cpu", ON_A_GPU, "reference"])
def test_probe_pushes_nodes_out_and_feels_the_tissue(backend):
    """A long ellipsoid goes down into a block: no node is left inside, none is turned, and the force is upward."""
    model = block(6, 4, 4, fix_base=True, geometry=oblique_geometry((4, 4, 6)))
    simulation = Simulation(model, backend=backend, damping_per_s=60.0)
    frame = model.geometry.direction_matrix
    top = model.rest_positions_mm()[model.node_index[:, 2] == 4].mean(axis=0)
    up = frame[:, 2]
    axes = np.array([1.0, 2.5, 1.2]) * model.cell_mm
    probe = simulation.probe(top + 1.3 * model.cell_mm * up, axes, turn=frame)
    assert np.abs(simulation.force_on(probe)).max() == 0
    simulation.move(probe, top + 0.6 * model.cell_mm * up)
    simulation.step(40)
    position = simulation.positions_mm()[~model.node_is_fixed]
    away = np.linalg.norm((position - (top + 0.6 * model.cell_mm * up)) @ frame / axes, axis=1)
    assert away.min() > 1 - 1e-4
    assert simulation.inverted_cell_count() == 0
    force = simulation.force_on(probe)
    assert force @ up > 0.01 * model.units.force_n
    assert np.linalg.norm(force - (force @ up) * up) < 0.5 * (force @ up)
    simulation.withdraw(probe)
    simulation.withdraw(probe)
    assert simulation.probes == []


def zigzag(model, seed, *, speed, backend="cpu"):
    """Most cells turned inside out while a ball goes zigzag through tissue at some cells per step."""
    rng = np.random.default_rng(seed)
    simulation = Simulation(model, damping_per_s=30.0, backend=backend)
    place = model.rest_positions_mm()[rng.integers(model.node_count)]
    at = place + np.array([0, 0, 6]) * model.cell_mm
    probe = simulation.probe(at, 1.5 * model.cell_mm)
    worst = 0
    for _ in range(8):
        target = place + rng.uniform(-2, 2, 3) * model.cell_mm
        simulation.move(probe, target)
        simulation.step(max(1, int(np.linalg.norm(target - at) / (speed * model.cell_mm))))
        at = target
        worst = max(worst, simulation.inverted_cell_count())
    return worst


def test_movements_near_a_probe_are_kept_from_turning_cells_inside_out():
    """Through 196 cells on a fixed base."""
    model = block(7, 7, 4, fix_base=True)
    for speed in (0.05, 0.1, 1.0):
        assert [zigzag(model, seed, speed=speed) for seed in range(8)] == [0] * 8


@settings(max_examples=20, deadline=None)
@given(random_models(size_max=(8, 4, 4)), st.integers(0, 2**32 - 1), st.floats(0.02, 1.0))
def test_a_probe_breaks_no_tissue(model, seed, speed):
    """Any tissue, at up to a cell per step (some 10 m/s): the watchdog would raise."""
    zigzag(model, seed, speed=speed)


def test_a_ball_that_meets_nothing_changes_nothing():
    model = block(4, 4, 4, fix_base=True)
    ends = []
    for has_probe in (False, True):
        simulation = Simulation(model)
        hand = simulation.grab((7.0, 7.0, 14.0), 4.0)
        if has_probe:
            simulation.probe((7.0, 7.0, 60.0), 5.0)
        simulation.lead(hand, (1.0, 0.0, 1.0))
        simulation.step(50)
        ends.append(simulation.state.displacement.tobytes())
    assert ends[0] == ends[1]


@pytest.mark.parametrize("backend", ["cpu", "cuda", "reference"])
def test_grab_follows_a_turning_hand(backend):
    model = block(4, 3, 3, fix_base=True, geometry=oblique_geometry())
    simulation = Simulation(model, backend=backend)
    top = model.rest_positions_mm()[model.node_index[:, 2] == 3].mean(axis=0)
    hand = simulation.grab(top, 1.2 * model.cell_mm)
    before = simulation.positions_mm()[hand.nodes]
    turn, offset = turn_about((1, 2, 3), 0.3), np.array([0.2, 0.1, -0.3])
    simulation.lead(hand, offset, turn)
    simulation.step(4)
    expected = top + (before - top) @ turn.T + offset
    np.testing.assert_allclose(simulation.positions_mm()[hand.nodes], expected, atol=20 * EPS * model.cell_mm)


@pytest.mark.parametrize("turn", [np.diag([1, 1, -1]), np.zeros((3, 3)), np.full((3, 3), np.nan), np.eye(2)])
def test_what_is_no_rotation_is_refused(turn):
    simulation = Simulation(block(2, 2, 2))
    hand = simulation.grab((3.5, 3.5, 3.5), 4.0)
    with pytest.raises(SimulationError, match="rotation"):
        simulation.lead(hand, (0, 0, 0), turn)
    with pytest.raises(SimulationError, match="rotation"):
        simulation.probe((0, 0, 0), 4.0, turn=turn)
    assert simulation.probes == []


def test_all_that_is_wrong_with_a_probe_is_said_at_once():
    simulation = Simulation(block(2, 2, 2))
    with pytest.raises(SimulationError) as error:
        simulation.probe((np.nan, 0, 0), (1.0, 4.0, 4.0))
    assert len(error.value.problems) == 2
    probe = simulation.probe((0, 0, 0), 4.0)
    with pytest.raises(SimulationError, match="finite"):
        simulation.move(probe, (0, 0, np.inf))


def test_removed_springs_let_go():
    """A bar cut through falls apart: its two halves feel nothing of each other."""
    model = block(6, 1, 1)
    simulation = Simulation(model)
    i = model.node_index[model.spring_nodes, 0]
    simulation.remove_springs((i.min(axis=1) <= 3) & (i.max(axis=1) > 3))
    right = np.flatnonzero(model.node_index[:, 0] == 6)
    hand = simulation.grab(model.rest_positions_mm()[right].mean(axis=0), 0.8 * model.cell_mm)
    simulation.lead(hand, (3.0, 0.0, 0.0))
    simulation.step(100)
    moved = np.abs(simulation.displacement_mm()).max(axis=1)
    assert (moved[model.node_index[:, 0] <= 3] == 0).all()
    assert (moved[model.node_index[:, 0] > 3] > 0).all()
    with pytest.raises(SimulationError, match="one value for each"):
        simulation.remove_springs(np.zeros(3, bool))


@pytest.mark.parametrize("backend", ["cpu", "cuda", "reference"])
def test_explicit_spring_pulls_with_hookes_force_until_it_is_removed(backend):
    """Two cells that nothing else joins, at rest but for a spring of 20 mm between nodes 35 mm apart."""
    from heartcase.simulator.lattice.model import make_model

    model = make_model([(0, 0, 0), (10, 0, 0)])
    simulation = Simulation(model, backend=backend, damping_per_s=0.0)
    a, b = (int(np.flatnonzero((model.node_index == place).all(axis=1))[0]) for place in ((0, 0, 0), (10, 0, 0)))
    simulation.add_springs([(a, b)], 0.5, rest_length_mm=20.0)
    pull = simulation._engine.forces()[a] * model.units.force_n
    np.testing.assert_allclose(pull, (0.5 * 0.015, 0, 0), rtol=1e-5, atol=1e-12)
    simulation.step(1)
    expected = simulation.step_s**2 * 0.5 * 0.015 / (model.node_mass[a] * model.units.mass_kg) * 1e3
    np.testing.assert_allclose(simulation.displacement_mm()[a], (expected, 0, 0), rtol=1e-4, atol=1e-9)
    simulation.remove_explicit_springs([True])
    assert simulation.model.explicit.count == 0
    before = simulation.state.velocity.sum(axis=0)
    simulation.step(2)
    np.testing.assert_allclose(simulation.state.velocity.sum(axis=0), before, atol=1e-6)


def test_explicit_spring_is_at_rest_where_it_was_tied():
    model = block(3, 2, 2)
    simulation = Simulation(model)
    simulation.add_springs([(0, model.node_count - 1), (1, 7)], 1.0)
    simulation.step(20)
    assert np.abs(simulation.state.displacement).max() < 1e-5


def test_springs_too_stiff_for_the_step_are_refused_and_the_rest_is_stable():
    model = block(3, 3, 3)
    simulation = Simulation(model, damping_per_s=0.0)
    pairs = [(0, model.node_count - 1), (0, model.node_count - 2)]
    with pytest.raises(SimulationError, match="times as stiff"):
        simulation.add_springs(pairs, 1e4)
    assert simulation.model.explicit.count == 0
    stiffness = 1e-3
    while True:
        try:
            simulation.add_springs(pairs, stiffness, rest_length_mm=0.0)
        except SimulationError:
            break
        stiffness *= 2
    for _ in range(10):
        simulation.step(500)
    assert simulation.energy().total_j < 1e3 * model.units.energy_j


def test_limits_of_a_model_reckon_with_its_explicit_springs():
    """A spring between two corners of a lone cell, as stiff as the step of a millionth allows."""
    model = block(1, 1, 1)
    simulation = Simulation(model, step_s=1e-6)
    simulation.add_springs([(0, 7)], 1e6)
    for limit in (default_step, step_limit, own_step_limit):
        assert limit(simulation.model) < 1e-2 * limit(model)
    with pytest.raises(SimulationError, match="not stable"):
        Simulation(simulation.model, step_s=step_limit(model))
    coarse = Simulation(model, step_s=step_limit(model))
    with pytest.raises(SimulationError, match="leaves nothing"):
        coarse.add_springs([(0, 7)], 1.0)


def test_what_a_hand_holds_does_not_press_on_a_probe():
    model = block(4, 4, 4, fix_base=True)
    simulation = Simulation(model)
    hand = simulation.grab((7.0, 7.0, 14.0), 4.0)
    simulation.lead(hand, (0.0, 0.0, 2.0))
    simulation.step(20)
    top = hand.nodes[simulation.positions_mm()[hand.nodes, 2].argmax()]
    probe = simulation.probe(simulation.positions_mm()[top] + (0.0, 0.0, 1.0), 1.75)
    assert probe.touched(model, simulation.state.displacement).tolist() == [top]
    simulation.step(20)
    assert np.linalg.norm(simulation.force_on(hand)) > 0
    assert not simulation.force_on(probe).any()


def test_wrong_shapes_are_said_in_words():
    simulation = Simulation(block(2, 2, 2))
    hand = simulation.grab((3.5, 3.5, 3.5), 4.0)
    probe = simulation.probe((0, 0, 0), 4.0)
    for wrong in (
        lambda: simulation.grab((1.0, 2.0), 3.0),
        lambda: simulation.lead(hand, 1.0),
        lambda: simulation.move(probe, (1.0,)),
        lambda: simulation.probe((0, 0), (1.0, 2.0)),
        lambda: simulation.add_springs((1, 2, 3), 1.0),
        lambda: simulation.add_springs([(1, 2)], [1.0, 2.0]),
        lambda: simulation.add_springs([(1, 2)], 1.0, [1.0, 2.0, 3.0]),
    ):
        with pytest.raises(SimulationError):
            wrong()
    simulation.add_springs([], 1.0)
    assert simulation.model.explicit.count == 0


def test_all_that_is_wrong_with_explicit_springs_is_said_at_once():
    simulation = Simulation(block(2, 2, 2))
    with pytest.raises(SimulationError) as error:
        simulation.add_springs([(0, 999)], -1.0, rest_length_mm=np.nan)
    assert len(error.value.problems) == 3
    with pytest.raises(SimulationError, match="two different"):
        simulation.add_springs([(1, 1)], 1.0)
    with pytest.raises(SimulationError, match="whole number"):
        simulation.add_springs([(0.5, 1.0)], 1.0)


def test_hands_that_let_go_feel_nothing_and_cannot_be_led():
    simulation = Simulation(block(4, 4, 4, fix_base=True))
    hand = simulation.grab((4.0, 4.0, 8.0), 3.0)
    simulation.lead(hand, (0.0, 0.0, 1.0))
    simulation.step(50)
    probe = simulation.probe((0.0, 0.0, 40.0), 3.0)
    assert np.linalg.norm(simulation.force_on(hand)) > 0
    simulation.release(hand)
    simulation.withdraw(probe)
    assert not simulation.force_on(hand).any()
    assert not simulation.force_on(probe).any()
    with pytest.raises(SimulationError, match="let go"):
        simulation.lead(hand, (0.0, 0.0, 2.0))
    with pytest.raises(SimulationError, match="withdrawn"):
        simulation.move(probe, (0.0, 0.0, 41.0))
    with pytest.raises(SimulationError, match="radius must be above 0 mm"):
        simulation.grab((4.0, 4.0, 8.0), -8.0)
