"""Slices of the scan: greys and places against SimpleITK's own resampling, and what is told of the scan."""

from __future__ import annotations

import json

import numpy as np
import pytest
import SimpleITK
from scipy.spatial.transform import Rotation

from heartcase.pipeline.bundle.write_bundle import BundleSource, write_bundle
from heartcase.pipeline.stages.read import region_of_scan
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import parse_recipe
from heartcase.studio.operating.scene.scan_slices import ScanSlices
from heartcase.studio.starting.registry import Registry
from tests.studio.operating.performing import operator, theatre
from tests.studio.operating.two_walls import two_walls
from tests.studio.page.browsing import TURNED, write_recipe
from tests.studio.talking import TOKEN

OBLIQUE = Rotation.from_euler("xyz", (20.0, -35.0, 50.0), degrees=True).as_matrix()


def image_of(values, direction, spacing=(0.8, 1.3, 2.1), origin=(13.0, -21.0, 7.0)):
    image = SimpleITK.GetImageFromArray(values)
    image.SetSpacing(spacing)
    image.SetOrigin(origin)
    image.SetDirection(np.asarray(direction).ravel().tolist())
    nk, nj, ni = values.shape
    return image, Geometry.of(shape=(nk, nj, ni), spacing_mm=spacing, origin_mm=origin, direction=direction)


@pytest.mark.parametrize("turn", [(0, 0, 0), (30, 40, 10), (-70, 15, 120)])
def test_greys_are_those_of_the_scan_at_the_places_of_the_pixels(turn):
    values = np.random.default_rng(4).uniform(0.0, 1000.0, (9, 12, 15)).astype(np.float32)
    image, geometry = image_of(values, OBLIQUE)
    axes = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
    point = geometry.index_to_world(np.array([7.0, 5.5, 4.0]))
    shown = ScanSlices(values, geometry).through(point, axes[0], axes[1])
    rows, columns, _ = shown.greys.shape
    pixel = shown.width_mm / columns
    assert shown.height_mm / rows == pytest.approx(pixel)
    # the same plane by SimpleITK: its origin is the middle of the first pixel
    into = SimpleITK.ResampleImageFilter()
    into.SetSize((columns, rows, 1))
    into.SetOutputSpacing((pixel, pixel, 1.0))
    into.SetOutputDirection(np.stack([axes[0], axes[1], axes[2]], axis=1).ravel().tolist())
    into.SetOutputOrigin((shown.origin_mm + 0.5 * pixel * (axes[0] + axes[1])).tolist())
    into.SetInterpolator(SimpleITK.sitkLinear)
    into.SetDefaultPixelValue(-1.0)
    found = SimpleITK.GetArrayFromImage(into.Execute(image))[0]
    low, high = np.percentile(values, [1.0, 99.0])
    grey = 255.0 * np.clip((found - low) / (high - low), 0.0, 1.0)
    # SimpleITK has nothing beyond the middles of the outer voxels, here they reach to their faces
    known = found >= 0.0
    assert known.sum() > 50
    assert np.abs(shown.greys[..., 0][known] - grey[known]).max() <= 1.0
    assert (shown.greys[..., 1][known] > 127).all()
    assert (shown.greys[[0, 0, -1, -1], [0, -1, 0, -1], 1] < 255).all()


def test_a_voxel_lies_between_its_corners():
    values = np.zeros((9, 12, 15), np.float32)
    values[4, 6, 8] = 100.0
    _, geometry = image_of(values, OBLIQUE)
    right, down = OBLIQUE[:, 0], OBLIQUE[:, 1]
    slices = ScanSlices(values, geometry)
    assert slices.range == (0.0, 100.0)
    middle = geometry.index_to_world(np.array([0.0, 0.0, 4.0]))
    shown = slices.through(middle, right, down, (0.0, 100.0))
    # grey runs from black to white evenly
    narrow = slices.through(middle, right, down, (25.0, 75.0)).greys[..., 0].astype(int)
    np.testing.assert_allclose(narrow, np.clip(2.0 * shown.greys[..., 0] - 127.5, 0, 255), atol=1.6)
    # linear between voxels: half of the grey is at the voxel's faces
    rows, columns = np.nonzero(shown.greys[..., 0] >= 128)
    pixel = shown.width_mm / shown.greys.shape[1]
    for number, place in ((columns, right), (rows, down)):
        low, high = number.min() * pixel, (number.max() + 1) * pixel
        corners = geometry.index_to_world(np.array([[7.5, 5.5, 4.0], [8.5, 6.5, 4.0]]))
        expected = (corners - shown.origin_mm) @ place
        np.testing.assert_allclose([low, high], expected, atol=pixel)
    # the picture begins at the outer corner of the first voxel
    np.testing.assert_allclose(shown.origin_mm, geometry.index_to_world(np.array([-0.5, -0.5, 4.0])), atol=1e-9)


def test_a_case_that_was_opened_from_its_recipe_shows_its_scan_and_leads_back(tmp_path):
    recipe, affine = write_recipe(tmp_path, TURNED)
    scan = region_of_scan(parse_recipe(recipe.read_text(), needs_markers=False), tmp_path)
    case = tmp_path / "two.case"
    write_bundle(case, two_walls(BundleSource(geometry=scan.geometry, sha256=scan.values_sha256)))
    plane = {"point_mm": (affine @ [20, 15, 12, 1])[:3].tolist(), "right": [1, 0, 0], "down": [0, 1, 0]}
    with theatre(case, tmp_path, recipe) as (browser, opened):
        with operator(browser, opened) as page:
            assert page.opened["scan"]
            assert page.opened["recipe"].startswith("/prepare/")
            assert browser.get(page.opened["recipe"]).status_code == 200
            page.done("slice", name="axial", **plane)
            header, greys = page.slices["axial"]
            # what is bright in the scan is bright here
            bright = (affine @ [29.5, 9, 17, 1])[:3]
            page.done("slice", name="axial", **(plane | {"point_mm": bright.tolist()}))
            header, greys = page.slices["axial"]
            pixel = header["width_mm"] / greys.shape[1]
            column, row = ((bright - header["origin_mm"])[:2] / pixel).astype(int)
            assert greys[row, column, 0] > 2 * np.median(greys[..., 0][greys[..., 1] == 255])
            assert header["range"][0] <= header["window"][0] < header["window"][1] <= header["range"][1]
            assert page.ask("slice", name="axial", **plane, window=[5, 5])["kind"] == "refused"
            page.done("slice", name="axial", **plane, window=[5, 50])
            assert page.slices["axial"][0]["window"] == [5, 50]
            answer = page.ask("slice", name="axial", **(plane | {"down": [0, 1, 1]}))
            assert answer["kind"] == "refused"
        # a scan that became another one is not shown as that of the case
        image = SimpleITK.ReadImage(str(tmp_path / "scan.nii.gz"))
        SimpleITK.WriteImage(image + 1, str(tmp_path / "scan.nii.gz"))
        opened.places["operating"]._slices._scan = None
        with operator(browser, opened) as page:
            answer = page.ask("slice", name="axial", **plane)
            assert "no longer" in json.dumps(answer["problems"])
        (tmp_path / "scan.nii.gz").unlink()
        with operator(browser, opened) as page:
            answer = page.ask("slice", name="axial", **plane)
            assert "cannot be read" in json.dumps(answer["problems"])
            told = json.dumps([page.told, answer])
            assert str(tmp_path) not in told
            assert "nii" not in told


def test_a_case_alone_has_no_scan_to_show(operated):
    browser, opened = operated
    with operator(browser, opened) as page:
        assert page.opened["scan"] is False
        assert page.opened["recipe"] is None
        answer = page.ask("slice", name="cut", point_mm=[0, 0, 0], right=[1, 0, 0], down=[0, 1, 0])
        assert "open the case from its recipe" in json.dumps(answer["problems"])


def test_a_case_that_is_opened_from_a_recipe_knows_it_also_where_it_was_open_before(tmp_path):
    recipe, _ = write_recipe(tmp_path)
    case = tmp_path / "two.case"
    write_bundle(case, two_walls())
    registry = Registry(TOKEN)
    before = registry.open_case(case)
    assert before.places["operating"].origin is None
    opened = registry.open_recipe(recipe, out=tmp_path)
    address = opened.places["building"]._operate(case)
    assert address == before.address
    assert before.places["operating"].origin.address == opened.address
