"""The whole way in one page: a scan opened, painted, shaped, built, said what it is, and operated on by the mouse.

Pictures of each step are left in HEARTCASE_SHOTS, where that is given.
"""

import os
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import ndimage

from heartcase.cli.main import cli
from heartcase.pipeline.building.session_file import open_session
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.schemas.recording.reader import open_recording
from tests.pipeline.formats.dicom_series import write_series
from tests.studio.page.browsing import Page, Server, until
from tests.studio.page.journey import Painter, strokes_of

FEW_STROKES = Path(__file__).parents[3] / "sample_cases" / "chest_ct_few_strokes.toml"
OPEN = "(await import('/static/operating/main.js')).open"
MOST_STROKES = 40
HOLE_MM = (3.4, -16.3, -9.3)
"""Where the child's heart has its own hole."""
VENTRICLES = re.compile("left ventricle.+right ventricle")
BUILD_MS = 400_000

pytestmark = pytest.mark.slow


class StartServer(Server):
    """The studio in a folder, with nothing open yet."""

    def open_in(self, registry):
        return SimpleNamespace(address="/")


class Journey:
    """A page that is taken from the start page to an operated heart; every step leaves a picture."""

    def __init__(self, chromium, folder, name):
        self.folder, self.name, self.count = folder, name, 0
        self.server = StartServer(folder / "none.toml")
        self.context = chromium.new_context(
            viewport={"width": 1366, "height": 768}, locale="en-GB", color_scheme="dark"
        )

    def __enter__(self):
        self.server.start()
        self.page = Page(self.context, self.server)
        self.tab = self.page.tab
        self.tab.goto(self.server.address)
        self.tab.locator("#entries button").first.wait_for()
        return self

    def __exit__(self, *error):
        if error[0] is not None:
            self.shot("failed")
        self.context.close()
        self.server.stop()

    def shot(self, what):
        self.count += 1
        if shots := os.environ.get("HEARTCASE_SHOTS"):
            self.tab.screenshot(path=Path(shots) / f"{self.name}_{self.count:02}_{what}.png")

    def begin(self, entry):
        """A scan is chosen in the list, its series looked at, and a recipe begun."""
        tab = self.tab
        tab.locator("#entries button").get_by_text(entry).first.click()
        files = tab.locator("#entries button").get_by_text("DICOM files")
        until(lambda: tab.locator("#series-rows tr").count() > 0 or files.count() > 0)
        if files.count():
            files.click()
        tab.locator("#series-rows tr").first.wait_for(timeout=60_000)
        self.shot("series")
        tab.locator("#case-named").fill(self.name)
        tab.locator("#begin-form button").click()
        self.page.ready()
        assert self.page.text("#case-name") == self.name
        return self.folder / f"{self.name}.toml"

    def paint(self, painter, strokes):
        for count, (value, points) in enumerate(strokes, start=1):
            painter.stroke(str(value), points)
            self.page.saved(count)
        self.tab.mouse.move(5, 5)
        self.page.drawn()
        self.shot("painted")

    def build(self):
        tab = self.tab
        tab.locator("#tab-build").click()
        tab.locator("#build").click()
        tab.locator("#build-cancel").wait_for()
        tab.locator("#build-cancel").wait_for(state="hidden", timeout=BUILD_MS)
        assert tab.locator("#build-problems").is_hidden(), self.page.text("#build-problems")
        self.shot("built")

    def operate(self):
        """Pulled, cut, looked at from elsewhere, taken back, and replayed as it was recorded."""
        tab, page = self.tab, self.page
        with tab.expect_navigation():
            tab.locator("#operate").click()
        page.ready()

        def header():
            return tab.evaluate(f"async () => {OPEN}.header")

        def wait(check):
            # No frame has come yet where there is no header.
            until(lambda: (now := header()) is not None and check(now), 90.0)
            return header()

        box = tab.locator("#scene").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.shot("operate")
        tab.locator("#record").click()
        recording = wait(lambda one: one["recording"])["recording"]
        tab.keyboard.press("g")
        tab.mouse.move(x, y)
        tab.mouse.down()
        tab.mouse.move(x + 25, y - 10, steps=5)
        wait(lambda one: one["instruments"])
        self.shot("pulled")
        tab.mouse.up()
        wait(lambda one: not one["instruments"])
        acts = header()["act_count"]
        tab.keyboard.press("c")
        tab.mouse.move(x - 25, y)
        tab.mouse.down()
        tab.mouse.move(x + 25, y + 4, steps=8)
        tab.mouse.up()
        cut = wait(lambda one: one["act_count"] > acts)
        # looked at from elsewhere
        before = tab.evaluate(f"async () => {OPEN}.picture.camera.towards")
        tab.locator("#scene").focus()
        for _ in range(6):
            tab.keyboard.press("ArrowLeft")
        assert tab.evaluate(f"async () => {OPEN}.picture.camera.towards") != before
        self.shot("cut")
        tab.locator("#undo").click()
        wait(lambda one: one["act_count"] < cut["act_count"])
        tab.locator("#record").click()
        wait(lambda one: one["recording"] is None)
        tab.locator("#tab-recordings").click()
        tab.locator("#recordings button").first.click()
        wait(lambda one: one["mode"] in ("playing", "paused"))
        wait(lambda one: one["mode"] == "paused")
        self.shot("replayed")
        return recording

    def assert_clean(self):
        assert not self.page.faults, self.page.faults
        here = (f"http://127.0.0.1:{self.server.port}/", f"ws://127.0.0.1:{self.server.port}/", "data:", "blob:")
        assert [url for url in self.page.requests if not url.startswith(here)] == []


def test_a_childs_heart_with_a_hole_from_dicom_to_the_operated_model(chromium, tmp_path):
    made = CliRunner().invoke(
        cli, ["phantom", str(tmp_path / "made"), "--size", "child", "--spacing", "1.75", "--vsd", "8"]
    )
    assert made.exit_code == 0, made.output
    scan = read_scan(tmp_path / "made" / "scan.nii.gz")
    truth = np.rint(read_scan(tmp_path / "made" / "truth.nii.gz").values).astype(np.uint8)
    geometry = scan.geometry
    np.testing.assert_allclose(geometry.affine[:3, :3], np.diag(geometry.spacing_mm), atol=1e-6)
    places = np.array([geometry.index_to_world((0, 0, k)) for k in range(geometry.size[2])])
    values = np.clip(np.rint(scan.values), 0, 60000).astype(np.uint16)
    folder = tmp_path / "work"
    write_series(
        folder / "images",
        values,
        places,
        modality="MR",
        pixel_spacing=geometry.spacing_mm[1::-1],
        PatientName="DOE^JANE",
    )
    strokes = strokes_of(truth, [1, 2, 3, 4, 5, 6, 7, 8, 9], geometry)
    assert len(strokes) <= MOST_STROKES
    assert len({value for value, _ in strokes} - {0}) >= 8
    with Journey(chromium, folder, "child") as journey:
        tab, page = journey.tab, journey.page
        path = journey.begin("images")
        painter = Painter(page, geometry)
        journey.paint(painter, strokes)
        # as the same strokes in a recipe label it, and near the truth
        session = open_session(path, out=folder / "again").session
        assert len(load_recipe(path).strokes) == len(strokes)
        for value in (1, 2, 3, 4):
            one, other = session.labels == value, truth == value
            assert 2.0 * (one & other).sum() / (one.sum() + other.sum()) > 0.8, value

        # vessel ends are found and taken, with the lumen's width beside the disc's
        tab.locator("#tab-shape").click()
        tab.locator(".find-ends").click()
        tab.locator(".take-all").click(timeout=60_000)
        until(lambda: len(load_recipe(path).ends) > 3)
        assert "lumen" in page.text("[data-end='1']")
        journey.shot("ends")

        # what is asked next stays in sight
        tab.locator("[data-section=shape_model] summary").click()
        nodes = tab.locator("[data-setting='grid.node_count'] input")
        nodes.fill("4000")
        nodes.press("Tab")
        until(lambda: load_recipe(path).grid.node_count == 4000)
        hint = tab.locator("#panel-shape .hint").bounding_box()
        panel = tab.locator("#panel-shape").bounding_box()
        assert panel["y"] - 1 <= hint["y"] < panel["y"] + 20
        # a second hole: by a click on the muscle between the ventricles, away from the first
        to_left, to_right = (
            ndimage.distance_transform_edt(session.labels != value, sampling=geometry.spacing_mm[::-1])
            for value in (1, 2)
        )
        thin = np.argwhere((session.labels == 9) & (to_left + to_right < 9.0))[:, ::-1]
        places = geometry.index_to_world(thin)
        middle = places[np.linalg.norm(places - HOLE_MM, axis=1).argmax()]
        painter.look_at(middle)
        tab.locator("[data-place=septal_defect]").click()
        tab.mouse.click(*painter.pixel("axial", middle))
        until(lambda: len(load_recipe(path).edits) == 1)
        assert load_recipe(path).edits[0].kind == "septal_defect"
        journey.shot("defect")

        journey.build()
        # the scan's own hole: a wall was grown there, and one button keeps it open
        row = tab.locator(".contact").filter(has_text=VENTRICLES).first
        row.scroll_into_view_if_needed()
        row.get_by_text("Go there").click()
        page.drawn()
        journey.shot("contact")
        row.get_by_text("It is a real defect").click()
        until(lambda: len(load_recipe(path).walls.contact) == 1)
        tab.keyboard.press("z")
        until(lambda: not load_recipe(path).walls.contact)
        tab.keyboard.press("y")
        until(lambda: len(load_recipe(path).walls.contact) == 1)
        assert load_recipe(path).walls.contact[0].is_open
        recording = journey.operate()
        assert "DOE" not in tab.content()
        journey.assert_clean()
    kinds = {one.command.kind for one in open_recording(folder / recording).entries}
    assert kinds >= {"close_grab", "open_grab", "cut"}


def test_the_chest_ct_from_the_file_to_the_operated_model(chromium, tmp_path):
    recipe = load_recipe(FEW_STROKES)
    scan_file = (FEW_STROKES.parent / recipe.scan.path).resolve()
    if not scan_file.exists():
        pytest.skip("the chest CT is not here (sample_cases/chest_ct_few_strokes.toml says where to get it)")
    # what a person would mark, from what the sample's strokes label
    given = open_session(FEW_STROKES, out=tmp_path / "given")
    geometry = given.scan.geometry
    strokes = strokes_of(given.session.labels, [1, 2, 3, 4, 5, 6, 7, 8, 9], geometry)
    assert len(strokes) <= MOST_STROKES
    folder = tmp_path / "work"
    folder.mkdir()
    (folder / "chest.nii.gz").write_bytes(scan_file.read_bytes())
    with Journey(chromium, folder, "chest") as journey:
        tab, page = journey.tab, journey.page
        path = journey.begin("chest.nii.gz")
        painter = Painter(page, read_scan(scan_file).geometry)
        journey.paint(painter, strokes)
        tab.locator("#tab-shape").click()
        tab.locator(".find-ends").click()
        tab.locator(".take-all").click(timeout=120_000)
        until(lambda: len(load_recipe(path).ends) > 0)
        tab.locator("[data-section=shape_model] summary").click()
        nodes = tab.locator("[data-setting='grid.node_count'] input")
        nodes.fill("6000")
        nodes.press("Tab")
        until(lambda: load_recipe(path).grid.node_count == 6000)
        journey.build()
        volumes = open_bundle(folder / "chest.case").manifest.quality["volumes_ml"]
        assert all(volumes[f"morphologically {side} ventricle"] > 40.0 for side in ("left", "right"))
        recording = journey.operate()
        journey.assert_clean()
    assert {one.command.kind for one in open_recording(folder / recording).entries} >= {"close_grab", "cut"}
