"""Lattices that were cut: nodes with copies, and cells and springs that the lanes do not hold, on every backend."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.dynamics.step_size import own_step_limit
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.engine.cpu.engine import CpuEngine
from heartcase.simulator.engine.shared.cell_lanes import cell_layout
from heartcase.simulator.engine.shared.contact import NO_PROBES
from heartcase.simulator.engine.shared.lanes import LANE_COUNT, lane_layout
from heartcase.simulator.forces.reference import elastic_forces
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from tests.simulator.lattices import EPS, block, cut_models, random_field, tied

SEEDS = st.integers(0, 2**32 - 1)
LAWS = [
    ForceLaw(guards_corners=False),
    ForceLaw(),
    ForceLaw("springs", 0.45),
    ForceLaw("element", 0.3, shares_strain=False),
    ForceLaw("element", 0.45),
]
laws = st.sampled_from(LAWS)


def cut_block(size, law=None, *, seed=0, sheet_count=4, **options) -> LatticeModel:
    """A block under so many sheets askew, which cross."""
    rng = np.random.default_rng(seed)
    model = block(*size, law=law, **options)
    sheets = []
    for _ in range(sheet_count):
        middle = np.array(size) * rng.uniform(0.2, 0.8, 3)
        along, across = rng.normal(size=(2, 3)) * np.array(size) / 3
        sheets.append(
            Sheet.swept([[middle - along - across, middle + along], [middle - along, middle + along + across]])
        )
    return part(model, sheets, TissueSamples.everywhere()).model


def small_sheet() -> Sheet:
    """A sheet through one cell of a block and none of those around it."""
    low, high = 2.01, 2.99
    return Sheet.swept([[[low, low, 2.5], [high, low, 2.5]], [[low, high, 2.5], [high, high, 2.5]]])


def forces_of(model: LatticeModel, displacement) -> tuple[np.ndarray, np.ndarray]:
    engine = CpuEngine(model)
    engine.load(State(displacement, np.zeros_like(displacement)))
    return engine.forces(), elastic_forces(model, displacement)


@settings(max_examples=60, deadline=None)
@given(laws, st.data(), SEEDS, st.sampled_from([1e-4, 0.1, 0.5]))
def test_forces_agree(law, data, seed, scale):
    """Rounding is that of the largest force around: of some 100 terms at a node."""
    model = data.draw(cut_models(law=law))
    displacement = random_field(model, seed, scale)
    ours, truth = forces_of(model, displacement)
    assert np.abs(ours - truth).max() <= 100 * EPS * max(np.abs(truth).max(), scale)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("size", [(5, 5, 5), (40, 5, 5)])
def test_a_cell_is_parted_by_a_sheet_that_leaves_all_nodes_whole(law, size):
    """Both pieces of the one cell have the same eight nodes: neither may be forgotten."""
    whole = block(*size, law=law)
    model = part(whole, [small_sheet()], TissueSamples.everywhere()).model
    assert (model.node_count, model.cell_count) == (whole.node_count, whole.cell_count + 1)
    rows = model.cell_corners.tolist()
    assert rows.count(rows[-1]) == 2
    for seed in range(3):
        displacement = random_field(model, seed, 0.3)
        ours, truth = forces_of(model, displacement)
        assert np.abs(ours - truth).max() <= 100 * EPS * np.abs(truth).max()


@settings(max_examples=20, deadline=None)
@given(laws, st.data())
def test_rest_is_an_exact_equilibrium(law, data):
    model = data.draw(cut_models(law=law))
    engine = CpuEngine(model)
    assert np.abs(engine.forces()).max(initial=0.0) == 0
    engine.advance(10, Verlet(0.1))
    assert not engine.read().displacement.any()


@settings(max_examples=40, deadline=None)
@given(st.sampled_from([law for law in LAWS if not law.has_corner_guard]), st.data(), SEEDS)
def test_steps_agree(law, data, seed):
    model = data.draw(cut_models(law=law))
    displacement = random_field(model, seed, 0.05)
    displacement[model.node_is_fixed] = 0
    verlet = Verlet(0.5 * own_step_limit(model) / model.units.time_s, 0.05, (0.001, -0.002, 0.003))
    ends = []
    for backend in ("cpu", "reference"):
        engine = make_engine(model, backend)
        engine.load(State(displacement, np.zeros_like(displacement)))
        engine.advance(40, verlet)
        ends.append(engine.read().displacement)
    assert np.abs(ends[0] - ends[1]).max() <= 40**2 * EPS * 0.05


@settings(max_examples=20, deadline=None)
@given(st.data(), SEEDS)
def test_corners_are_guarded_alike(data, seed):
    """A row of one step looks at every corner; of more, the kernel looks every eighth step alone."""
    law = data.draw(st.sampled_from([ForceLaw(), ForceLaw("springs", 0.45)]))
    model = data.draw(cut_models(law=law))
    displacement = random_field(model, seed, 0.3)

    def end_of(backend, start):
        engine = make_engine(model, backend)
        engine.load(State(start.astype(np.float32), np.zeros_like(start, np.float32)))
        for _ in range(5):
            engine.advance(1, Verlet(0.05, 0.05))
        return engine.read().displacement.astype(float)

    exact = end_of("reference", displacement)
    # Whether a corner is guarded depends on its volume: what rounding of the start makes of the end is what it may.
    shifts = [sign * random_field(model, seed + 1, 4 * EPS) for sign in (-1, 1)]
    tolerance = 1e-5 + 10 * max(np.abs(end_of("reference", displacement + shift) - exact).max() for shift in shifts)
    assume(tolerance < 0.01)
    assert np.abs(end_of("cpu", displacement) - exact).max() <= tolerance


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("still", [(0.0, 0.0), (1e-3, 1e-4)])
def test_result_does_not_depend_on_the_number_of_threads(law, still):
    model = tied(cut_block((24, 9, 9), law, fix_base=True), 7)
    engine = CpuEngine(model)
    assert len(engine.layout.irregular_cells)
    assert len(engine.layout.irregular_springs(model))
    displacement = random_field(model, 1, 0.1)
    displacement[model.node_index[:, 0] > 8] = 0
    results = []
    for thread_count in (1, 2, 3):
        engine.load(State(displacement, np.zeros_like(displacement)))
        engine.advance_by(thread_count, 50, Verlet(0.1, 0.05, still=still), NO_PROBES)
        end = engine.read()
        results.append(end.displacement.tobytes() + end.velocity.tobytes())
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("law", LAWS)
def test_chunks_do_not_matter(law, monkeypatch):
    from heartcase.simulator.engine.cpu import chunks

    model = cut_block((17, 8, 9), law, seed=3)
    ends = []
    for count in (1, 2, 4):
        monkeypatch.setattr(chunks, "get_num_threads", lambda count=count: count)
        engine = CpuEngine(model)
        engine.load(State(random_field(model, 1, 0.1), random_field(model, 2, 0.01)))
        engine.advance_by(1, 20, Verlet(0.1, 0.05), NO_PROBES)
        ends.append(engine.read().displacement.tobytes())
    assert ends[0] == ends[1] == ends[2]


@settings(max_examples=40, deadline=None)
@given(cut_models(), st.booleans())
def test_kernels_find_and_take_for_their_own_what_is_theirs(model, in_banks):
    layout = lane_layout(model, in_banks=in_banks)
    lanes = layout.node_lane
    assert len(np.unique(lanes)) == model.node_count
    slots = layout.window_rows[layout.node_slot // LANE_COUNT, 4] + layout.node_slot % LANE_COUNT
    np.testing.assert_array_equal(slots, lanes)
    # In each window's lanes lie nodes of no other window.
    starts = np.sort(layout.window_rows[:, 4])
    assert (np.diff(starts) >= LANE_COUNT).all()
    weight = layout.spring_weight(model, np.arange(1, model.spring_count + 1, dtype=np.float32))
    regular = np.ones(model.spring_count, np.bool_)
    regular[layout.irregular_springs(model)] = False
    nodes = np.arange(model.node_count)
    for number, offset in enumerate(DIRECTIONS):
        own = model.spring_direction == number
        for ends, way, at_lower in (((0, 1), offset, True), ((1, 0), -offset, False)):
            found = layout.neighbour_lanes(nodes, way)
            read = weight[layout.stride * number + (lanes if at_lower else found)]
            truth = np.zeros(model.node_count)
            chosen = np.flatnonzero(own & regular)
            truth[model.spring_nodes[chosen, ends[0]]] = chosen + 1
            np.testing.assert_array_equal(read, truth)
            there = model.spring_nodes[chosen, ends[1]]
            np.testing.assert_array_equal(found[model.spring_nodes[chosen, ends[0]]], lanes[there])
    cells = cell_layout(model, layout)
    assert len(np.unique(cells.cell_lane)) == model.cell_count


@pytest.mark.parametrize("in_banks", [False, True])
def test_ghosts_lie_behind_all_nodes(in_banks):
    """Also where there are more of them than rows."""
    model = cut_block((60, 6, 6), seed=4, sheet_count=8)
    layout = lane_layout(model, in_banks=in_banks)
    assert 5 * len(layout.ghost_start) > len(np.unique(model.node_index[:, 1:], axis=0))
    assert layout.ghost_start.min() > layout.node_lane.max()
    assert layout.lane_count > layout.ghost_start.max() + 32
    if not in_banks:
        assert layout.lane_count < layout.node_lane.max() + 48 * (len(layout.ghost_start) + 2)


def test_a_lattice_without_copies_has_nothing_irregular():
    layout = lane_layout(block(12, 5, 4))
    assert not layout.is_near_copies.any()
    assert not len(layout.irregular_cells)


@pytest.mark.parametrize("seed", range(4))
def test_few_springs_are_irregular_where_a_plane_cuts_a_block(seed):
    """A plane parts thousands; those that do not fit lie where it changes from row to row."""
    rng = np.random.default_rng(seed)
    uncut = block(24, 16, 16)
    normal = rng.normal(size=3)
    along = np.cross(normal, [1.0, 0.3, 0.2])
    across = np.cross(normal, along)
    along, across = (20 * v / np.linalg.norm(v) for v in (along, across))
    middle = np.array([12.0, 8.0, 8.0])
    sheet = Sheet.swept(
        [[middle - along - across, middle + along - across], [middle - along + across, middle + along + across]]
    )
    model = part(uncut, [sheet], TissueSamples.everywhere()).model
    layout = lane_layout(model)
    added = model.spring_count - uncut.spring_count
    assert added > 500
    assert len(layout.irregular_springs(model)) < added
