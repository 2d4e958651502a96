"""Cutting while tissue moves: nothing jumps, hands hold on, and going back gives the same bytes."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, lattice_keys
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.blade_sheet import Sheet, key_indices
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.cutting.descent import cells_of_samples
from heartcase.simulator.cutting.rest_space import blade_at_rest, places_at_rest, refined
from heartcase.simulator.cutting.rest_space_kernels import Tissue, find_near, follow_back
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from tests.simulator.cutting.plain_rest import plain_blade_at_rest, plain_refined
from tests.simulator.lattices import block, oblique_geometry, random_field

LAWS = [ForceLaw(), ForceLaw("springs", 0.45), ForceLaw("element", 0.45)]
FULL = TissueSamples.everywhere()


def sheet_through(model, rng) -> Sheet:
    middle = model.node_index.mean(axis=0) + rng.uniform(-1, 1, 3)
    along, across = rng.normal(size=(2, 3)) * 4
    return Sheet.swept([[middle - along - across, middle + along - across], [middle - along + across, middle + along]])


def blade_mm(model, points):
    """Points in the frame of the nodes [cells], LPS mm."""
    return model.geometry.index_to_world(np.asarray(points, dtype=float) - 0.5)


def across_bar(model, place=4.3, depth=2.6):
    """A blade across a bar along i, from above down to a depth below its top."""
    top = model.node_index[:, 2].max() + 1.0
    low = top - 1.0 - depth
    points = [[[place, -1.0, top], [place, -1.0, low]], [[place, 9.0, top], [place, 9.0, low]]]
    return blade_mm(model, points)


def moving_bar(backend, law=None, **options):
    model = block(9, 4, 4, law=law, geometry=oblique_geometry((4, 4, 9)), fix_base=False)
    model.node_is_fixed[model.node_index[:, 0] == 0] = True
    simulation = Simulation(model, backend=backend, sleep_mm=0, **options)
    tip = model.rest_positions_mm()[model.node_index[:, 0] == 9].mean(axis=0)
    hand = simulation.grab(tip, 2.0 * model.cell_mm)
    simulation.lead(hand, 0.6 * model.cell_mm * np.array([0.3, 0.4, 0.8]))
    simulation.step(60)
    return simulation, hand


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("law", LAWS)
def test_nothing_moves_when_tissue_is_cut(backend, law):
    simulation, hand = moving_bar(backend, law)
    model, state = simulation.model, simulation.state
    before, force = simulation.energy(), simulation.force_on(hand)
    momentum = (model.node_mass[:, None] * state.velocity.astype(float)).sum(axis=0)
    simulation.cut(across_bar(model))
    cut = simulation.model
    assert cut.node_count > model.node_count
    assert simulation.step_count == 60
    np.testing.assert_array_equal(simulation.state.displacement[: model.node_count], state.displacement)
    np.testing.assert_allclose(simulation.energy().elastic_j, before.elastic_j, rtol=0.02 if law.is_element else 1e-5)
    now = (cut.node_mass[:, None] * simulation.state.velocity.astype(float)).sum(axis=0)
    np.testing.assert_allclose(now, momentum, atol=1e-6 * np.abs(momentum).max())
    np.testing.assert_allclose(cut.node_mass.sum(dtype=float), model.node_mass.sum(dtype=float), rtol=1e-6)
    np.testing.assert_allclose(simulation.force_on(hand), force, rtol=2e-2, atol=1e-6)
    simulation.step(60)
    assert np.isfinite(simulation.positions_mm()).all()
    # The lips part.
    copies = np.flatnonzero(np.bincount(np.unique(cut.node_index, axis=0, return_inverse=True)[1].ravel()) > 1)
    assert len(copies)
    assert np.ptp(simulation.state.displacement, axis=0).max() > 0.1


@pytest.mark.parametrize("law", LAWS)
def test_steps_after_a_cut_agree_with_the_reference(law):
    ends = []
    for backend in ("cpu", "reference"):
        simulation, _ = moving_bar(backend, law)
        simulation.cut(across_bar(simulation.model))
        simulation.step(50)
        simulation.cut(across_bar(simulation.model, 6.2, 1.4))
        simulation.step(50)
        ends.append(simulation.positions_mm())
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-3)


def test_a_hand_holds_all_copies_of_what_it_held():
    simulation, hand = moving_bar("cpu")
    held = simulation.model.node_index[hand.nodes]
    simulation.cut(across_bar(simulation.model, 8.5, 5.0))
    assert len(hand.nodes) > len(held)
    np.testing.assert_array_equal(np.unique(simulation.model.node_index[hand.nodes], axis=0), np.unique(held, axis=0))
    simulation.lead(hand, (2.0, 0.0, 0.0))
    simulation.step(10)
    moved = simulation.state.displacement[hand.nodes] - hand.displacement_at(hand.pose)
    np.testing.assert_allclose(moved, 0, atol=1e-5)


def test_going_back_before_a_cut_and_on_again_gives_the_same_bytes():
    simulation, hand = moving_bar("cpu")
    start = simulation.snapshot()
    ends = []
    for _ in range(2):
        simulation.cut(across_bar(simulation.model))
        between = simulation.snapshot()
        simulation.step(30)
        ends.append((simulation.state.displacement.tobytes(), simulation.force_on(hand).tobytes()))
        simulation.restore(between)
        simulation.step(30)
        ends.append((simulation.state.displacement.tobytes(), simulation.force_on(hand).tobytes()))
        simulation.restore(start)
        assert simulation.model is start.model
    assert ends[0] == ends[1] == ends[2] == ends[3]
    simulation.step(30)
    uncut = simulation.state.displacement.tobytes()
    simulation.restore(start)
    simulation.step(30)
    assert simulation.state.displacement.tobytes() == uncut


def test_explicit_springs_hold_on():
    simulation, _ = moving_bar("cpu")
    ends = np.flatnonzero((simulation.model.node_index == (4, 2, 4)).all(axis=1))[0], 7
    simulation.add_springs([ends], 0.05)
    simulation.cut(across_bar(simulation.model))
    spring = simulation.model.explicit.nodes[0]
    np.testing.assert_array_equal(simulation.model.node_index[spring], simulation.model.node_index[list(ends)])
    simulation.step(5)


def test_what_cannot_be_cut_is_refused_and_changes_nothing():
    simulation, _ = moving_bar("cpu")
    model = simulation.model
    for poses in ([[1, 2, 3]], [[[0, 0, 0]], [[1, 1, 1]]], np.full((2, 2, 3), np.nan), np.full((2, 2, 3), 1e9), "ab"):
        with pytest.raises(SimulationError, match="blade"):
            simulation.cut(poses)
        assert simulation.model is model
    far = np.array([[[0.0, 0, 0], [9e4, 0, 0]], [[0, 9e4, 0], [9e4, 9e4, 0]]])
    with pytest.raises(SimulationError, match="reaches too far"):
        simulation.cut(far)
    simulation.remove_springs(np.arange(model.spring_count) == 0)
    with pytest.raises(SimulationError, match="springs of this lattice were removed"):
        simulation.cut(across_bar(model))


@settings(max_examples=25, deadline=None)
@example(15324, 1.0)  # in a cell that does not hold the place Newton's method goes round without an end
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.2, 1.0]))
def test_a_blade_cuts_what_it_meets(seed, size):
    """Places of deformed tissue, worked out from places at rest, are followed back to these."""
    rng = np.random.default_rng(seed)
    model = block(6, 5, 4)
    stretch = np.eye(3) + size * rng.uniform(-0.3, 0.3, (3, 3))
    shift = size * rng.uniform(-5, 5, 3)
    displacement = (model.node_index @ (stretch - np.eye(3)).T + shift).astype(np.float32)
    places = rng.uniform((0, 0, 0), (6, 5, 4), (40, 3))
    found, is_open = places_at_rest(model, displacement, places @ stretch.T + shift)
    assert not is_open.any()
    np.testing.assert_allclose(found, places, atol=1e-4)
    # Beside it nothing is torn: neighbours stay neighbours.
    beside = np.linspace((-3.0, 2, 2), (12.0, 3, 2), 40) + shift
    back, _ = places_at_rest(model, displacement, beside)
    assert np.linalg.norm(np.diff(back, axis=0), axis=1).max() < 0.4 + 2.5 * size
    # In a cell that is warped, what its trilinear displacements say.
    displacement += random_field(model, seed % 1000, 0.1 * size)
    at, now = places_in_cells(model, displacement, rng)
    np.testing.assert_allclose(places_at_rest(model, displacement, now)[0], at, atol=1e-4)


def places_in_cells(model, displacement, rng):
    """Places at rest in some cells, and where they are now."""
    inside = rng.uniform(0, 1, (60, 3))
    cells = rng.integers(model.cell_count, size=60)
    weight = np.where(CORNER_OFFSETS == 1, inside[:, None], 1 - inside[:, None]).prod(axis=2)
    at = model.cells[cells] + inside
    return at, at + np.einsum("nc,nci->ni", weight, displacement[model.cell_corners[cells]].astype(float))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1.0, 3.5))
def test_a_blade_cuts_what_it_meets_where_tissue_is_pulled_long_and_thin(seed, length):
    """There the middles of many other cells are nearer to a place than that of the cell which holds it."""
    rng = np.random.default_rng(seed)
    model = block(6, 5, 4)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pull = turn @ np.diag([length, length**-0.5, length**-0.5]) @ turn.T
    displacement = (model.node_index @ (pull - np.eye(3)).T).astype(np.float32) + random_field(model, seed % 1000, 0.05)
    at, now = places_in_cells(model, displacement, rng)
    found, is_open = places_at_rest(model, displacement, now)
    assert not is_open.any()
    np.testing.assert_allclose(found, at, atol=1e-4)


def test_a_place_in_a_bent_cell_is_found_where_a_step_towards_it_goes_too_far():
    model = block(7, 6, 5)
    displacement = np.random.default_rng(46).normal(0, 0.25, (model.node_count, 3)).astype(np.float32)
    inside = np.array([0.01627506, 0.87868984, 0.05712053])
    weight = np.where(CORNER_OFFSETS == 1, inside, 1 - inside).prod(axis=1)
    at = model.cells[162] + inside
    now = at + weight @ displacement[model.cell_corners[162]].astype(float)
    np.testing.assert_allclose(places_at_rest(model, displacement, now)[0], at, atol=1e-4)


def test_a_blade_is_refined_along_both_of_its_ways():
    poses = np.array([[[0.0, 0, 0], [3, 0, 0], [3, 1, 0]], [[0, 0, 2], [3, 0, 2], [3, 1, 2.2]]])
    finer = refined(poses)
    assert np.linalg.norm(np.diff(finer, axis=0), axis=2).max() <= 0.5 + 1e-9
    assert np.linalg.norm(np.diff(finer, axis=1), axis=2).max() <= 0.5 + 1e-9
    for corner in poses.reshape(-1, 3):
        assert np.linalg.norm(finer - corner, axis=2).min() < 1e-12


def samples_of_nodes(uncut, parted):
    """All samples, as (uncut cell, number), of the pieces that each node is a corner of."""
    pieces, samples = parted.pieces, defaultdict(set)
    row = {int(cell): number for number, cell in enumerate(pieces.cells)}
    rank = defaultdict(int)
    for cell, (origin, corners) in enumerate(zip(parted.cell_origin, parted.model.cell_corners, strict=True)):
        number = rank[origin]
        rank[origin] += 1
        whole = range(512) if int(origin) not in row else np.flatnonzero(pieces.samples[row[int(origin)]] == number)
        for node in corners:
            samples[int(node)].update((int(origin), int(sample)) for sample in whole)
        assert cell >= 0
    return samples


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_node_goes_over_to_where_most_of_its_tissue_hung(seed):
    rng = np.random.default_rng(seed)
    model = block(4, 3, 3)
    first, _ = Cuts(model, FULL).with_sheet(sheet_through(model, rng))
    second, step = first.with_sheet(sheet_through(model, rng))
    before, now = samples_of_nodes(model, first.parted), samples_of_nodes(model, second.parted)
    copies = defaultdict(list)
    for node, origin in enumerate(first.parted.node_origin):
        copies[int(origin)].append(node)
    for node, origin in enumerate(second.parted.node_origin):
        common = {old: len(before[old] & now[node]) for old in copies[int(origin)]}
        chosen = int(step.descent.node_before[node])
        assert chosen in common
        assert common[chosen] == max(common.values())
    assert (second.parted.node_origin[step.node_now] == first.parted.node_origin).all()
    state = State(random_field(first.model, seed % 97, 0.1), random_field(first.model, seed % 89, 0.1), 5)
    carried = step.carried(state)
    assert carried.step_count == 5
    mixed = np.unique(step.descent.mixed)
    plain = np.delete(np.arange(second.model.node_count), mixed)
    masses = [one.model.node_mass.astype(float)[:, None] for one in (first, second)]
    # The centre of mass and the momentum stay, node by node, and so those of all.
    for was, now in ((state.displacement, carried.displacement), (state.velocity, carried.velocity)):
        np.testing.assert_array_equal(now[plain], was[step.descent.node_before[plain]])
        old, new = masses[0] * was, masses[1] * now
        for origin in np.unique(second.parted.node_origin[mixed]):
            here, there = first.parted.node_origin == origin, second.parted.node_origin == origin
            np.testing.assert_allclose(new[there].sum(axis=0), old[here].sum(axis=0), atol=1e-6)
        np.testing.assert_allclose(new.sum(axis=0), old.sum(axis=0), atol=1e-5)


def test_a_suture_across_the_lips_is_taken_back_with_its_cut():
    simulation, _ = moving_bar("cpu")
    start = simulation.snapshot()
    simulation.cut(across_bar(simulation.model))
    index = simulation.model.node_index
    copy = len(start.model.node_index)
    original = np.flatnonzero((index[:copy] == index[copy]).all(axis=1))[0]
    simulation.add_springs([(copy, original)], 0.01)
    sewn = simulation.snapshot()
    simulation.step(5)
    simulation.remove_explicit_springs([True])
    simulation.restore(sewn)
    assert simulation.model.explicit.count == 1
    simulation.restore(start)
    simulation.restore(sewn)
    simulation.step(5)
    with pytest.raises(SimulationError, match="cut it by blades only"):
        simulation.remove_springs(np.zeros(simulation.model.spring_count, bool))


def test_a_surface_that_is_not_closed_refuses_a_cut_and_nothing_changes():
    from tests.simulator.surface_splitting.surfaces import block as full
    from tests.simulator.surface_splitting.surfaces import box, hung

    model = full((3, 3, 2))
    places, triangles = box((6, 6, 4), np.array((3.0, 3.0, 2.0)))
    simulation = Simulation(model, surface=hung(model, places, triangles[1:]), sleep_mm=0)
    before = simulation.state.displacement.tobytes()
    with pytest.raises(SimulationError, match="closed"):
        simulation.cut(blade_mm(model, [[[1.3, -1, 4], [1.3, -1, 0.5]], [[1.3, 5, 4], [1.3, 5, 0.5]]]))
    assert simulation.model is model
    assert simulation.cuts is None
    simulation.step(3)
    assert simulation.state.displacement.tobytes() == before


@pytest.mark.parametrize("reach", [0.0, 0.7, 2.0])
def test_places_at_rest_do_not_depend_on_which_cells_are_looked_at_first(reach):
    model = block(16, 4, 4)
    draw = np.random.default_rng(5)
    displacement = draw.normal(0, 0.15, (model.node_count, 3)).astype(np.float32)
    points = draw.uniform(-2.0, 7.0, (60, 3))
    none = np.zeros(0, np.int64)
    whole = (np.zeros(0, np.int32), none, none, none, np.zeros((0, 512), np.int32))
    tissue = Tissue(model.cells, model.cell_corners, displacement, CORNER_OFFSETS - 0.5, *whole)
    found, wanted = np.empty_like(points), np.empty_like(points)
    is_open, is_wanted = np.empty((2, len(points)), np.bool_)
    near, every = find_near(points, tissue, reach), find_near(points, tissue, np.inf)
    assert len(near.cells) < len(every.cells) == model.cell_count
    follow_back(points, tissue, near, near, found, is_open)
    follow_back(points, tissue, every, every, wanted, is_wanted)
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(is_open, is_wanted)
    assert is_open.any()


@pytest.mark.parametrize("aside", [0.0, 0.3, 1.0])
def test_a_blade_between_lips_that_are_held_apart_cuts_only_what_it_meets(aside):
    """The usual way to make an incision longer: through the gap, and on into whole tissue."""
    uncut, width = block(16, 10, 8), 6.0
    incision = Sheet.swept([[[8.3, -1.0, 9.0], [8.3, -1.0, 2.6]], [[8.3, 7.0, 9.0], [8.3, 7.0, 2.6]]])
    cuts, _ = Cuts(uncut, FULL).with_sheet(incision)
    model = cuts.model
    middle, count = np.zeros((2, model.node_count))
    np.add.at(middle, model.cell_corners, (model.cells + 0.5 + model.cell_moments[:, :3])[:, :1])
    np.add.at(count, model.cell_corners, 1)
    x, y, z = model.node_index.T.astype(float)
    opening = width / 2 * np.clip((z - 2.6) / 5.4, 0, 1) * np.clip((7 - y) / 7, 0, 1)
    displacement = np.zeros((model.node_count, 3), np.float32)
    displacement[:, 0] = np.sign(middle / count - 8.3) * opening * np.clip(1 - np.abs(x - 8.3) / 8, 0, 1)
    at = 8.3 + aside
    blade = refined(np.array([[[at, 1.0, 9.0], [at, 1.0, 3.0]], [[at, 9.0, 9.0], [at, 9.0, 3.0]]]))
    rest = blade_at_rest(model, displacement, blade, cuts.parted)
    further = Sheet.swept(rest)
    assert np.isnan(rest).any()

    # Each link that is crossed lies now where the blade went by: a plane.
    pieces = cells_of_samples(uncut, cuts.parted, np.arange(uncut.cell_count))
    for axis, keys in enumerate(further.links):
        keys = np.setdiff1d(keys, incision.links[axis])
        sample = key_indices(keys)
        inside = ((sample >= 0) & (sample + np.eye(3, dtype=int)[axis] < np.array([16, 10, 8]) * 8)).all(axis=1)
        sample = sample[inside]
        cell = pieces[np.searchsorted(lattice_keys(uncut.cells), lattice_keys(sample // 8)), sample % 8 @ [1, 8, 64]]
        local = (sample % 8 + 0.5 + np.eye(3)[axis] / 2) / 8
        weight = np.where(CORNER_OFFSETS == 1, local[:, None], 1 - local[:, None]).prod(axis=2)
        now = model.cells[cell, 0] + local[:, 0]
        now = now + np.einsum("nc,nc->n", weight, displacement[model.cell_corners[cell], 0].astype(float))
        # Into the other lip it comes by one sample at most, so that nothing is left between it and the incision.
        is_at_lip = np.abs((sample[:, 0] + 0.5 + (axis == 0) / 2) / 8 - 8.3) < 0.2
        assert np.abs(now - at)[~is_at_lip].max(initial=0.0) < 0.3
    # And the whole tissue before it is parted, to where the blade came.
    longer, _ = cuts.with_sheet(further)
    for j in (5, 6, 7, 8):
        there = (longer.model.node_index == (int(at), j, 7)).all(axis=1)
        assert there.sum() >= 2


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32))
def test_a_blade_lies_at_rest_where_plain_numpy_says(seed):
    draw = np.random.default_rng(seed)
    model = block(8, 6, 5)
    cuts, parted = Cuts(model, FULL), None
    for _ in range(seed % 3):
        cuts, _ = cuts.with_sheet(sheet_through(model, draw))
        parted = cuts.parted
    displacement = random_field(cuts.model, seed % 83, 0.3)
    if seed % 4 == 0:
        displacement += cuts.model.node_index.astype(np.float32) * np.float32(0.2)
    middle = model.node_index.mean(axis=0) + draw.uniform(-4, 4, 3)
    along, across = draw.normal(size=(2, 3)) * 3
    blade = refined(np.array([[middle - along, middle + along], [middle - along + across, middle + along + across]]))
    found = blade_at_rest(cuts.model, displacement, blade, parted)
    wanted = plain_blade_at_rest(cuts.model, displacement, blade, parted)
    assert found.tobytes() == wanted.tobytes()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 6), st.integers(2, 9), st.sampled_from([0.1, 1.0, 7.0]))
def test_a_blade_is_refined_as_plain_numpy_refines_it(seed, poses, count, size):
    blade = np.random.default_rng(seed).uniform(-size, size, (poses, count, 3))
    if seed % 3 == 0:
        blade = np.round(4 * blade) / 4
    assert refined(blade).tobytes() == np.ascontiguousarray(plain_refined(blade)).tobytes()
