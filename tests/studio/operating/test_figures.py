"""Figures of an incision, as a page is told them while it looks at them."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.simulator.background.figures_worker import LiveFigures, figures_of
from heartcase.simulator.incisions.figures import IncisionFigures
from heartcase.studio.operating.incisions import Incisions, is_held_open
from heartcase.studio.operating.live_figures import ShownFigures, told_figures
from tests.hollow_case import hollow_case
from tests.simulator.live.scenes import load, until
from tests.studio.operating.performing import operator, theatre

FIRST_HANDS = {"lid 1 one lip 1", "lid 1 one lip 2", "lid 1 other lip 1", "lid 1 other lip 2"}


@pytest.fixture(scope="module")
def hollow(tmp_path_factory):
    path = tmp_path_factory.mktemp("hollow") / "hollow.case"
    write_bundle(path, hollow_case())
    with theatre(path, path.parent) as (browser, opened):
        yield browser, opened


def figures(page, check):
    """The next message with figures of which something is so."""
    while not check(found := page.hear("figures")):
        pass
    return found


def test_a_planned_incision_is_cut_and_held_open_and_its_figures_follow(hollow):
    browser, opened = hollow
    with operator(browser, opened) as page:
        stage = opened.places["operating"]._stage
        assert page.opened["incisions"] == ["lid"]
        page.until(lambda frame: frame["step"] > 0)
        # nothing is worked out that nobody looks at
        assert stage.figures._worker is None
        assert page.ask("hold_open", incision=0)["kind"] == "refused"
        assert page.ask("cut_planned", incision="attic")["kind"] == "refused"
        page.done("figures", shown=True)
        # it may have come before the answer
        while not (told := [one for one in page.told if one["kind"] == "figures"]):
            page.next()
        assert told[0]["cuts"] == []
        page.done("cut_planned", incision="lid")
        page.until(lambda frame: frame["act_count"] == 1)
        closed = figures(page, lambda one: one["found"] is not None)
        assert (closed["cuts"], closed["found"]["name"]) == (["lid"], "lid")
        assert closed["found"]["hand_force_n"] == {}
        page.done("hold_open", incision=0)
        page.until(lambda frame: len(frame["instruments"]) == 4)
        page.until(lambda frame, goal=page.frames[-1]["time_s"] + 0.6: frame["time_s"] > goal)
        page.done("pause", paused=True)
        step = page.until(lambda frame: frame["mode"] == "paused")["step"]
        told = figures(page, lambda one: one["found"] is not None and one["found"]["step"] == step)["found"]
        # the same that a program gets for this moment
        live = stage.live.newest
        landmarks = stage._case.manifest.landmarks
        exact = figures_of(live, stage.incisions.whole, landmarks, reaches=False)
        assert told["defects"] == json.loads(
            json.dumps([{"name": "hole", "rim_found": 1.0, "figures": told_figures(exact.defects["hole"])}])
        )
        assert told["defects"][0]["figures"]["gap_mm"] > 5.0
        assert told["defects"][0]["figures"]["rim_seen"] > closed["found"]["defects"][0]["figures"]["rim_seen"]
        assert set(told["hand_force_n"]) == FIRST_HANDS
        # who looks at something else ends the process
        process = stage.figures._worker._process
        page.done("figures", shown=False)
        assert not process.is_alive()
        page.done("begin")
        page.until(lambda frame: frame["act_count"] == 0)


def test_a_second_incision_has_hands_of_its_own_and_one_that_is_held_stays(hollow):
    browser, opened = hollow
    with operator(browser, opened) as page:
        stage = opened.places["operating"]._stage
        page.until(lambda frame: frame["step"] > 0)
        page.done("cut_planned", incision="lid")
        page.until(lambda frame: frame["act_count"] == 1)
        page.done("hold_open", incision=0)
        page.until(lambda frame: len(frame["instruments"]) == 4)

        def offsets():
            return {one.name: one.offset_mm.tolist() for one in stage.live.newest.held}

        wanted = {led.name: list(led.offset_mm) for _, led, _ in stage.incisions.hands(stage.live.newest.cuts[0], 0)}
        until(lambda: offsets() == wanted)
        # all hands are one act for undo, and let go at once
        page.done("undo")
        page.until(lambda frame: not frame["instruments"] and frame["act_count"] == 1)
        page.done("redo")
        page.until(lambda frame: len(frame["instruments"]) == 4)
        assert page.done("let_go", everything=True)["used"]
        page.until(lambda frame: not frame["instruments"])
        page.done("undo")
        page.until(lambda frame: len(frame["instruments"]) == 4)
        page.done("pause", paused=False)
        assert page.frames[-1]["cut_count"] == 1
        # held already: it is refused in one line, and nothing is led
        assert not page.frames[-1]["can_hold_open"]
        refused = page.ask("hold_open", incision=0)
        assert [one["message"] for one in refused["problems"]] == ["this cut is held open already: let all go first"]
        cut = stage.incisions.cut("lid")
        beside = np.array(cut.poses_mm) - np.array([0.0, 9.0, 0.0])
        page.done("command", command={"kind": "cut", "name": "lid", "poses_mm": beside.tolist(), "at_rest": True})
        page.until(lambda frame: frame["act_count"] == 6)
        page.done("hold_open", incision=1)
        page.until(lambda frame: len(frame["instruments"]) == 8)
        for _, led, _ in stage.incisions.hands(stage.live.newest.cuts[1], 1):
            wanted[led.name] = list(led.offset_mm)
        until(lambda: offsets() == wanted)
        assert len(wanted) == 8
        page.done("begin")
        page.until(lambda frame: frame["act_count"] == 0)


def test_names_of_hands_are_names_of_the_format(hollow):
    _, opened = hollow
    incisions = Incisions(load(opened.path))
    cut = incisions.cut("lid").model_copy(update={"name": "l" * 64})
    names = {close.name for number in range(2) for close, _, _ in incisions.hands(cut, 11 * number)}
    assert len(names) == 8


def test_a_cut_is_held_open_by_its_own_hands_alone(hollow):
    _, opened = hollow
    incisions = Incisions(load(opened.path))
    # the hands of the second begin like those of the first
    cuts = [incisions.cut("lid").model_copy(update={"name": name}) for name in ("lid", "lid 1", "lid")]
    for number, cut in enumerate(cuts):
        held = {close.name: None for close, _, _ in incisions.hands(cut, number)}
        live = SimpleNamespace(cuts=tuple(cuts), frame=SimpleNamespace(instruments=held))
        assert [is_held_open(live, other) for other in range(3)] == [other == number for other in range(3)]
        assert is_held_open(live) == (number == 2)
    assert not is_held_open(SimpleNamespace(cuts=(), frame=SimpleNamespace(instruments=held)))


def test_a_page_that_goes_ends_what_was_worked_out_for_it(hollow):
    browser, opened = hollow
    with operator(browser, opened) as page, operator(browser, opened) as other:
        page.done("figures", shown=True)
        other.done("figures", shown=True)
        worker = opened.places["operating"]._stage.figures._worker
        page.done("figures", shown=False)
        assert worker._process.is_alive()
        # one that ended by itself is begun anew when it is asked for
        worker._process.kill()
        worker._process.join(10.0)
        other.done("figures", shown=True)
        worker = opened.places["operating"]._stage.figures._worker
        assert worker._process.is_alive()
    until(lambda: not worker._process.is_alive())


def test_what_is_no_number_is_told_as_unknown():
    found = told_figures(IncisionFigures("one", gap_mm=np.inf, length_mm=3.0, nearest_mm={"vessel": 2.0}))
    assert (found["gap_mm"], found["length_mm"], found["rim_seen"]) == (None, 3.0, None)
    assert (found["nearest_vessel_mm"], found["worst_stitch"]) == (2.0, None)
    json.dumps(found, allow_nan=False)
    found = told_figures(IncisionFigures("one", nearest_mm={"vessel": np.nan, "nerve": 1.0}))
    assert found["nearest_mm"] == {"vessel": None, "nerve": 1.0}
    json.dumps(found, allow_nan=False)


def test_forces_that_are_no_numbers_are_told_as_unknown():
    shown = ShownFigures(SimpleNamespace(), (), lambda: None)
    shown._worker = SimpleNamespace(
        newest=LiveFigures(
            step=1,
            time_s=0.1,
            incision=0,
            name="lid",
            defects={"hole": IncisionFigures("hole", nearest_mm={"vessel": np.inf})},
            rim_found={"hole": np.nan},
            hand_force_n={"hand": np.nan, "other": 2.0},
            inverted_cell_count=0,
            has_reach=False,
            problems=(),
        ),
        error=None,
        is_reaching=False,
    )
    found = json.loads(shown.message(SimpleNamespace(cuts=(SimpleNamespace(name="lid"),))))["found"]
    assert found["hand_force_n"] == {"hand": None, "other": 2.0}
    assert (found["defects"][0]["rim_found"], found["defects"][0]["figures"]["nearest_mm"]) == (None, {"vessel": None})
