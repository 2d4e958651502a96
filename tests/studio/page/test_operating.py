"""A case that is operated on in a real browser: pulled by mouse, cut, taken back, recorded, replayed; and by keys."""

import base64
import json
from pathlib import Path

import numpy as np
import pytest

from heartcase import approve_case
from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.recording.commands import Cut
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.live.live import Live
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.perform_tools import as_poses
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.deform import deform
from heartcase.studio.operating.scene.packing import Rounded, frame_message, topology_message
from tests.factories import block_case
from tests.simulator.live.scenes import write_case
from tests.studio.axe.accessible import assert_accessible
from tests.studio.operating.boxes import write_block_with_a_box
from tests.studio.operating.charts import write_charted
from tests.studio.page.browsing import Server, browsing, until

READ_BACK = (Path(__file__).parent / "read_back.js").read_text(encoding="utf-8")
TOLERANCE_MM, TOLERANCE_NORMAL = 0.005, 0.005
"""Of places and normals on the graphics card, where displacements are sent in steps of 0.003 mm."""
OPEN = "(await import('/static/operating/main.js')).open"
TOP = (22.0, -14.0, 40.5)


class CaseServer(Server):
    def open_in(self, registry):
        return registry.open_case(self.recipe, out=self.recipe.parent)

    @property
    def live(self):
        return self.opened.places["operating"]._stage.live


@pytest.fixture
def operated(tmp_path):
    server = CaseServer(write_case(tmp_path))
    server.start()
    yield server
    server.stop()


class Hands:
    """Mouse and keys on the heart."""

    def __init__(self, page):
        self.tab = page.tab

    def header(self):
        return self.tab.evaluate(f"async () => {OPEN}.header")

    def pixel(self, place_mm):
        x, y = self.tab.evaluate(f"async (place) => {OPEN}.picture.camera.pixel(place)", list(place_mm))
        box = self.tab.locator("#scene").bounding_box()
        return box["x"] + x, box["y"] + y

    def drag(self, *places_mm):
        self.tab.mouse.move(*self.pixel(places_mm[0]))
        self.tab.mouse.down()
        for place in places_mm[1:]:
            self.tab.mouse.move(*self.pixel(place), steps=3)

    def from_above(self):
        self.tab.evaluate(
            f"async () => {{ const {{ picture }} = {OPEN}; picture.camera.towards = [0, 0, 1];"
            "picture.camera.right = [1, 0, 0]; picture.camera.up = [0, 1, 0]; picture.redraw(); }"
        )

    def until(self, check, seconds=60.0):
        until(lambda: check(self.header()), seconds)
        return self.header()

    def read_back(self, **messages):
        """Surface vertex, place and normal of each vertex that is drawn, and the step of which it is."""
        found = self.tab.evaluate(READ_BACK, {"topology": None, "frame": None} | messages)
        self.vertex, self.uv = np.array(found["vertex"]), np.reshape(found["uv"], (-1, 2)).astype(np.float32)
        self.tangents = np.reshape(found["tangents"], (-1, 3))
        return self.vertex, *(np.reshape(found[one], (-1, 3)) for one in ("places", "normals"))

    def shows(self, live):
        """How far the surface that is drawn is from the server's at most, mm; the session stands."""
        frame = self.until(lambda header: header["mode"] == "paused" and header["step"] == live.newest.frame.step)
        vertex, places, normals = self.read_back()
        newest = live.newest
        surface = deform(newest.frame.model, newest.surface, newest.frame.state.displacement)
        assert frame["step"] == live.newest.frame.step
        assert set(vertex) == set(range(len(surface.vertices_mm)))
        assert np.abs(normals - surface.normals[vertex]).max() < TOLERANCE_NORMAL
        return np.abs(places - surface.vertices_mm[vertex]).max()


def picture(page):
    return page.tab.locator("#scene").screenshot(animations="disabled")


def test_a_story_by_mouse(chromium, operated):
    with browsing(chromium, operated, viewport={"width": 1366, "height": 768}) as page:
        hands, tab = Hands(page), page.tab
        assert tab.title() == "heartcase studio"
        assert page.text("#case-name") == "block"
        hands.from_above()
        at_rest = hands.read_back()[1]
        before = picture(page)
        tab.locator("#record").click()
        hands.until(lambda header: header["recording"] == "block-1.recording")
        until(lambda: page.text("#record") == "Stop recording")
        tab.locator("#tab-forces").click()
        # pulled to the side by 5 mm: the tissue follows the pointer
        tab.keyboard.press("g")
        hands.drag(TOP, (27.0, -14.0, 40.5))
        hands.until(lambda header: header["instruments"] and header["instruments"][0]["center_mm"][0] > 26.5)
        tab.locator("#scene").focus()
        tab.keyboard.press(" ")
        assert hands.shows(operated.live) < TOLERANCE_MM
        moved = hands.read_back()[1] - at_rest
        top = np.linalg.norm(at_rest - np.array([22.0, -14.0, 40.5]), axis=1) < 4.0
        assert moved[top, 0].min() > 4.0
        assert picture(page) != before
        until(lambda: "hand 1" in page.text("#forces") and " N" in page.text("#forces"))
        tab.mouse.up()
        hands.until(lambda header: not header["instruments"] and header["mode"] == "running")
        # cut across
        tab.keyboard.press("c")
        hands.drag((22.3, -20.0, 40.5), (22.3, -17.0, 40.5), (22.3, -13.0, 40.5), (22.3, -9.0, 40.5))
        tab.mouse.up()
        hands.until(lambda header: header["topology"] > 1 and header["act_count"] == 3)
        tab.keyboard.press(" ")
        assert hands.shows(operated.live) < TOLERANCE_MM
        faces = tab.evaluate(f"async () => {OPEN}.picture.heart.arrays.structure.includes(256)")
        assert faces
        count = len(hands.read_back()[0])
        # taken back, and done again
        tab.locator("#undo").click()
        hands.until(lambda header: header["act_count"] == 2)
        assert hands.shows(operated.live) < TOLERANCE_MM
        assert len(hands.read_back()[0]) < count
        tab.locator("#redo").click()
        hands.until(lambda header: header["act_count"] == 3)
        assert hands.shows(operated.live) < TOLERANCE_MM
        end = operated.live.newest.frame.step
        tab.locator("#record").click()
        hands.until(lambda header: header["recording"] is None)
        until(lambda: page.text("#record") == "Record")
        # replayed, looked at anywhere, and taken over
        tab.locator("#tab-recordings").click()
        tab.locator("#speed").select_option("0.25")
        tab.locator("#recordings button").first.click()
        hands.until(lambda header: header["mode"] == "playing" and header["step"] < end)
        assert operated.live.played_speed == 0.25
        # pauses are passed over, unless one wants to see them: at once, too
        assert operated.live._skips
        tab.locator("#skip-pauses").uncheck()
        until(lambda: not operated.live._skips)
        # quicker at once
        tab.locator("#speed").select_option("4")
        until(lambda: operated.live.played_speed == 4.0)
        hands.until(lambda header: header["mode"] == "paused" and header["step"] == end)
        assert hands.shows(operated.live) < TOLERANCE_MM
        assert operated.live.session.deviations == []
        # the cut stands on the time line: a click goes there
        ((step, kind),) = operated.live.newest.marks
        assert kind == "cut"
        tab.locator("#time-marks .cut").click()
        hands.until(lambda header: header["step"] == step)
        slider = tab.locator("#time")
        slider.evaluate("(one) => { one.value = one.max / 2; one.dispatchEvent(new Event('input')); }")
        hands.until(lambda header: abs(header["step"] - end / 2) <= 1)
        assert hands.shows(operated.live) < TOLERANCE_MM
        tab.keyboard.press("g")
        # away from the cut, which may lie open there
        hands.drag((14.0, -14.0, 40.5), (14.0, -14.0, 40.5))
        tab.mouse.up()
        hands.until(lambda header: header["mode"] == "running")

        def nothing_is_held():
            # The hand of the recording may hold where it was left. The button lets go of what holds since last: the
            # mouse's until that has let go by itself, so once more.
            tab.locator("#let-go").evaluate("(button) => button.click()")
            return not hands.header()["instruments"]

        until(nothing_is_held)
        header = hands.header()
        assert header["end_s"] == header["time_s"]
        stored = open_recording(operated.recipe.parent / "block-1.recording")
        assert {one.command.kind for one in stored.entries} >= {"close_grab", "open_grab", "cut"}
        kept = json.dumps(tab.evaluate("() => ({...localStorage})"))
        assert '"heartcase studio: skip_pauses": "off"' in kept
        assert "block" not in kept


def test_hands_that_hold_open_and_a_patch_say_so(chromium, operated):
    with browsing(chromium, operated, viewport={"width": 1366, "height": 768}) as page:
        hands, tab = Hands(page), page.tab
        hands.from_above()
        tab.keyboard.press("c")
        hands.drag((18.3, -20.0, 40.5), (18.3, -17.0, 40.5), (18.3, -13.0, 40.5), (18.3, -9.0, 40.5))
        tab.mouse.up()
        hands.until(lambda header: header["cut_count"] == 1)
        tab.locator("#hold-last").wait_for()
        told = tab.evaluate(
            "() => new Promise((told) => { const button = document.getElementById('hold-last');"
            "new MutationObserver(() => told(button.textContent)).observe(button, {childList: true});"
            "button.click(); })"
        )
        assert told == "Opening …"
        hands.until(lambda header: len(header["instruments"]) >= 2)
        until(lambda: page.text("#hold-last") == "Hold open" or tab.locator("#hold-last").is_hidden())
        tab.locator("#let-go-all").click()
        hands.until(lambda header: not header["instruments"])
        # a patch on tissue that is whole
        tab.keyboard.press("e")
        around = 2 * np.pi * np.arange(25) / 24
        ring = np.stack([24.0 + 4.0 * np.cos(around), -14.0 + 4.0 * np.sin(around), np.full(25, 40.5)], axis=1)
        hands.drag(*ring)
        tab.mouse.up()
        (patch,) = hands.until(lambda header: header["patches"])["patches"]
        assert patch["stitch_count"] > 8
        assert 0.5 * np.pi * 16 < patch["area_mm2"] < 1.5 * np.pi * 16
        until(lambda: "The patch is sewn on" in page.text("#notice-words"))
        said = f"{patch['stitch_count']} stitches, {patch['area_mm2']:.0f} mm²"
        assert said in page.text("#notice-words")
        # a stitch beside it, tied: told with its pull
        tab.keyboard.press("s")
        for place in ((14.0, -14.0, 40.5), (17.0, -14.0, 40.5)):
            tab.mouse.click(*hands.pixel(place))
        hands.until(lambda header: len(header["stitches"]) == 1)
        tab.locator("#tie").click()
        (stitch,) = hands.until(lambda header: header["stitches"][0]["tied"])["stitches"]
        until(lambda: "Tied stitches: 1." in page.text("#notice-words"))
        assert stitch["force_n"] > 0.0


def test_by_keys_alone_what_is_hidden_and_a_server_that_is_gone(chromium, operated):
    with browsing(chromium, operated, locale="de-DE", color_scheme="light", may_fault=True) as page:
        hands, tab = Hands(page), page.tab
        assert "Greifen" in page.text("#tools")
        hands.from_above()
        tab.locator("#scene").focus()
        # turned and turned back
        before = tab.evaluate(f"async () => {OPEN}.picture.camera.towards")
        tab.keyboard.press("ArrowLeft")
        assert tab.evaluate(f"async () => {OPEN}.picture.camera.towards") != before
        tab.keyboard.press("ArrowRight")
        tab.keyboard.press("g")
        tab.keyboard.press("Enter")
        hands.until(lambda header: bool(header["instruments"]))
        for _ in range(12):
            tab.keyboard.press("ArrowRight")
        hands.until(lambda header: header["instruments"] and header["instruments"][0]["center_mm"][0] > 21.5)
        tab.keyboard.press("Enter")
        hands.until(lambda header: not header["instruments"])
        # hidden structures are neither drawn nor pointed at: then the pointer turns the heart
        for button in tab.locator("#structures button").all():
            button.click()
        page.drawn()
        tab.locator("#scene").focus()
        hands.drag(TOP, (24.0, -14.0, 40.5))
        tab.mouse.up()
        # the server says first that nothing is there
        until(lambda: tab.evaluate(f"async () => {OPEN}.picture.camera.towards") != [0, 0, 1], 60.0)
        page.drawn()
        assert hands.header()["act_count"] == 2
        tab.locator("#show-all").click()
        # everything that is used has a name and is large enough
        nameless = tab.evaluate(
            """() => [...document.querySelectorAll("button, input, select, a, [role=application], [role=tab]")]
              .filter((one) => one.checkVisibility())
              .filter((one) => !(one.getAttribute("aria-label") || one.textContent.trim() || one.labels?.length)
                || one.getBoundingClientRect().height < 17).map((one) => one.outerHTML)"""
        )
        assert nameless == []
        assert tab.evaluate("() => document.documentElement.scrollWidth") == 1280
        # the server goes: it is said, and comes back by itself
        operated.stop()
        tab.locator("#lost").get_by_text("abgerissen").wait_for()
        assert tab.locator("body").get_attribute("data-ready") == "false"
        operated.start()
        page.ready()
        assert tab.locator("#lost").is_hidden()


def test_after_a_click_keys_are_the_pages_and_by_keys_a_button_keeps_them(chromium, operated):
    with browsing(chromium, operated) as page:
        hands, tab = Hands(page), page.tab

        def focused():
            return tab.evaluate("() => document.activeElement.id")

        def space_changes(mode):
            tab.keyboard.press("Space")
            hands.until(lambda header: header["mode"] == {"running": "paused", "paused": "running"}[mode])

        buttons = ("#tab-forces", "#tools button[data-key=g]", "#record", "#cut-open", "#reset-view")
        for number, button in enumerate(buttons):
            tab.locator(button).click()
            assert focused() == "scene", button
            space_changes("paused" if number % 2 else "running")
        # home is the view from the start
        first = tab.evaluate(f"async () => {OPEN}.picture.camera.towards")
        tab.keyboard.press("ArrowLeft")
        assert tab.evaluate(f"async () => {OPEN}.picture.camera.towards") != first
        tab.locator("#tab-view").click()
        tab.keyboard.press("Home")
        assert tab.evaluate(f"async () => {OPEN}.picture.camera.towards") == first
        # the second view is gone on with where it was used last
        tab.locator("#two-views").click()
        tab.locator("#scene-2").focus()
        tab.locator("#tab-help").click()
        assert focused() == "scene-2"
        # a slider has no use for the space bar
        tab.locator("#time").focus()
        space_changes("paused")
        # by keys a button is pressed, and keeps the focus
        tab.locator("#cut-open").focus()
        pressed = tab.locator("#cut-open").get_attribute("aria-pressed")
        tab.keyboard.press("Space")
        assert tab.locator("#cut-open").get_attribute("aria-pressed") != pressed
        assert focused() == "cut-open"
        tab.locator("#tab-help").focus()
        tab.keyboard.press("ArrowLeft")
        assert focused() == "tab-recordings"


def test_what_was_taken_back_is_not_lost_when_time_goes_on(chromium, operated):
    with browsing(chromium, operated) as page:
        hands, tab = Hands(page), page.tab
        hands.from_above()
        tab.locator("#scene").focus()
        tab.keyboard.press("c")
        hands.drag((22.3, -20.0, 40.5), (22.3, -17.0, 40.5), (22.3, -13.0, 40.5), (22.3, -9.0, 40.5))
        tab.mouse.up()
        hands.until(lambda header: header["topology"] > 1 and header["act_count"] == 1)
        tab.keyboard.press("u")
        hands.until(lambda header: header["act_count"] == 0 and header["mode"] == "paused")
        before = operated.live.newest.frame.step
        known = hands.header()["end_s"]
        assert tab.locator("#branches-part").is_hidden()
        # time goes on: redo has nothing any more, and that is said
        tab.keyboard.press("Space")
        until(lambda: "is kept" in page.text("#notice-words"))
        hands.until(lambda header: header["end_s"] == header["time_s"] and header["step"] > before + 10)
        tab.locator("#tab-recordings").click()
        row = tab.locator("#branches li")
        assert row.count() == 1
        assert "1 cut" in row.inner_text()
        assert_accessible(page, "a branch")
        # brought back it is ahead, and stands on the time line
        row.locator("button").click()
        header = hands.until(lambda header: header["mode"] == "paused" and header["step"] == before)
        assert header["end_s"] == known
        until(lambda: tab.locator("#time-marks .cut").count() == 1)
        until(lambda: tab.locator("#branches-part").is_hidden())
        tab.locator("#redo").click()
        hands.until(lambda header: header["act_count"] == 1)
        assert hands.shows(operated.live) < TOLERANCE_MM


@pytest.mark.parametrize("is_cut", [False, True])
def test_the_graphics_card_places_vertices_as_the_server_does(chromium, operated, is_cut):
    """Curved everywhere, oblique, on nodes that were moved at random: against the surface that Python works out."""
    case = load_case(operated.recipe, needs=("surface", "structures"), curvature="all")
    assert case.surface.curvature.any()
    random = np.random.default_rng(5)
    session = OperatingSession(Simulation(case.model, surface=case.surface))
    if is_cut:
        low, high = case.surface.rest_mm.min(axis=0), case.surface.rest_mm.max(axis=0)
        middle, size = (low + high) / 2, high - low
        poses = middle + size * np.array([[[y, z, way] for z in (-1.0, 0.1)] for way, y in ((-1.0, 0.0), (0.1, 0.07))])
        session.do(Cut(poses_mm=as_poses(poses), at_rest=True))
    live = Live(session)
    model, surface = live.newest.frame.model, live.newest.surface
    assert (len(surface.in_cells.vertices) > 0) == is_cut
    topology = topology_message(1, live.newest, np.full(len(surface.triangles), 9, np.int32))
    live.close()
    with browsing(chromium, operated) as page:
        hands = Hands(page)
        for size in (0.02, 0.2, 0.4):
            nodes = random.normal(0.0, size, (model.node_count, 3)).astype(np.float32)
            rounded = Rounded.of(nodes)
            frame = frame_message({"frame": 1}, rounded, None, {})
            messages = {
                name: base64.b64encode(one).decode() for name, one in (("topology", topology), ("frame", frame))
            }
            vertex, places, normals = hands.read_back(**messages)
            exact = deform(model, surface, rounded.steps.astype(np.float32) * np.float32(rounded.scale))
            # the same formula on the same displacements: float32 alone is between them
            assert np.abs(places - exact.vertices_mm[vertex]).max() < 1e-4
            assert np.abs(normals - exact.normals[vertex]).max() < 1e-4


def test_tangents_of_the_normal_map_turn_with_the_surface(chromium, tmp_path):
    path, _ = write_charted(tmp_path)
    server = CaseServer(path)
    server.start()
    with browsing(chromium, server) as page:
        hands = Hands(page)
        hands.from_above()
        until(lambda: page.tab.evaluate(f"async () => {OPEN}.picture.heart.uniforms.hasMap.value"))
        page.drawn()
        bent = picture(page)
        page.tab.evaluate(
            f"async () => {{ const {{ picture }} = {OPEN}; picture.heart.uniforms.hasMap.value = false; "
            "picture.draw(); }"
        )
        page.drawn()
        assert picture(page) != bent
        hands.drag(TOP, TOP)
        page.tab.mouse.up()
        page.tab.keyboard.press("g")
        hands.drag(TOP, (27.0, -14.0, 40.5))
        hands.until(lambda header: header["instruments"] and header["instruments"][0]["center_mm"][0] > 26.5)
        page.tab.locator("#pause").focus()
        page.tab.keyboard.press(" ")
        assert hands.shows(server.live) < TOLERANCE_MM
        frame = server.live.newest.frame
        loaded = load_case(path, needs=("surface", "tangents"))
        exact = deform(frame.model, loaded.surface, frame.state.displacement).tangents
        vertex, uv = hands.vertex, hands.uv
        known = server.opened.places["operating"]._stage.normal_map.uv
        render = np.array([np.flatnonzero((known == one).all(axis=1))[0] for one in uv])
        np.testing.assert_array_equal(loaded.surface.render_to_welded[render], vertex)
        assert np.abs(hands.tangents - exact[render, :3]).max() < TOLERANCE_NORMAL
        page.tab.mouse.up()
    server.stop()


def test_a_page_shows_the_case_that_was_built_anew_where_another_opens_it(chromium, tmp_path):
    path, _ = write_charted(tmp_path)
    server = CaseServer(path)
    server.start()
    with browsing(chromium, server) as page:
        hands, tab = Hands(page), page.tab
        until(lambda: tab.evaluate(f"async () => {OPEN}.picture.heart.uniforms.hasMap.value"))
        hands.from_above()
        tab.keyboard.press("g")
        hands.drag(TOP, (27.0, -14.0, 40.5))
        hands.until(lambda header: header["instruments"])
        write_bundle(path, block_case(size=(6, 5, 4)))
        with browsing(chromium, server) as other:
            assert other.text("#case-name") == "block"
            until(lambda: page.text("#case-name") == "block")
            assert "built anew" in page.text("#notice")
            hands.until(lambda header: not header["instruments"])
            tab.locator("#pause").focus()
            tab.keyboard.press(" ")
            assert hands.shows(server.live) < TOLERANCE_MM
            assert Hands(other).shows(server.live) < TOLERANCE_MM
        # it has no normal map, and is not drawn with that of the one before
        assert not tab.evaluate(f"async () => {OPEN}.picture.heart.uniforms.hasMap.value")
        tab.mouse.up()
    server.stop()


def test_what_moves_is_drawn_more_coarsely_where_drawing_takes_long(chromium, tmp_path):
    """Chromium without a graphics card: the box stands for the block while the eye moves, also when it was cut."""
    server = CaseServer(write_block_with_a_box(tmp_path))
    server.start()
    try:
        with browsing(chromium, server) as page:
            hands = Hands(page)
            shown = f"""async () => {{ const {{ heart, renderer }} = {OPEN}.picture;
              return [heart.mesh.visible, heart.coarse.map((one) => one.mesh.visible), renderer.getPixelRatio()]; }}"""
            page.tab.keyboard.press("Space")
            hands.until(lambda header: header["mode"] == "paused")
            until(lambda: page.tab.evaluate(shown)[1] == [False])
            hands.from_above()
            # the last frame before the pause counts as motion for a while, and is drawn coarsely where that is slow
            until(lambda: not page.tab.evaluate(f"async () => {OPEN}.picture.detail.isMoving"))
            until(lambda: page.tab.evaluate(shown) == [True, [False], 1])
            page.drawn()
            still = picture(page)
            # turned there and back, for as long as pictures take long
            late = f"async () => {{ const {{ picture }} = {OPEN}; picture.detail.drew(40, 1); picture.move(); }}"
            for _ in range(5):
                page.tab.evaluate(late)
            page.tab.evaluate(f"async () => {{ const {{ picture }} = {OPEN}; picture.move(); picture.draw(); }}")
            moving = page.tab.evaluate(shown)
            assert moving[:2] == [False, [True]]
            assert moving[2] < 1.0
            until(lambda: page.tab.evaluate(shown) == [True, [False], 1])
            until(lambda: picture(page) == still)
    finally:
        server.stop()


def test_axe_finds_nothing_on_the_page_that_operates(chromium, operated):
    with browsing(chromium, operated, viewport={"width": 1366, "height": 768}) as page:
        hands, tab = Hands(page), page.tab
        hands.from_above()
        tab.keyboard.press("f")
        hands.drag(TOP, (24.0, -14.0, 40.5))
        tab.mouse.up()
        hands.until(lambda header: bool(header["instruments"]))
        tab.keyboard.press("w")
        hands.until(lambda header: header["recording"] is not None)
        tab.keyboard.press("w")
        tab.locator("#notice").wait_for()
        tab.locator("#strain").check()
        tab.locator("#pause").click()
        # each tab once, both colours and both languages among them
        for theme, language, names in (
            ("light", "de", ("help", "structures")),
            ("dark", "en", ("forces", "figures", "recordings")),
        ):
            if tab.locator("html").get_attribute("data-theme") != theme:
                tab.locator("#theme").click()
            tab.locator("#tab-help").click()
            tab.locator("#language").select_option(language)
            for name in names:
                tab.locator(f"#tab-{name}").click()
                if name == "figures":
                    tab.locator("#figures-none").wait_for()
                if name == "recordings":
                    tab.locator("#recordings button").first.wait_for()
                assert_accessible(page, f"{theme}, {language}, {name}")


def test_that_nobody_approved_the_case_stands_on_the_page_until_somebody_does(chromium, operated):
    with browsing(chromium, operated, locale="de-DE") as page:
        assert page.text("#draft-case").startswith("Entwurf: Niemand hat diesen Fall freigegeben")
        assert page.text("#not-device").startswith("Kein Medizinprodukt. Nur für Lehre")
        approve_case(operated.recipe, role="paediatric cardiologist")
        page.tab.locator("#draft-case").wait_for(state="hidden")
        approve_case(operated.recipe, role="paediatric cardiologist", withdraw=True)
        page.tab.locator("#draft-case").wait_for()
        approve_case(operated.recipe, role="paediatric cardiologist")
        page.open()
        assert page.tab.locator("#draft-case").is_hidden()


def test_all_tools_and_tabs_fit_in_german_and_what_is_said_changes_its_language(chromium, operated):
    with browsing(chromium, operated, locale="de-DE", viewport={"width": 1366, "height": 768}) as page:
        tab = page.tab
        tab.locator("#strain").check()
        assert "Gedehnt" in page.text("#stretch-legend")
        # the tool that ties is there with stitches alone
        tab.locator("#tie").evaluate("(one) => { one.hidden = false; }")
        # which side of the patient lies where, and how long a millimetre is, stands over the heart
        inked = (
            "(one) => one.getContext('2d').getImageData(0, 0, one.width, one.height).data.filter((v) => v > 0).length"
        )
        assert tab.locator("#scene canvas.orientation").evaluate(inked) > 500
        theme = tab.locator("#theme").bounding_box()
        assert theme["x"] + theme["width"] <= 1366
        for name in ("structures", "recordings", "help"):
            tab.locator(f"#tab-{name}").click()
            tops = {one.bounding_box()["y"] for one in tab.locator("[role=tab]:visible").all()}
            assert len(tops) == 1
        tab.locator("#language").select_option("en")
        assert "Stretched" in page.text("#stretch-legend")
