import heapq
import itertools

import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage, sparse
from scipy.sparse.csgraph import minimum_spanning_tree
from skimage.segmentation import watershed

from heartcase.pipeline.flood import flood_from_markers

UNMARKED = 255
SIDES = ((-1, 0, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1), (0, 1, 0), (1, 0, 0))


def textbook_flood(height, markers):
    """The priority flood with a list as the shore and the tie rule spelled out."""
    labels = markers.copy()
    turns = itertools.count()
    shore = []
    for voxel in np.argwhere(markers != UNMARKED):
        heapq.heappush(shore, (height[tuple(voxel)], next(turns), tuple(voxel)))
    while shore:
        _, _, voxel = heapq.heappop(shore)
        for side in SIDES:
            near = tuple(int(a + b) for a, b in zip(voxel, side, strict=True))
            if all(0 <= a < n for a, n in zip(near, height.shape, strict=True)) and labels[near] == UNMARKED:
                labels[near] = labels[voxel]
                heapq.heappush(shore, (height[near], next(turns), near))
    return labels


def random_case(seed, shape=(6, 7, 8), levels=None, labels=4, count=8):
    random = np.random.default_rng(seed)
    size = int(np.prod(shape))
    if levels is None:
        height = random.permutation(size).astype(np.float32).reshape(shape)
    else:
        height = random.integers(0, levels, shape).astype(np.float32)
    markers = np.full(shape, UNMARKED, np.uint8)
    markers.flat[random.choice(size, count, replace=False)] = random.integers(0, labels, count)
    return height, markers


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), levels=st.sampled_from([1, 2, 5, 50, None]), count=st.integers(1, 60))
def test_equals_the_textbook_flood_with_its_tie_rule(seed, levels, count):
    height, markers = random_case(seed, levels=levels, count=count)
    np.testing.assert_array_equal(
        flood_from_markers(height, markers, unmarked=UNMARKED), textbook_flood(height, markers)
    )


@pytest.mark.parametrize("seed", range(4))
def test_equals_skimage_and_simpleitk_where_no_two_voxels_are_equally_high(seed):
    height, markers = random_case(seed, (20, 21, 22), count=30)
    got = flood_from_markers(height, markers, unmarked=UNMARKED)
    seeds = np.where(markers == UNMARKED, 0, markers.astype(np.int32) + 1)
    np.testing.assert_array_equal(got, watershed(height, seeds, connectivity=1) - 1)
    itk = SimpleITK.MorphologicalWatershedFromMarkers(
        SimpleITK.GetImageFromArray(height),
        SimpleITK.GetImageFromArray(seeds.astype(np.uint8)),
        markWatershedLine=False,
        fullyConnected=False,
    )
    # ITK fills a pit at the level of its rim, last come last served, which moves single voxels of the divide
    assert np.mean(got == SimpleITK.GetArrayFromImage(itk) - 1) > 0.98


@pytest.mark.parametrize("seed", range(3))
def test_no_marker_of_another_label_can_be_reached_over_a_lower_pass(seed):
    """The property that defines a watershed, against pass heights from a minimum spanning tree."""
    shape = (5, 5, 6)
    height, markers = random_case(seed, shape, count=6)
    got = flood_from_markers(height, markers, unmarked=UNMARKED)
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


def test_on_a_plateau_two_floods_meet_half_way():
    markers = np.full((1, 1, 10), UNMARKED, np.uint8)
    markers[0, 0, [0, 9]] = 3, 0
    got = flood_from_markers(np.zeros((1, 1, 10), np.float32), markers, unmarked=UNMARKED)
    assert got.ravel().tolist() == [3] * 5 + [0] * 5


def test_each_label_hangs_together_with_its_markers():
    height, markers = random_case(7, (10, 11, 12), levels=6, count=9)
    got = flood_from_markers(height, markers, unmarked=UNMARKED)
    for label in np.unique(got):
        pieces, count = ndimage.label(got == label)
        assert set(np.unique(pieces[markers == label])) == set(range(1, count + 1))


def test_marked_voxels_keep_their_label_and_the_input_is_not_changed():
    height, markers = random_case(8, levels=3, count=40)
    before = markers.copy()
    got = flood_from_markers(height, markers, unmarked=UNMARKED)
    np.testing.assert_array_equal(markers, before)
    np.testing.assert_array_equal(got[markers != UNMARKED], markers[markers != UNMARKED])
    assert not np.any(got == UNMARKED)


def test_views_that_are_not_contiguous_work():
    height, markers = random_case(9)
    turned = flood_from_markers(height.transpose(2, 1, 0), markers.transpose(2, 1, 0), unmarked=UNMARKED)
    np.testing.assert_array_equal(turned, textbook_flood(height.transpose(2, 1, 0), markers.transpose(2, 1, 0)))
