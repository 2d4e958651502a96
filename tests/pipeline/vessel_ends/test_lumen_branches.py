"""Ways within a lumen against straight distances, and its branches against shapes whose arms are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from heartcase.pipeline.vessel_ends.lumen_branches import find_branches, way_within
from tests.pipeline.lattices import LATTICES, lattice, points_of
from tests.pipeline.vessel_shapes import line, tube


def errors_in_a_box(geometry):
    """How much longer the way from the middle of a box is than the distance, mm."""
    sources = np.zeros(geometry.shape, np.bool_)
    k, j, i = (n // 2 for n in geometry.shape)
    sources[k, j, i] = True
    way = way_within(np.ones(geometry.shape, np.bool_), geometry.spacing_mm, sources)
    return way - np.linalg.norm(points_of(geometry) - geometry.index_to_world((i, j, k)), axis=-1)


@pytest.mark.parametrize("kind", sorted(LATTICES))
def test_the_way_in_an_open_box_is_the_distance(kind):
    geometry = lattice(kind, 40.0)
    error = errors_in_a_box(geometry)
    # first order in the spacing, with a logarithm, as the front starts at a point; never shorter
    assert error.min() >= -1e-9
    assert error.max() < 1.7 * max(geometry.spacing_mm)
    assert errors_in_a_box(geometry.refined(2)).max() < 0.7 * error.max()


def test_the_way_goes_round_what_is_not_lumen_and_not_to_other_pieces():
    mask = np.ones((3, 20, 41), np.bool_)
    mask[:, 4:, 20] = False
    mask[:, :, 40] = False
    mask[1, 10, 40] = True
    mask[:, :, 39] = False
    sources = np.zeros_like(mask)
    sources[1, 19, 0] = True
    way = way_within(mask, (1.0, 1.0, 1.0), sources)
    # over the corner of the barrier and down its other side, where the straight distance is 38
    true = np.hypot(20.0, 16.0) + np.hypot(18.0, 16.0)
    assert true <= way[1, 19, 38] <= 1.06 * true
    assert np.isinf(way[1, 10, 40])
    assert np.isinf(way[~mask]).all()


@pytest.mark.parametrize("kind", sorted(LATTICES))
def test_the_arms_of_a_fork_are_told_with_their_tips_and_where_they_join(kind):
    geometry = lattice(kind, 70.0)
    fork = np.array((0.0, 0.0, 0.0))
    ends = [np.array((-18.0, 4.0, 20.0)), np.array((20.0, -3.0, 15.0))]
    foot = np.array((2.0, 3.0, -26.0))
    trunk = tube(geometry, line(tuple(foot), tuple(fork)), 5.0)
    mask = trunk | np.logical_or.reduce([tube(geometry, line(tuple(fork), tuple(end)), 4.0) for end in ends])
    sources = mask & (np.linalg.norm(points_of(geometry) - foot, axis=-1) < 5.0)
    (root,) = find_branches(mask, geometry.spacing_mm, sources)
    assert len(root.index) == np.count_nonzero(mask)
    assert len(root.leaves) == 2
    tips = [geometry.index_to_world(leaf.index[0][::-1]) for leaf in root.leaves]
    for end in ends:
        nearest = min(np.linalg.norm(tip - end) for tip in tips)
        assert nearest < 4.0 + 1.5 * max(geometry.spacing_mm)
    for leaf in root.leaves:
        arm_mm = leaf.top_mm - leaf.foot_mm
        assert 8.0 < arm_mm < 30.0
        # what is told of the arm lies beyond the joint
        assert (leaf.way_mm > leaf.foot_mm).all()
        assert np.all(np.diff(leaf.way_mm) <= 0.0)


def test_a_bump_is_no_branch():
    geometry = lattice("even", 60.0)
    mask = tube(geometry, line((0.0, 0.0, -26.0), (0.0, 0.0, 26.0)), 8.0)
    bumpy = mask | (np.linalg.norm(points_of(geometry) - (8.0, 0.0, 0.0), axis=-1) < 4.0)
    sources = mask & (points_of(geometry)[..., 2] < -24.0)
    assert len(find_branches(bumpy, geometry.spacing_mm, sources)[0].leaves) == 1


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.5, 0.95))
def test_arms_lie_in_what_they_join_and_begin_at_a_farthest_voxel(seed, share):
    random = np.random.default_rng(seed)
    mask = ndimage.zoom(random.random(random.integers(3, 6, 3)), 3, order=1) < share
    sources = mask & (random.random(mask.shape) < 0.01)
    spacing = tuple(random.uniform(0.5, 2.0, 3))
    way = way_within(mask, spacing, sources)
    roots = find_branches(mask, spacing, sources)
    assert sum(len(root.index) for root in roots) == np.count_nonzero(np.isfinite(way))

    def look(branch):
        own = {tuple(one) for one in branch.index.tolist()}
        np.testing.assert_array_equal(way[tuple(branch.index.T)], branch.way_mm)
        assert branch.way_mm[0] == branch.way_mm.max()
        inner = [{tuple(one) for one in arm.index.tolist()} for arm in branch.arms]
        assert all(one <= own for one in inner)
        assert sum(len(one) for one in inner) == len(set().union(*inner)) if inner else True
        for arm in branch.arms:
            assert arm.foot_mm >= branch.foot_mm
            look(arm)

    for root in roots:
        look(root)
