"""A recording that is not finished is replayed, compared and saved as far as it is whole, and that is said."""

import json

from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.simulation import Simulation
from tests.studio.operating.performing import operator, theatre
from tests.studio.operating.short import cut_short
from tests.studio.operating.test_plans import newest, recorded  # noqa: F401
from tests.studio.operating.test_saved_page import told


def test_as_far_as_it_is_whole(recorded):  # noqa: F811
    path, _ = recorded
    short = open_recording(cut_short(path.parent / "wide.recording", path.parent / "short.recording"), partial=True)
    whole = open_recording(path.parent / "wide.recording")
    assert 0.0 < short.seconds < whole.seconds
    with theatre(path, path.parent) as (browser, opened), operator(browser, opened) as page:
        answer = page.done("recordings")
        assert {"short.recording", "wide.recording"} <= set(answer["recordings"])
        assert answer["unfinished"] == ["short.recording"]
        assert page.done("replay", name="short.recording", speed=4.0)["shown_s"] == short.seconds
        page.until(lambda frame: frame["mode"] == "paused" and frame["step"] == short.end_step)
        assert "shown_s" not in page.done("replay", name="wide.recording")
        page.done("compare", names=["short.recording", "wide.recording"])
        about = newest(page)["about"]
        assert about["short.recording"]["shown_s"] == short.seconds
        assert about["wide.recording"]["shown_s"] is None
        page.told.clear()
        page.done("save_page", names=["short.recording"])
        saved = told(page)
        assert saved["state"] == "saved", saved
        problem = saved["problems"][0]
        assert (problem["place"], problem["code"]) == ("short", "recording-not-whole")
        assert problem["values"] == {"seconds": f"{short.seconds:.1f}"}


def test_one_that_is_being_recorded_is_finished_before(recorded):  # noqa: F811
    path, _ = recorded
    with theatre(path, path.parent) as (browser, opened), operator(browser, opened) as page:
        page.done("record")
        name = page.until(lambda frame: frame["recording"] is not None)["recording"]
        assert name not in page.done("recordings")["unfinished"]
        page.until(lambda frame: frame["time_s"] > 0.2)
        assert "shown_s" not in page.done("replay", name=name)
        page.until(lambda frame: frame["recording"] is None and frame["mode"] == "paused")
        assert open_recording(path.parent / name).is_whole


def test_one_that_is_being_recorded_is_neither_ended_unasked_nor_compared_or_saved(recorded):  # noqa: F811
    path, _ = recorded
    with theatre(path, path.parent) as (browser, opened), operator(browser, opened) as page:
        page.done("record")
        name = page.until(lambda frame: frame["recording"] is not None)["recording"]
        page.until(lambda frame: frame["time_s"] > 0.2)
        for do in ("compare", "save_page"):
            refused = page.ask(do, names=["wide.recording", name])
            assert [one["code"] for one in refused["problems"]] == ["recording-busy"], refused
        # the session goes on into it
        since = page.frames[-1]["frame"]
        page.until(lambda frame: frame["frame"] > since and frame["recording"] == name)
        page.done("stop_recording")
        page.until(lambda frame: frame["recording"] is None)
        page.told.clear()
        page.done("save_page", names=[name])
        saved = told(page)
        assert (saved["state"], saved["problems"]) == ("saved", [])


def test_one_that_another_program_records_is_told_as_not_finished(recorded):  # noqa: F811
    path, case = recorded
    session = OperatingSession(Simulation(case.model, surface=case.surface, tissue=case.tissue))
    with (
        Recorder(session, path.parent / "theirs.recording", case=case.manifest),
        theatre(path, path.parent) as (browser, opened),
        operator(browser, opened) as page,
    ):
        session.take([], 25)
        assert "theirs.recording" in page.done("recordings")["unfinished"]
        page.done("save_page", names=["theirs.recording"])
        saved = told(page)
        assert saved["state"] == "saved"
        assert [(one["place"], one["code"]) for one in saved["problems"]] == [("theirs", "recording-not-whole")]
        assert "cut short" not in json.dumps(saved)
    assert open_recording(path.parent / "theirs.recording").is_whole
