"""Rows of steps in fewer, longer ones: against closed solutions, an independent integrator and the reference."""

from __future__ import annotations

from dataclasses import replace
from math import acos, cos, isclose

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.dynamics.integrate import PACED_STEPS_LEAST, Verlet, staggered, verlet_step
from heartcase.simulator.dynamics.step_size import StepSizes, default_step, own_step_limit
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.forces.reference import elastic_forces
from heartcase.simulator.instruments.probe import Probe
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import EPS, block, random_field

ELEMENT = ForceLaw("element")


@given(st.integers(0, 400), st.floats(1.0, 3.0), st.floats(0.0, 0.5))
def test_a_row_takes_its_time_in_as_few_steps_as_the_pace_allows(step_count, pace, damping):
    """The ways add up to the row's time, and so do the times from velocity to velocity."""
    verlet = Verlet(0.25, damping, pace=pace)
    row = verlet.row(step_count)
    numbers = [row.numbers_of(number) for number in range(row.step_count)]
    assert isclose(sum(each[0] for each in numbers), 0.25 * step_count, abs_tol=1e-9)
    if step_count < PACED_STEPS_LEAST or pace == 1.0:
        assert (row.step_count, row.last) == (step_count, None)
        return
    assert all(each[0] <= 0.25 * pace * (1 + 1e-12) for each in numbers)
    assert row.step_count - 1 < step_count / pace <= row.step_count
    # (1 - c b/2) / (1 + c b/2) has kick b / (1 + c b/2): b = kick / (1 - c kick / 2)
    kicks = [each[2] for each in (*numbers, *([] if row.last is None else [row.last]))]
    assert isclose(sum(kick / (1 - damping * kick / 2) for kick in kicks), 0.25 * step_count, abs_tol=1e-9)
    assert row.last is None or row.last[0] == 0.0


@pytest.mark.parametrize("omega_step", [0.05, 0.5, 1.0, 1.3, 1.6])
def test_rows_of_one_length_do_not_swing_anything_up(omega_step):
    """One row of an undamped oscillator is a matrix M of determinant 1: of its powers none grows where |tr M| < 2."""
    row = Verlet(1.0, pace=1.5).row(146)
    omega = omega_step / (146 / row.step_count)
    ends = []
    for u, v in ((1.0, 0.0), (0.0, 1.0)):
        for number in range(row.step_count):
            way, keep, kick = row.numbers_of(number)[:3]
            v = keep * v - kick * omega**2 * u
            u += way * v
        assert row.last is not None
        ends.append((u, v - row.last[2] * omega**2 * u))
    (a, c), (b, d) = ends
    assert a * d - b * c == pytest.approx(1.0, abs=1e-9)
    # It is similar to that many equal steps of Verlet: tr M = 2 cos(n theta), cos theta = 1 - (omega h)^2 / 2.
    assert a + d == pytest.approx(2 * cos(row.step_count * acos(1 - omega_step**2 / 2)), abs=1e-9)


def test_longer_steps_are_of_second_order_too():
    """Large, damped motion of two elements with gravity against DOP853 at 1e-12."""
    model = block(2, 1, 1, law=ELEMENT)
    rng = np.random.default_rng(4)
    u0, v0 = rng.uniform(-0.1, 0.1, (2, model.node_count, 3))
    mass = model.node_mass[:, None].astype(float)
    gravity, damping, duration = np.array([0.02, -0.01, 0.03]), 0.1, 8.0

    def rates(_, y):
        u, v = y.reshape(2, -1, 3)
        return np.concatenate([v, elastic_forces(model, u) / mass + gravity - damping * v]).ravel()

    truth = solve_ivp(rates, (0, duration), np.array([u0, v0]).ravel(), method="DOP853", rtol=1e-12, atol=1e-13)
    exact = truth.y[:, -1].reshape(2, -1, 3)[0]
    errors, counts = [], (60, 120, 240, 480)
    for count in counts:
        verlet = Verlet(duration / count, damping, tuple(gravity), pace=1.5)
        u, v = u0, staggered(model, verlet, u0, v0)
        for steps in (count // 2, count - count // 2):
            row = verlet.row(steps)
            for number in range(row.step_count):
                u, v = verlet_step(model, verlet, u, v, 1 / mass[:, 0], numbers=row.numbers_of(number))
            assert row.last is not None
            u, v = verlet_step(model, verlet, u, v, 1 / mass[:, 0], numbers=row.last)
        errors.append(np.abs(u - exact).max())
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.1)
    assert errors[-1] < 2e-3


@pytest.mark.parametrize("law", [ELEMENT, ForceLaw("element", 0.45)])
def test_engines_take_the_same_longer_steps(law):
    model = block(7, 4, 3, fix_base=True, law=law)
    verlet = Verlet(default_step(model) / model.units.time_s, 0.02, (0.0, 0.001, 0.0))
    verlet = replace(verlet, pace=StepSizes(model).pace(default_step(model)))
    assert verlet.row(100).step_count < 90
    ends = []
    for backend in ("cpu", "reference"):
        engine = make_engine(model, backend)
        engine.load(State(random_field(model, 1, 0.02), random_field(model, 2, 0.01)))
        for steps in (100, 1, 41):
            engine.advance(steps, verlet)
        ends.append(engine.read())
    assert ends[0].step_count == ends[1].step_count == 142
    assert np.abs(ends[0].displacement - ends[1].displacement).max() <= 142**2 * EPS * 0.05
    assert np.abs(ends[0].velocity - ends[1].velocity).max() <= 142**2 * EPS * 0.05


def test_engines_take_the_same_longer_steps_with_threads_that_are_drawn():
    model = block(7, 4, 3, fix_base=True, law=ELEMENT)
    at, h = model.rest_positions_mm(), model.cell_mm
    ends = []
    for backend in ("cpu", "reference"):
        simulation = Simulation(model, backend=backend, damping_per_s=30.0)
        assert simulation.pace > 1.2
        thread = simulation.stitch(at[[-1, -8]] + 0.3 * h * np.array([-1.0, 0.0, -1.0]))
        simulation.draw(thread, tension_n=0.02)
        simulation.step(80)
        assert simulation._paced.pace > 1.2
        simulation.draw(thread, length_mm=0.5 * h)
        simulation.step(60)
        ends.append((simulation.state, simulation.stitch_state(thread).force_n))
    (one, force), (other, expected) = ends
    assert np.abs(one.displacement).max() > 0.1
    assert np.abs(one.displacement - other.displacement).max() <= 140**2 * EPS * 0.05
    assert np.abs(one.velocity - other.velocity).max() <= 140**2 * EPS * 0.05
    assert force == pytest.approx(expected, rel=1e-3)
    assert force > 0.0


@pytest.mark.parametrize(("away", "is_as_long"), [(30.0, True), (-2.5, False)])
def test_a_probe_that_touches_nothing_leaves_the_longer_steps(away, is_as_long):
    """The same bytes as without it; one that may touch has steps as they are."""
    model = block(7, 4, 3, fix_base=True, law=ELEMENT)
    at, ends = model.rest_positions_mm(), []
    for place, pace in ((None, None), (away, None), (away, 1.0)):
        simulation = Simulation(model, damping_per_s=30.0, pace=pace)
        hand = simulation.grab(at[-1], 1.2 * model.cell_mm)
        simulation.lead(hand, (0.0, 0.0, model.cell_mm))
        if place is not None:
            probe = simulation.probe(at[0] + np.array([place, 0.0, 0.0]) * model.cell_mm, model.cell_mm)
            simulation.move(probe, at[0] + np.array([place, 1.0, 0.0]) * model.cell_mm)
        simulation.step(60)
        ends.append(simulation.state.displacement.tobytes())
    assert (ends[1] == ends[0]) == is_as_long
    assert (ends[1] == ends[2]) == (not is_as_long)


def test_a_hand_that_is_led_to_a_probe_has_steps_as_they_are():
    """It rests before, and nothing of it is quick."""
    model = block(7, 4, 3, fix_base=True, law=ELEMENT)
    at, ends, h = model.rest_positions_mm(), [], model.cell_mm
    for pace, far in ((None, 12.0), (1.0, 12.0), (None, 40.0)):
        simulation = Simulation(model, damping_per_s=30.0, pace=pace)
        hand = simulation.grab(at[-1], 1.2 * h)
        simulation.probe(at[-1] + np.array([0.0, 0.0, far * h]), h)
        simulation.lead(hand, (0.0, 0.0, 10.0 * h))
        simulation.step(400)
        ends.append(simulation.state.displacement.tobytes())
    assert ends[0] == ends[1] != ends[2]


@given(st.integers(0, 2**32 - 1))
def test_a_probe_that_keeps_away_touches_nothing_on_its_way(seed):
    rng = np.random.default_rng(seed)
    model = block(4, 3, 2)
    axis = rng.normal(0, 2, 3) if rng.random() < 0.5 else np.zeros(3)
    axes = np.full(3, rng.uniform(0.5, 2)) if axis.any() else rng.uniform(0.5, 2, 3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    probe = Probe(axes, turn, rng.uniform(-6, 9, 3), rng.uniform(-6, 9, 3), half_axis=axis)
    state = State(random_field(model, seed, 0.2), random_field(model, seed + 1, 0.1))
    if not probe.keeps_away(model, state, 3.0):
        return
    start, end = probe.centre, probe.target
    for way in np.linspace(0, 1, 21):
        probe.centre = start + way * (end - start)
        assert not len(probe.touched(model, state.displacement + np.float32(3.0 * way) * state.velocity))


def test_the_bytes_do_not_depend_on_how_a_row_is_shared_among_threads():
    model = block(60, 24, 12, fix_base=True, law=ELEMENT)
    start = State(random_field(model, 1, 0.05), random_field(model, 2, 0.01))
    verlet = Verlet(0.2, 0.01, still=(1e-4, 1e-4), pace=1.4)
    ends = []
    for seconds in ([1.0, 2.0], [2.0, 1.0], []):
        engine = make_engine(model, "cpu")
        engine.load(start)
        engine.autotuner.seconds_per_step = list(seconds)
        engine.autotuner.trials = {}
        engine.autotuner.round_count = 3 if seconds else 0
        for _ in range(2):
            engine.advance(40, verlet)
        ends.append(engine.read().displacement.tobytes() + engine.read().velocity.tobytes())
    assert ends[0] == ends[1] == ends[2]


def test_what_follows_a_state_is_the_same_wherever_it_came_from():
    """Nothing of how a row was taken is left but the state."""
    model = block(5, 3, 3, fix_base=True, law=ELEMENT)
    simulation = Simulation(model)
    assert simulation.pace > 1.1
    hand = simulation.grab(model.rest_positions_mm()[-1], 4.0)
    simulation.lead(hand, (2.0, 0.0, 1.0))
    simulation.step(60)
    simulation.release(hand)
    middle = simulation.snapshot()
    simulation.step(60)
    after = simulation.state.displacement.tobytes()
    other = Simulation(model)
    other.restore(State(middle.state.displacement, middle.state.velocity, middle.state.step_count))
    other.step(60)
    assert other.state.displacement.tobytes() == after


def test_the_pace_is_that_of_the_lattices_own_limit_and_for_whole_elements_alone():
    model = block(6, 4, 4, fix_base=True, law=ELEMENT)
    simulation = Simulation(model, tissue=TissueSamples.everywhere())
    assert simulation.pace * simulation.step_s == pytest.approx(0.8 * own_step_limit(model), rel=1e-9)
    assert Simulation(model.with_law(ForceLaw())).pace == 1.0
    assert Simulation(model, step_s=simulation.step_s).pace == 1.0
    assert Simulation(model, step_s=simulation.step_s, pace=simulation.pace).pace == simulation.pace
    at = model.rest_positions_mm()
    centre = at.mean(axis=0)
    taken = []

    def advance(step_count, verlet, probes, simulation=simulation, undisturbed=simulation._engine.advance):
        taken.append(verlet.row(step_count).step_count)
        undisturbed(step_count, verlet, probes)

    simulation._engine.advance = advance
    simulation.step(60)
    probe = simulation.probe(at.max(axis=0) + 4.0, 3.0)
    simulation.step(60)
    simulation.withdraw(probe)
    simulation.step(60)
    assert taken[1] == 60
    assert taken[0] == taken[2] < 55
    square = 40.0 * np.array([[[-1.0, -1, 0], [1, -1, 0]], [[-1, 1, 0], [1, 1, 0]]])
    simulation.cut(centre + square[..., [2, 0, 1]])
    assert 1.0 <= simulation._paced.pace <= simulation.pace


@pytest.mark.parametrize("pace", [0.5, float("nan"), 3.0])
def test_a_pace_beyond_the_lattices_limit_is_refused(pace):
    model = block(4, 3, 3, fix_base=True, law=ELEMENT)
    with pytest.raises(SimulationError, match=r"pace") as caught:
        Simulation(model, pace=pace)
    assert len(caught.value.problems) == 1


def test_what_swings_up_is_noticed_at_any_pace():
    """A pace that the lattice does not stand: the row ends where the velocity is least, and it is seen all the same."""
    model = block(5, 4, 4, fix_base=True, law=ELEMENT)
    simulation = Simulation(model, damping_per_s=0.0)
    simulation.pace = 1.2 * own_step_limit(model) / simulation.step_s
    simulation.restore(State(random_field(model, 1, 0.01), random_field(model, 2, 0.01)))
    with pytest.raises(SimulationError, match=r"by itself|not a number"):
        simulation.step(200)


@pytest.mark.parametrize("seed", [11, 23, 30, 43])
def test_what_is_let_go_without_damping_does_not_swing_up(seed):
    """Nearly incompressible blocks that broke down in steps of 0.8 of their own limit: energy had more than doubled."""
    rng = np.random.default_rng(seed)
    model = block(*rng.integers([4, 2, 2], [12, 5, 5]), fix_base=True, law=ForceLaw("element", 0.45))
    simulation = Simulation(model, damping_per_s=0.0)
    assert simulation.pace > 1.2
    last = model.rest_positions_mm()[np.flatnonzero(~model.node_is_fixed)[-1]]
    hand = simulation.grab(last, float(rng.uniform(1.2, 2.5)) * model.cell_mm)
    way = rng.normal(size=3)
    way *= rng.uniform(2, 6) * model.cell_mm / np.linalg.norm(way)
    for part in range(20):
        simulation.lead(hand, way * (part + 1) / 20)
        simulation.step(40)
    before = simulation.energy()
    simulation.release(hand)
    simulation.step(3000)
    after = simulation.energy()
    assert after.elastic_j + after.kinetic_j < 1.5 * (before.elastic_j + before.kinetic_j)
