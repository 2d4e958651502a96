"""What the watchdog sees, and what it lets pass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.measures import inverted_cells
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.watchdog import find_trouble
from tests.simulator.lattices import block, random_field, random_models


def quiet(node_count):
    return State(np.zeros((node_count, 3), np.float32), np.zeros((node_count, 3), np.float32))


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("part", ["displacement", "velocity"])
def test_what_is_no_number_is_seen_anywhere(number, part):
    state = quiet(7)
    getattr(state, part)[6, 2] = number
    assert "not a number" in find_trouble(state)


def test_rest_is_no_trouble():
    assert find_trouble(quiet(5)) is None
    assert find_trouble(quiet(0)) is None


def beyond_its_limit():
    """A simulation whose steps are a quarter too long, and a state with a little of every swing in it."""
    simulation = Simulation(block(6, 5, 5, fix_base=True), damping_per_s=1.0, sleep_mm=0.0)
    too_long = 1.25 * simulation.step_limit_s / simulation.model.units.time_s
    simulation.verlet = replace(simulation.verlet, step=too_long)
    start = random_field(simulation.model, 3, 1e-3)
    start[simulation.model.node_is_fixed] = 0
    simulation.restore(State(start, np.zeros_like(start)))
    return simulation


def test_energy_from_nowhere_is_seen_and_undone():
    simulation = beyond_its_limit()
    before = simulation.state
    with pytest.raises(SimulationError, match=r"energy grew from .* J to .* J by itself.*smaller step"):
        simulation.step(400)
    assert simulation.step_count == before.step_count
    np.testing.assert_array_equal(simulation.state.displacement, before.displacement)
    np.testing.assert_array_equal(simulation.state.velocity, before.velocity)


def test_energy_that_a_hand_or_gravity_gives_is_no_trouble():
    model = block(6, 5, 5, fix_base=True)
    simulation = Simulation(model)
    hand = simulation.grab(simulation.positions_mm()[-1], 5.0)
    simulation.lead(hand, (0.0, 0.0, 30.0))
    simulation.step(10)
    assert simulation.watch().hurried_node_count
    falling = Simulation(block(3, 3, 3), gravity_m_s2=(0.0, 0.0, -1e4), damping_per_s=0.0)
    falling.step(200)
    assert falling.watch().hurried_node_count


@settings(max_examples=30, deadline=None)
@given(random_models(), st.sampled_from([0.02, 0.3, 1.0]), st.integers(0, 2**32 - 1))
def test_cells_inside_out_are_those_of_the_formula(model, size, seed):
    """Also where the cells that hardly moved are passed over."""
    u = random_field(model, seed, size) * (np.random.default_rng(seed).random((model.node_count, 1)) < 0.5)
    at = (model.node_index + u.astype(float))[model.cell_corners]
    volume = np.full(model.cell_count, np.inf)
    for corner in range(8):
        edges = np.stack([(at[:, corner ^ 1 << n] - at[:, corner]) * (1 - 2 * (corner >> n & 1)) for n in range(3)], 1)
        volume = np.minimum(volume, np.linalg.det(edges))
    is_clear = np.abs(volume) > 1e-9
    np.testing.assert_array_equal(inverted_cells(model, u)[is_clear], (volume <= 0)[is_clear])
