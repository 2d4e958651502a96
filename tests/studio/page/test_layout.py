"""What lies over the heart covers neither the letters of the patient's sides nor the scale bars, nor one another."""

import itertools

import pytest

from tests.studio.page.browsing import browsing, until
from tests.studio.page.test_operating import Hands
from tests.studio.page.test_unfinished import served  # noqa: F401

OVER = ["#cut-open", "#two-views", "#hold-last", "#let-go-all", "#second-look", "#tool-hint", ".scene-notices p"]
COVERED = """(boxes) => [...document.querySelectorAll("canvas.orientation")].flatMap((canvas) => {
  const own = canvas.getBoundingClientRect();
  if (own.width === 0) return [];
  // a copy, as the browser complains of reading from what is drawn
  const copy = Object.assign(document.createElement("canvas"), { width: own.width, height: own.height });
  const pen = copy.getContext("2d", { willReadFrequently: true });
  pen.drawImage(canvas, 0, 0, copy.width, copy.height);
  const alpha = pen.getImageData(0, 0, copy.width, copy.height).data.filter((_, at) => at % 4 === 3);
  const isIn = (at, from, size) => at >= from && at < from + size;
  return boxes.filter(([, left, top, width, height]) => alpha.some((value, at) => value > 0
    && isIn(own.left + (at % copy.width), left, width)
    && isIn(own.top + Math.floor(at / copy.width), top, height))).map(([name]) => name);
})"""


def boxes(tab):
    found = []
    for one in OVER:
        for box in (each.bounding_box() for each in tab.locator(one).all() if each.is_visible()):
            found.append([one, box["x"], box["y"], box["width"], box["height"]])
    return found


def overlapping(found):
    return [
        (one[0], other[0])
        for one, other in itertools.combinations(found, 2)
        if one[1] < other[1] + other[3]
        and other[1] < one[1] + one[3]
        and one[2] < other[2] + other[4]
        and other[2] < one[2] + one[4]
    ]


def check(page, expected):
    page.drawn()
    found = boxes(page.tab)
    assert expected <= {one for one, *_ in found}
    assert overlapping(found) == []
    assert page.tab.evaluate(COVERED, found) == []


@pytest.mark.parametrize("locale", ["en-GB", "de-DE"])
def test_nothing_is_covered(chromium, served, locale):  # noqa: F811
    with browsing(chromium, served, locale=locale, viewport={"width": 1366, "height": 768}) as page:
        tab, hands = page.tab, Hands(page)
        tab.locator("#begin").dispatch_event("click")
        hands.until(lambda header: header["act_count"] == 0 and header["mode"] == "running")
        hands.from_above()
        tab.keyboard.press("c")
        hands.drag((22.3, -20.0, 40.5), (22.3, -14.0, 40.5), (22.3, -9.0, 40.5))
        tab.mouse.up()
        hands.until(lambda header: header["can_hold_open"])
        # two instruments that stay, so that both buttons are there
        tab.keyboard.press("f")
        for place in ((14.0, -14.0, 40.5), (28.0, -14.0, 40.5)):
            hands.drag(place, place)
            tab.mouse.up()
            tab.wait_for_timeout(300)
        hands.until(lambda header: len(header["instruments"]) == 2)
        tab.locator("#let-go-all").wait_for()
        over = {"#cut-open", "#two-views", "#hold-last", "#let-go-all", "#tool-hint", ".scene-notices p"}
        check(page, over)
        tab.locator("#two-views").click()
        until(lambda: tab.locator("#scene-2").is_visible())
        check(page, over | {"#second-look"})
        tab.locator("#two-views").click()
        tab.locator("#let-go-all").click()
        hands.until(lambda header: not header["instruments"])
        tab.locator("#tab-recordings").click()
        for name in ("whole", "torn"):
            tab.locator("#recordings li", has_text=name).locator("input").check()
        until(lambda: tab.locator("#side-by-side").is_enabled())
        # nor does a mark squeeze a recording's name
        names = [one.bounding_box() for one in tab.locator("#recordings .name").all()]
        assert min(one["width"] for one in names) > 70.0
        tab.locator("#side-by-side").click()
        until(lambda: tab.locator("#beside").is_visible())
        page.drawn()
        tab.wait_for_timeout(500)
        check(page, {"#cut-open", "#two-views"})
