"""Figures of an incision, plans side by side and a haptic device, on the page in a real browser."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.studio.operating import plans
from tests.hollow_case import hollow_case
from tests.studio.axe.accessible import assert_accessible
from tests.studio.page.browsing import browsing, until
from tests.studio.page.test_operating import CaseServer, Hands


@pytest.fixture
def hollow(tmp_path):
    write_bundle(tmp_path / "hollow.case", hollow_case())
    server = CaseServer(tmp_path / "hollow.case")
    server.start()
    yield server
    server.stop()


@pytest.mark.slow
def test_incisions_are_cut_held_compared_and_played_side_by_side_and_a_device_pulls(chromium, hollow, monkeypatch):
    monkeypatch.setattr(plans, "REACHES", False)
    with browsing(chromium, hollow, viewport={"width": 1366, "height": 768}) as page:
        hands, tab = Hands(page), page.tab
        tab.locator("#tab-figures").click()
        for number in (1, 2):
            tab.locator("#record").click()
            hands.until(lambda header: header["recording"] == "hollow-1.recording")
            tab.locator("#planned-cuts button").click()
            hands.until(lambda header: header["act_count"] == 1)
            if number == 1:
                # in the panel and over the heart; all hands are one act, and let go at once
                tab.locator("#hold-last").click()
                hands.until(lambda header: len(header["instruments"]) == 4)
                tab.locator("#hold-last").wait_for(state="hidden")
                tab.locator("#undo").click()
                hands.until(lambda header: header["act_count"] == 1 and header["mode"] == "paused")
                # the space bar goes on, and presses no button that was clicked
                tab.keyboard.press("Space")
                hands.until(lambda header: header["mode"] == "running")
                tab.locator("#hold-open").click()
                hands.until(lambda header: len(header["instruments"]) == 4)
                tab.locator("#let-go-all").click()
                hands.until(lambda header: not header["instruments"])
                assert tab.locator("#let-go-all").is_hidden()
                tab.locator("#hold-last").click()
                hands.until(lambda header: len(header["instruments"]) == 4)
                until(lambda: float(cell(page, "Gap between the lips").split()[0]) > 5.0)
                assert float(cell(page, "Rim seen").split()[0]) > 50.0
                assert "N" in cell(page, "Force of retraction")
                assert_accessible(page, "figures")
            tab.locator("#record").click()
            hands.until(lambda header: header["recording"] is None)
            tab.locator("#tab-recordings").click()
            tab.locator("#recordings li").nth(number - 1).wait_for()
            if number == 1:
                rename(tab, 0, "held open")
                tab.locator("#begin").click()
                hands.until(lambda header: header["act_count"] == 0)
                tab.locator("#tab-figures").click()
                tab.locator("#figures-none").wait_for()
        # both in one table, and in two panes
        for name in ("held open", "hollow-1"):
            tab.get_by_label(f"Choose {name} to compare it").check()
        tab.locator("#compare").click()
        until(lambda: tab.locator("#plans-table thead th").count() == 2 and page.text("#plans-state") == "", 120.0)
        table = page.text("#plans-table")
        assert "held open" in table
        assert "Score" in table
        # the same recordings, in one file to hand on
        tab.locator("#save-page").click()
        tab.locator("#saved-page").wait_for(timeout=120_000.0)
        assert tab.locator("#saved-page").inner_text() == "Download hollow.html"
        with tab.expect_download() as taken:
            tab.locator("#saved-page").click()
        assert taken.value.path().stat().st_size > 100_000
        tab.locator("#side-by-side").click()
        until(lambda: page.text("#beside-title") == "hollow-1" and " of " in page.text("#beside-time"))
        hands.until(lambda header: header["mode"] == "paused" and header["act_count"] == 13)
        beside = hollow.opened.places["beside"]
        until(lambda: beside._stage.live.newest.mode == "paused" and beside._stage.live.newest.act_count == 1)
        page.drawn()
        # seen from the same eye, the same but for what is held
        one, other = (np.frombuffer(tab.locator(which).screenshot(), np.uint8) for which in ("#scene", "#beside-scene"))
        assert one.shape != other.shape or (one != other).any()
        assert_accessible(page, "side by side")
        tab.locator("#beside-close").click()
        assert tab.locator("#beside").is_hidden()
        until(lambda: not beside._viewers)
        # a device in the middle of the picture
        tab.locator("#tab-forces").click()
        tab.locator("#device-start").click()
        hands.until(lambda header: header["device"] and header["device"]["holds"])
        until(lambda: "N on the hand" in page.text("#device-state"))
        assert_accessible(page, "device")
        tab.locator("#device-start").click()
        hands.until(lambda header: header["device"] is None)


def cell(page, label):
    """The figure in a row of the table beside the heart."""
    rows = page.tab.locator("#figures tr").filter(has=page.tab.get_by_role("rowheader", name=label, exact=True))
    rows.first.wait_for(timeout=60_000)
    return rows.first.locator("td").inner_text()


def rename(tab, number, name):
    tab.locator("#recordings li").nth(number).get_by_role("button", name="Rename").click()
    tab.locator("#recordings input[type=text]").fill(name)
    tab.keyboard.press("Enter")
    tab.get_by_label(f"Choose {name} to compare it").wait_for()
