"""Strokes in flat minima that several labels mark: mended as they are solved anew, whatever is put off."""

from unittest.mock import patch

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed import division
from heartcase.pipeline.watershed import forest as module
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
from tests.pipeline.watershed.test_forest import shapes


@settings(max_examples=150, deadline=None)
@given(
    shape=shapes,
    level_count=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
    limits=st.fixed_dictionaries(
        {
            "BEHIND_FROM": st.sampled_from([0, 10**9]),
            "FEW_MARKED": st.sampled_from([0.0, 0.3, 2.0]),
            "MOST_AT_ONCE": st.sampled_from([0, 5, 10**9]),
            "MOST_LISTED": st.sampled_from([0, 20, 10**9]),
            "MOST_MENDED": st.sampled_from([0.005, 0.3, 5.0]),
            "MOST_CARRIED": st.sampled_from([1, 5, 2000]),
        }
    ),
    puts_off=st.booleans(),
    is_restored=st.booleans(),
)
def test_a_mended_forest_is_the_one_that_is_solved_anew(shape, level_count, seed, limits, puts_off, is_restored):
    rng = np.random.default_rng(seed)
    tree = build_basin_tree(rng.integers(0, level_count, shape).astype(np.float32))
    painted = np.full(shape, UNMARKED, np.uint8)
    with patch.multiple(module, **limits):
        mended = solve_forest(tree, painted)
        mended.puts_off = puts_off
        for label in rng.choice([0, 1, 2, UNMARKED], rng.integers(1, 10)).tolist():
            start = rng.integers(painted.size)
            voxels = np.unique(np.minimum(start + rng.integers(0, 6, 3), painted.size - 1))
            before = mended.labels.copy()
            if is_restored:
                values = rng.choice([label, 0, UNMARKED], len(voxels)).astype(np.uint8)
                box = mended.restore(voxels, values)
            else:
                values, box = label, mended.paint(voxels, label)
            painted.reshape(-1)[voxels] = values
            anew = solve_forest(tree, painted)
            if not puts_off:
                differs = before != mended.labels
                differs[box or ()] &= box is None
                assert not differs.any()
            mended.settle()
            np.testing.assert_array_equal(mended.labels, anew.labels)
            np.testing.assert_array_equal(mended.marks, anew.marks)
            np.testing.assert_array_equal(mended.lowest_mark, anew.lowest_mark)


def test_a_stroke_in_a_flat_that_two_labels_share_divides_it_alone():
    height = np.full((1, 1, 20), 1.0, np.float32)
    height[0, 0, 10] = 2.0
    forest = solve_forest(build_basin_tree(height), np.full(height.shape, UNMARKED, np.uint8))
    for voxel, label in ((0, 1), (19, 3), (9, 2)):
        forest.paint(np.array([voxel]), label)
    assert forest.labels.ravel().tolist() == [1] * 5 + [2] * 5 + [2] + [3] * 9
    with patch.object(module, "divided_anew", wraps=division.divided_anew) as divided:
        forest.paint(np.array([4]), 2)
        assert forest.labels.ravel().tolist() == [1] * 3 + [2] * 7 + [2] + [3] * 9
        forest.paint(np.array([4]), UNMARKED)
        assert forest.labels.ravel().tolist() == [1] * 5 + [2] * 5 + [2] + [3] * 9
        forest.paint(np.array([15]), 3)
        assert divided.call_count == 2
