"""Threads share no cell and no spring: the bits are those of all forces together, in any number of chunks."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator import engine_cpu, kernel_cpu_chunks
from heartcase.simulator.contact import NO_PROBES
from heartcase.simulator.engine_cpu import CpuEngine
from heartcase.simulator.force_law import ForceLaw
from heartcase.simulator.integrate import Verlet
from heartcase.simulator.kernel_cpu_chunks import share_out
from heartcase.simulator.lanes import LANE_COUNT
from heartcase.simulator.state import State
from tests.simulator.lattices import block, random_field, random_models

SEEDS = st.integers(0, 2**32 - 1)
LAWS = {
    "springs": ForceLaw(),
    "unguarded": ForceLaw(guards_corners=False),
    "springs-0.4": ForceLaw("springs", 0.4),
    "element-0.3": ForceLaw("element", 0.3),
}
STEP = 2.0**-10
"""A power of two: what it is multiplied with keeps its bits."""


def engine_of(model, chunk_count: int, *, keeps_tensions: bool = True) -> CpuEngine:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine_cpu, "KEPT_LANES_MAX", 10**9 if keeps_tensions else 0)
        patch.setattr(kernel_cpu_chunks, "get_num_threads", lambda: chunk_count)
        return CpuEngine(model)


@settings(max_examples=80, deadline=None)
@given(random_models(size_max=(30, 6, 12)), st.sampled_from(sorted(LAWS)), SEEDS)
def test_a_step_is_that_of_all_forces_worked_out_together(model, law, seed):
    """Together springs are worked out from both their ends, and cells in one row."""
    model = model.with_law(LAWS[law])
    rng = np.random.default_rng(seed)
    model = model.without_springs(rng.random(model.spring_count) < 0.1)
    displacement = random_field(model, seed, 0.3)
    chunk_count = int(rng.integers(1, 6))
    kept = engine_of(model, chunk_count)
    apart = engine_of(model, chunk_count, keeps_tensions=False)
    assert apart.tension.size == 0 < kept.tension.size
    for thread_count, engine in product((2, 1), (kept, apart)):
        engine.load(State(displacement, np.zeros_like(displacement)))
        forces = engine.forces()
        # What was left by other displacements must not be read.
        if engine is kept:
            engine.tension[:, engine.layout.node_lane] = np.nan
        engine.cell_force[:] = np.nan
        engine.advance_by(thread_count, 1, Verlet(STEP), NO_PROBES)
        expected = np.float32(STEP) * (forces * model.inverse_mass[:, None])
        np.testing.assert_array_equal(engine.read().velocity, expected)
    assert np.abs(forces).max() > 0


@settings(max_examples=40, deadline=None)
@given(random_models(size_max=(30, 6, 12)), st.integers(1, 6), SEEDS, st.floats(0.0, 1.0))
def test_chunks_find_the_tensions_of_all_springs_behind(model, chunk_count, seed, asleep):
    engine = engine_of(model, chunk_count)
    layout, sleep, chunks = engine.layout, engine._sleep, engine._chunks
    sleep.is_asleep[:] = np.random.default_rng(seed).random(layout.window_count) < asleep
    awake = np.flatnonzero(sleep.is_asleep == 0)
    sleep.awake[: len(awake)] = awake
    sleep.counts[0] = len(awake)
    share_out(chunks, sleep)
    window_of_node = layout.node_slot // LANE_COUNT
    lower, higher = window_of_node[model.spring_nodes].T
    stepped = []
    for chunk in range(len(chunks.before_counts)):
        own = sleep.awake[chunks.ends[chunk] : chunks.ends[chunk + 1]]
        before = chunks.before[chunk, : chunks.before_counts[chunk]]
        assert not np.intersect1d(own, before).size
        assert np.isin(lower[np.isin(higher, own)], np.concatenate([own, before])).all()
        stepped.append(own)
    np.testing.assert_array_equal(np.concatenate(stepped), awake)


@pytest.mark.parametrize("law", LAWS)
def test_many_steps_are_the_same_in_any_number_of_chunks(law):
    """Corners are flat in some cells: the field folds them."""
    model = block(20, 7, 13, fix_base=True, law=LAWS[law])
    start = State(random_field(model, 1, 0.4), random_field(model, 2, 0.01))
    ends = []
    for chunk_count in (1, 2, 5, 7):
        engine = engine_of(model, chunk_count)
        assert len(engine._chunks.before_counts) == min(chunk_count, 7)
        engine.load(start)
        engine.advance_by(min(chunk_count, 3), 40, Verlet(0.1, 0.01), NO_PROBES)
        ends.append(engine.read().displacement.tobytes())
        assert np.isfinite(engine.read().displacement).all()
    assert len(set(ends)) == 1


def test_chunks_of_a_heart_work_out_few_tensions_twice():
    engine = engine_of(block(40, 40, 50), 2)
    assert len(engine._chunks.before_counts) == 2
    assert engine._chunks.before_counts.sum() <= 1.2 * engine.layout.window_count / 50
    assert len(engine_of(block(40, 40, 1), 16)._chunks.before_counts) == 1
