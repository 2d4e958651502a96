import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.watershed.forest import UNMARKED, solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
from tests.pipeline.watershed import textbook

shapes = st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 7))
level_counts = st.sampled_from([1, 2, 3, 6, 40, None])


def landscape(shape, levels, seed, smooth=False):
    random = np.random.default_rng(seed)
    size = int(np.prod(shape))
    if levels is None:
        return random.permutation(size).astype(np.float32).reshape(shape) / np.float32(3.0)
    return random.integers(0, levels, shape).astype(np.float32)


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
    got = solve_forest(build_basin_tree(height), markers).labels
    np.testing.assert_array_equal(got, textbook.flood(height, markers))


@settings(max_examples=60, deadline=None)
@given(shape=shapes, levels=level_counts, seed=st.integers(0, 2**32 - 1), count=st.integers(1, 20))
def test_the_two_textbook_forms_agree(shape, levels, seed, count):
    height, markers = landscape(shape, levels, seed), painted(shape, count, 3, seed)
    np.testing.assert_array_equal(textbook.joined(height, markers), textbook.flood(height, markers))


@settings(max_examples=300, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 7), st.integers(1, 8), st.integers(1, 9)),
    levels=level_counts,
    seed=st.integers(0, 2**32 - 1),
    steps=st.integers(1, 15),
)
def test_any_sequence_of_strokes_ends_where_a_fresh_solve_does(shape, levels, seed, steps):
    random = np.random.default_rng(seed)
    tree = build_basin_tree(landscape(shape, levels, seed))
    forest = solve_forest(tree, painted(shape, int(random.integers(0, 4)), 3, seed))
    for _ in range(steps):
        before = forest.labels.copy()
        start = random.integers(0, tree.height.size)
        voxels = np.unique(np.minimum(start + random.integers(0, 6, random.integers(1, 6)), tree.height.size - 1))
        box = forest.paint(voxels, UNMARKED if random.random() < 0.15 else int(random.integers(0, 4)))
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
