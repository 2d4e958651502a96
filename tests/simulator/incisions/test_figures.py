"""Distances to vessels and structures, stitches, and plans in their order."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.landmarks import Landmark
from heartcase.simulator.incisions.figures import CRITERIA, Criterion, IncisionFigures, ranked, table, to_json
from heartcase.simulator.incisions.nearness import as_triangles, carried, to_structure, to_vessel, to_vessels
from heartcase.simulator.incisions.stitch_limits import MEASURED, beside_measured
from tests.simulator.incisions.scenes import circle, plate


def test_the_distance_of_skew_lines_less_the_vessels_radius():
    found = to_vessel(as_triangles([[-30.0, 0, 0], [40, 0, 0]]), [[3.3, -50, 7], [3.3, 20, 7]], 1.5, name="artery")
    assert found.distance_mm == pytest.approx(5.5)
    assert abs(found.place_mm[0] - 3.3) <= 1e-9
    assert abs(found.place_mm[1]) <= 0.5
    assert to_vessel(
        as_triangles([[0.0, 0, 0], [1, 0, 0]]), [[0, -1, 1], [0, 1, 1]], 1.5, name="artery"
    ).distance_mm == pytest.approx(-0.5)


def test_vessels_are_measured_from_all_of_a_cut_and_the_nearest_comes_first():
    vessels = [
        Landmark(name="far", kind="polyline", points_mm=((55.0, -5, 0), (55, 5, 0)), radius_mm=2.0),
        Landmark(name="near", kind="polyline", points_mm=((9.0, -5, 0), (9, 5, 0)), radius_mm=1.0),
        Landmark(name="an incision", kind="polyline", points_mm=((0.0, 0, 0), (1, 0, 0)), depth_mm=3.0),
        Landmark(name="apex", kind="point", points_mm=((0.0, 0, 0),)),
    ]
    deep = [[[0.0, 0, 0], [5, 0, 0], [5, 0, -6]], [[0, 0, 0], [5, 0, -6], [0, 0, -6]]]
    found = to_vessels(deep, vessels)
    assert [one.name for one in found] == ["near", "far"]
    assert found[0].distance_mm == pytest.approx(3.0)
    # A blade that passes an artery deep in the wall is near it, however far its line on the outside is.
    below = Landmark(name="below", kind="polyline", points_mm=((2.5, 3, -6), (2.5, 9, -6)), radius_mm=1.0)
    assert to_vessels(deep, [below])[0].distance_mm == pytest.approx(2.0)
    assert to_vessels(as_triangles([[0.0, 0, 0], [5, 0, 0]]), [below])[0].distance_mm == pytest.approx(45**0.5 - 1.0)


def test_points_are_carried_by_the_surface():
    rest, _ = plate(5.0, outer=60.0)
    now = rest + np.array([0.0, 0.0, 4.0])
    np.testing.assert_allclose(carried([[1.0, 2, 3]], rest, now), [[1, 2, 7]])


def test_a_structure_is_as_far_as_its_nearest_triangle():
    vertices, triangles = plate(10.0, outer=50.0)
    is_of_it = np.ones(len(triangles), bool)
    found = to_structure(0.5 * circle(10.0, count=9)[:5] + [0, 0, 3.0], vertices, triangles, is_of_it, name="valve")
    assert found.distance_mm == pytest.approx(np.hypot(5.0, 3.0), rel=1e-3)
    with pytest.raises(SimulationError, match="valve"):
        to_structure([[0, 0, 0], [1, 0, 0]], vertices, triangles, ~is_of_it, name="valve")
    with pytest.raises(SimulationError, match="two finite points"):
        to_structure([[0, 0, 0]], vertices, triangles, is_of_it, name="valve")


def test_stitches_are_put_beside_what_was_measured():
    first, second = beside_measured((1.0, 6.0))
    assert (first.number, second.number) == (1, 2)
    assert first.part_of_mean == pytest.approx(1.0 / 4.77)
    assert first.deviations_below == pytest.approx((4.77 - 1.0) / 3.28)
    assert second.deviations_below < 0.0 < second.part_of_mean
    assert {one.key for one in MEASURED} >= {"aortic-cut-in-weakest", "aortic-tear-out"}
    with pytest.raises(SimulationError, match="aortic-cut-in"):
        beside_measured((1.0,), "steel")
    with pytest.raises(SimulationError, match="0 N"):
        beside_measured((-1.0,))


def plans():
    good = IncisionFigures(
        "right atriotomy",
        rim_seen=0.9,
        freedom_mm3=5e4,
        retraction_n=0.8,
        stretch=1.3,
        nearest_mm={"rca": 6.0},
        length_mm=30.0,
    )
    poor = IncisionFigures(
        "pulmonary root",
        rim_seen=0.4,
        freedom_mm3=1e4,
        retraction_n=1.9,
        stretch=1.6,
        nearest_mm={"rca": 4.0},
        length_mm=35.0,
    )
    near = IncisionFigures(
        "ventriculotomy",
        rim_seen=1.0,
        freedom_mm3=9e4,
        retraction_n=0.1,
        stretch=1.1,
        nearest_mm={"rca": 1.0},
        length_mm=10.0,
    )
    return poor, near, good


def test_plans_are_ranked_by_the_stated_weights_and_those_too_near_come_last():
    found = ranked(plans())
    assert [one.figures.name for one in found] == ["right atriotomy", "pulmonary root", "ventriculotomy"]
    assert [one.is_too_near for one in found] == [False, False, True]
    assert [one.place for one in found] == [1, 2, 3]
    by_hand = sum(c.weight * found[0].shares[c.figure] for c in CRITERIA if c.figure in found[0].shares)
    counted = sum(c.weight for c in CRITERIA if c.figure in found[0].shares)
    assert found[0].score == pytest.approx(by_hand / counted)
    assert found[0].shares["rim_seen"] == pytest.approx(0.5 / 0.6)
    assert "solid_angle_sr" not in found[0].shares
    assert ranked(plans(), nearest_least_mm=0.0)[0].figures.name == "ventriculotomy"


def test_plans_that_leave_cells_inside_out_come_last_and_say_so():
    poor, _, good = plans()
    folded = replace(good, name="folded", rim_seen=1.0, inverted_cell_count=3)
    found = ranked((folded, poor, good))
    assert [(one.figures.name, one.is_inverted) for one in found] == [
        ("right atriotomy", False), ("pulmonary root", False), ("folded", True),
    ]  # fmt: skip
    assert ranked((folded, poor, good), inverted_cells_most=3)[0].figures.name == "folded"
    rows = [line.split() for line in table([one.figures for one in found]).splitlines()]
    assert ["cells", "inside", "out", "0", "0", "3"] in rows


def test_what_the_best_eye_sees_counts_more_than_what_all_eyes_see_together():
    names = ("from one place", "from many")
    one, many = (
        IncisionFigures(name, rim_seen=seen, rim_seen_best=best)
        for name, seen, best in zip(names, (0.8, 1.0), (0.8, 0.3), strict=True)
    )
    assert [plan.figures.name for plan in ranked((one, many))] == list(names)


def test_plans_that_do_not_differ_share_a_place():
    same = [IncisionFigures(name, rim_seen=0.5) for name in ("b", "a", "c")]
    found = ranked(same)
    assert [one.figures.name for one in found] == ["a", "b", "c"]
    assert [one.place for one in found] == [1, 1, 1]
    assert ranked([]) == ()


def test_what_cannot_be_ranked_is_told_at_once():
    with pytest.raises(SimulationError) as found:
        ranked(
            [IncisionFigures("a", rim_seen=float("nan")), IncisionFigures("a")],
            [Criterion("beauty", 1.0, True), Criterion("rim_seen", -1.0, True)],
        )
    assert len(found.value.problems) == 4


def test_the_table_has_a_column_for_each_plan_and_json_is_read_back():
    text = table(plans())
    lines = text.splitlines()
    assert lines[0].split() == ["pulmonary", "root", "ventriculotomy", "right", "atriotomy"]
    assert any(line.startswith("rim seen [%]") and line.endswith("90%") for line in lines)
    assert any(line.startswith("to rca [mm]") and line.split()[-3:] == ["4.0", "1.0", "6.0"] for line in lines)
    assert not any("solid angle" in line for line in lines)
    data = json.loads(to_json(ranked(plans())))
    assert [one["figures"]["name"] for one in data] == ["right atriotomy", "pulmonary root", "ventriculotomy"]
    assert data[0]["figures"]["nearest_mm"] == {"rca": 6.0}
