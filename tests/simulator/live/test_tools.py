"""What the mouse does with each tool, as commands: against the places where rays must meet an analytic surface."""

from __future__ import annotations

from itertools import count

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.recording.commands import LeadGrab, MoveProbe
from heartcase.simulator.live.drawing_tools import HINGE_MM, CutTool, PatchTool, RowTool, ScissorsTool, StitchTool
from heartcase.simulator.live.goals import HAND_SPEED_MM_S, Goals
from heartcase.simulator.live.holding_tools import ForcepsTool, GrabTool, ProbeTool, RetractorTool
from heartcase.simulator.live.rays import Eye, Hit, Pointer
from heartcase.simulator.live.tool import Held
from heartcase.simulator.live.tools import TOOLS

SIZE = (400, 300)
EYE = Eye(np.array([10.0, -200.0, 30.0]), np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.1, 1.0]), 30.0)
RADIUS = 40.0
"""Of the ball about the origin that is operated on."""


def pointer(x, y, eye=EYE):
    """Where the mouse points, with the ball met where the quadratic equation says."""
    ray = eye.ray(x, y, SIZE)
    along = -ray.start_mm @ ray.direction
    square = RADIUS**2 - (ray.start_mm @ ray.start_mm - along**2)
    hit = None
    if square > 0.0:
        distance = along - np.sqrt(square)
        point = ray.at(distance)
        hit = Hit(point, 0, point / RADIUS, distance)
    return Pointer(ray, hit, eye.axes)


def names():
    numbers = count(1)
    return lambda kind: f"{kind} {next(numbers)}"


def seen_at(place, eye=EYE):
    """Pixel at which a place is seen: the pinhole camera, written down."""
    right, up, towards = eye.axes
    arm = np.asarray(place) - eye.position_mm
    depth = -arm @ towards
    scale = SIZE[1] / 2.0 / np.tan(np.radians(eye.view_angle_deg) / 2.0)
    return SIZE[0] / 2.0 + scale * (arm @ right) / depth, SIZE[1] / 2.0 + scale * (arm @ up) / depth


places = st.tuples(st.floats(150.0, 250.0), st.floats(100.0, 200.0))


@settings(max_examples=60, deadline=None)
@given(start=places, end=places, notches=st.integers(-5, 5))
def test_a_hand_stays_under_the_mouse_and_goes_deeper_by_the_wheel(start, end, notches):
    tool = GrabTool(names())
    (closed,) = tool.press(pointer(*start))
    assert np.linalg.norm(closed.center_mm) == pytest.approx(RADIUS)
    assert seen_at(closed.center_mm) == pytest.approx(start, abs=1e-6)
    (led,) = tool.drag(pointer(*end))
    place = np.add(closed.center_mm, led.offset_mm)
    assert seen_at(place) == pytest.approx(end, abs=1e-6)
    assert np.asarray(led.offset_mm) @ EYE.axes[2] == pytest.approx(0.0, abs=1e-9)
    (deeper,) = tool.wheel(notches)
    assert np.subtract(deeper.offset_mm, led.offset_mm) == pytest.approx(-notches * EYE.axes[2], abs=1e-9)
    (opened,) = tool.release(pointer(*end))
    assert {closed.name, led.name, deeper.name, opened.name} == {"hand 1"}
    assert tool.drag(pointer(*start)) == []
    assert tool.wheel(1) is None


def test_a_probe_touches_where_it_is_brought_in_and_is_pushed_by_the_wheel():
    tool = ProbeTool(names())
    (brought,) = tool.press(pointer(210.0, 160.0))
    assert np.linalg.norm(brought.center_mm) == pytest.approx(RADIUS + tool.size)
    (pushed,) = tool.wheel(3)
    assert np.subtract(pushed.center_mm, brought.center_mm) == pytest.approx(-3.0 * EYE.axes[2])
    (moved,) = tool.drag(pointer(230.0, 160.0))
    assert (np.subtract(moved.center_mm, pushed.center_mm) @ EYE.axes[0]) > 0.0
    (gone,) = tool.release(pointer(230.0, 160.0))
    assert gone.kind == "withdraw_probe"
    assert gone.name == brought.name


def test_nothing_is_done_beside_the_heart():
    off = pointer(2.0, 2.0)
    assert off.hit is None
    for kind in TOOLS:
        tool = kind(names())
        assert [*tool.press(off), *tool.drag(off), *tool.release(off)] == []
        assert not tool.is_waiting


def test_a_blade_goes_along_the_drawn_line_to_its_depth_and_against_the_normals():
    tool = CutTool(names())
    ways = [(180.0 + 2.0 * n, 150.0) for n in range(21)]
    assert tool.press(pointer(*ways[0])) == []
    for way in ways[1:]:
        assert tool.drag(pointer(*way)) == []
    drawn = tool.line_mm
    assert np.linalg.norm(drawn, axis=1) == pytest.approx(RADIUS)
    assert np.linalg.norm(np.diff(drawn, axis=0), axis=1).min() >= 1.5
    (cut,) = tool.release(pointer(*ways[-1]))
    above, below = np.array(cut.poses_mm)
    into = (below - above) / np.linalg.norm(below - above, axis=1, keepdims=True)
    # In the middle of the line the direction is that of the ball's centre.
    middle = drawn.mean(axis=0)
    assert into == pytest.approx(np.tile(-middle / np.linalg.norm(middle), (len(drawn), 1)), abs=1e-3)
    assert np.linalg.norm(below - drawn, axis=1) == pytest.approx(tool.size)
    assert len(tool.line_mm) == 0
    assert tool.press(pointer(*ways[0])) + tool.release(pointer(*ways[0])) == []  # a click is no line


def test_scissors_close_as_far_as_the_mouse_goes():
    tool = ScissorsTool(names())
    start = pointer(190.0, 150.0)
    assert tool.press(start) == []
    assert tool.drag(pointer(190.5, 150.0)) == []  # not far enough to know where they point
    made = [command for n in range(60) for command in tool.drag(pointer(191.0 + n, 150.0))]
    brought, snips = made[0], made[1:]
    point, normal, along = start.hit.point_mm, start.hit.normal, np.array(brought.direction)
    # The hinge lies behind the place that was pressed on, and one jaw outside the surface, one inside.
    assert np.array(brought.hinge_mm) == pytest.approx(point - HINGE_MM * along)
    assert along @ normal == pytest.approx(0.0, abs=1e-9)
    assert along @ EYE.axes[0] > 0.8
    assert brought.closing == pytest.approx(normal)
    # Edges meet in proportion to how far the jaws have closed: as far as the mouse went along them.
    assert [one.kind for one in snips] == ["snip"] * len(snips)
    met = brought.length_mm * (1.0 - np.array([one.angle_deg for one in snips]) / brought.opening_deg)
    assert (np.diff(met) > 0).all()
    assert met[-1] == pytest.approx(brought.length_mm)
    assert snips[-1].angle_deg == pytest.approx(0.0)
    assert tool.line_mm == pytest.approx(np.stack([brought.hinge_mm, np.add(brought.hinge_mm, met[-1] * along)]))
    assert tool.drag(pointer(260.0, 150.0)) == []
    (gone,) = tool.release(pointer(260.0, 150.0))
    assert (gone.kind, gone.name) == ("withdraw_scissors", brought.name)
    assert tool.press(start) + tool.release(start) == []  # a click is no snip
    # In the middle of their way the edges meet under the mouse.
    tool.press(start)
    *_, snip = tool.drag(pointer(200.0, 150.0))
    met = brought.length_mm * (1.0 - snip.angle_deg / brought.opening_deg)
    assert seen_at(np.add(brought.hinge_mm, met * along))[0] == pytest.approx(200.0, abs=0.5)


def test_a_line_does_not_leap_over_an_edge_to_what_lies_behind():
    tool = CutTool(names())
    tool.press(pointer(200.0, 150.0))
    near = pointer(210.0, 150.0)
    far = Hit(near.ray.at(near.hit.distance_mm + 60.0), 0, near.hit.normal, near.hit.distance_mm + 60.0)
    tool.drag(Pointer(near.ray, far, near.axes))
    assert len(tool.line_mm) == 1
    tool.drag(near)
    assert len(tool.line_mm) == 2


def test_forceps_close_along_the_view_stay_and_are_taken_up_again():
    tool = ForcepsTool(names())
    (closed,) = tool.press(pointer(200.0, 150.0))
    assert closed.direction == pytest.approx(pointer(200.0, 150.0).ray.direction)
    assert closed.closing == pytest.approx(EYE.axes[0])
    (led,) = tool.drag(pointer(220.0, 150.0))
    assert tool.release(pointer(220.0, 150.0)) == []
    turn = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    centre = np.add(closed.tip_mm, led.offset_mm)
    held = [Held(closed.name, centre, np.array(led.offset_mm), turn), Held("far", centre + 30.0, np.zeros(3))]
    at = seen_at(centre)
    assert tool.press(pointer(at[0] + 3.0, at[1]), held) == []
    (further,) = tool.drag(pointer(at[0] + 3.0, at[1] + 20.0))
    assert further.name == closed.name
    assert further.turn == turn
    # It does not leap to the mouse, but goes as far as the mouse goes.
    assert seen_at(centre + np.subtract(further.offset_mm, led.offset_mm)) == pytest.approx(
        (at[0], at[1] + 20.0), abs=0.2
    )


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_retractor_holds_the_lip_that_is_pulled_away(sign):
    tool = RetractorTool(names())
    ways = [(200.0, 130.0 + 2.0 * n) for n in range(21)]
    tool.press(pointer(*ways[0]))
    for way in ways[1:]:
        tool.drag(pointer(*way))
    assert tool.release(pointer(*ways[-1])) == []
    assert tool.is_waiting
    drawn = tool.line_mm
    assert tool.press(pointer(200.0, 150.0)) == []
    assert tool.drag(pointer(200.0 + 1.0 * sign, 150.0)) == []  # not far enough to know
    closed, led = tool.drag(pointer(200.0 + 20.0 * sign, 155.0))
    assert np.array(closed.line_mm) == pytest.approx(drawn)
    assert np.asarray(closed.side) @ EYE.axes[0] * sign > 0.9 * np.linalg.norm(closed.side)
    assert np.asarray(closed.side) @ (drawn[-1] - drawn[0]) == pytest.approx(0.0, abs=1e-6)
    assert np.asarray(led.offset_mm) @ EYE.axes[0] * sign > 0.0
    (further,) = tool.drag(pointer(200.0 + 30.0 * sign, 155.0))
    assert abs(np.asarray(further.offset_mm) @ EYE.axes[0]) > abs(np.asarray(led.offset_mm) @ EYE.axes[0])
    assert tool.release(pointer(200.0 + 30.0 * sign, 155.0)) == []
    assert not tool.is_waiting


def test_a_stitch_goes_through_two_places_and_is_drawn():
    tool = StitchTool(names())
    first, second = pointer(190.0, 150.0), pointer(210.0, 150.0)
    assert tool.press(first) + tool.release(first) == []
    assert tool.line_mm == pytest.approx(first.hit.point_mm[None])
    placed, drawn = tool.press(second)
    assert np.array(placed.places_mm) == pytest.approx(np.stack([first.hit.point_mm, second.hit.point_mm]))
    assert drawn.name == placed.name
    assert drawn.tension_n == tool.size
    tool.press(first)
    tool.forget()
    assert len(tool.line_mm) == 0


def test_a_row_goes_between_two_stitches_and_a_patch_is_cut_to_its_outline():
    tool = RowTool(names())
    clicked = [pointer(190.0, 140.0), pointer(210.0, 140.0), pointer(190.0, 170.0)]
    assert [command for one in clicked for command in tool.press(one)] == []
    assert tool.line_mm == pytest.approx(np.stack([one.hit.point_mm for one in clicked]))
    last = pointer(210.0, 170.0)
    placed, drawn = tool.press(last)
    places = np.array(placed.places_mm)
    assert places.reshape(4, 3) == pytest.approx(np.stack([one.hit.point_mm for one in (*clicked, last)]))
    assert drawn.name == placed.name == "row 1"
    tool = PatchTool(names())
    turns = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ways = [(200.0 + 30.0 * np.cos(turn), 150.0 + 30.0 * np.sin(turn)) for turn in turns]
    tool.press(pointer(*ways[0]))
    for way in ways[1:]:
        tool.drag(pointer(*way))
    (patch,) = tool.release(pointer(*ways[-1]))
    assert np.array(patch.outline_mm) == pytest.approx(np.stack([pointer(*way).hit.point_mm for way in ways]))
    assert patch.spacing_mm == tool.size
    assert tool.press(pointer(*ways[0])) + tool.release(pointer(*ways[0])) == []


def test_sizes_stay_in_their_range():
    tool = GrabTool(names())
    for _ in range(100):
        tool.resize(1)
    assert tool.size == tool.sizes[1]
    tool.resize(-1)
    assert tool.size == tool.sizes[1] - tool.sizes[2]
    tool.resize(-1000)
    assert tool.size == tool.sizes[0]


def test_hands_go_to_where_the_mouse_leapt_no_faster_than_a_hand():
    goals = Goals()
    goals.set(LeadGrab(name="hand", offset_mm=(30.0, 0.0, 40.0)))
    goals.set(MoveProbe(name="tip", center_mm=(0.0, 1.0, 0.0)))
    goals.set(MoveProbe(name="gone", center_mm=(0.0, 1.0, 0.0)))
    at = {"hand": np.zeros(3), "tip": np.zeros(3)}
    seconds, way = 0.02, 0.0
    for n in range(100):
        given = {command.name: command for command in goals.commands(at, seconds)}
        assert "gone" not in given
        assert ("tip" in given) == (n == 0)
        if "hand" not in given:
            break
        goal = np.array(given["hand"].offset_mm)
        assert np.linalg.norm(goal - at["hand"]) <= HAND_SPEED_MM_S * seconds * (1 + 1e-9)
        assert np.cross(goal, (30.0, 0.0, 40.0)) == pytest.approx(0.0, abs=1e-9)
        way += np.linalg.norm(goal - at["hand"])
        at["hand"] = goal
    assert way == pytest.approx(50.0)
    assert tuple(at["hand"]) == (30.0, 0.0, 40.0)
    goals.set(LeadGrab(name="hand", offset_mm=(0.0, 0.0, 0.0)))
    goals.drop("hand")
    assert goals.commands(at, seconds) == []
