import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from heartcase.pipeline.cells.changes import _is_simple, topology_changes
from heartcase.pipeline.kernels.topology import betti_numbers, distance_in_samples


def changes(before, after, connectivity=26):
    depth = np.maximum(distance_in_samples(before), distance_in_samples(~before))
    return topology_changes(before, after, depth, connectivity)


def solid(shape=(15, 15, 15)):
    mask = np.zeros(shape, bool)
    mask[3:-3, 3:-3, 3:-3] = True
    return mask


@pytest.mark.parametrize("connectivity", [6, 26])
def test_what_can_be_deformed_has_no_change(connectivity):
    moved = np.roll(solid(), (2, -1, 1), axis=(0, 1, 2))
    assert changes(solid(), moved, connectivity) == []
    thin = np.zeros_like(moved)
    thin[7, 7, 3:-3] = True
    assert changes(solid(), thin, connectivity) == []
    assert changes(solid(), solid(), connectivity) == []


@pytest.mark.parametrize("connectivity", [6, 26])
@pytest.mark.parametrize("is_closed", [False, True])
@pytest.mark.parametrize(
    ("what", "place"),
    [
        ("tunnel", (slice(None), slice(6, 8), slice(9, 11))),
        ("hollow", (slice(6, 8), slice(6, 8), slice(9, 11))),
        ("gap", (slice(None), slice(None), slice(7, 9))),
    ],
)
def test_a_place_is_where_the_change_is(what, place, is_closed, connectivity):
    holed = solid()
    holed[place] = False
    found = changes(holed, solid(), connectivity) if is_closed else changes(solid(), holed, connectivity)
    assert len(found) == 1
    for at, part in zip(found[0].place, place, strict=True):
        low, high, _ = part.indices(15)
        assert low - 1 <= at <= high


def test_changes_that_cancel_in_the_counts_are_found_all_the_same():
    before, after = solid(), solid()
    before[:, 5, 5] = False
    after[:, 9, 9] = False
    assert betti_numbers(before, 26) == betti_numbers(after, 26)
    assert sorted(change.place[1] for change in changes(before, after)) == [5, 9]


def test_a_piece_that_comes_or_goes_is_a_change():
    before, after = solid(), solid()
    before[1, 1, 1] = True
    after[13, 13, 13] = True
    assert sorted(change.place for change in changes(before, after)) == [(1, 1, 1), (13, 13, 13)]


def test_simple_voxels_are_those_of_the_definition():
    # One piece of the set around the voxel, and one of what is off it that shares a face with the voxel.
    random = np.random.default_rng(0)
    to_centre = np.abs(np.indices((3, 3, 3)) - 1).sum(axis=0)
    for _ in range(3000):
        inside = random.random((3, 3, 3)) < random.random()
        inside[1, 1, 1] = False
        outside = ndimage.label(~inside & (to_centre > 0) & (to_centre < 3))[0]
        pieces = ndimage.label(inside, np.ones((3, 3, 3)))[1]
        is_simple = pieces == 1 and len(set(outside[to_centre == 1].tolist()) - {0}) == 1
        assert bool(_is_simple((np.int64(1) << np.flatnonzero(inside)).sum())) == is_simple


@settings(max_examples=60, deadline=None)
@given(st.sampled_from([6, 26]), st.data())
def test_without_a_change_the_betti_numbers_are_equal(connectivity, data):
    shape = data.draw(st.tuples(*[st.integers(3, 7)] * 3))
    before, after = (data.draw(hnp.arrays(bool, shape)) for _ in range(2))
    if data.draw(st.booleans()):
        before, after = (ndimage.binary_closing(np.pad(mask, 2))[2:-2, 2:-2, 2:-2] for mask in (before, after))
    found = topology_changes(before, after, np.zeros(shape, np.float32), connectivity)
    assert sum(change.size for change in found) <= (before != after).sum()
    if not found:
        assert betti_numbers(before, connectivity) == betti_numbers(after, connectivity)
    if betti_numbers(before, connectivity) != betti_numbers(after, connectivity):
        assert found
    if (before == after).all():
        assert not found
    for change in found:
        assert before[change.place] != after[change.place]


def test_the_larger_change_comes_first():
    before = solid((15, 15, 25))
    after = before.copy()
    after[:, 5, 5] = False
    after[:, 4:11, 15] = False
    sizes = [change.size for change in changes(before, after)]
    assert sizes == sorted(sizes, reverse=True)
    assert len(sizes) == 2
