"""What is seen besides the heart in Operate, in a real browser: cut plane, and what comes with it."""

import io

import numpy as np
import pytest
from PIL import Image

from heartcase.pipeline.bundle.write_bundle import BundleSource, write_bundle
from heartcase.pipeline.stages.read import region_of_scan
from heartcase.schemas.recipe.recipe import parse_recipe
from heartcase.studio.operating.theatre import Origin
from tests.factories import TABLE
from tests.studio.axe.accessible import assert_accessible
from tests.studio.operating.two_walls import INNER, WALL, two_walls
from tests.studio.page.browsing import TURNED, browsing, until, write_recipe
from tests.studio.page.test_operating import OPEN, CaseServer, Hands

SIZE = {"width": 1366, "height": 768}


def colour(value):
    text = next(one.colour for one in TABLE if one.value == value)
    return np.array([int(text[at : at + 2], 16) for at in (1, 3, 5)], float)


class FromRecipe(CaseServer):
    """The case is opened from its recipe, and knows its scan."""

    def open_in(self, registry):
        folder = self.recipe.parent
        opened = registry.open_recipe(folder / "painted.toml", out=folder)
        return registry.open_case(self.recipe, out=folder, origin=Origin(folder / "painted.toml", opened.address))


@pytest.fixture(scope="module")
def shown(tmp_path_factory, chromium):
    """One page for all tests here."""
    folder = tmp_path_factory.mktemp("scene")
    recipe, Scene.scan = write_recipe(folder, TURNED)
    scan = region_of_scan(parse_recipe(recipe.read_text(), needs_markers=False), folder)
    write_bundle(folder / "two.case", two_walls(BundleSource(geometry=scan.geometry, sha256=scan.values_sha256)))
    server = FromRecipe(folder / "two.case")
    server.start()
    with browsing(chromium, server, viewport=SIZE, has_touch=True) as page:
        yield page
    server.stop()


@pytest.fixture
def cut_open(shown):
    """The page as it is when the case is opened."""
    shown.tab.reload()
    shown.ready()
    scene = Scene(shown)
    shown.tab.locator("#tab-recordings").click()
    shown.tab.locator("#begin").click()
    scene.until(lambda header: header["act_count"] == 0 and header["mode"] == "running")
    shown.tab.locator("#tab-structures").click()
    return shown, scene


class Scene(Hands):
    """The scene, and what is seen at places of it."""

    scan = None
    """Affine of the scan, shape (4, 4)."""

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


class Touching:
    """Fingers and a pen, as the browser's own input has them."""

    def __init__(self, page):
        self.line = page.tab.context.new_cdp_session(page.tab)
        self.page = page

    def fingers(self, kind, *pixels):
        points = [{"x": x, "y": y, "id": n} for n, (x, y) in enumerate(pixels)]
        self.line.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})

    def pen(self, kind, x, y):
        buttons = 0 if kind == "Released" else 1
        self.line.send(
            "Input.dispatchMouseEvent",
            {"type": f"mouse{kind}", "x": x, "y": y, "button": "left", "buttons": buttons, "pointerType": "pen"}
            | {"clickCount": 1, "force": 0.5},
        )

    def between(self, start, end, steps=5):
        return [tuple(np.array(start) + (np.array(end) - start) * n / steps) for n in range(1, steps + 1)]


def test_one_finger_and_a_pen_act_and_two_fingers_turn_and_zoom(cut_open):
    page, scene = cut_open
    touching, tab = Touching(page), page.tab
    scene.from_above()
    tab.evaluate(
        "() => { window.kinds = []; document.querySelector('#scene').addEventListener('pointerdown', "
        "(event) => window.kinds.push(event.pointerType)); }"
    )
    tab.locator("#tools button[data-key=g]").tap()
    top, aside = scene.pixel((22.0, -14.0, 40.5)), scene.pixel((27.0, -14.0, 40.5))

    def camera():
        return tab.evaluate(
            f"async () => {{ const {{ towards, distance, target }} = {OPEN}.picture.camera;"
            "return { towards, distance, target }; }"
        )

    before = camera()
    # one finger pulls
    touching.fingers("Start", top)
    for place in touching.between(top, aside):
        touching.fingers("Move", place)
    scene.until(lambda header: header["instruments"] and header["instruments"][0]["center_mm"][0] > 26.5)
    # another, as of a hand that is laid down, changes nothing
    touching.fingers("Start", aside, (top[0], top[1] + 150))
    touching.fingers("Move", aside, (top[0] + 80, top[1] + 150))
    touching.fingers("Move", aside)
    page.drawn()
    assert scene.header()["instruments"]
    assert camera() == before
    touching.fingers("End")
    scene.until(lambda header: not header["instruments"])
    # two fingers turn and zoom, and no instrument is taken by the first
    left, right = (top[0] - 40, top[1]), (top[0] + 40, top[1])
    for _ in range(10):
        acts = scene.header()["act_count"]
        touching.fingers("Start", left)
        touching.fingers("Start", left, right)
        for n in range(1, 6):
            touching.fingers("Move", (left[0] - 8 * n, left[1] + 10 * n), (right[0] + 8 * n, right[1] + 10 * n))
        touching.fingers("End")
        page.drawn()
        after = camera()
        if after != before:
            break
        # on a machine that is slow just now the second finger came so late that the first one had the tool
        scene.until(lambda header, acts=acts: not header["instruments"] and header["act_count"] > acts)
    assert after["distance"] == pytest.approx(before["distance"] / 2.0, rel=0.05)
    assert after["towards"][2] < 0.99
    assert after["target"] == before["target"]
    tab.wait_for_timeout(200)
    assert scene.header()["act_count"] == acts
    # three move
    touching.fingers("Start", left, right, (top[0], top[1] + 60))
    for n in range(1, 4):
        touching.fingers("Move", *((x + 20 * n, y) for x, y in (left, right, (top[0], top[1] + 60))))
    touching.fingers("End")
    page.drawn()
    assert camera()["target"] != after["target"]
    # a pen pulls at once
    scene.from_above()
    tab.evaluate(f"async (one) => {{ Object.assign({OPEN}.picture.camera, one); }}", {"target": before["target"]})
    tab.evaluate(f"async (one) => {{ {OPEN}.picture.camera.distance = one; }}", before["distance"])
    touching.pen("Pressed", *top)
    for place in touching.between(top, aside):
        touching.pen("Moved", *place)
    scene.until(lambda header: header["instruments"] and header["instruments"][0]["center_mm"][0] > 26.5)
    touching.pen("Released", *aside)
    scene.until(lambda header: not header["instruments"])
    assert set(tab.evaluate("() => window.kinds")) == {"touch", "pen"}


def test_slices_lie_where_the_scan_is_and_the_recipe_is_a_click_away(cut_open):
    page, scene = cut_open
    tab = page.tab
    tab.locator("#tab-view").click()
    for name in ("axial", "sagittal"):
        tab.locator(f"#scan-{name}").check()
    slices = f"async () => {{ const {{ slices: s }} = {OPEN}.picture; return s.names.map((o) => [o, s.corners(o)]); }}"
    until(lambda: len(tab.evaluate(slices)) == 2)
    tab.locator("#scan-sagittal-at").evaluate("(one) => { one.value = 18; one.dispatchEvent(new Event('input')); }")
    until(lambda: dict(tab.evaluate(slices))["sagittal"][0][0] == 18.0)
    # level and width, by the same words as in Paint: as at first, and then with all of it white
    assert tab.locator("#scan-level").is_enabled()
    assert float(tab.locator("#scan-width").input_value()) > 0.0
    shown = tab.locator("#scene").screenshot()
    tab.locator("#scan-level").evaluate("(one) => { one.value = one.min; one.dispatchEvent(new Event('input')); }")
    until(lambda: tab.locator("#scene").screenshot() != shown)
    # all of the scan is in the picture: it begins and ends where the scan's box does
    scan = scene.scan
    corner, right, down = (np.array(one) for one in dict(tab.evaluate(slices))["axial"])
    corners = np.array([[i, j, k] for i in (-0.5, 39.5) for j in (-0.5, 29.5) for k in (-0.5, 23.5)])
    places = corners @ scan[:3, :3].T + scan[:3, 3]
    assert corner[:2] == pytest.approx(places.min(axis=0)[:2], abs=0.05)
    assert [right[0], down[1]] == pytest.approx(places.max(axis=0)[:2], abs=1.1)
    # in the cut plane
    scene.put([0, 0, 1], [20.5, -14.0, 35.0])
    tab.locator("#scan-cut").check()
    until(lambda: "cut" in dict(tab.evaluate(slices)))
    assert dict(tab.evaluate(slices))["cut"][0][2] == pytest.approx(35.0)
    scene.put([0, 0, 1], [20.5, -14.0, 33.0])
    until(lambda: dict(tab.evaluate(slices))["cut"][0][2] == pytest.approx(33.0))
    tab.keyboard.press("k")
    page.drawn()
    assert "cut" not in dict(tab.evaluate(slices))
    with tab.expect_navigation():
        tab.locator("#recipe").click()
    page.ready()
    assert "/prepare/" in tab.url
    tab.go_back()
    page.ready()


def test_two_views_draw_the_same_and_surroundings_are_not_met(cut_open):
    page, scene = cut_open
    tab = page.tab
    scene.from_above()
    page.drawn()
    memory = f"async () => ({{...{OPEN}.picture.renderer.info.memory}})"
    before = tab.evaluate(memory)
    tab.keyboard.press("i")
    page.drawn()
    assert tab.locator("#scene-2").is_visible()
    # nothing of the heart is twice on the graphics card
    assert tab.evaluate(memory) == before
    # the second looks from elsewhere, and acts
    tab.locator("#second-look").select_option("head")
    second = f"async (place) => {{ const {{ camera }} = {OPEN}.picture.views[1]; return camera.pixel(place); }}"
    page.drawn()
    box = tab.locator("#scene-2").bounding_box()
    x, y = tab.evaluate(second, [22.0, -14.0, 40.5])
    tab.keyboard.press("g")
    tab.mouse.move(box["x"] + x, box["y"] + y)
    tab.mouse.down()
    header = scene.until(lambda header: bool(header["instruments"]))
    assert header["instruments"][0]["center_mm"] == pytest.approx([22.0, -14.0, 40.5], abs=0.6)
    tab.mouse.up()
    scene.until(lambda header: not header["instruments"])
    tab.keyboard.press("i")
    # drape and instruments around are no part of what is pointed at
    tab.keyboard.press("d")
    page.drawn()
    assert tab.evaluate(memory)["geometries"] > before["geometries"]
    scene.drag((22.0, -14.0, 40.5), (22.0, -14.0, 40.5))
    scene.until(lambda header: bool(header["instruments"]))
    tab.mouse.up()
    scene.until(lambda header: not header["instruments"])


def test_axe_finds_nothing_on_what_is_seen_besides(cut_open):
    page, scene = cut_open
    tab = page.tab
    tab.locator("#tab-view").click()
    scene.put([0, 0, 1], [20.5, -14.0, 35.0])
    tab.locator("#two-views").click()
    for theme, language in (("light", "de"), ("dark", "en")):
        if tab.locator("html").get_attribute("data-theme") != theme:
            tab.locator("#theme").click()
        tab.locator("#tab-help").click()
        tab.locator("#language").select_option(language)
        tab.locator("#tab-view").click()
        page.drawn()
        assert_accessible(page, f"{theme}, {language}, view")
    assert tab.evaluate("() => document.documentElement.scrollWidth") == SIZE["width"]
