"""What server and page say to each other while a case is operated on, with a page that is none."""

from __future__ import annotations

import asyncio
import json
import re
import time

import numpy as np
import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.bundle.manifest import MANIFEST_NAME
from heartcase.schemas.recording.reader import open_recording
from heartcase.studio.operating.scene.packing import BLOCK_NODES, SCALE_LEAST, Rounded, frame_message, moved_blocks
from heartcase.studio.pages import Page
from heartcase.studio.serving import app
from tests.factories import block_case
from tests.simulator.live.scenes import until, write_case
from tests.studio.operating.performing import operator, theatre, unpacked

TOP = (22.0, -14.0, 40.5)


def live_of(opened):
    return opened.places["operating"]._stage.live


def agrees(page, opened):
    """Whether the page has the nodes where they are in a session that stands, by half a step of what is sent."""
    frame = live_of(opened).newest.frame
    displacement = frame.state.displacement
    scale = page.frames[-1]["scale"]
    return (
        page.frames[-1]["step"] == frame.step
        and len(page.displacement) == len(displacement)
        and float(np.abs(page.displacement - displacement).max()) <= 0.5001 * scale
    )


def test_a_story_that_pulls_cuts_undoes_records_and_replays(operated, operated_case):
    browser, opened = operated
    with operator(browser, opened) as page:
        assert page.opened["name"] == "block"
        assert [one["name"] for one in page.opened["structures"]][-1] == "cut faces"
        assert str(operated_case.parent) not in json.dumps(page.opened)
        page.until(lambda frame: frame["frame"] > 1)
        assert page.arrays["blocks"].size == 0
        page.done("record")
        recorded = page.until(lambda frame: frame["recording"] is not None)["recording"]
        # a hand that is led by 5 mm to the side
        page.done("take", tool="g")
        assert page.at("press", TOP)["used"]
        page.at("drag", (27.0, -14.0, 40.5))
        page.until(lambda frame: frame["instruments"] and frame["instruments"][0]["center_mm"][0] > 26.9)
        assert np.nanmax(page.displacement) * 3.0 > 3.0
        assert np.linalg.norm(page.frames[-1]["instruments"][0]["force_n"]) > 0.0
        page.done("pause", paused=True)
        page.until(lambda frame: frame["mode"] == "paused")
        assert agrees(page, opened)
        assert page.at("release", (27.0, -14.0, 40.5))["used"]
        page.until(lambda frame: not frame["instruments"] and frame["act_count"] == 2)
        # a blade across the block
        page.done("take", tool="c")
        page.at("press", (22.3, -20.0, 40.5))
        for y in (-17.0, -14.0, -11.0, -8.0):
            answer = page.at("drag", (22.3, y, 40.5))
        assert len(answer["line_mm"]) == 5
        nodes, count = len(page.displacement), page.topology_count
        answer = page.at("release", (22.3, -8.0, 40.5))
        assert answer["line_mm"] == []
        page.until(lambda frame: page.topology_count > count)
        assert len(page.displacement) > nodes
        assert (page.topology[1]["structure"] == page.opened["cut_faces"]).any()
        # back before the cut, and on again
        page.done("undo")
        page.until(lambda frame: frame["mode"] == "paused" and len(page.displacement) == nodes)
        assert agrees(page, opened)
        assert page.frames[-1]["end_s"] > page.frames[-1]["time_s"]
        page.done("redo")
        page.until(lambda frame: len(page.displacement) > nodes and frame["act_count"] == 3)
        assert agrees(page, opened)
        end = page.frames[-1]
        page.done("stop_recording")
        page.until(lambda frame: frame["recording"] is None)
        name = page.done("recordings")["recordings"][0]
        assert name == recorded
        # the same again from the recording, and taken over
        page.done("replay", name=name, speed=0.5)
        page.until(lambda frame: frame["mode"] == "playing" and frame["step"] < end["step"])
        page.done("play", speed=4.0)
        page.until(lambda frame: frame["mode"] == "paused" and frame["step"] == end["step"])
        assert agrees(page, opened)
        assert live_of(opened).session.deviations == []
        page.done("command", command={"kind": "go_to", "step": end["step"] // 2})
        page.until(lambda frame: frame["step"] == end["step"] // 2)
        assert agrees(page, opened)
        page.done(
            "command",
            command={"kind": "bring_probe", "name": "tip", "center_mm": [22, -14, 60], "semi_axes_mm": [3, 3, 3]},
        )
        page.until(lambda frame: frame["mode"] == "running" and frame["instruments"])
        assert page.frames[-1]["end_s"] == page.frames[-1]["time_s"]
        page.done("begin")
        page.until(lambda frame: frame["act_count"] == 0 and not frame["instruments"])
        stored = open_recording(opened.places["operating"]._out / name)
        assert {one.command.kind for one in stored.entries} >= {"close_grab", "open_grab", "cut"}


def test_what_is_asked_wrongly_is_refused_and_changes_nothing(operated):
    browser, opened = operated
    with operator(browser, opened) as page:
        page.until(lambda frame: frame["step"] > 0)
        pointer = {"start_mm": [0, 0, 0], "direction": [0, 0, 1], "axes": [[1, 0, 0], [1, 0, 0], [0, 0, 1]]}
        for do, request, words in (
            ("press", {"pointer": pointer}, "perpendicular"),
            ("press", {"pointer": pointer | {"direction": [0, 0, 0]}}, "all zero"),
            ("press", {"pointer": pointer | {"start_mm": [float("inf"), 0, 0]}}, "JSON"),
            ("take", {"tool": "q"}, "no tool"),
            ("replay", {"name": "../block-1.recording"}, "no recording"),
            ("replay", {"name": str(opened.path)}, "no recording"),
            ("command", {"command": {"kind": "erase"}}, "kind"),
            ("command", {"command": {"kind": "cut", "poses_mm": []}}, "poses_mm"),
            ("fly", {}, "do"),
            ("resize", {"steps": 1e9}, "steps"),
            ("play", {"speed": 0.0}, "speed"),
        ):
            answer = page.ask(do, **request)
            assert answer["kind"] == "refused", do
            assert words in json.dumps(answer["problems"]), answer
        page.socket.send_text("[1]")
        assert page.hear("refused")["id"] is None
        assert live_of(opened).newest.act_count == 0
        # beside the heart there is no use for a tool: the page turns the heart instead
        page.done("take", tool="g")
        assert not page.at("press", (100.0, -14.0, 40.5))["used"]
        # nor on a structure that is hidden
        everything = [one["value"] for one in page.opened["structures"]]
        page.done("hide", structures=everything)
        assert not page.at("press", TOP)["used"]
        page.done("hide", structures=[])
        assert page.done("resize", steps=2)["size"] == 8.0
        assert page.at("press", TOP)["used"]
        page.at("release", TOP)
        page.until(lambda frame: frame["act_count"] == 2)
        page.done("begin")
        page.until(lambda frame: frame["act_count"] == 0)


def test_what_a_plane_cuts_away_cannot_be_pointed_at(operated):
    browser, opened = operated
    with operator(browser, opened) as page:
        page.done("begin")
        page.until(lambda frame: frame["mode"] == "running" and not frame["instruments"])
        page.done("take", tool="g")
        # the upper half is taken away: seen from above the wall is met in the plane
        page.done("cut_open", plane={"normal": [0, 0, 2], "point_mm": [0, 0, 35.0]})
        assert page.at("press", (22.0, -14.0, 40.5))["used"]
        page.until(lambda frame: bool(frame["instruments"]))
        (held,) = page.frames[-1]["instruments"]
        assert held["center_mm"] == pytest.approx([22.0, -14.0, 35.0], abs=0.2)
        page.at("release", (22.0, -14.0, 40.5))
        page.until(lambda frame: not frame["instruments"])
        # all of it is taken away
        page.done("cut_open", plane={"normal": [0, 0, 1], "point_mm": [0, 0, 20.0]})
        assert not page.at("press", (22.0, -14.0, 40.5))["used"]
        # a wall that is hidden is not met where it is cut
        page.done("cut_open", plane={"normal": [0, 0, 1], "point_mm": [0, 0, 35.0]})
        labels = set(page.topology[1]["cell_label"].tolist())
        page.done("hide", structures=sorted(labels | {one["value"] for one in page.opened["structures"]}))
        assert not page.at("press", (22.0, -14.0, 40.5))["used"]
        page.done("hide", structures=[])
        page.done("cut_open", plane=None)
        assert page.at("press", (22.0, -14.0, 40.5))["used"]
        page.at("release", (22.0, -14.0, 40.5))
        page.until(lambda frame: not frame["instruments"])
        # nor is a stitch taken out that lies beyond it
        places = [[20.0, -14.0, 40.5], [24.0, -14.0, 40.5]]
        page.done("command", command={"kind": "place_stitch", "name": "thread", "places_mm": places})
        page.until(lambda frame: frame["stitches"])
        page.done("cut_open", plane={"normal": [0, 0, 1], "point_mm": [0, 0, 35.0]})
        assert not page.at("let_go", (22.0, -14.0, 40.5))["used"]
        page.done("cut_open", plane=None)
        assert page.at("let_go", (22.0, -14.0, 40.5))["used"]
        page.until(lambda frame: not frame["stitches"])
        page.socket.send_json({"do": "cut_open", "id": 999, "plane": {"normal": [0, 0, 0], "point_mm": [0, 0, 0]}})
        assert page.hear("refused")["id"] == 999
        page.done("take", tool="")
        page.done("begin")


def test_a_page_that_is_slow_gets_the_newest_and_no_queue_grows(operated):
    browser, opened = operated
    with operator(browser, opened) as page, operator(browser, opened, takes=False) as slow:
        page.until(lambda frame: frame["step"] > 0)
        page.done("take", tool="g")
        page.at("press", TOP)
        for n in range(40):
            page.at("drag", (22.0 + 4.0 * np.sin(0.4 * n), -14.0, 40.5))
            last = page.frames[-1]["frame"]
            page.until(lambda frame, last=last: frame["frame"] > last)
        viewers = opened.places["operating"]._viewers
        assert len(viewers) == 2
        assert all(len(viewer_page.waiting._queue) <= 6 for viewer_page in viewers)
        # it took none: it was sent as many as may be under way, and not one more
        slow.done("take", tool="")
        assert len(slow.frames) == 2
        assert len(page.frames) > 40
        page.done("pause", paused=True)
        page.until(lambda frame: frame["mode"] == "paused")
        # ready again, it is shown where things are now, and all that moved meanwhile
        slow.takes = True
        slow.socket.send_text(json.dumps({"do": "seen", "frame": 2}))
        slow.until(lambda frame: frame["mode"] == "paused")
        np.testing.assert_array_equal(slow.displacement, page.displacement)
        page.done("begin")
        page.until(lambda frame: frame["act_count"] == 0)


def test_a_lost_page_freezes_what_it_led_and_lets_go_softly_and_then_time_stands(operated):
    browser, opened = operated
    with operator(browser, opened) as page:
        page.until(lambda frame: frame["step"] > 0)
        page.done("take", tool="g")
        page.at("press", TOP)
        page.at("drag", (26.0, -14.0, 40.5))
        page.until(lambda frame: frame["instruments"] and frame["instruments"][0]["center_mm"][0] > 25.9)
        page.at("drag", (60.0, -14.0, 40.5))
    live = live_of(opened)
    offsets, began = [], live.newest.frame.time_s
    end = time.monotonic() + 60.0
    while live.newest.frame.instruments:
        newest = live.newest
        if newest.held:
            offsets.append((newest.frame.time_s, float(newest.held[0].offset_mm[0])))
        assert time.monotonic() < end
        time.sleep(0.002)
    # it went no further than it was led by then, and came back at 30 mm/s, not with a leap
    assert max(offset for _, offset in offsets) < 12.0
    assert offsets[-1][1] < 2.5
    assert live.newest.frame.time_s - began > 0.1
    assert live.session.entries[-2].command.kind in ("open_grab", "advance")
    until(lambda: live.newest.mode == "paused")
    step = live.newest.frame.step
    time.sleep(0.2)
    assert live.newest.frame.step == step
    with operator(browser, opened) as page:
        page.until(lambda frame: frame["mode"] == "running" and frame["step"] > step)
        page.done("begin")
        page.until(lambda frame: frame["act_count"] == 0)


def test_a_heart_that_does_not_move_costs_next_to_nothing(operated):
    browser, opened = operated
    with operator(browser, opened) as page:
        page.until(lambda frame: frame["step"] > 0)
        first, began = len(page.frames), time.monotonic()
        page.until(lambda frame: frame["time_s"] > page.frames[first - 1]["time_s"] + 0.5)
        seconds = time.monotonic() - began
        # the time is told ten times a second at most, without a node
        assert len(page.frames) - first <= 11.0 * seconds + 2
        assert max(page.sizes[first:]) < 1000


def test_strain_is_sent_to_the_page_that_wants_it(operated):
    browser, opened = operated
    with operator(browser, opened) as page:
        page.until(lambda frame: frame["step"] > 0)
        page.done("strain", shown=True)
        page.until(lambda frame: "stretch" in page.arrays)
        assert page.arrays["stretch"].shape == (len(page.displacement),)
        page.done("strain", shown=False)


def test_a_session_that_broke_is_told_and_the_next_page_begins_anew(operated_case, tmp_path):
    with theatre(operated_case, tmp_path) as (browser, opened):
        with operator(browser, opened) as page:
            page.until(lambda frame: frame["step"] > 0)
            page.done("record")
            page.until(lambda frame: frame["recording"] is not None)

            def fail():
                raise ZeroDivisionError("a fault")

            live_of(opened)._ask([fail])
            assert "ZeroDivisionError" in json.dumps(page.hear("failed")["problems"])
            assert page.ask("undo")["kind"] == "refused"
        assert open_recording(tmp_path / "block-1.recording").header.end is not None
        with operator(browser, opened) as page:
            page.until(lambda frame: frame["step"] > 0)
            assert page.frames[-1]["recording"] is None


def kinds_in(path):
    recording = open_recording(path)
    assert recording.header.end is not None
    return [one.command.kind for one in recording.entries]


def test_what_was_done_is_kept_where_the_session_broke_and_where_the_server_ends(operated_case, tmp_path):
    with theatre(operated_case, tmp_path) as (browser, opened):
        with operator(browser, opened) as page:
            page.done("take", tool="g")
            assert page.at("press", TOP)["used"]
            page.until(lambda frame: frame["act_count"] == 1)

            def fail():
                raise ZeroDivisionError("a fault")

            live_of(opened)._ask([fail])
            problems = page.hear("failed")["problems"]
            assert "ZeroDivisionError" in problems[0]["message"]
            kept = "what was done is kept in the recording block-1"
            assert problems[1] == {
                "place": "recording",
                "message": kept,
                "code": "kept",
                "values": {"name": "block-1"},
            }
        assert "close_grab" in kinds_in(tmp_path / "block-1.recording")
        with operator(browser, opened) as page:
            page.until(lambda frame: frame["step"] > 0)
        # nothing was done in it
        assert len(list(tmp_path.iterdir())) == 1
        with operator(browser, opened) as page:
            page.done("take", tool="g")
            assert page.at("press", TOP)["used"]
            page.until(lambda frame: frame["act_count"] == 1)
    assert "close_grab" in kinds_in(tmp_path / "block-2.recording")
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("name", ["messages", "figures"])
def test_a_page_whose_picture_cannot_be_told_is_let_go_alone(operated, name):
    browser, opened = operated
    with operator(browser, opened) as page, operator(browser, opened) as other:
        page.until(lambda frame: frame["step"] > 0)
        theatre = opened.places["operating"]
        stage, viewer = theatre._stage, next(iter(theatre._viewers.values()))

        def fail(newest):
            raise ZeroDivisionError("a fault")

        setattr(viewer, name, fail)
        assert "ZeroDivisionError" in json.dumps(page.hear("failed")["problems"])
        other.until(lambda frame, step=stage.live.newest.frame.step: frame["step"] > step)
        assert theatre._stage is stage
        assert viewer not in theatre._viewers.values()
        assert page.ask("undo")["kind"] == "refused"
        other.done("begin")
        other.until(lambda frame: frame["act_count"] == 0)


def shows(page, size):
    """Take messages until the page shows a block of this size in a new frame; whether it knows where its nodes are."""
    page.frames.clear()
    count = np.prod(np.array(size) + 1)
    page.until(lambda frame: page.topology[0]["node_count"] == count and frame["step"] > 0)
    return bool(np.isfinite(page.displacement).all())


@pytest.fixture
def rebuilt(tmp_path):
    """A block of 8 x 5 x 4 cells, and how another is built in its place."""
    case = write_case(tmp_path)
    return case, lambda size: write_bundle(case, block_case(size=size))


def test_who_opens_a_case_that_was_built_anew_sees_the_new_one_and_so_do_all_others(rebuilt, tmp_path):
    case, build = rebuilt
    with theatre(case, tmp_path) as (browser, opened), operator(browser, opened) as page:
        assert shows(page, (8, 5, 4))
        page.done("record")
        page.until(lambda frame: frame["recording"] is not None)
        page.done("take", tool="g")
        assert page.at("press", TOP)["used"]
        stage, live = opened.places["operating"]._stage, live_of(opened)
        # the same bytes again: nothing is disturbed
        build((8, 5, 4))
        with operator(browser, opened) as other:
            assert shows(other, (8, 5, 4))
        assert opened.places["operating"]._stage is stage
        build((6, 5, 4))
        with operator(browser, opened) as other:
            assert shows(other, (6, 5, 4))
            assert page.hear("opened")["box_mm"] == other.opened["box_mm"]
            assert "this is the new one" in page.hear("message")["message"]
            assert shows(page, (6, 5, 4))
            page.done("take", tool="g")
            assert page.at("press", TOP)["used"]
        assert live._thread is None
        assert open_recording(tmp_path / "block-1.recording").header.end is not None


def test_what_was_done_on_a_case_that_was_built_anew_is_kept(rebuilt, tmp_path):
    case, build = rebuilt
    with theatre(case, tmp_path) as (browser, opened):
        with operator(browser, opened) as page:
            assert shows(page, (8, 5, 4))
            page.done("take", tool="g")
            assert page.at("press", TOP)["used"]
            page.until(lambda frame: frame["act_count"] == 1)
            build((6, 5, 4))
            with operator(browser, opened) as other:
                assert shows(other, (6, 5, 4))
            while "kept in the recording block-1" not in page.hear("message")["message"]:
                pass
            assert "close_grab" in kinds_in(tmp_path / "block-1.recording")
            page.done("take", tool="g")
            assert page.at("press", TOP)["used"]
            page.until(lambda frame: frame["act_count"] == 1)
        build((8, 5, 4))
        # nobody looked: who comes next is told
        with operator(browser, opened) as page:
            assert "kept in the recording block-2" in page.hear("message")["message"]


def test_to_begin_anew_is_to_begin_with_the_case_as_it_is_now(rebuilt, tmp_path):
    case, build = rebuilt
    with theatre(case, tmp_path) as (browser, opened), operator(browser, opened) as page:
        assert shows(page, (8, 5, 4))
        build((6, 5, 4))
        assert "begin anew to see the new one" in page.hear("message")["message"]
        page.done("begin")
        assert shows(page, (6, 5, 4))
        # one that cannot be read is told, and the session goes on
        live = live_of(opened)
        (case / MANIFEST_NAME).write_text("{")
        assert page.ask("begin")["kind"] == "refused"
        with operator(browser, opened) as other:
            assert other.opened["kind"] == "failed"
        assert live_of(opened) is live
        step = page.frames[-1]["step"]
        page.until(lambda frame: frame["step"] > step)


def test_a_case_that_is_none_is_told_without_its_path(tmp_path):
    folder = tmp_path / "a-patient's-name.case"
    folder.mkdir()
    with theatre(folder, tmp_path) as (browser, opened), operator(browser, opened) as page:
        assert page.opened["kind"] == "failed"
        assert page.opened["problems"]
        assert "patient" not in json.dumps(page.opened)
        assert page.ask("undo")["kind"] == "refused"


@pytest.mark.parametrize("seed", range(5))
def test_frames_that_tell_what_moved_add_up_to_all_that_is(seed):
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 500))
    nodes, before, held = np.zeros((count, 3), np.float32), None, np.full((count, 3), np.nan)
    for turn in range(30):
        some = random.random(count) < random.choice([0.0, 0.01, 0.5])
        nodes[some] += random.normal(0.0, 2.0 if turn < 20 else 40.0, (some.sum(), 3)).astype(np.float32)
        now = Rounded.of(nodes, SCALE_LEAST if before is None else before.scale)
        assert np.abs(now.steps * now.scale - nodes).max() <= 0.5001 * now.scale
        header, arrays = unpacked(frame_message({}, now, before, {}))
        moved = {} if before is None else set(np.flatnonzero(some) // BLOCK_NODES)
        if before is not None and before.scale == now.scale:
            assert set(moved_blocks(now, before).tolist()) <= moved
        for block, steps in zip(arrays["blocks"], arrays["steps"], strict=True):
            part = held[block * BLOCK_NODES : (block + 1) * BLOCK_NODES]
            part[:] = steps[: len(part)] * header["scale"]
        before = now
        np.testing.assert_array_equal(held, now.steps * now.scale)


def test_a_page_hears_that_the_server_is_there_while_time_stands(operated):
    browser, opened = operated
    with operator(browser, opened) as page:
        page.done("pause", paused=True)
        page.until(lambda frame: frame["mode"] == "paused")
        for _ in range(4):
            page.hear("alive")
        page.done("pause", paused=False)


def test_signs_of_life_come_apart_and_often_enough_for_a_page():
    beat_s, sent = 0.05, []
    page = Page()

    class Socket:
        async def send_text(self, text):
            # on the server's side: whoever reads late finds several at once
            sent.append((time.monotonic(), text))
            if len(sent) == 4:
                page.send("what was waited for")

    began = time.monotonic()
    assert asyncio.run(app._next(page, Socket(), beat_s)) == "what was waited for"
    assert [text for _, text in sent] == [app._ALIVE] * 4
    assert (np.diff([began, *(when for when, _ in sent)]) > 0.9 * beat_s).all()
    silent_ms = re.search(r"SILENT_MS = (\d+);", (app.PAGE / "shared" / "connection.js").read_text())
    assert int(silent_ms[1]) / 1000 >= 4 * app._BEAT_S


def test_what_a_page_leads_can_be_left_to_let_go_softly(operated):
    browser, opened = operated
    with operator(browser, opened) as page:
        page.done("begin")
        page.done("take", tool="g")
        assert page.at("press", TOP)["used"]
        page.at("drag", (24.0, -14.0, 40.5))
        page.until(lambda frame: frame["instruments"])
        page.done("abandon")
        page.until(lambda frame: not frame["instruments"])
        assert page.at("drag", (24.0, -14.0, 40.5))["used"] is False
