"""Building as the page drives it: stages, problems, what came of it, approval; and what a killed server leaves."""

import asyncio
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from websockets.sync.client import connect

from heartcase.library.progress import MAKING_THE_SCAN
from heartcase.pipeline.stages.table import steps
from heartcase.pipeline.warnings import CaseWarning, anatomy
from heartcase.schemas.bundle.approval import approval_state, bundle_sha256
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.files import TEMPORARY_PREFIX
from heartcase.studio.building.outcome import outcome_of
from heartcase.studio.building.process import BuildProcess
from tests.ball import write_ball_recipe, write_ball_scan
from tests.cli.small_case import write_case
from tests.studio.process import entered
from tests.studio.talking import TOKEN, line, page, studio

MUSCLE_STROKE = '\n[[strokes]]\nlabel = "muscle"\nradius_mm = 1.0\npoints_mm = [[12, 12, 0]]\n'


def ball(folder):
    write_ball_scan(folder / "scan.nii.gz")
    return write_ball_recipe(folder / "scan.nii.gz", folder / "ball.toml")


def building(browser):
    return line(browser, f"/building/{browser.opened.key}", first="build")


def until(told, check):
    """What is told, until it is so."""
    while not check(state := told.hear("build", "refused")):
        assert state["kind"] == "build", state
    return state


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A recipe that was built through the page, and all that the page was told meanwhile."""
    folder = tmp_path_factory.mktemp("built")
    path = ball(folder)
    with studio(path) as browser, building(browser) as told:
        assert told.first["case"] is None
        assert told.ask(do="operate")["problems"][0]["message"].startswith("there is no case yet")
        assert told.ask(do="cancel")["kind"] == "refused"
        told.ask(do="build")
        assert told.ask(do="build")["problems"][0]["message"].startswith("a build runs already")
        # the server answers meanwhile
        with page(browser) as painter:
            assert painter.opened["kind"] == "opened"
        until(told, lambda state: not state["is_running"] and state["case"])
    return path, told.told


@pytest.fixture
def copy(built, tmp_path):
    shutil.copytree(built[0].parent, tmp_path / "copy")
    return tmp_path / "copy" / built[0].name


def test_a_build_tells_its_stages_and_what_came_of_it(built):
    path, told = built
    states = [one for one in told if one["kind"] == "build" and one["steps"]]
    names = [step["stage"] for step in states[-1]["steps"]]
    assert names == [MAKING_THE_SCAN, *(step.name for step in steps())]
    ran = {step["stage"]: step["state"] for step in states[-1]["steps"]}
    # the recipe edits nothing, and its scan is not made
    assert {name for name, state in ran.items() if state == "waiting"} == {MAKING_THE_SCAN, "edit"}
    assert {state for name, state in ran.items() if name not in (MAKING_THE_SCAN, "edit", "filter")} == {"computed"}
    running = [one for one in states if any(step["state"] == "running" for step in one["steps"])]
    assert all(sum(step["state"] == "running" for step in one["steps"]) == 1 for one in running)
    assert all(one["expected"]["elapsed"] >= 0 for one in running)
    # nothing is known of the first build: no seconds are said
    assert all(one["expected"]["left"] is None for one in running)
    end = states[-1]
    assert (end["changed"], end["age"], end["problems"]) == (True, "current", [])
    case = path.parent / "out" / "ball.case"
    assert check_bundle(case) == ()
    manifest = open_bundle(case).manifest
    assert end["case"]["sha256"] == bundle_sha256(case)
    assert end["case"]["volumes_ml"] == {
        name: pytest.approx(manifest.quality["volumes_ml"][name]) for name in ("cavity", "muscle")
    }
    # 4/3 pi 14 mm cubed
    assert end["case"]["volumes_ml"]["cavity"] == pytest.approx(4 / 3 * np.pi * 14**3 / 1000, rel=0.05)


@pytest.mark.thorough
def test_the_page_is_told_when_the_case_is_older_than_the_recipe(copy):
    text = copy.read_text()
    with studio(copy) as browser, building(browser) as told:
        # also after a restart
        assert told.first["age"] == "current"
        copy.write_text(text + MUSCLE_STROKE)
        until(told, lambda state: state["age"] == "older")
        copy.write_text(text)
        until(told, lambda state: state["age"] == "current")
        # nothing changed: nothing is computed but what no cache keeps
        told.ask(do="build")
        state = until(told, lambda state: not state["is_running"])
        assert (state["changed"], state["age"]) == (False, "current")
        ran = {step["stage"]: step["state"] for step in state["steps"]}
        assert {ran[name] for name in ("filter", "segment", "walls", "grid", "surface", "map", "report")} == {"reused"}


def test_a_case_of_a_recipe_that_was_renamed_is_the_one_that_is_shown_opened_and_approved(copy):
    case, other = copy.parent / "out" / "ball.case", copy.parent / "out" / "other.case"
    shutil.copytree(case, other)
    with studio(copy) as browser, building(browser) as told:
        sha256 = told.first["case"]["sha256"]
        at_first = told.ask(do="operate")["address"]
        for name in ("other", "nowhere"):
            copy.write_text(re.sub(r'^name = ".*"$', f'name = "{name}"', copy.read_text(), count=1, flags=re.MULTILINE))
            state = until(told, lambda state: state["age"] == "older")
            assert state["case"]["name"] == "ball"
            assert told.ask(do="operate")["address"] == at_first
        told.ask(do="approve", role="consultant cardiologist", sha256=sha256, has_looked=True)
    assert approval_state(case).state == "approved"
    assert approval_state(other).state == "draft"


def test_a_case_of_unknown_recipe_is_told_as_that(copy):
    shutil.rmtree(copy.parent / "out" / ".heartcase-cache")
    with studio(copy) as browser, building(browser) as told:
        assert (told.first["age"], told.first["case"]["name"]) == ("unknown", "ball")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"bundle_sha256": 1}', '{"places_mm": {"x": 5}}', "\xff"])
def test_a_damaged_note_counts_as_none(copy, text):
    (note,) = (copy.parent / "out" / ".heartcase-cache" / "studio").glob("*.built.json")
    note.write_text(text, encoding="latin-1")
    with studio(copy) as browser, building(browser) as told:
        assert (told.first["age"], told.first["case"]["name"]) == ("unknown", "ball")


def test_problems_are_told_with_their_places_and_the_old_case_stays(copy):
    case = copy.parent / "out" / "ball.case"
    before = bundle_sha256(case)
    with studio(copy) as browser, building(browser) as told:
        copy.write_text(copy.read_text().replace('label = "muscle"', 'label = "bone"'))
        told.ask(do="build")
        state = until(told, lambda state: not state["is_running"] and state["problems"])
        assert state["problems"][0]["place"].startswith("strokes")
        assert "bone" in state["problems"][0]["message"]
        assert state["case"]["sha256"] == before
    assert bundle_sha256(case) == before


def test_a_cancelled_build_leaves_the_old_case(copy):
    case = copy.parent / "out" / "ball.case"
    before = bundle_sha256(case)
    copy.write_text(copy.read_text() + MUSCLE_STROKE)
    with studio(copy) as browser, building(browser) as told:
        told.ask(do="build")
        until(told, lambda state: any(step["state"] == "computed" for step in state["steps"]))
        told.ask(do="cancel")
        state = until(told, lambda state: not state["is_running"])
        assert state["is_cancelled"]
        assert state["problems"] == []
        assert (state["case"]["sha256"], state["age"]) == (before, "older")
    assert bundle_sha256(case) == before
    assert not list((copy.parent / "out").glob(f"{TEMPORARY_PREFIX}*"))


def test_a_case_is_approved_in_a_role_once_it_was_looked_at(copy):
    case = copy.parent / "out" / "ball.case"
    with studio(copy) as browser, building(browser) as told:
        sha256 = told.first["case"]["sha256"]
        order = {"do": "approve", "role": "consultant cardiologist", "sha256": sha256}
        assert "read the report" in told.ask(**order)["problems"][0]["message"]
        assert told.ask(**order | {"has_looked": True, "sha256": "0" * 64})["kind"] == "refused"
        assert "name" in told.ask(**order | {"has_looked": True, "role": "Dr. Jane Doe"})["problems"][0]["message"]
        assert approval_state(case).state == "draft"
        assert told.ask(**order, has_looked=True)["kind"] == "done"
        state = told.hear("build")
        assert state["case"]["approval"]["state"] == approval_state(case).state == "approved"
        told.ask(**order | {"do": "withdraw"})
        assert approval_state(case).state == "draft"


def test_the_report_is_served_to_the_page_alone_and_runs_nothing(copy):
    with studio(copy) as browser:
        address = f"/report/{browser.opened.key}"
        # before a page asked how the case stands there is none to show
        with building(browser):
            answer = browser.get(address)
            assert answer.status_code == 200
            assert answer.content == (copy.parent / "out" / "ball.report.html").read_bytes()
            policy = answer.headers["content-security-policy"]
            assert "script-src" not in policy
            assert policy.startswith("default-src 'none'; style-src 'unsafe-inline'; img-src data:")
            assert policy.endswith("sandbox")
            assert browser.get("/report/nothing").status_code == 303
            browser.cookies.clear()
            assert browser.get(address).status_code == 403
            assert browser.get(address, params={"token": TOKEN + "x"}).status_code == 403


@pytest.mark.parametrize(
    "request_", [{"do": "paint"}, {"do": "approve"}, {}, {"do": "approve", "role": "x" * 101, "sha256": "0" * 64}]
)
def test_other_requests_are_refused(copy, request_):
    with studio(copy) as browser, building(browser) as told:
        assert told.ask(**request_)["kind"] == "refused"


def test_warnings_have_the_places_that_the_build_or_their_sentence_tells(tmp_path):
    case, _ = write_case(
        tmp_path, warnings=[CaseWarning("a hole at (1.0, -2.5, 30.0), (4, 5, -6) mm (4.5 cm)"), anatomy("odd")]
    )
    found = outcome_of(case).figures["warnings"]
    assert [one["grade"] for one in found] == ["anatomy", "look"]
    assert [one["places_mm"] for one in found] == [[], [[1.0, -2.5, 30.0], [4.0, 5.0, -6.0]]]
    told = outcome_of(case, {"odd": [(7.0, 8.0, 9.0)]}).figures["warnings"]
    assert told[0]["places_mm"] == [[7.0, 8.0, 9.0]]
    assert outcome_of(tmp_path / "nothing.case") is None


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("ending", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
@pytest.mark.thorough
def test_a_server_that_ends_ends_its_build_and_leaves_the_old_case_whole(copy, ending, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(copy.parent / "state"))
    out = copy.parent / "out"
    before = bundle_sha256(out / "ball.case")
    copy.write_text(copy.read_text() + MUSCLE_STROKE)
    command = [sys.executable, "-m", "heartcase", "studio", str(copy), "--out", str(out), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        address = re.search(r"http://\S+", server.stdout.readline())[0]
        host, key = re.search(r"http://(\S+)/prepare/(\S+)\?", address).groups()
        _, headers = entered(address)
        with connect(f"ws://{host}/building/{key}", origin=f"http://{host}", additional_headers=headers) as page:
            page.send('{"id": 1, "do": "build"}')
            while '"computed"' not in page.recv(timeout=60):
                pass
        builders = psutil.Process(server.pid).children(recursive=True)
        assert any("heartcase.studio.building.work" in " ".join(one.cmdline()) for one in builders)
        # nobody who looks at the list of processes learns of whom the scan is
        assert not any(str(copy.parent) in " ".join(one.cmdline()) for one in builders)
        server.send_signal(ending)
        server.wait(timeout=30)
    _, alive = psutil.wait_procs(builders, timeout=30)
    assert [one for one in alive if one.status() != psutil.STATUS_ZOMBIE] == []
    assert bundle_sha256(out / "ball.case") == before
    # and the next start says how it stands
    with studio(copy) as browser, building(browser) as told:
        assert (told.first["case"]["sha256"], told.first["age"]) == (before, "older")


def test_what_a_build_notes_holds_no_path(built):
    path, told = built
    assert str(path.parent) not in json.dumps(told)


@pytest.mark.thorough
def test_what_lies_in_the_folder_that_it_was_started_in_is_not_run(copy, monkeypatch):
    """A folder that came from elsewhere may hold anything."""
    folder = copy.parent / "came"
    folder.mkdir()
    for name in ("tomllib.py", "heartcase.py", "sitecustomize.py"):
        (folder / name).write_text("open('it_ran', 'w').close()\nraise SystemExit(3)\n")
    monkeypatch.chdir(folder)

    async def news():
        return [one async for one in BuildProcess(copy, copy.parent / "out").news()]

    told = asyncio.run(news())
    assert told
    assert not (folder / "it_ran").exists()


def test_a_case_with_odd_figures_is_none(copy, monkeypatch):
    case = copy.parent / "out" / "ball.case"
    assert outcome_of(case) is not None
    odd = open_bundle(case)
    quality = dict(odd.manifest.quality) | {"openings": [{"area_mm2": 1.0}]}
    changed = SimpleNamespace(manifest=odd.manifest.model_copy(update={"quality": quality}))
    monkeypatch.setattr("heartcase.studio.building.outcome.open_bundle", lambda path: changed)
    assert outcome_of(case) is None
