"""Leaks that were made on purpose, with the place and the area that they must be reported with."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from heartcase.pipeline.checks.leaks import leak_warnings
from heartcase.pipeline.data import Reshaping, Segmentation
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.pipeline.warnings import WarningGrade
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import EndMarker, WallsSettings, WallThickness
from tests.pipeline.lattices import lattice, points_of
from tests.pipeline.walls.test_walls import KINDS, owners
from tests.pipeline.walls.test_walls import grown as grown_by_default

AORTA, ATRIUM, SEPTUM = 1, 2, 3
AXIS = np.array([0.48, 0.6, 0.64])


def grown(labels, geometry, *, settings=None, **more):
    """Walls, and no septa: what the outlines alone join and split is looked at."""
    return grown_by_default(labels, geometry, settings=settings or WallsSettings(septa="as segmented"), **more)


def place_and_area(warning):
    found = re.search(r"over ([\d,.]+) mm².* near \((.+)\) mm", warning.text)
    assert found, warning.text
    place = tuple(float(v) for v in found.group(2).split(","))
    assert warning.places_mm == (place,)
    return np.array(place), float(found.group(1).replace(",", ""))


def two_chambers(kind, *, canal_mm=0.0, muscle=True):
    """Two half balls with 6 mm of muscle between, and a canal through it at (0, 5, 2)."""
    geometry = lattice(kind, 40.0)
    points = points_of(geometry)
    x = points[..., 0]
    ball = np.linalg.norm(points, axis=-1) < 15.0
    labels = np.where(ball, np.where(x < -3.0, AORTA, np.where(x > 3.0, ATRIUM, SEPTUM if muscle else 0)), 0)
    canal = np.linalg.norm(points[..., 1:] - [5.0, 2.0], axis=-1) < canal_mm
    return geometry, np.where(canal & ball & (np.abs(x) <= 3.0), np.where(x < 0.0, AORTA, ATRIUM), labels)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("muscle", [True, False])
def test_compartments_that_stay_apart_are_not_reported(kind, muscle):
    geometry, labels = two_chambers(kind, muscle=muscle)
    assert grown(labels, geometry).warnings == ()


@pytest.mark.parametrize("kind", KINDS)
def test_a_canal_that_the_segmentation_does_not_have_is_reported_where_it_is(kind):
    geometry, apart = two_chambers(kind)
    _, joined = two_chambers(kind, canal_mm=6.0)
    structures = grown(joined, geometry)
    (warning,) = leak_warnings(structures, apart.astype(np.uint8))
    assert warning.text.startswith("the blood of aorta and of left atrium: apart in the segmentation, but joined")
    assert warning.grade is WarningGrade.ANATOMY
    place, area = place_and_area(warning)
    assert np.linalg.norm(place[1:] - [5.0, 2.0]) < 3.0
    assert abs(place[0]) < 3.5
    y, z = np.meshgrid(np.arange(-3.0, 13.0, 0.05), np.arange(-6.0, 10.0, 0.05))
    sections = [
        0.05**2 * np.isin(owners(structures, np.stack([np.full(y.shape, x), y, z], axis=-1)), (1, 2)).sum()
        for x in (-2.0, -1.0, 0.0, 1.0, 2.0)
    ]
    assert 0.85 * min(sections) < area < 1.15 * max(sections)


@pytest.mark.parametrize("kind", KINDS)
def test_a_canal_that_was_closed_is_reported_where_it_was(kind):
    geometry, apart = two_chambers(kind)
    _, joined = two_chambers(kind, canal_mm=6.0)
    (warning,) = leak_warnings(grown(apart, geometry), joined.astype(np.uint8))
    assert warning.text.startswith(
        "the blood of aorta and of left atrium: in one piece in the segmentation, but cut in two"
    )
    place, area = place_and_area(warning)
    assert np.linalg.norm(place[1:] - [5.0, 2.0]) < 3.0
    assert abs(place[0]) < 3.5
    assert area == pytest.approx(np.pi * 6.0**2, rel=0.15)


def test_several_canals_are_told_one_by_one():
    geometry, apart = two_chambers("even")
    x, y, z = np.moveaxis(points_of(geometry), -1, 0)
    joined = apart.copy()
    for at in ((6.0, 2.0), (-7.0, -3.0)):
        canal = (np.hypot(y - at[0], z - at[1]) < 3.0) & (np.abs(x) <= 3.0)
        joined[canal] = AORTA
    (warning,) = leak_warnings(grown(joined, geometry), apart.astype(np.uint8))
    assert "in 2 patches" in warning.text
    for at, place in zip(((6.0, 2.0), (-7.0, -3.0)), sorted(warning.places_mm, key=lambda one: -one[1]), strict=True):
        assert np.linalg.norm(np.array(place[1:]) - at) < 3.0


@settings(deadline=None, max_examples=15)
@given(
    st.lists(st.tuples(st.integers(0, 2), *[st.integers(1, 8)] * 3, *[st.integers(1, 4)] * 3), min_size=1, max_size=7),
    st.sampled_from(KINDS),
    st.sampled_from([None, 0.0]),
)
@example([(1, 1, 1, 1, 4, 4, 4), (1, 5, 5, 1, 4, 4, 4)], "even", None)
@example([(1, 1, 1, 1, 4, 4, 4), (2, 5, 5, 1, 4, 4, 4)], "even", 0.0)
@example([(1, 1, 1, 1, 4, 4, 4), (1, 5, 5, 5, 4, 4, 4)], "even", None)
@example([(1, 1, 1, 1, 4, 4, 4), (1, 5, 2, 2, 1, 1, 1), (1, 6, 1, 1, 4, 4, 4)], "even", None)
@example([(1, 1, 1, 1, 4, 4, 4), (1, 5, 2, 2, 1, 1, 1), (1, 6, 1, 1, 4, 4, 4)], "even", 0.0)
def test_what_the_stage_does_to_any_boxes_it_never_joins_in_silence(boxes, kind, smoothing):
    """The oracle: pieces by flood fill on the same fine lattice, counted without any of the code under test."""
    from scipy.ndimage import label

    from heartcase.pipeline.fields.reader import ownership_on_lattice

    geometry = lattice(kind, 18.0)
    labels = np.zeros(geometry.shape, np.uint8)
    for value, i, j, k, di, dj, dk in boxes:
        labels[k : k + dk, j : j + dj, i : i + di] = value
    if not labels.any():
        return
    structures = grown(labels, geometry, settings=WallsSettings(smoothing_mm=smoothing, septa="as segmented"))
    owner = ownership_on_lattice(structures, geometry.refined(2))
    after, _ = label((owner.tissue_mm > 0.0) & np.isin(owner.void_label, (AORTA, ATRIUM)))
    before, count = label(np.isin(labels, (AORTA, ATRIUM)))
    before = before.repeat(2, 0).repeat(2, 1).repeat(2, 2)
    sizes = np.bincount(before.ravel()) // 8
    large = [n for n in range(1, count + 1) if sizes[n] >= 8]
    held = {n: {m for m in np.unique(after[before == n]) if m and (after[before == n] == m).sum() >= 64} for n in large}
    is_joined = any(held[a] & held[b] for a in large for b in large if a < b)
    is_split = any(len(held[a]) > 1 for a in large)
    text = " ".join(warning.text for warning in structures.warnings)
    assert ("but joined" in text) == is_joined
    assert ("cut in two" in text) == is_split


def tube(kind="oblique", **changes):
    geometry = lattice(kind, 46.0)
    points = points_of(geometry)
    along = points @ AXIS
    labels = np.linalg.norm(points - along[..., None] * AXIS, axis=-1) < 6.0
    return geometry, labels.astype(int)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("thickness", [0.3, 1.0])
def test_ends_and_faces_of_the_volume_are_no_gaps_however_thin_the_wall(kind, thickness):
    geometry, labels = tube(kind)
    end = EndMarker(label="aorta", position_mm=tuple(6.0 * AXIS), axis=tuple(AXIS), radius_mm=10.0)
    assert grown(labels, geometry, ends=(end,), first_mm=thickness).warnings == ()


def curved_patch(radius):
    """Area that a cylinder of a radius cuts out of the tube of radius 6, mm2."""
    u, v = np.meshgrid(*2 * [np.linspace(-radius, radius, 401)])
    return np.where(np.hypot(u, v) < radius, 6.0 / np.sqrt(36.0 - v**2), 0.0).sum() * (2.0 * radius / 400) ** 2


@pytest.mark.parametrize("kind", ["even", "oblique"])
def test_a_hole_in_a_wall_is_reported_with_place_and_area(kind):
    geometry, labels = tube(kind)
    structures = grown(labels, geometry, first_mm=1.5)
    side = np.cross(AXIS, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    at = 3.0 * AXIS + 6.0 * side
    hole = Reshaping(
        "cylinder", (tuple(at - 1.0 * side), tuple(at + 3.0 * side)), 3.0, ("aorta wall",), ("background",)
    )
    (warning,) = leak_warnings(replace(structures, reshapings=(hole,)), labels.astype(np.uint8))
    assert warning.grade is WarningGrade.ANATOMY
    assert warning.text.startswith("aorta: its wall has a gap")
    place, area = place_and_area(warning)
    assert np.linalg.norm(place - at) < 2.0
    half = 0.5 * max(geometry.refined(2).spacing_mm)
    assert curved_patch(3.0 - half) < area < curved_patch(3.0 + half)


def in_muscle(kind, *, hole_mm=0.0, wall_mm=4.0):
    """A ball of the atrium's blood with muscle around it, and a round hole in the muscle along ``AXIS``."""
    geometry = lattice(kind, 40.0)
    points = points_of(geometry)
    along = points @ AXIS
    across = np.linalg.norm(points - along[..., None] * AXIS, axis=-1)
    from_middle = np.linalg.norm(points, axis=-1)
    muscle = (from_middle < 12.0 + wall_mm) & ~((across < hole_mm) & (along > 0.0))
    return geometry, np.where(from_middle < 12.0, ATRIUM, np.where(muscle, SEPTUM, 0))


def cap_mm2(hole_mm):
    """Area of a ball of radius 12 that a coaxial cylinder cuts out, mm2."""
    return 2.0 * np.pi * 12.0 * (12.0 - np.sqrt(144.0 - hole_mm**2))


@pytest.mark.parametrize("kind", KINDS)
def test_a_hole_in_the_muscle_around_a_cavity_without_a_wall_is_reported_with_place_and_area(kind):
    geometry, labels = in_muscle(kind, hole_mm=6.0)
    (warning,) = grown(labels, geometry, second_mm=0.0).warnings
    assert warning.grade is WarningGrade.ANATOMY
    assert warning.text.startswith("left atrium: its blood is open to the outside over ")
    assert "wall_thickness_mm" in warning.text
    assert "'ends'" not in warning.text
    place, area = place_and_area(warning)
    width = max(geometry.spacing_mm)  # the smoothing draws the rim in
    assert np.linalg.norm(place - 12.0 * AXIS) < 2.0
    assert cap_mm2(6.0 - 0.75 * width) < area < cap_mm2(6.0 + 0.5 * width)


@pytest.mark.parametrize("kind", KINDS)
def test_muscle_all_around_or_a_wall_in_the_hole_is_no_gap(kind):
    assert grown(*in_muscle(kind)[::-1], second_mm=0.0).warnings == ()
    assert grown(*in_muscle(kind, hole_mm=6.0)[::-1], second_mm=1.0).warnings == ()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_cavity_without_a_wall_that_the_region_cuts_is_not_open_there(kind, axis):
    geometry, labels = in_muscle(kind)
    start = [0, 0, 0]
    start[axis] = geometry.size[axis] // 2
    size = np.array(geometry.size) - start
    i, j, k = start
    part = labels[k:, j:, i:]
    assert (part == ATRIUM).take(0, 2 - axis).any()
    assert grown(part, geometry.cropped((i, j, k), tuple(int(n) for n in size)), second_mm=0.0).warnings == ()


@pytest.mark.parametrize("kind", KINDS)
def test_a_vessel_in_muscle_that_an_end_marker_cuts_is_not_open_there(kind):
    geometry, labels = tube(kind)
    points = points_of(geometry)
    along = points @ AXIS
    across = np.linalg.norm(points - along[..., None] * AXIS, axis=-1)
    labels = np.where(across < 6.0, AORTA, np.where(across < 10.0, SEPTUM, 0))
    end = EndMarker(label="aorta", position_mm=tuple(6.0 * AXIS), axis=tuple(AXIS), radius_mm=8.0)
    cut = np.where((along > 6.0) & (across < 10.0), 0, labels)
    assert grown(labels, geometry, ends=(end,), first_mm=0.0).warnings == ()
    assert grown(cut, geometry, ends=(end,), first_mm=0.0).warnings == ()


def test_a_vessel_of_blood_only_is_told_in_one_line_with_its_area():
    geometry, labels = tube("even")
    along = points_of(geometry) @ AXIS
    (warning,) = grown(np.where(np.abs(along) < 12.0, labels, 0), geometry, first_mm=0.0).warnings
    assert warning.text.startswith("aorta: its blood is open to the outside")
    assert "'ends'" in warning.text
    _, area = place_and_area(warning)
    assert area == pytest.approx(2.0 * np.pi * 6.0 * 24.0 + 2.0 * np.pi * 36.0, rel=0.1)


def test_a_segmented_wall_with_a_hole_is_told_as_a_wall():
    geometry, labels = in_muscle("even", hole_mm=6.0)
    table = LabelTable(
        labels=(
            Label(value=ATRIUM, name="left atrium", role=Role.BLOOD),
            Label(value=SEPTUM, name="left atrium wall", role=Role.MYOCARDIUM, wall_of=ATRIUM),
        )
    )
    (warning,) = grow_walls(Segmentation(labels.astype(np.uint8), geometry, table), WallsSettings(), ()).warnings
    assert warning.text.startswith("left atrium: its wall has a gap over ")


def test_where_the_table_says_zero_the_opening_is_noted():
    geometry, labels = tube()
    points = [tuple(s * AXIS) for s in (-12.0, 4.0, 4.5, 12.0)]
    one = WallThickness(label="aorta", kind="centreline", points_mm=points, thickness_mm=[2.0, 2.0, 0.0, 0.0])
    (warning,) = grown(labels, geometry, settings=WallsSettings(thickness=(one,))).warnings
    assert warning.grade is WarningGrade.NOTE
    assert warning.text.startswith("aorta: open to the outside")
    _, area = place_and_area(warning)
    inside = np.abs(geometry.world_to_index((np.linspace(4.4, 40.0, 2000)[:, None]) * AXIS) / geometry.size - 0.5) < 0.5
    length = inside.all(axis=1).sum() * (35.6 / 2000)
    assert area == pytest.approx(2.0 * np.pi * 6.0 * length, rel=0.15)


def test_the_segmentation_without_blood_has_no_leaks():
    geometry = lattice("even", 16.0)
    labels = np.where(np.linalg.norm(points_of(geometry), axis=-1) < 5.0, SEPTUM, 0)
    assert grown(labels, geometry).warnings == ()
