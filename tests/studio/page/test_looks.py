"""What the studio's page looks like: sides, contrast, sizes, names for screen readers; in a real browser."""

import json

import numpy as np
import pytest

from heartcase.schemas.recipe.recipe import load_recipe
from tests.studio.page.browsing import SIZE, TURNED, Server, browsing, mm_of, pixel_of, until, write_recipe
from tests.studio.page.test_page import MIDDLE, at, inside, look_at, off, stroke

CONTRAST = """() => {
  const parts = (colour) => {
    const found = colour.match(/[\\d.]+/g).map(Number);
    const rgb = colour.startsWith("color(srgb") ? found.slice(0, 3).map((x) => 255 * x) : found.slice(0, 3);
    return [rgb, found.length > 3 ? found[3] : 1];
  };
  const behind = (element) => {
    const layers = [];
    for (let one = element; one; one = one.parentElement) {
      const [rgb, cover] = parts(getComputedStyle(one).backgroundColor);
      if (cover > 0) layers.push([rgb, cover]);
      if (cover === 1) break;
    }
    return layers.reverse().reduce((under, [rgb, cover]) => under.map((u, n) => u + cover * (rgb[n] - u)), [0, 0, 0]);
  };
  const light = (rgb) => {
    const [r, g, b] = rgb.map((x) => x / 255).map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const found = [];
  for (const element of document.querySelectorAll("body *")) {
    const text = [...element.childNodes].filter((one) => one.nodeType === 3).map((one) => one.data.trim()).join("");
    const isField = element.matches("input[type=number], select");
    if ((!text && !isField) || !element.checkVisibility()) continue;
    if (element.closest(".hidden-words, :disabled, noscript, option")) continue;
    const [rgb, cover] = parts(getComputedStyle(element).color);
    const under = behind(element);
    const over = rgb.map((x, n) => under[n] + cover * (x - under[n]));
    const [bright, dark] = [light(over), light(under)].sort((a, b) => b - a);
    found.push([(bright + 0.05) / (dark + 0.05), text || element.id]);
  }
  return found;
}"""
"""Contrast of every text that is seen with what lies behind it, as WCAG 2.2 defines it."""


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_every_text_stands_out(chromium, painted, theme):
    server, path, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server, color_scheme=theme) as page:
        assert page.tab.locator("html").get_attribute("data-theme") == theme
        look_at(page, middle, affine)
        stroke(page, "axial", [middle, middle + np.array([2.0, 0, 0])], affine)
        page.saved(1)
        page.tab.keyboard.press("n")
        page.tab.locator("#place").get_by_text("lace").first.wait_for(timeout=60_000)
        path.write_text(path.read_text() + "# by hand\n")
        stroke(page, "axial", [middle, middle + np.array([2.0, 0, 0])], affine)
        page.tab.locator("#notice").wait_for()
        page.ready()
        count = 0
        for hovered in ("#next-place", "button[data-tool=brush]", "#tab-help"):
            page.tab.locator(hovered).hover()
            found = page.tab.evaluate(CONTRAST)
            count += len(found)
            assert [one for one in found if one[0] < 4.5] == []
        page.tab.locator("#tab-help").click()
        found = page.tab.evaluate(CONTRAST)
        assert [one for one in found if one[0] < 4.5] == []
        assert count + len(found) > 150


def test_an_oblique_scan_has_the_sides_that_its_matrix_says(chromium, tmp_path):
    path, affine = write_recipe(tmp_path, TURNED)
    server = Server(path)
    server.start()
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server) as page:
        # all of the bar is seen with the button of oblique scans too, in the longest words and of the longest names
        page.tab.locator("#tab-help").click()
        for language in ("de", "en"):
            page.tab.locator("#language").select_option(language)
            page.tab.locator("#case-name").evaluate(
                "(one) => { one.textContent = 'a long name of a heart '.repeat(5); }"
            )
            for selector in ("#planes-open", "#fit", "#theme", "#outline"):
                box = page.tab.locator(selector).bounding_box()
                assert box["x"] + box["width"] <= 1280, (selector, language)
            assert page.tab.locator("header").bounding_box()["height"] < 48
        page.tab.locator("#tab-structures").click()
        page.drawn()
        sides = {view: page.text(f"#sides-{view}") for view in ("axial", "coronal", "sagittal")}
        # planes of the patient at first
        assert sides["axial"] == "Left R, right L, above A, below P."
        assert sides["coronal"] == "Left R, right L, above H, below F."
        assert sides["sagittal"] == "Left A, right P, above H, below F."
        page.tab.locator("#planes-open").click()
        page.tab.locator("[data-planes=scan]").click()
        page.tab.keyboard.press("Escape")
        page.drawn()
        # turned by 35 degrees about the head-foot axis: 0.82 to the patient's left, 0.57 to the back
        sides = {view: page.text(f"#sides-{view}") for view in ("axial", "coronal", "sagittal")}
        assert sides["axial"] == "Left R·A, right L·P, above A·L, below P·R."
        assert sides["coronal"] == "Left R·A, right L·P, above H, below F."
        assert sides["sagittal"] == "Left A·L, right P·R, above H, below F."
        # and the bright block is seen as a box again, where the matrix has it
        i_left, j_back = -TURNED[:, 0], TURNED[:, 1]
        frames = {"axial": (i_left, j_back), "coronal": (i_left, (0, 0, -1)), "sagittal": (j_back, (0, 0, -1))}
        page.tab.keyboard.press("v")
        for view in ("axial", "sagittal"):
            x, y, *_ = page.box(view)
            page.tab.mouse.click(*(np.array([x, y]) + pixel_of(middle, page, view, affine, frames[view])[0]))
        page.tab.keyboard.press("b")
        for view, frame in frames.items():
            x, y, *_ = page.box(view)
            xy = np.array([x, y]) + pixel_of(middle, page, view, affine, frame)[0]
            page.tab.mouse.move(*xy)
            under = page.text("#under").split()
            sides, values = under[0:6:2], [float(one) for one in under[1:6:2]]
            found = [value if side in "LPH" else -value for side, value in zip(sides, values, strict=True)]
            np.testing.assert_allclose(found, middle, atol=0.2)
            intensity = float(under[7])
            assert intensity > 450.0
            page.tab.mouse.down()
            page.tab.mouse.up()
        page.saved(3)
        for one in load_recipe(path).strokes:
            np.testing.assert_allclose(one.points_mm[0], middle, atol=0.2)
    server.stop()


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (1366, 768), (1920, 1080)])
def test_all_of_it_is_seen(chromium, painted, width, height):
    server, _, _ = painted
    with browsing(chromium, server, viewport={"width": width, "height": height}) as page:
        assert page.tab.evaluate(
            "() => [document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
        ) == [width, height]
        assert page.tab.locator("header").bounding_box()["height"] < 48
        for selector in ("#undo", "#window", "#theme", "#axial .surface", "#solid .surface", "#next-place", "#saved"):
            box = page.tab.locator(selector).bounding_box()
            assert box["x"] >= 0, selector
            assert box["x"] + box["width"] <= width, selector
            assert box["y"] + box["height"] <= height, selector
        small = page.box("coronal")[2]
        page.tab.locator("#coronal .enlarge").click()
        page.drawn()
        assert page.box("coronal")[2] > 1.3 * small
        page.tab.keyboard.press("Escape")
        assert page.box("coronal")[2] == small


def test_fine_screens_get_fine_pictures(chromium, painted):
    server, _, affine = painted
    with browsing(chromium, server, device_scale_factor=2) as page:
        sizes = page.tab.evaluate(
            "() => [...document.querySelectorAll('canvas')].map((one) => [one.width, one.clientWidth])"
        )
        assert all(abs(width - 2 * shown) <= 2 for width, shown in sizes)
        look_at(page, mm_of(MIDDLE, affine)[0], affine)
        assert page.pixels("axial").shape[1] == pytest.approx(2 * page.box("axial")[2], abs=2)


def test_everything_that_is_used_has_a_name(chromium, painted):
    server, _, _ = painted
    with browsing(chromium, server) as page:
        nameless = page.tab.evaluate(
            """() => [...document.querySelectorAll("button, input, select, [role=application], [role=tab]")]
              .filter((one) => one.checkVisibility())
              .filter((one) => !(one.getAttribute("aria-label") || one.textContent.trim() || one.labels?.length))
              .map((one) => one.outerHTML)"""
        )
        assert nameless == []
        small = page.tab.evaluate(
            """() => [...document.querySelectorAll("button, select")].filter((one) => one.checkVisibility())
              .map((one) => [one.outerHTML.slice(0, 80), one.getBoundingClientRect()])
              .filter(([, box]) => box.width < 24 || box.height < 24).map(([text]) => text)"""
        )
        # targets of WCAG 2.2, 2.5.8
        assert small == []
        for language in ("de", "en"):
            page.tab.locator("#tab-help").click()
            page.tab.locator("#language").select_option(language)
            assert page.tab.locator("html").get_attribute("lang") == language
            page.tab.locator("#tab-structures").click()
        kept = json.dumps(page.tab.evaluate("() => ({...localStorage})"))
        assert "painted" not in kept
        assert page.tab.title() == "heartcase studio"


def test_solids_are_seen_turned_and_take_the_slices_along(chromium, painted):
    server, _, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server) as page:
        look_at(page, middle, affine)
        page.tab.keyboard.press("5")
        assert (inside(page, "solid")[40:-60, 40:-40].max(axis=2) > 60).mean() < 0.01
        for name, mm in (("0", mm_of([4, 24, 17], affine)[0]), ("5", middle)):
            page.tab.keyboard.press(name)
            stroke(page, "axial", [mm, mm + np.array([2.0, 0, 0])], affine)
        page.saved(2)
        page.tab.mouse.move(5, 5)

        def reddish():
            red, green, blue = np.moveaxis(inside(page, "solid").astype(int), -1, 0)
            return (red > 40) & (red > 2 * green) & (red > 1.5 * blue)

        until(lambda: reddish().mean() > 0.002)
        rows, columns = np.nonzero(reddish())
        # from the front and a little from the left and above, as the block's middle lies
        x, y, *_ = page.box("solid")
        page.tab.mouse.click(5, 5)
        before = page.text("#under")
        page.tab.mouse.click(x + 5 + np.median(columns), y + 5 + np.median(rows))
        page.tab.mouse.move(5, 5)
        assert page.text("#under") != before
        assert "aorta" in page.text("#under")
        seen = inside(page, "solid")
        page.tab.mouse.move(x + 100, y + 100)
        page.tab.mouse.down()
        page.tab.mouse.move(x + 220, y + 100, steps=4)
        page.tab.mouse.up()
        page.tab.wait_for_timeout(400)
        assert (inside(page, "solid") != seen).any()
        # a structure that is hidden is no solid
        page.tab.locator("#structures .structure").filter(has_text="aorta").locator(".show").click()
        until(lambda: reddish().mean() < 0.0005)


def test_window_presets_are_those_of_the_modality(chromium, painted):
    server, path, _ = painted
    with browsing(chromium, server) as page:
        names = page.tab.locator("#window option").all_inner_texts()
        assert "Darker half" in names
        assert "Lung" not in names
        level, width = (float(page.tab.locator(f"#window-{one}").input_value()) for one in ("level", "width"))
        page.tab.locator("#window").select_option(label="Darker half")
        assert float(page.tab.locator("#window-width").input_value()) == pytest.approx(width / 2, abs=1)
        assert float(page.tab.locator("#window-level").input_value()) == pytest.approx(level - width / 4, abs=1)
        before = inside(page, "coronal")
        x, y, w, h = page.box("coronal")
        page.tab.mouse.move(x + w / 2, y + h / 2)
        page.tab.mouse.down(button="right")
        page.tab.mouse.move(x + w / 2 + 50, y + h / 2 + 40)
        page.tab.mouse.up(button="right")
        page.tab.mouse.move(5, 5)
        page.drawn()
        assert (inside(page, "coronal") != before).any()
        assert "[[strokes]]" not in path.read_text()


def test_wheel_zoom_and_pan(chromium, painted):
    server, _, affine = painted
    with browsing(chromium, server) as page:
        first = page.text("#axial output")
        x, y = at(page, "axial", mm_of((SIZE - 1) / 2, affine)[0], affine)
        page.tab.mouse.move(x, y)
        page.tab.mouse.wheel(0, -120)
        until(lambda: page.text("#axial output") != first)
        at_first, now = (int(text.split()[0]) for text in (first, page.text("#axial output")))
        # away from the hand goes to the head
        assert now == at_first + 1
        radius = page.text("#radius-words")
        page.tab.keyboard.down("Shift")
        page.tab.mouse.wheel(0, -120)
        page.tab.keyboard.up("Shift")
        until(lambda: page.text("#radius-words") != radius)
        for keys, does in ((["Control"], lambda: page.tab.mouse.wheel(0, -300)), ([], None)):
            before = inside(page, "axial")
            for key in keys:
                page.tab.keyboard.down(key)
            if does:
                does()
            else:
                page.tab.mouse.down(button="middle")
                page.tab.mouse.move(x + 40, y + 30, steps=3)
                page.tab.mouse.up(button="middle")
            for key in keys:
                page.tab.keyboard.up(key)
            page.drawn()
            until(lambda seen=before: (inside(page, "axial") != seen).mean() > 0.02)


def test_the_foot_follows_what_moves_below_a_mouse_that_rests(chromium, painted):
    server, _, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server) as page:
        look_at(page, middle, affine)
        beside = at(page, "axial", off(middle, 4.0, 3.0, 0.0), affine)
        page.tab.locator("#axial .surface").focus()
        page.tab.mouse.move(*beside)
        seen = [page.text("#under")]
        slider = page.tab.locator("#axial .slice-slider")
        for move in (
            lambda: page.tab.keyboard.press("ArrowUp"),
            lambda: page.tab.keyboard.press("PageDown"),
            lambda: slider.evaluate("(one) => { one.value = 3; one.dispatchEvent(new Event('input')); }"),
        ):
            move()
            page.drawn()
            shown = page.text("#under")
            assert shown != seen[-1]
            # it is what the mouse says that comes back to the same pixel
            page.tab.mouse.move(*(beside + 40))
            page.tab.mouse.move(*beside)
            until(lambda shown=shown: page.text("#under") == shown)
            seen.append(shown)
