import json
import re
import tomllib
from pathlib import Path

import pytest

from heartcase.pipeline.building.starter_recipe import starter_recipe
from heartcase.schemas.errors import RecipeError
from heartcase.schemas.published.json_schemas import schema_files
from heartcase.schemas.recipe.recipe import Recipe, load_recipe, parse_recipe

MINIMAL = """
heartcase_recipe = 1
name = "a"
scan.path = "scan.nii.gz"
[[strokes]]
label = "aorta"
points_mm = [[0, 0, 0]]
"""
ROOT = Path(__file__).parents[2]


def places(error):
    return {problem.place for problem in error.value.problems}


def test_defaults_are_filled_in():
    recipe = parse_recipe(MINIMAL)
    assert recipe.surface.triangle_count == 80_000
    assert recipe.table["aorta"].wall_thickness_mm == 2.0


def test_every_problem_is_reported_at_once_with_its_place():
    with pytest.raises(RecipeError) as error:
        parse_recipe(
            MINIMAL
            + """
[[strokes]]
label = "aorta"
points_mm = [[0, 0]]
[filter]
iterations = -1
speed = 3
[grid]
cell_mm = 2.0
node_count = 100
"""
        )
    assert places(error) == {"strokes[2].points_mm[1][3]", "filter.iterations", "filter.speed", "grid"}


def test_names_that_no_label_has_are_all_reported():
    with pytest.raises(RecipeError) as error:
        parse_recipe(
            MINIMAL
            + """
[[strokes]]
label = "aorto"
points_mm = [[0, 0, 0]]
[[ends]]
label = "vena"
position_mm = [0, 0, 0]
axis = [0, 0, 1]
radius_mm = 3
[materials.labels.bone]
youngs_modulus_kpa = 3
[[edits]]
kind = "septal_defect"
position_mm = [0, 0, 0]
diameter_mm = 3
axis = [0, 0, 0]
"""
        )
    assert places(error) == {"strokes[2]", "ends[1]", "materials.labels", "edits[1].axis"}


def test_an_edit_takes_from_and_gives_to_another_label_than_its_own():
    line = "radius_mm = 2\npoints_mm = [[0, 0, 0]]\n"
    add = f'{MINIMAL}\n[[edits]]\nkind = "add"\nlabel = "aorta"\n{line}'
    parse_recipe(f'{add}only_from = ["left ventricle"]\n')
    with pytest.raises(RecipeError) as error:
        parse_recipe(
            f'{add}only_from = ["left ventricle", "Aorta"]\n'
            '[[edits]]\nkind = "keep_largest"\nlabel = "aorta"\ninto = "aorta"\n'
        )
    assert places(error) == {"edits[1].only_from", "edits[2].into"}
    with pytest.raises(RecipeError) as error:
        parse_recipe(f"{add}only_from = []\n")
    assert places(error) == {"edits[1].only_from"}


def test_a_watershed_without_markers_is_refused():
    with pytest.raises(RecipeError, match="needs markers"):
        parse_recipe('heartcase_recipe = 1\nname = "a"\nscan.path = "s"')


@pytest.mark.parametrize("text", ["a = ", "heartcase_recipe = 2\nname='a'\nscan.path='s'", "[]", "name = '../x'"])
def test_broken_recipes_raise_a_recipe_error(text):
    with pytest.raises(RecipeError):
        parse_recipe(text)


def test_a_missing_or_binary_file_is_refused_in_one_line(tmp_path):
    with pytest.raises(RecipeError, match="no such file"):
        load_recipe(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RecipeError, match="UTF-8"):
        load_recipe(tmp_path / "binary.toml")


@pytest.mark.parametrize("name", ["jane.nii.gz", "jane.NRRD", "jane.mhd", "jane.dcm", "IM0001"])
def test_a_scan_in_place_of_a_recipe_is_told_to_be_one(tmp_path, name):
    content = b"\x00" * 128 + b"DICM" if name == "IM0001" else b"NDims = 3\n"
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecipeError, match=r"looks like a scan, not a recipe.*heartcase new SCAN") as error:
        load_recipe(tmp_path / name)
    assert "jane" not in str(error.value)
    with pytest.raises(RecipeError, match="no such file"):
        load_recipe(tmp_path / "none.nii.gz")


def test_a_folder_in_place_of_a_recipe_is_told_to_be_one(tmp_path):
    with pytest.raises(RecipeError, match="this is a folder, not a recipe"):
        load_recipe(tmp_path)


@pytest.mark.parametrize("value", ['"no"', '"true"', "1", "0"])
@pytest.mark.parametrize(
    ("place", "text"),
    [
        ("grid.repair", "[grid]\nrepair = {}\n"),
        ("scan.straighten_tilt", "[scan]\npath = 's'\nstraighten_tilt = {}\n"),
        ("edits[1].enabled", "[[edits]]\nkind = 'keep_largest'\nlabel = 'aorta'\nenabled = {}\n"),
        ("markers[1].background", "[[markers]]\npath = 'm'\ncore_mm = 3\nbackground = {}\n"),
        ("strokes[2].erase", "[[strokes]]\npoints_mm = [[0, 0, 0]]\nerase = {}\n"),
    ],
)
def test_true_and_false_are_written_without_quotes(place, text, value):
    text = MINIMAL.replace('scan.path = "scan.nii.gz"', "" if "scan" in place else "scan.path = 's'") + text
    with pytest.raises(RecipeError) as error:
        parse_recipe(text.format(value))
    (problem,) = error.value.problems
    assert problem.place == place
    assert problem.message.startswith("must be true or false, without quotes (found ")
    parse_recipe(text.format("true"))


UNITS = """
heartcase_recipe = 1
name = "x"
scan.path = "scan.nii.gz"
segment.method = "labels"
segment.file = "labels.nii.gz"
labels = [
  {{ value = 1, name = "left ventricle", role = "blood", wall_thickness_mm = {wall} }},
  {{ value = 2, name = "stent", role = "device" }},
]
[materials]
youngs_modulus_kpa = {modulus}
density_kg_m3 = {density}
[materials.labels.stent]
youngs_modulus_kpa = {stent}
density_kg_m3 = {steel}
"""
SOUND = {"wall": 2.0, "modulus": 30.0, "density": 1060.0, "stent": 3e5, "steel": 7900.0}


@pytest.mark.parametrize(
    ("slip", "place", "message"),
    [
        (
            {"modulus": 30000},
            "materials.youngs_modulus_kpa",
            "30000 kPa is stiffer than any soft tissue (0.1 to 5000 kPa): was Pa meant? then write 30",
        ),
        ({"modulus": 0.03}, "materials.youngs_modulus_kpa", "was MPa meant? then write 30"),
        ({"density": 1.06}, "materials.density_kg_m3", "was g/cm3 meant? then write 1060"),
        ({"density": 5000}, "materials.density_kg_m3", "check the number and its unit"),
        ({"stent": 0.01}, "materials.labels.stent.youngs_modulus_kpa", "was MPa meant? then write 10"),
        ({"steel": 7.9}, "materials.labels.stent.density_kg_m3", "was g/cm3 meant? then write 7900"),
        ({"wall": 0.0025}, "labels[1].wall_thickness_mm", "was m meant? then write 2.5"),
        ({"wall": 0.05}, "labels[1].wall_thickness_mm", "was cm meant? then write 0.5"),
        ({"wall": 25}, "labels[1].wall_thickness_mm", "25 mm is thicker than any wall (0.1 to 15 mm)"),
    ],
)
def test_a_number_in_another_unit_is_refused_and_the_right_one_named(slip, place, message):
    with pytest.raises(RecipeError) as caught:
        parse_recipe(UNITS.format(**SOUND | slip))
    (problem,) = caught.value.problems
    assert problem.place == place
    assert message in problem.message


@pytest.mark.parametrize(
    "numbers",
    [
        {},
        {"wall": 0},
        {"wall": 0.1},
        {"wall": 15},
        {"modulus": 0.1},
        {"modulus": 5000},
        {"density": 500},
        {"density": 3000},
    ],
)
def test_numbers_that_a_heart_or_a_device_may_have_are_sound(numbers):
    assert parse_recipe(UNITS.format(**SOUND | numbers)).name == "x"


def test_a_table_of_thicknesses_in_metres_is_refused_once_for_each_number():
    table = """
[[walls.thickness]]
label = "left ventricle"
kind = "positions"
points_mm = [[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]]
thickness_mm = [0.002, 0.0]
"""
    with pytest.raises(RecipeError) as caught:
        parse_recipe(UNITS.format(**SOUND) + table)
    (problem,) = caught.value.problems
    assert problem.place == "walls.thickness[1].thickness_mm"
    assert "was m meant? then write 2" in problem.message


def test_numbers_are_read_as_before():
    recipe = parse_recipe(MINIMAL + "[grid]\ncell_mm = 2\nrepair = false\n[filter]\niterations = 3.0\n")
    assert (recipe.grid.cell_mm, recipe.grid.repair, recipe.filter.iterations) == (2.0, False, 3)
    assert isinstance(recipe.grid.cell_mm, float)
    assert Recipe.model_validate_json(recipe.model_dump_json()) == recipe


def test_what_kind_an_edit_is_of_is_told_in_plain_words():
    with pytest.raises(RecipeError) as error:
        parse_recipe(MINIMAL + "[[edits]]\nkind = 'hole'\n[[edits]]\nlabel = 'aorta'\n[[edits]]\nkind = 5\n")
    kinds = "'septal_defect', 'close_defect', 'add', 'remove', 'smooth', 'fill', 'keep_largest' or 'remove_islands'"
    assert [str(problem) for problem in error.value.problems] == [
        f"edits[1].kind: must be {kinds} (found 'hole')",
        "edits[2].kind: is missing: add it",
        f"edits[3].kind: must be {kinds} (found 5)",
    ]
    with pytest.raises(RecipeError) as error:
        parse_recipe(MINIMAL.replace("[[0, 0, 0]]", "5") + "[materials]\nlabels = 5\n[grid]\nrepair = []\n")
    assert {problem.place: problem.message for problem in error.value.problems} == {
        "strokes[1].points_mm": "must be a list in [brackets] (found 5)",
        "materials.labels": "must be a table of names with values (found 5)",
        "grid.repair": "must be true or false, without quotes",
    }


def uncommented(text):
    """A recipe with every setting that is shown as a comment; of two for one key the first."""
    lines, key = [], ""
    for line in text.splitlines():
        found = re.match(r"# (\[+[\w.]+\]+|(\w+) = .*)", line)
        if found and found.group(2) and found.group(2) == key:
            continue
        key = (found and found.group(2)) or ""
        lines.append(line.removeprefix("# ") if found else line)
    return "\n".join(lines)


@pytest.mark.parametrize("modality", ["CT", "unknown"])
def test_what_the_starter_recipe_shows_as_comments_is_valid_too(modality):
    text = starter_recipe(
        name="first",
        scan_path="scan.nii",
        choice={},
        center_mm=(1.0, 2.0, 3.0),
        extent_mm=(300.0, 300.0, 100.0),
        modality=modality,
    )
    assert "heartcase paint THIS_FILE" in text
    assert "heartcase suggest THIS_FILE" in text
    assert max(len(line) for line in text.splitlines()) <= 120
    recipe = parse_recipe(uncommented(text))
    assert recipe.segment.automatic == ("background", "lung")
    assert [(file.core_mm, file.background) for file in recipe.markers] == [(None, False), (3.0, True)]
    assert recipe.markers[1].convention == "totalsegmentator-heartchambers"
    assert [stroke.erase for stroke in recipe.strokes] == [False, False, True]
    assert [one.label for one in recipe.walls.thickness] == ["aorta"]
    assert (recipe.filter.conductance, len(recipe.ends), len(recipe.edits), len(recipe.pins)) == (1.0, 1, 1, 1)
    assert [mark.name for mark in recipe.landmarks] == ["apex", "mitral valve"]
    assert recipe.region is not None


def test_the_starter_recipe_is_valid_and_lists_every_label():
    text = starter_recipe(
        name="first case",
        scan_path='folder "a"\\scan',
        choice={"series": "2", "trigger_time_ms": 312.5, "straighten_tilt": True},
        center_mm=(1.0, 2.0, 3.0),
        extent_mm=(300.0, 300.0, 100.0),
        modality="MR",
    )
    recipe = parse_recipe(text)
    assert recipe.scan.path == 'folder "a"\\scan'
    assert recipe.scan.choice == {"series": "2", "trigger_time_ms": 312.5, "straighten_tilt": True}
    assert len(recipe.table) == 10


def test_all_sample_recipes_are_valid():
    samples = [path for path in (ROOT / "sample_cases").glob("*.toml") if "heartcase_recipe" in path.read_text()]
    assert len(samples) >= 3
    for path in samples:
        recipe = load_recipe(path)
        assert isinstance(recipe, Recipe)
        # The Makefile and the README name the cases so.
        assert recipe.name == path.stem.replace("_", "-")


def test_the_schemas_in_docs_are_current():
    for name, text in schema_files().items():
        assert (ROOT / "docs" / "schemas" / name).read_text() == text, (
            f"run: heartcase schema --out docs/schemas ({name})"
        )
        assert name.endswith(".md") or json.loads(text)


def test_a_recipe_round_trips_through_json():
    recipe = parse_recipe(MINIMAL)
    assert Recipe.model_validate_json(recipe.model_dump_json()) == recipe
    assert tomllib.loads(MINIMAL)["name"] == recipe.name


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[grid]\ncell_size_mm = 3\n", "grid.cell_size_mm: unknown setting: did you mean 'cell_mm'?"),
        ("[materials]\nyoungs_modulus_pa = 3e4\n", "did you mean 'youngs_modulus_kpa'?"),
        (
            '[[labels]]\nvalue = 0\nname = "background"\nrole = "background"\nwall_thickness_cm = 1\n',
            "labels[1].wall_thickness_cm: unknown setting: did you mean 'wall_thickness_mm'?",
        ),
        # An edit has only the settings of its kind.
        (
            '[[edits]]\nkind = "septal_defect"\nposition_mm = [0, 0, 0]\ndiametre_mm = 3\n',
            "did you mean 'diameter_mm'?",
        ),
        ("sculpture = 1\n", "sculpture: unknown setting: check its spelling, or remove it"),
    ],
)
def test_an_unknown_setting_is_told_with_the_nearest_one(text, said):
    text = MINIMAL.replace("[[strokes]]", f"{text}[[strokes]]", 1)
    with pytest.raises(RecipeError) as caught:
        parse_recipe(text)
    assert any(said in str(problem) for problem in caught.value.problems), caught.value


def test_a_wrong_setting_does_not_hide_an_unknown_label():
    text = MINIMAL.replace("heartcase_recipe = 1", "heartcase_recipe = 1\ncolour = 3") + (
        '[[strokes]]\nlabel = "left ventrikel"\npoints_mm = [[0, 0, 0]]\n[grid]\ncell_mm = -1\n'
    )
    with pytest.raises(RecipeError) as caught:
        parse_recipe(text)
    said = "\n".join(map(str, caught.value.problems))
    assert "colour: unknown setting" in said
    assert "grid.cell_mm: must be above 0" in said
    assert "there is no label 'left ventrikel'; did you mean 'morphologically left ventricle'?" in said


AUTOMATIC = """
heartcase_recipe = 1
name = "case"
scan = { path = "scan.nii.gz" }
strokes = [{ label = "aorta", points_mm = [[0, 0, 0]] }]
"""


def test_ends_may_be_the_text_automatic_which_stands_for_a_setting_of_the_walls():
    recipe = parse_recipe(f'ends = "automatic"\n{AUTOMATIC}')
    assert recipe.ends == ()
    assert recipe.walls.find_ends
    assert recipe == parse_recipe(f"ends = []\nwalls = {{ find_ends = true }}\n{AUTOMATIC}")
    assert parse_recipe(f'ends = "automatic"\nwalls = {{ find_ends = true }}\n{AUTOMATIC}') == recipe
    assert not parse_recipe(AUTOMATIC).walls.find_ends


@pytest.mark.parametrize(
    ("lines", "place", "said"),
    [
        ('ends = "auto"', "ends", "[[ends]]"),
        ('ends = "automatic"\nwalls = { find_ends = false }', "walls.find_ends", "remove one of them"),
        ('ends = "automatic"\nwalls = 3', "walls", "table"),
    ],
)
def test_another_text_or_a_contradiction_is_refused(lines, place, said):
    with pytest.raises(RecipeError) as caught:
        parse_recipe(f"{lines}\n{AUTOMATIC}")
    (problem,) = caught.value.problems
    assert problem.place == place
    assert said in problem.message
