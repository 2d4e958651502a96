"""A case saved from its page as one HTML file, with the recordings that are chosen."""

from __future__ import annotations

import json
import threading

import pytest

from heartcase.schemas.errors import UsageError
from heartcase.studio.offline.exported import fitting_page_of, page_of
from heartcase.studio.operating.saved_page import SavedPage, told_seldom
from tests.studio.operating.performing import operator, theatre
from tests.studio.operating.test_plans import recorded  # noqa: F401


def told(page):
    """What was told of the saved page last, when it is no longer being saved."""
    while not (found := [one for one in page.told if one["kind"] == "saved_page"]) or found[-1]["state"] == "working":
        page.next()
    return found[-1]


def until(page, is_meant):
    """Wait until a page was told this of the page that is saved."""
    while not any(one["kind"] == "saved_page" and is_meant(one) for one in page.told):
        page.next()


def test_a_case_is_saved_as_the_command_exports_it(recorded):  # noqa: F811
    path, _ = recorded
    (path.parent / "hollow.html").write_text("mine")
    with theatre(path, path.parent) as (browser, opened), operator(browser, opened) as page:
        assert browser.get(f"/saved/{opened.key}", follow_redirects=False).status_code == 303
        assert page.ask("save_page", names=["none.recording"])["kind"] == "refused"
        page.done("save_page", names=["wide.recording"])
        one = told(page)
        assert (one["state"], one["problems"]) == ("saved", [])
        parts = [each["fraction"] for each in page.told if each.get("fraction") is not None]
        # a page that is slow hears of some of them alone
        assert parts == sorted(parts)
        assert all(0.0 < part <= 1.0 for part in parts)
        # a file that was there stays
        assert one["name"] == "hollow-2.html"
        assert (path.parent / "hollow.html").read_text() == "mine"
        content = (path.parent / "hollow-2.html").read_bytes()
        assert one["byte_count"] == len(content)
        heard = []
        recordings = [path.parent / "wide.recording"]
        wanted = page_of(path, recordings, level=0, frames_per_second=10.0, told=heard.append).content
        assert heard == sorted(heard)
        assert 0.0 < heard[0] < heard[-1] == pytest.approx(1.0)
        assert content == wanted
        answer = browser.get(f"/saved/{opened.key}")
        assert answer.content == content
        assert answer.headers["content-disposition"] == 'attachment; filename="hollow-2.html"'
        # who comes later is told as well
        with operator(browser, opened) as other:
            assert other.hear("saved_page") == one
        (path.parent / "broken.recording").mkdir(exist_ok=True)
        page.told.clear()
        page.done("save_page", names=["broken.recording"])
        lost = told(page)
        assert lost["state"] == "failed"
        assert lost["problems"]
        assert str(path.parent) not in json.dumps(lost)
        assert not (path.parent / "hollow-3.html").exists()


def test_a_page_that_is_being_saved_can_be_left(recorded):  # noqa: F811
    path, _ = recorded
    before = {one.name for one in path.parent.glob("*.html")}
    with theatre(path, path.parent) as (browser, opened), operator(browser, opened) as page:
        page.done("save_page", names=["wide.recording"])
        until(page, lambda one: one.get("state") == "working")
        page.told.clear()
        page.done("leave_page")
        until(page, lambda one: "state" not in one and "fraction" not in one)
        # nothing to leave any more, and another can be saved
        page.done("leave_page")
        page.told.clear()
        page.done("save_page")
        saved = told(page)
        assert saved["state"] == "saved"
        # what was saved can still be had where the next is left
        page.told.clear()
        page.done("save_page", names=["wide.recording"])
        until(page, lambda one: one.get("state") == "working")
        page.done("leave_page")
        assert told(page) == saved
    assert len({one.name for one in path.parent.glob("*.html")} - before) == 1


def test_a_page_that_cannot_be_written_is_told(recorded, tmp_path):  # noqa: F811
    path, _ = recorded
    heard = threading.Event()
    saved = SavedPage(
        path, tmp_path / "none", fitting_page_of, lambda: saved.facts["state"] != "working" and heard.set()
    )
    saved.save([])
    assert heard.wait(120.0)
    assert saved.facts["state"] == "failed"
    words = "it cannot be written: No such file or directory"
    of_kind = {"code": "page-unwritable", "values": {"why": "No such file or directory"}}
    assert saved.facts["problems"] == [{"place": "page", "message": words} | of_kind]
    saved.close()


def test_a_page_is_not_saved_in_a_case(recorded):  # noqa: F811
    path, _ = recorded
    before = set(path.iterdir())
    saved = SavedPage(path, path, fitting_page_of, lambda: None)
    with pytest.raises(UsageError, match="lies in one"):
        saved.save([])
    assert saved.facts == {}
    assert set(path.iterdir()) == before


def test_what_is_left_on_the_way_is_neither_told_nor_there(recorded):  # noqa: F811
    path, _ = recorded
    saved = SavedPage(path, path.parent, fitting_page_of, lambda: None)
    before = set(path.parent.iterdir())
    saved.save([])
    assert saved.facts == {"state": "working"}
    saved.close()
    assert saved.facts == {}
    assert saved.file is None
    assert set(path.parent.iterdir()) == before


def test_what_is_done_is_told_by_hundredths():
    heard = []
    tell = told_seldom(heard.append)
    for part in (0.0, 0.004, 0.012, 0.013, 0.5, 0.5, 1.0):
        tell(part)
    assert heard == [0.012, 0.5, 1.0]
