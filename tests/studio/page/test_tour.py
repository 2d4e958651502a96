"""A guided tour on the page that operates: by keys alone, read aloud, answered, taken over."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from tests.hollow_case import hollow_case
from tests.simulator.touring.hollow_tour import TOUR
from tests.studio.axe.accessible import assert_accessible
from tests.studio.page.browsing import browsing, until
from tests.studio.page.test_operating import OPEN, CaseServer


@pytest.fixture
def toured(tmp_path):
    write_bundle(tmp_path / "hollow.case", hollow_case())
    hostile = TOUR.replace("Nothing is to be seen.", "Nothing: &lt;img src=x onerror=alert(1)&gt;")
    (tmp_path / "hollow.tour.md").write_text(hostile)
    server = CaseServer(tmp_path / "hollow.case")
    server.start()
    yield server
    server.stop()


def test_a_tour_by_keys_alone(chromium, toured):
    options = {"viewport": {"width": 1366, "height": 768}, "reduced_motion": "reduce"}
    with browsing(chromium, toured, **options) as page:
        tab = page.tab
        until(lambda: tab.locator("#tab-tour").is_visible())
        header = lambda: tab.evaluate(f"async () => {OPEN}.header")  # noqa: E731
        camera = lambda: tab.evaluate(f"async () => {OPEN}.picture.camera.towards")  # noqa: E731
        # to the tour's tab by arrows, and to its button
        tab.locator("#tab-structures").focus()
        for _ in range(10):
            if tab.locator("#tab-tour").get_attribute("aria-selected") == "true":
                break
            tab.keyboard.press("ArrowRight")
        assert tab.locator("#panel-tour").is_visible()
        assert page.text("#panel-tour h2") == "Two rooms"
        assert tab.locator("#panel-tour strong").inner_text() == "two rooms"
        assert_accessible(tab)
        tab.locator("#panel-tour button.main").first.focus()
        tab.keyboard.press("Enter")
        assert page.text("#panel-tour h2") == "From outside"
        # text is text
        assert "<img src=x onerror=alert(1)>" in page.text("#panel-tour .tour-text")
        assert tab.locator("#panel-tour img").count() == 0
        np.testing.assert_allclose(camera(), [0, -1, 0], atol=1e-6)
        # the focus stays on Next, and what came is said
        assert tab.evaluate("document.activeElement.textContent") == "Next"
        assert page.text("#panel-tour .hidden-words[role=status]") == "Step 1 of 6: From outside"
        assert tab.locator("#panel-tour").get_by_role("button", name="Back").get_attribute("aria-disabled") == "true"
        tab.keyboard.press("Enter")
        assert page.text("#panel-tour h2") == "The hole"
        np.testing.assert_allclose(camera(), [0, 0, 1], atol=1e-6)
        assert tab.locator("#cut-open").get_attribute("aria-pressed") == "true"
        assert_accessible(tab)
        # a question: choosing tells nothing yet, so that arrows may go through the answers
        first = tab.locator("#panel-tour input[type=radio]").first
        first.focus()
        tab.keyboard.press("Space")
        assert page.text("#panel-tour .outcome") == ""
        tab.keyboard.press("Enter")
        assert "Not right" in page.text("#panel-tour .outcome")
        assert "One is missing." in page.text("#panel-tour .outcome")
        tab.keyboard.press("ArrowDown")
        tab.keyboard.press("Enter")
        assert page.text("#panel-tour .outcome").startswith("Right.")
        assert "It is a square." in page.text("#panel-tour .outcome")
        assert tab.locator("#panel-tour .outcome").get_attribute("role") == "status"
        # on by its key: the step does what it says
        tab.keyboard.press("m")
        until(lambda: [one["name"] for one in header()["instruments"]] == ["probe"])
        assert tab.locator("#cut-open").get_attribute("aria-pressed") == "false"
        until(lambda: tab.locator(".tour-state").get_attribute("data-state") == "ready", 60.0)
        tab.keyboard.press("m")
        until(lambda: len(header()["instruments"]) == 2, 60.0)
        until(lambda: tab.locator(".tour-state").get_attribute("data-state") == "ready", 60.0)
        # taken over: undone by the learner, and brought back by the tour
        tab.locator("#scene").focus()
        tab.keyboard.press("u")
        until(lambda: len(header()["instruments"]) == 1 and header()["mode"] == "paused")
        tab.keyboard.press("i")
        until(lambda: len(header()["instruments"]) == 2 and header()["mode"] == "running", 60.0)
        until(lambda: tab.locator(".tour-state").get_attribute("data-state") == "ready", 60.0)
        # back: undone
        tab.keyboard.press("d")
        until(lambda: [one["name"] for one in header()["instruments"]] == ["probe"], 60.0)
        # the page's words in German, the tour's own as they are
        tab.locator("#tab-help").click()
        tab.locator("#language").select_option("de")
        tab.locator("#tab-tour").click()
        assert tab.locator("#panel-tour").get_by_role("button", name="Weiter").is_visible()
        assert page.text("#panel-tour h2") == "Through it"
        tab.locator("#panel-tour").get_by_role("button", name="Beenden").click()
        assert "0 von 1" in page.text("#panel-tour")
        assert page.text("#panel-tour h2") == "Two rooms"
