"""Mistakes that strangers made with the commands, and the one clear line that each gets."""

from __future__ import annotations

import pytest

from heartcase.cli.main import main
from heartcase.schemas.errors import RecipeError, ScriptError, SimulationError, UsageError
from heartcase.schemas.recipe.recipe import parse_recipe
from heartcase.simulator.instruments.grab import require_grab
from heartcase.simulator.load import load_case
from heartcase.simulator.session.script import parse_script
from tests.ball import write_ball_recipe, write_ball_scan

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


def test_a_recipe_is_no_script():
    with pytest.raises(ScriptError, match="this is a recipe, not a script"):
        parse_script(HEAD)


def test_needs_that_are_a_text_are_told(tmp_path):
    with pytest.raises(UsageError, match=r"needs=\['surface'\]"):
        load_case(tmp_path / "any.case", needs="surface")


def test_what_is_no_hand_cannot_be_led():
    with pytest.raises(SimulationError, match="this is no grab but a int"):
        require_grab(99)


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
