"""What pages are told of recordings, branches and tours has a kind, by which a page says it in its language."""

import json
import shutil

import pytest

from heartcase.schemas.recording.header import HEADER_NAME
from tests.studio.operating.performing import operator, theatre
from tests.studio.operating.test_plans import recorded  # noqa: F401


def with_header(recording, to, change):
    """A copy of a recording whose header is changed as text."""
    shutil.copytree(recording, to)
    (to / HEADER_NAME).write_text(change((to / HEADER_NAME).read_text()))


def kinds(answer):
    """Kinds of what an answer was refused for."""
    assert answer["kind"] == "refused", answer
    return [one.get("code") for one in answer["problems"]]


def header_with(**values):
    return lambda text: json.dumps(json.loads(text) | values)


@pytest.fixture
def page(recorded, tmp_path):  # noqa: F811
    path, _ = recorded
    shutil.copytree(path.parent / "wide.recording", tmp_path / "wide.recording")
    with theatre(path, tmp_path) as (browser, opened), operator(browser, opened) as found:
        yield found


def test_a_recording_that_cannot_be_replayed(page, tmp_path):
    made = tmp_path / "wide.recording"
    changes = {
        "recording-no-json": lambda _: "{",
        "recording-foreign": lambda _: "{}",
        "recording-damaged": header_with(node_count=0),
        "recording-newer": header_with(format_version="9.0", software_version="7.1"),
        "recording-no-start": header_with(backend="reference"),
        "recording-other-case": header_with(lattice_sha256="0" * 64),
    }
    for code, change in changes.items():
        with_header(made, tmp_path / f"{code}.recording", change)
        answer = page.ask("replay", name=f"{code}.recording")
        assert kinds(answer) == [code], answer
        if code == "recording-newer":
            get = answer["problems"][0]["values"]["get"]
            assert (get["code"], get["values"]) == ("newer-one", {"version": "7.1"})
    first = shutil.copytree(made, tmp_path / "first.recording") / "state-000000.safetensors"
    first.write_bytes(first.read_bytes()[:-1] + b"x")
    assert kinds(page.ask("replay", name="first.recording")) == ["state-damaged"]


def test_a_name_that_no_recording_can_have(page):
    for to in ("a/b", "..", "a.b", " ", "x" * 81):
        assert kinds(page.ask("rename", name="wide.recording", to=to)) == ["recording-name"], to


def test_branches_and_tours_that_are_not_there(page):
    page.done("take_up", branch=99)
    assert page.hear("message")["code"] == "branch-gone"
    assert kinds(page.ask("tour", tour=99, step=None)) == ["tour-gone"]
