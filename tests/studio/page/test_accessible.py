"""Axe finds nothing on the page, in each state that it can be in; in a real browser."""

import itertools

import numpy as np

from tests.studio.axe.accessible import assert_accessible, axe_findings
from tests.studio.page.browsing import browsing, mm_of
from tests.studio.page.test_page import MIDDLE, look_at, stroke

VIEWPORT = {"width": 1366, "height": 768}


THEMES = ("dark", "light")


def take_theme(page, theme):
    if page.tab.locator("html").get_attribute("data-theme") != theme:
        page.tab.locator("#theme").click()
    page.tab.locator(f"html[data-theme={theme}]").wait_for()


def test_axe_finds_nothing_on_the_prepare_page(chromium, painted):
    server, path, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server, viewport=VIEWPORT) as page:
        for theme, language in itertools.product(THEMES, ("de", "en")):
            take_theme(page, theme)
            page.tab.locator("#tab-help").click()
            page.tab.locator("#language").select_option(language)
            page.tab.locator(f"html[lang={language}]").wait_for()
            for tab in page.tab.locator("[role=tab]:visible").all():
                tab.click()
                assert_accessible(page, f"{theme}, {language}, {tab.inner_text()}")
        page.tab.locator("#tab-structures").click()
        look_at(page, middle, affine)
        stroke(page, "axial", [middle, middle + np.array([2.0, 0, 0])], affine)
        page.saved(1)
        page.tab.keyboard.press("n")
        page.tab.locator("#place").get_by_text("lace").first.wait_for(timeout=60_000)
        page.tab.locator("#axial .enlarge").click()
        assert_accessible(page, "a place to look at, one large")
        path.write_text(path.read_text() + "# by hand\n")
        stroke(page, "axial", [middle, middle + np.array([2.0, 0, 0])], affine)
        page.tab.locator("#notice").wait_for()
        page.ready()
        for theme in THEMES:
            take_theme(page, theme)
            assert_accessible(page, f"{theme}, refused")


def test_axe_finds_nothing_where_the_server_is_gone_and_finds_what_is_planted(chromium, painted):
    server, _, _ = painted
    with browsing(chromium, server, may_fault=True) as page:
        server.stop()
        page.tab.locator("#lost").wait_for(timeout=30_000)
        assert_accessible(page, "lost")
        page.tab.evaluate(
            """() => {
              const button = document.createElement("button");
              button.style.cssText = "width: 10px; height: 10px; min-height: 0; padding: 0";
              const beside = document.createElement("button");
              beside.style.cssText = "height: 10px; min-height: 0; padding: 0";
              beside.textContent = "words";
              const words = document.createElement("span");
              words.textContent = "hardly to be read";
              words.style.cssText = "color: #333; background: #222";
              const all = document.createElement("div");
              all.append(button, beside);
              document.querySelector("footer").prepend(all, words);
            }"""
        )
        found, _ = axe_findings(page)
        assert {one.partition(" ")[0] for one in found} == {"button-name", "color-contrast", "target-size"}


def test_axe_finds_nothing_where_a_recipe_cannot_be_opened(chromium, painted):
    server, path, _ = painted
    path.write_text(path.read_text().replace("scan.nii.gz", "another.nii.gz"))
    context = chromium.new_context()
    tab = context.new_page()
    tab.goto(server.address)
    tab.locator("#curtain-words strong").wait_for(timeout=60_000)
    assert_accessible(tab, "failed")
    context.close()
