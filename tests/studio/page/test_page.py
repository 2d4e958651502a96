"""Painting on the studio's page with mouse, keys, pen and fingers, in a real browser."""

import numpy as np
import pytest

from heartcase.pipeline.building.session_file import open_session
from heartcase.pipeline.watershed import forest, voxel_labels
from heartcase.schemas.recipe.recipe import load_recipe
from tests.studio.page.browsing import BLOCK, FRAMES, SIZE, browsing, mm_of, pixel_of, until

MIDDLE = np.array([29.0, 9.0, 17.0])
"""A voxel in the middle of the bright block, and of no slice's edge."""


def scan_indices():
    return np.stack(np.meshgrid(*map(np.arange, SIZE), indexing="ij"), axis=-1)


def at(page, view, mm, affine):
    """Where a position is seen, in the window's pixels."""
    x, y, *_ = page.box(view)
    return np.array([x, y]) + pixel_of(mm, page, view, affine)[0]


def off(mm, *by):
    """A position that lies off another one, mm."""
    return np.asarray(mm) + by


def look_at(page, mm, affine):
    """Take all slices to a position, by the pointer."""
    page.tab.keyboard.press("v")
    for view in ("axial", "sagittal"):
        page.tab.mouse.click(*at(page, view, mm, affine))
    page.tab.keyboard.press("b")
    page.tab.mouse.move(5, 5)
    page.drawn()


def stroke(page, view, points_mm, affine, *, steps=6):
    """Draw with the mouse through positions of the slice that is shown."""
    first, *others = [at(page, view, mm, affine) for mm in points_mm]
    page.tab.mouse.move(*first)
    page.tab.mouse.down()
    for xy in others:
        page.tab.mouse.move(*xy, steps=steps)
    page.tab.mouse.up()


def slice_voxels(view, through):
    """The voxels (n, 3) of the slice of a view through a voxel; the scan's axes run along the patient's."""
    axis = {"axial": 2, "coronal": 1, "sagittal": 0}[view]
    voxels = scan_indices().reshape(-1, 3)
    return voxels[voxels[:, axis] == through[axis]]


def assert_shown(page, view, labels, table, through, affine):
    """Every voxel of the slice has its label's colour on the screen, in its middle."""
    voxels = slice_voxels(view, through)
    picture = page.pixels(view)
    x, y = np.floor(pixel_of(mm_of(voxels, affine), page, view, affine)).astype(int).T
    seen = picture[y, x].astype(int)
    i, j, k = voxels.T
    wanted = labels[k, j, i]
    is_checked = np.ones(len(voxels), bool)
    # the crosshair, letters and the scale lie over some
    height, width = picture.shape[:2]
    cross = pixel_of(mm_of(through, affine), page, view, affine)[0]
    is_checked &= (abs(x - cross[0]) > 3) & (abs(y - cross[1]) > 3)
    is_checked &= ~((abs(x - width / 2) < 12) & ((y < 26) | (y > height - 26))) & ~((x < 180) & (y > height - 34))
    is_checked &= ~((abs(y - height / 2) < 12) & ((x < 30) | (x > width - 30)))
    assert is_checked.mean() > 0.6
    for value in np.unique(wanted):
        here = is_checked & (wanted == value)
        if value == 255:
            # grey where there is no label
            assert (np.ptp(seen[here], axis=1) <= 1).all()
            continue
        colour = table[int(value)].colour
        rgb = [int(colour[n : n + 2], 16) for n in (1, 3, 5)]
        assert (abs(seen[here] - rgb) <= 1).all(), (view, value)


def inside(page, view):
    """What is seen of a view, without the rim that shows where keys go."""
    return page.pixels(view)[5:-5, 5:-5]


def test_a_stroke_by_mouse_labels_the_right_voxels_in_all_slices_and_is_in_the_recipe(chromium, painted):
    server, path, affine = painted
    text = path.read_text()
    corner, middle = mm_of([4, 24, 17], affine)[0], mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server) as page:
        page.plain()
        look_at(page, middle, affine)
        before = {view: inside(page, view) for view in FRAMES}
        page.tab.keyboard.press("0")
        stroke(page, "axial", [corner, off(corner, 6.0, 0, 0)], affine)
        page.saved(1)
        page.tab.keyboard.press("5")
        drawn = [off(middle, -2.0, 0, 0), off(middle, 1.5, 0, 0), off(middle, 1.5, 3.0, 0)]
        stroke(page, "axial", drawn, affine)
        page.saved(2)
        page.tab.mouse.move(5, 5)
        page.drawn()
        # the recipe holds what was drawn, where it was drawn
        last = load_recipe(path).strokes[-1]
        assert [one.label for one in load_recipe(path).strokes] == ["background", "aorta"]
        assert last.radius_mm == 3.0
        assert np.linalg.norm(last.points_mm[0] - drawn[0]) < 0.2
        assert np.linalg.norm(last.points_mm[-1] - drawn[-1]) < 0.5
        assert len(last.points_mm) > 5
        # and what is seen is what a session in Python makes of it, voxel for voxel
        session = open_session(path, out=path.parent / "out").session
        i, j, k = MIDDLE.astype(int)
        aorta, background = session.table["aorta"].value, 0
        assert session.labels[k, j, i] == aorta
        assert session.labels[17, 24, 4] == background
        for view in FRAMES:
            assert_shown(page, view, session.labels, session.table, MIDDLE.astype(int), affine)
        # back, and forth
        after = {view: inside(page, view) for view in FRAMES}
        page.tab.keyboard.press("Control+z")
        page.saved(1)
        assert [one.label for one in load_recipe(path).strokes] == ["background"]
        page.tab.keyboard.press("Control+z")
        page.saved(0)
        assert path.read_text() == text
        for view in FRAMES:
            np.testing.assert_array_equal(inside(page, view), before[view])
        page.tab.keyboard.press("Control+y")
        page.tab.locator("#redo .count").get_by_text("1", exact=True).wait_for()
        page.tab.keyboard.press("Control+Shift+z")
        page.saved(2)
        for view in FRAMES:
            np.testing.assert_array_equal(inside(page, view), after[view])
        # of a slice that is drawn only where labels changed the rims are right, too
        page.tab.locator("#outline").set_checked(True)
        page.tab.locator("#opacity").evaluate("(one) => { one.value = 30; one.dispatchEvent(new Event('input')); }")
        page.tab.keyboard.press("Control+z")
        page.saved(1)
        in_part = {view: inside(page, view) for view in FRAMES}
        page.tab.keyboard.press("l")
        page.drawn()
        page.tab.keyboard.press("l")
        page.drawn()
        for view in FRAMES:
            np.testing.assert_array_equal(in_part[view], inside(page, view))
        page.tab.keyboard.press("Control+y")
        page.saved(2)
        # a page that is loaded again shows the same, and can go back as far
        page.tab.reload()
        page.ready()
        page.plain()
        look_at(page, middle, affine)
        page.tab.mouse.move(5, 5)
        page.saved(2)
        for view in FRAMES:
            assert_shown(page, view, session.labels, session.table, MIDDLE.astype(int), affine)


def test_slices_that_are_shown_come_first_and_others_are_right_when_they_are_scrolled_to(
    chromium, painted, monkeypatch
):
    # every stroke is one that changes more than is worked out at once, and basins are left behind
    monkeypatch.setattr(voxel_labels, "MOST_AT_ONCE", 0)
    monkeypatch.setattr(forest, "BEHIND_FROM", 0)
    monkeypatch.setattr(forest, "FEW_MARKED", 1.0)
    server, path, affine = painted
    corner, middle = mm_of([4, 24, 17], affine)[0], mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server) as page:
        page.plain()
        look_at(page, middle, affine)
        for number, (key, at_mm) in enumerate((("0", corner), ("5", middle)), start=1):
            page.tab.keyboard.press(key)
            stroke(page, "axial", [at_mm, off(at_mm, 2.0, 0, 0)], affine)
            page.saved(number)
        session = open_session(path, out=path.parent / "out").session
        for voxel in (MIDDLE, MIDDLE - [4, 0, 0], MIDDLE - [0, -2, 3], np.array([5.0, 22.0, 4.0])):
            look_at(page, mm_of(voxel, affine)[0], affine)
            page.tab.wait_for_timeout(300)
            for view in FRAMES:
                assert_shown(page, view, session.labels, session.table, voxel.astype(int), affine)


def test_the_picture_lies_as_radiologists_see_it(chromium, painted):
    server, _, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    low, high = BLOCK
    with browsing(chromium, server) as page:
        look_at(page, middle, affine)
        page.tab.mouse.move(5, 5)
        page.drawn()
        for view, axis in (("axial", 2), ("coronal", 1), ("sagittal", 0)):
            bright = page.pixels(view).astype(int).min(axis=2) > 200
            # letters and lines are thin
            inner = bright & np.roll(bright, 4, 0) & np.roll(bright, -4, 0) & np.roll(bright, 4, 1)
            rows, columns = np.nonzero(inner & np.roll(bright, -4, 1))
            corners = np.array([low, high]) - 0.5
            corners[:, axis] = MIDDLE[axis]
            wanted = pixel_of(mm_of(corners, affine), page, view, affine)
            assert columns.min() == pytest.approx(wanted[:, 0].min(), abs=12), view
            assert columns.max() == pytest.approx(wanted[:, 0].max(), abs=12), view
            assert rows.min() == pytest.approx(wanted[:, 1].min(), abs=12), view
            assert rows.max() == pytest.approx(wanted[:, 1].max(), abs=12), view


def test_by_keys_alone(chromium, painted):
    server, path, affine = painted
    with browsing(chromium, server) as page:
        # every slice can be reached by Tab
        reached = []
        for _ in range(80):
            page.tab.keyboard.press("Tab")
            reached.append(
                page.tab.evaluate(
                    "() => document.activeElement.closest('.tile')?.id + document.activeElement.className"
                )
            )
            if reached[-1] == "axialsurface":
                break
        assert reached[-1] == "axialsurface"
        keys = [
            "3",
            "ArrowUp",
            "ArrowUp",
            "ArrowDown",
            "ArrowUp",
            "Shift+ArrowRight",
            "Shift+ArrowDown",
            "]",
            "[",
            "Enter",
        ]
        for key in keys:
            page.tab.keyboard.press(key)
        page.saved(1)
        last = load_recipe(path).strokes[-1]
        table = open_session(path, out=path.parent / "out").session.table
        assert table[last.label].value == 3
        # up goes to the head, to the right of the picture is the patient's left, down is the back; i runs to the right
        wanted = mm_of(SIZE // 2 + np.array([-1, 1, 2]), affine)[0]
        np.testing.assert_allclose(last.points_mm, [wanted], atol=1e-3)
        page.tab.keyboard.press("x")
        page.tab.keyboard.press("Enter")
        page.saved(2)
        assert load_recipe(path).strokes[-1].erase
        page.tab.keyboard.press("z")
        page.saved(1)
        page.tab.keyboard.press("y")
        page.saved(2)
        # key after key, without a look at what came of the one before
        for key in ("z", "y", "z", "z", "y"):
            page.tab.keyboard.press(key)
        page.saved(1)


def test_after_a_click_keys_are_the_slices_and_by_keys_a_button_keeps_them(chromium, painted):
    server, _, _ = painted
    with browsing(chromium, server) as page:
        tab = page.tab
        surface = "() => document.activeElement.closest('.tile')?.id + document.activeElement.className"
        for button in ("#tab-structures", "button[data-tool=pointer]", "#fit", "#tab-build"):
            tab.locator("#coronal .surface").focus()
            tab.locator(button).click()
            assert tab.evaluate(surface) == "coronalsurface", button
        # the space bar changes tools, and presses nothing again
        tab.keyboard.press("Space")
        assert tab.locator("button[data-tool=brush]").get_attribute("aria-pressed") == "true"
        # what a click opens keeps the focus
        tab.locator("#case-name").click()
        assert tab.evaluate("() => document.activeElement.id") == "case-rename"
        tab.keyboard.press("Escape")
        tab.locator("button[data-tool=ruler]").focus()
        tab.keyboard.press("Space")
        assert tab.locator("button[data-tool=ruler]").get_attribute("aria-pressed") == "true"
        assert tab.evaluate("() => document.activeElement.dataset.tool") == "ruler"


def test_keys_that_are_switched_off_do_nothing(chromium, painted):
    server, path, _ = painted
    with browsing(chromium, server) as page:
        page.tab.locator("#tab-help").click()
        page.tab.locator("#keys-on").set_checked(False)
        page.tab.locator("#axial .surface").focus()
        page.tab.keyboard.press("Enter")
        page.tab.keyboard.press("x")
        assert page.tab.locator("button[data-tool=brush]").get_attribute("aria-pressed") == "true"
        page.drawn()
        assert (
            load_recipe(path, needs_markers=False).strokes == ()
            if False
            else path.read_text().count("[[strokes]]") == 0
        )


def test_what_erases_and_what_takes_back(chromium, painted):
    server, path, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server) as page:
        look_at(page, middle, affine)
        stroke(page, "coronal", [middle, off(middle, 2.0, 0, 2.0)], affine)
        page.saved(1)
        page.tab.keyboard.down("e")
        assert page.tab.locator("button[data-tool=eraser]").get_attribute("aria-pressed") == "true"
        stroke(page, "sagittal", [middle, off(middle, 0, 1.0, 0)], affine)
        page.tab.keyboard.up("e")
        page.saved(2)
        assert [one.erase for one in load_recipe(path).strokes] == [False, True]
        # erased where it was painted: no voxel at the middle is marked any more
        session = open_session(path, out=path.parent / "out").session
        i, j, k = MIDDLE.astype(int)
        assert session.marked[k, j, i] == 255
        page.tab.locator("#undo").click()
        page.saved(1)
        assert [one.erase for one in load_recipe(path).strokes] == [False]
        page.tab.locator("#redo").click()
        page.saved(2)


def test_pen_and_fingers(chromium, painted):
    server, path, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server, has_touch=True) as page:
        look_at(page, middle, affine)
        tool = page.tab.context.new_cdp_session(page.tab)
        one, two = at(page, "axial", middle, affine), at(page, "axial", off(middle, 4.0, 0, 0), affine)

        def touch(kind, *points):
            fingers = [{"x": float(x), "y": float(y), "id": n} for n, (x, y) in enumerate(points)]
            tool.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})

        # one finger paints
        touch("touchStart", one)
        touch("touchMove", (one + two) / 2)
        touch("touchMove", two)
        touch("touchEnd")
        page.saved(1)
        assert len(load_recipe(path).strokes[-1].points_mm) >= 2
        # two zoom, and paint nothing
        for _ in range(10):
            before = inside(page, "axial")
            touch("touchStart", one)
            touch("touchStart", one, two)
            touch("touchMove", one, off(two, 60.0, 0))
            touch("touchEnd")
            page.drawn()
            page.tab.wait_for_timeout(200)
            page.saved()
            if page.text("#undo .count") == "1":
                break
            # on a machine that is slow just now the second finger came so late that the first one painted
            page.tab.keyboard.press("z")
            page.saved(1)
            page.tab.keyboard.press("f")
        assert (inside(page, "axial") != before).any()
        page.saved(1)
        page.tab.keyboard.press("f")
        # a pen paints
        for kind, xy in (("mousePressed", one), ("mouseMoved", two), ("mouseReleased", two)):
            event = {"type": kind, "x": float(xy[0]), "y": float(xy[1]), "pointerType": "pen", "clickCount": 1}
            tool.send("Input.dispatchMouseEvent", event | {"button": "left", "buttons": 1})
        page.saved(2)
        assert not load_recipe(path).strokes[-1].erase
        # and its other end erases: told apart by the button, which no driver of browsers can press
        surface = page.tab.locator("#axial .surface")
        for kind, xy, buttons in (("pointerdown", one, 32), ("pointermove", two, 32), ("pointerup", two, 0)):
            event = {"pointerId": 1, "pointerType": "pen", "button": 5, "buttons": buttons, "bubbles": True}
            surface.dispatch_event(kind, event | {"clientX": float(xy[0]), "clientY": float(xy[1])})
        page.saved(3)
        assert load_recipe(path).strokes[-1].erase


def test_volumes_the_checklist_and_the_next_place(chromium, painted):
    server, path, affine = painted
    middle, corner = mm_of(MIDDLE, affine)[0], mm_of([4, 24, 17], affine)[0]
    with browsing(chromium, server) as page:
        row = page.tab.locator("#structures .structure").filter(has_text="aorta")
        assert "not marked" in row.inner_text()
        assert "Background" in page.text("#checklist .open:first-child")
        assert "A hole in a septum?" in page.text("#checklist li:last-child")
        look_at(page, middle, affine)
        # without background the whole scan is one structure: that is said, and its volume means nothing
        for count, (name, mm) in enumerate((("aorta", middle), ("background", corner)), 1):
            page.tab.locator("#structures .pick").filter(has_text=name).click()
            stroke(page, "axial", [mm, off(mm, 2.0, 0, 0)], affine)
            page.saved(count)
            if name == "aorta":
                page.tab.locator("#checklist .open").get_by_text("all of the scan counts as aorta").wait_for()
                assert "ml" not in row.inner_text()
        session = open_session(path, out=path.parent / "out").session
        ml = (session.labels == session.table["aorta"].value).sum() * session.geometry.voxel_volume_mm3 / 1000.0
        until(lambda: f"{ml:.2f} ml" in row.inner_text() or f"{ml:.1f} ml" in row.inner_text())
        assert "Background" in page.text("#checklist .done:first-child")
        page.tab.keyboard.press("n")
        page.tab.locator("#place strong, #place:text-matches('unsure')").first.wait_for(timeout=60_000)
        found = session.suggest(count=12).places
        if found:
            page.tab.locator("#place").get_by_text(f"Place 1 of {len(found)}").wait_for()
            page.tab.mouse.move(5, 5)
            position = page.text("#under")
            mm = found[0].position_mm
            for value, sides in zip(mm, ("LR", "PA", "HF"), strict=True):
                assert f"{sides[0] if value >= 0 else sides[1]} {abs(value):.1f}" in position
            # it is wrong: what it is instead is in hand, there
            wrong = page.tab.locator("#place-wrong")
            rival = next(one for one in session.table if one.value == found[0].rival).name
            assert rival in wrong.inner_text().lower()
            wrong.click()
            assert rival in page.tab.locator("#structures .structure.picked").inner_text().lower()
            assert page.tab.locator("button[data-tool=brush]").get_attribute("aria-pressed") == "true"
            # it is right: on to the next, and this one does not come again
            page.tab.keyboard.press("r")
            until(lambda: next(path.parent.rglob("*.right.json"), None) is not None)
            page.tab.locator("#place strong, #place:text-matches('unsure')").first.wait_for(timeout=60_000)
            if len(found) > 1:
                # one after the other, of those that were found together
                page.tab.locator("#place").get_by_text(f"Place 1 of {len(found) - 1}").wait_for()
                assert page.tab.locator("#place .enough").count() == 0
                # those that are left, and the first of them once more
                for number in range(1, len(found)):
                    page.tab.keyboard.press("n")
                    again = number == len(found) - 1
                    page.tab.locator("#place").get_by_text(f"Place {1 if again else number + 1} of").wait_for()
                    assert page.tab.locator("#place .enough").count() == again
                assert "You have looked at all of these" in page.text("#place .enough")


def test_two_pages_follow_one_another(chromium, painted):
    server, _, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server) as one, browsing(chromium, server) as other:
        for page in (one, other):
            page.plain()
            look_at(page, middle, affine)
        before = inside(other, "coronal")
        stroke(one, "axial", [middle, off(middle, 2.0, 0, 0)], affine)
        for page in (one, other):
            page.saved(1)
            page.tab.mouse.move(5, 5)
            page.drawn()
        assert (inside(other, "coronal") != before).any()
        np.testing.assert_array_equal(inside(one, "coronal"), inside(other, "coronal"))


def test_what_is_refused_is_said(chromium, painted):
    server, path, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server) as page:
        look_at(page, middle, affine)
        path.write_text(path.read_text() + "# by hand\n")
        stroke(page, "axial", [middle, off(middle, 2.0, 0, 0)], affine)
        page.tab.locator("#notice").wait_for()
        assert "another program changed the recipe" in page.text("#notice")
        page.ready()
        page.tab.locator("#notice-close").click()
        assert not page.tab.locator("#notice").is_visible()
        stroke(page, "axial", [middle, off(middle, 2.0, 0, 0)], affine)
        page.saved(1)
        assert path.read_text().count("# by hand") == 1
        # also while a stroke is drawn, which is lost then
        page.tab.mouse.move(*at(page, "axial", middle, affine))
        page.tab.mouse.down()
        page.tab.locator("#saved[data-state=saving]").wait_for()
        path.write_text(path.read_text() + "# again\n")
        page.tab.mouse.up()
        page.tab.locator("#notice").wait_for()
        # refused if the server had not begun it, lost if it had (tests/studio/test_painting.py)
        assert "another program changed the recipe: it was opened again" in page.text("#notice")
        page.ready()
        page.saved()
        stroke(page, "axial", [middle, off(middle, 2.0, 0, 0)], affine)
        page.saved(1)
        assert path.read_text().count("# again") == 1


def test_a_recipe_that_cannot_be_opened_says_why(chromium, painted):
    server, path, _ = painted
    path.write_text(path.read_text().replace("scan.nii.gz", "another.nii.gz"))
    context = chromium.new_context()
    tab = context.new_page()
    tab.goto(server.address)
    words = tab.locator("#curtain-words strong")
    words.wait_for(timeout=60_000)
    assert "cannot be opened" in words.inner_text()
    assert tab.locator("#curtain-words li").count() >= 1
    assert not tab.locator("#lost").is_visible()
    context.close()


def test_a_page_that_has_ended_stays_as_it_is_and_others_go_on(chromium, painted):
    server, path, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    workplace = server.opened.places["socket"]
    with browsing(chromium, server) as one, browsing(chromium, server) as other:
        look_at(one, middle, affine)
        whole = path.read_text()
        path.write_text(whole.replace("scan.nii.gz", "another.nii.gz"))
        stroke(one, "axial", [middle, off(middle, 2.0, 0, 0)], affine)
        for page in (one, other):
            page.tab.locator("#curtain-words strong").wait_for(timeout=60_000)
            assert "another program changed the recipe" in page.text("#curtain-words")
            assert not page.tab.locator("#notice").is_visible()
        why = other.text("#curtain-words")
        # the server has dropped both: nothing that comes later reaches them
        until(lambda: not workplace._pages)
        path.write_text(whole)
        one.tab.reload()
        one.ready()
        look_at(one, middle, affine)
        stroke(one, "axial", [middle, off(middle, 2.0, 0, 0)], affine)
        one.saved(1)
        other.drawn()
        assert other.text("#curtain-words") == why
        assert other.tab.locator("#curtain-bar").is_hidden()
        assert other.tab.locator("body").get_attribute("data-ready") == "false"
        assert other.text("#saved") == "Not connected"
        # whoever has it loaded again goes on as well
        other.tab.reload()
        other.ready()
        other.saved(1)


def test_a_server_that_is_gone_and_comes_back(chromium, painted):
    server, path, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server, may_fault=True) as page:
        look_at(page, middle, affine)
        stroke(page, "axial", [middle, off(middle, 2.0, 0, 0)], affine)
        page.saved(1)
        server.stop()
        page.tab.locator("#lost").wait_for(timeout=30_000)
        assert "lost" in page.text("#lost")
        assert page.tab.locator("button[data-tool=brush]").is_disabled()
        stroke(page, "axial", [middle, off(middle, 4.0, 0, 0)], affine)
        server.start()
        page.saved(1)
        assert not page.tab.locator("#lost").is_visible()
        assert len(load_recipe(path).strokes) == 1
        stroke(page, "axial", [middle, off(middle, 4.0, 0, 0)], affine)
        page.saved(2)
        # started anew it has another key, which the page cannot know
        server.stop()
        server.start(token="another")
        page.tab.locator("#lost").get_by_text("started again").wait_for(timeout=60_000)
        # and nothing on it looks as if it could be used
        assert page.tab.locator("main").evaluate("(one) => one.inert && getComputedStyle(one).opacity < 0.5")
        assert len(load_recipe(path).strokes) == 2
