"""Mistakes that strangers made with the commands, and the one clear line that each gets."""

from __future__ import annotations

import json
import shutil

import pytest

from heartcase.cli.main import main
from heartcase.schemas.errors import RecipeError, ScriptError, SimulationError, UsageError
from heartcase.schemas.recipe.recipe import parse_recipe
from heartcase.simulator.instruments.grab import require_grab
from heartcase.simulator.load import load_case
from heartcase.simulator.session.script import parse_script
from tests.ball import write_ball_recipe, write_ball_scan
from tests.golden.make import CASE

HEAD = 'heartcase_recipe = 1\nname = "a"\n[scan]\npath = "s.nii.gz"\n'


@pytest.mark.parametrize("command", [
    "info {}", "validate {}", "validate {}.toml", "build {}.toml", "preview {} --out x.png", "simulate {}.case",
    "view {}.case", "export {}.case --out x.stl", "approve {}.case --role surgeon", "upgrade {}",
    "lock {}.toml --out x.toml", "new {}.nii.gz --out x.toml", "library build {}", "library check {}",
    "library draw {}.toml", "library catalogue {}", "library diff {} {}",
])  # fmt: skip
def test_where_nothing_is_every_command_ends_alike(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    assert main(command.replace("{}", "gone").split()) == 1
    said = capsys.readouterr()
    assert "there is no" in said.out + said.err or "there is nothing" in said.out + said.err


def test_a_wrong_name_in_many_strokes_is_one_line():
    stroke = '[[strokes]]\nlabel = "left ventrikel"\npoints_mm = [[0.0, 0.0, 0.0]]\n'
    with pytest.raises(RecipeError) as caught:
        parse_recipe(HEAD + 11 * stroke + stroke.replace("left ventrikel", "aortaa"))
    first, second = caught.value.problems
    assert first.place == "strokes[1, 2, 3 and 8 more]"
    assert "left ventrikel" in first.message
    assert second.place == "strokes[12]"


def test_a_name_of_many_labels_is_one_line_with_the_rows():
    label = '[[labels]]\nvalue = {}\nname = "{}"\nrole = "blood"\n'
    rows = [(9, "ed"), (3, "aorta"), *((value, "ED") for value in range(10, 18)), (3, "z")]
    landmark = '[[landmarks]]\nname = "apex"\nkind = "point"\npoints_mm = [[0.0, 0.0, 0.0]]\n'
    labels = "".join(label.format(*row) for row in rows)
    with pytest.raises(RecipeError) as caught:
        parse_recipe(HEAD + labels)
    assert [str(one) for one in caught.value.problems] == [
        "labels: value 3 is used by rows 2 and 11 ('aorta', 'z'): give each its own",
        "labels: the name 'ed' is used by rows 1, 3, 4, 5, 6, 7, 8, 9 and 10: give each its own",
    ]
    with pytest.raises(RecipeError) as caught:
        parse_recipe(HEAD + 3 * landmark)
    said = [str(one) for one in caught.value.problems if one.place == "landmarks"]
    assert said == ["landmarks: the name 'apex' is used by rows 1, 2 and 3: give each its own"]


def test_a_recipe_is_no_script():
    with pytest.raises(ScriptError, match="this is a recipe, not a script"):
        parse_script(HEAD)


def test_needs_that_are_a_text_are_told(tmp_path):
    with pytest.raises(UsageError, match=r"needs=\['surface'\]"):
        load_case(tmp_path / "any.case", needs="surface")


def test_what_is_no_hand_cannot_be_led():
    with pytest.raises(SimulationError, match="this is no grab but a int"):
        require_grab(99)


@pytest.mark.parametrize(("command", "place"), [
    ("library build lib --out file", "--out"), ("library build lib --out file/deep", "--out"),
    ("library build lib --cache file", "--cache"), ("library catalogue lib --to file", "--to"),
    ("schema --out file", "--out"), ("build lib/a.toml --cache file", "--cache"), ("phantom file", "OUT_DIR"),
    ("compare-incisions lib lib --pictures file", "--pictures"), ("simulate lib --templates file", "--templates"),
])  # fmt: skip
def test_a_file_in_the_place_of_a_folder_is_told_before_any_work(tmp_path, monkeypatch, capsys, command, place):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "a.toml").write_text(HEAD)
    (tmp_path / "file").write_text("mine")
    assert main(command.split()) == 2
    said = capsys.readouterr().err
    is_below = "file/deep" in command
    words = "a part of this path is a file: give a folder" if is_below else "this is a file: give the folder"
    assert said.startswith(f"heartcase: {place}: {words}")
    assert said.count("\n") == 1
    assert (tmp_path / "file").read_text() == "mine"


def test_library_build_tells_what_it_skips(tmp_path, capsys):
    (tmp_path / "a.toml").write_text(HEAD)
    (tmp_path / "b.toml").write_text(HEAD.replace("heartcase_recipe", "heartcase_recipi"))
    (tmp_path / "c.toml").write_text("")
    out = tmp_path / "out"
    assert main(["library", "build", str(tmp_path), "--out", str(out), "--json"]) == 1
    said = capsys.readouterr()
    assert json.loads(said.out)["skipped"] == ["b.toml", "c.toml"]
    assert "skipped: b.toml, c.toml (they have no heartcase_recipe = 1)\n" in said.err


def test_an_ending_alone_is_no_name(capsys):
    assert main(["export", "any.case", "--out", ".stl"]) == 2
    assert capsys.readouterr().err == (
        "heartcase: --out: is an ending alone: put a name before it, such as heart.stl\n"
    )


@pytest.mark.parametrize(("name", "words"), [
    ("d.tour.md", "tour: this is a folder: give the file"),
    ("d.toml", "PATH: this is a folder, and recipes and scripts are files: give the .toml file"),
    ("d", "case: this is not a case: it holds no case.json; for a scan, take info"),
    ("d.case", "case: this is not a case: it holds no case.json; for a scan, take info"),
    ("d.recording", "recording: this is not a recording: it holds no recording.json"),
    ("f.txt", "PATH: this file is neither a recipe nor a script (.toml) nor a tour (.tour.md): give one, or the folder "
     "of a case or of a recording; for a scan, take info"),
])  # fmt: skip
def test_validate_says_of_each_kind_of_path_what_fits(tmp_path, capsys, name, words):
    path = tmp_path / name
    path.write_text("x") if name == "f.txt" else path.mkdir()
    assert main(["validate", str(path)]) == 1
    assert capsys.readouterr().out == f"{words}\n1 problem found\n"


def test_a_file_of_a_case_that_is_a_link_is_told_as_one(tmp_path, capsys):
    case = shutil.copytree(CASE, tmp_path / "x.case")
    grid = next(case.glob("grid-*"))
    (tmp_path / "elsewhere").write_bytes(grid.read_bytes())
    grid.unlink()
    grid.symlink_to(tmp_path / "elsewhere")
    assert main(["validate", str(case)]) == 1
    said = capsys.readouterr().out
    assert f"files.grid: the file {grid.name} is a link: put the file itself in its place" in said
    assert "is missing" not in said


def test_a_build_into_a_file_and_one_that_is_interrupted(tmp_path, monkeypatch, capsys):
    write_ball_scan(tmp_path / "scan.nii.gz")
    recipe = write_ball_recipe(tmp_path / "scan.nii.gz", tmp_path / "ball.toml", cell_mm=5.0)
    assert main(["build", str(recipe), "--out", str(tmp_path / "scan.nii.gz")]) == 2
    assert "--out: this is a file: give the folder" in capsys.readouterr().err

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("heartcase.pipeline.building.run.build_case", stop)
    assert main(["build", str(recipe), "--out", str(tmp_path / "out")]) == 130
    said = capsys.readouterr().err
    assert "the next build goes on from the stages that are finished" in said
    assert said.count("interrupted") == 1


def test_a_preview_says_where_it_is(tmp_path, capsys):
    write_ball_scan(tmp_path / "scan.nii.gz")
    out = tmp_path / "p.png"
    assert main(["preview", str(tmp_path / "scan.nii.gz"), "--out", str(out)]) == 0
    assert f"wrote {out}: a picture of" in capsys.readouterr().out
