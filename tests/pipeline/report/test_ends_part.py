"""The report's part on where vessels end."""

import base64
import io

import numpy as np
from PIL import Image

from heartcase.pipeline.data import Scan, Segmentation
from heartcase.pipeline.report.build_report import ReportData, render_report
from heartcase.pipeline.report.ends_part import ends_part
from heartcase.pipeline.report.hand_work import hand_work_facts
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.settings import WallsSettings
from tests.pipeline.lattices import lattice
from tests.pipeline.vessel_shapes import TABLE, ball, line, segmented, tube

GEOMETRY = lattice("oblique", 60.0)
FACE = GEOMETRY.direction_matrix[:, 0]
UP = GEOMETRY.direction_matrix[:, 2]


def segmentation() -> Segmentation:
    """One vessel that ends in the volume, and one that leaves it through a face."""
    return segmented(
        GEOMETRY,
        (1, ball(GEOMETRY, -8.0 * UP, 10.0)),
        (4, ball(GEOMETRY, 12.0 * FACE - 14.0 * UP, 9.0)),
        (2, tube(GEOMETRY, line(tuple(-8.0 * UP), tuple(17.0 * UP)), 5.0)),
        (5, tube(GEOMETRY, line(tuple(12.0 * FACE - 14.0 * UP), tuple(60.0 * FACE - 14.0 * UP)), 4.0)),
    )


def test_each_end_has_a_row_and_each_that_is_cut_two_pictures_of_the_scan():
    labels = segmentation()
    scan = Scan(np.where(labels.labels > 0, 300.0, 0.0).astype(np.float32), GEOMETRY, "CT")
    part = ends_part(scan, grow_walls(labels, WallsSettings(find_ends=True), ()))
    by_vessel = {row.vessel: row for row in part.rows}
    cut, opened = by_vessel["superior vena cava"], by_vessel["aorta"]
    assert cut.words == "cut where the program found the end"
    assert cut.is_doubtful
    assert cut.diameter_mm > 10.0
    assert opened.diameter_mm is None
    assert "open at the face" in opened.words
    assert not opened.is_doubtful
    (picture,) = part.pictures
    pixels = np.array(Image.open(io.BytesIO(base64.b64decode(picture.uri.partition(",")[2]))).convert("L"))
    height = pixels.shape[1] // 2
    along, across = (pixels[-height:, n * height : (n + 1) * height].astype(int) for n in (0, 1))
    middle = height // 2
    # the vessel comes from the left and ends at the middle; across it is in the middle alone
    assert along[middle, height // 6] > 200
    assert along[middle, -height // 6] < 60
    assert across[middle, middle] > 200
    assert across[middle, height // 12] < 60
    html = render_report(ReportData(case_name="x", ends=part))
    assert html.count("cut where the program found the end") == 1
    assert '<a href="#ends">' in html


def test_without_ends_there_is_no_such_part():
    scan = Scan(np.zeros(GEOMETRY.shape, np.float32), GEOMETRY)
    assert ends_part(scan, grow_walls(segmentation(), WallsSettings(), ())) is None
    assert 'id="ends"' not in render_report(ReportData(case_name="x"))


def test_that_the_program_found_them_is_told_among_what_was_decided():
    recipe = Recipe.model_validate(
        {
            "heartcase_recipe": 1,
            "name": "x",
            "scan": {"path": "scan.nii.gz"},
            "labels": [label.model_dump() for label in TABLE],
            "strokes": [{"label": "aorta", "points_mm": [[0, 0, 0]]}],
            "ends": "automatic",
        }
    )
    facts = {fact.name: fact.value for fact in hand_work_facts(recipe)}
    assert facts["Ends of vessels"] == "found by the program"
