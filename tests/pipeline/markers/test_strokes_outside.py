"""What lies outside a region of interest is cut off in one line; what lies outside the scan is refused in one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from heartcase.pipeline.markers.load_markers import load_markers, rasterise_strokes
from heartcase.pipeline.warnings import WarningGrade
from heartcase.schemas.errors import MarkerError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table
from heartcase.schemas.recipe.recipe import MarkerFile
from heartcase.schemas.recipe.settings import Stroke
from tests.pipeline.markers.test_markers import mrk, points, seg_nrrd

TABLE = default_label_table()
WHOLE = Geometry.of(shape=(30, 32, 34), spacing_mm=(1.5, 1.5, 2.0), origin_mm=(-90.0, 10.0, -40.0))
START = (10, 8, 6)
REGION = WHOLE.cropped(START, (12, 12, 12))


def dab(index: tuple[float, float, float], label: str = "aorta", radius_mm: float = 2.0) -> Stroke:
    x, y, z = WHOLE.index_to_world(index).tolist()
    return Stroke(label=label, radius_mm=radius_mm, points_mm=((x, y, z),))


def many_outside(count: int = 80) -> list[Stroke]:
    return [dab((3.0 + 0.02 * n, 4.0, 3.0)) for n in range(count)]


def test_eighty_strokes_outside_the_region_are_one_line_and_change_nothing() -> None:
    kept = [dab((15, 14, 12)), dab((10, 14, 12), "background", 4.0)]
    markers = load_markers((), [*kept, *many_outside()], TABLE, REGION, Path(), whole=WHOLE)
    (warning,) = markers.warnings
    assert warning.grade is WarningGrade.LOOK
    assert warning.text == (
        "of 82 strokes 80 lie wholly outside the region of interest and are left out, 1 reaches out of the region of "
        "interest and is cut there"
    )
    # what is left is the part of the whole scan's strokes that lies in the region
    whole = rasterise_strokes(kept, TABLE, WHOLE)
    (i, j, k), (a, b, c) = START, REGION.size
    np.testing.assert_array_equal(markers.labels, whole[k : k + c, j : j + b, i : i + a])


def test_strokes_that_only_reach_out_are_for_information() -> None:
    (warning,) = load_markers((), [dab((10, 14, 12), radius_mm=4.0)], TABLE, REGION, Path(), whole=WHOLE).warnings
    assert warning.grade is WarningGrade.NOTE
    assert load_markers((), [dab((15, 14, 12))], TABLE, REGION, Path(), whole=WHOLE).warnings == ()
    # without a region what reaches out of the scan is cut as ever
    assert load_markers((), [dab((0, 14, 12), radius_mm=4.0)], TABLE, WHOLE, Path(), whole=WHOLE).warnings == ()


def test_strokes_outside_the_scan_are_one_refusal_for_each_remedy() -> None:
    far = [dab((500.0 + n, 4.0, 3.0)) for n in range(70)]
    x, y, z = WHOLE.index_to_world((15, 14, 12)).tolist()
    flipped = [Stroke(label="left atrium", points_mm=((-x, -y, z),)) for _ in range(3)]
    with pytest.raises(MarkerError) as caught:
        load_markers((), [*many_outside(4), *far, *flipped], TABLE, REGION, Path(), whole=WHOLE)
    ras, other = caught.value.problems
    assert ras.place == other.place == "strokes"
    assert "strokes[75], strokes[76], strokes[77] lie outside the scan" in ras.message
    assert "RAS: change the sign" in ras.message
    assert "strokes[5], strokes[6]" in other.message
    assert "and 64 more lie outside the scan, which reaches over x -90.8 to -39.8" in other.message


def test_points_and_segments_of_files_are_cut_as_strokes_are(tmp_path: Path) -> None:
    inside, outside = WHOLE.index_to_world((15, 14, 12)).tolist(), WHOLE.index_to_world((2, 2, 2)).tolist()
    mrk(tmp_path / "p.mrk.json", points("Fiducial", "LPS", [inside, outside, outside], ["aorta"] * 3))
    values = np.zeros(WHOLE.shape, np.uint8)
    values[12:14, 14:16, 15:17], values[1:3, 1:3, 1:3] = 1, 2
    table = [{"Name": name, "LabelValue": str(n), "Layer": "0"} for n, name in ((1, "left atrium"), (2, "aorta"))]
    seg_nrrd(tmp_path / "s.seg.nrrd", values, WHOLE, table)
    files = [MarkerFile(path="p.mrk.json"), MarkerFile(path="s.seg.nrrd")]
    of_points, of_segments = (
        load_markers(files[:1], (), TABLE, REGION, tmp_path, whole=WHOLE).warnings
        + load_markers(files[1:], (), TABLE, REGION, tmp_path, whole=WHOLE).warnings
    )
    assert of_points.text == "markers[1]: of 3 marks 2 lie wholly outside the region of interest and are left out"
    assert "segment 2 of the file lie outside the region" in of_segments.text
    with pytest.raises(MarkerError, match="segment 2 of the file lie outside the scan"):
        load_markers(files[1:], (), TABLE, REGION, tmp_path)
