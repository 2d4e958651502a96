"""What a cut leaves of a lattice."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.bundle.lattice import lattice_keys
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.blade_sheet import Sheet, crossed_links
from heartcase.simulator.cutting.crossings import SAMPLES
from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.cutting.piece_frequency import QUICKER
from heartcase.simulator.cutting.pieces import find_pieces
from heartcase.simulator.cutting.tissue_samples import TissueSamples, samples_of
from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.forces.reference import elastic_energy, elastic_forces
from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from tests.simulator.surface_splitting.surfaces import box

LAWS = [ForceLaw(), ForceLaw(poissons_ratio=0.45), ForceLaw("element"), ForceLaw("element", shares_strain=False)]
FULL = TissueSamples.everywhere()


def block(shape, law=None, kept=1.0, seed=0) -> LatticeModel:
    """Cells of a box, some of them, of any coverage."""
    cells = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1).reshape(-1, 3)
    cells = cells[np.lexsort(cells.T)]
    draw = np.random.default_rng(seed)
    chosen = draw.random(len(cells)) < kept
    chosen[0] = True
    return make_model(cells[chosen], coverage=draw.uniform(0.02, 1.0, chosen.sum()), law=law)


points = st.tuples(*[st.floats(-0.5, 4.5)] * 3)
blades = st.lists(
    st.tuples(st.integers(2, 4), st.integers(2, 3)).flatmap(
        lambda shape: st.lists(
            st.lists(points, min_size=shape[1], max_size=shape[1]), min_size=shape[0], max_size=shape[0]
        )
    ),
    min_size=1,
    max_size=3,
)


def parts_of_samples(model: LatticeModel, triangles) -> dict[tuple, set]:
    """Which samples around each node hang together: by a search from sample to sample, over all samples."""
    is_crossed = [set(crossed_links(triangles, axis).tolist()) for axis in range(3)]
    cells = {tuple(cell) for cell in model.cells.tolist()}

    def neighbours(at, allowed):
        for axis in range(3):
            for step in (-1, 1):
                there = list(at)
                there[axis] += step
                lower = min(at, tuple(there), key=lambda s: s[axis])
                if tuple(n // SAMPLES for n in there) not in allowed:
                    continue
                if int(lattice_keys(lower)) not in is_crossed[axis]:
                    yield tuple(there)

    found = {}
    for node in map(tuple, model.node_index.tolist()):
        around = {tuple(np.subtract(node, o)) for o in np.ndindex(2, 2, 2)} & cells
        left = {tuple(s) for cell in around for s in samples_of([cell])[0].tolist()}
        sets = set()
        while left:
            queue, together = deque([left.pop()]), set()
            while queue:
                at = queue.popleft()
                together.add(at)
                for there in neighbours(at, around):
                    if there in left:
                        left.remove(there)
                        queue.append(there)
            sets.add(frozenset(together))
        found[node] = sets
    return found


@settings(max_examples=12, deadline=None)
@given(blades, st.integers(0, 5))
def test_nodes_are_copied_as_the_samples_around_them_hang_together(blade, seed):
    """Against a search over all samples around each node, in full cells of which each touches others by its faces."""
    model = block((2, 2, 2) if seed % 2 else (3, 2, 1), seed=seed)
    sheets = [Sheet(Sheet.swept(poses).triangles) for poses in blade]
    parted = part(model, sheets, FULL)
    triangles = np.concatenate([sheet.triangles for sheet in sheets])
    wanted = parts_of_samples(model, triangles)
    nodes = [tuple(node) for node in parted.model.node_index.tolist()]
    assert {node: nodes.count(node) for node in set(nodes)} == {node: len(sets) for node, sets in wanted.items()}

    links = tuple(crossed_links(triangles, axis) for axis in range(3))
    pieces = find_pieces(model, FULL, links)
    for row, cell in enumerate(pieces.cells):
        for corner in range(8):
            node = tuple(model.node_index[model.cell_corners[cell, corner]].tolist())
            copy = pieces.copies[pieces.first[row] + pieces.samples[row], corner]
            by_set = [
                {
                    copy[n]
                    for n, s in enumerate(map(tuple, samples_of([model.cells[cell]])[0].tolist()))
                    if s in together
                }
                for together in wanted[node]
            ]
            found = [copies for copies in by_set if copies]
            assert all(len(copies) == 1 for copies in found)
            assert len(set.union(*found)) == len(found)


@settings(max_examples=60, deadline=None)
@given(blades, st.sampled_from(LAWS), st.integers(0, 100))
def test_a_cut_moves_nothing_and_loses_nothing(blade, law, seed):
    model = block((4, 3, 3), law=law, kept=0.7, seed=seed)
    parted = part(model, [Sheet.swept(poses) for poses in blade], FULL)
    cut = parted.model
    assert cut.node_mass.sum(dtype=float) == pytest.approx(model.node_mass.sum(dtype=float), rel=1e-6)
    shared_out = np.bincount(parted.cell_origin, cut.cell_coverage, minlength=model.cell_count)
    np.testing.assert_allclose(shared_out, model.cell_coverage, rtol=1e-6)
    of_node = np.bincount(parted.node_origin, cut.node_mass, minlength=model.node_count)
    np.testing.assert_allclose(of_node, model.node_mass, rtol=1e-5)
    assert (cut.node_mass > 0).all()

    draw = np.random.default_rng(seed)
    state = State(*(draw.normal(0, 0.1, (2, model.node_count, 3)).astype(np.float32)), step_count=7)
    carried = parted.carried(state)
    np.testing.assert_array_equal(
        cut.node_index + carried.displacement, (model.node_index + state.displacement)[parted.node_origin]
    )
    momentum = (model.node_mass[:, None].astype(float) * state.velocity).sum(axis=0)
    np.testing.assert_allclose(
        (cut.node_mass[:, None].astype(float) * carried.velocity).sum(axis=0), momentum, atol=1e-5
    )


@settings(max_examples=40, deadline=None)
@given(blades, st.integers(0, 100))
def test_energy_of_springs_does_not_rise_by_a_cut(blade, seed):
    """What a spring stores is shared out among its copies. (Elements work out the mean strain of each piece: nearer to
    the integral, but not always below what the mean strain of the cell stored.)"""
    model = block((4, 3, 3), kept=0.8, seed=seed)
    parted = part(model, [Sheet.swept(poses) for poses in blade], FULL)
    u = np.random.default_rng(seed).normal(0, 0.05, (model.node_count, 3))
    before = elastic_energy(model, u)
    assert elastic_energy(parted.model, u[parted.node_origin]) == pytest.approx(before, rel=1e-5)


@settings(max_examples=40, deadline=None)
@given(blades, st.sampled_from(LAWS), st.integers(0, 100))
def test_uniform_strain_stores_the_same_in_a_cut_lattice(blade, law, seed):
    """At a stretch at which springs pull, shears and turns: F is the same in each piece.

    Copies of a node together are pulled as it was; in elements, where the pieces' moments add up to their cell's."""
    model = block((4, 3, 3), law=law, kept=0.8, seed=seed)
    parted = part(model, [Sheet.swept(poses) for poses in blade], FULL)
    G = np.random.default_rng(seed).normal(0, 0.15, (3, 3))
    u = model.node_index @ G.T
    before = elastic_energy(model, u)
    assert elastic_energy(parted.model, u[parted.node_origin]) == pytest.approx(before, rel=1e-5)
    if law.is_element:
        return
    forces = elastic_forces(parted.model, u[parted.node_origin])
    together = np.stack([np.bincount(parted.node_origin, column) for column in forces.T], axis=1)
    np.testing.assert_allclose(together, elastic_forces(model, u), atol=2e-5)


@settings(max_examples=15, deadline=None)
@given(blades, st.sampled_from(LAWS), st.integers(0, 100))
def test_a_cut_needs_no_shorter_step(blade, law, seed):
    """Slivers of springs are no quicker: omega^2 of the cut lattice stays below that of a lone cell; those of elements
    by half of it at most, where the default step leaves room for two and a half times as much."""
    model = block((3, 3, 2), law=law, seed=seed)
    cut = part(model, [Sheet.swept(poses) for poses in blade], FULL).model
    bound = QUICKER * law.rest_bound if law.is_element else law.rest_bound
    assert bound < law.stretched_bound or not law.is_element
    assert largest_eigenvalue(cut).lower <= bound * (1 + 1e-6)


@settings(max_examples=30, deadline=None)
@given(blades, st.integers(0, 100), st.randoms(use_true_random=False))
def test_the_order_of_sheets_does_not_matter_and_undoing_gives_the_same_bytes(blade, seed, order):
    model = block((4, 3, 3), kept=0.7, seed=seed)
    sheets = [Sheet.swept(poses) for poses in blade]
    shuffled = list(sheets)
    order.shuffle(shuffled)
    one, other = part(model, sheets, FULL).model, part(model, shuffled, FULL).model
    none = part(model, [], FULL).model
    for name in vars(model):
        values = getattr(model, name)
        if isinstance(values, np.ndarray):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
            assert getattr(none, name).dtype == values.dtype
            np.testing.assert_array_equal(getattr(none, name), values, err_msg=name)


@pytest.mark.parametrize("place", [6.0, 6.3, 5.95, 6 + 1 / 16])
def test_a_plane_through_a_bar_leaves_two_bars(place):
    """Also along the faces between cells and through the samples themselves."""
    model = block((12, 3, 3))
    parted = part(model, [Sheet.swept([[(place, -1, -1), (place, 4, -1)], [(place, -1, 4), (place, 4, 4)]])], FULL)
    cut = parted.model
    side = np.full(cut.node_count, -1)
    queue = deque([0])
    side[0] = 0
    by_node = [[] for _ in range(cut.node_count)]
    for corners in cut.cell_corners.tolist():
        for corner in corners:
            by_node[corner] += corners
    while queue:
        for there in by_node[queue.popleft()]:
            if side[there] < 0:
                side[there] = 0
                queue.append(there)
    left, right = cut.node_index[side == 0, 0], cut.node_index[side < 0, 0]
    assert left.max() <= np.ceil(place)
    assert right.min() >= np.floor(place)
    share = np.where(side[cut.cell_corners[:, 0]] == 0, cut.cell_coverage, 0.0)
    beyond = model.cell_coverage[model.cells[:, 0] < int(place)].sum()
    within = model.cell_coverage[model.cells[:, 0] == int(place)].sum()
    whole_samples = np.ceil((place % 1) * SAMPLES - 0.5) / SAMPLES
    assert share.sum() == pytest.approx(beyond + within * whole_samples, rel=1e-5)


def test_a_sheet_that_ends_inside_opens_up_to_its_end():
    model = block((6, 2, 4))
    half = Sheet.swept([[(3.3, -1, 2.0), (3.3, 3, 2.0)], [(3.3, -1, 5.0), (3.3, 3, 5.0)]])
    parted = part(model, [half], FULL)
    copied = parted.model.node_index[model.node_count :]
    assert sorted(set(copied[:, 2].tolist())) == [3, 4]
    assert sorted(set(copied[:, 0].tolist())) == [3, 4]
    assert len(copied) == 2 * 2 * 3
    assert parted.model.cell_count == model.cell_count + 4


@pytest.mark.parametrize(("place", "pieces"), [(3.3, 3), (3.0, 2)])
def test_tissue_beside_the_end_of_a_sheet_joins_both_sides(place, pieces):
    """A sheet that ends at a quarter of a cell, in it or on its face: the other three quarters are the stem."""
    model = make_model(np.stack(np.meshgrid([2, 3], [0], [0, 1, 2], indexing="ij"), -1).reshape(-1, 3))
    cut = part(model, [Sheet.swept([[(place, -1, 1.75), (place, 2, 1.75)], [(place, -1, 4), (place, 2, 4)]])], FULL)
    middle = np.flatnonzero((cut.model.cells[:, 2] == 1) & (cut.model.cells[:, 0] == 3))
    assert len(middle) == pieces
    assert cut.model.cell_coverage[middle].sum() == pytest.approx(1.0, rel=1e-6)
    stem = middle[np.argmax(cut.model.cell_coverage[middle])]
    assert cut.model.cell_coverage[stem] == pytest.approx(0.75, abs=0.13)
    assert cut.model.cell_moments[stem, 2] < 0
    others = np.setdiff1d(middle, stem)
    above = {
        tuple(cut.model.cell_corners[cell, 4:].tolist())
        for cell in (*others, *np.flatnonzero((cut.model.cells == (2, 0, 1)).all(axis=1)))
    }
    joined = set(cut.model.cell_corners[stem, 4:].tolist())
    assert all(joined & set(corners) for corners in above)
    assert len({tuple(corners) for corners in above}) == len(above)


def test_a_sheet_that_ends_alone_in_a_cell_parts_nothing_before_it_has_a_side():
    """A cut deepens without a jump: coverage of what it joins goes down with it."""
    model = block((4, 2, 4))
    stems = []
    for depth in np.linspace(2.97, 2.03, 9):
        cut = part(model, [Sheet.swept([[(1.4, -1, depth), (1.4, 3, depth)], [(1.4, -1, 5), (1.4, 3, 5)]])], FULL).model
        middle = np.flatnonzero((cut.cells == (1, 0, 2)).all(axis=1))
        whole = model.cell_coverage[(model.cells == (1, 0, 2)).all(axis=1)][0]
        left = cut.cell_coverage[middle][-1] / whole if len(middle) == 3 else 1.0 if len(middle) == 1 else 0.0
        stems.append(left)
    assert stems == sorted(stems, reverse=True)
    assert np.ptp(stems) > 0.7
    assert np.abs(np.diff(stems)).max() < 0.3


def test_moments_of_pieces_are_those_of_the_parts_of_a_box():
    """A full cell cut at three quarters: each part's mean and mean square along x, by hand."""
    model = make_model([[0, 0, 0]])
    sheet = Sheet.swept([[(0.75, -1, -1), (0.75, 2, -1)], [(0.75, -1, 2), (0.75, 2, 2)]])
    cut = part(model, [sheet], FULL).model
    np.testing.assert_allclose(cut.cell_coverage, [0.75, 0.25], atol=1e-6)
    np.testing.assert_allclose(cut.cell_moments[:, 0], [-0.125, 0.375], atol=1e-6)
    squares = [(0.25**3 + 0.5**3) / 3 / 0.75, (0.5**3 - 0.25**3) / 3 / 0.25]
    np.testing.assert_allclose(cut.cell_moments[:, 3], squares, atol=1e-6)
    np.testing.assert_allclose(cut.cell_moments[:, 4:6], 1 / 12, atol=1e-6)


def test_tissue_that_never_touched_is_parted_by_a_sheet_between_alone():
    """Two walls that one cell holds: a sheet beside them leaves them together, one between them does not."""
    model = make_model([[0, 0, 0]], coverage=0.5)
    boxes = [np.array([(x, y, z) for x in side for y in (-1, 2) for z in (-1, 2)]) for side in ((0, 0.25), (0.75, 1))]
    faces = np.array([(0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5)])
    faces = np.concatenate([faces, [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]])
    walls = TissueSamples.inside(np.concatenate(boxes), np.concatenate([faces, faces + 8]))
    assert walls.of_cells(model.cells, model.cell_moments).mean() == 0.5

    def cut(x, top=2.0):
        return part(model, [Sheet.swept([[(x, -1, -1), (x, 2, -1)], [(x, -1, top), (x, 2, top)]])], walls).model

    assert cut(0.5).cell_count == 2
    half = cut(0.5, top=0.5)
    np.testing.assert_allclose(sorted(half.cell_coverage), [0.125, 0.125, 0.25])
    assert cut(0.5, top=-0.5).cell_count == 1
    assert cut(0.9).cell_count == 2
    np.testing.assert_allclose(sorted(cut(0.5).cell_coverage), [0.25, 0.25])


def test_a_sheet_is_continued_in_its_own_cells_alone():
    """Two cuts: the continuation of the first reaches a cell that only the second comes to."""
    model = block((5, 2, 4))
    first = Sheet.swept([[(2.4, -1, 5), (2.4, 3, 5)], [(2.4, -1, 3.2), (2.4, 3, 3.2)]])
    second = Sheet.swept([[(-1, -1, 1.6), (-1, 3, 1.6)], [(6, -1, 1.6), (6, 3, 1.6)]])
    cut = part(model, [first, second], FULL).model
    of_place = (cut.cells == (2, 0, 1)).all(axis=1)
    assert of_place.sum() == 2
    np.testing.assert_array_equal(np.unique(cut.node_index[cut.cell_corners[of_place]][:, :, 0]), [2, 3])
    assert ((cut.cells == (2, 0, 3)).all(axis=1)).sum() == 3


def test_a_lattice_whose_springs_were_removed_is_refused():
    model = block((3, 2, 2))
    removed = np.zeros(model.spring_count, bool)
    removed[0] = True
    with pytest.raises(SimulationError, match="springs of this lattice were removed"):
        part(model.without_springs(removed), [], FULL)


@pytest.mark.parametrize("depth", [0.3, 0.7, 1.4])
def test_lips_of_a_thin_wall_part_above_other_tissue(depth):
    """A blade through a wall of a third of a cell, with a gap below it, and then tissue that shares nodes with it."""
    boxes = [box((1, 1, 1), np.array((4.0, 2.0, 0.9))), box((1, 1, 1), np.array((4.0, 2.0, 0.3)))]
    places = np.concatenate([boxes[0][0] + 1e-3, boxes[1][0] + (1e-3, 1e-3, 1.65)])
    tissue = TissueSamples.inside(places, np.concatenate([boxes[0][1], boxes[1][1] + len(boxes[0][0])]))
    model = block((4, 2, 2))
    ends = [(2.3, y, z) for y, z in ((-1, 3), (-1, 1.65 - depth), (3, 3), (3, 1.65 - depth))]
    parted = part(model, [Sheet.swept([ends[:2], ends[2:]])], tissue)
    cut = parted.model
    is_wall = cut.cells[:, 2] == 1
    middle = (cut.cells + 0.5 + cut.cell_moments[:, :3])[:, 0]
    left, right = (np.unique(cut.cell_corners[is_wall & (side * (middle - 2.3) > 0)]) for side in (-1, 1))
    assert len(left)
    assert len(right)
    assert not np.intersect1d(left, right).size
