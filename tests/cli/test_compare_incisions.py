"""``heartcase compare-incisions`` on a box with two rooms: tables, JSON, a page, pictures, a surface, recordings."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from PIL import Image, ImageSequence

from heartcase.cli.main import main
from heartcase.cli.sessions.compare_incisions import _Wanted
from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.session.planned_incisions import load_plans, parse_plans
from tests.hollow_case import CELL_MM, SIZE, hollow_case

SAMPLES = Path(__file__).parents[2] / "sample_cases"
PLANS = """heartcase_plans = 1
[shaft]
spacing_mm = 8.0
depth_mm = 20.0
[[plans]]
name = "left alone"
cuts = [{ landmark = "lid" }]
settle_s = 0.04
open_s = 0.04
hold_s = 0.04
[[plans]]
name = "held open"
cuts = [{ landmark = "lid" }]
retraction = { spread_mm = 6.0, lift_mm = 2.0, radius_mm = 4.5 }
settle_s = 0.04
open_s = 0.2
hold_s = 0.1
[[plans]]
name = "beside"
cuts = [{ poses_mm = [[[900, 0, 0], [900, 0, 9]], [[909, 0, 0], [909, 0, 9]]] }]
[[plans]]
name = "elsewhere"
only_with_landmarks = true
cuts = [{ landmark = "cellar" }]
"""


@pytest.fixture
def folder(tmp_path):
    write_bundle(tmp_path / "hollow.case", hollow_case())
    (tmp_path / "plans.toml").write_text(PLANS)
    return tmp_path


def test_everything_that_it_writes(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    wanted = "-o told.json --table told.md --page told.html --pictures pictures --animations moving"
    wanted += " --surfaces surfaces --recordings films"
    assert main(["compare-incisions", "hollow.case", "plans.toml", *wanted.split()]) == 1
    said = capsys.readouterr()
    assert said.err.strip() == (
        "heartcase: hollow, beside: blade: there is no tissue in its way: look where the line lies and how deep it goes"
    )
    lines = said.out.splitlines()
    assert "1. held open 2. left alone" in " ".join(lines[4].split())
    assert "Left out, for want of landmarks: elsewhere." in lines
    assert "Not a medical device" in said.out

    told = json.loads((folder / "told.json").read_text())
    (case,) = told["cases"]
    first, second = case["defects"]["hole"]
    assert [one["figures"]["name"] for one in (first, second)] == ["held open", "left alone"]
    assert (first["figures"]["rim_seen_closed"], second["figures"]["rim_seen"]) == (0.0, 0.0)
    assert first["figures"]["rim_seen"] > 0.5
    assert np.linalg.norm(first["looks_from"]) == pytest.approx(1.0)
    assert (case["left_out"], len(case["failed"])) == (["elsewhere"], 1)

    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in (folder / "told.md").read_text().splitlines()]
    assert [row[:4] for row in table[2:]] == [
        ["hollow", "hole", "held open", "1"],
        ["hollow", "hole", "left alone", "2"],
    ]
    assert {len(row) for row in table} == {len(table[0])}
    assert table[2][table[0].index("rim seen")] == f"{first['figures']['rim_seen']:.0%}"

    page = (folder / "told.html").read_text()
    assert page.count("<img ") == 2
    assert "1. held open" in page
    assert "http" not in page.replace("http://www.w3.org", "")
    assert sorted(path.name for path in (folder / "pictures").iterdir()) == [
        "hollow-held-open-hole.png", "hollow-left-alone-hole.png",
    ]  # fmt: skip
    picture = np.asarray(Image.open(folder / "pictures" / "hollow-held-open-hole.png").convert("RGB")).astype(int)
    is_rim = (picture[..., 1] > picture[..., 0] + 60) & (picture[..., 1] > picture[..., 2] + 60)
    assert is_rim.sum() > 20
    film = Image.open(folder / "moving" / "hollow-held-open-hole.gif")
    frames = [np.asarray(one.convert("RGB")).astype(int) for one in ImageSequence.Iterator(film)]
    # The film begins with the closed lid; walls of the cut are dark red.
    cut_faces = [((one[..., 0] > 2 * one[..., 1]) & (one[..., 0] > 2 * one[..., 2])).sum() for one in frames]
    assert cut_faces[0] == 0
    assert cut_faces[-1] > 200
    surface = trimesh.load(folder / "surfaces" / "hollow-held-open.ply", process=False)
    assert len(np.unique(surface.visual.vertex_colors, axis=0)) > 20
    # It encloses the tissue: cells of a box without its two rooms, and a wall with a hole between these.
    cells = np.prod(SIZE) - np.prod(np.array(SIZE) - 2) + 10 * 8 - 4 * 4
    assert surface.volume == pytest.approx(cells * CELL_MM**3, rel=0.1)
    recordings = sorted((folder / "films").iterdir())
    assert [path.name for path in recordings] == ["hollow-held-open.recording", "hollow-left-alone.recording"]
    assert [mark.command.name for mark in open_recording(recordings[0]).entries if mark.command.kind == "mark"] == [
        "closed", "cut", "held open",
    ]  # fmt: skip

    assert main(["compare-incisions", "hollow.case", "plans.toml", "--recordings", "films"]) == 2
    assert "there is a recording already" in capsys.readouterr().err


def test_a_folder_holds_plans_by_the_name_of_each_case(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "plans").mkdir()
    assert main(["compare-incisions", "hollow.case", "plans"]) == 1
    assert "there is no such file" in capsys.readouterr().err
    (folder / "plans" / "hollow.toml").write_text(PLANS[: PLANS.index('[[plans]]\nname = "held open"')])
    assert main(["compare-incisions", "hollow.case", "plans", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cases"][0]["case"] == "hollow"


def test_the_example_of_the_page_can_be_read():
    page = (SAMPLES.parent / "docs" / "incisions.md").read_text()
    plans = parse_plans(page.split("```toml\n")[1].split("```")[0])
    assert len(plans.plans) == 2


def test_the_sample_plans_can_be_read():
    plans = load_plans(SAMPLES / "incision_plans.toml")
    assert plans.plans[0].name == "trans-atrial"
    for path in sorted((SAMPLES / "incisions").iterdir()):
        recipe = (SAMPLES / f"{path.stem.replace('-', '_')}.toml").read_text()
        assert f'name = "{path.stem}"' in recipe
        for plan in load_plans(path).plans:
            assert all(cut.landmark is None or f'name = "{cut.landmark}"' in recipe for cut in plan.cuts)


def test_files_of_cases_with_one_name_are_refused_before_a_folder_is_made(tmp_path):
    cases = [SimpleNamespace(manifest=SimpleNamespace(name=name)) for name in ("same", "SAME", "other")]
    wanted = _Wanted(tmp_path / "pictures", None, None, None, False, "cpu", 0.0)
    with pytest.raises(UsageError, match=r"one name \(SAME, same\): compare them one at a time"):
        wanted.make_folders(cases, ())
    assert not any(tmp_path.iterdir())
