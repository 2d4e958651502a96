"""The thesis's scene on two sample cases: closed, cut below the pulmonary valve, held open, the septal defect seen.

With ``HEARTCASE_LIBRARY`` set to the folder of a build of ``sample_cases``, such as ``out``, what is up to date there
is not built again.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from heartcase.cli.main import main

SAMPLES = Path(__file__).parents[2] / "sample_cases"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["vsd-perimembranous", "vsd-muscular-mid"])
def test_the_defect_is_hidden_until_the_incision_is_held_open(name, tmp_path, capfd):
    out = Path(os.environ.get("HEARTCASE_LIBRARY", tmp_path))
    recipe = SAMPLES / f"{name.replace('-', '_')}.toml"
    if out == tmp_path:
        (tmp_path / "sample_cases").mkdir()
        recipe = Path(shutil.copy(recipe, tmp_path / "sample_cases"))
    assert main(["build", str(recipe), "--out", str(out)]) == 0
    capfd.readouterr()
    case, plans, films = out / f"{name}.case", SAMPLES / "incisions" / f"{name}.toml", tmp_path / "recordings"
    assert main(["compare-incisions", str(case), str(plans), "--json", "--recordings", str(films)]) == 0
    (told,) = json.loads(capfd.readouterr().out)["cases"]
    (ways,) = told["defects"].values()
    by_name = {way["figures"]["name"]: way["figures"] for way in ways}
    for figures in by_name.values():
        assert (figures["rim_seen_closed"], figures["rim_seen_cut"]) == (0.0, 0.0)
    for way in ("right atrium", "below the pulmonary valve"):
        assert by_name[way]["rim_seen_best"] > 0.5
    assert set(told["inverted_cell_count"].values()) == {0}
    # What was recorded is repeated to the same bytes.
    recording = films / f"{name}-below-the-pulmonary-valve.recording"
    assert main(["replay", str(recording), "--case", str(case)]) == 0
    assert "the same bytes" in capfd.readouterr().out
