"""The build report: whole, standing alone, honest, and without identity."""

import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from heartcase.pipeline.data import GridMap
from heartcase.pipeline.report.build_report import (
    STATE_WORDS,
    ReportData,
    ReportInputs,
    SeptumRow,
    build_report,
    render_report,
)
from heartcase.pipeline.report.hand_work import hand_work_facts
from heartcase.pipeline.report.plain_words import cardiac_phase_words, figure_facts, setting_lines
from heartcase.pipeline.warnings import CaseWarning, anatomy, grouped, note
from heartcase.schemas.bundle.format import CaseManifest, StageRecord
from heartcase.schemas.recipe.recipe import parse_recipe
from tests.pipeline.report.analytic_heart import make_heart

RECIPE = """
heartcase_recipe = 1
name = "Case 7"
[scan]
path = "private/Qwertz_Jane.nii.gz"
origin = "from the archive of Qwertz"
[[markers]]
path = "private/Qwertz_markers.nrrd"
[[strokes]]
label = "left ventricle"
points_mm = [[22, -12, -20], [22, -12, 0], [22, -12, 10]]
[[strokes]]
label = "left ventricle"
points_mm = [[20, -12, 0], [20, -12, 5]]
[[edits]]
kind = "septal_defect"
position_mm = [5, -15, -10]
diameter_mm = 8
axis = [1, 0, 0]
[[pins]]
position_mm = [0, 0, 60]
radius_mm = 6
"""
VOID = {"meta", "img", "br", "link", "hr"}


class Page(HTMLParser):
    """Checks that elements nest, and collects text and attributes."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "title"):
            self.text += data + " "

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attrs for name, attrs in self.tags if name == tag]


@pytest.fixture(scope="module")
def heart():
    return make_heart(spacing_mm=(2.5, 2.5, 3.0))


@pytest.fixture(scope="module")
def html(heart):
    recipe = parse_recipe(RECIPE)
    return build_report(
        ReportInputs(
            recipe=recipe,
            scan=heart.scan,
            segmentation=heart.segmentation,
            structures=heart.structures,
            grid=heart.grid,
            surface=heart.surface,
            grid_map=grid_map(),
            volumes_ml={1: 33.25, 5: 11.5, 9: 87.75, 10: 20.0},
            timings_s={"surface": 6.25, "filter": 0.5},
            stages=[
                StageRecord(
                    stage="filter",
                    version=3,
                    settings={"iterations": 5, "file": "private/Qwertz.nii", "note": "C:\\Qwertz\\x"},
                    output_sha256="ab" * 32,
                )
            ],
            warnings=[
                note("a lesser one"),
                CaseWarning("one to look at"),
                anatomy("the worst <of> all"),
                note("a lesser one"),
            ],
            case_id="HC-TEST-0001",
        )
    )


def grid_map() -> GridMap:
    empty = np.zeros((0, 3), np.float32)
    none = np.zeros(0, np.uint8)
    return GridMap(
        triangle_nodes=np.zeros((0, 3), np.int32),
        weights=empty,
        offset_mm=empty,
        normal=empty,
        curvature=none,
        tangent=np.zeros((0, 4), np.float32),
        nearest_node=np.zeros(0, np.int32),
        quality={"other_label_count": 4, "curvature_share": 0.125, "offset_cells": {"p50": 0.25, "max": 1.5}},
    )


def test_page_is_whole_html_and_stands_alone(html):
    page = Page(html)
    assert html.startswith("<!DOCTYPE html>")
    assert page.all("html") == [{"lang": "en"}]
    assert not page.all("script")
    assert not page.all("link")
    assert "http:" not in html
    assert "https:" not in html
    assert "url(" not in html
    assert "@import" not in html
    for anchor in page.all("a"):
        target = anchor["href"]
        assert target.startswith("#")
        assert any(attrs.get("id") == target[1:] for _, attrs in page.tags)


def test_pictures_are_inside_decode_and_have_words(html):
    images = Page(html).all("img")
    # Three stacks of slices, six sides, the surgeon's view and three cuts, two thickness maps and the histogram.
    assert len(images) == 16
    assert any("from the inferior side" in image["alt"] for image in images)
    for image in images:
        assert len(image["alt"]) > 20
        head, _, content = image["src"].partition(",")
        assert re.fullmatch(r"data:image/(png|jpeg);base64", head)
        picture = Image.open(io.BytesIO(base64.b64decode(content, validate=True)))
        picture.load()
        assert picture.size == (int(image["width"]), int(image["height"]))
        assert np.asarray(picture.convert("L")).std() > 5.0


def test_no_path_file_name_or_identity_reaches_the_page(html):
    text = re.sub(r"base64,[A-Za-z0-9+/=]+", "", html)
    for private in ("Qwertz", "private", ".nii", ".nrrd", "\\", "archive", "/tmp", "/home", "/work"):
        assert private not in text


def test_notice_stands_first_and_warnings_follow_worst_first(html):
    text = Page(html).text
    notice = CaseManifest.model_fields["notice"].default
    order = [notice, "Case 7", "HC-TEST-0001", "DRAFT: not approved", "3 warnings", "The anatomy may be wrong"]
    order += ["The worst <of> all", "Look at this", "One to look at", "For your information", "A lesser one"]
    places = [text.index(words) for words in order]
    assert places == sorted(places)
    assert text.count("A lesser one") == 1


def test_what_a_warning_lists_is_a_list_on_the_page_in_its_order():
    text = "these touch: aorta and <vein>; left and right. Say so"
    lists = CaseWarning(text, listed=("aorta and <vein>", "left and right"))
    html = render_report(ReportData(case_name="x", warnings=grouped([lists, CaseWarning("plain; text")])))
    found = re.search(r"<li>These touch:\s*<ul>(.*?)</ul>\s*Say so\.</li>\s*<li>Plain; text\.</li>", html, re.DOTALL)
    assert found
    assert re.findall(r"<li>(.*?)</li>", found[1]) == ["aorta and &lt;vein&gt;", "left and right"]
    page = Page(html)
    assert "2 warnings" in page.text
    assert "; left" not in page.text


def test_grown_walls_are_told_apart_from_openings_that_are_stated():
    septum = SeptumRow("left atrium and right atrium", 120.0, 1.2, 1, "L 1.0 P 2.0 H 3.0 mm")
    text = re.sub(r"\s+", " ", Page(render_report(ReportData(case_name="x", septa=[septum]))).text)
    assert "Where the recipe states an opening by a landmark, by strokes or by an open place" in text
    assert "it is closed in the model" not in text
    assert "stated openings included" not in text
    assert "not seen" not in Page(render_report(ReportData(case_name="x"))).text


def test_every_structure_is_there_with_its_volume(html, heart):
    text = Page(html).text
    for value, volume in ((1, "33.2"), (5, "11.5"), (9, "87.8"), (10, "20.0")):
        assert heart.table[value].name in text
        assert volume in text
    assert re.search(r"Blood in the chambers\s+sum\s+33\.2", text)
    assert re.search(r"Blood in the vessels\s+sum\s+11\.5", text)
    assert re.search(r"All blood\s+sum\s+44\.8", text)
    assert re.search(r"Heart muscle\s+sum\s+107\.8", text)
    assert re.search(r"All tissue\s+sum\s+107\.8", text)
    assert "Patches and devices" not in text


def test_thickness_table_gives_measured_and_asked_for(html, heart):
    text = re.sub(r"\s+", " ", Page(html).text)
    # The analytic heart's grown walls are 1 mm thicker than the table asks for.
    row = re.search(
        re.escape(heart.table[heart.table.wall_value(2)].name) + r" (\d\.\d) (\d\.\d) ", text[text.index("Asked for") :]
    )
    assert row is not None
    assert row.group(1) == "4.0"
    assert float(row.group(2)) == pytest.approx(5.0, abs=0.25)


def test_a_wall_that_varies_along_the_vessel_has_no_single_thickness_that_was_asked_for(heart):
    tables = """
[[walls.thickness]]
label = "Aorta"
kind = "positions"
points_mm = [[0, 0, 40], [0, 0, 60]]
thickness_mm = [1.0, 3.0]
"""
    text = re.sub(r"\s+", " ", Page(page_of(heart, recipe=RECIPE + tables, surface=heart.surface)).text)
    rows = text[text.index("Asked for") :]
    atrium = heart.table["morphologically left atrium"]
    aorta_wall, atrium_wall = (
        re.escape(heart.table[heart.table.wall_value(one.value)].name) for one in (heart.table["aorta"], atrium)
    )
    assert re.search(aorta_wall + r" \u2013 \d\.\d ", rows)
    found = re.search(atrium_wall + r" (\d\.\d) \d\.\d ", rows)
    assert found is not None
    assert float(found.group(1)) == atrium.wall_thickness_mm


def test_hand_work_times_and_provenance_are_stated(html):
    text = re.sub(r"\s+", " ", Page(html).text)
    assert "Painted: left ventricle 2 strokes, 35 mm in all" in text
    assert "Marker files 1" in text
    assert "septal defect of 8 mm made at L 5.0 A 15.0 F 10.0 mm" in text
    assert "ball of 6 mm radius" in text
    assert "6.25" in text
    assert "iterations = 5" in text
    assert "abababababab" in text
    assert "Points tied to another structure 4" in text
    assert "12.5 %" in text
    assert "Distance of the surface from the grid median 0.25, largest 1.5 cells" in text


def page_of(heart, *, scan=None, surface=None, recipe=RECIPE, septa=()) -> str:
    """The page of a case about which little is known."""
    return build_report(
        ReportInputs(
            recipe=parse_recipe(recipe),
            scan=scan or heart.scan,
            segmentation=heart.segmentation,
            structures=heart.structures,
            grid=heart.grid,
            surface=surface,
            grid_map=None,
            volumes_ml={},
            timings_s={},
            stages=[],
            warnings=[],
            septa=septa,
        )
    )


def test_places_of_grown_walls_are_told_as_they_were_judged(heart):
    place = {"center_mm": [1.0, 2.0, 3.0], "radius_mm": 2.0}
    figure = {
        "between": ["left atrium", "right atrium"],
        "area_mm2": 99.0,
        "thickness_mm": 1.2,
        "patches": 12,
        "center_mm": [1.0, 2.0, 3.0],
        "places": [
            place | {"area_mm2": mm2, "state": state}
            for mm2, state in zip((40.0, 30.0, 20.0), STATE_WORDS, strict=True)
        ],
        "others": place | {"area_mm2": 9.0},
    }
    text = re.sub(r"\s+", " ", Page(page_of(heart, septa=[figure])).text)
    table = text.partition("Walls that were grown and not seen")[2].partition("What to think of it")[2]
    rows = [row.strip() for row in table.split("left atrium and right atrium")[1:5]]
    assert [row.split()[0] for row in rows] == ["40.0", "30.0", "20.0", "9.0"]
    for row, words in zip(rows, (*STATE_WORDS.values(), STATE_WORDS["grown"]), strict=True):
        assert words in row
    assert rows[3].split()[2] == "9"


def test_same_input_gives_the_same_page(heart):
    page = page_of(heart)
    assert page == page_of(heart)
    assert "without a visible surface" in page
    assert "No warnings" in page
    assert len(Page(page).all("img")) == 3


def test_everything_that_is_given_is_escaped():
    nasty = "<script>alert('x')</script> & \"y\""
    page = Page(render_report(ReportData(case_name=nasty, warnings=grouped([CaseWarning(nasty)]))))
    assert not page.all("script")
    assert page.text.count(nasty) == 2


def test_case_is_a_draft_and_the_page_says_how_to_approve_it(html):
    text = re.sub(r"\s+", " ", Page(html).text)
    assert "heartcase approve CASE --role" in text
    assert "heartcase info CASE" in text
    assert "<title>Case 7 (HC-TEST-0001): build report</title>" in html
    assert "HC-" not in render_report(ReportData(case_name="x"))


@pytest.mark.parametrize(
    ("acquisition", "words"),
    [
        ({"trigger_time_ms": 640.0}, "640 ms after the R wave"),
        ({"cardiac_phase_percent": 70.0}, "70 % of the way from one R wave to the next"),
        (
            {"cardiac_phase_percent": 0.0, "trigger_time_ms": 0.0},
            "0 ms after the R wave, 0 % of the way from one R wave to the next",
        ),
        ({"echo_time_ms": 3.0}, "not stated in the scan"),
        ({"trigger_time_ms": float("nan")}, "not stated in the scan"),
        ({"trigger_time_ms": "Qwertz"}, "not stated in the scan"),
    ],
)
def test_cardiac_phase_is_put_in_words(acquisition, words):
    assert cardiac_phase_words(acquisition) == words


@pytest.mark.parametrize("acquisition", [{"trigger_time_ms": 640.0, "cardiac_phase_percent": 70.0}, {}])
def test_cardiac_phase_is_on_the_page_and_in_every_row_of_slices(heart, acquisition):
    words = cardiac_phase_words(acquisition)
    scan = replace(heart.scan, acquisition={**acquisition, "magnetic_field_strength_t": 1.5})
    page = Page(page_of(heart, scan=scan))
    text = re.sub(r"\s+", " ", page.text)
    assert f"Cardiac phase {words}" in text
    assert "Trigger time" not in text
    assert "1.5 T" in text
    assert sum(f"Cardiac phase: {words}." in image["alt"] for image in page.all("img")) == 3


def test_where_no_short_axis_can_be_found_the_page_says_what_it_needs():
    heart = make_heart(spacing_mm=(5.0, 5.0, 5.0))
    surface = replace(
        heart.surface, triangle_label=np.where(heart.surface.triangle_label == 3, 0, heart.surface.triangle_label)
    )
    page = Page(page_of(heart, surface=surface))
    assert "There is no short-axis cut" in page.text
    assert len(page.all("img")) == 15


def luminance(colour: str) -> float:
    """Relative luminance, WCAG 2.2."""
    channels = np.array([int(colour[n : n + 2], 16) / 255.0 for n in (1, 3, 5)])
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_writing_has_the_contrast_that_wcag_aa_asks_for(html):
    named = dict(re.findall(r"--(\w+): (#[0-9a-f]{6});", html))
    grounds = {named["paper"], named["tint"], *re.findall(r"background: (#[0-9a-f]{6})[;} ]", html)}
    assert len(grounds) >= 4
    inks = {named["ink"], named["soft"], *re.findall(r"[^-]color: (#[0-9a-f]{6});", html)}
    for ink in inks:
        for ground in grounds:
            light, dark = sorted((luminance(ink), luminance(ground)), reverse=True)
            assert (light + 0.05) / (dark + 0.05) >= 4.5, (ink, ground)
    light, dark = sorted((luminance(named["accent"]), luminance(named["paper"])), reverse=True)
    assert (light + 0.05) / (dark + 0.05) >= 4.5


def test_page_is_made_for_paper_too(html):
    style = html[html.index("<style>") : html.index("</style>")]
    print_rules = style[style.index("@media print") :]
    assert re.search(r"figure[^{]*\{ break-inside: avoid", print_rules)
    tallest = re.search(r"figure img \{[^}]*max-height: (\d+)mm", print_rules)
    # Letter is 279 mm high, less the margins.
    assert int(tallest.group(1)) < 279 - 2 * 14 - 30


def test_figures_are_put_in_words_with_units():
    facts = figure_facts(
        {
            "volume_error_percent": -0.25,
            "betti_blood": {"full_resolution": [2, 0, 0], "grid": [2, 1, 0]},
            "some_new_distance_p95_mm": 0.125,
            "repairs": {"leak_cells_added": 3},
            "is_closed": True,
            "area_cm2": {"aorta": 12.5},
            "thickness_cells": {"p5": 0.5, "p50": 1.0},
            "volume_change_fraction": -0.00012,
            "unheard_of": float("nan"),
            "change_places_mm": {"tissue": [[1.25, 2.0, -3.0]] * 7, "blood": []},
        }
    )
    words = {fact.name: fact.value for fact in facts}
    assert words["Error of the tissue volume"] == "-0.25 %"
    assert words["Blood"] == "in the scan 2 / 0 / 0, in the cells 2 / 1 / 0"
    assert words["Some new distance (95% are below)"] == "0.125 mm"
    assert words["Area: aorta"] == "12.5 cm²"
    assert words["Thickness of the tissue"] == "5% below 0.5, median 1 cells"
    assert words["Change of volume by simplifying"] == "-0.012 %"
    technical = [fact.is_technical for fact in facts]
    assert technical == sorted(technical)
    assert words["Cells added to stop leaks"] == "3"
    assert words["Is closed"] == "yes"
    assert words["Unheard of"] == "not known"
    assert words["Where, in LPS: tissue"] == ", ".join(["L 1.2 P 2.0 F 3.0 mm"] * 5) + " and 2 more"
    assert words["Where, in LPS: blood"] == "none"


def test_figures_stand_in_the_same_order_however_they_come():
    figures = {"b": 1, "node_count": 2, "cell_mm": 2.5, "a": 3, "repairs": {"leak_cells_added": 3, "hinges_left": 0}}
    one, other = figure_facts(figures), figure_facts(dict(sorted(figures.items(), reverse=True)))
    assert one == other
    assert [fact.name for fact in one][:2] == ["Edge of a cell", "Nodes"]


def test_settings_leave_paths_out_and_count_lists():
    lines = setting_lines(
        {
            "cell_mm": 2.5,
            "path": "a",
            "names": {"Qwertz": "x"},
            "free": "a/b",
            "strokes": [{}] * 9,
            "inner": {"repair": True},
        }
    )
    assert lines == ["cell = 2.5 mm", "strokes = 9 entries", "inner: repair = yes"]


def test_case_without_hand_work_says_so():
    recipe = parse_recipe(
        'heartcase_recipe = 1\nname = "x"\n[scan]\npath = "a.nrrd"\n'
        '[[strokes]]\nlabel = "aorta"\npoints_mm = [[0, 0, 0]]\n'
    )
    assert [fact.name for fact in hand_work_facts(recipe)] == ["Painted: aorta"]
    assert "made by the program alone" in render_report(ReportData(case_name="x"))
