"""Thin lumens between the voxels that are taken: whatever way a tube goes, the labels' own pieces stay in one piece."""

from itertools import pairwise

import cc3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.building.quick_surface import quick_surface
from heartcase.pipeline.building.thin_lumens import THIN_STEPS, thin_lumens
from heartcase.pipeline.data import UNMARKED, Segmentation
from heartcase.schemas.geometry import Geometry
from tests.pipeline.building.test_quick_surface import TABLE, euler, parts, recipe, shells
from tests.thoroughly import thoroughly

VEIN, ATRIUM = TABLE["superior vena cava"].value, TABLE["left atrium"].value
MUSCLE = TABLE["left ventricular myocardium"].value


def line_of_voxels(corners):
    """Voxels [z, y, x] along a polyline, each beside the last over a face."""
    found = [np.rint(corners[0]).astype(int)]
    for one, other in pairwise(corners):
        for t in np.linspace(0.0, 1.0, 8 * int(np.abs(np.subtract(other, one)).sum()) + 2):
            at = np.rint((1.0 - t) * np.array(one) + t * np.array(other)).astype(int)
            for axis in range(3):
                if at[axis] != found[-1][axis]:
                    step = found[-1].copy()
                    step[axis] = at[axis]
                    found.append(step)
    return np.array(found)


def tube(labels, corners, width, value):
    """A tube of a square cross-section, so many voxels wide."""
    for z, y, x in line_of_voxels(corners):
        labels[z : z + width, y : y + width, x : x + width] = value


def taken(labels, steps):
    """Every n-th voxel [z, y, x], the first one's index (i, j, k), and the coarse voxel that each voxel is in."""
    first = np.array(steps) // 2
    i, j, k = (slice(int(a), None, int(step)) for a, step in zip(first, steps, strict=True))
    coarse = np.ascontiguousarray(labels[k, j, i])
    where = np.argwhere(labels > -1) // np.array(steps)[::-1]
    return coarse, first, where.reshape(*labels.shape, 3)


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_a_thin_tube_is_in_every_coarse_voxel_that_it_passes_through(data):
    steps = np.array(data.draw(st.tuples(*(st.integers(2, 5),) * 3), "steps"))
    width = data.draw(st.integers(1, int(THIN_STEPS * steps.min()) - 1), "width")
    places = st.tuples(*(st.integers(2, 59 - width),) * 3)
    corners = data.draw(st.lists(places, min_size=2, max_size=4, unique=True), "corners")
    labels = np.zeros((60, 60, 60), np.uint8)
    tube(labels, corners, width, VEIN)
    coarse, first, where = taken(labels, steps)
    found, is_thin = thin_lumens(labels, coarse, steps, first, TABLE)
    is_known = (where < coarse.shape).all(axis=-1)
    # its bends may be wider; all else is in, so that pieces of the labels cannot fall apart
    mine = (labels == VEIN) & is_known
    if not thick(labels == VEIN, steps).any():
        assert (found[tuple(where[mine].T)] == VEIN).all()
        assert (is_thin == (found == VEIN)).all()
        assert cc3d.connected_components(found == VEIN, connectivity=6).max() == 1
    # and nothing is where the labels have nothing
    touched = np.zeros(coarse.shape, np.bool_)
    touched[tuple(where[mine].T)] = True
    assert not (found[~touched] == VEIN).any()


def thick(mask, steps):
    """Voxels of a mask that goes on over twice the step or more along all axes."""
    found = mask.copy()
    for axis, step in zip((2, 1, 0), steps, strict=True):
        length = int(np.ceil(THIN_STEPS * step))
        lines = np.moveaxis(mask, axis, -1)
        long = np.zeros_like(lines)
        for start in range(lines.shape[-1] - length + 1):
            run = lines[..., start : start + length].all(axis=-1)
            long[..., start : start + length] |= run[..., None]
        found &= np.moveaxis(long, -1, axis)
    return found


def test_what_is_wide_is_left_as_it_is_and_so_is_what_is_not_background():
    k, j, i = np.indices((60, 60, 60))
    labels = np.where((k - 30) ** 2 + (j - 31) ** 2 + (i - 29) ** 2 <= 18**2, ATRIUM, 0).astype(np.uint8)
    # roughness of single voxels all over it
    rough = np.random.default_rng(0).random(labels.shape) < 0.3
    beside = np.maximum.reduce([np.roll(labels, way, axis) for way in (-1, 1) for axis in range(3)])
    labels = np.where(rough, beside, labels)
    steps = np.array([3, 3, 3])
    coarse, first, _ = taken(labels, steps)
    found, is_thin = thin_lumens(labels, coarse, steps, first, TABLE)
    np.testing.assert_array_equal(found, coarse)
    assert not is_thin.any()
    labels[:] = MUSCLE
    tube(labels, [(4, 4, 4), (50, 40, 30)], 2, VEIN)
    coarse, first, _ = taken(labels, steps)
    found, _ = thin_lumens(labels, coarse, steps, first, TABLE)
    np.testing.assert_array_equal(found, coarse)


def test_a_thin_vein_reaches_the_atrium_that_it_opens_into():
    labels = np.full((60, 60, 60), UNMARKED, np.uint8)
    k, j, i = np.indices(labels.shape)
    labels[(k - 30) ** 2 + (j - 30) ** 2 + (i - 18) ** 2 <= 14**2] = ATRIUM
    for steps in ((3, 3, 3), (4, 3, 5)):
        for start in (30, 31, 32, 33):
            with_vein = labels.copy()
            tube(with_vein, [(start, start, 18), (start, start, 40), (start + 9, start + 9, 56)], 2, ATRIUM)
            coarse, first, _ = taken(with_vein, np.array(steps))
            found, _ = thin_lumens(with_vein, coarse, np.array(steps), first, TABLE)
            assert cc3d.connected_components(found == ATRIUM, connectivity=6).max() == 1
            assert (found == ATRIUM).any(axis=(0, 1)).nonzero()[0].max() >= 56 // steps[0] - 1


def two_chambers_and_a_tube(way, diameter, off):
    """Two balls in corners, so that few voxels are taken, and a round tube between them that touches neither."""
    size = 130
    geometry = Geometry.of(shape=(size,) * 3, spacing_mm=(1.0,) * 3, origin_mm=(-0.5 * (size - 1),) * 3)
    k, j, i = np.indices(geometry.shape)
    at = geometry.index_to_world(np.stack([i, j, k], axis=-1))
    labels = np.zeros(geometry.shape, np.uint8)
    for label, side in (("left atrium", -38.0), ("right atrium", 38.0)):
        labels[np.linalg.norm(at - side * np.array([1.0, -1.0, 1.0]), axis=-1) <= 12.0] = TABLE[label].value
    unit = np.array(way) / np.linalg.norm(way)
    # between voxels where it is an even number of them wide
    middle = np.array(off, float) + 0.5 * (diameter % 2)
    if diameter == 1:
        ends = [geometry.world_to_index(middle + side * unit)[::-1] for side in (-40.0, 40.0)]
        tube(labels, ends, 1, VEIN)
    else:
        along = (at - middle) @ unit
        across = np.linalg.norm(at - middle - along[..., None] * unit, axis=-1)
        labels[(np.abs(along) <= 40.0) & (across <= 0.5 * diameter + 1e-6)] = VEIN
    assert cc3d.connected_components(labels == VEIN, connectivity=6).max() == 1
    return Segmentation(labels, geometry, TABLE), middle, unit


def outermost(surface, middle, unit):
    """Of the part of a surface that goes furthest along a tube: its two ends along the tube, and its triangles."""
    found = []
    for triangles in parts(surface):
        away = surface.vertices_mm[np.unique(triangles)].astype(float) - middle
        along = away @ unit
        if np.linalg.norm(away - along[:, None] * unit, axis=1).max() < 16.0:
            found.append((along.min(), along.max(), triangles))
    return max(found, key=lambda one: one[1] - one[0])


WAYS = ((0, 0, 1), (1, 2, 3), (1, 1, 0), (1, 1, 1), (3, 1, 0), (0, 1, 3))


@pytest.mark.parametrize("is_coarse", [False, True])
@pytest.mark.parametrize("number", thoroughly(range(len(WAYS)), 0, 1, 2))
def test_the_wall_of_a_thin_vessel_is_in_one_piece_without_a_hole(number, is_coarse):
    for diameter in (1, 2, 3, 4):
        off = (number % 3, diameter % 3, (number + diameter) % 3)
        segmentation, middle, unit = two_chambers_and_a_tube(WAYS[number], diameter, off)
        surface = quick_surface(segmentation, recipe(), is_coarse=is_coarse)
        voxel = max(surface.spacing_mm)
        assert voxel > 2.5
        # the labels are in one piece: so is its outside, without a handle, from end to end; the rest lies within
        low, high, triangles = outermost(surface, middle, unit)
        assert euler(triangles) == 2
        assert low < -38.0
        assert high > 38.0
        away = surface.vertices_mm[np.unique(triangles)] - middle
        across = np.linalg.norm(away - (away @ unit)[:, None] * unit, axis=1)
        # as much thicker as is said: the lumen by a voxel to each side, the wall as far as the surface's points ask for
        wall = TABLE["superior vena cava"].wall_thickness_mm
        lumen = np.median(across) - max(wall, 0.6 * voxel)
        assert 0.5 * diameter - 0.5 < lumen < 0.5 * diameter + 1.05 * voxel


@pytest.mark.parametrize("is_coarse", [False, True])
def test_a_wall_thinner_than_the_points_are_apart_has_no_hole(is_coarse):
    size = 120
    geometry = Geometry.of(shape=(size,) * 3, spacing_mm=(1.0,) * 3, origin_mm=(-0.5 * (size - 1),) * 3)
    k, j, i = np.indices(geometry.shape)
    away = np.linalg.norm(geometry.index_to_world(np.stack([i, j, k], axis=-1)), axis=-1)
    labels = np.where(away <= 40.0, VEIN, 0).astype(np.uint8)
    thin = '\n[[labels]]\nvalue = 7\nname = "superior vena cava"\nrole = "vessel_lumen"\nwall_thickness_mm = 0.6\n'
    surface = quick_surface(Segmentation(labels, geometry, TABLE), recipe(thin), is_coarse=is_coarse)
    assert shells(surface) == [2, 2]
