"""Threads share no cell and no spring: the bits are those of all forces together, in any number of chunks."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numba import njit
from numba.core.registry import cpu_target

from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.engine.cpu import chunks as kernel_cpu_chunks
from heartcase.simulator.engine.cpu import engine as engine_cpu
from heartcase.simulator.engine.cpu import kernel as kernel_cpu
from heartcase.simulator.engine.cpu.arrays import CellWork
from heartcase.simulator.engine.cpu.cells import is_flat_window
from heartcase.simulator.engine.cpu.chunks import share_out
from heartcase.simulator.engine.cpu.engine import CpuEngine
from heartcase.simulator.engine.cpu.steps import STEPS_BY_ORDER
from heartcase.simulator.engine.shared.contact import NO_PROBES
from heartcase.simulator.engine.shared.lanes import CELL_LANES, LANE_COUNT
from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.lattice.moduli import LOOK_BELOW, ForceLaw
from heartcase.simulator.lattice.state import State
from tests.simulator.lattices import block, block_cells, random_field, random_models, random_shares

SEEDS = st.integers(0, 2**32 - 1)
LAWS = {
    "springs": ForceLaw(),
    "unguarded": ForceLaw(guards_corners=False),
    "springs-0.4": ForceLaw("springs", 0.4),
    "element-0.3": ForceLaw("element", 0.3, shares_strain=False),
    "sharing": ForceLaw("element", 0.3),
}
HAS_AVX512 = "+avx512vl" in cpu_target.target_context.codegen().magic_tuple()[2]
STEP = 2.0**-10
"""A power of two: what it is multiplied with keeps its bits."""


def under(model, law):
    """The model under a law; where it shares strain, any part of its cells does."""
    model = model.with_law(LAWS[law])
    if law != "sharing":
        return model
    return replace(model, cell_shares=random_shares(model.cell_count, np.random.default_rng(model.cell_count)))


def engine_of(model, chunk_count: int, *, keeps_tensions: bool = True) -> CpuEngine:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine_cpu, "KEPT_NODES_MAX", 10**9 if keeps_tensions else 0)
        patch.setattr(kernel_cpu_chunks, "get_num_threads", lambda: chunk_count)
        return CpuEngine(model)


@njit
def look(displacement, numbers, rows, window, in_pairs):
    return is_flat_window(displacement, numbers, rows, window, in_pairs)


def looked_at(engine):
    """Whether each window of an engine's cells has a flat corner."""
    cells = engine._cell_arrays
    windows = range(len(cells.rows))
    return np.array([look(engine.displacement, cells.numbers, cells.rows, at, cells.in_pairs[at]) for at in windows])


def least_corner_volume(corners: np.ndarray) -> np.ndarray:
    """Least volume that a cell's edges span at one of its corners, of positions (count, 8, 3)."""
    at = {tuple(offset): number for number, offset in enumerate(CORNER_OFFSETS.tolist())}
    volumes = []
    for i, j, k in at:
        here = corners[:, at[i, j, k]]
        beside = [corners[:, at[place]] - here for place in ((1 - i, j, k), (i, 1 - j, k), (i, j, 1 - k))]
        volumes.append(np.linalg.det(np.stack(beside, axis=1)) * (-1) ** (i + j + k))
    return np.min(volumes, axis=0)


@settings(max_examples=80, deadline=None)
@given(random_models(size_max=(30, 6, 12)), st.sampled_from(sorted(LAWS)), SEEDS)
def test_a_step_is_that_of_all_forces_worked_out_together(model, law, seed):
    """Together springs are worked out from both their ends, and cells in one row."""
    model = under(model, law)
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
            engine.tension[engine.layout.places(engine.layout.node_lane, 9)] = np.nan
        engine.cell_force[:] = np.nan
        if model.shares_strain:
            # Lanes without a cell read some of it, with a share of zero.
            engine._sharing.stress[engine.layout.places(engine.layout.node_lane, 9)] = 1e30
            engine._sharing.gradient[engine.layout.places(engine.cells.cell_lane, 9)] = 1e30
        engine.advance_by(thread_count, 1, Verlet(STEP), NO_PROBES)
        expected = np.float32(STEP) * (forces * model.inverse_mass[:, None])
        np.testing.assert_array_equal(engine.read().velocity, expected)
    assert np.abs(forces).max() > 0


def make_step(in_stages: bool):
    step = STEPS_BY_ORDER[in_stages]

    @njit
    def steps(arrays, windows, constants):
        step(*arrays, windows, 0, len(windows), constants)

    return steps


STEPS = {in_stages: make_step(in_stages) for in_stages in STEPS_BY_ORDER}


@pytest.mark.skipif(not HAS_AVX512, reason="springs in stages need a processor with AVX-512")
@settings(max_examples=40, deadline=None)
@given(random_models(size_max=(30, 6, 12)), SEEDS)
def test_springs_in_stages_give_the_same_bits_as_one_after_the_other(model, seed):
    """Whatever the windows: all of them, some in a row, one, or none."""
    engine = engine_of(model, 1)
    rng = np.random.default_rng(seed)
    first, end = np.sort(rng.integers(0, engine.layout.window_count + 1, 2)) if seed % 2 else (0, None)
    windows = np.arange(engine.layout.window_count)[first:end]
    constants = (0.3, 0.99, 0.29, 0.001, -0.002, 0.003, 1.5)
    ends = []
    for in_stages in (False, True):
        engine.load(State(random_field(model, seed, 0.3), random_field(model, seed + 1, 0.01)))
        now, later = engine.displacement, np.zeros_like(engine.displacement)
        engine.tension[:] = 0
        room = engine.cell_force[0]
        arrays = (now, later, engine.velocity, engine.weight, engine.window_numbers, engine.tension, room)
        arrays += (engine.inverse_mass, engine._rows)
        STEPS[in_stages](arrays, windows, tuple(np.float32(constant) for constant in constants))
        changed = (later, engine.velocity, engine.tension)
        ends.append(b"".join(array.tobytes() for array in changed))
        assert later.any() == (len(windows) > 0)
    assert ends[0] == ends[1]


@pytest.mark.parametrize("corner", range(8))
@pytest.mark.parametrize(("way", "is_flat"), [(0.133, False), (0.134, True), (0.119, False), (0.121, False)])
def test_the_smallest_difference_that_makes_a_corner_flat_is_seen(corner, way, is_flat):
    """One corner of a cell goes towards its middle: each edge gets shorter by c and bent by c twice, J = 1 - 3 c."""
    engine = engine_of(block(1, 1, 1), 1)
    displacement = np.zeros((8, 3), np.float32)
    node = engine.model.cell_corners[0, corner]
    displacement[node] = way * (1 - 2 * CORNER_OFFSETS[corner])
    assert (least_corner_volume((engine.model.node_index + displacement)[engine.model.cell_corners]) < 0.6) == is_flat
    engine.load(State(displacement, np.zeros_like(displacement)))
    assert looked_at(engine)[0] == is_flat


def step_one_chunk(engine: CpuEngine, chunk: int) -> None:
    later = np.zeros_like(engine.displacement)
    state = (engine.displacement, later, engine.velocity, engine.weight, engine.window_numbers, engine.tension)
    state += (engine.inverse_mass, engine._rows)
    constants = tuple(np.float32(number) for number in Verlet(0.1).numbers)
    work = CellWork(engine._cell_arrays, engine._kinds, engine._sharing, engine._ghosts)
    kernel_cpu._step_chunk_with_cells(chunk, state, constants, work, engine._chunks, engine._sleep)


def test_the_forces_of_one_chunk_are_not_those_of_another():
    """What a chunk's cells do is kept in a room of its own: three chunks share an array."""
    model = block(4, 4, 20, law=LAWS["element-0.3"])
    engine = engine_of(model, 7)
    engine.load(State(random_field(model, 1, 0.1), random_field(model, 2, 0.01)))
    for stepped in range(7):
        engine.cell_force[:] = np.nan
        step_one_chunk(engine, stepped)
        for chunk in range(7):
            room, number = divmod(chunk, kernel_cpu.CHUNKS_PER_ROOM)
            places = engine.layout.places(engine.layout.node_lane, 3 * kernel_cpu.CHUNKS_PER_ROOM)
            forces = engine.cell_force[room][places[:, 3 * number :][:, :3]]
            assert np.isnan(forces).all() == (chunk != stepped)


@settings(max_examples=40, deadline=None)
@given(random_models(size_max=(30, 6, 12)), SEEDS, st.floats(0.0, 0.3), st.floats(0.0, 3.0))
def test_no_corner_is_overlooked_where_the_corners_of_a_cell_are_near_each_other(model, seed, scale, far):
    """The look spares itself a window's corners where none can be flat; the reference works out all."""
    engine = engine_of(model, 1)
    displacement = random_field(model, seed, scale) + np.float32(far)
    engine.load(State(displacement, np.zeros_like(displacement)))
    found = looked_at(engine)
    positions = model.node_index + displacement.astype(float)
    volume = least_corner_volume(positions[model.cell_corners])
    least = np.full(len(found), np.inf)
    np.minimum.at(least, engine.cells.cell_slot // CELL_LANES, volume)
    is_clear = np.abs(least - LOOK_BELOW) > 1e-5
    np.testing.assert_array_equal(found[is_clear], least[is_clear] < LOOK_BELOW)


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
    model = under(block(20, 7, 13, fix_base=True), law)
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


def sparse_model(law):
    """Cells at random, so that many lanes hold none, of which each shares strain in part where the law has that."""
    rng = np.random.default_rng(1)
    cells = block_cells(20, 8, 14)
    return under(make_model(cells[rng.random(len(cells)) < 0.3]), law)


@pytest.mark.parametrize("law", LAWS)
def test_nothing_is_left_of_a_state_that_broke_down(law):
    model = sparse_model(law)
    start = State(random_field(model, 1, 0.1), random_field(model, 2, 0.01))
    broken = State(np.full_like(start.displacement, np.nan), start.velocity)
    ends = []
    for states in ([start], [broken, start]):
        engine = engine_of(model, 3)
        for state in states:
            engine.load(state)
            engine.advance_by(2, 9, Verlet(0.1, 0.01), NO_PROBES)
        ends.append(engine.read().displacement.tobytes())
        assert np.isfinite(engine.read().displacement).all()
    assert ends[0] == ends[1]


def test_an_engine_goes_on_with_cells_that_share_strain_no_more_and_again():
    model = sparse_model("sharing")
    alone = replace(model, cell_shares=np.zeros_like(model.cell_shares))
    start = State(random_field(model, 1, 0.1), random_field(model, 2, 0.01))
    ends = {}
    for models in ([model], [alone], [model, alone], [alone, model], [model, alone, model]):
        engine = engine_of(models[0], 3)
        for each in models:
            engine.set_springs(each)
            engine.load(start)
            engine.advance_by(2, 9, Verlet(0.1, 0.01), NO_PROBES)
        ends.setdefault(each.shares_strain, set()).add(engine.read().displacement.tobytes())
    assert len(ends) == 2
    assert all(len(found) == 1 for found in ends.values())


def test_chunks_of_a_heart_work_out_few_tensions_twice():
    engine = engine_of(block(40, 40, 50), 2)
    assert len(engine._chunks.before_counts) == 2
    assert engine._chunks.before_counts.sum() <= 1.2 * engine.layout.window_count / 50
    assert len(engine_of(block(40, 40, 1), 16)._chunks.before_counts) == 1


@pytest.mark.parametrize("chunk_count", [2, 3, 7])
def test_chunks_are_as_much_work_as_each_other(chunk_count):
    """A window of which the tensions alone are needed is half as much as one that is stepped."""
    chunks = engine_of(block(20, 30, 40), chunk_count)._chunks
    work = 2 * np.diff(chunks.ends) + chunks.before_counts
    assert chunks.before_counts[0] == 0 < chunks.before_counts[1:].min()
    assert work.max() - work.min() <= 0.02 * work.mean()


@settings(max_examples=40, deadline=None)
@given(random_models(size_max=(30, 6, 12)), st.integers(1, 6), SEEDS, st.floats(0.0, 1.0))
def test_chunks_know_means_and_gradients_before_they_need_them(model, chunk_count, seed, asleep):
    """Of the cells that are awake: what sleeps was worked out before."""
    engine = engine_of(under(model, "sharing"), chunk_count)
    assume(engine.model.shares_strain)
    layout, sleep, chunks, cells = engine.layout, engine._sleep, engine._chunks, engine.cells
    awake = np.flatnonzero(np.random.default_rng(seed).random(len(cells.window_rows)) >= asleep)
    sleep.awake_cells[: len(awake)] = awake
    sleep.counts[1] = len(awake)
    share_out(chunks, sleep)
    window_of_cell = cells.cell_slot // CELL_LANES
    corner_windows = layout.node_slot[model.cell_corners] // LANE_COUNT
    for chunk in range(len(chunks.cell_counts)):
        listed = chunks.cells[chunk, : chunks.cell_counts[chunk]]
        own = np.flatnonzero(chunks.chunk_of == chunk)
        needed = np.unique(window_of_cell[np.isin(corner_windows, own).any(axis=1)])
        np.testing.assert_array_equal(listed, np.intersect1d(needed, awake))
        for place, window in enumerate(listed):
            means = chunks.means[chunk, : chunks.mean_ends[chunk, place]]
            at = corner_windows[window_of_cell == window]
            assert np.isin(at, means).all()
            strained = chunks.strained[chunk, : chunks.strained_ends[chunk, len(means) - 1]]
            around = np.unique(window_of_cell[np.isin(corner_windows, means).any(axis=1)])
            assert np.isin(np.intersect1d(around, awake), strained).all()
            assert (np.diff(means) > 0).all()
            assert (np.diff(strained) > 0).all()
