"""Strokes in flat minima that several labels mark: mended as they are solved anew, whatever is put off."""

from unittest.mock import patch

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed import forest as module
from heartcase.pipeline.watershed import voxel_labels
from heartcase.pipeline.watershed.flat_minima import division
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
from tests.pipeline.watershed.test_forest import costs, shapes


def has_same_division(mended, anew):
    """Distances and counts of what is known to be divided are those of a fresh solution."""
    tree = mended.tree
    bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
    assert mended._division is None or mended._division.is_done
    for number, counts in (mended._division.counts if mended._division else {}).items():
        np.testing.assert_array_equal(counts, anew._division.counts[number])
        assert (number in mended._division.far) == (number in anew._division.far)
        if number in mended._division.far:
            continue
        inside = (tree.flat[basin] == number) & (bits == bits[tree.root[number]])
        np.testing.assert_array_equal(mended._division.distance[inside], anew._division.distance[inside])
        assert (mended._division.distance[inside] > 0).all()


@settings(max_examples=150, deadline=None)
@given(
    shape=shapes,
    level_count=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
    small=st.sampled_from([0.0, 2.0]),
    limits=st.fixed_dictionaries(
        {
            "BEHIND_FROM": st.sampled_from([0, 10**9]),
            "FEW_MARKED": st.sampled_from([0.0, 0.3, 2.0]),
            "MOST_MENDED": st.sampled_from([0.005, 0.3, 5.0]),
            "MOST_CARRIED": st.sampled_from([1, 5, 2000]),
            "DIVIDED_AT_ONCE": st.sampled_from([1, 4, 15, 10**9]),
            "MOST_ERASED": st.sampled_from([0, 10**9]),
            "DIVIDED_IN_PAUSES": st.sampled_from([1, 7]),
        }
    ),
    voxel_limits=st.fixed_dictionaries(
        {"MOST_AT_ONCE": st.sampled_from([0, 5, 10**9]), "MOST_LISTED": st.sampled_from([0, 20, 10**9])}
    ),
    settles=st.sampled_from([0.0, 0.3, 1.0]),
    puts_off=st.booleans(),
    is_restored=st.booleans(),
)
def test_a_mended_forest_is_the_one_that_is_solved_anew(
    shape, level_count, seed, small, limits, voxel_limits, settles, puts_off, is_restored
):
    rng = np.random.default_rng(seed)
    tree = build_basin_tree(rng.integers(0, level_count, shape).astype(np.float32), *costs(shape, seed))
    painted = np.full(shape, UNMARKED, np.uint8)
    of_forest, of_voxels = patch.multiple(module, **limits), patch.multiple(voxel_labels, **voxel_limits)
    with of_forest, of_voxels, patch.object(division, "SMALL_SHARE", small):
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
            for _ in range(rng.integers(3)):
                mended.fill_some()
            if puts_off and rng.random() >= settles:
                continue
            anew = solve_forest(tree, painted)
            if not puts_off:
                differs = before != mended.labels
                differs[box or ()] &= box is None
                assert not differs.any()
            if rng.random() < 0.5:
                counts = np.bincount(anew.labels.ravel(), minlength=256)
                np.testing.assert_array_equal(mended.label_counts(), counts)
            copy = mended.copy() if rng.random() < 0.3 else None
            mended.settle()
            np.testing.assert_array_equal(mended.labels, anew.labels)
            mended.fill()
            np.testing.assert_array_equal(mended.marks, anew.marks)
            np.testing.assert_array_equal(mended.lowest_mark, anew.lowest_mark)
            np.testing.assert_array_equal((copy or mended).marks, anew.marks)
            np.testing.assert_array_equal(mended.foot_label, anew.foot_label)
            np.testing.assert_array_equal(mended.foot_level, anew.foot_level)
            has_same_division(mended, anew)


def test_a_stroke_in_a_flat_that_two_labels_share_divides_it_alone():
    height = np.full((1, 1, 20), 1.0, np.float32)
    height[0, 0, 10] = 2.0
    forest = solve_forest(build_basin_tree(height), np.full(height.shape, UNMARKED, np.uint8))
    for voxel, label in ((0, 1), (19, 3), (9, 2)):
        forest.paint(np.array([voxel]), label)
    assert forest.labels.ravel().tolist() == [1] * 5 + [2] * 5 + [2] + [3] * 9
    redivided = division.Division.redivided
    with patch.object(division.Division, "redivided", autospec=True, side_effect=redivided) as divided:
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
    assert forest._division.far
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
        assert bool(forest._division.far) is not is_known
        has_same_division(forest, anew)


def test_a_stroke_through_a_flat_of_one_label_leaves_it_whole():
    # a contested flat of 9 voxels and one of a single label, with a wall between them
    height = np.full((1, 1, 19), 1.0, np.float32)
    height[0, 0, 9] = 2.0
    painted = np.full(height.shape, UNMARKED, np.uint8)
    painted[0, 0, [0, 8, 18]] = 1, 2, 3
    tree = build_basin_tree(height)
    forest = solve_forest(tree, painted)
    begin = division.Division._begin
    with patch.object(division.Division, "_begin", autospec=True, side_effect=begin) as begun:
        for voxels, label in (([7, 12], 3), ([12, 18], UNMARKED), ([4, 11], 2)):
            forest.paint(np.array(voxels), label)
            painted[0, 0, voxels] = label
            np.testing.assert_array_equal(forest.labels, solve_forest(tree, painted).labels)
        # the flat that label 3 had is another label's at last: nobody is sure that it was its alone
        assert [call.args[1] for call in begun.call_args_list] == [forest.tree.flat[tree.basin[0, 0, 11]]]


@settings(max_examples=60, deadline=None)
@given(
    shape=shapes,
    seed=st.integers(0, 2**32 - 1),
    most=st.sampled_from([1, 3, 10]),
    begins=st.booleans(),
    done=st.booleans(),
    small=st.sampled_from([0.0, 2.0]),
)
def test_until_it_is_done_a_voxel_has_its_label_of_before_or_of_then(shape, seed, most, begins, done, small):
    assume(np.prod(shape) >= 4)
    rng = np.random.default_rng(seed)
    tree = build_basin_tree(np.zeros(shape, np.float32), *costs(shape, seed))
    painted = np.full(shape, UNMARKED, np.uint8)
    painted.flat[rng.choice(painted.size, 3)] = [0, 0, 0] if begins else [0, 1, 0]
    limits = patch.multiple(module, DIVIDED_AT_ONCE=most, DIVIDED_IN_PAUSES=most)
    with limits, patch.object(division, "SMALL_SHARE", small):
        forest = solve_forest(tree, painted)
        forest.puts_off = True
        first = forest.copy()
        stroke = rng.choice(painted.size, rng.integers(1, 4), replace=False)
        values = rng.choice([2, 2, UNMARKED], len(stroke)).astype(np.uint8)
        forest.restore(stroke, values)
        painted.flat[stroke] = values
        anew = solve_forest(tree, painted)
        everything = np.arange(painted.size)
        while True:
            forest.settle_voxels(everything)
            is_known = (forest.labels == first.labels) | (forest.labels == anew.labels)
            is_known |= forest.labels == painted
            assert is_known.all()
            assert (forest.labels.flat[stroke] == values)[values != UNMARKED].all()
            if not forest.is_dividing or (done and rng.random() < 0.3):
                break
            forest.fill_some()
        # taken back, whether it was done or not
        forest.restore(stroke, first.painted.flat[stroke])
        forest.settle()
        np.testing.assert_array_equal(forest.labels, first.labels)
        forest.fill()
        np.testing.assert_array_equal(forest.marks, first.marks)
        has_same_division(forest, first)


def test_what_is_not_done_is_taken_back_at_once():
    tree = build_basin_tree(np.zeros((1, 20, 50), np.float32))
    painted = np.full((1, 20, 50), UNMARKED, np.uint8)
    painted[0, 10, [0, 49]] = 0, 1
    with patch.multiple(module, DIVIDED_AT_ONCE=30, DIVIDED_IN_PAUSES=30):
        forest = solve_forest(tree, painted)
        forest.puts_off = True
        distance, marks = forest._division.distance.copy(), forest.marks.copy()
        for times in (0, 1, 4):
            forest.paint(np.array([525, 526]), 2)
            for _ in range(times):
                forest.fill_some()
            assert forest.is_dividing
            assert (forest.marks == 2).sum() > 10 * times
            forest.paint(np.array([525, 526]), UNMARKED)
            assert not forest.is_dividing
            np.testing.assert_array_equal(forest.marks, marks)
            np.testing.assert_array_equal(forest._division.distance, distance)


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    at_once=st.sampled_from([1, 6, 40]),
    in_pauses=st.sampled_from([3, 25]),
    small=st.sampled_from([0.0, 2.0]),
    behind=st.sampled_from([0, 10**9]),
    raised=st.sampled_from([0.0, 0.3]),
)
def test_labels_come_and_go_in_one_flat(seed, at_once, in_pauses, small, behind, raised):
    """Strokes, erasers, undo, and all of a label erased, while labels spread or not: as it is solved anew."""
    rng = np.random.default_rng(seed)
    shape = (2, 5, 9)
    tree = build_basin_tree((rng.random(shape) < raised).astype(np.float32), *costs(shape, seed))
    painted = np.full(shape, UNMARKED, np.uint8)
    limits = patch.multiple(module, DIVIDED_AT_ONCE=at_once, DIVIDED_IN_PAUSES=in_pauses, BEHIND_FROM=behind)
    with limits, patch.object(division, "SMALL_SHARE", small):
        forest = solve_forest(tree, painted)
        forest.puts_off = True
        undone = []
        for _ in range(rng.integers(4, 16)):
            what = rng.integers(5)
            if what == 0 and undone:
                voxels, values = undone.pop()
            elif what == 1:
                voxels = np.flatnonzero(painted == rng.integers(3))
                values = np.full(len(voxels), UNMARKED, np.uint8)
            else:
                voxels = rng.choice(painted.size, rng.integers(1, 5), replace=False)
                values = np.full(len(voxels), UNMARKED if what == 2 else rng.integers(3), np.uint8)
            undone.append((voxels, painted.flat[voxels]))
            forest.restore(voxels, values)
            painted.flat[voxels] = values
            for _ in range(rng.choice([0, 1, 3, 20])):
                forest.fill_some()
            how = rng.integers(5)
            if how == 0:
                counts = np.bincount(solve_forest(tree, painted).labels.ravel(), minlength=256)
                np.testing.assert_array_equal(forest.label_counts(), counts)
            elif how == 1:
                forest.settle()
                np.testing.assert_array_equal(forest.labels, solve_forest(tree, painted).labels)
            elif how == 2:
                anew, copy = solve_forest(tree, painted), forest.copy()
                for one in (forest, copy):
                    one.fill()
                    for name in ("marks", "lowest_mark", "foot_label", "foot_level"):
                        np.testing.assert_array_equal(getattr(one, name), getattr(anew, name))
                    has_same_division(one, anew)
        forest.settle()
        np.testing.assert_array_equal(forest.labels, solve_forest(tree, painted).labels)
