"""Rows of stitches: evenly filled in, each on its side, and one tension all along a running thread."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.suturing.rows import filled_in, rest_point, shared_lengths
from tests.simulator.cutting.test_cuts import across_bar
from tests.simulator.lattices import block
from tests.simulator.suturing.test_stitches import parts_of

BACKENDS = ("cpu", "reference")
SIZES = st.floats(0.01, 5.0)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(SIZES, SIZES), min_size=1, max_size=12), st.floats(0.0, 20.0))
def test_a_shared_length_pulls_alike_and_is_no_longer_than_it_was(numbers, length):
    """Held against bisection for the one tension, and against every other way to share the length out at random."""
    apart, stiffness = np.array(numbers).T
    shared = shared_lengths(apart, stiffness, length)
    assert shared.sum() == pytest.approx(length, rel=1e-12, abs=1e-12)
    assert (shared >= 0).all()
    pull = stiffness * np.maximum(apart - shared, 0.0)
    if length >= apart.sum():
        assert np.abs(pull).max() <= 1e-12
        return
    low, high = 0.0, float((stiffness * apart).max())
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.maximum(apart - middle / stiffness, 0).sum() > length else (low, middle)
    np.testing.assert_allclose(pull, np.minimum(low, stiffness * apart), atol=1e-9 * (1 + low))
    energy = (pull**2 / stiffness).sum()
    other = np.random.default_rng(0).dirichlet(np.ones(len(apart)), 20) * length
    energies = ((stiffness * np.maximum(apart - other, 0.0)) ** 2 / stiffness).sum(axis=1)
    assert (energies >= energy * (1 - 1e-9)).all()


def test_a_row_is_filled_in_evenly_between_chosen_stitches():
    chosen = [[(0, 0, 0), (0, 2, 0)], [(10, 0, 0), (10, 2, 0)], [(10, 0, 3), (10, 2, 7)]]
    points, is_chosen = filled_in(chosen, 2.4)
    assert is_chosen == [True, False, False, False, True, False, True]
    np.testing.assert_allclose(points[:, 0, 0], [0, 2.5, 5, 7.5, 10, 10, 10])
    np.testing.assert_allclose(points[:, 0, 2], [0, 0, 0, 0, 0, 1.5, 3])
    np.testing.assert_allclose(points[5, 1], (10, 2, 3.5))
    with pytest.raises(SimulationError, match="two chosen stitches"):
        filled_in(chosen[:1], 1.0)
    with pytest.raises(SimulationError, match="500 are the most"):
        filled_in(chosen, 1e-3)


def incised(backend="cpu", **options):
    """A slab whose base is held, cut through to it along y; and both ends of a row across the cut, at rest."""
    model = block(12, 8, 3, cell_mm=2.0)
    model.node_is_fixed[model.node_index[:, 2] == 0] = True
    simulation = Simulation(model, backend=backend, damping_per_s=40.0, **options)
    simulation.cut([[(12, 2, 8), (12, 14, 8)], [(12, 2, -2), (12, 14, -2)]], at_rest=True)
    return simulation, [((9, y, 6), (15, y, 6)) for y in (3.0, 13.0)]


@pytest.mark.parametrize("backend", BACKENDS)
def test_an_interrupted_row_pulls_by_each_stitch_and_a_running_one_alike_all_along(backend):
    forces = {}
    for is_running in (False, True):
        simulation, ends = incised(backend)
        places = simulation.row_places(ends, spacing_mm=2.5, at_rest=True)
        assert len(places) == 5
        for number, pair in enumerate(places):
            at = [rest_point(place, simulation.uncut(simulation.model, simulation.cuts)) * 2.0 for place in pair]
            np.testing.assert_allclose(at, [(9, 3 + 2.5 * number, 6), (15, 3 + 2.5 * number, 6)], atol=1e-6)
        row = simulation.stitch_row(places, is_running=is_running)
        assert len(row) == (9 if is_running else 5)
        for stitch in row[:1] if is_running else row:
            simulation.draw(stitch, length_mm=3.0)
        simulation.step(200)
        for stitch in row:
            simulation.tie(stitch)
        for _ in range(8):
            simulation.step(100)
        states = [simulation.stitch_state(stitch) for stitch in row]
        assert all(state.is_tied and state.row == "row" and state.is_running == is_running for state in states)
        forces[is_running] = np.array([state.force_n for state in states])
        length = sum(state.length_mm for state in states)
        assert length == pytest.approx(3.0 * len(row), rel=1e-6)
    assert (forces[True] > 0).all()
    np.testing.assert_allclose(forces[True], forces[True][0], rtol=1e-5)
    # Stitches at the ends of the incision hold more tissue than those in the middle, and both ends alike.
    np.testing.assert_allclose(forces[False], forces[False][::-1], rtol=1e-2)
    assert forces[False][0] > 1.2 * forces[False][2]


def test_a_running_thread_that_is_drawn_has_one_tension_and_energy_falls_when_it_is_held():
    simulation, ends = incised()
    row = simulation.stitch_row(simulation.row_places(ends, spacing_mm=5.0, at_rest=True), is_running=True)
    simulation.draw(row[2], tension_n=0.02)
    simulation.step(50)
    assert [simulation.stitch_state(stitch).force_n for stitch in row] == pytest.approx([0.02] * len(row), rel=1e-5)
    simulation.tie(row[0])
    energies = []
    for _ in range(30):
        energies.append(simulation.energy().total_j)
        simulation.step(20)
    assert (np.diff(energies) < 0).all()
    simulation.take_out(row[1])
    assert simulation.stitches == []


def test_a_row_between_stitches_that_are_there_keeps_them_and_each_place_stays_on_its_side():
    model = block(9, 4, 4, cell_mm=2.0)
    simulation = Simulation(model)
    simulation.cut(across_bar(simulation.model, 4.5, 9.0), at_rest=True)
    chosen = [simulation.stitch([(8.0, y, 8.0), (10.0, y, 8.0)], name=f"s{y}", at_rest=True) for y in (1.0, 7.0)]
    places = simulation.row_places(chosen, spacing_mm=2.0)
    row = simulation.stitch_row(places)
    assert [stitch.name for stitch in row] == ["row 1", "row 2"]
    assert simulation.stitches == [*chosen, *row]
    parts = parts_of(simulation.model)
    for stitch in simulation.stitches:
        sides = [set(parts[nodes]) for nodes in stitch.nodes.reshape(2, 8)]
        assert len(sides[0]) == len(sides[1]) == 1
        assert sides[0] != sides[1]
    first = {int(parts[stitch.nodes[0]]) for stitch in simulation.stitches}
    assert len(first) == 1
    with pytest.raises(SimulationError, match="there already"):
        simulation.stitch_row([stitch.places for stitch in chosen], name="again")
    with pytest.raises(SimulationError, match="of this name"):
        simulation.stitch_row(places, name="s1.0")
    with pytest.raises(SimulationError, match="above 0"):
        simulation.row_places(chosen, spacing_mm=0.0)
    assert len(simulation.stitches) == 4


def test_all_threads_of_a_row_are_within_what_the_step_allows():
    simulation, ends = incised()
    for number in range(3):
        places = simulation.row_places(ends, spacing_mm=0.7, at_rest=True)
        simulation.stitch_row(places, is_running=True, name=f"r{number}")
    assert simulation._thread_rate() <= simulation._thread_rate_limit(simulation.model, simulation.cuts)
    for stitch in simulation.stitches:
        simulation.draw(stitch, length_mm=0.0)
    for _ in range(10):
        simulation.step(50)
    assert np.linalg.norm(simulation.displacement_mm(), axis=1).max() < 10.0
