"""Every situation of the table is read exactly, or refused in plain lines; none hangs, none gives a traceback."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from heartcase.cli.main import main
from tests.pipeline.formats.dicom_situations import (
    PLANTED,
    Outcome,
    Situation,
    all_situations,
    command_line,
    outcome_of,
    table,
)

SITUATIONS = {situation.name: situation for situation in all_situations()}
OUTCOMES: dict[str, Outcome] = {}
DOCUMENT = Path(__file__).parents[3] / "docs" / "dicom.md"


def leaks(text: str, folder: Path) -> bool:
    return PLANTED.lower() in text.lower() or "1977" in text or str(folder) in text


@pytest.mark.timeout(10)
@pytest.mark.parametrize("name", SITUATIONS)
def test_situation(tmp_path: Path, name: str, capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    situation = SITUATIONS[name]
    outcome = OUTCOMES[name] = outcome_of(situation, tmp_path)
    if situation.refused:
        assert outcome.scan is None
        assert re.search(situation.refused, outcome.problems[0]), outcome.problems
        assert len(outcome.problems) == situation.lines
    else:
        check_what_was_read(situation, outcome)
    assert capfd.readouterr() == ("", "")

    monkeypatch.chdir(tmp_path)
    (target,) = tmp_path.iterdir()
    code = main(["info", str(target / situation.file), *command_line(situation.options)])
    out, err = capfd.readouterr()
    assert "Traceback" not in out + err
    assert not leaks(out + err, tmp_path)
    lists_choices = "choose one" in out
    assert code == (1 if situation.refused and not lists_choices else 0)
    if code:
        assert err.splitlines() == [f"heartcase: {problem}" for problem in outcome.problems]
    assert not leaks("\n".join(outcome.problems) + repr(outcome.scan), tmp_path)


def check_what_was_read(situation: Situation, outcome: Outcome) -> None:
    assert outcome.scan is not None, outcome.problems
    assert outcome.truth is not None
    geometry, values = outcome.scan.geometry, outcome.scan.values
    assert values.shape == geometry.shape == outcome.truth.values.shape
    corners = np.array(
        [(i, j, k, 1) for i in (0, geometry.size[0]) for j in (0, geometry.size[1]) for k in (0, geometry.size[2])]
    )
    off = corners @ (geometry.affine - outcome.truth.affine).T
    assert np.abs(off).max() <= outcome.truth.place_mm
    error = np.abs(values.astype(np.float64) - outcome.truth.values)
    assert np.isfinite(error).mean() > 0.8
    assert np.nanmax(error) <= outcome.truth.loss
    said = "; ".join(warning.text for warning in outcome.scan.warnings)
    assert re.search(situation.warns, said) if situation.warns else not said, said
    acquisition = outcome.scan.acquisition
    assert acquisition == acquisition | situation.has_acquisition


def test_the_table_is_large_enough() -> None:
    read = [situation for situation in SITUATIONS.values() if not situation.refused]
    assert len(SITUATIONS) == len(all_situations())
    assert len(SITUATIONS) >= 45
    assert 2 * len(read) > len(SITUATIONS)


def test_the_table_in_the_document_is_current() -> None:
    """Else: ``python -m tests.pipeline.formats.dicom_situations`` and put it between the marks."""
    text = DOCUMENT.read_text(encoding="utf-8")
    assert table(OUTCOMES) == text.partition("<!-- table -->\n")[2].partition("<!-- end of table -->")[0]
