"""What a script's cuts, excisions and threads come to, and what is said of those that did nothing."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from heartcase.cli.shared.sessions import operation_lines, require_case
from heartcase.schemas.errors import ScriptError, UsageError
from heartcase.simulator.session.script import parse_script, run_script
from heartcase.simulator.simulation import Simulation
from tests.simulator.surface_splitting.surfaces import block, box, hung

SHAPE = (9, 6, 6)
MODEL = block(SHAPE)
MM = MODEL.cell_mm


def blade(x: float) -> str:
    low, high, at = -2 * MM, 8 * MM, x * MM
    return f"[[[{at}, {low}, {low}], [{at}, {low}, {high}]], [[{at}, {high}, {low}], [{at}, {high}, {high}]]]"


def run(text: str):
    surface = hung(MODEL, *box(SHAPE, np.array(SHAPE, float)))
    return run_script(Simulation(MODEL, surface=surface, step_s=2e-4), parse_script(text))


def test_cuts_excisions_and_tensions_are_told():
    summary = run(f"""
seconds = 0.1
step_s = 2e-4
cuts = [
  {{ name = "across", time_s = 0.01, poses_mm = {blade(6.5)}, at_rest = true }},
  {{ name = "in the air", time_s = 0.02, poses_mm = {blade(60.0)}, at_rest = true }},
]
excisions = [{{ name = "end", time_s = 0.03, place_mm = [{9 * MM}, {3 * MM}, {3 * MM}] }}]
[[stitches]]
name = "too strong"
places_mm = [[{2 * MM}, {3 * MM}, {6 * MM}], [{2.2 * MM}, {3 * MM}, {6 * MM}]]
time_s = 0.04
tied_s = 0.08
tension_n = 500.0
""")
    assert summary.cut_mm2 == {"across": pytest.approx(36 * MM**2, rel=1e-3), "in the air": 0.0}
    assert summary.excised_ml == {"end": pytest.approx(2.5 * 36 * MM**3 / 1000.0, rel=1e-6)}
    tied, asked = summary.stitch_tied_n["too strong"]
    assert asked == 500.0
    assert tied < 100.0
    words = list(operation_lines(summary))
    assert [line.split()[0] for line in words] == ["Cut", "Warning", "Excision", "Warning"]
    assert "in the air cut nothing" in words[1]
    assert "not the 500 N" in words[3]


def test_a_script_of_another_case_is_refused_and_all_that_comes_late_is_told():
    script = parse_script('case = "Tetralogy"')
    require_case(script, SimpleNamespace(manifest=SimpleNamespace(name="tetralogy")))
    with pytest.raises(UsageError, match="for the case Tetralogy, and this is avsd"):
        require_case(script, SimpleNamespace(manifest=SimpleNamespace(name="avsd")))
    with pytest.raises(ScriptError) as found:
        parse_script(
            f"seconds = 1.0\ncuts = [{{ time_s = 2.0, poses_mm = {blade(1.0)} }}]\n"
            + 2 * "[[excisions]]\nplace_mm = [0, 0, 0]\ntime_s = 1.5\n"
        )
    (problem,) = found.value.problems
    for words in ("cuts come after the end", "excisions come after the end", "two excisions have one name"):
        assert words in problem.message
