"""A case that no page has open for some time leaves the memory, and nothing that was done is lost."""

from __future__ import annotations

import gc
import time
import weakref

import numpy as np
import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recording.reader import open_recording
from heartcase.studio import idle
from heartcase.studio.operating import slices
from heartcase.studio.operating.scene.scan_slices import ScanSlices
from tests.factories import block_case
from tests.simulator.live.scenes import until, write_case
from tests.studio.operating.performing import operator, theatre

TOP = (22.0, -14.0, 40.5)


@pytest.fixture
def soon(monkeypatch):
    monkeypatch.setattr(idle, "FREE_AFTER_S", 0.3)


def stage_of(opened):
    return opened.places["operating"]._stage


def pull(page):
    page.done("take", tool="g")
    assert page.at("press", TOP)["used"]
    page.at("drag", (25.0, -14.0, 40.5))
    page.until(lambda frame: frame["instruments"] and frame["instruments"][0]["center_mm"][0] > 24.9)


def test_what_was_done_is_kept_in_a_recording_that_goes_on(soon, operated_case, tmp_path, monkeypatch):
    scan = ScanSlices(np.zeros((4, 4, 4), np.float32), Geometry(size=(4, 4, 4)))
    monkeypatch.setattr(slices, "open_scan", lambda case, recipe: scan)
    with theatre(operated_case, tmp_path) as (browser, opened):
        with operator(browser, opened) as page:
            page.until(lambda frame: frame["step"] > 0)
            page.done("tours")
            page.done("slice", name="axial", point_mm=[1, 1, 1], right=[1, 0, 0], down=[0, 1, 0])
        # nothing was done: it is freed, and nothing is written
        case = weakref.ref(stage_of(opened)._case.model)
        until(lambda: stage_of(opened) is None)
        until(lambda: gc.collect() >= 0 and case() is None)
        assert list(tmp_path.iterdir()) == []
        with operator(browser, opened) as page:
            assert page.hear("message")["message"].endswith("this is its beginning")
            pull(page)
            act_count = page.frames[-1]["act_count"]
        until(lambda: stage_of(opened) is None)
        with operator(browser, opened) as page:
            assert "kept in the recording block-1: replay it to go on" in page.hear("message")["message"]
            page.until(lambda frame: frame["act_count"] == 0)
            page.done("replay", name="block-1.recording")
            # the page was lost, so its hand let go softly: that is done again, too
            page.until(lambda frame: frame["mode"] == "paused" and frame["act_count"] == act_count + 1)
        # what a recording has already is not written again
        until(lambda: stage_of(opened) is None)
        assert [one.name for one in tmp_path.iterdir()] == ["block-1.recording"]
        assert open_recording(tmp_path / "block-1.recording").header.end is not None


def test_what_is_recorded_or_cannot_be_kept_stays_and_so_does_what_is_open(soon, operated_case, tmp_path):
    with theatre(operated_case, tmp_path) as (browser, opened):
        with operator(browser, opened) as page:
            page.until(lambda frame: frame["step"] > 0)
            time.sleep(0.6)
            assert stage_of(opened) is not None
            page.done("record")
            page.until(lambda frame: frame["recording"] is not None)
        stage = stage_of(opened)
        time.sleep(0.8)
        assert stage_of(opened) is stage
        with operator(browser, opened) as page:
            page.done("stop_recording")
            page.until(lambda frame: frame["recording"] is None)
            pull(page)
            stage._out = tmp_path / "gone"
        time.sleep(1.5)
        assert stage_of(opened) is stage
        with operator(browser, opened) as page:
            page.until(lambda frame: frame["act_count"] > 0)


def test_a_replay_is_of_the_case_as_it_lies_there_now(tmp_path):
    case = write_case(tmp_path)
    with theatre(case, tmp_path) as (browser, opened), operator(browser, opened) as page:
        page.done("record")
        pull(page)
        page.done("stop_recording")
        page.until(lambda frame: frame["recording"] is None)
        nodes = len(page.displacement)
        write_bundle(case, block_case(size=(6, 5, 4)))
        # the recording is of the case before: it is refused, and the page is shown the new case
        page.number += 1
        page.socket.send_text(f'{{"id": {page.number}, "do": "replay", "name": "block-1.recording"}}')
        assert page.hear("opened")["name"] == "block"
        assert "the case that was recorded" in page.hear("refused")["problems"][0]["message"]
        page.until(lambda frame: len(page.displacement) < nodes and frame["act_count"] == 0)
        # built as it was, it plays
        write_bundle(case, block_case(size=(8, 5, 4)))
        page.done("replay", name="block-1.recording")
        page.until(lambda frame: frame["mode"] == "paused" and len(page.displacement) == nodes)
        assert page.frames[-1]["act_count"] == 1
