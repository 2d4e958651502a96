"""The integrator against conservation laws, closed solutions and an independent integrator."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from heartcase.simulator.dynamics.integrate import Verlet, energy, runge_kutta_step, staggered, verlet_step
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.forces.reference import spring_forces
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import EPS, block, oblique_geometry, random_field, stiffness_matrix

REST_LIMIT = 2 / np.sqrt(20)


def total_energy(model, verlet, engine):
    state = engine.read()
    force = spring_forces(model, state.displacement)
    inverse_mass = np.where(model.node_is_fixed, 0, 1 / model.node_mass)
    return energy(model, verlet, state, force=force, inverse_mass=inverse_mass).total_j


def test_momentum_is_conserved_undamped_and_free():
    """Newton's third law holds to the bit for each spring; what is left is the rounding of 18 additions a node."""
    model = block(6, 5, 4)
    mass = model.node_mass[:, None].astype(float)
    start = State(random_field(model, 1, 0.05), random_field(model, 2, 0.05))
    engine = make_engine(model, "cpu")
    engine.load(start)
    verlet = Verlet(step=0.5 * REST_LIMIT)
    steps, bound = 0, 0.0
    before = (mass * start.velocity).sum(axis=0)
    for _ in range(10):
        engine.advance(100, verlet)
        steps += 100
        now = engine.read()
        lower, higher = model.spring_nodes.T
        pulls = 2 * (model.spring_weight * np.linalg.norm(now.displacement[higher] - now.displacement[lower], axis=1))
        bound += 100 * EPS * (20 * verlet.step * pulls.sum() + 3 * (mass * np.abs(now.velocity)).sum())
    drift = np.abs((mass * engine.read().velocity).sum(axis=0) - before).max()
    assert drift <= bound
    assert bound < 0.05 * (mass * np.abs(start.velocity)).sum()


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_energy_stays_in_the_band_of_verlet(backend):
    """A mode of frequency w keeps kinetic + elastic energy within [1 - (w s)^2 / 4, 1] of its highest value.

    At half the limit (w s)^2 is at most 1, so that the total stays between 3/4 and 4/3 of the start's.
    """
    model = block(4, 3, 3, fix_base=True)
    displacement = random_field(model, 3, 1e-4)
    displacement[model.node_is_fixed] = 0
    engine = make_engine(model, backend)
    engine.load(State(displacement, np.zeros_like(displacement)))
    verlet = Verlet(step=0.5 * REST_LIMIT)
    start = total_energy(model, verlet, engine)
    for _ in range(20 if backend == "cpu" else 4):
        engine.advance(100, verlet)
        # The strain of 1e-4 makes the band uncertain by the cubic term of the energy.
        assert 0.75 * (1 - 1e-3) < total_energy(model, verlet, engine) / start < (1 + 1e-3) / 0.75


@pytest.mark.parametrize(
    ("scheme", "order", "counts", "last_error"),
    [(verlet_step, 2.0, (40, 80, 160, 320), 1e-3), (runge_kutta_step, 4.0, (40, 70, 120, 200), 1e-6)],
)
def test_schemes_are_of_their_order(scheme, order, counts, last_error):
    """Large, damped, nonlinear motion of two cells against DOP853 at 1e-12."""
    model = block(2, 1, 1)
    rng = np.random.default_rng(4)
    u0, v0 = rng.uniform(-0.2, 0.2, (2, model.node_count, 3))
    mass = model.node_mass[:, None].astype(float)
    gravity, damping, duration = np.array([0.02, -0.01, 0.03]), 0.1, 4.0

    def rates(_, y):
        u, v = y.reshape(2, -1, 3)
        return np.concatenate([v, spring_forces(model, u) / mass + gravity - damping * v]).ravel()

    truth = solve_ivp(rates, (0, duration), np.array([u0, v0]).ravel(), method="DOP853", rtol=1e-12, atol=1e-13)
    exact = truth.y[:, -1].reshape(2, -1, 3)[0]
    errors = []
    for count in counts:
        verlet = Verlet(step=duration / count, damping=damping, gravity=tuple(gravity))
        u, v = u0, staggered(model, verlet, u0, v0) if scheme is verlet_step else v0
        for _ in range(count):
            u, v = scheme(model, verlet, u, v, 1 / mass[:, 0])
        errors.append(np.abs(u - exact).max())
    rate = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert rate == pytest.approx(order, abs=0.1)
    assert errors[-1] < last_error


def test_runge_kutta_leaves_fixed_nodes_and_carries_led_ones():
    model = block(2, 2, 2, fix_base=True)
    velocity = np.zeros((model.node_count, 3))
    velocity[-1] = (0.1, 0.0, 0.2)
    inverse_mass = model.inverse_mass.astype(float)
    inverse_mass[-1] = 0.0
    start = np.zeros_like(velocity)
    u, v = runge_kutta_step(model, Verlet(0.2, 0.3, (0.0, 0.0, -0.5)), start, velocity, inverse_mass)
    np.testing.assert_array_equal(u[model.node_is_fixed], 0.0)
    np.testing.assert_allclose(u[-1], (0.02, 0.0, 0.04), atol=1e-15)
    np.testing.assert_array_equal(v[-1], velocity[-1])


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_damped_fall_in_seconds_and_mm(backend):
    """v = g/c (1 - exp(-c t)), x = g/c (t - (1 - exp(-c t)) / c), in an oblique frame."""
    c, g = 20.0, np.array([3.0, -5.0, 9.81])
    model = block(2, 2, 2, geometry=oblique_geometry())
    simulation = Simulation(model, damping_per_s=c, gravity_m_s2=g, backend=backend)
    verlet = simulation.verlet
    still = np.zeros((model.node_count, 3))
    half_back = staggered(model, verlet, still, still)
    simulation.restore(State(still.astype(np.float32), half_back.astype(np.float32)))
    simulation.step(300)
    t = simulation.time_s
    x_mm = 1e3 * g / c * (t - (1 - np.exp(-c * t)) / c)
    # Second order: (c s)^2 / 12, some 1e-6; 300 additions in float32.
    tolerance = (300 * EPS + (c * simulation.step_s) ** 2) * np.abs(x_mm).max()
    np.testing.assert_allclose(simulation.displacement_mm(), np.broadcast_to(x_mm, still.shape), atol=tolerance)


def test_highest_mode_of_a_lone_cell_swings_as_theory_says():
    """omega^2 = 20 k/m; Verlet's frequency is 2 asin(omega s / 2) / s."""
    model = block(1, 1, 1)

    K = stiffness_matrix(model) / float(model.node_mass[0])
    values, vectors = np.linalg.eigh((K + K.T) / 2)
    mode = vectors[:, -1].reshape(-1, 3) * 1e-4
    assert values[-1] == pytest.approx(20.0, rel=1e-6)
    omega, step = np.sqrt(20.0), 0.01
    verlet = Verlet(step=step)
    u, v = mode, staggered(model, verlet, mode, np.zeros_like(mode))
    for _ in range(200):
        u, v = verlet_step(model, verlet, u, v, 1 / model.node_mass.astype(float))
    theta = 2 * np.arcsin(omega * step / 2)
    np.testing.assert_allclose(u, mode * np.cos(200 * theta), atol=1e-3 * np.abs(mode).max())
