"""Tissue that rests is not worked out, and nobody can tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import block

LAWS = [ForceLaw(), ForceLaw("springs", 0.45), ForceLaw("element")]
FRAME_STEPS = 96
SLEEP_MM = 0.05


def bar(law=LAWS[0]):
    """80 x 8 x 8 cells on a fixed base; half of each element's tissue is strained by the means around its corners."""
    model = block(80, 8, 8, fix_base=True, law=law)
    return replace(model, cell_shares=np.full((model.cell_count, 8), 1 / 16, np.float32)) if law.is_element else model


def awake_part(simulation):
    return simulation._engine.awake_part


def frames(scene, model, sleep_mm, **options):
    """Displacement [mm], elastic energy [J] and what is awake after each frame of a scene."""
    simulation = Simulation(model, sleep_mm=sleep_mm, damping_per_s=30.0, **options)
    shown = []
    for _ in scene(simulation):
        simulation.step(FRAME_STEPS)
        awake = awake_part(simulation)  # forces are worked out of all tissue
        shown.append((simulation.displacement_mm(), simulation.energy().elastic_j, awake))
    way, elastic, awake = (np.array(part) for part in zip(*shown, strict=True))
    return way, elastic, awake


def pulled_and_let_go(simulation):
    yield from range(2)
    hand = simulation.grab((20.0, 10.0, 20.0), 5.0)
    for frame in range(4):
        simulation.lead(hand, np.array([0.5, 0.0, 1.5]) * (frame + 1))
        yield
    yield from range(20)
    simulation.release(hand)
    yield from range(20)


def touched(simulation):
    yield from range(2)
    probe = simulation.probe((150.0, 10.0, 40.0), 10.0)
    for frame in range(6):
        simulation.move(probe, (150.0, 10.0, 40.0 - 2.5 * frame))
        yield
    yield from range(20)
    simulation.withdraw(probe)
    yield from range(10)


def cut_while_it_sleeps(simulation):
    hand = simulation.grab((20.0, 10.0, 20.0), 5.0)
    simulation.lead(hand, (0.0, 0.0, 5.0))
    yield from range(25)
    model = simulation.model
    springs = model.node_index[model.spring_nodes, 0]
    simulation.remove_springs((springs.min(axis=1) == 12) & (springs.max(axis=1) == 13))
    yield from range(25)


def crept(simulation):
    """A hand so slow that nothing moves as fast as what may sleep."""
    hand = simulation.grab((20.0, 10.0, 20.0), 5.0)
    frame_s = FRAME_STEPS * simulation.step_s
    for frame in range(60):
        simulation.lead(hand, (0.0, 0.0, 1.0 * frame * frame_s))
        yield


def scenes_and_laws():
    """All of them; in the usual run every scene with the quickest law and with one of the others."""
    for number, scene in enumerate([pulled_and_let_go, touched, cut_while_it_sleeps, crept]):
        for law in range(len(LAWS)):
            is_slow = law > 0 and (number + law) % 2 == 0
            name = f"{scene.__name__}-law{law}"
            yield pytest.param(scene, LAWS[law], id=name, marks=[pytest.mark.slow] if is_slow else [])


@pytest.mark.parametrize(("scene", "law"), list(scenes_and_laws()))
def test_what_is_left_out_is_not_seen(scene, law):
    way, elastic, awake = frames(scene, bar(law), SLEEP_MM)
    all_way, all_elastic, all_awake = frames(scene, bar(law), 0.0)
    assert (all_awake == 1).all()
    assert np.abs(way - all_way).max() <= SLEEP_MM
    assert np.abs(elastic - all_elastic).max() <= 1e-3 * all_elastic.max()
    assert np.linalg.norm(all_way, axis=2).max() > 0.02
    assert awake.min() < 0.7


@pytest.mark.parametrize("law", LAWS)
def test_nothing_is_worked_out_where_all_rests(law):
    simulation = Simulation(bar(law))
    simulation.step(FRAME_STEPS)
    assert awake_part(simulation) == 0
    assert not simulation.state.displacement.any()


def test_a_swing_is_awake_at_its_turning_points():
    """Undamped, in the lowest mode along its length: at times all of it stands still at once."""
    model = block(80, 4, 4)
    simulation = Simulation(model, sleep_mm=SLEEP_MM, damping_per_s=0.0)
    whole = Simulation(model, sleep_mm=0.0, damping_per_s=0.0)
    swing = np.zeros((model.node_count, 3), np.float32)
    swing[:, 0] = 0.3 * np.cos(np.pi * model.node_index[:, 0] / 80)
    for one in (simulation, whole):
        one.restore(State(swing, np.zeros_like(swing)))
    for _ in range(40):
        simulation.step(FRAME_STEPS)
        whole.step(FRAME_STEPS)
        assert awake_part(simulation) == 1
    np.testing.assert_array_equal(simulation.state.displacement, whole.state.displacement)


def kicked(model):
    """All at rest but one end."""
    velocity = np.zeros((model.node_count, 3), np.float32)
    velocity[(model.node_index[:, 0] < 6) & ~model.node_is_fixed] = 0.02
    return State(np.zeros_like(velocity), velocity)


def test_the_same_again_after_going_back():
    simulation = Simulation(bar(), sleep_mm=SLEEP_MM, damping_per_s=30.0)
    simulation.restore(kicked(simulation.model))
    simulation.step(20)
    before = simulation.state
    ends = []
    for _ in range(2):
        simulation.restore(before)
        simulation.step(20)
        assert 0 < awake_part(simulation) < 1
        simulation.step(100)
        ends.append(simulation.state)
    assert ends[0].displacement.tobytes() == ends[1].displacement.tobytes()
    assert ends[0].velocity.tobytes() == ends[1].velocity.tobytes()


def test_what_sleeps_does_not_depend_on_threads_or_how_the_steps_are_shared():
    model = bar(LAWS[1])
    verlet = Verlet(0.2, 0.05, still=(1e-3, 1e-4))
    ends = []
    for thread_count, shares in ((2, (40,)), (3, (4, 4, 32)), (1, (4, 4, 32)), (1, (3, 37))):
        engine, taken = make_engine(model, "cpu"), 0
        engine.load(kicked(model))
        for count in shares:
            engine.advance_by(thread_count, count, verlet, np.zeros((0, 17), np.float32), taken)
            taken += count
        assert 0 < engine.awake_part < 1
        ends.append(engine.read().displacement.tobytes() + engine.read().velocity.tobytes())
    assert ends[0] == ends[1] == ends[2] == ends[3]
