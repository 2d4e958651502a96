"""A server that stands still while tissue is held: the page says so, and goes on by itself when it answers."""

import os
import signal

import pytest

from tests.simulator.live.scenes import write_case
from tests.studio.page.browsing import WAIT_MS
from tests.studio.page.test_operating import TOP, Hands
from tests.studio.process import started


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="this system cannot stop a process and let it go on")
@pytest.mark.parametrize(
    ("locale", "words", "runs"), [("en-GB", "does not answer", "Running"), ("de-DE", "antwortet nicht", "Läuft")]
)
def test_it_is_told_and_goes_on(chromium, tmp_path, locale, words, runs):
    with started(write_case(tmp_path)) as (process, address):
        context = chromium.new_context(locale=locale, viewport={"width": 1366, "height": 768})
        tab = context.new_page()
        tab.goto(address)
        tab.locator("body[data-ready=true]").wait_for(timeout=WAIT_MS)
        page = type("Page", (), {"tab": tab})
        hands = Hands(page)
        hands.from_above()
        tab.keyboard.press("g")
        hands.drag(TOP, (27.0, -14.0, 40.5))
        hands.until(lambda header: header["instruments"])
        os.kill(process.pid, signal.SIGSTOP)
        try:
            tab.locator("#lost").get_by_text(words).wait_for(timeout=10_000)
            assert tab.locator("body").get_attribute("data-ready") == "false"
            assert tab.locator("#mode").inner_text() == ""
        finally:
            os.kill(process.pid, signal.SIGCONT)
        tab.locator("#lost").wait_for(state="hidden", timeout=30_000)
        tab.locator("body[data-ready=true]").wait_for(timeout=30_000)
        tab.mouse.up()
        # what was held lets go softly, and the page operates as before
        hands.until(lambda header: not header["instruments"])
        tab.locator("#mode").get_by_text(runs).wait_for()
        tab.locator("#pause").click()
        hands.until(lambda header: header["mode"] == "paused")
        # time stands, and no frame comes: it is not taken for silent
        tab.wait_for_timeout(4000)
        assert tab.locator("#lost").is_hidden()
        context.close()
