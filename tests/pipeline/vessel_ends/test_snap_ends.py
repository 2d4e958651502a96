"""End markers a little off their vessel are moved onto it; others are refused with numbers that would do."""

import re

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from heartcase.pipeline.vessel_ends.cut_ends import cut_ends
from heartcase.pipeline.vessel_ends.discs import disc_of, meets, sides_of
from heartcase.pipeline.vessel_ends.lumen_sections import angle_between
from heartcase.schemas.errors import StageError
from heartcase.schemas.recipe.settings import EndMarker
from tests.pipeline.lattices import lattice
from tests.pipeline.vessel_shapes import STUMPS, TABLE, ball, line, segmented, tube

AXIS = np.array([0.48, 0.6, 0.64])
CHAMBER = -20.0 * AXIS
RADIUS = 6.0
GEOMETRY = lattice("oblique", 80.0)
STRAIGHT = segmented(
    GEOMETRY,
    (1, ball(GEOMETRY, CHAMBER, 13.0)),
    (2, tube(GEOMETRY, line(tuple(CHAMBER), tuple(20.0 * AXIS)), RADIUS)),
)
VEINS = (np.array((-30.0, 12.0, 9.0)), np.array((30.0, 13.0, 6.0)), np.array((-26.0, 20.0, -14.0)))
WIDE = lattice("even", 110.0)
ATRIUM = segmented(
    WIDE,
    (
        3,
        np.logical_or.reduce(
            [
                ball(WIDE, (0.0, 0.0, 0.0), 17.0),
                *(tube(WIDE, line((0.0, 0.0, 0.0), tuple(vein)), 5.0) for vein in VEINS),
            ]
        ),
    ),
    (4, ball(WIDE, (0.0, -34.0, 0.0), 21.0)),
)


def marker(label, position, axis, radius_mm):
    return EndMarker(
        label=label, position_mm=tuple(map(float, position)), axis=tuple(map(float, axis)), radius_mm=radius_mm
    )


def cut(segmentation, *ends):
    return cut_ends(segmentation, TABLE.with_walls(), ends, STUMPS)


def does_cut(segmentation, end):
    label = TABLE[end.label]
    disc = disc_of(segmentation, end, label.value, STUMPS.wall_mm(label), STUMPS.clearance_mm)
    return disc is not None and sides_of(segmentation.labels, disc).is_divided and meets(segmentation.labels, disc)


def tilted(axis, degrees, turn):
    side = np.cross(axis, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    way = np.cos(turn) * side + np.sin(turn) * np.cross(axis, side)
    return np.cos(np.radians(degrees)) * axis + np.sin(np.radians(degrees)) * way


perturbed = given(
    along=st.floats(-1.0, 1.0),
    off=st.floats(0.0, 1.0),
    off_turn=st.floats(0.0, 6.28),
    degrees=st.floats(0.0, 30.0),
    turn=st.floats(0.0, 6.28),
    wide=st.sampled_from([0.6, 0.9, 1.0, 1.3]),
    number=st.integers(0, len(VEINS) - 1),
)


@settings(max_examples=25, deadline=None)
@example(along=0.0, off=1.0, off_turn=0.0, degrees=7.0, turn=5.0, wide=0.6, number=0)
@perturbed
def test_a_marker_off_by_half_its_radius_and_30_degrees_cuts_its_vessel(
    along, off, off_turn, degrees, turn, wide, number
):
    del number
    radius = 10.0
    side = tilted(AXIS, 90.0, off_turn)
    shift = 0.5 * radius * np.array((along, off)) / max(1.0, np.hypot(along, off))
    end = marker(
        "superior vena cava", 6.0 * AXIS + shift[0] * AXIS + shift[1] * side, tilted(AXIS, degrees, turn), wide * radius
    )
    found = cut(STRAIGHT, end)
    (used,) = found.ends
    assert does_cut(STRAIGHT, used)
    if used == end:
        assert found.warnings == ()
        assert found.vessel_ends[0].found == "stated"
        return
    # it was moved no farther than its radius, lies across the tube, and says so with the numbers
    assert found.vessel_ends[0].found == "moved"
    assert np.linalg.norm(np.subtract(used.position_mm, end.position_mm)) <= end.radius_mm + 0.1
    assert angle_between(np.array(used.axis), AXIS) < 10.0
    offset = np.array(used.position_mm)
    assert np.linalg.norm(offset - (offset @ AXIS) * AXIS) < 1.2
    (words,) = found.warnings
    assert words.text.startswith(
        "ends[1] (superior vena cava): the disc did not cut the vessel through, so it was moved by"
    )
    assert [float(x) for x in re.findall(r"-?\d+\.?\d*", words.text.partition("position_mm")[2])] == [
        *used.position_mm,
        *used.axis,
        used.radius_mm,
    ]


@settings(max_examples=12, deadline=None)
@perturbed
def test_so_does_one_on_a_vein_of_an_atrium_and_cuts_no_other(along, off, off_turn, degrees, turn, wide, number):
    vein = VEINS[number]
    axis, radius = vein / np.linalg.norm(vein), 9.0
    shift = 0.5 * radius * np.array((along, off)) / max(1.0, np.hypot(along, off))
    middle = 27.0 * axis + shift[0] * axis + shift[1] * tilted(axis, 90.0, off_turn)
    found = cut(ATRIUM, marker("left atrium", middle, tilted(axis, degrees, turn), wide * radius))
    (used,) = found.ends
    assert does_cut(ATRIUM, used)
    offset = np.array(used.position_mm)
    if found.vessel_ends[0].found == "moved":
        assert np.linalg.norm(offset - (offset @ axis) * axis) < 1.2
        assert angle_between(np.array(used.axis), axis) < 12.0
    # the other veins keep their tips
    for other in VEINS:
        index = np.rint(WIDE.world_to_index(0.94 * other)).astype(int)
        is_kept = found.labels[tuple(index[::-1])] == 3
        assert is_kept == (other is not vein) or other is vein


def test_a_marker_that_may_mean_either_of_two_is_not_moved():
    two = segmented(
        GEOMETRY,
        (1, ball(GEOMETRY, (0.0, 0.0, -22.0), 16.0)),
        (
            2,
            tube(GEOMETRY, line((-8.0, 0.0, -20.0), (-8.0, 0.0, 14.0)), 4.0)
            | tube(GEOMETRY, line((8.0, 0.0, -20.0), (8.0, 0.0, 14.0)), 4.0),
        ),
    )
    up = (0.0, 0.0, 1.0)
    with pytest.raises(StageError) as caught:
        cut(two, marker("superior vena cava", (0.0, 0.0, 3.0), up, 6.0))
    assert "this end of it" in str(caught.value)
    # nearer to one of them it is clear
    (used,) = cut(two, marker("superior vena cava", (-5.5, 0.0, 3.0), up, 5.0)).ends
    assert used.position_mm[0] == pytest.approx(-8.0, abs=0.6)


def test_refused_ends_are_all_told_with_the_nearest_lumen_and_numbers_that_do():
    axis = tuple(AXIS)
    away = 20.0 * AXIS + 25.0 * tilted(AXIS, 90.0, 0.0)
    outside = 200.0 * AXIS
    with pytest.raises(StageError) as caught:
        cut(
            STRAIGHT,
            marker("superior vena cava", 6.0 * AXIS, (-AXIS[1], AXIS[0], 0.0), 3.0),
            marker("aorta", (0.0, 0.0, 0.0), axis, 10.0),
            marker("superior vena cava", outside, axis, 10.0),
        )
    places = [problem.place for problem in caught.value.problems]
    assert places == ["ends[1]", "ends[2]", "ends[3]"]
    first, second, third = (problem.message for problem in caught.value.problems)
    assert "does not cut through 'superior vena cava'" in first
    assert "no 'aorta' in the segmentation" in second
    assert "outside the volume" in third
    assert "no end of it was found within 60 mm" in third
    numbers = [float(x) for x in re.findall(r"-?\d+\.?\d*", first.partition("position_mm = ")[2])]
    proposed = marker("superior vena cava", numbers[:3], numbers[3:6], numbers[6])
    assert does_cut(STRAIGHT, proposed)
    assert cut(STRAIGHT, proposed).warnings == ()
    # off to the side by more than its radius: it stays closed, with the same numbers
    (warning,) = cut(STRAIGHT, marker("superior vena cava", away, axis, 8.0)).warnings
    assert "stays closed" in warning.text
    near = float(re.search(r"nearest lumen is ([\d.]+) mm", warning.text)[1])
    assert near == pytest.approx(25.0 - RADIUS, abs=1.5)
    assert warning.text.partition("position_mm = ")[2] == first.partition("position_mm = ")[2]


def test_a_marker_that_points_into_the_heart_is_not_moved_and_one_that_cuts_the_heart_off_is_told():
    far = marker("superior vena cava", 26.0 * AXIS, tuple(-AXIS), 8.0)
    (warning,) = cut(STRAIGHT, far).warnings
    assert "turn its axis round" in warning.text
    found = cut(STRAIGHT, marker("superior vena cava", 15.0 * AXIS, tuple(-AXIS), 10.0))
    assert any("turn its axis out of the heart" in line.text for line in found.warnings)
