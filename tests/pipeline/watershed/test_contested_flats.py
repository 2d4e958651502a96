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
from tests.pipeline.watershed.test_forest import costs, shapes


def has_same_division(mended, anew):
    """Distances and counts of what is known to be divided are those of a fresh solution."""
    tree = mended.tree
    bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
    for number, counts in (mended._division.counts if mended._division else {}).items():
        np.testing.assert_array_equal(counts, anew._division.counts[number])
        inside = (tree.flat[basin] == number) & (bits == bits[tree.root[number]])
        np.testing.assert_array_equal(mended._division.distance[inside], anew._division.distance[inside])
        assert (mended._division.distance[inside] > 0).all()


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
    tree = build_basin_tree(rng.integers(0, level_count, shape).astype(np.float32), *costs(shape, seed))
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
            has_same_division(mended, anew)


def test_a_stroke_in_a_flat_that_two_labels_share_divides_it_alone():
    height = np.full((1, 1, 20), 1.0, np.float32)
    height[0, 0, 10] = 2.0
    forest = solve_forest(build_basin_tree(height), np.full(height.shape, UNMARKED, np.uint8))
    for voxel, label in ((0, 1), (19, 3), (9, 2)):
        forest.paint(np.array([voxel]), label)
    assert forest.labels.ravel().tolist() == [1] * 5 + [2] * 5 + [2] + [3] * 9
    with patch.object(module, "redivided", wraps=division.redivided) as divided:
        forest.paint(np.array([4]), 2)
        assert forest.labels.ravel().tolist() == [1] * 3 + [2] * 7 + [2] + [3] * 9
        forest.paint(np.array([4]), UNMARKED)
        assert forest.labels.ravel().tolist() == [1] * 5 + [2] * 5 + [2] + [3] * 9
        forest.paint(np.array([15]), 3)
        assert divided.call_count == 2


def test_a_copy_is_painted_on_alone():
    rng = np.random.default_rng(3)
    height = np.maximum(rng.random((6, 7, 8)), 0.7).astype(np.float32)
    painted = np.full(height.shape, UNMARKED, np.uint8)
    painted.flat[rng.choice(painted.size, 6, replace=False)] = [0, 1, 2] * 2
    forest = solve_forest(build_basin_tree(height), painted)
    assert forest._division.counts
    before = {name: getattr(forest, name).copy() for name in ("labels", "marks", "painted", "flat_label")}
    distance, counts = forest._division.distance.copy(), dict(forest._division.counts)
    copy = forest.copy()
    for label in (5, 1, UNMARKED):
        copy.paint(rng.choice(painted.size, 9, replace=False), label)
    assert (copy.labels != forest.labels).any()
    for name, values in before.items():
        np.testing.assert_array_equal(getattr(forest, name), values)
    np.testing.assert_array_equal(forest._division.distance, distance)
    assert forest._division.counts.keys() == counts.keys()
    for number, values in counts.items():
        np.testing.assert_array_equal(forest._division.counts[number], values)


def test_a_flat_with_longer_ways_than_can_be_noted_is_divided_anew(monkeypatch):
    monkeypatch.setattr(division, "FARTHEST", 1_052 * 15)
    shape = (1, 1, 2_000)
    tree = build_basin_tree(np.full(shape, 1.0, np.float32), np.full(shape, 5, np.uint16), (1, 1, 3))
    painted = np.full(shape, UNMARKED, np.uint8)
    painted[0, 0, :2] = 1, 2
    forest = solve_forest(tree, painted)
    assert not forest._division.counts
    # with a third label far away all distances can be noted, and without it they cannot any more
    for voxel, label, is_known in (
        (1_900, 3, True),
        (1_800, 1, True),
        (1_800, UNMARKED, True),
        (1_900, UNMARKED, False),
    ):
        forest.paint(np.array([voxel]), label)
        painted[0, 0, voxel] = label
        anew = solve_forest(tree, painted)
        np.testing.assert_array_equal(forest.labels, anew.labels)
        np.testing.assert_array_equal(forest.marks, anew.marks)
        assert bool(forest._division.counts) is is_known
        has_same_division(forest, anew)


def test_a_stroke_through_a_flat_of_one_label_leaves_it_whole():
    # a contested flat of 9 voxels and one of a single label, with a wall between them
    height = np.full((1, 1, 19), 1.0, np.float32)
    height[0, 0, 9] = 2.0
    painted = np.full(height.shape, UNMARKED, np.uint8)
    painted[0, 0, [0, 8, 18]] = 1, 2, 3
    tree = build_basin_tree(height)
    forest = solve_forest(tree, painted)
    with patch.object(division, "_anew", wraps=division._anew) as anew:
        for voxels, label in (([7, 12], 3), ([12, 18], UNMARKED), ([4, 11], 2)):
            forest.paint(np.array(voxels), label)
            painted[0, 0, voxels] = label
            np.testing.assert_array_equal(forest.labels, solve_forest(tree, painted).labels)
        # the flat that label 3 had is another label's at last: nobody is sure that it was its alone
        assert [call.args[1] for call in anew.call_args_list] == [forest.tree.flat[tree.basin[0, 0, 11]]]
