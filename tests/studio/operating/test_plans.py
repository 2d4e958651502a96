"""Recordings as plans: named, compared by their figures, and a second session for two side by side."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.background.recorded_figures import figures_of_recording
from heartcase.simulator.incisions.figures import ranked
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.planned_incisions import on_case, parse_plans, run_plan
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.simulation import Simulation
from heartcase.studio.operating import plans
from heartcase.studio.operating.live_figures import told_figures
from tests.hollow_case import hollow_case
from tests.simulator.live.scenes import load, until
from tests.studio.operating.performing import Operator, operator, theatre
from tests.studio.talking import ADDRESS, PORT

PLANS = """\
heartcase_plans = 1
[shaft]
spacing_mm = 8.0
depth_mm = 20.0
[[plans]]
name = "wide"
cuts = [{ landmark = "lid" }]
retraction = { spread_mm = 6.0, lift_mm = 2.0, radius_mm = 4.5 }
[[plans]]
name = "alone"
cuts = [{ landmark = "lid" }]
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A case, with the recordings of two plans that a script ran; what each came to."""
    path = tmp_path_factory.mktemp("hollow") / "hollow.case"
    write_bundle(path, hollow_case())
    case = load(path)
    on = on_case(parse_plans(PLANS), case.manifest.landmarks)
    for plan in on.runs:
        session = OperatingSession(Simulation(case.model, surface=case.surface, tissue=case.tissue, damping_per_s=30.0))
        with Recorder(session, path.parent / f"{plan.name}.recording", case=case.manifest):
            plan = plan.model_copy(update={"settle_s": 0.05, "open_s": 0.1, "hold_s": 0.05})
            run_plan(plan, on, case, session)
    return path, case


def newest(page):
    """What was told of plans last, when all of it is known."""
    while not any(one["kind"] == "plans" for one in page.told) or told_last(page)["is_working"]:
        page.next()
    return told_last(page)


def told_last(page):
    return [one for one in page.told if one["kind"] == "plans"][-1]


def test_recordings_of_scripts_are_compared_as_the_command_compares_plans(recorded, monkeypatch):
    path, case = recorded
    monkeypatch.setattr(plans, "REACHES", False)
    found = {
        name: figures_of_recording(case, open_recording(path.parent / f"{name}.recording"), reaches=False)
        for name in ("wide", "alone")
    }
    (path.parent / "broken.recording").mkdir(exist_ok=True)
    with theatre(path, path.parent) as (browser, opened), operator(browser, opened) as page:
        page.until(lambda frame: frame["step"] > 0)
        assert page.ask("compare", names=["none.recording"])["kind"] == "refused"
        names = ["wide.recording", "alone.recording", "broken.recording"]
        page.done("compare", names=names)
        # time stands meanwhile
        page.until(lambda frame: frame["mode"] == "paused")
        told = newest(page)
        assert told["names"] == names
        (hole,) = told["defects"]
        assert hole["name"] == "hole"
        for name, one in found.items():
            expected = json.loads(json.dumps(told_figures(one.defects["hole"])))
            assert hole["figures"][f"{name}.recording"] == expected
            assert told["about"][f"{name}.recording"]["incision"] == "lid"
        order = ranked([replace(one.defects["hole"], name=f"{name}.recording") for name, one in found.items()])
        assert [one["name"] for one in hole["ranked"]] == [one.figures.name for one in order]
        assert [one["score"] for one in hole["ranked"]] == [one.score for one in order]
        assert told["problems"]["broken.recording"]
        assert str(path.parent) not in json.dumps(told)
        # what is known is not worked out again, and stands in one message
        page.done("compare", names=names[:2])
        again = newest(page)
        assert again["defects"] == told["defects"]
        # who comes later is told as well
        with operator(browser, opened) as other:
            assert other.hear("plans") == again


def test_what_is_left_on_the_way_is_not_told_as_under_way(recorded):
    path, _ = recorded
    compared = plans.ComparedPlans(path, path.parent, lambda: None)
    assert not compared.is_comparing
    compared.compare(["wide.recording"])
    compared.close()
    assert compared.is_comparing
    assert not json.loads(compared.message())["is_working"]


def test_a_recording_is_given_another_name(recorded, tmp_path):
    path, _ = recorded
    with theatre(path, tmp_path) as (browser, opened), operator(browser, opened) as page:
        page.done("record")
        page.until(lambda frame: frame["recording"] is not None)
        assert "is being recorded" in json.dumps(page.ask("rename", name="hollow-1.recording", to="mine"))
        page.done("stop_recording")
        page.until(lambda frame: frame["recording"] is None)
        found = page.done("rename", name="hollow-1.recording", to="über den Vorhof (2)")
        assert found["recordings"] == ["über den Vorhof (2).recording"]
        assert (tmp_path / "über den Vorhof (2).recording").is_dir()
        for to in ("../out", "a/b", "a.b", "", " ", "x" * 81, "über den Vorhof (2)"):
            assert page.ask("rename", name="über den Vorhof (2).recording", to=to)["kind"] == "refused", to
        assert [one.name for one in tmp_path.iterdir()] == ["über den Vorhof (2).recording"]


def test_another_recording_is_played_in_a_session_beside(recorded):
    path, _ = recorded
    with theatre(path, path.parent) as (browser, opened), operator(browser, opened) as page:
        assert opened.places["beside"]._stage is None
        url = f"ws://127.0.0.1:{PORT}/beside/{opened.key}"
        with browser.websocket_connect(url, headers={"origin": ADDRESS}) as socket:
            other = Operator(socket)
            assert other.hear("opened")["name"] == "hollow"
            page.done("replay", name="wide.recording")
            other.done("replay", name="alone.recording")
            for one, instruments in ((page, 2), (other, 0)):
                one.until(lambda frame: frame["mode"] == "paused" and frame["act_count"] > 0)
                assert len(one.frames[-1]["instruments"]) == instruments
        until(lambda: not opened.places["beside"]._viewers)
