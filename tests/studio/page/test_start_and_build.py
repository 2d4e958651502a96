"""From a DICOM folder to a built case by the mouse and by keys, in a real browser."""

import re

import numpy as np
import pytest

from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.schemas.bundle.approval import approval_state, bundle_sha256
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text
from tests.ball import write_ball_recipe, write_ball_scan
from tests.pipeline.formats.dicom_series import write_series
from tests.studio.axe.accessible import assert_accessible
from tests.studio.page.browsing import TOKEN, Page, Server

SPILLED = """
[[strokes]]
label = "background"
radius_mm = 2.0
points_mm = [[24, 24, 8], [18, 24, 0], [24, 24, -8], [24, 18, 0], [24, 24, 8]]
[[strokes]]
label = "cavity"
radius_mm = 2.0
points_mm = [[24, 24, 0]]
"""
"""Blood outside of the ball: warned of, with its place."""
DROP = """() => {
  const held = new DataTransfer();
  held.items.add(new File(["x"], "scan.nii"));
  return ["dragover", "drop"].map((kind) =>
    !document.body.dispatchEvent(new DragEvent(kind, { dataTransfer: held, bubbles: true, cancelable: true })));
}"""
"""Whether the page keeps the browser from leaving it for a file."""
STROKE = '\n[[strokes]]\nlabel = "muscle"\nradius_mm = 1.0\npoints_mm = [[12, 12, 0]]\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a ball as a recipe and as DICOM series: the whole, and three slices of it."""
    folder = tmp_path_factory.mktemp("started")
    write_ball_scan(folder / "scan.nii.gz")
    write_ball_recipe(folder / "scan.nii.gz", folder / "ball.toml", more=SPILLED)
    scan = read_scan(folder / "scan.nii.gz")
    values = np.clip(np.rint(scan.values), 0, 60000).astype(np.uint16)
    places = np.array([[-31.0, -31.0, -31.0 + 2.0 * k] for k in range(len(values))])
    options = {"modality": "MR", "pixel_spacing": (2.0, 2.0), "PatientName": "DOE^JANE"}
    write_series(folder / "images", values[:3], places[:3], series=1, **options)
    write_series(folder / "images", values, places, series=2, **options)
    return folder


@pytest.fixture
def server(folder):
    found = Server(folder / "ball.toml")
    found.start()
    yield found
    found.stop()


@pytest.fixture
def page(chromium, server):
    context = chromium.new_context(viewport={"width": 1366, "height": 768}, locale="en-GB", color_scheme="dark")
    found = Page(context, server)
    yield found
    assert not found.faults, found.faults
    assert all(
        url.startswith((f"http://127.0.0.1:{server.port}/", f"ws://127.0.0.1:{server.port}/", "data:", "blob:"))
        for url in found.requests
    )
    context.close()


def start(page):
    page.tab.goto(f"http://127.0.0.1:{page.server.port}/?token={TOKEN}")
    page.tab.locator("#entries button").first.wait_for()


def test_from_a_dicom_folder_to_a_recipe_by_keys_alone(page, folder):
    start(page)
    tab = page.tab
    tab.locator("#sample-rows button:enabled").nth(18).wait_for()
    assert_accessible(page, "start page")
    tab.locator("#entries button").first.focus()
    tab.keyboard.press("ArrowDown")
    assert tab.evaluate("() => document.activeElement.textContent").startswith("images")
    tab.keyboard.press("Enter")
    tab.locator("#entries button").get_by_text("DICOM files").wait_for()
    # the list's only entry has the focus: the files of the folder
    tab.keyboard.press("Enter")
    tab.locator("#series-rows tr").nth(1).wait_for()
    assert "localiser" in page.text("#series-rows tr:first-child")
    assert "thin walls are grown" in page.text("#series-rows tr:last-child")
    assert tab.locator("#series-rows img").count() == 2
    # the one that suits is proposed, and has the focus
    assert tab.evaluate("() => document.activeElement.id") == "series-1"
    assert_accessible(page, "series")
    assert "DOE" not in tab.content()
    tab.locator("#recipe-file").fill("from_dicom")
    tab.keyboard.press("Enter")
    page.ready()
    recipe = parse_recipe(read_recipe_text(folder / "from_dicom.toml"), needs_markers=False)
    assert recipe.scan.path == "images"
    assert read_scan(folder / "images", **recipe.scan.choice).geometry.size == (32, 32, 32)
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/prepare/[A-Za-z0-9_-]{12}", tab.url)
    assert tab.title() == "heartcase studio"
    # nothing is marked yet: a build says what it lacks, in place
    tab.locator("#tab-build").click()
    tab.locator("#build").click()
    tab.locator("#build-problems li").first.wait_for(timeout=60_000)
    assert "strokes" in page.text("#build-problems")
    # and the start page knows it from now on
    tab.locator("a.home").click()
    tab.locator("#recent-rows .open").first.wait_for()
    assert recipe.name in page.text("#recent-rows li:first-child")
    assert page.text("#recent-rows li:first-child .folder") == folder.name
    assert tab.locator("#recent-rows li:first-child .folder").get_attribute("title") == folder.name


def test_what_lies_outside_and_what_is_dropped_is_answered_in_the_pages_language(page, tmp_path):
    start(page)
    tab = page.tab
    tab.locator("#language").select_option("de")
    tab.locator("#path").fill(str(tmp_path))
    tab.keyboard.press("Enter")
    tab.locator("#start-live").get_by_text(f'heartcase studio "{tmp_path}"').wait_for()
    assert "liegt außerhalb der Ordner" in page.text("#start-live")
    tab.locator("#language").select_option("en")
    assert "lies outside of the folders" in page.text("#start-live")
    taken = tab.evaluate(DROP)
    assert taken == [True, True]
    assert "does not tell where a dropped file lies" in page.text("#start-live")


def test_a_build_shows_its_stages_and_its_warnings_lead_to_their_places(page, folder):
    tab = page.tab
    page.open()
    tab.locator("#tab-build").click()
    assert "no case of this recipe" in page.text("#build-age")
    tab.locator("#build").click()
    tab.locator("#build-steps .running, #build-steps .computed").first.wait_for(timeout=60_000)
    assert tab.locator("#build-cancel").is_visible()
    tab.locator("#build-warnings .fly").first.wait_for(timeout=180_000)
    assert "as it is now" in page.text("#build-age")
    assert tab.locator("#build-warnings h4.anatomy").count() == 1
    # each goes to the place that its sentence names
    for row in tab.locator("#build-warnings li").all():
        named = re.findall(r"[LR] [\d.]+ [PA] [\d.]+ [HF] [\d.]+(?= mm)", row.locator(".says").inner_text())
        # below it may stand what can be done there
        fly = row.locator(".where").first.locator(".fly")
        assert bool(named) == (fly.count() == 1)
        if not named:
            assert "No place" in row.inner_text()
            continue
        fly.click()
        tab.mouse.move(5, 5)
        shown = page.text("#under")
        assert named[0] in " ".join(shown.split())
        assert row.locator("input").is_checked(), row.inner_text()
    # where muscle is missing it is painted, at the place that was looked at last
    tab.locator("#build-warnings").get_by_text("Paint the missing muscle here").first.click()
    assert tab.locator("#tab-structures").get_attribute("aria-selected") == "true"
    assert tab.locator("button[data-tool=brush]").get_attribute("aria-pressed") == "true"
    assert "muscle" in tab.locator("#structures .structure.picked").inner_text()
    assert page.text("#radius-words") == "1.5 mm"
    assert tab.evaluate("() => document.activeElement.className") == "surface"
    tab.locator("#tab-build").click()
    assert "cavity" in page.text("#volume-rows")
    # why they are others than those of the list
    assert "counts voxels" in page.text("#build-volumes-says")
    assert_accessible(page, "built")
    # approved only once the report was opened, and all was looked at
    case = folder / "out" / "ball.case"
    approve = tab.locator("#approve")
    tab.locator("#approve-role").fill("consultant cardiologist")
    assert approve.is_disabled()
    with tab.context.expect_page() as opened:
        tab.locator("#report-link").click()
    opened.value.wait_for_load_state()
    assert "Build report" in opened.value.content()
    # its own styles work
    assert opened.value.locator("h1").first.evaluate("(one) => getComputedStyle(one).marginTop") != "0px"
    opened.value.close()
    for box in tab.locator("#build-warnings input").all():
        box.check()
    tab.locator("#approve-compared").check()
    # a role that is refused: what is wrong is read beside the button
    tab.locator("#approve-role").fill("Jane Doe")
    approve.click()
    tab.locator("#approve-problems li").first.wait_for()
    panel = tab.locator("#panel-build").bounding_box()
    for one in ("#approve", "#approve-problems"):
        shown = tab.locator(one).bounding_box()
        assert panel["y"] <= shown["y"]
        assert shown["y"] + shown["height"] <= panel["y"] + panel["height"] + 1
    tab.locator("#approve-role").fill("consultant cardiologist")
    # one approval for a double click
    approve.dblclick()
    tab.locator("#approve-state[data-state=approved]").wait_for()
    state = approval_state(case)
    assert state.entry_count == 1
    assert (state.state, state.entry.role, state.entry.bundle_sha256) == (
        "approved",
        "consultant cardiologist",
        bundle_sha256(case),
    )
    # a change of the recipe makes the case older
    text = (folder / "ball.toml").read_text()
    (folder / "ball.toml").write_text(text + STROKE)
    tab.locator("#build-age[data-age=older]").wait_for(timeout=10_000)
    (folder / "ball.toml").write_text(text)
    tab.locator("#build-age[data-age=current]").wait_for(timeout=10_000)
    # another build is compared with it
    assert page.text("#build-changed").startswith("The case is new.")
    assert not any(tab.locator("#volume-rows td:last-child").all_inner_texts())
    (folder / "ball.toml").write_text(text + STROKE)
    tab.locator("#build-age[data-age=older]").wait_for(timeout=10_000)
    tab.locator("#build").click()
    tab.locator("#build-changed").get_by_text("The case is another than before").wait_for(timeout=180_000)
    changes = tab.locator("#volume-rows td:last-child").all_inner_texts()
    assert len(changes) == 2
    assert all(re.fullmatch(r"0\.0|[+\u2212]\d+\.\d", one) for one in changes)
    # and from here it is operated on
    tab.route("**/operate/*", lambda route: route.fulfill(body="the case"))
    tab.locator("#operate").click()
    tab.wait_for_url(re.compile(r"/operate/[A-Za-z0-9_-]{12}$"))
