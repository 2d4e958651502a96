"""Ends that are found, against vessels whose course is known, and the phantoms' own ends."""

import numpy as np
import pytest

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.vessel_ends.cut_ends import cut_ends
from heartcase.pipeline.vessel_ends.discs import Stumps, end_marker
from heartcase.pipeline.vessel_ends.find_ends import find_ends
from heartcase.pipeline.vessel_ends.lumen_sections import angle_between
from heartcase.pipeline.walls.grow_walls import grow_walls, resolve_walls
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.heart_form import HeartForm
from heartcase.schemas.recipe.settings import WallsSettings
from tests.pipeline.lattices import LATTICES, lattice
from tests.pipeline.vessel_shapes import STUMPS, TABLE, WALL_MM, arc, ball, line, segmented, tube

KINDS = sorted(LATTICES)
AXIS = np.array([0.48, 0.6, 0.64])
SIDE = np.cross(AXIS, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(AXIS, [1.0, 0.0, 0.0]))
CHAMBER = -20.0 * AXIS


def found_in(segmentation, **more):
    return find_ends(segmentation, TABLE.with_walls(), STUMPS, **more)


def check_end(end, tip, axis, radius_mm, geometry, *, degrees=8.0):
    """Position within a voxel or so of the middle of the lumen, just before its tip; axis; lumen and disc."""
    voxel = max(geometry.spacing_mm)
    offset = np.array(end.position_mm) - tip
    along = offset @ axis
    assert -0.5 * radius_mm - 1.5 * voxel <= along <= 0.5 * voxel
    assert np.linalg.norm(offset - along * axis) < 0.5 * voxel + 0.1 * radius_mm
    assert angle_between(np.array(end.axis), axis) < degrees
    assert end.lumen_radius_mm == pytest.approx(radius_mm, rel=0.15)
    assert radius_mm + WALL_MM - 0.3 < end.radius_mm < radius_mm + WALL_MM + 2.0 * voxel + 1.5


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("is_round", [False, True])
def test_a_straight_vessel_is_cut_at_its_tip(kind, is_round):
    geometry = lattice(kind, 76.0)
    vessel = tube(geometry, line(tuple(CHAMBER), tuple(18.0 * AXIS)), 6.0, is_round=is_round)
    found = found_in(segmented(geometry, (1, ball(geometry, CHAMBER, 13.0)), (2, vessel)))
    (end,) = found.ends
    assert found.dropped == ()
    assert end.label == "superior vena cava"
    assert not end.is_open
    tip = (18.0 + (6.0 if is_round else 0.0)) * AXIS
    # of a round tip the cut takes what is narrower
    check_end(end, tip - (3.0 if is_round else 0.0) * AXIS, AXIS, 6.0, geometry)


@pytest.mark.parametrize("kind", KINDS)
def test_a_vessel_that_bends_is_cut_across_its_own_way(kind):
    geometry = lattice(kind, 84.0)
    course = arc(26.0, 80.0, SIDE, AXIS) - 14.0 * AXIS - 8.0 * SIDE
    start = course[0] - 8.0 * AXIS
    vessel = tube(geometry, np.concatenate([line(tuple(start), tuple(course[0])), course]), 5.0)
    found = found_in(segmented(geometry, (1, ball(geometry, start - 8.0 * AXIS, 13.0)), (2, vessel)))
    (end,) = found.ends
    out = course[-1] - course[-2]
    check_end(end, course[-1], out / np.linalg.norm(out), 5.0, geometry, degrees=18.0)


@pytest.mark.parametrize("kind", ["even", "oblique"])
def test_both_branches_of_a_fork_are_cut_and_nothing_else(kind):
    geometry = lattice(kind, 84.0)
    fork, ends = np.zeros(3), [np.array((-20.0, 3.0, 22.0)), np.array((21.0, -4.0, 18.0))]
    vessel = tube(geometry, line((0.0, 0.0, -24.0), tuple(fork)), 7.0)
    vessel |= np.logical_or.reduce([tube(geometry, line(tuple(fork), tuple(end)), 5.0) for end in ends])
    segmentation = segmented(geometry, (4, ball(geometry, (0.0, 0.0, -26.0), 12.0)), (5, vessel))
    found = found_in(segmentation)
    assert len(found.ends) == 2
    for end in found.ends:
        tip = min(ends, key=lambda one: np.linalg.norm(one - np.array(end.position_mm)))
        check_end(end, tip, tip / np.linalg.norm(tip), 5.0, geometry)
    # an end that there is already is not told again
    (other,) = found_in(segmentation, known=(end_marker(found.ends[0]),)).ends
    assert other == found.ends[1]


def test_a_vessel_that_leaves_through_a_face_is_open_there():
    geometry = lattice("oblique", 60.0)
    face = geometry.direction_matrix[:, 0]
    far = 60.0 * face
    vessel = tube(geometry, line(tuple(-10.0 * face), tuple(far)), 6.0)
    segmentation = segmented(geometry, (1, ball(geometry, -14.0 * face, 10.0)), (2, vessel))
    (end,) = found_in(segmentation).ends
    assert end.is_open
    np.testing.assert_allclose(end.axis, face, atol=1e-3)
    last = geometry.index_to_world((geometry.size[0] - 0.5, 0.0, 0.0)) @ face
    assert np.array(end.position_mm) @ face == pytest.approx(last, abs=0.1)
    assert end.lumen_radius_mm == pytest.approx(6.0, rel=0.05)
    assert found_in(segmentation).markers == ()
    assert found_in(segmentation).dropped == ()


def test_a_vessel_that_goes_on_under_another_label_has_no_end_there():
    geometry = lattice("even", 76.0)
    course = line(tuple(CHAMBER), tuple(18.0 * AXIS))
    near = tube(geometry, course[: len(course) // 2], 6.0)
    whole = tube(geometry, course, 6.0)
    segmentation = segmented(geometry, (1, ball(geometry, CHAMBER, 13.0)), (2, near), (5, whole))
    assert [end.label for end in found_in(segmentation).ends] == ["aorta"]


def test_veins_that_are_a_part_of_an_atrium_are_cut_and_an_appendage_is_not():
    geometry = lattice("even", 110.0)
    valve = np.array((0.0, -1.0, 0.0))
    atrium = ball(geometry, (0.0, 0.0, 0.0), 17.0)
    ends = [np.array((-30.0, 12.0, 9.0)), np.array((30.0, 13.0, 6.0)), np.array((-28.0, 14.0, -12.0))]
    veins = np.logical_or.reduce([tube(geometry, line((0.0, 0.0, 0.0), tuple(end)), 5.0) for end in ends])
    # it bends round from the side to the ventricle, as long and as narrow as a vein
    auricle = tube(geometry, line((0.0, 0.0, 0.0), (20.0, -12.0, 14.0), (20.0, -26.0, 12.0)), 5.5, is_round=True)
    ventricle = ball(geometry, 34.0 * valve, 21.0)
    segmentation = segmented(geometry, (3, atrium | veins | auricle), (4, ventricle))
    found = found_in(segmentation)
    assert {end.label for end in found.ends} == {"left atrium"}
    assert len(found.ends) == 3
    for end in found.ends:
        tip = min(ends, key=lambda one: np.linalg.norm(one - np.array(end.position_mm)))
        check_end(end, tip, tip / np.linalg.norm(tip), 5.0, geometry, degrees=10.0)


def test_a_lower_vein_behind_the_ventricle_is_no_appendage():
    """It lies towards the valve and near the ventricle, as the appendage does, but not by an artery."""
    geometry = lattice("even", 110.0)
    atrium, ventricle = ball(geometry, (0.0, 0.0, 0.0), 17.0), ball(geometry, (0.0, -34.0, 0.0), 21.0)
    ends = [np.array((30.0, 13.0, 6.0)), np.array((-29.0, -10.0, -6.0))]
    veins = np.logical_or.reduce([tube(geometry, line((0.0, 0.0, 0.0), tuple(end)), 5.0) for end in ends])
    auricle = tube(geometry, line((0.0, 0.0, 0.0), (20.0, -12.0, 14.0), (20.0, -26.0, 12.0)), 5.5, is_round=True)
    aorta = tube(geometry, line((8.0, -26.0, 18.0), (8.0, -26.0, 50.0)), 6.0)
    segmentation = segmented(geometry, (3, atrium | veins | auricle), (4, ventricle), (5, aorta))
    found = found_in(segmentation, only=(3,)).ends
    assert len(found) == 2
    for end in found:
        tip = min(ends, key=lambda one: np.linalg.norm(one - np.array(end.position_mm)))
        check_end(end, tip, tip / np.linalg.norm(tip), 5.0, geometry, degrees=12.0)


def test_a_vein_is_judged_by_where_it_leads_and_not_by_its_twigs():
    """It splits into two that are too narrow, one of which runs back to the front of the ventricle."""
    geometry = lattice("even", 110.0)
    atrium, ventricle = ball(geometry, (0.0, 0.0, 0.0), 17.0), ball(geometry, (0.0, -34.0, 0.0), 21.0)
    tip = np.array((32.0, 11.0, 6.0))
    vein = tube(geometry, line((0.0, 0.0, 0.0), tuple(tip)), 5.0)
    back = tube(geometry, line(tuple(tip), (40.0, 4.0, 6.0), (40.0, -12.0, 6.0), (26.0, -26.0, 6.0)), 1.6)
    out = tube(geometry, line(tuple(tip), (40.0, 24.0, 8.0)), 1.6)
    (end,) = found_in(segmented(geometry, (3, atrium | vein | back | out), (4, ventricle))).ends
    check_end(end, tip, tip / np.linalg.norm(tip), 5.0, geometry, degrees=12.0)


def test_a_dilated_atrium_has_veins_of_a_usual_width():
    geometry = lattice("even", 110.0)
    atrium, ventricle = ball(geometry, (0.0, 0.0, 0.0), 24.0), ball(geometry, (0.0, -40.0, 0.0), 21.0)
    tip = np.array((36.0, 16.0, 9.0))
    vein = tube(geometry, line((0.0, 0.0, 0.0), tuple(tip)), 4.2)
    (end,) = found_in(segmented(geometry, (3, atrium | vein), (4, ventricle))).ends
    check_end(end, tip, tip / np.linalg.norm(tip), 4.2, geometry, degrees=10.0)


def test_where_there_is_no_vessel_or_no_wall_there_is_no_end():
    geometry = lattice("even", 60.0)
    atrium, ventricle = ball(geometry, (0.0, 0.0, 0.0), 13.0), ball(geometry, (0.0, 0.0, -22.0), 14.0)
    assert found_in(segmented(geometry, (3, atrium), (4, ventricle))).ends == ()
    bulge = ball(geometry, (9.0, 9.0, 3.0), 8.0)
    assert found_in(segmented(geometry, (3, atrium | bulge), (4, ventricle))).ends == ()
    vessel = tube(geometry, line((0.0, 0.0, 0.0), (0.0, 0.0, 24.0)), 5.0)
    segmentation = segmented(geometry, (1, atrium), (2, vessel))
    assert len(found_in(segmentation).ends) == 1
    bare = LabelTable(labels=tuple(label.model_copy(update={"wall_thickness_mm": 0.0}) for label in TABLE))
    assert find_ends(segmentation, bare, STUMPS).ends == ()
    assert found_in(segmentation, only=(5,)).ends == ()


def test_where_no_disc_would_cut_a_branch_alone_that_is_told():
    """A short arm 2 mm beside a long one: what its disc takes away would open the other."""
    geometry = lattice("even", 84.0)
    arms = [line((x, 0.0, -6.0), (x, 0.0, top)) for x, top in ((-5.0, 14.0), (5.0, 36.0))]
    bridge = tube(geometry, line((-5.0, 0.0, -6.0), (5.0, 0.0, -6.0)), 4.0, is_round=True)
    vessel = np.logical_or.reduce([bridge, *(tube(geometry, arm, 4.0) for arm in arms)])
    segmentation = segmented(geometry, (4, ball(geometry, (0.0, 0.0, -22.0), 14.0)), (5, vessel))
    found = found_in(segmentation)
    (end,) = found.ends
    check_end(end, np.array((5.0, 0.0, 36.0)), np.array((0.0, 0.0, 1.0)), 4.0, geometry)
    (words,) = found.dropped
    assert words.startswith("the aorta ends near (-5.")
    assert "would cut other parts of the same label" in words


def test_the_same_labels_give_the_same_ends_in_another_orientation_of_the_lattice():
    """An exact quarter turn and mirror image: nothing may hang on which array axis is which."""
    geometry = lattice("even", 76.0)
    vessel = tube(geometry, line(tuple(CHAMBER), tuple(18.0 * AXIS)), 6.0)
    segmentation = segmented(geometry, (1, ball(geometry, CHAMBER, 13.0)), (2, vessel))
    flipped = Segmentation(np.ascontiguousarray(segmentation.labels[:, :, ::-1]), geometry.flipped(0), TABLE)
    (one,), (other,) = found_in(segmentation).ends, found_in(flipped).ends
    np.testing.assert_allclose(one.position_mm, other.position_mm, atol=0.6)
    assert angle_between(np.array(one.axis), np.array(other.axis)) < 3.0


# ---- The phantoms: twelve ends, which their truth knows

FORMS = {
    "adult": (HeartForm(size="adult"), 1.75, False),
    "child": (HeartForm(size="child"), (0.7, 0.7, 1.5), False),
    "newborn": (HeartForm(body_surface_m2=0.23), 0.9, True),
}
SHORT_BRANCHES = (2, 3)
"""Arteries of the arch that stand out by less than they are wide, on such voxels: found where that is enough."""


def true_labels(form, spacing_mm, oblique):
    phantom = HeartPhantom.of_form(form)
    geometry = phantom.scan_geometry(spacing_mm, oblique=oblique)
    k, j, i = np.meshgrid(*(np.arange(n) for n in geometry.shape), indexing="ij")
    labels = phantom.truth.label(geometry.index_to_world(np.stack([i, j, k], axis=-1)))
    for label in phantom.truth.table:
        if label.wall_of is not None:
            labels[labels == label.value] = 0
    return phantom, Segmentation(labels, geometry, phantom.table)


@pytest.mark.parametrize("name", ["adult", "child", pytest.param("newborn", marks=pytest.mark.slow)])
def test_the_ends_of_a_phantom(name):
    form, spacing_mm, oblique = FORMS[name]
    phantom, segmentation = true_labels(form, spacing_mm, oblique)
    geometry = segmentation.geometry
    table, settings = phantom.table.with_walls(), resolve_walls(WallsSettings(), geometry, phantom.table)
    stumps = Stumps.of(settings, table, geometry.spacing_mm)
    found = find_ends(segmentation, table, stumps)
    voxel, seen = max(geometry.spacing_mm), set()
    for end in found.ends:
        assert not end.is_open
        distance = [np.linalg.norm(np.subtract(end.position_mm, true.position_mm)) for true in phantom.ends]
        number = int(np.argmin(distance))
        true = phantom.ends[number]
        assert number not in seen
        seen.add(number)
        assert table[true.label].name == end.label
        axis = np.array(true.axis) / np.linalg.norm(true.axis)
        offset = np.array(end.position_mm) - np.array(true.position_mm)
        along = offset @ axis
        # as far before the tip as for tubes: half a radius, and what the voxels leave open
        assert -0.5 * end.lumen_radius_mm - 1.5 * voxel <= along <= 0.5 * voxel
        assert np.linalg.norm(offset - along * axis) < 0.75 * voxel
        # the narrower the vessel, the fewer voxels there are to tell its way from
        assert angle_between(np.array(end.axis), axis) < 4.0 + 25.0 * voxel / end.lumen_radius_mm
        lumen_mm = true.radius_mm - (4.0 * phantom.scale + 1.0)
        assert end.lumen_radius_mm == pytest.approx(lumen_mm, abs=0.7 * voxel)
    assert set(range(len(phantom.ends))) - seen <= set(SHORT_BRANCHES)
    cut = cut_ends(segmentation, table, (), stumps, find=True)
    assert cut.vessel_ends == found.ends
    assert len(cut.reshapings) == len(found.markers)


def test_walls_with_ends_that_are_found_are_those_with_the_same_ends_stated():
    geometry = lattice("even", 76.0)
    vessel = tube(geometry, line(tuple(CHAMBER), tuple(18.0 * AXIS)), 6.0)
    segmentation = segmented(geometry, (1, ball(geometry, CHAMBER, 13.0)), (2, vessel))
    found = grow_walls(segmentation, WallsSettings(find_ends=True), ())
    (end,) = found.vessel_ends
    assert end.found == "found"
    stated = grow_walls(segmentation, WallsSettings(), (end_marker(end),))
    assert [one.found for one in stated.vessel_ends] == ["stated"]
    assert found.reshapings == stated.reshapings
    assert found.fixed_planes == stated.fixed_planes
    for value, field in found.distance_mm.items():
        np.testing.assert_array_equal(field, stated.distance_mm[value])
    # beside those that are stated, none is sought where they cut
    both = grow_walls(segmentation, WallsSettings(find_ends=True), (end_marker(end),))
    assert [one.found for one in both.vessel_ends] == ["stated"]
