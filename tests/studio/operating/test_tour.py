"""A guided tour through the server: steps do what a recording holds, and are undone on the way back."""

from __future__ import annotations

import json
import time

import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.recording.commands import Mark
from heartcase.schemas.recording.reader import open_recording
from tests.hollow_case import hollow_case
from tests.simulator.touring.hollow_tour import TOUR
from tests.studio.operating.performing import operator, theatre


@pytest.fixture(scope="module")
def toured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("toured")
    write_bundle(folder / "hollow.case", hollow_case())
    (folder / "hollow.tour.md").write_text(TOUR.replace("Nothing is to be seen.", "Nothing: &lt;script&gt;alert(1)"))
    (folder / "other.tour.md").write_text(TOUR.replace('"hollow"', '"another"'))
    with theatre(folder / "hollow.case", folder) as (browser, opened):
        yield browser, opened


def arrived(page, step, state="ready"):
    """Take messages until the server says how a step went."""
    while True:
        found = page.hear("tour")
        if found["step"] == step and found["state"] in ("ready", "failed"):
            assert found["state"] == state, found.get("problems")
            return found


def go(page, step):
    page.done("tour", tour=0, step=step)
    return arrived(page, step)


def live_of(opened):
    return opened.places["operating"]._stage.live


def marks_of(opened):
    session = live_of(opened).session
    return [one.command.name for one in session.entries[: session.position] if isinstance(one.command, Mark)]


def test_tours_are_named_with_all_that_they_say_and_show(toured):
    browser, opened = toured
    with operator(browser, opened) as page:
        answer = page.done("tours")
        (tour,) = answer["tours"]
        assert answer["tour_problems"] == []
        assert tour["title"] == "Two rooms"
        # text is text, whatever stands in it
        assert tour["steps"][0]["blocks"] == [
            {
                "kind": "paragraph",
                "pieces": [{"text": "Nothing: <script>alert(1)", "strong": False, "emphasis": False}],
            }
        ]
        assert [step["acts"] for step in tour["steps"]] == [False, False, True, True, True, True]
        assert tour["steps"][1]["scene"]["view"]["towards"] == [0.0, 0.0, 1.0]
        assert tour["steps"][1]["question"]["choices"][1]["is_right"]
        assert str(opened.path.parent) not in json.dumps(answer)
        # one that is wrong is told to who wrote it, and those that are sound are shown
        wrong = opened.path.parent / "wrong.tour.md"
        wrong.write_text(TOUR.replace('at = "hole"', 'at = "hle"'))
        answer = page.done("tours")
        assert len(answer["tours"]) == 1
        assert "did you mean 'hole'?" in answer["tour_problems"][0]["message"]
        assert "step 2" in answer["tour_problems"][0]["place"]
        wrong.unlink()
        for request in ({"tour": 7, "step": 0}, {"tour": 0, "step": 99}, {"tour": -1, "step": 0}):
            assert page.ask("tour", **request)["kind"] == "refused"


def test_a_tour_on_back_taken_over_and_recorded(toured):
    browser, opened = toured
    with operator(browser, opened) as page:
        page.done("tours")
        page.until(lambda frame: frame["step"] > 0)
        page.done("record")
        name = page.until(lambda frame: frame["recording"] is not None)["recording"]
        # what only shows leaves the session as it is
        go(page, 1)
        assert marks_of(opened) == []
        go(page, 2)
        page.until(lambda frame: [one["name"] for one in frame["instruments"]] == ["probe"])
        end = marks_of(opened)
        assert [one.partition(" (")[0] for one in end] == ["tour begins", "tour step 3"]
        go(page, 3)
        held = page.until(lambda frame: len(frame["instruments"]) == 2)
        assert {one["name"] for one in held["instruments"]} == {"lid one lip", "lid other lip"}
        cut_nodes = len(page.displacement)
        # back: the step's commands are undone, to where the step before had ended
        go(page, 2)
        page.until(lambda frame: [one["name"] for one in frame["instruments"]] == ["probe"])
        assert len(page.displacement) < cut_nodes
        assert marks_of(opened)[:2] == end
        go(page, 0)
        page.until(lambda frame: not frame["instruments"])
        # a leap does all steps between
        go(page, 4)
        page.until(lambda frame: [one["name"] for one in frame["patches"]] == ["patch"])
        assert len(page.displacement) > cut_nodes  # with those of the patch
        # the learner takes over, and the tour goes on from where it was
        acts = live_of(opened).newest.act_count
        page.done("command", command={"kind": "take_out_patch", "name": "patch"})
        page.until(lambda frame: not frame["patches"])
        page.done(
            "command",
            command={"kind": "bring_probe", "name": "own", "center_mm": [0, 0, 90], "semi_axes_mm": [2, 2, 2]},
        )
        page.until(lambda frame: any(one["name"] == "own" for one in frame["instruments"]))
        go(page, 4)
        page.until(lambda frame: frame["patches"] and all(one["name"] != "own" for one in frame["instruments"]))
        assert live_of(opened).newest.act_count == acts
        # to its end
        go(page, 5)
        end_frame = page.until(lambda frame: not frame["instruments"] and frame["stitches"])
        assert all(one["tied"] for one in end_frame["stitches"])
        page.done("tour", tour=0, step=None)
        page.done("stop_recording")
        page.until(lambda frame: frame["recording"] is None)
        stored = open_recording(opened.path.parent / name)
        kinds = [one.command.kind for one in stored.entries]
        assert {"cut", "close_grab", "lead_grab", "open_grab", "place_patch", "place_row", "tie_stitch", "mark"} <= set(
            kinds
        )
        page.done("begin")
        page.until(lambda frame: frame["act_count"] == 0)


def test_a_step_that_is_left_on_the_way_leaves_no_trace(toured):
    browser, opened = toured
    with operator(browser, opened) as page:
        page.done("tours")
        page.until(lambda frame: frame["step"] > 0)
        for _ in range(3):
            for step in (3, 5, 2):
                page.done("tour", tour=0, step=step)
                time.sleep(0.02)
        arrived(page, 2)
        page.until(lambda frame: [one["name"] for one in frame["instruments"]] == ["probe"])
        assert live_of(opened).newest.act_count == 1
        # what came before the tour is forgotten: it begins anew
        page.done("command", command={"kind": "go_to", "step": 0})
        page.until(lambda frame: frame["mode"] == "paused" and frame["step"] == 0)
        page.done("pause", paused=False)
        page.until(lambda frame: frame["step"] > 0)
        go(page, 2)
        page.until(lambda frame: [one["name"] for one in frame["instruments"]] == ["probe"])
        assert live_of(opened).newest.act_count == 1
        page.done("begin")
        page.until(lambda frame: frame["act_count"] == 0)


def test_a_step_that_another_page_ends_is_told_as_left(toured):
    browser, opened = toured
    with operator(browser, opened) as page, operator(browser, opened) as other:
        page.done("tours")
        page.until(lambda frame: frame["step"] > 0)
        page.done("pause", paused=True)
        page.done("tour", tour=0, step=5)
        while page.hear("tour")["state"] != "working":
            pass
        other.done("begin")
        assert page.hear("tour")["state"] == "left"
        page.until(lambda frame: frame["act_count"] == 0)


def test_a_step_that_cannot_be_done_says_why(toured):
    browser, opened = toured
    path = opened.path.parent / "hollow.tour.md"
    before = path.read_text()
    path.write_text(TOUR.replace('kind = "withdraw_probe"\nname = "probe"', 'kind = "take_out_patch"\nname = "none"'))
    try:
        with operator(browser, opened) as page:
            page.done("tours")
            page.done("tour", tour=0, step=3)
            found = arrived(page, 3, "failed")
            assert "none" in json.dumps(found["problems"])
            page.done("begin")
            page.until(lambda frame: frame["act_count"] == 0)
    finally:
        path.write_text(before)
