"""The CPU's kernels of cells against the reference: every law, any cells, coverage, moments and cuts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.engine.shared.contact import NO_PROBES
from heartcase.simulator.forces.reference import elastic_forces
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from tests.simulator.lattices import EPS, block, random_field, random_models, random_moments, random_shares

LAWS = st.builds(
    ForceLaw,
    st.sampled_from(["springs", "element"]),
    st.sampled_from([0.25, 0.3, 0.45, 0.49]),
    st.booleans(),
    st.booleans(),
)
SEEDS = st.integers(0, 2**32 - 1)


def with_law(model, law, seed):
    """The model under a law, tissue anywhere in its cells, any part of it strained by means, some springs cut."""
    rng = np.random.default_rng(seed)
    model = replace(model, cell_moments=random_moments(model.cell_count, rng)).with_law(law)
    if law.has_shared_strain and rng.random() < 0.5:
        model = replace(model, cell_shares=random_shares(model.cell_count, rng))
    return model.without_springs(rng.random(model.spring_count) < rng.choice([0.0, 0.05]))


def force_scale(model, displacement):
    """What the forces on each node are made of: moduli times strain, which rounding is a part of, shape (n, 1)."""
    law = model.law
    u = displacement[model.cell_corners].astype(float)
    size = np.abs(u - u.mean(axis=1, keepdims=True)).max(axis=(1, 2))
    modulus = max(law.lame_modulus, law.youngs_modulus, law.plate_modulus) + 3.0
    part = modulus * model.cell_coverage * model.cell_stiffness * size * (1.0 + size) ** 5
    return np.bincount(model.cell_corners.ravel(), np.repeat(part, 8), model.node_count)[:, None]


@settings(max_examples=60, deadline=None)
@given(random_models(), LAWS, SEEDS, st.sampled_from([1e-6, 1e-3, 0.1, 0.4]))
def test_forces_agree(model, law, seed, size):
    """Some hundred operations on numbers of the size of modulus times strain; 1 / D keeps powers of strain low."""
    model = with_law(model, law, seed)
    displacement = random_field(model, seed, size)
    engine = make_engine(model, "cpu")
    engine.load(State(displacement, np.zeros_like(displacement)))
    gap = np.abs(engine.forces() - elastic_forces(model, displacement))
    assert (gap <= 40 * EPS * force_scale(model, displacement)).all()
    some = np.random.default_rng(seed).permutation(model.node_count)[:5]
    np.testing.assert_array_equal(engine.forces(some), engine.forces()[some])


@settings(max_examples=25, deadline=None)
@given(random_models(), LAWS, SEEDS)
def test_forty_steps_agree(model, law, seed):
    """No corner gets near to being flat here, so that the looks for such corners miss none."""
    model = with_law(model, law, seed)
    displacement = random_field(model, seed, 0.04)
    displacement[model.node_is_fixed] = 0
    rate = (model.cell_stiffness / model.cell_density).max()
    verlet = Verlet(step=0.5 / np.sqrt(3.0 * law.rest_bound * rate), damping=0.1)
    ends = []
    for backend in ("cpu", "reference"):
        engine = make_engine(model, backend)
        engine.load(State(displacement, np.zeros_like(displacement)))
        engine.advance(40, verlet)
        ends.append(engine.read().displacement)
    assert np.abs(ends[0] - ends[1]).max() <= 40**2 * EPS * np.abs(displacement).max()


@settings(max_examples=25, deadline=None)
@given(random_models(fixed=False), LAWS, SEEDS)
def test_rest_and_rigid_motion_make_no_force(model, law, seed):
    model = replace(with_law(model, law, seed), explicit=model.explicit)
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    x = model.node_index.astype(float)
    displacement = (x @ rotation.T + rng.uniform(-20, 20, 3) - x).astype(np.float32)
    engine = make_engine(model, "cpu")
    np.testing.assert_array_equal(engine.forces(), 0.0)
    engine.load(State(displacement, np.zeros_like(displacement)))
    modulus = 12 * law.lame_modulus + 8 * law.shear_modulus + 30.0
    # Positions are rounded to EPS / 2 of the largest displacement.
    tolerance = 4 * EPS * max(np.abs(displacement).max(), 4.0) * modulus
    assert np.abs(engine.forces()).max() <= tolerance


@pytest.mark.parametrize("law", [ForceLaw(), ForceLaw("springs", 0.4), ForceLaw("element", 0.3)])
def test_threads_give_the_same_bits_also_where_cells_are_inside_out(law):
    model = block(17, 6, 5, fix_base=True, law=law)
    displacement = random_field(model, 3, 0.6)
    displacement[model.node_is_fixed] = 0
    start = State(displacement, np.zeros_like(displacement))
    verlet = Verlet(step=0.8 * 2 / np.sqrt(law.stretched_bound), damping=0.02)
    ends = []
    for thread_counts in ((2,), (1,), (2, 1)):
        engine = make_engine(model, "cpu")
        engine.load(start)
        taken = 0
        while taken < 42:
            # the pieces in which steps are taken must not matter either
            count = 5 if len(thread_counts) == 2 else 21
            count = min(count, 42 - taken)
            engine.advance_by(thread_counts[taken % len(thread_counts)], count, verlet, NO_PROBES, taken)
            taken += count
        ends.append(engine.read())
    for end in ends[1:]:
        np.testing.assert_array_equal(end.displacement, ends[0].displacement)
        np.testing.assert_array_equal(end.velocity, ends[0].velocity)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_free_node_moves_at_most_half_a_cell_in_a_step(backend):
    model = block(3, 2, 2, fix_base=True)
    displacement = random_field(model, 5, 5.0)
    displacement[model.node_is_fixed] = 0
    engine = make_engine(model, backend)
    engine.load(State(displacement, np.zeros_like(displacement)))
    verlet = Verlet(step=0.3)
    for _ in range(20):
        before = engine.read().displacement
        engine.advance(1, verlet)
        way = np.abs(engine.read().displacement - before).max()
        assert way <= 0.5 * (1 + 20 * EPS)
    assert way > 0.1
