import heapq

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.certainty import foot_certainty, voxel_certainty
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
from tests.pipeline.watershed.test_forest import landscape, level_counts, painted, shapes
from tests.pipeline.watershed.textbook import neighbours


def passes(height, markers):
    """Label -> pass to every voxel: the lowest height a way to a voxel with the label must climb to (Dijkstra)."""
    found = {}
    for label in sorted(set(markers.ravel().tolist()) - {UNMARKED}):
        best = np.full(height.shape, np.inf)
        shore = [(float(height[tuple(v)]), tuple(int(a) for a in v)) for v in np.argwhere(markers == label)]
        heapq.heapify(shore)
        while shore:
            climb, voxel = heapq.heappop(shore)
            if climb < best[voxel]:
                best[voxel] = climb
                for near in neighbours(voxel, height.shape):
                    heapq.heappush(shore, (max(climb, float(height[near])), near))
        found[label] = best
    return found


def expected(height, markers, labels):
    """Own and other pass and certainty of every voxel, from their definition."""
    every = passes(height, markers)
    own, other = np.full(height.shape, np.inf), np.full(height.shape, np.inf)
    for label, climb in every.items():
        own = np.where(labels == label, climb, own)
        other = np.where(labels != label, np.minimum(other, climb), other)
    with np.errstate(invalid="ignore", divide="ignore"):
        certainty = np.where(other == 0.0, 0.0, np.where(np.isinf(other), 1.0, 1.0 - own / other))
    certainty[np.isinf(own)] = 0.0
    certainty[markers != UNMARKED] = 1.0
    return every, own, other, certainty


@settings(max_examples=200, deadline=None)
@given(
    shape=shapes,
    levels=level_counts,
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 30),
    labels=st.integers(1, 4),
)
def test_passes_and_certainties_are_those_of_the_voxel_graph(shape, levels, seed, count, labels):
    height, markers = landscape(shape, levels, seed), painted(shape, count, labels, seed)
    forest = solve_forest(build_basin_tree(height), markers)
    every, _, _, certainty = expected(height, markers, forest.labels)
    got = foot_certainty(forest)
    root, foot = forest.tree.root, forest.foot_label
    root_passes = np.array([every[label].ravel()[root] for label in every]).reshape(len(every), len(root))
    names = np.array(list(every), int)
    is_own = names[:, None] == foot
    np.testing.assert_array_equal(got.own, np.where(is_own, root_passes, np.inf).min(axis=0, initial=np.inf))
    np.testing.assert_array_equal(got.other, np.where(is_own, np.inf, root_passes).min(axis=0, initial=np.inf))
    for n, rival in enumerate(got.rival):
        if rival == UNMARKED:
            assert np.isinf(got.other[n])
        else:
            assert rival != foot[n]
            assert every[int(rival)].ravel()[root[n]] == got.other[n]
    np.testing.assert_allclose(voxel_certainty(forest, got), certainty, rtol=0.0, atol=2e-7)
    free = markers.ravel()[root] == UNMARKED
    np.testing.assert_allclose(got.certainty[free], certainty.ravel()[root][free], rtol=0.0, atol=2e-7)


def test_a_valley_is_as_sure_as_its_passes_say():
    # marks of two labels at the ends, passes of 2 and 8 on the ways to the valley between
    height = np.array([0, 2, 1, 8, 0], np.float32).reshape(1, 1, 5)
    markers = np.full(height.shape, UNMARKED, np.uint8)
    markers[0, 0, [0, 4]] = 1, 2
    forest = solve_forest(build_basin_tree(height), markers)
    feet = foot_certainty(forest)
    assert feet.own.tolist() == [0.0, 2.0, 0.0]
    assert feet.other.tolist() == [8.0, 8.0, 8.0]
    assert feet.rival.tolist() == [2, 2, 1]
    assert voxel_certainty(forest).ravel().tolist() == [1.0, 0.75, 0.75, 0.0, 1.0]


def test_a_landscape_twice_as_high_is_as_sure():
    height, markers = landscape((5, 6, 7), None, 3), painted((5, 6, 7), 6, 3, 3)
    one, other = (voxel_certainty(solve_forest(build_basin_tree(h), markers)) for h in (height, 2.0 * height))
    np.testing.assert_array_equal(one, other)
    assert 0.0 < one.mean() < 1.0


@pytest.mark.parametrize(("labels", "sure"), [((), 0.0), ((3,), 1.0)])
def test_without_markers_nothing_is_sure_and_with_one_label_all_is(labels, sure):
    height = landscape((3, 4, 5), None, 1)
    markers = np.full(height.shape, UNMARKED, np.uint8)
    markers.flat[: len(labels)] = labels
    certainty = voxel_certainty(solve_forest(build_basin_tree(height), markers))
    assert (certainty == sure).all()


def test_any_number_of_threads_gives_the_same():
    height, markers = landscape((9, 10, 11), None, 4), painted((9, 10, 11), 12, 3, 4)
    found = []
    before = numba.get_num_threads()
    for threads in (1, before):
        numba.set_num_threads(threads)
        found.append(voxel_certainty(solve_forest(build_basin_tree(height), markers)))
    np.testing.assert_array_equal(*found)
