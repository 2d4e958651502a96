"""The build report: whole, standing alone, honest, and without identity."""

import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from heartcase.pipeline.data import GridMap
from heartcase.pipeline.report.build_report import ReportData, build_report, render_report
from heartcase.pipeline.report.plain_words import figure_facts, hand_work_facts, setting_lines
from heartcase.schemas.bundle import CaseManifest, StageRecord
from heartcase.schemas.recipe import parse_recipe
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
        warnings=["the worst <of> all", "a lesser one", "the worst <of> all"],
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
    # Three stacks of slices, four sides, two cuts, two thickness maps and the histogram.
    assert len(images) == 12
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
    assert text.index(notice) < text.index("Case 7") < text.index("the worst <of> all") < text.index("a lesser one")
    assert text.count("the worst <of> all") == 1
    assert "2 warnings" in text


def test_every_structure_is_there_with_its_volume(html, heart):
    text = Page(html).text
    for value, volume in ((1, "33.2"), (5, "11.5"), (9, "87.8"), (10, "20.0")):
        assert heart.table[value].name in text
        assert volume in text
    assert re.search(r"All blood\s+44\.8", text)
    assert re.search(r"All tissue\s+107\.8", text)


def test_thickness_table_gives_measured_and_asked_for(html):
    text = re.sub(r"\s+", " ", Page(html).text)
    # The analytic heart's grown walls are 1 mm thicker than the table asks for.
    row = re.search(r"right ventricle wall (\d\.\d) (\d\.\d) ", text[text.index("Asked for") :])
    assert row is not None
    assert row.group(1) == "4.0"
    assert float(row.group(2)) == pytest.approx(5.0, abs=0.25)


def test_hand_work_times_and_provenance_are_stated(html):
    text = re.sub(r"\s+", " ", Page(html).text)
    assert "Painted: left ventricle 2 strokes, 35 mm in all" in text
    assert "Marker files 1" in text
    assert "septal defect of 8 mm made at (5.0, -15.0, -10.0) mm" in text
    assert "ball of 6 mm radius" in text
    assert "6.25" in text
    assert "iterations = 5" in text
    assert "abababababab" in text
    assert "Points tied to another structure 4" in text
    assert "12.5 %" in text
    assert "Distance of the surface from the grid median 0.25, largest 1.5 cells" in text


def test_same_input_gives_the_same_page(heart):
    def once() -> str:
        return build_report(
            recipe=parse_recipe(RECIPE),
            scan=heart.scan,
            segmentation=heart.segmentation,
            structures=heart.structures,
            grid=heart.grid,
            surface=None,
            grid_map=None,
            volumes_ml={},
            timings_s={},
            stages=[],
            warnings=[],
        )

    page = once()
    assert page == once()
    assert "without a visible surface" in page
    assert "No warnings" in page
    assert len(Page(page).all("img")) == 3


def test_everything_that_is_given_is_escaped():
    nasty = "<script>alert('x')</script> & \"y\""
    page = Page(render_report(ReportData(case_name=nasty, warnings=[nasty])))
    assert not page.all("script")
    assert page.text.count(nasty) == 2


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
        '[segment]\nmethod = "threshold"\n[[segment.ranges]]\nlabel = "aorta"\nlower = 5\n'
    )
    assert hand_work_facts(recipe) == []
    assert "made by the program alone" in render_report(ReportData(case_name="x"))
