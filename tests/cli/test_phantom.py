import io
import json
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
import SimpleITK as sitk
from click.testing import CliRunner
from pydicom import dcmread
from rich.console import Console

from heartcase.cli.commands import phantom
from heartcase.cli.commands.phantom import command
from heartcase.cli.main import main
from heartcase.cli.shared.step_bar import StepBar
from heartcase.phantom.anatomy import build, heart
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.drawing import recipe
from heartcase.phantom.scan.acquisition import MRI_UNITS, noise_free
from heartcase.pipeline.building.recipe_text import HEADING
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.recipe import load_recipe


def run(*arguments):
    result = CliRunner().invoke(command, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_says_that_kernels_are_compiled_while_it_makes_the_scan(tmp_path, monkeypatch):
    told = []

    @contextmanager
    def listening(console):
        told.append("begun")
        yield
        told.append("ended")

    monkeypatch.setattr(phantom, "compiling_told", listening)
    monkeypatch.setattr(HeartPhantom, "prepare", lambda self, _: told.append("made"))
    run(tmp_path / "phantom", "--size", "child", "--spacing", "4", "--scan-only")
    assert told == ["begun", "made", "ended"]


def test_writes_scan_truth_and_recipe(tmp_path):
    out = tmp_path / "phantom"
    summary = json.loads(run(out, "--size", "child", "--spacing", "2", "2", "3", "--vsd", "5", "--oblique", "--json"))
    assert summary["files"] == ["scan.nii.gz", "truth.nii.gz", "recipe.toml"]
    assert sorted(path.name for path in out.iterdir()) == ["recipe.toml", "scan.nii.gz", "truth.nii.gz"]
    scan, truth = sitk.ReadImage(str(out / "scan.nii.gz")), sitk.ReadImage(str(out / "truth.nii.gz"))
    assert list(scan.GetSize()) == list(truth.GetSize()) == summary["voxels"]
    np.testing.assert_allclose(scan.GetSpacing(), (2.0, 2.0, 3.0), atol=1e-5)
    phantom = HeartPhantom.child()
    phantom = HeartPhantom.child(defects=[phantom.ventricular_defect(5.0)])
    labels = sitk.GetArrayFromImage(truth)
    geometry = phantom.scan_geometry((2.0, 2.0, 3.0), oblique=True)
    np.testing.assert_allclose(scan.GetOrigin(), geometry.origin_mm, atol=1e-3)
    np.testing.assert_allclose(np.reshape(scan.GetDirection(), (3, 3)), geometry.direction_matrix, atol=1e-5)
    middle = np.array(phantom.defects[0].position_mm)
    i, j, k = np.rint(geometry.world_to_index(middle)).astype(int)
    assert labels[k, j, i] in (1, 2)
    volume = np.isin(labels, phantom.truth.table.tissue_values).sum() * 12.0 / 1000.0
    assert summary["tissue_ml"] == pytest.approx(volume, abs=0.01)
    assert load_recipe(out / "recipe.toml").scan.path == "scan.nii.gz"


def test_scan_only_and_without_noise(tmp_path):
    text = run(tmp_path, "--size", "child", "--modality", "ct", "--spacing", "4", "--noise", "0", "--scan-only")
    assert [path.name for path in tmp_path.iterdir()] == ["scan.nii.gz"]
    assert "CT of the child phantom" in text
    values = sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "scan.nii.gz")))
    assert values.min() == -800.0
    assert values.max() == 350.0


@pytest.mark.parametrize("modality", ["mri", "ct"])
def test_a_dicom_series_is_the_same_scan_and_names_nobody(tmp_path, modality):
    sizes = ("--size", "child", "--spacing", "6", "6", "7")
    given = (*sizes, "--modality", modality, "--oblique", "--scan-only", "--dicom")
    text = run(tmp_path / "one", *given)
    scan, series = (read_scan(tmp_path / "one" / name) for name in ("scan.nii.gz", "dicom"))
    assert f"scan.nii.gz, dicom ({scan.geometry.size[2]} files)" in text
    assert series.modality == {"mri": "MR", "ct": "CT"}[modality]
    assert series.geometry.size == scan.geometry.size
    np.testing.assert_allclose(series.geometry.affine, scan.geometry.affine, atol=1e-4)
    np.testing.assert_array_equal(series.values, np.rint(scan.values))
    run(tmp_path / "two", *given)
    one, two = (sorted((tmp_path / name / "dicom").iterdir()) for name in ("one", "two"))
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in two]
    assert str(dcmread(one[0]).PatientName) == "child phantom"
    before = (tmp_path / "one" / "scan.nii.gz").read_bytes()
    with pytest.raises(UsageError, match="is there and is not empty"):
        run(tmp_path / "one", *given, "--seed", "7")
    assert (tmp_path / "one" / "scan.nii.gz").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--spacing", "0"], "give one voxel size or three"),
        (["--spacing", "1", "2"], "give one voxel size or three"),
        (["--noise", "-1"], "0 (no noise) or above"),
        (["--vsd", "0"], "above 0 and up to 50"),
        (["--bias", "2"], "below 1"),
    ],
)
def test_wrong_options_are_said_in_one_line(tmp_path, capsys, arguments, message):
    assert main(["phantom", str(tmp_path / "out"), "--size", "child", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert message in lines[0]
    assert not (tmp_path / "out").exists()


def test_a_file_in_the_way_is_said(tmp_path, capsys):
    (tmp_path / "out").write_text("")
    assert main(["phantom", str(tmp_path / "out"), "--size", "child"]) == 2
    assert capsys.readouterr().err.strip()


def test_a_recipe_that_was_painted_on_is_not_written_over(tmp_path, capsys):
    painted = f"heartcase_recipe = 1\n{HEADING}[[strokes]]\n"
    (tmp_path / "recipe.toml").write_text(painted)
    assert main(["phantom", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "its recipe.toml holds strokes that were painted in a session: choose another folder" in said
    assert said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.toml"]
    assert (tmp_path / "recipe.toml").read_text() == painted


def test_the_note_of_a_normal_heart_does_not_stay_beside_one_with_a_defect(tmp_path, capsys):
    note = tmp_path / "scan.nii.gz.made.json"
    settings = ["--size", "child", "--spacing", "4", "--scan-only"]
    assert main(["phantom", str(tmp_path), *settings]) == 0
    assert '"size": "child"' in note.read_text()
    assert main(["phantom", str(tmp_path), *settings, "--vsd", "8"]) == 0
    assert not note.exists()


def test_each_step_is_said_beside_the_result(tmp_path, capsys):
    assert main(["phantom", str(tmp_path), "--size", "child", "--spacing", "6"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "Making a scan of the child phantom"
    steps = ["building the heart", "making the scan", "labelling its voxels", "drawing strokes"]
    assert [line.strip().rsplit(maxsplit=2)[0] for line in lines[1:]] == steps


@pytest.mark.parametrize("supersampling", [1, 3])
def test_the_heart_and_its_scan_say_how_far_they_are(monkeypatch, supersampling):
    monkeypatch.setattr(heart, "_ANATOMIES", {})
    monkeypatch.setattr(heart, "build_anatomy", build.build_anatomy)
    phantom = HeartPhantom.child()
    built, scanned = [], []
    phantom.prepare(built.append)
    assert len(built) >= 9
    noise_free(phantom, phantom.scan_geometry(6.0), MRI_UNITS, supersampling=supersampling, told=scanned.append)
    for heard, end in ((built, 0.9), (scanned, 1.0)):
        assert all(before <= after for before, after in pairwise(heard))
        assert 0.0 < heard[0] < 0.2
        assert end <= heard[-1] <= 1.0
    built.clear()
    phantom.prepare(built.append)
    assert built == []


def test_a_terminal_sees_the_step_that_runs_and_how_far_it_is():
    written = io.StringIO()
    bar = StepBar(Console(file=written, force_terminal=True, width=80))
    with bar.progress, bar.step("making the scan") as told:
        bar.progress.refresh()
        assert "making the scan" in written.getvalue()
        told(0.25)
        assert bar.progress.tasks[0].percentage == 25.0
    assert bar.progress.tasks == []


def test_who_stops_it_finds_nothing(tmp_path, monkeypatch, capsys):
    def stopped(phantom):
        raise KeyboardInterrupt

    monkeypatch.setattr(recipe, "marker_strokes", stopped)
    assert main(["phantom", str(tmp_path / "out"), "--size", "child", "--spacing", "6"]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
