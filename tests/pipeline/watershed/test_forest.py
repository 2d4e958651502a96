from unittest.mock import patch

import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage, sparse
from scipy.sparse.csgraph import minimum_spanning_tree
from skimage.segmentation import watershed

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed import forest as forest_module
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
from tests.pipeline.watershed import textbook

shapes = st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 7))
level_counts = st.sampled_from([1, 2, 3, 6, 40, None])


def landscape(shape, levels, seed):
    random = np.random.default_rng(seed)
    size = int(np.prod(shape))
    if levels is None:
        return random.permutation(size).astype(np.float32).reshape(shape) / np.float32(3.0)
    return random.integers(0, levels, shape).astype(np.float32)


def costs(shape, seed):
    """Costs of voxels and axes, often the same sum by several ways; for a third of the seeds none."""
    random = np.random.default_rng(seed)
    if not seed % 3:
        return None, (1, 1, 1)
    return random.integers(1, 1 + random.integers(1, 9), shape).astype(np.uint16), tuple(
        random.integers(1, 4, 3).tolist()
    )


def painted(shape, count, labels, seed):
    random = np.random.default_rng(seed)
    markers = np.full(shape, UNMARKED, np.uint8)
    size = markers.size
    markers.flat[random.choice(size, min(count, size), replace=False)] = random.integers(0, labels, min(count, size))
    return markers


@settings(max_examples=300, deadline=None)
@given(
    shape=shapes,
    levels=level_counts,
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 40),
    labels=st.integers(1, 4),
)
def test_equals_the_textbook_flood_voxel_for_voxel(shape, levels, seed, count, labels):
    height, markers = landscape(shape, levels, seed), painted(shape, count, labels, seed)
    got = solve_forest(build_basin_tree(height, *costs(shape, seed)), markers).labels
    np.testing.assert_array_equal(got, textbook.flood(height, markers, *costs(shape, seed)))


@settings(max_examples=60, deadline=None)
@given(shape=shapes, levels=level_counts, seed=st.integers(0, 2**32 - 1), count=st.integers(1, 20))
def test_the_two_textbook_forms_agree(shape, levels, seed, count):
    height, markers = landscape(shape, levels, seed), painted(shape, count, 3, seed)
    both = (flood(height, markers, *costs(shape, seed)) for flood in (textbook.joined, textbook.flood))
    np.testing.assert_array_equal(*both)


@settings(max_examples=300, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 7), st.integers(1, 8), st.integers(1, 9)),
    levels=level_counts,
    seed=st.integers(0, 2**32 - 1),
    steps=st.integers(1, 15),
    most_mended=st.sampled_from([0.0, 0.1, 1.0]),
)
def test_any_sequence_of_strokes_ends_where_a_fresh_solve_does(shape, levels, seed, steps, most_mended):
    with patch.object(forest_module, "MOST_MENDED", most_mended):
        paint_and_erase(shape, levels, seed, steps)


def paint_and_erase(shape, levels, seed, steps):
    random = np.random.default_rng(seed)
    tree = build_basin_tree(landscape(shape, levels, seed), *costs(shape, seed))
    forest = solve_forest(tree, painted(shape, int(random.integers(0, 4)), 3, seed))
    for _ in range(steps):
        before = forest.labels.copy()
        start = random.integers(0, tree.height.size)
        voxels = np.unique(np.minimum(start + random.integers(0, 6, random.integers(1, 6)), tree.height.size - 1))
        box = forest.paint(voxels, UNMARKED if random.random() < 0.4 else int(random.integers(0, 4)))
        fresh = solve_forest(tree, forest.painted)
        np.testing.assert_array_equal(forest.labels, fresh.labels)
        np.testing.assert_array_equal(forest.foot_level, fresh.foot_level)
        np.testing.assert_array_equal(forest.marks, fresh.marks)
        np.testing.assert_array_equal(forest.lowest_mark, fresh.lowest_mark)
        changed = np.argwhere(before != forest.labels)
        if not len(changed):
            assert box is None
        else:
            assert [(s.start, s.stop - 1) for s in box] == list(
                zip(changed.min(axis=0).tolist(), changed.max(axis=0).tolist(), strict=True)
            )


def smooth_noise(seed, shape, sigma=1.0):
    values = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), sigma)
    return (values - values.min()).astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
def test_long_sequences_on_larger_landscapes_end_where_a_fresh_solve_does(seed, monkeypatch):
    monkeypatch.setattr(forest_module, "MOST_MENDED", 0.3 * seed)
    random = np.random.default_rng(seed)
    shape = (18, 23, 20)
    height = smooth_noise(seed, shape)
    if seed % 2:
        height = np.floor(height * 12.0)
    tree = build_basin_tree(height)
    forest = solve_forest(tree, np.full(shape, UNMARKED, np.uint8))
    z, y, x = np.indices(shape)
    for step in range(60):
        centre, radius = random.uniform(0, 1, 3) * shape, random.uniform(0.5, 3.5)
        ball = (z - centre[0]) ** 2 + (y - centre[1]) ** 2 + (x - centre[2]) ** 2 <= radius**2
        forest.paint(np.flatnonzero(ball), UNMARKED if step % 4 == 3 else int(random.integers(0, 5)))
        fresh = solve_forest(tree, forest.painted)
        np.testing.assert_array_equal(forest.labels, fresh.labels)
        np.testing.assert_array_equal(forest.foot_level, fresh.foot_level)


@settings(max_examples=100, deadline=None)
@given(shape=shapes, levels=level_counts, seed=st.integers(0, 2**32 - 1))
def test_restored_labels_are_those_of_a_fresh_solve(shape, levels, seed):
    random = np.random.default_rng(seed)
    tree = build_basin_tree(landscape(shape, levels, seed))
    forest = solve_forest(tree, painted(shape, 12, 3, seed))
    before = forest.labels.copy()
    voxels = np.unique(random.integers(0, tree.height.size, 8))
    with patch.object(forest_module, "MOST_MENDED", 1.0):
        box = forest.restore(voxels, random.choice(np.array([0, 1, 2, UNMARKED], np.uint8), len(voxels)))
    fresh = solve_forest(tree, forest.painted)
    np.testing.assert_array_equal(forest.labels, fresh.labels)
    np.testing.assert_array_equal(forest.foot_level, fresh.foot_level)
    outside = before != forest.labels
    if box is not None:
        outside[box] = False
    assert not outside.any()


@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_skimage_and_simpleitk_but_for_equally_low_passes(seed):
    """A voxel that two floods reach over passes of one height is theirs by rule, and the rules differ."""
    shape = (40, 41, 42)
    height = smooth_noise(seed, shape)
    markers = painted(shape, 25, 4, seed)
    got = solve_forest(build_basin_tree(height), markers).labels
    seeds = np.where(markers == UNMARKED, 0, markers.astype(np.int32) + 1)
    assert np.mean(got == watershed(height, seeds, connectivity=1) - 1) > 0.98
    itk = SimpleITK.MorphologicalWatershedFromMarkers(
        SimpleITK.GetImageFromArray(height),
        SimpleITK.GetImageFromArray(seeds.astype(np.uint8)),
        markWatershedLine=False,
        fullyConnected=False,
    )
    assert np.mean(got == SimpleITK.GetArrayFromImage(itk) - 1) > 0.98


@pytest.mark.parametrize("seed", range(3))
def test_no_marker_of_another_label_can_be_reached_over_a_lower_pass(seed):
    """The property that defines a watershed, against pass heights from a minimum spanning tree by scipy."""
    shape = (5, 5, 6)
    height = landscape(shape, [None, 7, 30][seed], seed)
    markers = painted(shape, 6, 4, seed)
    got = solve_forest(build_basin_tree(height), markers).labels
    number = np.arange(height.size).reshape(shape)
    pairs = np.concatenate(
        [np.stack([np.delete(number, -1, a).ravel(), np.delete(number, 0, a).ravel()], 1) for a in range(3)]
    )
    weight = height.ravel()[pairs].max(axis=1) + 1.0
    tree = minimum_spanning_tree(sparse.coo_matrix((weight, pairs.T), shape=(height.size,) * 2)).tocoo()
    near = [[] for _ in range(height.size)]
    for a, b, w in zip(tree.row, tree.col, tree.data, strict=True):
        near[a].append((b, w))
        near[b].append((a, w))
    reach = np.full((4, height.size), np.inf)
    for start in np.flatnonzero(markers.ravel() != UNMARKED):
        mine = reach[markers.ravel()[start]]
        stack = [(start, -1, height.ravel()[start] + 1.0)]
        while stack:
            voxel, parent, level = stack.pop()
            mine[voxel] = min(mine[voxel], level)
            stack += [(b, voxel, max(level, w)) for b, w in near[voxel] if b != parent]
    free = markers.ravel() == UNMARKED
    chosen = reach[got.ravel(), np.arange(height.size)]
    np.testing.assert_array_equal(chosen[free], reach.min(axis=0)[free])


def test_each_label_hangs_together_with_its_markers():
    shape = (10, 11, 12)
    markers = painted(shape, 9, 4, 7)
    got = solve_forest(build_basin_tree(landscape(shape, 6, 7)), markers).labels
    for label in np.unique(got):
        pieces, count = ndimage.label(got == label)
        assert set(np.unique(pieces[markers == label])) == set(range(1, count + 1))


def test_marked_voxels_keep_their_label_and_the_input_is_not_changed():
    shape = (6, 7, 8)
    height, markers = landscape(shape, 3, 8), painted(shape, 40, 4, 8)
    kept = height.copy(), markers.copy()
    got = solve_forest(build_basin_tree(height), markers).labels
    np.testing.assert_array_equal(height, kept[0])
    np.testing.assert_array_equal(markers, kept[1])
    np.testing.assert_array_equal(got[markers != UNMARKED], markers[markers != UNMARKED])
    assert not np.any(got == UNMARKED)
