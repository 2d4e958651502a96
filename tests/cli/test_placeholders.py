"""The example strokes of a starter recipe are known again by where they lie, and refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from heartcase.cli.main import main
from heartcase.pipeline.building.session_file import open_session
from heartcase.pipeline.markers.placeholders import StarterPlaces, example_strokes, placeholder_problems
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import Recipe, load_recipe
from heartcase.schemas.recipe.settings import Stroke
from tests.ball import write_ball_scan

GEOMETRY = Geometry.of(shape=(32, 32, 32), spacing_mm=(2, 2, 2), origin_mm=(-31, -31, -31))
VENTRICLE, BACKGROUND = "points_mm = [[0.0, 0.0, 0.0]]", "points_mm = [[-28.8, 0.0, 0.0]]"
MOVED = {VENTRICLE: "points_mm = [[3.5, 1.0, -2.0]]", BACKGROUND: "points_mm = [[-28.8, -27.0, 4.0]]"}


@pytest.fixture
def starter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    write_ball_scan(tmp_path / "scan.nii.gz")
    recipe = tmp_path / "case.toml"
    assert main(["new", str(tmp_path / "scan.nii.gz"), "--out", str(recipe), "--name", "first"]) == 0
    assert "example" in capsys.readouterr().out
    return recipe


def change(recipe: Path, *changes: tuple[str, str]) -> None:
    text = recipe.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    recipe.write_text(text)


def test_a_fresh_starter_recipe_is_refused_by_validate_and_build(starter: Path, capsys) -> None:
    assert main(["validate", str(starter)]) == 1
    said = capsys.readouterr().out
    for number in (1, 2):
        assert f"strokes[{number}]: this is still the example that the starter recipe came with" in said
    assert "put points of your own in its place, or take the stroke out" in said
    for command in (
        ("build", starter, "--out", starter.parent / "out"),
        ("segment", starter.parent / "scan.nii.gz", starter.parent / "l.safetensors", "--recipe", starter),
    ):
        assert main([str(part) for part in command]) == 1
        assert "strokes[1]: this is still the example" in capsys.readouterr().err
    assert not (starter.parent / "out" / "first.case").exists()


def test_the_examples_come_first_and_what_follows_from_them_is_not_said(starter: Path, capsys) -> None:
    """A fresh starter marks no muscle either, and "nothing is marked as tissue" is not what to mend first."""
    assert main(["validate", str(starter)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines[:2]] == ["strokes[1]", "strokes[2]"]
    assert lines[-1] == "2 problems found"
    assert all(line.startswith("warning: scan.modality") for line in lines[2:-1])
    change(starter, *MOVED.items(), ('label = "left ventricle"\nradius', 'label = "background"\nradius'))
    assert main(["validate", str(starter)]) == 1
    assert "tissue" in capsys.readouterr().out


@pytest.mark.parametrize(("moved", "left"), [(VENTRICLE, 2), (BACKGROUND, 1)])
def test_one_that_is_left_is_refused_although_the_other_was_moved(starter: Path, capsys, moved: str, left: int) -> None:
    change(starter, (moved, MOVED[moved]), ("# an example", "#"), ('label = "left ventricle"', 'label = "LA"'))
    change(starter, ("radius_mm = 2.0\npoints_mm", "radius_mm = 3.5\npoints_mm"))
    assert main(["validate", str(starter)]) == 1
    said = capsys.readouterr().out
    assert f"strokes[{left}]: this is still the example" in said
    assert f"strokes[{3 - left}]" not in said


def test_moved_strokes_are_strokes(starter: Path, capsys) -> None:
    change(starter, *MOVED.items(), ('label = "left ventricle"\nradius', 'label = "aorta"\nradius'))
    assert main(["validate", str(starter)]) == 0
    first, *others, last = capsys.readouterr().out.splitlines()
    assert first.startswith("warning: scan.modality: whether it is a CT or an MR is stated neither by")
    assert (others, last) == ([], "sound")
    change(starter, ("# modality = ", "modality = "))
    assert main(["validate", str(starter)]) == 0
    assert capsys.readouterr().out == "sound\n"


def test_examples_that_were_taken_out_of_their_comments_are_refused_too(starter: Path) -> None:
    change(starter, *MOVED.items())
    lines = starter.read_text().split("\n")
    begin = lines.index("# [[ends]]")
    lines[begin : begin + 5] = [line.removeprefix("# ") for line in lines[begin : begin + 5]]
    starter.write_text("\n".join(lines))
    (problem,) = placeholder_problems(load_recipe(starter), GEOMETRY)
    assert problem.place == "ends[1]"
    assert "at the very middle of the scan" in problem.message


def test_a_pair_is_known_without_its_scan_also_in_a_recipe_for_another(starter: Path, capsys) -> None:
    (starter.parent / "scan.nii.gz").unlink()
    assert main(["validate", str(starter)]) == 1
    assert "strokes[2]: this is still the example" in capsys.readouterr().out
    other = Geometry.of(shape=(40, 50, 60), spacing_mm=(1, 1, 1), origin_mm=(3, 4, 5))
    assert example_strokes(load_recipe(starter).strokes, other) == (1, 2)


def test_painting_goes_over_the_examples_and_they_mark_nothing(starter: Path) -> None:
    opened = open_session(starter, out=starter.parent / "out")
    assert (opened.session.markers().labels == 255).all()


def test_strokes_that_people_paint_are_no_examples() -> None:
    places = StarterPlaces.of(GEOMETRY)
    assert places.center_mm == (0.0, 0.0, 0.0)
    near = Stroke(label="LV", radius_mm=2.0, points_mm=((0.1, 0.0, 0.0),))
    line = Stroke(label="LV", radius_mm=2.0, points_mm=(places.center_mm, (4.0, 0.0, 0.0)))
    beside = Stroke(label="background", radius_mm=2.0, points_mm=((-20.0, 0.1, 0.0),))
    assert example_strokes((near, line, beside), GEOMETRY) == ()


def test_the_sample_recipes_hold_none() -> None:
    for path in sorted((Path(__file__).parents[2] / "sample_cases").glob("*.toml")):
        if "heartcase_recipe" in path.read_text():
            recipe = load_recipe(path)
            assert isinstance(recipe, Recipe)
            assert placeholder_problems(recipe) == ()
