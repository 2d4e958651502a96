"""The sample library from raw synthetic scans to cases that stand handling: one to five minutes a case.

With ``HEARTCASE_LIBRARY`` set to the folder of a build of ``sample_cases``, such as ``out``, what is up to date there
is not built again.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from heartcase.cli.main import main
from heartcase.library.check import check_case, problems_of
from heartcase.schemas.recipe.recipe import load_recipe

SAMPLES = Path(__file__).parents[2] / "sample_cases"
MADE = [path for path in sorted(SAMPLES.glob("*.toml")) if "[scan.phantom]" in path.read_text()]


@pytest.mark.parametrize("path", MADE, ids=lambda path: path.stem)
def test_a_sample_cases_coronary_arteries_are_lines_without_a_jump(path):
    lines = [one for one in load_recipe(path).landmarks if one.is_vessel]
    assert len(lines) == 3
    for line in lines:
        steps = np.linalg.norm(np.diff(line.points_mm, axis=0), axis=1)
        assert steps.max() < 0.2 * steps.sum(), line.name


@pytest.mark.parametrize("path", MADE, ids=lambda path: path.stem)
def test_a_sample_cases_incisions_are_lines_without_a_jump(path):
    for line in load_recipe(path).landmarks:
        if line.depth_mm is not None:
            steps = np.linalg.norm(np.diff(line.points_mm, axis=0), axis=1)
            assert steps.max() < 4.0 * np.median(steps), line.name


@pytest.mark.slow
@pytest.mark.parametrize("path", MADE, ids=lambda path: path.stem)
def test_a_sample_case_is_what_its_diagnosis_says_and_stands_handling(path, tmp_path, capfd):
    out = Path(os.environ.get("HEARTCASE_LIBRARY", tmp_path))
    if out == tmp_path:
        (tmp_path / "sample_cases").mkdir()
        path = Path(shutil.copy(path, tmp_path / "sample_cases"))
    recipe = load_recipe(path)
    assert main(["build", str(path), "--out", str(out)]) == 0
    case = out / f"{recipe.name}.case"
    check = check_case(case, recipe.scan.phantom)
    assert check.joined == check.joined_truly
    assert not problems_of(check, least_dice=0.85, surface_mm=1.0, diameter_mm=2.0)
    capfd.readouterr()
    assert main(["simulate", str(case), "--script", str(SAMPLES / "handling.toml"), "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told["seconds"] == pytest.approx(10.0, rel=0.01)
    assert 2.0 < told["displacement_max_mm"] < 60.0
    assert told["displacement_end_mm"] < 1.0
    assert told["inverted_cell_count_end"] == 0
