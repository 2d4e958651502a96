import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.subtrees import NO_PIECE, forest_pieces
from heartcase.pipeline.watershed.tree import build_basin_tree
from tests.pipeline.watershed.test_forest import landscape, level_counts, painted, shapes

NEW = 9
"""A label that no random marker has."""


def with_marker(forest, voxels):
    markers = forest.painted.copy()
    markers.flat[voxels] = NEW
    return solve_forest(forest.tree, markers)


@settings(max_examples=120, deadline=None)
@given(
    shape=shapes,
    levels=level_counts,
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 12),
    labels=st.integers(1, 4),
)
def test_a_marker_at_a_lowest_voxel_changes_what_its_piece_says(shape, levels, seed, count, labels):
    markers = painted(shape, count, labels, seed)
    forest = solve_forest(build_basin_tree(landscape(shape, levels, seed)), markers)
    # a flat minimum that is marked with two labels is divided, which no piece foretells
    assume((forest.marks == forest.painted).all())
    pieces = forest_pieces(forest)
    flat = forest.tree.flat
    is_free = (markers.flat[forest.tree.root] == UNMARKED) & ((flat < 0) | (forest.flat_label[flat] == -1))
    assume(is_free.any())
    # the highest and the lowest pieces, and some between
    basins = np.flatnonzero(is_free)[np.argsort(pieces.piece[is_free])]
    for basin in basins[np.unique(np.linspace(0, len(basins) - 1, 6).astype(int))].tolist():
        root = forest.tree.root[basin]
        piece = int(pieces.piece[basin])
        changed = with_marker(forest, root).labels != forest.labels
        assert changed.sum() == pieces.flipped_count[piece]
        # and they are the feet of the pieces that hang on it
        taken = pieces.hanging_on(piece)
        assert pieces.own_count[taken].sum() == changed.sum()
        assert set(np.unique(pieces.piece[forest.tree.basin[changed]])) >= set(np.flatnonzero(taken))


@settings(max_examples=60, deadline=None)
@given(shape=shapes, seed=st.integers(0, 2**32 - 1), count=st.integers(1, 8), more=st.integers(1, 6))
def test_a_wider_stroke_inside_what_a_marker_takes_takes_the_same(shape, seed, count, more):
    forest = solve_forest(build_basin_tree(landscape(shape, None, seed)), painted(shape, count, 3, seed))
    free = np.flatnonzero(forest.painted.flat[forest.tree.root] == UNMARKED)
    assume(len(free))
    root = forest.tree.root[free[seed % len(free)]]
    taken = with_marker(forest, root).labels == NEW
    wider = np.random.default_rng(seed).choice(np.flatnonzero(taken), more)
    np.testing.assert_array_equal(with_marker(forest, np.append(wider, root)).labels == NEW, taken)


@settings(max_examples=60, deadline=None)
@given(shape=shapes, levels=level_counts, seed=st.integers(0, 2**32 - 1), count=st.integers(0, 12))
def test_a_parent_comes_first_and_all_of_a_family_has_one_label(shape, levels, seed, count):
    forest = solve_forest(build_basin_tree(landscape(shape, levels, seed)), painted(shape, count, 3, seed))
    pieces = forest_pieces(forest)
    assert (np.diff(pieces.level) > 0).all()
    assert (pieces.parent < np.arange(len(pieces.parent))).all()
    label = forest.foot_label[pieces.first_foot]
    # piece 0 of the marked lowest voxels hangs on no face: it may hold several labels
    own = pieces.level[pieces.piece] != 0
    np.testing.assert_array_equal(forest.foot_label[own], label[pieces.piece][own])
    hung = pieces.parent != NO_PIECE
    hung[hung] = pieces.level[pieces.parent[hung]] != 0
    np.testing.assert_array_equal(label[hung], label[pieces.parent[hung]])


@pytest.mark.parametrize(("place", "taken"), [(2, 6), (4, 4), (7, 1)])
def test_a_chain_of_valleys_hangs_valley_on_valley(place, taken):
    # ways climb to 5, 6 and 7 from the mark on the left, so each valley hangs on the one to its left
    height = np.array([0, 5, 1, 6, 1.5, 2, 7, 3], np.float32).reshape(1, 1, -1)
    markers = np.full(height.shape, UNMARKED, np.uint8)
    markers[0, 0, 0] = 1
    forest = solve_forest(build_basin_tree(height), markers)
    pieces = forest_pieces(forest)
    basin = int(forest.tree.basin[0, 0, place])
    assert pieces.flipped_count[pieces.piece[basin]] == taken
    assert (with_marker(forest, place).labels == NEW).sum() == taken
