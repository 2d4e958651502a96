"""What is given as 0, as an empty text or as false is given, and not taken as left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from heartcase.cli.main import cli, main
from heartcase.cli.shared.stage_io import scan_options
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.schemas.errors import RecipeError
from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe
from tests.ball import write_ball_scan
from tests.pipeline.formats.dicom_situations_stacks import cine


@pytest.mark.parametrize("option", ["trigger_time_ms", "echo_time_ms"])
def test_a_time_of_zero_is_a_choice(option: str) -> None:
    given: list[dict[str, Any]] = []

    @click.command()
    @scan_options
    def taking(choice: dict[str, Any]) -> None:
        given.append(choice)

    flag = {"trigger_time_ms": "--trigger-time", "echo_time_ms": "--echo-time"}[option]
    assert CliRunner().invoke(taking, [flag, "0"]).exit_code == 0
    assert CliRunner().invoke(taking, []).exit_code == 0
    assert given == [{option: 0.0}, {}]


def test_end_diastole_is_chosen_by_its_own_number(tmp_path: Path) -> None:
    cine(tmp_path / "cine")
    recipe = tmp_path / "case.toml"
    result = CliRunner().invoke(cli, ["new", str(tmp_path / "cine"), "--out", str(recipe), "--trigger-time", "0"])
    assert result.exit_code == 0, result.output
    source = load_recipe(recipe).scan
    assert source.choice == {"trigger_time_ms": 0.0}
    scan = read_scan(tmp_path / source.path, **source.choice)
    assert scan.acquisition["trigger_time_ms"] == pytest.approx(10.0)  # the first of the cine


def test_an_empty_name_is_refused_and_none_made_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ball_scan(tmp_path / "scan.nii.gz")
    out = tmp_path / "case.toml"
    assert main(["new", str(tmp_path / "scan.nii.gz"), "--out", str(out), "--name", ""]) != 0
    assert "name" in capsys.readouterr().err
    assert not out.exists()


def test_an_empty_scheduler_is_not_this_machine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["library", "build", str(tmp_path), "--scheduler", ""]) == 2
    assert "--scheduler" in capsys.readouterr().err


def test_an_empty_path_of_a_segmentation_is_refused_at_once() -> None:
    text = 'heartcase_recipe = 1\nname = "a"\n[scan]\npath = "s.nii"\n[segment]\nmethod = "labels"\nfile = ""\n'
    with pytest.raises(RecipeError, match=r"segment\.file"):
        parse_recipe(text)
