"""A case as one file, opened from a folder by a real browser: no server, no network."""

import base64
import hashlib
import json
import re
import zlib

import numpy as np
import pytest

from heartcase import CloseGrab, Cut, LeadGrab, PlaceStitch, approve_case
from heartcase.cli.main import main
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from heartcase.simulator.simulation import Simulation
from tests.simulator.live.scenes import write_case
from tests.studio.axe.accessible import assert_accessible
from tests.studio.offline.browser import with_web_gpu
from tests.studio.operating.charts import write_charted
from tests.studio.page.browsing import until

READY = "body[data-ready=true]"
PLACES = """() => {
  const { nodes } = heartcase.picture.heart;
  return [...nodes.displacement.subarray(0, 4 * nodes.count)];
}"""

WITH_AND_WITHOUT_MAP = """() => {
  const { picture } = heartcase;
  const { hasMap, normalMap } = picture.heart.uniforms;
  const drawn = (has) => {
    hasMap.value = has;
    picture.draw();
    return picture.canvas.toDataURL();
  };
  const { width, height } = normalMap.value.image;
  const has = hasMap.value;
  return { size: [width, height], with: drawn(has), without: drawn(false), again: drawn(has) };
}"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A case, a recording of a pull on it, and the page of both."""
    folder = tmp_path_factory.mktemp("offline")
    case = write_case(folder)
    loaded = load_case(case, needs=("surface", "tissue"))
    session = OperatingSession(Simulation(loaded.model, surface=loaded.surface, tissue=loaded.tissue))
    recorder = Recorder(session, folder / "pull.recording", case=loaded.manifest)
    session.do(CloseGrab(name="hand", center_mm=(22.0, -14.0, 40.5), radius_mm=6.0))
    for number in range(8):
        session.do(LeadGrab(name="hand", offset_mm=(0.0, 0.0, number + 1.0)))
        if number == 2:
            session.do(Cut(poses_mm=tuple(tuple((26.3, y, z) for y in (-18.0, -10.0)) for z in (45.0, 36.0))))
        if number == 4:
            session.do(PlaceStitch(name="s", places_mm=((17.0, -14.0, 40.5), (19.0, -14.0, 40.5)), at_rest=True))
        session.advance(60)
    recorder.finish()
    page = folder / "page.html"
    command = ["export", str(case), "-o", str(page), "--recording", str(folder / "pull.recording")]
    assert main([*command, "--frames-per-second", "20"]) == 0
    return case, folder / "pull.recording", page


def contents(page):
    """What the file holds: the table, and the messages."""
    return contents_of(re.search(r'id="case-data">([^<]*)<', page.read_text(encoding="utf-8"))[1])


def contents_of(text):
    data = zlib.decompress(base64.b64decode(text))
    size = int.from_bytes(data[:4], "little")
    table, at, parts = json.loads(data[4 : 4 + size]), 4 + size, []
    for length in table["lengths"]:
        parts.append(data[at : at + length])
        at += length
    assert at == len(data)
    return table, parts


def header_of(part):
    return json.loads(part[4 : 4 + int.from_bytes(part[:4], "little")])


def test_only_its_own_script_runs_and_nothing_is_fetched(recorded):
    text = recorded[2].read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text)[1]
    assert policy.startswith("default-src 'none'")
    for kind, content in re.findall(r"<(script|style)>(.*?)</\1>", text, re.DOTALL):
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in policy
    assert "unsafe" not in policy
    assert len(re.findall("<script", text)) == 2
    assert not re.search(r'(src|href)="(?!data:|#)', text.partition("<script>")[0])


def test_it_is_lit_by_the_normal_map_of_the_case(chromium, tmp_path):
    case, surface = write_charted(tmp_path)
    page = tmp_path / "page.html"
    assert main(["export", str(case), "-o", str(page)]) == 0
    tab = chromium.new_page()
    tab.goto(page.as_uri())
    tab.wait_for_selector(READY, timeout=60_000)
    height, width = surface.normal_map.shape[:2]
    until(lambda: tab.evaluate("() => !heartcase.picture.detail.isMoving"))
    seen = tab.evaluate(WITH_AND_WITHOUT_MAP)
    assert seen["size"] == [width, height]
    assert seen["with"] != seen["without"]
    assert seen["with"] == seen["again"]
    tab.close()


def test_it_holds_the_case_and_the_recording(recorded):
    case, recording, page = recorded
    table, parts = contents(page)
    kinds = [header_of(part)["kind"] for part in parts]
    # the recording begins with the case's own surface, which stands once
    assert kinds[:3] == ["topology", "springs", "landmarks"]
    # and one more where it was cut
    assert set(kinds[3:]) == {"frame", "topology"}
    assert kinds[3:].count("topology") == 1
    opened = open_recording(recording)
    assert table["case"] == [0, 1]
    assert table["recordings"] == [{"name": "pull", "parts": [0, *range(3, len(parts))]}]
    times = [header_of(part)["time_s"] for part in parts if header_of(part)["kind"] == "frame"]
    assert times[0] == 0.0
    assert times[-1] == pytest.approx(opened.seconds)
    assert np.diff(times).max() < 0.08
    assert table["facts"]["name"] == load_case(case).manifest.name
    # the same inputs, the same bytes
    before = page.read_bytes()
    command = ["export", str(case), "-o", str(page), "--recording", str(recording), "--frames-per-second", "20"]
    assert main(command) == 0
    assert page.read_bytes() == before


def test_what_does_not_go_together(recorded, capsys):
    case, _, page = recorded
    assert main(["export", str(case), "-o", str(page), "--model", "solid"]) == 2
    assert "a page shows the hollow model" in capsys.readouterr().err


def test_it_is_looked_at_cut_open_and_played(chromium, recorded):
    case, recording, page = recorded
    tab = chromium.new_page(viewport={"width": 1366, "height": 768})
    faults, asked = [], []
    tab.on("pageerror", lambda error: faults.append(str(error)))
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(page.as_uri())
    tab.wait_for_selector(READY, timeout=60_000)
    assert [url for url in asked if not url.startswith(("blob:", "data:"))] == [page.as_uri()]
    assert "no WebGPU" in tab.inner_text("#engine") or tab.evaluate("() => heartcase.engine !== null")
    assert_accessible(tab)
    # what is hidden is not hit; nor what lies before the plane
    middle = tab.evaluate("() => [heartcase.picture.camera.width / 2, heartcase.picture.camera.height / 2]")
    pick = "([x, y]) => heartcase.picking.at(x, y)"
    hit = tab.evaluate(pick, middle)
    surface = load_case(case, needs=("surface",)).surface.rest_mm
    assert (np.array(hit) > surface.min(axis=0) - 0.5).all()
    assert (np.array(hit) < surface.max(axis=0) + 0.5).all()
    tab.click("#tab-view")
    tab.select_option("#cut-axis", "front")
    behind = tab.evaluate(pick, middle)
    low, high = surface[:, 1].min(), surface[:, 1].max()
    assert hit[1] < 0.5 * (low + high)
    assert behind is None or behind[1] >= 0.5 * (low + high) - 0.1
    tab.click("#cut-open")
    tab.click("#tab-structures")
    for button in tab.locator("#structures .show").all():
        button.click()
    assert tab.evaluate(pick, middle) is None
    tab.click("#show-all")
    # the recording ends where it ended
    tab.click("#tab-recordings")
    tab.click("#recordings button")
    tab.wait_for_selector("#time-bar:not([hidden])")
    # the button says what it does
    icon = "() => document.querySelector('#play use').getAttribute('href')"
    # at one moment: it plays on
    shown = "() => { const { value, max } = document.querySelector('#time'); return [Number(value), Number(max)]; }"
    (moment, last), now = tab.evaluate(f"() => [({shown})(), ({icon})()]")
    assert now == ("#icon-pause" if moment < last else "#icon-go")
    cut, stitch = tab.locator("#time-marks span").all()
    assert [one.get_attribute("class") for one in (cut, stitch)] == ["cut", "stitch"]
    cut.click()
    assert 0.25 <= int(tab.locator("#time").evaluate("(one) => one.value")) / last <= 0.25 + 1.0 / last
    stitch.click()
    assert tab.evaluate(icon) == "#icon-go"
    moment = int(tab.locator("#time").evaluate("(one) => one.value"))
    assert tab.locator("#speed option").all_inner_texts() == [
        f"{one} \N{MULTIPLICATION SIGN}" for one in ("0.25", "0.5", "1", "2", "4")
    ]
    # it was placed after half of the recording
    assert 0.5 <= moment / last <= 0.5 + 1.0 / last
    # on from there to the end
    tab.select_option("#speed", "4")
    tab.click("#play")
    tab.wait_for_function("() => document.querySelector('#time').value === document.querySelector('#time').max")
    tab.wait_for_function("() => document.querySelector('#play').getAttribute('aria-pressed') === 'false'")
    assert_accessible(tab, "recording")
    loaded = load_case(case, needs=("surface", "tissue"))
    session = load_session(open_recording(recording), loaded.model, surface=loaded.surface, tissue=loaded.tissue)
    for _ in session.play():
        pass
    shown = np.reshape(tab.evaluate(PLACES), (-1, 4))[:, :3]
    assert np.abs(shown - session.simulation.state.displacement).max() < 2e-3
    assert np.abs(shown).max() > 1.0
    tab.click("#begin")
    assert not np.any(tab.evaluate(PLACES))
    assert faults == []
    tab.close()


@pytest.mark.slow
def test_it_is_pulled_by_the_pages_own_engine(recorded):
    with with_web_gpu() as browser:
        tab = browser.new_page(viewport={"width": 1000, "height": 700})
        tab.goto(recorded[2].as_uri())
        tab.wait_for_selector(READY, timeout=60_000)
        box = tab.locator("#scene").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        tab.keyboard.press("g")
        tab.mouse.move(x, y)
        tab.mouse.down()
        tab.wait_for_timeout(200)
        tab.mouse.move(x + 60, y, steps=4)
        for _ in range(100):
            tab.wait_for_timeout(200)
            if np.abs(tab.evaluate(PLACES)).max() > 0.5:
                break
        else:
            pytest.fail("nothing moved")
        assert "N" in tab.inner_text("#forces") or tab.locator("#forces dd").count()
        tab.mouse.up()
        tab.click("#as-at-start")
        tab.wait_for_timeout(1000)
        assert np.abs(tab.evaluate(PLACES)).max() < 0.05


def test_that_nobody_approved_the_case_stands_on_the_page_until_somebody_does(chromium, tmp_path):
    case, page = write_case(tmp_path), tmp_path / "page.html"
    context = chromium.new_context(viewport={"width": 1366, "height": 768}, locale="de-DE")
    tab = context.new_page()

    def opened():
        assert main(["export", str(case), "-o", str(page)]) == 0
        tab.goto(page.as_uri())
        tab.wait_for_selector(READY, timeout=60_000)
        return tab.locator("#draft-case")

    assert opened().inner_text().startswith("Entwurf: Niemand hat diesen Fall freigegeben")
    # it leaves the letter below the heart free
    scene, notices = (tab.locator(one).bounding_box() for one in ("#scene", ".scene-notices"))
    assert notices["x"] > scene["x"] + scene["width"] / 2 + 12
    approve_case(case, role="paediatric cardiologist")
    assert opened().is_hidden()
    context.close()
