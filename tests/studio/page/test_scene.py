"""What is seen besides the heart in Operate, in a real browser: cut plane, and what comes with it."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from heartcase.pipeline.bundle.write_bundle import (
    BundleParts,
    BundleRecord,
    BundleSource,
    assemble_bundle,
    resolve_materials,
    write_bundle,
)
from heartcase.schemas.bundle.format import StageRecord
from heartcase.schemas.recipe.settings import MaterialsSettings
from tests.factories import TABLE, block_grid, block_surface
from tests.studio.page.browsing import browsing, until
from tests.studio.page.test_operating import OPEN, CaseServer, Hands

SIZE = {"width": 1366, "height": 768}
WALL, INNER = 9, 13
"""Labels of the halves of the block, below and above x = 20.5 mm; the surface knows the first alone."""


def colour(value):
    text = next(one.colour for one in TABLE if one.value == value)
    return np.array([int(text[at : at + 2], 16) for at in (1, 3, 5)], float)


def write_two_walls(folder, **more):
    """A block of 8 x 5 x 4 cells of 3 mm on a fixed base: x 8.5 to 32.5, y -21.5 to -6.5, z 28.5 to 40.5 mm."""
    grid = block_grid((8, 5, 4))
    grid = replace(grid, cell_label=np.where(grid.cells[:, 0] < 4, WALL, INNER).astype(np.uint8))
    surface, grid_map, picking = block_surface(grid)
    parts = BundleParts(grid=grid, surface=surface, grid_map=grid_map, picking=picking)
    stages = (StageRecord(stage="grid", version=1, settings={}, output_sha256="1" * 64),)
    source = BundleSource(geometry=grid.geometry, sha256="0" * 64)
    made = assemble_bundle(
        parts, resolve_materials(MaterialsSettings(), TABLE), source, BundleRecord(name="two walls", stages=stages)
    )
    write_bundle(folder / "two.case", made)
    return folder / "two.case"


@pytest.fixture
def cut_open(tmp_path, chromium):
    server = CaseServer(write_two_walls(tmp_path))
    server.start()
    with browsing(chromium, server, viewport=SIZE) as page:
        yield page, Scene(page)
    server.stop()


class Scene(Hands):
    """The scene, and what is seen at places of it."""

    def put(self, normal, point):
        self.tab.evaluate(
            f"async ([normal, point]) => {{ const {{ plane }} = {OPEN}.picture; plane.put(normal, point);"
            "plane.show(true); }",
            [normal, point],
        )

    def seen(self, places_mm):
        """Red, green, blue at places, shape (n, 3)."""
        self.tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        shot = np.asarray(Image.open(io.BytesIO(self.tab.screenshot(animations="disabled"))).convert("RGB"), float)
        box = self.tab.locator("#scene").bounding_box()
        script = (
            f"async (places) => {{ const {{ camera }} = {OPEN}.picture; return places.map((o) => camera.pixel(o)); }}"
        )
        found = self.tab.evaluate(script, np.asarray(places_mm, float).tolist())
        pixels = np.rint(np.add(found, [box["x"], box["y"]])).astype(int)
        return shot[pixels[:, 1], pixels[:, 0]]

    def plane(self):
        return self.tab.evaluate(f"async () => {{ const {{ plane }} = {OPEN}.picture; return plane.equation; }}")


def hue(colours):
    return colours / np.linalg.norm(colours, axis=-1, keepdims=True)


def is_of(seen, value):
    """Whether colours are that of a structure, lit more or less."""
    return np.linalg.norm(hue(seen) - hue(colour(value)), axis=-1) < 0.02


def over(x, y, z):
    return np.stack([one.ravel() for one in np.meshgrid(x, y, z)], axis=-1)


def test_walls_are_capped_in_their_colours_while_the_heart_moves_and_after_cuts(cut_open):
    page, scene = cut_open
    tab = page.tab
    scene.from_above()
    tab.locator("#scene").focus()
    tab.keyboard.press("k")
    assert tab.locator("#cut-open").get_attribute("aria-pressed") == "true"
    scene.put([0, 0, 1], [26.0, -14.0, 35.0])
    left, right = (
        over(np.arange(9.5, 20.0), np.arange(-20.5, -7.0), [35.0]),
        over(np.arange(21.5, 32.0), np.arange(-20.5, -7.0), [35.0]),
    )
    # but where the handles are
    right = right[np.linalg.norm(right - [26.0, -14.0, 35.0], axis=1) > 4.0]
    tab.evaluate("() => { for (const one of document.querySelectorAll('.plane-handle')) one.style.opacity = 0; }")
    assert is_of(scene.seen(left), WALL).all()
    assert is_of(scene.seen(right), INNER).all()
    beside = over([7.6, 33.4], np.arange(-20.5, -7.0), [35.0])
    assert not (is_of(scene.seen(beside), WALL) | is_of(scene.seen(beside), INNER)).any()
    # what is taken away cannot be grabbed: the wall is held in the plane, and its cap goes with it
    tab.keyboard.press("g")
    scene.drag((14.0, -14.0, 35.0), (14.0, -9.0, 35.0))
    header = scene.until(lambda header: header["instruments"] and header["instruments"][0]["center_mm"][1] > -9.5)
    assert header["instruments"][0]["center_mm"][2] == pytest.approx(35.0, abs=0.3)
    pulled = scene.seen([(14.0, -4.5, 35.0)])
    assert is_of(pulled, WALL).all()
    tab.mouse.up()
    scene.until(lambda header: not header["instruments"])
    until(lambda: not is_of(scene.seen([(14.0, -4.5, 35.0)]), WALL).any())
    # a blade across, drawn on the cap
    tab.keyboard.press("c")
    scene.drag((26.0, -21.0, 35.0), (26.0, -17.0, 35.0), (26.0, -12.0, 35.0), (26.0, -7.0, 35.0))
    tab.mouse.up()
    scene.until(lambda header: header["topology"] > 1)
    tab.keyboard.press("o")
    assert is_of(scene.seen(left), WALL).mean() > 0.97
    away = right[np.abs(right[:, 0] - 26.0) > 1.5]
    assert is_of(scene.seen(away), INNER).mean() > 0.97
    # all but a thin slice is taken away: what is beside it is not met
    scene.put([1, 0, 0], [10.0, -14.0, 34.0])
    tab.keyboard.press("g")
    acts = scene.header()["act_count"]
    scene.drag((26.0, -12.0, 40.5))
    tab.mouse.up()
    page.drawn()
    assert scene.header()["act_count"] == acts
    # a hidden wall has no cap
    scene.put([0, 0, 1], [26.0, -14.0, 35.0])
    tab.locator("#structures button").first.click()
    assert not is_of(scene.seen(left), WALL).any()


def test_a_plane_is_led_and_turned_by_handles_wheel_and_keys(cut_open):
    page, scene = cut_open
    tab = page.tab
    scene.tab.evaluate(
        f"async () => {{ const {{ picture }} = {OPEN}; picture.camera.look([0, -1, 0]); picture.redraw(); }}"
    )
    scene.put([0, 0, 1], [20.5, -14.0, 34.5])
    page.drawn()
    move, turn = tab.locator("#plane-move"), tab.locator("#plane-turn")
    box = move.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    up = scene.pixel((20.5, -14.0, 37.5))[1]
    tab.mouse.move(x, y)
    tab.mouse.down()
    tab.mouse.move(x, up, steps=4)
    tab.mouse.up()
    assert scene.plane() == pytest.approx([0, 0, 1, 37.5], abs=0.1)
    tab.keyboard.press("ArrowDown")
    assert scene.plane()[3] == pytest.approx(36.5, abs=0.1)
    tab.keyboard.press("PageDown")
    assert scene.plane()[3] == pytest.approx(31.5, abs=0.1)
    assert "mm" in move.get_attribute("aria-valuetext")
    # its end turns it: to the right
    box = turn.bounding_box()
    tab.mouse.move(box["x"] + 12, box["y"] + 12)
    tab.mouse.down()
    tab.mouse.move(box["x"] + 72, box["y"] + 12, steps=6)
    tab.mouse.up()
    normal = np.array(scene.plane()[:3])
    assert normal[0] != 0
    tab.keyboard.press("ArrowLeft")
    assert not np.allclose(normal, scene.plane()[:3])
    # wheel and keys over the picture
    before = scene.plane()[3]
    tab.mouse.move(x - 200, y - 100)
    tab.keyboard.down("Shift")
    tab.mouse.wheel(0, 100)
    tab.keyboard.up("Shift")
    until(lambda: abs(scene.plane()[3] - before + 1.0) < 1e-6)
    tab.locator("#scene").focus()
    tab.keyboard.press(">")
    assert scene.plane()[3] == pytest.approx(before, abs=1e-6)
    # along a side of the body, and looked at
    tab.locator("#tab-view").click()
    tab.locator("#cut-axis").select_option("left")
    assert scene.plane() == pytest.approx([1, 0, 0, 20.5])
    tab.locator("#cut-flip").click()
    assert scene.plane()[0] == -1
    tab.locator("#cut-face").click()
    assert tab.evaluate(f"async () => {OPEN}.picture.camera.towards[0]") == pytest.approx(-1.0)
    assert tab.locator("#cut-axis").input_value() == ""
