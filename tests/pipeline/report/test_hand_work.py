"""What was done by hand is told whole, and without a name of a file or from a file."""

import re
from dataclasses import replace

import pytest

from heartcase.pipeline.report.hand_work import hand_work_facts
from heartcase.pipeline.stages.resolve import resolve_recipe
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.recipe.recipe import parse_recipe
from tests.pipeline.report.analytic_heart import make_heart

HEAD = 'heartcase_recipe = 1\nname = "x"\n[scan]\npath = "a.nrrd"\n'
THRESHOLD = '[segment]\nmethod = "threshold"\n[[segment.ranges]]\nlabel = "aorta"\nlower = 5\n'
RICH = """
heartcase_recipe = 1
name = "x"
[scan]
path = "private/Qwertz.dcm"
series = "Qwertz.123"
origin = "Qwertz"
trigger_time_ms = 640
echo_time_ms = 2.5
modality = "MR"
[region]
center_mm = [1, 2, 3]
size_mm = [100, 90, 80]
[filter]
iterations = 9
[segment]
method = "labels"
file = "private/Qwertz.nrrd"
[segment.names]
Qwertz = "aorta"
[[edits]]
kind = "add"
label = "aorta"
radius_mm = 2
points_mm = [[1, 2, 3], [4, 5, 6]]
[[edits]]
kind = "close_defect"
position_mm = [5, -15, -10]
diameter_mm = 8
axis = [1, 0, 0]
[[edits]]
kind = "septal_defect"
name = "second one"
enabled = false
position_mm = [5, -15, -10]
shape = "slit"
diameter_mm = 8
width_mm = 3
axis = [1, 0, 0]
long_axis = [0, 0, 1]
[[edits]]
kind = "remove_islands"
[[ends]]
label = "aorta"
position_mm = [1, 2, 60]
axis = [0, 0, 1]
radius_mm = 9
[[pins]]
position_mm = [0, 0, 60]
radius_mm = 6
[grid]
cell_mm = 2.5
[materials]
youngs_modulus_kpa = 12
[materials.labels.aorta]
youngs_modulus_kpa = 200
[[landmarks]]
name = "apex"
kind = "point"
points_mm = [[1, 2, 3]]
"""


def told(text: str, scan=None) -> dict[str, str]:
    return {fact.name: fact.value for fact in hand_work_facts(parse_recipe(text), scan)}


@pytest.fixture(scope="module")
def scan():
    return make_heart(spacing_mm=(8.0, 8.0, 8.0)).scan


def test_everything_that_a_person_did_is_told(scan):
    mended = replace(scan, warnings=(CaseWarning("2 missing slices were filled in from their neighbours"),))
    facts = told(RICH, mended)
    assert facts["Series of the scan"] == "chosen by hand"
    assert facts["Cardiac phase"] == "the one nearest to 640 ms after the R wave was chosen"
    assert facts["Echo"] == "the one nearest to 2.5 ms was chosen"
    assert facts["Kind of scan"] == "MRI, as the recipe says"
    assert facts["Scan changed before use"] == "2 missing slices were filled in from their neighbours"
    assert facts["Region of interest"] == "a box of 100 x 90 x 80 mm around L 1.0 P 2.0 H 3.0 mm"
    assert facts["Segmentation"] == "taken as it was given"
    assert facts["Edit 1"] == "added to aorta: brush of 2 mm radius, 2 points from L 1.0 P 2.0 H 3.0 mm"
    assert facts["Edit 2"] == "defect closed with a patch of 8 mm at L 5.0 A 15.0 F 10.0 mm"
    slit = "septal defect of 8 x 3 mm (slit) made at L 5.0 A 15.0 F 10.0 mm"
    assert facts["Edit 3"] == f"second one: {slit} (switched off: not carried out)"
    assert facts["Edit 4"] == "pieces of all structures below 0.1 ml removed"
    assert facts["Vessel cut off"] == "aorta at L 1.0 P 2.0 H 60.0 mm"
    assert facts["Held fixed by hand"] == "ball of 6 mm radius at L 0.0 P 0.0 H 60.0 mm"
    assert facts["Setting for smoothing the scan"] == "iterations = 9"
    assert facts["Setting for dividing the tissue into cells"] == "cell = 2.5 mm"
    assert facts["Material: all tissue"] == "12 kPa, 1060 kg/m³"
    assert facts["Material: aorta"] == "200 kPa, 1060 kg/m³"
    assert facts["Landmark"] == "apex (point)"


def test_no_name_of_a_file_or_from_a_file_is_told(scan):
    text = " ".join(f"{fact.name} {fact.value} {fact.meaning}" for fact in hand_work_facts(parse_recipe(RICH), scan))
    for private in ("Qwertz", "private", ".dcm", ".nrrd", "/", "123"):
        assert private not in re.sub(r"kg/m³", "", text)


def test_what_the_program_chose_is_no_hand_work(scan):
    recipe = parse_recipe(HEAD + THRESHOLD)
    resolved = resolve_recipe(recipe, scan)
    assert resolved.model_dump() != recipe.model_dump()
    names = [fact.name for fact in hand_work_facts(resolved, scan)]
    assert names == ["Found by brightness: aorta"]
    changed = resolve_recipe(parse_recipe(HEAD + THRESHOLD + "[walls]\nsmoothing_mm = 0.25\n"), scan)
    facts = {fact.name: fact for fact in hand_work_facts(changed, scan)}
    setting = facts["Setting for walls and outlines"]
    assert setting.value == "smoothing = 0.25 mm"
    assert re.fullmatch(r"Instead of [\d.]+ mm\.", setting.meaning)


@pytest.mark.parametrize(
    ("limits", "words"),
    [("lower = 5", "from 5"), ("upper = -2.5", "up to -2.5"), ("lower = 0\nupper = 9", "from 0 to 9")],
)
def test_brightness_ranges_are_told(limits, words):
    text = HEAD + THRESHOLD.replace("lower = 5", limits)
    assert told(text)["Found by brightness: aorta"] == words


def test_a_wall_of_another_thickness_than_usual_is_told():
    label = '[[labels]]\nvalue = 5\nname = "{}"\nrole = "vessel_lumen"\nwall_thickness_mm = {}\n{}'
    thin = label.format("aorta", 1.25, 'snomed = "15825003"\n')
    odd = label.format("conduit", 1.0, "").replace("value = 5", "value = 6")
    facts = told(HEAD + thin + odd + THRESHOLD)
    assert facts["Wall thickness: aorta"] == "1.25 mm"
    assert facts["Wall thickness: conduit"] == "1 mm"
    usual = label.format("aorta", 2.0, 'snomed = "15825003"\n')
    assert "Wall thickness: aorta" not in told(HEAD + usual + THRESHOLD)


def test_drafts_and_what_the_program_marked_are_told():
    text = (
        HEAD
        + '[segment]\nautomatic = ["lung", "background"]\n[[markers]]\npath = "Qwertz.nrrd"\ncore_mm = 2.5\n'
        + '[[markers]]\npath = "b.nrrd"\n'
    )
    facts = {fact.name: fact.value for fact in hand_work_facts(parse_recipe(text))}
    assert facts["Marker files"] == "2"
    assert facts["Drafts among them"] == "1, of which only what lies 2.5 mm deep counts"
    assert facts["Markers set by the program"] == "background and lung"
    assert not any("automatic" in value for value in facts.values())
    plain = {fact.name for fact in hand_work_facts(parse_recipe(text.replace("automatic", "# automatic")))}
    assert "Markers set by the program" not in plain


@pytest.mark.parametrize(
    ("points", "numbers", "words"),
    [
        ("[[1, 2, 3]]", "[2.0]", "2 mm"),
        ("[[1, 2, 3], [1, 2, 9]]", "[1.5, 1.5]", "1.5 mm"),
        ("[[1, 2, 3], [1, 2, 9]]", "[1.5, 3]", "1.5 to 3 mm, by place"),
    ],
)
def test_a_wall_that_varies_is_told_by_its_range(points, numbers, words):
    table = (
        f'[[walls.thickness]]\nlabel = "aorta"\nkind = "positions"\npoints_mm = {points}\nthickness_mm = {numbers}\n'
    )
    assert told(HEAD + THRESHOLD + table)["Wall thickness: aorta"] == words


def test_pairs_that_are_connected_or_kept_apart_are_told_by_name():
    text = """
heartcase_recipe = 1
name = "pairs"
[scan]
path = "scan.nii.gz"
[walls]
connected = [["right atrium", "left atrium"]]
[[walls.septum]]
between = ["aorta", "left atrium"]
thickness_mm = 1.5
[[strokes]]
label = "aorta"
points_mm = [[0, 0, 0]]
"""
    told = {fact.name: fact.value for fact in hand_work_facts(parse_recipe(text))}
    assert told["Open to each other: right atrium and left atrium"] == "no wall is grown between them"
    assert told["Kept apart: aorta and left atrium"] == "1.5 mm"
