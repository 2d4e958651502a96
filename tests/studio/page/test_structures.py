"""The list of structures on the studio's page: locks and states; in a real browser."""

import numpy as np

from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe
from tests.studio.axe.accessible import assert_accessible
from tests.studio.page.browsing import browsing, mm_of, pixel_of, until
from tests.studio.page.test_page import MIDDLE, inside, look_at, off, stroke


def test_a_locked_structure_stays_and_states_are_shown(chromium, painted):
    server, path, affine = painted
    middle, corner = mm_of(MIDDLE, affine)[0], mm_of([4, 24, 17], affine)[0]
    with browsing(chromium, server) as page:

        def row(name):
            return page.tab.locator("#structures .structure").filter(has_text=name)

        def state(name):
            return row(name).locator(".mark").get_attribute("data-state")

        look_at(page, middle, affine)
        assert state("aorta") == "nothing"
        for name, mm in (("background", corner), ("aorta", middle)):
            row(name).locator(".pick").click()
            stroke(page, "axial", [mm, off(mm, 2.0, 0, 0)], affine)
        page.saved(2)
        until(lambda: state("aorta") in ("confident", "unsure"))
        assert state("pulmonary artery") == "nothing"
        row("aorta").locator(".lock").click()
        page.tab.locator(".lock[aria-pressed=true]").wait_for()
        text = path.read_text()
        page.tab.mouse.move(5, 5)
        page.drawn()
        before = inside(page, "axial")
        row("pulmonary artery").locator(".pick").click()
        stroke(page, "axial", [middle, off(middle, 1.0, 0, 0)], affine)
        page.tab.locator("#notice").wait_for()
        assert "would change what is locked: aorta" in page.text("#notice")
        assert_accessible(page, "locked")
        page.tab.mouse.move(5, 5)
        row("aorta").locator(".pick").click()
        page.drawn()
        page.tab.locator("#notice-close").click()
        assert path.read_text() == text
        page.drawn()
        assert (inside(page, "axial") != before).mean() < 0.02
        row("aorta").locator(".lock").click()
        page.tab.locator(".lock[aria-pressed=true]").wait_for(state="detached")
        row("pulmonary artery").locator(".pick").click()
        stroke(page, "axial", [middle, off(middle, 1.0, 0, 0)], affine)
        page.saved(3)
        assert [one.label for one in load_recipe(path).strokes] == ["background", "aorta", "pulmonary artery"]


def test_quick_clicks_lock_one_structure_each(chromium, painted):
    server, *_ = painted
    with browsing(chromium, server) as page:
        locks = page.tab.locator("#structures .lock")
        # before the server has answered the first one
        page.tab.evaluate(
            "() => document.querySelectorAll('#structures .lock').forEach((lock, n) => n % 2 && lock.click())"
        )
        count = locks.count() // 2
        until(lambda: page.tab.locator("#structures .lock[aria-pressed=true]").count() == count)
        pressed = [one.get_attribute("aria-pressed") == "true" for one in locks.all()]
        assert pressed == [n % 2 == 1 for n in range(locks.count())]


def test_a_structure_is_added_painted_and_removed(chromium, painted):
    server, path, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    text = path.read_text()
    with browsing(chromium, server, viewport={"width": 1366, "height": 768}) as page:
        tab = page.tab

        def row(name):
            return tab.locator("#structures .structure").filter(has_text=name)

        look_at(page, middle, affine)
        count = tab.locator("#structures .structure").count()
        tab.locator("#new-structure summary").click()
        which = tab.locator("#new-structure-which")
        assert "aorta" not in which.inner_text()
        which.select_option("coronary sinus")
        assert tab.locator("#new-structure-wall").input_value() == "1.5"
        assert_accessible(page, "new structure")
        tab.locator("#new-structure-form button").dblclick()
        row("coronary sinus").wait_for()
        assert tab.locator("#notice").is_hidden()
        # it is in hand at once
        assert row("coronary sinus").locator(".pick").get_attribute("aria-pressed") == "true"
        assert parse_recipe(path.read_text(), needs_markers=False).table["coronary sinus"].wall_thickness_mm == 1.5
        stroke(page, "axial", [middle, off(middle, 2.0, 0, 0)], affine)
        page.saved(2)
        tab.locator("#new-structure summary").click()
        tab.locator("#structure-remove").click()
        tab.locator("#notice").wait_for()
        assert "take its strokes back first" in page.text("#notice")
        tab.locator("#notice-close").click()
        tab.locator("#undo").click()
        page.saved(1)
        assert tab.locator("#undo").get_attribute("title").endswith("a structure")
        tab.locator("#structure-remove").click()
        until(lambda: tab.locator("#structures .structure").count() == count)
        # once is enough: the next one in hand stays
        tab.locator("#structure-remove").wait_for(state="hidden")
        tab.locator("#undo").click()
        row("coronary sinus").wait_for()
        tab.locator("#undo").click()
        until(lambda: tab.locator("#structures .structure").count() == count)
        assert path.read_text() == text
        # one that nobody has named yet, by keys alone
        tab.locator("#new-structure summary").focus()
        tab.keyboard.press("Enter")
        tab.locator("#new-structure-which").focus()
        which.select_option("")
        tab.locator("#new-structure-name").fill("Rastelli conduit")
        tab.locator("#new-structure-role").select_option("device")
        assert tab.locator("#new-structure-wall-part").is_hidden()
        tab.keyboard.press("Tab")
        tab.locator("#new-structure-name").press("Enter")
        row("Rastelli conduit").wait_for()
        (label,) = [one for one in parse_recipe(path.read_text(), needs_markers=False).table if one.role == "device"]
        assert label.name == "Rastelli conduit"
        assert label.colour != "#a0a0a0"


def test_what_the_brush_paints_is_shown_on_every_tab(chromium, painted):
    server, *_ = painted
    with browsing(chromium, server) as page:
        shown = page.tab.locator("#in-hand")
        for tab in ("structures", "shape", "build"):
            page.tab.locator(f"#tab-{tab}").click()
            page.tab.keyboard.press("b")
            page.tab.keyboard.press("5")
            assert shown.inner_text().strip() == "Brush: aorta"
            colour = shown.locator(".chip").evaluate("(chip) => getComputedStyle(chip).backgroundColor")
            listed = page.tab.locator("#structures .picked .chip").evaluate(
                "(chip) => getComputedStyle(chip).backgroundColor"
            )
            assert colour == listed
            page.tab.keyboard.press("0")
            assert shown.inner_text().strip() == "Brush: background"
        # the eraser paints nothing, and neither does a pointer
        for key in ("x", "v"):
            page.tab.keyboard.press(key)
            assert not shown.is_visible()
        page.tab.keyboard.press("b")
        page.tab.keyboard.down("e")
        assert not shown.is_visible()
        page.tab.keyboard.up("e")
        page.tab.locator("#tab-help").click()
        page.tab.locator("#language").select_option("de")
        assert shown.inner_text().strip() == "Pinsel: Hintergrund"
        assert_accessible(page, "in hand")


def test_a_single_marked_structure_is_drawn_faintly_and_it_is_said_why(chromium, painted):
    server, path, affine = painted
    middle, corner = mm_of(MIDDLE, affine)[0], mm_of([4, 24, 17], affine)[0]
    aside = off(middle, 3.0, 3.0, 0.0)
    with browsing(chromium, server) as page:

        def tint(shown=page):
            """How far a pixel of the label is from grey, against the label's own colour."""
            shown.drawn()
            x, y = pixel_of(aside, shown, "axial", affine)[0].astype(int)
            colour = shown.tab.locator("#structures .picked .chip").evaluate(
                "(chip) => getComputedStyle(chip).backgroundColor.match(/[0-9]+/g).map(Number)"
            )
            return np.ptp(shown.pixels("axial")[y, x].astype(int)) / np.ptp(colour)

        look_at(page, middle, affine)
        page.plain()
        page.tab.keyboard.press("5")
        stroke(page, "axial", [middle, off(middle, 2.0, 0, 0)], affine)
        page.saved(1)
        page.tab.mouse.move(5, 5)
        note = page.tab.locator("#checklist").get_by_text("Only aorta is marked")
        note.wait_for()
        until(lambda: 0.15 < tint() < 0.25)
        # another page sees the same, and so does this one after it was loaded again
        with browsing(chromium, server) as other:
            look_at(other, middle, affine)
            other.plain()
            other.tab.locator("#structures .structure").filter(has_text="aorta").locator(".pick").click()
            other.tab.mouse.move(5, 5)
            until(lambda: 0.15 < tint(other) < 0.25)
        page.tab.keyboard.press("6")
        stroke(page, "axial", [corner, off(corner, 2.0, 0, 0)], affine)
        page.saved(2)
        page.tab.keyboard.press("5")
        page.tab.mouse.move(5, 5)
        until(lambda: tint() > 0.9)
        note.wait_for(state="detached")
        assert load_recipe(path).strokes[0].label == "aorta"
        page.tab.keyboard.press("z")
        until(lambda: 0.15 < tint() < 0.25)
        note.wait_for()
