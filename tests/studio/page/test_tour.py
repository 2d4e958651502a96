"""A guided tour on the page that operates: by keys alone, read aloud, answered, taken over."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.cli.main import main
from heartcase.pipeline.bundle.write_bundle import write_bundle
from tests.hollow_case import hollow_case
from tests.simulator.touring.hollow_tour import TOUR
from tests.studio.axe.accessible import assert_accessible
from tests.studio.page.browsing import browsing, until
from tests.studio.page.test_operating import OPEN, CaseServer

TURNED = """async (picture) => {
  const axis = () => [...picture.camera.towards];
  const scene = document.getElementById('scene');
  document.querySelector('#panel-tour button.main').click();
  await new Promise(requestAnimationFrame);
  scene.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowRight', bubbles: true, cancelable: true }));
  const turned = axis();
  await new Promise((resolve) => setTimeout(resolve, 1000));
  return [turned, axis()];
}"""
"""Where a user looks from who turns the heart while a tour's step begins to, and a second later."""


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
        tab.keyboard.press("h")
        until(lambda: len(header()["instruments"]) == 2 and header()["mode"] == "running", 60.0)
        until(lambda: tab.locator(".tour-state").get_attribute("data-state") == "ready", 60.0)
        # back: undone
        tab.keyboard.press("q")
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


def test_who_turns_the_heart_has_the_camera(chromium, toured):
    with browsing(chromium, toured) as page:
        until(lambda: page.tab.locator("#tab-tour").is_visible())
        page.tab.locator("#tab-tour").click()
        turned, later = page.tab.evaluate(f"async () => ({TURNED})({OPEN}.picture)")
        assert turned == later


def test_a_tour_in_a_page_without_a_server(chromium, tmp_path):
    write_bundle(tmp_path / "hollow.case", hollow_case())
    (tmp_path / "hollow.tour.md").write_text(TOUR)
    page = tmp_path / "hollow.html"
    assert main(["export", str(tmp_path / "hollow.case"), "-o", str(page)]) == 0
    context = chromium.new_context(viewport={"width": 1366, "height": 768}, reduced_motion="reduce", locale="en-GB")
    tab = context.new_page()
    faults = []
    tab.on("pageerror", lambda error: faults.append(str(error)))
    tab.goto(page.as_uri())
    tab.locator("body[data-ready=true]").wait_for(timeout=60_000)
    nodes = lambda: tab.evaluate("heartcase.picture.heart.nodes.count")  # noqa: E731
    tab.locator("#tab-tour").click()
    tab.get_by_role("button", name="Begin: 6 steps").click()
    whole = nodes()
    tab.keyboard.press("m")
    assert tab.locator("#panel-tour h2").inner_text() == "The hole"
    np.testing.assert_allclose(tab.evaluate("heartcase.picture.camera.towards"), [0, 0, 1], atol=1e-6)
    assert tab.evaluate("heartcase.picture.plane.isOn")
    assert_accessible(tab)
    tab.keyboard.press("m")
    tab.keyboard.press("m")
    until(lambda: nodes() > whole)
    opened = nodes()
    # landmarks go with the tissue that is moved
    there, rest = (
        lambda which=which: tab.evaluate(f"heartcase.{which}.flatMap((one) => one.points.flat())")
        for which in ("marks.marks", "facts.landmarks")
    )
    until(lambda: np.abs(np.subtract(there(), rest())).max() > 0.5)
    # back: the lid is whole again; and on, over what is between
    tab.keyboard.press("q")
    until(lambda: nodes() == whole)
    tab.keyboard.press("m")
    until(lambda: nodes() == opened)
    tab.get_by_role("button", name="End", exact=True).click()
    until(lambda: nodes() == whole)
    assert not tab.evaluate("heartcase.picture.plane.isOn")
    tab.emulate_media(reduced_motion="no-preference")
    turned, later = tab.evaluate(f"async () => ({TURNED})(heartcase.picture)")
    assert turned == later
    assert faults == []
    context.close()
    # a site shows the tour, and says of what moves tissue that it does not
    site = tmp_path / "site"
    assert main(["export", str(tmp_path / "hollow.case"), "--web", "--out", str(site)]) == 0
    tab = chromium.new_page(viewport={"width": 1366, "height": 768}, reduced_motion="reduce", locale="en-GB")
    tab.goto((site / "cases/hollow.html").as_uri())
    tab.locator("body[data-ready=true]").wait_for(timeout=60_000)
    tab.locator("#tab-tour").click()
    tab.get_by_role("button", name="Begin: 6 steps").click()
    tab.keyboard.press("m")
    assert tab.evaluate("heartcase.picture.plane.isOn")
    assert "Here it is only shown" not in tab.inner_text("#panel-tour")
    tab.keyboard.press("m")
    tab.get_by_text("Here it is only shown").wait_for()
    tab.close()
    bare = tmp_path / "bare.html"
    assert main(["export", str(tmp_path / "hollow.case"), "-o", str(bare), "--no-tours"]) == 0
    assert bare.stat().st_size < page.stat().st_size
