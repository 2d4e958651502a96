"""The tab Shape in a browser: what is placed by mouse and keys, and what the recipe says then."""

import numpy as np
from click.testing import CliRunner

from heartcase.cli.main import cli
from heartcase.pipeline.building.session_file import open_session
from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe
from tests.studio.axe.accessible import assert_accessible
from tests.studio.page.browsing import browsing, mm_of, until
from tests.studio.page.test_page import MIDDLE, look_at, off, stroke

END = """
[[ends]]
label = "aorta"
position_mm = [{position}]
axis = [{axis}]
radius_mm = {radius}
"""


def listed(numbers):
    return ", ".join(repr(float(one)) for one in numbers)


def read(path):
    return parse_recipe(path.read_text(), needs_markers=False)


def part(page, name):
    """A section of the tab, opened."""
    section = page.tab.locator(f"[data-section={name}]")
    if section.get_attribute("open") is None:
        section.locator("summary").click()
    return section


def type_into(field, text):
    field.fill(text)
    field.press("Enter")
    field.page.keyboard.press("Tab")


def test_an_end_a_defect_and_a_wall_by_mouse_stand_in_the_recipe_and_are_taken_back_with_strokes(chromium, painted):
    server, path, affine = painted
    corner, middle = mm_of([4, 24, 17], affine)[0], mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server, viewport={"width": 1366, "height": 768}) as page:
        look_at(page, middle, affine)
        page.tab.keyboard.press("0")
        stroke(page, "axial", [corner, off(corner, 6.0, 0, 0)], affine)
        page.tab.keyboard.press("5")
        stroke(page, "axial", [off(middle, -1.0, 0, 0), off(middle, 1.0, 0, 0)], affine)
        page.saved(2)
        painted_text = path.read_text()
        head = painted_text.split("\n# Painted in a session.")[0]

        # a vessel end: from the middle across to the wall, seen as a line in this slice
        page.tab.locator("#tab-shape").click()
        page.tab.locator("[data-place=ends]").click()
        stroke(page, "axial", [middle, off(middle, 0.0, 5.0, 0)], affine)
        page.saved(3)
        end = load_recipe(path).ends[0]
        assert end.label == "aorta"
        np.testing.assert_allclose(end.position_mm, middle, atol=0.25)
        assert abs(end.radius_mm - 5.0) < 0.3
        # what is painted reaches beyond the disc on its axis, and that is said
        assert f"the disc (⌀ {2.0 * end.radius_mm:.1f}) is too narrow" in page.text("[data-end='1']")
        np.testing.assert_allclose(np.abs(end.axis), [1.0, 0.0, 0.0], atol=0.06)
        written = END.format(position=listed(end.position_mm), axis=listed(end.axis), radius=end.radius_mm)
        assert path.read_text() == painted_text.replace(head, head + written)

        # its rim is drawn farther and turned: by 30 degrees in the slice
        far = off(middle, -4.0, 4.0 * np.sqrt(3.0), 0)
        stroke(page, "axial", [off(middle, 0.0, end.radius_mm, 0), far], affine)
        page.saved(4)
        turned = load_recipe(path).ends[0]
        assert abs(turned.radius_mm - 8.0) < 0.4
        cosine = np.dot(turned.axis, end.axis) / np.linalg.norm(turned.axis) / np.linalg.norm(end.axis)
        assert abs(np.degrees(np.arccos(cosine)) - 30.0) < 4.0
        # and its middle is moved, in another slice
        stroke(page, "coronal", [turned.position_mm, off(turned.position_mm, 2.0, 0, 3.0)], affine)
        page.saved(5)
        assert page.tab.locator("#undo").get_attribute("title") == "Undo (Z), a vessel end"
        moved = load_recipe(path).ends[0]
        np.testing.assert_allclose(moved.position_mm, off(turned.position_mm, 2.0, 0, 3.0), atol=0.4)
        assert moved.radius_mm == turned.radius_mm

        # a septal defect, drawn from its middle to its rim
        page.tab.locator("[data-place=septal_defect]").click()
        start = off(middle, -8.0, -6.0, 0)
        stroke(page, "axial", [start, off(start, 3.0, 0, 0)], affine)
        page.saved(6)
        defect = load_recipe(path).edits[0]
        assert defect.kind == "septal_defect"
        assert abs(defect.diameter_mm - 6.0) < 0.4
        form = page.tab.locator(".line.picked .form")
        type_into(form.get_by_label("Name"), "residual VSD")
        page.saved(7)
        assert load_recipe(path).edits[0].name == "residual VSD"

        # a wall, typed
        wall = part(page, "shape_walls").locator("[data-wall=aorta] input")
        assert wall.input_value() == "2"
        type_into(wall, "1.4")
        page.saved(8)
        assert load_recipe(path).table["aorta"].wall_thickness_mm == 1.4
        text = path.read_text()
        assert '\n[[edits]]\nkind = "septal_defect"\nposition_mm = [' in text
        assert ']\nname = "residual VSD"\n' in text
        assert "wall_thickness_mm = 1.4\n" in text
        assert text.endswith(painted_text[len(head) :])
        # what cannot be is refused, said, and changes nothing
        type_into(wall, "70")
        page.tab.locator("#notice").get_by_text("wall_thickness_mm").wait_for()
        assert wall.input_value() == "1.4"
        assert path.read_text() == text
        said = CliRunner().invoke(cli, ["validate", str(path)])
        assert said.exit_code == 0, said.output

        # the surface, with what is placed
        before = page.pixels("solid")
        page.tab.locator("#preview-on").check()
        until(lambda: (page.pixels("solid") != before).any(axis=2).sum() > 200)
        page.tab.locator("#preview-state").get_by_text("edits[1]").wait_for(timeout=60_000)
        page.tab.locator("#preview-on").uncheck()

        # a landmark by a click in the 3-D picture, on the red of the aorta
        page.drawn()
        red, green, blue = np.moveaxis(page.pixels("solid").astype(float), -1, 0)
        rows, columns = np.nonzero((red > 80.0) & (green < 0.6 * red) & (blue < 0.8 * red))
        n = len(rows) // 2
        part(page, "shape_landmarks").locator("[data-place=point]").click()
        x, y, *_ = page.box("solid")
        page.tab.mouse.click(float(x + columns[n]), float(y + rows[n]))
        page.saved(9)
        point = load_recipe(path).landmarks[0].points_mm[0]
        i, j, k = np.rint(np.linalg.inv(affine) @ [*point, 1.0])[:3].astype(int)
        session = open_session(path, out=path.parent / "out").session
        assert session.labels[k, j, i] == session.table["aorta"].value

        # one history: a stroke on top, then all back, and forth again
        page.tab.locator("#tab-structures").click()
        stroke(page, "axial", [off(middle, 0, 1.0, 0)], affine)
        page.saved(10)
        whole = path.read_bytes()
        for count in range(9, -1, -1):
            page.tab.keyboard.press("Control+z")
            page.saved(count)
        assert path.read_text().count("[[") == 0
        for count in range(1, 11):
            page.tab.keyboard.press("Control+y")
            page.saved(count)
        assert path.read_bytes() == whole
        # the case gets another name by a click on it
        page.tab.locator("#case-name").click()
        page.tab.locator("#case-rename").fill("a child 2")
        page.tab.keyboard.press("Enter")
        page.saved(11)
        assert (read(path).name, page.text("#case-name")) == ("a child 2", "a child 2")


def test_by_keys_alone_and_what_another_page_sees(chromium, painted):
    server, path, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    with browsing(chromium, server) as page, browsing(chromium, server) as other:
        look_at(page, middle, affine)
        page.tab.keyboard.press("s")
        assert page.tab.locator("#tab-shape").get_attribute("aria-selected") == "true"
        other.tab.keyboard.press("s")
        part(page, "shape_landmarks").locator("[data-place=point]").focus()
        page.tab.keyboard.press("Enter")
        page.tab.locator("#axial .surface").focus()
        page.tab.keyboard.press("Enter")
        page.saved(1)
        point = read(path).landmarks[0]
        assert (point.kind, point.name) == ("point", "point 1")
        np.testing.assert_allclose(point.points_mm[0], middle, atol=0.3)
        part(other, "shape_landmarks").locator("[data-line='landmarks 1']").wait_for()
        # named by keys, moved to the crosshair, removed
        form = page.tab.locator(".line.picked .form")
        type_into(form.get_by_label("Name"), "apex")
        page.saved(2)
        page.tab.locator("#axial .surface").focus()
        for _ in range(3):
            page.tab.keyboard.press("Shift+ArrowRight")
        page.tab.locator(".line.picked .form").get_by_text("Move to the crosshair").press("Enter")
        page.saved(3)
        moved = read(path).landmarks[0]
        assert moved.name == "apex"
        np.testing.assert_allclose(moved.points_mm[0], off(middle, 3.0, 0, 0), atol=0.3)
        page.tab.locator("#axial .surface").focus()
        page.tab.keyboard.press("Delete")
        page.saved(4)
        assert read(path).landmarks == ()
        # sculpting, a material and a setting
        part(page, "shape_edits").locator("[data-place=add]").click()
        page.tab.keyboard.press("5")
        page.tab.locator("#axial .surface").focus()
        page.tab.keyboard.press("Enter")
        page.saved(5)
        edit = read(path).edits[0]
        assert (edit.kind, edit.label, edit.radius_mm) == ("add", "aorta", 3.0)
        part(page, "shape_materials").locator(".add-material").select_option("aorta wall")
        page.saved(6)
        assert read(path).materials.labels["aorta wall"].youngs_modulus_kpa == 30.0
        # with every section open and a form in it, in both themes
        for name in ("shape_ends", "shape_edits", "shape_landmarks", "shape_pins", "shape_walls"):
            part(page, name)
        assert page.tab.locator("[data-line='edits 1'] .form").is_visible()
        for _ in range(2):
            assert_accessible(page)
            page.tab.locator("#theme").click()
        nodes = part(page, "shape_model").locator("[data-setting='grid.node_count'] input")
        type_into(nodes, "12000")
        page.saved(7)
        assert read(path).grid.node_count == 12000


def test_a_double_click_on_the_bin_and_a_key_held_down_remove_one_line(chromium, painted):
    server, path, affine = painted
    middle = mm_of(MIDDLE, affine)[0]
    point = '\n[[landmarks]]\nname = "{name}"\nkind = "point"\npoints_mm = [[{position}]]\n'
    path.write_text(path.read_text() + "".join(point.format(name=f"p{n}", position=listed(middle)) for n in range(6)))
    with browsing(chromium, server) as page:

        def names():
            return [one.name for one in read(path).landmarks]

        page.tab.locator("#tab-shape").click()
        lines = part(page, "shape_landmarks").locator(".lines .line")
        # nothing is known of the recipe's own lines: what is removed here counts from 1
        lines.nth(1).locator(".remove").dblclick()
        page.saved(1)
        lines.nth(1).locator(".go").click()
        page.tab.locator("#axial .surface").focus()
        for _ in range(4):
            page.tab.keyboard.down("Delete")
        page.tab.keyboard.up("Delete")
        page.saved(2)
        lines.nth(0).locator(".remove").click()
        page.saved(3)
        assert names() == ["p3", "p4", "p5"]
        assert not page.tab.locator("#notice").is_visible()
