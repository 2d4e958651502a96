"""A planned incision on a plate: the blade's way, the hands and retractors at its lips, and where the lips are."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.scripts.incision_plans import LipHands, PlannedCut
from heartcase.simulator.incisions.planned import (
    blade_poses,
    drawn_line,
    lip_hands,
    lip_retractors,
    lips,
    problems_of_cut,
)
from heartcase.simulator.incisions.triangle_tree import triangle_tree

LINE = ((-6.0, 0.0, 0.0), (0.0, 0.0, 0.0), (6.0, 0.0, 0.0))
MARK = Landmark(name="Lid", kind="polyline", points_mm=LINE, depth_mm=3.0)


def grid_plate(*, upside_down=False):
    """A wall of half a millimetre with its outer face at z = 0, and a floor far below: vertices, normals, tree."""
    across = np.arange(-20.0, 20.5, 1.0)
    x, y = np.meshgrid(across, across, indexing="ij")
    count = len(across)
    sheets = [np.stack([x, y, np.full_like(x, z)], axis=-1).reshape(-1, 3) for z in (0.0, -0.5, -30.0)]
    number = np.arange(count * count).reshape(count, count)
    corners = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    quads = np.stack([one.ravel() for one in corners], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    vertices = np.concatenate(sheets)
    triangles = np.concatenate([faces + count**2 * sheet for sheet in range(3)])
    normals = np.repeat([[0.0, 0, 1], [0.0, 0, -1], [0, 0, 1]], count * count, axis=0)
    if upside_down:
        vertices, normals = -vertices, -normals
    return vertices, normals, triangle_tree(vertices, triangles)


@pytest.fixture(scope="module")
def whole():
    return grid_plate()


def lid(whole, **given):
    vertices, normals, tree = whole
    return drawn_line(PlannedCut(landmark="lid", **given), (MARK,), tree, vertices, normals)


def test_the_blade_stands_across_the_wall(whole):
    line = lid(whole)
    assert line.outward == pytest.approx(np.tile([0.0, 0, 1], (3, 1)))
    assert line.length_mm == pytest.approx(12.0)
    given = PlannedCut(landmark="lid", outside_mm=2.5, deeper_mm=0.0)
    poses = np.array(blade_poses(given, line, (MARK,), cell_mm=2.0))
    assert poses[:, 0] == pytest.approx(np.array(LINE) + np.array([0, 0, 2.5]))
    assert poses[:, 1] == pytest.approx(np.array(LINE) - np.array([0, 0, 3.0]))
    deeper = np.array(blade_poses(PlannedCut(landmark="lid", depth_mm=2.0, deeper_mm=0.7), line, (MARK,), cell_mm=2.0))
    assert deeper[:, 1] == pytest.approx(np.array(LINE) - np.array([0, 0, 2.7]))
    # Without more words it goes past the wall by two cells on either side.
    past = np.array(blade_poses(PlannedCut(landmark="lid"), line, (MARK,), cell_mm=2.0))
    assert past[:, 0] == pytest.approx(np.array(LINE) + np.array([0, 0, 4.0]))
    assert past[:, 1] == pytest.approx(np.array(LINE) - np.array([0, 0, 7.0]))


def test_out_is_where_there_is_less_tissue_whichever_face_is_nearer(whole):
    vertices, normals, tree = grid_plate(upside_down=True)
    line = drawn_line(PlannedCut(landmark="lid"), (MARK,), tree, vertices, normals)
    assert line.outward == pytest.approx(np.tile([0.0, 0, -1], (3, 1)))
    # A line that lies nearer to the inside of the wall.
    vertices, normals, tree = whole
    low = PlannedCut(curve_mm=tuple((x, y, -0.4) for x, y, _ in LINE), depth_mm=1.0)
    assert drawn_line(low, (), tree, vertices, normals).outward == pytest.approx(np.tile([0.0, 0, 1], (3, 1)))


def test_a_blade_with_a_way_of_its_own_has_no_line(whole):
    poses = (((0.0, 0, 1), (0.0, 0, -1)), ((1.0, 0, 1), (1.0, 0, -1)))
    cut = PlannedCut(poses_mm=poses)
    assert drawn_line(cut, (), whole[2], whole[0], whole[1]) is None
    assert blade_poses(cut, None, (), cell_mm=2.0) == poses


def test_hands_lie_on_both_sides_and_go_apart(whole):
    hands = lip_hands(
        LipHands(hands_per_lip=2, spread_mm=4.0, lift_mm=1.0, radius_mm=3.0), lid(whole), whole[0], cell_mm=1.0,
        open_s=0.4,
    )  # fmt: skip
    assert [one.name for one in hands] == ["one lip 1", "one lip 2", "other lip 1", "other lip 2"]
    for one in hands:
        x, y, z = one.position_mm
        assert (abs(x), abs(y), z) == pytest.approx((2.0, 3.0, 0.0))
        offset = one.path[-1].offset_mm
        assert offset == pytest.approx((0.0, 4.0 * np.sign(y), 1.0))
        assert one.path[-1].time_s == 0.4


def test_retractors_lie_along_the_lips_where_these_are_now(whole):
    line = lid(whole)
    now = whole[0] + np.where(whole[0][:, 1:2] > 0.0, [0.0, 0.7, 0.0], [0.0, -0.7, 0.0])
    sides = lips(line, whole[0], now)
    for side, lip in zip((1.0, -1.0), sides, strict=True):
        assert lip == pytest.approx(np.array(LINE) + np.sign(side * line.across[0][1]) * np.array([0.0, 0.7, 0.0]))
    settings = LipHands(kind="retractors", part=0.5, spread_mm=2.0, lift_mm=0.5, stiffness_n_mm2=0.1)
    one, other = lip_retractors(settings, line, sides, cell_mm=2.0, open_s=0.3)
    for retractor in (one, other):
        points = np.array(retractor.line_mm)
        assert np.abs(points[:, 0]).max() == pytest.approx(3.0)
        assert np.abs(points[:, 1]) == pytest.approx(np.full(3, 0.7))
        assert np.sign(retractor.side[1]) == np.sign(points[0, 1])
        assert retractor.path[-1].offset_mm == pytest.approx((0.0, 2.0 * np.sign(points[0, 1]), 0.5))
        assert (retractor.depth_mm, retractor.stiffness_n_mm2) == (3.0, 0.1)
    assert np.sign(one.side[1]) != np.sign(other.side[1])


def test_what_is_wrong_with_a_cut_is_told():
    without = Landmark(name="seam", kind="polyline", points_mm=LINE)
    vessel = Landmark(name="artery", kind="polyline", points_mm=LINE, radius_mm=1.0)
    marks = (MARK, without, vessel)
    assert problems_of_cut(PlannedCut(landmark="LID"), marks, "cuts[1]") == []
    told = [
        str(problem)
        for name in ("gone", "artery", "seam")
        for problem in problems_of_cut(PlannedCut(landmark=name), marks, "cuts[1]")
    ]
    assert told[0].endswith("the case has no landmark 'gone'; its planned incisions: Lid, seam")
    assert "artery is no planned incision" in told[1]
    assert "seam says no depth: give one" in told[2]


def test_a_line_that_stands_still_is_refused(whole):
    cut = PlannedCut(curve_mm=(LINE[0], LINE[0]), depth_mm=1.0)
    with pytest.raises(SimulationError, match="two points of the line"):
        drawn_line(cut, (), whole[2], whole[0], whole[1])
