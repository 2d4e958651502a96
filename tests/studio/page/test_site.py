"""A site of three cases in a real browser, from a folder and from a web server; by finger and pen too."""

import threading
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from heartcase.studio.catalogue.site import write_catalogue
from heartcase.studio.offline.site import SiteCase, write_site
from tests.studio.axe.accessible import assert_accessible
from tests.studio.offline.cases import write_cases

NAMES = ["first", "second", "third"]
VIEWER = ".offline-page[data-ready=true]"
INDEX = ".site-page[data-ready=true]"
CAMERA = (
    "() => { const { distance, target, towards } = heartcase.picture.camera; return { distance, target, towards }; }"
)
PIXELS = """() => {
  heartcase.picture.draw();
  const { canvas } = heartcase.picture;
  const copy = document.createElement("canvas");
  Object.assign(copy, { width: canvas.width, height: canvas.height });
  const pen = copy.getContext("2d");
  pen.drawImage(canvas, 0, 0);
  const { data } = pen.getImageData(0, 0, copy.width, copy.height);
  let [sum, drawn] = [0, 0];
  for (let n = 0; n < data.length; n += 4) {
    sum += data[n] + 2 * data[n + 1] + 3 * data[n + 2];
    drawn += data[n + 3] > 0;
  }
  return { sum, drawn: drawn / (data.length / 4) };
}"""

CAPS_ALONE = """(pattern) => {
  const { heart } = heartcase.picture;
  const looks = [...heartcase.facts.structures, ...heartcase.facts.inside];
  heart.paint(looks.map(({ value, colour }) => ({ value, colour, pattern })), new Set());
  heart.material.visible = false;
}"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("heartcase.studio.offline.pictures.PICTURE_SIZE", (160, 120))
        write_site([SiteCase(case) for case in write_cases(folder, NAMES)], folder / "site")
        write_catalogue(folder)
    return folder


@contextmanager
def served(folder):
    """The address of a folder that a plain web server hands out."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *told):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}/"
    server.shutdown()
    thread.join()
    server.server_close()


@contextmanager
def opened(browser, address, **options):
    """A page in which nothing goes wrong."""
    context = browser.new_context(**({"viewport": {"width": 1366, "height": 768}, "locale": "en-GB"} | options))
    tab = context.new_page()
    faults = []
    tab.on("pageerror", lambda error: faults.append(str(error)))
    tab.on("console", lambda said: faults.append(said.text) if said.type == "error" else None)
    tab.goto(address)
    yield tab, faults
    context.close()


def fingers_on(tab):
    """What does as fingers do, as a touch screen tells it."""
    session = tab.context.new_cdp_session(tab)

    def touch(kind, *places):
        points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    return touch


def middle_of(tab, selector):
    box = tab.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@pytest.mark.parametrize("way", ["folder", "server"])
def test_every_case_opens_from_the_list_and_leads_back(chromium, site, way):
    with served(site / "site") as address:
        start = address if way == "server" else (site / "site/index.html").as_uri()
        with opened(chromium, start) as (tab, faults):
            tab.wait_for_selector(INDEX)
            assert tab.locator(".case").count() == 3
            tab.wait_for_function("[...document.images].every((one) => one.complete)")
            assert tab.evaluate("[...document.images].every((one) => one.naturalWidth > 0)")
            assert "draft: not approved" in tab.inner_text(".case >> nth=0")
            tab.select_option("#language", "de")
            assert "Entwurf" in tab.inner_text(".case >> nth=0")
            for number, name in list(enumerate(NAMES))[-1 if way == "server" else 0 :]:
                tab.click(f"h2 a >> nth={number}")
                tab.wait_for_selector(VIEWER, timeout=60_000)
                assert tab.inner_text("#case-name") == name
                assert tab.inner_text("#back") == "Alle Fälle"
                assert tab.evaluate(PIXELS)["drawn"] > 0.05
                tab.click("#back")
                tab.wait_for_selector(INDEX)
            assert faults == []
            assert_accessible(tab, "index")


def test_the_catalogue_opens_the_same_viewer(chromium, site):
    with opened(chromium, (site / "catalogue/cases/second.html").as_uri() + "?lang=de") as (tab, faults):
        assert_accessible(tab, "case")
        tab.click("#open-view")
        tab.wait_for_selector(VIEWER, timeout=60_000)
        assert tab.inner_text("#tab-view") == "Ansicht"
        tab.click("#back")
        tab.wait_for_selector("#open-view")
        assert "lang=de" in tab.url
        assert not [
            one for one in faults if "preload" not in one and "viewer.css" not in one and "style.css" not in one
        ]


def test_what_the_viewer_shows(chromium, site):
    with opened(chromium, (site / "site/cases/first.html").as_uri()) as (tab, faults):
        tab.wait_for_selector(VIEWER, timeout=60_000)
        tab.emulate_media(reduced_motion="reduce")
        assert "no WebGPU" in tab.inner_text("#engine") or tab.evaluate("() => heartcase.engine !== null")
        seen = tab.evaluate(PIXELS)
        tab.click("#tab-view")
        assert faults == []
        assert_accessible(tab, "view")
        for side, way in (("back", [0, 1, 0]), ("left", [1, 0, 0]), ("head", [0, 0, 1]), ("front", [0, -1, 0])):
            tab.click(f"[data-side={side}]")
            np.testing.assert_allclose(tab.evaluate(CAMERA)["towards"], way, atol=1e-9)
            assert f"Seen from: {side}." in tab.inner_text("#said")
        front = tab.evaluate(PIXELS)
        assert front["sum"] != seen["sum"]
        before = tab.evaluate(CAMERA)
        tab.click("[data-move=nearer]")
        tab.click("[data-move=turn_right]")
        assert tab.evaluate(CAMERA)["distance"] < before["distance"]
        assert tab.evaluate(CAMERA)["towards"][0] < -0.1
        tab.click("[data-side=front]")
        tab.click("[data-move=farther]")
        colours = set()
        for mode in ("colour", "oxygen", "safe"):
            tab.check(f"#colours-{mode}")
            colours.add(tab.evaluate(PIXELS)["sum"])
            assert_accessible(tab, mode)
        assert len(colours) == 3
        assert tab.locator("#blood-kinds li").count() == 0 or not tab.is_visible("#blood-kinds")
        tab.check("#colours-colour")
        # a click names the structure, and a row of the list shows it alone
        tab.click("#tab-structures")
        tab.mouse.click(*middle_of(tab, "#scene"))
        assert tab.inner_text("#said").startswith("This is: ")
        tab.hover("#structures li >> nth=0")
        assert tab.evaluate(PIXELS)["sum"] != front["sum"]
        tab.hover("#case-name")
        for button in ("#hide-all", "#show-all"):
            tab.click(button)
            assert (tab.evaluate(PIXELS)["drawn"] < 0.01) == (button == "#hide-all")
        # cut open: through the defect, along the screen, from the feet; walls are filled, and have names
        whole = tab.evaluate(PIXELS)["sum"]
        tab.click("#cut-open")
        tab.click("#tab-view")
        sums = set()
        for plane in ("lesion", "look", "feet"):
            tab.select_option("#cut-axis", plane)
            sums.add(tab.evaluate(PIXELS)["sum"])
        assert len(sums | {whole}) == 4
        tab.select_option("#cut-axis", "front")
        tab.click("#cut-face")
        assert_accessible(tab, "cut open")
        at = tab.evaluate("""() => {
          const { camera, plane } = heartcase.picture;
          const { width, height } = camera;
          for (let x = 0.3; x < 0.7; x += 0.02) {
            for (let y = 0.3; y < 0.7; y += 0.02) {
              const seen = heartcase.picking.seen(x * width, y * height);
              if (seen && Math.abs(seen.place[1] - plane.point[1]) < 1e-3) return [x * width, y * height];
            }
          }
          return null;
        }""")
        assert at is not None
        box = tab.locator("#scene").bounding_box()
        tab.mouse.click(box["x"] + at[0], box["y"] + at[1])
        assert "This is: " in tab.inner_text("#said")
        assert tab.inner_text("#said").endswith(("wall", "myocardium"))
        # the walls that the plane cuts have the patterns of their blood too
        caps = [tab.evaluate(f"({CAPS_ALONE})({pattern}) ?? ({PIXELS})()")["sum"] for pattern in (0, 1, 2)]
        assert len(set(caps)) == 3
        assert min(caps) > 0
        tab.locator("#cut-depth").evaluate("(one) => { one.value = one.min; one.dispatchEvent(new Event('input')); }")
        assert tab.evaluate("() => heartcase.picking.at(500, 350)") is None


def test_fingers_turn_and_zoom(chromium, site):
    with opened(
        chromium, (site / "site/cases/first.html").as_uri(), viewport={"width": 820, "height": 1180}, has_touch=True
    ) as (tab, faults):
        tab.wait_for_selector(VIEWER, timeout=60_000)
        assert_accessible(tab, "tablet")
        assert min(box["height"] for one in tab.locator("button:visible").all() if (box := one.bounding_box())) >= 44
        assert tab.evaluate("document.documentElement.scrollWidth") <= 820
        x, y = middle_of(tab, "#scene")
        before, touch = tab.evaluate(CAMERA), fingers_on(tab)
        touch("touchStart", (x, y))
        touch("touchMove", (x + 60, y))
        touch("touchEnd")
        turned = tab.evaluate(CAMERA)
        assert np.linalg.norm(np.subtract(turned["towards"], before["towards"])) > 0.1
        assert turned["distance"] == before["distance"]
        touch("touchStart", (x - 50, y), (x + 50, y))
        touch("touchMove", (x - 100, y + 40), (x + 100, y + 40))
        touch("touchEnd")
        zoomed = tab.evaluate(CAMERA)
        assert zoomed["distance"] == pytest.approx(turned["distance"] / 2, rel=0.02)
        # two fingers move, as there is no instrument that one of them would hold
        assert np.linalg.norm(np.subtract(zoomed["target"], turned["target"])) > 0.5
        assert np.linalg.norm(np.subtract(zoomed["towards"], turned["towards"])) < 1e-6
        tab.touchscreen.tap(x, y)
        assert tab.inner_text("#said").startswith(("This is: ", "There is nothing"))
        assert not [one for one in faults if "viewer.css" not in one]


def test_a_case_that_is_missing_is_told_of(chromium, site, tmp_path):
    page = tmp_path / "cases/first.html"
    page.parent.mkdir()
    (tmp_path / "assets").symlink_to(site / "site/assets")
    page.write_bytes((site / "site/cases/first.html").read_bytes())
    with opened(chromium, page.as_uri()) as (tab, _):
        tab.wait_for_function(
            "() => document.getElementById('curtain-words').textContent.includes('copy the whole folder')"
        )
