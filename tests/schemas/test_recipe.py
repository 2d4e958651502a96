import json
import tomllib
from pathlib import Path

import pytest

from heartcase.cli.new import starter_recipe
from heartcase.schemas.errors import RecipeError
from heartcase.schemas.export import schema_files
from heartcase.schemas.recipe import Recipe, load_recipe, parse_recipe

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
