"""Plans of incisions: their file, what of it is for a case, and the lid of a box cut, held open and looked through."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.errors import ScriptError, SimulationError
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.planned_incisions import (
    at_vertices,
    load_plans,
    on_case,
    parse_plans,
    ranked_by_defect,
    run_plan,
)
from heartcase.simulator.simulation import Simulation
from tests.hollow_case import CELL_MM, HOLE, hollow_case

HEAD = "heartcase_plans = 1\n"
ROUGH = "[shaft]\nspacing_mm = 8.0\ndepth_mm = 20.0\n"
"""Fewer places of the instrument's tip."""
LID = '[[plans]]\nname = "lid"\ncuts = [{ landmark = "lid" }]\n'
HELD = LID + "retraction = { spread_mm = 6.0, lift_mm = 2.0, radius_mm = 4.5 }\n"


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    path = tmp_path_factory.mktemp("hollow") / "hollow.case"
    write_bundle(path, hollow_case())
    return load_case(path, needs=("surface", "colours", "tissue"))


def run(case, text):
    on = on_case(parse_plans(HEAD + ROUGH + text), case.manifest.landmarks)
    session = OperatingSession(
        Simulation(case.model, surface=case.surface, tissue=case.tissue, damping_per_s=30.0), snapshot_every_s=inf
    )
    return run_plan(on.runs[0], on, case, session), session


@pytest.fixture(scope="module")
def held_open(case):
    return run(case, HELD)


@pytest.fixture(scope="module")
def left_alone(case):
    return run(case, LID)[0]


def test_the_hole_is_seen_only_when_the_lid_is_held_open(held_open):
    held, session = held_open
    found = held.figures["hole"]
    assert (found.rim_seen_closed, found.rim_seen_cut) == (0.0, 0.0)
    assert found.rim_seen > 0.5
    assert 0.0 < found.rim_seen_best <= found.rim_seen
    assert held.inverted_cell_count == 0
    assert found.length_mm == pytest.approx((9.4 - 2.6) * CELL_MM)
    # The lips were led 6 mm to each side; they give way between the hands' balls and the ends.
    assert 6.0 < found.gap_mm < 14.0
    assert set(held.hand_force_n) == {"one lip", "other lip"}
    assert found.retraction_n == max(held.hand_force_n.values()) > 0.0
    # Behind the lid and in front of the floor: nothing of the hole can look larger than its own area from there.
    side = (HOLE[0].stop - HOLE[0].start) * CELL_MM
    assert 0.0 < found.solid_angle_sr < side**2 / (400.0 - 50.0) ** 2
    marks = [entry.command.name for entry in session.entries if entry.command.kind == "mark"]
    assert marks == ["closed", "cut", "held open"]
    shown = at_vertices(held.strain.stretches[:, 0], held, session.simulation)
    assert shown.shape == (len(session.simulation.surface.rest_mm),)
    assert 1.05 < shown.max() <= held.strain.stretches[:, 0].max()


def test_without_hands_nothing_opens(left_alone):
    found = left_alone.figures["hole"]
    assert (found.rim_seen, found.retraction_n, left_alone.hand_force_n) == (0.0, 0.0, {})
    assert found.gap_mm == pytest.approx(0.0, abs=1e-3)
    assert found.stretch == pytest.approx(1.0, abs=1e-3)


def test_retractors_hold_the_lips_too(case):
    held, _ = run(case, LID + 'retraction = { kind = "retractors", spread_mm = 4.0, lift_mm = 1.0 }\n')
    assert held.figures["hole"].rim_seen > 0.0
    assert 3.0 < held.figures["hole"].gap_mm < 8.5
    one, other = held.hand_force_n.values()
    assert one == pytest.approx(other, rel=0.3)


def test_a_blade_and_hands_of_ones_own(case):
    line = next(mark for mark in case.manifest.landmarks if mark.name == "lid")
    x, y, z = np.mean(line.points_mm, axis=0).tolist()
    ends = [[[x + along, y, z + up] for up in (3.0, -5.0)] for along in (-10.0, 10.0)]
    text = (
        f'[[plans]]\nname = "own"\ncuts = [{{ poses_mm = {ends} }}]\n[[plans.actions]]\nname = "hand"\n'
        f"position_mm = {[x, y + 4.5, z]}\npath = [{{ time_s = 0.3, offset_mm = [0.0, 4.0, 3.0] }}]\n"
    )
    held, _ = run(case, text)
    assert held.opening_mm is None
    assert held.figures["hole"].gap_mm is None
    assert held.figures["hole"].rim_seen > 0.0
    assert held.hand_force_n["hand"] > 0.0


def test_a_plan_comes_to_the_same_bytes_again(case, held_open):
    first, second = held_open[0], run(case, HELD)[0]
    assert first.figures == second.figures
    assert first.strain.stretches.tobytes() == second.strain.stretches.tobytes()


def test_a_cut_beside_the_tissue_is_told(case):
    text = '[[plans]]\nname = "air"\ncuts = [{ poses_mm = [[[900, 0, 0], [900, 0, 9]], [[909, 0, 0], [909, 0, 9]]] }]\n'
    with pytest.raises(SimulationError, match="there is no tissue in its way"):
        run(case, text)


def test_plans_are_ranked_for_each_defect(held_open, left_alone):
    figures = {"hole": replace(held_open[0].figures["hole"], name="held")}
    held = (left_alone, replace(held_open[0], figures=figures))
    first, second = ranked_by_defect(held, nearest_least_mm=2.0, inverted_cells_most=2)["hole"]
    assert (first.figures.name, second.figures.name) == ("held", "lid")
    # The vessel runs 12 mm beside the line: too near where more is asked for.
    assert all(one.is_too_near for one in ranked_by_defect(held, nearest_least_mm=50.0, inverted_cells_most=2)["hole"])
    assert ranked_by_defect((), nearest_least_mm=2.0, inverted_cells_most=2) == {}


def test_what_a_case_lacks_is_told_all_at_once(case):
    marks = case.manifest.landmarks
    text = HEAD + 'defects = ["door"]\n' + LID.replace('"lid"', '"a"', 1).replace('"lid"', '"attic"')
    text += LID + '[[plans.actions]]\nlandmark = "cellar"\npath = [{ time_s = 0.1, offset_mm = [0, 0, 1] }]\n'
    with pytest.raises(ScriptError) as caught:
        on_case(parse_plans(text), marks)
    told = [str(problem) for problem in caught.value.problems]
    assert [line.split(":")[0] for line in told] == [
        "plans[1].cuts[1].landmark", "plans[2].actions[1].landmark", "defects",
    ]  # fmt: skip
    assert "its planned incisions: lid" in told[0]
    assert "its rings: hole" in told[2]


def test_a_plan_may_be_for_other_cases(case):
    other = LID.replace('"lid"', '"attic"') + "only_with_landmarks = true\n"
    on = on_case(parse_plans(HEAD + LID + other), case.manifest.landmarks)
    assert ([plan.name for plan in on.runs], on.left_out) == (["lid"], ("attic",))
    with pytest.raises(ScriptError, match="the case lacks landmarks of every plan"):
        on_case(parse_plans(HEAD + other), case.manifest.landmarks)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (LID + LID, "more than one plan is called lid"),
        (LID.replace('landmark = "lid"', "depth_mm = 2.0"), "give one of landmark, curve_mm and poses_mm"),
        (LID.replace('landmark = "lid"', "curve_mm = [[0, 0, 0], [1, 0, 0]]"), "a curve_mm needs a depth_mm"),
        (LID + "looks_from = [0.0, 0.0, 0.0]\n", "looks_from must not be zero"),
        (LID + "retraction = { part = 0.5 }\n", "grabs have no part: leave it out"),
        (LID + 'retraction = { kind = "retractors", radius_mm = 3.0 }\n', "retractors have no radius_mm"),
        (
            LID.replace('landmark = "lid"', "poses_mm = [[[0, 0, 0], [1, 0, 0]], [[0, 0, 1], [1, 0, 1]]]")
            + "retraction = {}\n",
            "a retraction needs a first cut along a landmark or a curve_mm",
        ),
        (LID + '[[plans.actions]]\nlandmark = "lid"\nstart_s = 9.0\npath = [{ time_s = 9.5, offset_mm = [0, 0, 1] }]\n',
         "hands close after the end"),
        ("plans = 3\n", "plans"),
        ("= 4\n", "not valid TOML"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_told(text, told):
    with pytest.raises(ScriptError, match=told):
        parse_plans(HEAD + text)


def test_other_files_are_named(tmp_path):
    with pytest.raises(ScriptError, match="this is a recipe, not a file of plans"):
        parse_plans("heartcase_recipe = 1\n")
    with pytest.raises(ScriptError, match="this is no file of plans"):
        parse_plans("seconds = 1.0\n")
    with pytest.raises(ScriptError, match="there is no such file"):
        load_plans(tmp_path / "gone.toml")
    with pytest.raises(ScriptError, match="newer"):
        parse_plans("heartcase_plans = 99\n" + LID)
