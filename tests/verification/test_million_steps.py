"""A million steps without damping: energy within the band of Verlet, momentum and centre of mass where they were."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.forces.reference import elastic_energy, elastic_forces
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from tests.simulator.lattices import block, random_field

STEPS = 1_000_000
LAWS = [ForceLaw(guards_corners=False), ForceLaw("springs", 0.4, False), ForceLaw("element", 0.3)]


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("law", LAWS, ids=str)
def test_energy_at_95_percent_of_the_limit_at_rest(law):
    """In float64, at a strain of 1e-4.

    With velocities half a step before, Verlet keeps H = v M v / 2 + u_n K u_(n-1) / 2 where forces are linear, and
    u K u / 2 is at most H / (1 - (w s / 2)^2) for the highest w: at 0.95 of the limit, 10.3 H. What forces are not
    linear is a part of 1e-4 of them; it may add up over a step's growth of 10.3, and is given 1%.
    """
    model = block(2, 1, 1, law=law)
    step = 0.95 * 2 / np.sqrt(law.rest_bound)
    engine = make_engine(model, "reference")
    engine.load(State(random_field(model, 1, 5e-5), np.zeros((model.node_count, 3), np.float32)))
    mass = model.node_mass[:, None].astype(float)

    def kept():
        before = engine.displacement - step * engine.velocity
        return (
            0.5 * (mass * engine.velocity**2).sum() - 0.5 * (elastic_forces(model, engine.displacement) * before).sum()
        )

    start = kept()
    for _ in range(STEPS // 10_000):
        engine.advance(10_000, Verlet(step))
        assert kept() == pytest.approx(start, rel=0.01)
        assert elastic_energy(model, engine.displacement) <= 1.01 * start / (1 - 0.95**2)


@pytest.mark.parametrize("law", [ForceLaw(), ForceLaw("element", 0.3)], ids=str)
@pytest.mark.parametrize("steps", [20_000, pytest.param(STEPS, marks=pytest.mark.slow)])
def test_centre_of_mass_stays(law, steps):
    """In float32, free, default step, strains of half a percent: within 0.01 cell after a million steps.

    Every step rounds each velocity to EPS / 2 of itself. If at random, their mean over n nodes walks by
    EPS |v| / 2 sqrt(steps / n), and the centre by the step times that, times the steps: some 0.01. It grows with the
    movement: four times as much, 0.02, was 0.02 cells.
    """
    model = block(4, 3, 3, law=law)
    mass = model.node_mass[:, None].astype(float)
    velocity = random_field(model, 2, 0.005).astype(float)
    velocity -= (mass * velocity).sum(axis=0) / mass.sum()
    start = State(random_field(model, 1, 0.005), velocity.astype(np.float32))
    # what rounding left of the velocity's mean is a movement, no error
    drift = (mass * start.velocity).sum(axis=0) / mass.sum()
    engine = make_engine(model, "cpu")
    engine.load(start)
    step = 0.8 * 2 / np.sqrt(law.stretched_bound)
    engine.advance(steps, Verlet(step))
    end = engine.read()
    way = (mass * (end.displacement.astype(float) - start.displacement)).sum(axis=0) / mass.sum()
    assert np.abs(way - drift * step * steps).max() <= 0.01
    assert np.abs(end.velocity).max() > 5e-4  # it still swings
