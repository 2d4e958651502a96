"""The recipe of the real scan: its limits always, its result where the scan is at hand."""

import dataclasses
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from heartcase.pipeline.bundle.assembly import labels_of
from heartcase.pipeline.checks.openings import Verdict, find_openings
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.image.region import crop_scan
from heartcase.pipeline.markers.load_markers import load_markers, rasterise_strokes
from heartcase.pipeline.vessel_ends.cut_ends import cut_ends
from heartcase.pipeline.vessel_ends.discs import Stumps
from heartcase.pipeline.vessel_ends.find_ends import find_ends
from heartcase.pipeline.walls.grow_walls import grow_walls, resolve_walls
from heartcase.pipeline.walls.septa import open_places
from heartcase.pipeline.watershed.segment_scan import segment_scan, segmentation_warnings
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import load_recipe

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
    assert np.mean(painted != UNMARKED) < 0.01
    assert set(np.unique(painted)) == {*recipe.table.values, UNMARKED}
    assert recipe.scan.origin


def test_the_quick_strokes_are_at_most_six_a_label():
    recipe = load_recipe(RECIPE.with_name("chest_ct_few_strokes.toml"))
    assert max(Counter(stroke.label for stroke in recipe.strokes).values()) <= 6
    assert max(stroke.radius_mm for stroke in recipe.strokes) <= 3.0
    assert not recipe.ends
    assert recipe.walls_to_grow.find_ends


def test_no_septum_is_open_with_the_quick_strokes():
    """Atria, great arteries and cavae touch in the scan, and are apart in the model."""
    recipe = load_recipe(RECIPE.with_name("chest_ct_few_strokes.toml"))
    path = RECIPE.parent / recipe.scan.path
    if not path.exists():
        pytest.skip("the scan is not at hand; the recipe says where to get it")
    scan = crop_scan(read_scan(path), recipe.region)
    markers = load_markers((), recipe.strokes, recipe.table, scan.geometry, RECIPE.parent)
    segmentation = segment_scan(filter_scan(scan, recipe.filter), markers, recipe.segment, recipe.table)
    opened = open_places(recipe.strokes, recipe.landmarks, recipe.table)
    bare = grow_walls(segmentation, recipe.walls_to_grow.model_copy(update={"septa": "as segmented"}), ())
    grown = grow_walls(segmentation, recipe.walls_to_grow, (), open_places=opened)

    def wrong(structures):
        found = find_openings(structures, labels_of(structures), (), recipe.landmarks, strokes=recipe.strokes)
        return {one.names: one.area_mm2 for one in found if one.verdict is Verdict.UNEXPECTED}

    assert len(wrong(bare)) >= 6
    assert wrong(grown) == {}


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


RECIPES = sorted(RECIPE.parent.glob("chest*.toml"))
VEIN_COUNTS = {"chest_ct": 1, "chest_ct_few_strokes": 4}
"""Veins that are found at least, where the strokes leave more than a rim of them: in the first one lines of background
cut all but one off at the atrium."""


@pytest.mark.parametrize("path", RECIPES, ids=[path.stem for path in RECIPES])
@pytest.mark.parametrize("has_floor", [True, False], ids=["defaults of a CT", "no floor"])
def test_the_ends_of_the_great_vessels_are_found_without_a_number(path, has_floor):
    """With the defaults background takes the large branch to the left lower lobe; smaller ones are found there."""
    recipe = load_recipe(path)
    if not (path.parent / recipe.scan.path).exists():
        pytest.skip("the scan is not at hand; the recipe says where to get it")
    scan = crop_scan(read_scan(path.parent / recipe.scan.path), recipe.region)
    settings, branch_mm = recipe.segment.model_copy(update={"noise_floor": 0.0}), 3.5
    if has_floor:
        # the file does not say what it is
        scan = dataclasses.replace(scan, modality=recipe.scan.modality)
        settings, branch_mm = recipe.segment, 2.5
    automatic = sorted({*recipe.segment.automatic})
    markers = load_markers(
        recipe.markers, recipe.strokes, recipe.table, scan.geometry, path.parent, scan=scan, automatic=automatic
    )
    segmentation = segment_scan(filter_scan(scan, recipe.filter), markers, settings, recipe.table)
    table = recipe.table.with_walls()
    stumps = Stumps.of(resolve_walls(recipe.walls, scan.geometry, table), table, scan.geometry.spacing_mm)
    found = find_ends(segmentation, table, stumps).ends

    def ends_of(name):
        return [end for end in found if end.label == table[name].name]

    # by LPS axes: the aorta and the upper vein leave upwards through the region's face, the lower one downwards
    assert [end.is_open and end.axis[2] > 0.9 for end in ends_of("aorta")] == [True]
    assert [end.is_open and end.axis[2] > 0.9 for end in ends_of("superior vena cava")] == [True]
    (inferior,) = ends_of("inferior vena cava")
    assert inferior.axis[2] < -0.5
    sides = [np.sign(end.position_mm[0]) for end in ends_of("pulmonary artery") if end.lumen_radius_mm > branch_mm]
    assert {*sides} == {-1.0, 1.0}
    assert len(ends_of("left atrium")) >= VEIN_COUNTS[path.stem]
    assert ends_of("right atrium") == []
    # all of them cut
    cut = cut_ends(segmentation, table, (), stumps, find=True)
    assert len(cut.reshapings) == sum(not end.is_open for end in found)
