"""The report's section on confidence: figures, colours, places, and that it is no probability."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from heartcase.pipeline.markers.confidence import Sureness
from heartcase.pipeline.markers.suggest import StrokePlace, StrokePlaces
from heartcase.pipeline.report.build_report import ReportInputs, build_report
from heartcase.pipeline.report.confidence_part import confidence_part
from heartcase.schemas.recipe.recipe import parse_recipe
from tests.pipeline.report.analytic_heart import make_heart
from tests.pipeline.report.test_report import RECIPE, Page, grid_map

COLOURS = {"#ff2d95": 0.3, "#ff9e2c": 0.6, "#ffe66d": 0.8}
"""Colour of a band -> a confidence in it."""


@pytest.fixture(scope="module")
def heart():
    return make_heart(spacing_mm=(2.5, 2.5, 3.0))


def sureness(heart, confidence, *places, rest_ml=0.25):
    return Sureness(confidence.astype(np.float32), StrokePlaces(tuple(places), rest_ml))


PLACE = StrokePlace((12.5, -7.25, 30.0), 1, 5, 3.25, 0.1, 4.5, 1.0)


def test_each_structure_has_its_unsure_part(heart):
    labels = heart.segmentation.labels
    confidence = np.ones(labels.shape)
    left = np.flatnonzero(labels == 1)
    confidence.flat[left[: len(left) // 4]] = 0.74
    confidence[labels == 5] = 0.75
    rows = {row.name: row for row in confidence_part(heart.scan, heart.segmentation, sureness(heart, confidence)).rows}
    table, voxel_ml = heart.segmentation.table, 2.5 * 2.5 * 3.0 / 1000.0
    assert set(rows) == {table[value].name for value in np.unique(labels).tolist() if value}
    ventricle, aorta = rows[table[1].name], rows[table[5].name]
    assert ventricle.volume_ml == pytest.approx(len(left) * voxel_ml)
    assert ventricle.unsure_ml == pytest.approx(len(left) // 4 * voxel_ml)
    assert ventricle.unsure_percent == pytest.approx(25.0, abs=0.1)
    assert ventricle.median == 1.0
    assert (aorta.unsure_ml, aorta.median) == (0.0, 0.75)


def pixels(picture):
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.uri.split(",")[1])))).astype(int)


@pytest.mark.parametrize(("colour", "value"), COLOURS.items())
def test_what_is_unsure_has_its_colour_and_the_outlined_slices_have_none(heart, colour, value):
    labels = heart.segmentation.labels
    plain, coloured = (
        confidence_part(heart.scan, heart.segmentation, sureness(heart, confidence)).pictures
        for confidence in (np.ones(labels.shape), np.where(labels == 1, value, 1.0))
    )
    hue = np.array([int(colour[n : n + 2], 16) for n in (1, 3, 5)])
    for before, after in zip(plain, coloured, strict=True):
        one, other = pixels(before), pixels(after)
        half = len(one) // 2
        np.testing.assert_array_less(np.abs(one[: half - 20] - other[: half - 20]), 40)
        changed = np.abs(one - other).max(axis=-1) > 60
        assert changed[half:].mean() > 0.005
        # blood is white here, so what lies over it is the colour and a third of white
        wanted = 0.65 * hue + 0.35 * one[changed].mean(axis=0)
        np.testing.assert_allclose(other[changed].mean(axis=0), wanted, atol=25.0)


def test_far_from_the_heart_nothing_is_coloured(heart):
    labels = heart.segmentation.labels
    confidence = np.where(labels == 0, 0.1, 1.0)
    part = confidence_part(heart.scan, heart.segmentation, sureness(heart, confidence))
    picture = pixels(part.pictures[0])
    pink = (picture[..., 0] > 150) & (picture[..., 1] < 90) & (picture[..., 2] > 80)
    # a rim of 5 mm around the heart only: in a picture of its box with 12 mm around, less than a third
    assert 0.01 < pink[len(picture) // 2 :].mean() < 0.3


def page(heart, one):
    return build_report(
        ReportInputs(
            recipe=parse_recipe(RECIPE),
            scan=heart.scan,
            segmentation=heart.segmentation,
            structures=heart.structures,
            grid=heart.grid,
            surface=None,
            grid_map=grid_map(),
            volumes_ml={1: 33.25},
            timings_s={},
            stages=[],
            warnings=[],
            sureness=lambda: one,
        )
    )


def test_the_page_says_what_it_is_not_and_lists_the_places(heart):
    html = page(heart, sureness(heart, np.full(heart.segmentation.labels.shape, 0.8), PLACE))
    text = " ".join(Page(html).text.split())
    assert "How sure are the outlines?" in text
    assert "It is no probability." in text
    table = heart.segmentation.table
    assert f"L 12.5 A 7.2 H 30.0 mm {table[1].name} {table[5].name} 3.25 4.5" in text
    assert "worth about 0.25 ml" in text
    for colour in COLOURS:
        assert f"background:{colour}" in html
    assert '<a href="#confidence">' in html


def test_where_all_is_sure_no_place_is_listed_and_without_a_watershed_no_section(heart):
    text = Page(page(heart, sureness(heart, np.ones(heart.segmentation.labels.shape), rest_ml=0.0))).text
    assert "No place is unsure enough" in text
    html = page(heart, None)
    assert "How sure" not in html
    assert "#confidence" not in html
