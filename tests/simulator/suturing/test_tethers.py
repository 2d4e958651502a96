"""What holds for threads in every lattice: forces from their energy, no momentum, never stiffer than their bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.engine.shared.contact import NO_PROBES
from heartcase.simulator.lattice.state import State
from heartcase.simulator.lattice.tethers import NO_LIMIT, Tethers, whole_weights
from tests.simulator.lattices import EPS, block, cut_models, random_field, random_models
from tests.simulator.suturing.threads import random_tethers

SEEDS = st.integers(0, 2**32 - 1)
LATTICES = random_models() | cut_models()


@settings(max_examples=40, deadline=None)
@given(random_models(size_max=(6, 3, 3)), SEEDS)
def test_forces_are_the_slope_of_the_energy_and_give_no_momentum(model, seed):
    tethers = random_tethers(model, seed, slack=0.5)
    u = random_field(model, seed, 0.2).astype(float)
    force, way = tethers.forces(u), np.random.default_rng(seed).normal(size=u.shape)
    h = 1e-5
    slope = (tethers.energy(u + h * way) - tethers.energy(u - h * way)) / (2 * h)
    size = float(np.abs(tethers.tension(u)).sum()) + 1e-12
    assert slope == pytest.approx(-float((force * way).sum()), abs=1e-4 * size * np.abs(way).max())
    assert np.abs(force.sum(axis=0)).max() <= 1e-14 * size * len(force)
    assert tethers.energy(u) >= 0.0


def test_a_thread_pulls_and_never_pushes():
    model = block(3, 1, 1)
    far, near = (np.flatnonzero(model.node_index[:, 0] == i) for i in (3, 0))
    nodes = np.concatenate([near, near, far, far])[None].astype(np.int32)
    shares = np.concatenate([np.full(8, -0.125), np.full(8, 0.125)])[None].astype(np.float32)
    one = Tethers(nodes, shares, np.array([[3.0, 0, 0]]), *(np.array([x]) for x in (np.float32(2.0), 3.0, NO_LIMIT)),
                  pace=np.zeros((1, 2)))  # fmt: skip
    for moved, tension, limited in ((-0.5, 0.0, 0.0), (0.0, 0.0, 0.0), (0.25, 0.5, 0.3)):
        u = np.zeros((model.node_count, 3))
        u[far, 0] = moved
        assert one.tension(u)[0] == pytest.approx(tension, abs=1e-12)
        assert one.forces(u)[far].sum(axis=0) == pytest.approx([-tension, 0, 0], abs=1e-12)
        held = Tethers(**(vars(one) | {"tension_most": np.array([0.3])}))
        assert held.forces(u)[near].sum(axis=0) == pytest.approx([limited, 0, 0], abs=1e-12)


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_whole_weights_sum_to_one_exactly_in_float32(seed):
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.full(8, rng.choice([0.1, 1.0, 10.0])), 5)
    whole = whole_weights(weights).astype(np.float32)
    assert (np.add.accumulate(whole, axis=1, dtype=np.float32)[:, -1] == 1.0).all()
    assert np.abs(whole - weights).max() <= 8 / 2**20


@settings(max_examples=40, deadline=None)
@given(random_models(fixed=False, size_max=(5, 3, 2)), SEEDS)
def test_no_thread_is_stiffer_than_its_bound(model, seed):
    """The largest eigenvalue by central differences of the forces, wherever the tissue is."""
    tethers = random_tethers(model, seed)
    u = random_field(model, seed, 0.4).astype(float)
    n, h = u.size, 1e-5
    matrix = np.empty((n, n))
    for column in range(n):
        push = np.zeros(n)
        push[column] = h
        ahead, behind = (tethers.forces(u + sign * push.reshape(u.shape)) for sign in (1, -1))
        matrix[:, column] = (behind - ahead).ravel() / (2 * h)
    root = np.sqrt(np.repeat(model.inverse_mass.astype(float), 3))
    largest = np.linalg.eigvalsh(root[:, None] * (matrix + matrix.T) / 2 * root).max()
    bound = tethers.rate_bound(model.inverse_mass)
    assert largest <= bound * (1 + 1e-6)
    alone = Tethers(**{name: value[:1] for name, value in vars(tethers).items()})
    if len(np.unique(alone.nodes)) == 16:
        exact = alone.stiffness[0] * (alone.shares[0].astype(float) ** 2 * model.inverse_mass[alone.nodes[0]]).sum()
        assert alone.rate_bound(model.inverse_mass) == pytest.approx(exact, rel=1e-6)


def check_tethers(model, seed, engine, reference, step_count=30):
    """Forces and each step of a fast engine against the reference's from the same state; threads are being drawn.

    Only one step at a time can be held to a bound: what rounding leaves of a thread that is about to be taut, or of
    tissue that is about to buckle, grows from step to step by no rule. Corners are not guarded: where springs act
    alone, the CPU looks for flat ones in every eighth step, the reference in each.
    """
    tethers = random_tethers(model, seed, pace=0.2 / step_count, slack=0.3)
    displacement = random_field(model, seed, 0.05)
    displacement[model.node_is_fixed] = 0
    rate = 24 * (model.cell_stiffness / model.cell_density).max() + tethers.rate_bound(model.inverse_mass)
    verlet = Verlet(step=float(0.8 * 2 / np.sqrt(rate)))
    engine.set_tethers(tethers)
    state = State(displacement, np.zeros_like(displacement))
    engine.load(state)
    # 16 products and sums of numbers up to the box, a root, a division: their rounding times the stiffness. Of 18
    # springs of at most k each, the same of numbers of a few cells.
    size = 1.0 + np.ptp(model.node_index, axis=0).max()
    at_nodes = np.bincount(tethers.nodes.ravel(), np.repeat(tethers.stiffness * size, 16), model.node_count)
    force_off = 60.0 * EPS * (1.0 + at_nodes[:, None])
    reference.set_tethers(tethers)
    reference.load(state)
    assert (np.abs(engine.forces().astype(float) - reference.forces()) <= force_off).all()
    for number in range(step_count):
        reference.set_tethers(tethers.after(number))
        reference.load(state)
        engine.advance_by(1, 1, verlet, NO_PROBES, number)
        reference.advance(1, verlet)
        state, exact = engine.read(), reference.read()
        speed_off = verlet.kick * force_off * model.inverse_mass[:, None].astype(float)
        speed_off += 4 * EPS * np.abs(exact.precise_velocity).max() + EPS * verlet.kick * size
        way_off = verlet.step * speed_off + 2 * EPS * np.abs(exact.precise_displacement)
        assert (np.abs(state.velocity - exact.precise_velocity) <= speed_off).all()
        assert (np.abs(state.displacement - exact.precise_displacement) <= way_off).all()
    return tethers, state


@settings(max_examples=25, deadline=None)
@given(LATTICES, SEEDS)
def test_threads_pull_alike_in_both_engines_of_the_host(model, seed):
    model = model.with_law(replace(model.law, guards_corners=False))
    check_tethers(model, seed, make_engine(model, "cpu"), make_engine(model, "reference"))


@pytest.mark.parametrize("seed", [1, 2])
def test_any_number_of_threads_and_any_division_of_a_row_gives_the_same_bytes(seed):
    model = block(20, 8, 12, fix_base=True)
    tethers = random_tethers(model, seed, pace=0.01)
    start = State(random_field(model, seed, 0.05), random_field(model, seed + 1, 0.01))
    verlet = Verlet(0.2, 0.01, still=(1e-4, 1e-5))
    ends = []
    for rows in ([(1, 40, 0)], [(2, 40, 0)], [(2, 16, 0), (1, 24, 16)]):
        engine = make_engine(model, "cpu")
        engine.set_tethers(tethers)
        engine.load(start)
        for thread_count, step_count, first_step in rows:
            engine.advance_by(thread_count, step_count, verlet, NO_PROBES, first_step)
        ends.append(engine.read())
    for other in ends[1:]:
        assert other.displacement.tobytes() == ends[0].displacement.tobytes()
        assert other.velocity.tobytes() == ends[0].velocity.tobytes()
    plain = make_engine(model, "cpu")
    plain.load(start)
    plain.advance_by(1, 40, verlet, NO_PROBES)
    assert np.abs(plain.read().displacement - ends[0].displacement).max() > 1e-3


def test_no_threads_leave_every_byte_as_it_was():
    model = block(6, 5, 4, fix_base=True)
    ends = []
    for is_set in (False, True):
        engine = make_engine(model, "cpu")
        if is_set:
            engine.set_tethers(random_tethers(model, 3))
            engine.set_tethers(Tethers.none())
        engine.load(State(random_field(model, 1, 0.1), random_field(model, 2, 0.01)))
        engine.advance(20, Verlet(0.2))
        ends.append(engine.read().displacement.tobytes())
    assert ends[0] == ends[1]
