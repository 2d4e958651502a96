"""The recipe of the real scan: its limits always, its result where the scan is at hand."""

import dataclasses
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from heartcase.pipeline.data import Markers
from heartcase.pipeline.filter import filter_scan
from heartcase.pipeline.markers import load_markers, rasterise_strokes
from heartcase.pipeline.read import read_scan
from heartcase.pipeline.region import crop_scan
from heartcase.pipeline.segment import segment_scan, segmentation_warnings
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe import load_recipe

RECIPE = Path(__file__).parents[2] / "sample_cases" / "chest_ct.toml"
SCAN_GEOMETRY = Geometry.of(
    shape=(112, 102, 122), origin_mm=(-71.658203125, -255.658203125, 576.2000122070312), spacing_mm=(1.5, 1.5, 1.5)
)
OPENINGS = {
    ("left ventricle", "left atrium"),
    ("left ventricle", "aorta"),
    ("right ventricle", "right atrium"),
    ("right ventricle", "pulmonary artery"),
    ("right atrium", "superior vena cava"),
    ("right atrium", "inferior vena cava"),
}


def touching(labels):
    """Pairs of values that share a voxel face."""
    pairs = set()
    for axis in range(3):
        first = np.delete(labels, -1, axis).ravel().astype(int)
        second = np.delete(labels, 0, axis).ravel().astype(int)
        low, high = np.minimum(first, second), np.maximum(first, second)
        pairs |= {(int(code) // 256, int(code) % 256) for code in np.unique(low * 256 + high)}
    return {pair for pair in pairs if pair[0] != pair[1]}


def test_the_strokes_are_few_and_thin():
    recipe = load_recipe(RECIPE)
    assert max(Counter(stroke.label for stroke in recipe.strokes).values()) <= 10
    assert max(stroke.radius_mm for stroke in recipe.strokes) <= 2.0
    painted = rasterise_strokes(recipe.strokes, recipe.table, SCAN_GEOMETRY)
    assert np.mean(painted != Markers.UNMARKED) < 0.01
    assert set(np.unique(painted)) == {*recipe.table.values, Markers.UNMARKED}
    assert recipe.scan.origin


def test_four_chambers_that_meet_only_at_their_valves_and_the_pulmonary_artery_of_the_given_label():
    recipe = load_recipe(RECIPE)
    path = RECIPE.parent / recipe.scan.path
    if not path.exists():
        pytest.skip("the scan is not at hand; the recipe says where to get it")
    whole = dataclasses.replace(read_scan(path), modality=recipe.scan.modality)
    assert whole.geometry.matches(SCAN_GEOMETRY)
    scan = crop_scan(whole, recipe.region)
    markers = load_markers((), recipe.strokes, recipe.table, scan.geometry, RECIPE.parent)
    segmentation = segment_scan(filter_scan(scan, recipe.filter), markers, recipe.segment, recipe.table)
    assert segmentation_warnings(segmentation, markers, filtered=scan) == ()
    table = recipe.table
    blood = {pair for pair in touching(segmentation.labels) if set(pair) <= set(table.blood_values)}
    assert blood == {tuple(sorted((table[one].value, table[other].value))) for one, other in OPENINGS}

    label = path.with_name("pulmonary_artery.nii.gz")
    given = crop_scan(read_scan(label), recipe.region).values > 0.5
    found = segmentation.labels == table["pulmonary artery"].value
    # 0.88; the rest is where to end: the given label follows the branches 10 mm further into the lungs
    assert 2 * np.count_nonzero(found & given) / (np.count_nonzero(found) + np.count_nonzero(given)) > 0.86
