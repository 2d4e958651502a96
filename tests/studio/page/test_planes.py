"""Planes of the slices on the studio's page: the heart's own, and turned by hand; in a real browser."""

import numpy as np
import pytest

from heartcase.pipeline.building.session_file import open_session
from heartcase.pipeline.report.heart_planes import heart_planes
from heartcase.pipeline.report.views import places_of
from heartcase.schemas.recipe.recipe import load_recipe
from tests.studio.axe.accessible import assert_accessible
from tests.studio.page.browsing import FRAMES, SIZE, browsing, mm_of, pixel_of, until
from tests.studio.page.test_page import at, inside

PLACES = {
    "apex": (28, 8, 12),
    "mitral valve": (15, 17, 14),
    "tricuspid valve": (14, 9, 12),
    "aortic valve": (18, 12, 20),
}
"""Voxels of the valves of a heart in the small scan."""
MIDDLE = np.array([21.5, 12.5, 13.0])
"""Half way between apex and mitral valve."""


def with_landmarks(path, affine):
    lines = [
        f'[[landmarks]]\nname = "{name}"\nkind = "point"\npoints_mm = [{mm_of(voxel, affine)[0].round(3).tolist()}]\n'
        for name, voxel in PLACES.items()
    ]
    path.write_text(path.read_text() + "\n" + "\n".join(lines))


def titles(page):
    return [page.text(f"#{view} h2") for view in FRAMES]


def mm_under(page):
    under = page.text("#under").split()
    sides, values = under[0:6:2], [float(one) for one in under[1:6:2]]
    return np.array([value if side in "LPH" else -value for side, value in zip(sides, values, strict=True)])


def assert_lies_as(page, view, frame, affine):
    """Three places of the picture are where a plane with this frame through the crosshair has them."""
    through = mm_of(MIDDLE, affine)[0]
    right, down = np.asarray(frame[0]), np.asarray(frame[1])
    x, y, *_ = page.box(view)
    for across, along in ((0.0, 0.0), (5.0, -3.0), (-4.0, 6.0)):
        mm = through + across * right + along * down
        page.tab.mouse.move(*(np.array([x, y]) + pixel_of(mm, page, view, affine, (right, down))[0]))
        np.testing.assert_allclose(mm_under(page), mm, atol=0.2, err_msg=view)


def test_the_hearts_own_planes_are_shown_where_they_are(chromium, painted):
    server, path, affine = painted
    with browsing(chromium, server, viewport={"width": 1366, "height": 768}) as page:
        # too few labels: nothing changes, and it is said what is needed
        page.tab.locator("#planes-open").click()
        assert not page.tab.locator("[data-planes=scan]").is_visible()
        page.tab.locator("[data-planes=heart]").click()
        page.tab.locator("#planes-said p").first.wait_for()
        assert "do not tell the heart's planes" in page.text("#planes-said")
        assert "Short axis: mark background, morphologically left ventricle, morphologically left atrium" in page.text(
            "#planes-said"
        )
        assert titles(page) == ["Axial", "Coronal", "Sagittal"]
        assert page.tab.locator("[data-planes=patient]").get_attribute("aria-pressed") == "true"
        for theme in ("light", "dark"):
            page.tab.locator("html").evaluate("(one, theme) => { one.dataset.theme = theme; }", theme)
            assert_accessible(page, f"planes, {theme}")
        # the tabs beside it stay free
        box, panel = (page.tab.locator(one).bounding_box() for one in ("#planes", ".panel"))
        assert box["x"] + box["width"] <= panel["x"]
    with_landmarks(path, affine)
    server.stop()
    server.start()
    opened = open_session(path, out=path.parent / "out")
    wanted = heart_planes(
        opened.session.labels,
        opened.session.geometry,
        opened.session.table,
        places=places_of(opened.recipe.landmarks),
    )
    with browsing(chromium, server, viewport={"width": 1366, "height": 768}) as page:
        page.tab.locator("#planes-open").click()
        page.tab.locator("[data-planes=heart]").click()
        page.tab.locator("[data-planes=heart][aria-pressed=true]").wait_for(state="attached")
        # what was chosen is seen, and nothing lies over it
        page.tab.locator("#planes").wait_for(state="hidden")
        page.tab.locator("#planes-open").click()
        page.tab.locator("#axial .surface").hover()
        page.tab.keyboard.press("Escape")
        page.tab.locator("#planes").wait_for(state="hidden")
        assert titles(page) == ["Four chambers", "Short axis", "Two chambers"]
        names = {"axial": "four_chamber", "coronal": "short_axis", "sagittal": "two_chamber"}
        page.drawn()
        page.tab.keyboard.press("Escape")
        for view, name in names.items():
            plane = wanted.planes[name]
            assert_lies_as(page, view, (plane.right, plane.down), affine)
        # what is painted lies in the plane that is seen
        page.tab.keyboard.press("b")
        plane = wanted.planes["two_chamber"]
        x, y, *_ = page.box("sagittal")
        through = mm_of(MIDDLE, affine)[0]
        drawn = [through, through + 4.0 * plane.right, through + 4.0 * plane.right + 3.0 * plane.down]
        for n, mm in enumerate(drawn):
            xy = np.array([x, y]) + pixel_of(mm, page, "sagittal", affine, (plane.right, plane.down))[0]
            page.tab.mouse.move(*xy, steps=5)
            if n == 0:
                page.tab.mouse.down()
        page.tab.mouse.up()
        page.saved(1)
        points = np.array(load_recipe(path).strokes[-1].points_mm)
        np.testing.assert_allclose((points - through) @ plane.normal, 0.0, atol=2e-3)
        assert np.ptp(points @ plane.right) == pytest.approx(4.0, abs=0.3)
        page.tab.locator("#planes-open").click()
        page.tab.locator("[data-planes=heart3]").click()
        page.tab.locator("#sagittal h2").get_by_text("Three chambers").wait_for()
        page.tab.keyboard.press("Escape")
        page.tab.locator("#tab-help").click()
        page.tab.locator("#language").select_option("de")
        assert titles(page) == ["Vierkammerblick", "Kurze Achse", "Dreikammerblick"]
        assert page.tab.locator("#axial .surface").get_attribute("aria-label") == "Bild: Vierkammerblick"


def test_planes_are_turned_by_a_handle_and_by_keys(chromium, painted):
    server, path, affine = painted
    with browsing(chromium, server) as page:
        centre = mm_of((SIZE - 1) / 2, affine)[0]
        page.tab.keyboard.press("v")
        for view in ("axial", "sagittal"):
            page.tab.mouse.click(*at(page, view, centre, affine))
        page.drawn()
        before = {view: inside(page, view) for view in FRAMES}
        middle = at(page, "axial", centre, affine)
        *_, width, height = page.box("axial")
        far = 0.36 * min(width, height)
        page.tab.mouse.move(middle[0] + far, middle[1])
        assert page.tab.locator("#axial .surface").evaluate("(one) => one.style.cursor") == "grab"
        page.tab.mouse.down()
        angle = np.radians(30.0)
        page.tab.mouse.move(middle[0] + far * np.cos(angle), middle[1] + far * np.sin(angle), steps=6)
        page.tab.mouse.up()
        page.tab.mouse.move(5, 5)
        page.drawn()
        assert titles(page) == ["Axial", "Coronal, turned", "Sagittal, turned"]
        assert page.text("#sides-axial") == "Left R, right L, above A, below P."
        # from right to below is from left to back
        assert page.text("#sides-coronal") == "Left R·A, right L·P, above H, below F."
        assert page.text("#sides-sagittal") == "Left A·L, right P·R, above H, below F."
        for view in ("coronal", "sagittal"):
            assert (inside(page, view) != before[view]).any()
        # painted in a turned plane, a stroke runs as the plane does
        page.tab.keyboard.press("b")
        x, y, width, height = page.box("coronal")
        page.tab.mouse.move(x + width / 2, y + height / 2)
        page.tab.mouse.down()
        page.tab.mouse.move(x + width / 2 + 40, y + height / 2, steps=4)
        page.tab.mouse.up()
        page.saved(1)
        points = np.array(load_recipe(path).strokes[-1].points_mm)
        way = points[-1] - points[0]
        np.testing.assert_allclose(way / np.linalg.norm(way), [np.cos(angle), np.sin(angle), 0.0], atol=0.02)
        # without the mouse: six steps of five degrees back
        page.tab.locator("#axial .surface").focus()
        for _ in range(6):
            page.tab.keyboard.press("j")
        until(lambda: page.text("#sides-coronal") == "Left R, right L, above H, below F.")
        page.tab.locator("#planes-open").click()
        page.tab.locator("#turn-right").click()
        assert "Axial" in page.text("#turn-about")
        page.tab.locator("[data-planes=patient]").click()
        assert titles(page) == ["Axial", "Coronal", "Sagittal"]
