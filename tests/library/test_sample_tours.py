"""The guided tours of the sample cases, done to their end on the built cases.

With ``HEARTCASE_LIBRARY`` set to the folder of a build of ``sample_cases``, such as ``out``, what is up to date there
is not built again.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from heartcase.cli.main import main
from heartcase.schemas.touring.reading import TOUR_ENDING, load_tour

SAMPLES = Path(__file__).parents[2] / "sample_cases"
TOURS = sorted(SAMPLES.glob(f"*{TOUR_ENDING}"))


@pytest.mark.slow
@pytest.mark.parametrize("path", TOURS, ids=lambda path: path.name.removesuffix(TOUR_ENDING))
def test_a_tour_does_all_of_it_on_its_case(path, tmp_path, capfd):
    out = Path(os.environ.get("HEARTCASE_LIBRARY", tmp_path))
    recipe = SAMPLES / (path.name.removesuffix(TOUR_ENDING) + ".toml")
    if out == tmp_path:
        (tmp_path / "sample_cases").mkdir()
        recipe = Path(shutil.copy(recipe, tmp_path / "sample_cases"))
    assert main(["build", str(recipe), "--out", str(out)]) == 0
    capfd.readouterr()
    case = out / f"{load_tour(path).head.case}.case"
    assert main(["validate", str(path), "--case", str(case), "--run"]) == 0
    # no cell is inside out at the end of any step
    assert capfd.readouterr().out == "sound\n"
