"""The CPU kernel against the reference, on any cells, coverage and stiffness."""

from __future__ import annotations

import platform
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.engine.cpu.engine import PARALLEL_WINDOWS_MIN
from heartcase.simulator.engine.shared.contact import NO_PROBES, probe_row
from heartcase.simulator.forces.reference import spring_forces
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from tests.simulator.lattices import EPS, block, random_field, random_models, random_probes, tied

BACKENDS = ("cpu", "reference")
SEEDS = st.integers(0, 2**32 - 1)


def stretch_at_nodes(model, displacement):
    """Sum of w |D| over each node's springs: the scale of the forces, and of their rounding."""
    lower, higher = model.spring_nodes.T
    size = model.spring_weight * np.linalg.norm(displacement[higher] - displacement[lower].astype(float), axis=1)
    total = np.bincount(lower, size, model.node_count) + np.bincount(higher, size, model.node_count)
    return total[:, None]


def unguarded(model):
    """The model without what corners add: tests/parity/test_force_laws.py looks at that."""
    return model.with_law(ForceLaw(guards_corners=False))


@settings(max_examples=60, deadline=None)
@given(random_models(), SEEDS, st.sampled_from([1e-6, 1e-3, 0.1, 1.0, 10.0]))
def test_forces_agree(model, seed, scale):
    """About 20 roundings in a spring's pull, of at most w |D| each, and 18 pulls to add."""
    model = unguarded(model)
    displacement = random_field(model, seed, scale)
    engine = make_engine(model, "cpu")
    engine.load(State(displacement, np.zeros_like(displacement)))
    gap = np.abs(engine.forces() - spring_forces(model, displacement))
    assert (gap <= 40 * EPS * stretch_at_nodes(model, displacement)).all()


@settings(max_examples=30, deadline=None)
@given(random_models())
def test_rest_is_an_exact_equilibrium(model):
    for backend in ("cpu", "reference"):
        assert np.abs(make_engine(model, backend).forces()).max(initial=0.0) <= (0 if backend == "cpu" else 1e-14)


@settings(max_examples=30, deadline=None)
@given(random_models(fixed=False), SEEDS)
def test_rigid_motion_makes_no_force(model, seed):
    """Positions up to |x| are rounded to EPS |x| / 2; a node's springs weigh up to sum(w)."""
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    x = model.node_index.astype(float)
    displacement = (x @ rotation.T + rng.uniform(-20, 20, 3) - x).astype(np.float32)
    weight = np.bincount(model.spring_nodes.ravel(), np.repeat(model.spring_weight, 2), model.node_count)
    engine = make_engine(model, "cpu")
    engine.load(State(displacement, np.zeros_like(displacement)))
    tolerance = 4 * EPS * max(np.abs(displacement).max(), 4.0) * weight
    assert (np.abs(engine.forces()) <= tolerance[:, None]).all()


@settings(max_examples=25, deadline=None)
@given(random_models(), SEEDS, st.floats(0.0, 0.3), st.booleans())
def test_a_hundred_steps_agree(model, seed, damping, guards_corners):
    """Each step rounds the velocity's change to EPS of the movement; all in one direction they add up to n^2 EPS.

    The CPU looks for corners to guard in the first step of a row and in every eighth, the reference in all: with a
    guard each step is a row.
    """
    model = replace(model, law=replace(model.law, guards_corners=guards_corners))
    displacement = random_field(model, seed, 0.05)
    displacement[model.node_is_fixed] = 0
    verlet = Verlet(step=0.8 * 2 / np.sqrt(24 * (model.cell_stiffness / model.cell_density).max()), damping=damping)
    ends = []
    for backend in ("cpu", "reference"):
        engine = make_engine(model, backend)
        engine.load(State(displacement, np.zeros_like(displacement)))
        for _ in range(100 if guards_corners else 1):
            engine.advance(1 if guards_corners else 100, verlet)
        ends.append(engine.read())
    assert ends[0].step_count == ends[1].step_count == 100
    assert np.abs(ends[0].displacement - ends[1].displacement).max() <= 100**2 * EPS * 0.05
    np.testing.assert_array_equal(ends[0].displacement[model.node_is_fixed], 0.0)


def test_result_does_not_depend_on_the_number_of_threads():
    model = block(24, 9, 9, fix_base=True)
    engine = make_engine(tied(model, 7), "cpu")
    probes = probe_row((8.0, 4.0, 10.0), (0.0, 0.0, -0.02), (3.0, 2.0, 2.0), np.eye(3))[None]
    results = []
    for thread_count in (1, 2, 3):
        engine.load(State(random_field(model, 1, 0.1), random_field(model, 2, 0.01)))
        engine.advance_by(thread_count, 50, Verlet(0.3, 0.05, (0.0, 0.001, 0.0)), probes)
        end = engine.read()
        results.append(end.displacement.tobytes() + end.velocity.tobytes())
    assert len(np.unique(engine.read().displacement)) > 1000
    assert results[0] == results[1] == results[2]


def test_moving_probes_do_not_depend_on_how_the_steps_are_shared():
    model = block(24, 9, 9, fix_base=True)
    probes = probe_row((8.0, 4.0, 10.0), (0.003, 0.001, -0.02), (3.0, 2.0, 2.0), np.eye(3))[None]
    ends = []
    for shares in ((50,), (4, 4, 42)):
        engine, taken = make_engine(model, "cpu"), 0
        for count in shares:
            engine.advance_by(1, count, Verlet(0.3, 0.05), probes, taken)
            taken += count
        ends.append(engine.read().displacement)
    assert np.abs(ends[0]).max() > 0.1
    assert ends[0].tobytes() == ends[1].tobytes()


@pytest.mark.parametrize("thread_count", [1, 2])
def test_numbers_too_small_for_float32_are_zero_for_the_kernel_alone(thread_count):
    """They take x86 three times as long; the arithmetic of everybody else in the process stays as it is."""
    model = block(3, 3, 3)
    engine = make_engine(model, "cpu")
    tiny = np.full((model.node_count, 3), 1e-42, np.float32)
    engine.load(State(np.zeros_like(tiny), tiny))
    engine.advance_by(thread_count, 2, Verlet(0.3), NO_PROBES)
    assert (engine.read().velocity == (0 if platform.machine() in ("x86_64", "AMD64") else tiny)).all()
    assert np.float32(1e-38) * np.float32(0.1) > 0
    assert (np.full(64, 1e-38, np.float32) * np.float32(0.1) > 0).all()


def test_large_lattices_take_whichever_way_is_quicker():
    """However the steps are shared between one thread and all, the state is that of one thread."""
    model = block(60, 24, 12, fix_base=True)
    start = State(random_field(model, 1, 0.1), random_field(model, 2, 0.01))
    engine, alone = make_engine(model, "cpu"), make_engine(model, "cpu")
    assert engine.layout.window_count >= PARALLEL_WINDOWS_MIN
    for each in (engine, alone):
        each.load(start)
    verlet = Verlet(0.3, 0.01)
    for _ in range(3):
        engine.advance(20, verlet)
        alone.autotuner.seconds_per_step = [1.0, 2.0]
        alone.autotuner.round_count = 3
        alone.advance(20, verlet)
    assert engine.read().step_count == 60
    assert engine.read().displacement.tobytes() == alone.read().displacement.tobytes()


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_coincident_nodes_and_inverted_cells_stay_finite(backend):
    model = block(3, 3, 3)
    displacement = (-model.node_index).astype(np.float32)
    engine = make_engine(model, backend)
    engine.load(State(displacement, np.zeros_like(displacement)))
    np.testing.assert_array_equal(engine.forces(), 0.0)
    engine.load(State(2 * displacement, np.zeros_like(displacement)))
    assert np.isfinite(engine.forces()).all()


def test_unknown_backend_is_refused():
    with pytest.raises(SimulationError, match="cpu, cuda, reference"):
        make_engine(block(1, 1, 1), "abacus")


@settings(max_examples=25, deadline=None)
@given(random_models(), SEEDS)
def test_explicit_springs_agree(model, seed):
    """As in :func:`test_a_hundred_steps_agree`; forces round their length, up to that of the box, once more."""
    assume(model.node_count > 1)
    model = unguarded(tied(model, seed))
    check_explicit_springs(model, seed, [make_engine(model, name) for name in BACKENDS])


@settings(max_examples=12, deadline=None)
@given(random_models(), SEEDS)
def test_probes_push_alike(model, seed):
    model = unguarded(model)
    check_probes(model, seed, [make_engine(model, name) for name in BACKENDS], step_count=30)


def check_explicit_springs(model, seed, engines, step_count=30):
    """Forces and steps of a fast engine against the reference's, the last of the engines."""
    displacement = random_field(model, seed, 0.05)
    displacement[model.node_is_fixed] = 0
    verlet = Verlet(step=stable_step(model))
    first, second = model.explicit.nodes.T
    way = (model.node_index + displacement.astype(float))[second] - (model.node_index + displacement)[first]
    length = np.linalg.norm(way, axis=1)
    # Each end of a spring is rounded to EPS of the way between them: as much of its length, and of its direction.
    far = 1.0 + np.abs(model.node_index[second] - model.node_index[first]).max(axis=1)
    # Between two copies of a node in one place there is no way: such a spring does not pull.
    stretch = np.abs(length - model.explicit.rest_length) / np.where(length > 0, length, np.inf)
    rounded = model.explicit.stiffness * EPS * far * (1 + stretch)
    at_nodes = np.bincount(np.concatenate([first, second]), np.tile(rounded, 2), model.node_count)[:, None]

    def after(engine, displacement):
        engine.load(State(displacement, np.zeros_like(displacement)))
        force = engine.forces()
        engine.advance(step_count, verlet)
        return force, engine.read().displacement.astype(float)

    exact_force, exact = after(engines[-1], displacement)
    tolerance = step_count**2 * EPS * 0.05
    for sign in (-1, 1):
        # A compressed spring buckles: what rounding of the start makes of the end is what rounding may.
        shift = sign * random_field(model, seed + 1, 4 * EPS * far.max()) * ~model.node_is_fixed[:, None]
        tolerance += 10 * np.abs(after(engines[-1], displacement + shift)[1] - exact).max()
    assume(tolerance < 0.1)
    for engine in engines[:-1]:
        force, end = after(engine, displacement)
        assert (np.abs(force - exact_force) <= 48 * EPS * stretch_at_nodes(model, displacement) + 8 * at_nodes).all()
        assert np.abs(end - exact).max() <= tolerance


def check_probes(model, seed, engines, step_count):
    """Steps of a fast engine with probes in the tissue against the reference's, the last of the engines."""
    start = State(np.zeros((model.node_count, 3), np.float32), random_field(model, seed, 0.02))
    start.velocity[model.node_is_fixed] = 0
    probes = random_probes(model, seed)
    verlet = Verlet(step=stable_step(model), damping=0.1)

    def end_of(engine, probes):
        engine.load(start)
        engine.advance(step_count, verlet, probes)
        return engine.read().displacement.astype(float)

    exact = end_of(engines[-1], probes)
    # Where a node is put depends on a position, rounded to EPS of its coordinate; and whether a movement is shortened,
    # on which side of the reach a node is: what such a change of the probes makes of the end is what rounding may.
    scale = 1.0 + np.abs(model.node_index).max()
    tolerance = step_count**2 * EPS * scale
    for sign in (-1, 1):
        shifted = probes.astype(float)
        shifted[:, :3] += sign * 4 * EPS * scale
        shifted[:, 15] += sign * 4 * EPS * scale
        tolerance += 10 * np.abs(end_of(engines[-1], shifted) - exact).max()
    assume(tolerance < 0.1)
    for engine in engines[:-1]:
        assert np.abs(end_of(engine, probes) - exact).max() <= tolerance


def stable_step(model):
    """The default step of a lattice with explicit springs, in units of time."""
    rate = 24 * (model.cell_stiffness / model.cell_density).max() + model.explicit.rate_bound(model.inverse_mass)
    return 0.8 * 2 / np.sqrt(rate)
