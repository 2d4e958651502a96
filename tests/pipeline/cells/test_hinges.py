import numpy as np
import pytest

from heartcase.pipeline.cells.hinges import HingeRepairs, hanging_cells, mend_hinges
from heartcase.pipeline.cells.passages import closes_passage
from heartcase.pipeline.cells.repair import CellState, cell_coverage
from heartcase.pipeline.cells.sampling import CellSamples, void_pieces
from heartcase.pipeline.kernels.topology import components
from heartcase.schemas.bundle.lattice import CELL_DIAGONALS, CELL_EDGES, cell_nodes
from heartcase.schemas.geometry import Geometry


def scene(tissue, *, coverage=None, blood=None):
    """Cells of two samples an edge, all tissue or all void, with the coverage that is asked for."""
    geometry = Geometry.of(shape=tissue.shape, origin_mm=np.zeros(3), spacing_mm=(2.0, 2.0, 2.0), direction=np.eye(3))
    fine = tissue.repeat(2, 0).repeat(2, 1).repeat(2, 2)
    samples = CellSamples(
        geometry=geometry,
        factor=2,
        tissue_mm=np.where(fine, -1.0, 1.0).astype(np.float32),
        void_label=np.ones(fine.shape, np.uint8),
        inside=tuple(np.ones(n) for n in fine.shape),
        coverage=(tissue if coverage is None else coverage).astype(np.float32),
        cell_label=tissue.astype(np.uint8),
    )
    pieces = void_pieces(samples)
    is_blood = np.zeros(tissue.shape, bool) if blood is None else blood
    return samples, pieces, CellState(tissue.copy(), pieces.main.copy(), is_blood.copy()), components(fine, 26)[0]


def blocks(*corners, shape=(6, 6, 6), size=2):
    tissue = np.zeros(shape, bool)
    for k, j, i in corners:
        tissue[k : k + size, j : j + size, i : i + size] = True
    return tissue


def zero_modes(tissue):
    """Modes without stiffness of the cells' springs, by the eigenvalues of the dense matrix."""
    nodes, corners = cell_nodes(np.argwhere(tissue)[:, ::-1])
    stiffness = np.zeros((len(nodes), 3, len(nodes), 3))
    for a, b in np.concatenate((CELL_EDGES, CELL_DIAGONALS)):
        for p, q in corners[:, (a, b)]:
            along = (nodes[q] - nodes[p]) / np.linalg.norm(nodes[q] - nodes[p])
            block = np.outer(along, along)
            stiffness[p, :, p] += block
            stiffness[q, :, q] += block
            stiffness[p, :, q] -= block
            stiffness[q, :, p] -= block
    values = np.linalg.eigvalsh(stiffness.reshape(3 * len(nodes), -1))
    return int((values < 1e-9 * values[-1]).sum())


def swinging(tissue):
    nodes, corners = cell_nodes(np.argwhere(tissue)[:, ::-1])
    return hanging_cells(tissue, corners, nodes, np.zeros(len(nodes), np.uint8))


@pytest.mark.parametrize(
    ("second", "modes", "cells"),
    # Two free bodies have 12 modes; a common edge ties 5 of them, a common corner 3.
    [((2, 2, 0), 7, 1), ((1, 2, 2), 7, 1), ((2, 2, 2), 9, 2)],
)
def test_blocks_that_touch_by_an_edge_or_a_corner_become_stiff(second, modes, cells):
    tissue = blocks((0, 0, 0), second)
    assert zero_modes(tissue) == modes
    samples, pieces, state, fine = scene(tissue)
    assert mend_hinges(samples, pieces, state, fine) == HingeRepairs(0, 0, 1, cells)
    assert swinging(tissue) == [second]
    assert swinging(state.tissue) == []
    assert zero_modes(state.tissue) == 6
    assert (state.tissue & ~tissue).sum() == cells
    assert (state.tissue >= tissue).all()


def test_the_cell_with_most_tissue_joins_and_then_the_first():
    tissue = blocks((0, 0, 0), (2, 2, 0))
    for best, expected in ((None, (1, 2, 0)), ((2, 1, 1), (2, 1, 1))):
        coverage = tissue.astype(np.float32)
        if best:
            coverage[best] = 0.01
        samples, pieces, state, fine = scene(tissue, coverage=coverage)
        mend_hinges(samples, pieces, state, fine)
        assert state.added == [expected]


def test_a_sliver_is_dropped_and_its_tissue_goes_to_its_neighbours():
    tissue = blocks((0, 0, 0), size=5, shape=(8, 8, 8))
    tissue[5, 5, 1:3] = True
    coverage = np.where(tissue, 0.9, 0.0).astype(np.float32)
    coverage[5, 5, 1:3] = 0.03
    samples, pieces, state, fine = scene(tissue, coverage=coverage)
    assert mend_hinges(samples, pieces, state, fine) == HingeRepairs(1, 2, 0, 0)
    np.testing.assert_array_equal(state.tissue, blocks((0, 0, 0), size=5, shape=(8, 8, 8)))
    after = cell_coverage(samples, state, 0.02)
    assert after.sum(dtype=float) == pytest.approx(coverage.sum(dtype=float), rel=1e-6)
    assert not after[~state.tissue].any()
    # The same sliver is not negligible beside less tissue.
    few = blocks((3, 3, 0), shape=(8, 8, 8)) | (tissue & (np.arange(8) > 4)[:, None, None])
    samples, pieces, state, fine = scene(few, coverage=np.where(few, coverage, 0.0))
    assert mend_hinges(samples, pieces, state, fine).joined_groups == 1
    assert zero_modes(state.tissue) == 6


def test_a_sliver_that_ties_two_blocks_together_stays():
    tissue = blocks((0, 0, 0), (3, 3, 3), size=2, shape=(8, 8, 8))
    tissue[2, 2, 2] = True
    coverage = np.where(tissue, 1.0, 0.0).astype(np.float32)
    coverage[2, 2, 2] = 0.005
    samples, pieces, state, fine = scene(tissue, coverage=coverage)
    repairs = mend_hinges(samples, pieces, state, fine)
    assert repairs.dropped_groups == 0
    assert repairs.joined_groups == 2
    assert zero_modes(state.tissue) == 6


def test_what_is_apart_or_touches_by_chance_stays_as_it_is():
    for second in ((3, 3, 0), (2, 2, 0)):
        tissue = blocks((0, 0, 0), second)
        samples, pieces, state, fine = scene(tissue)
        # Two pieces of tissue at the samples.
        fine = components(fine > 0, 6)[0]
        assert mend_hinges(samples, pieces, state, fine) == HingeRepairs()
        np.testing.assert_array_equal(state.tissue, tissue)


def canals(*columns):
    """Two posts that touch along an edge; the columns beside it are blood from below to above."""
    tissue = np.zeros((7, 4, 4), bool)
    tissue[1:6, 1, 1] = tissue[1:6, 2, 2] = True
    blood = np.zeros_like(tissue)
    j, i = np.indices((4, 4))
    for column in columns:
        side = (i > j) if column[1] > column[0] else (i < j)
        blood[0], blood[6] = blood[0] | side, blood[6] | side
        blood[1:6, column[0], column[1]] = True
    return tissue, blood


def test_a_canal_beside_the_edge_is_not_filled():
    tissue, blood = canals((1, 2))
    samples, pieces, state, fine = scene(tissue, blood=blood)
    assert closes_passage(state, [(3, 1, 2)])
    assert not closes_passage(state, [(3, 2, 1)])
    # The canal's cells would be the first to be taken, but for the blood.
    assert mend_hinges(samples, pieces, state, fine).joined_groups == 1
    assert state.added == [(1, 2, 1)]
    assert components(state.is_blood & ~state.tissue, 6)[1] == 1


def test_where_only_canals_could_be_filled_the_hinge_is_left_and_found():
    tissue, blood = canals((1, 2), (2, 1))
    samples, pieces, state, fine = scene(tissue, blood=blood)
    assert mend_hinges(samples, pieces, state, fine) == HingeRepairs()
    np.testing.assert_array_equal(state.tissue, tissue)
    assert swinging(state.tissue) == [(1, 2, 2)]
    nodes, corners = cell_nodes(np.argwhere(tissue)[:, ::-1])
    # A node held off the hinge's line holds the post; one on the line does not.
    for node, expected in (((3, 3, 3), []), ((2, 2, 3), [(1, 2, 2)])):
        fixed = (nodes == node).all(axis=1).astype(np.uint8)
        assert fixed.sum() == 1
        assert hanging_cells(tissue, corners, nodes, fixed) == expected


def test_a_cell_that_was_opened_stays_open():
    tissue = blocks((0, 0, 0), (2, 2, 0))
    samples, pieces, state, fine = scene(tissue)
    state.removed = [(1, 2, 0), (1, 2, 1), (2, 1, 0)]
    mend_hinges(samples, pieces, state, fine)
    assert state.added == [(2, 1, 1)]


@pytest.mark.parametrize("seed", range(12))
def test_random_tissue_has_six_modes_a_piece_after_the_repair(seed):
    tissue = np.zeros((6, 6, 6), bool)
    tissue[1:-1, 1:-1, 1:-1] = np.random.default_rng(seed).random((4, 4, 4)) < 0.25
    samples, pieces, state, fine = scene(tissue)
    before = components(tissue, 26)[1]
    mend_hinges(samples, pieces, state, fine)
    assert components(state.tissue, 26)[1] == before
    for candidate in (tissue, state.tissue):
        if not swinging(candidate):
            assert zero_modes(candidate) == 6 * before
    again = scene(tissue)
    mend_hinges(*again)
    assert again[2].added == state.added


def test_random_tissue_in_one_piece_ends_with_six_modes():
    repaired = 0
    for seed in range(12):
        tissue = np.random.default_rng(100 + seed).random((4, 4, 4)) < 0.3
        tissue &= components(tissue, 26)[0] == 1
        samples, pieces, state, fine = scene(tissue)
        repaired += zero_modes(tissue) > 6
        mend_hinges(samples, pieces, state, fine)
        assert components(state.tissue, 6)[1] == 1
        assert zero_modes(state.tissue) == 6
    assert repaired > 0
