"""Nothing that could name a patient leaves a scan or a marker file: searched in every byte that heartcase puts out."""

from __future__ import annotations

import logging
import os
import shutil
from pathlib import Path

import numpy as np
import pydicom
import pytest

from heartcase.cli.main import main
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.geometry import Geometry
from tests.ball import INNER_MM, OUTER_MM, write_ball_scan
from tests.identity.plants import (
    FILE,
    FOLDER,
    NAME,
    TOKENS,
    token,
    write_dicom,
    write_markups,
    write_metaimage,
    write_nifti,
    write_nrrd,
    write_stl,
)
from tests.identity.search import found_in, found_in_tree, self_check

GEOMETRY = Geometry.of(shape=(32, 32, 32), spacing_mm=(2, 2, 2), origin_mm=(-31, -31, -31))
CAVITY, MUSCLE, OUTSIDE = token(), token(), token()
"""Names that the marker files give their segments; the recipe maps them to labels."""

RECIPE = """
heartcase_recipe = 1
name = "ball"
[scan]
path = '{scan}'
[[labels]]
value = 1
name = "cavity"
role = "blood"
[[labels]]
value = 2
name = "muscle"
role = "myocardium"
{markers}
[[pins]]
position_mm = [0, 0, 20]
radius_mm = 8
[grid]
cell_mm = 5.0
[surface]
triangle_count = 600
normal_map_size = 128
"""
NAMES = f"names = {{ '{CAVITY}' = 'cavity', '{MUSCLE}' = 'muscle', '{OUTSIDE}' = 'background' }}"
SCRIPT = """
seconds = 0.02
[[actions]]
kind = "grab"
position_mm = [17.0, 0.0, 0.0]
radius_mm = 5.0
path = [{ time_s = 0.01, offset_mm = [1.0, 0.0, 0.0] }]
"""


def radius() -> np.ndarray:
    k, j, i = np.indices(GEOMETRY.shape)
    return np.linalg.norm(GEOMETRY.index_to_world(np.stack([i, j, k], axis=-1)), axis=-1)


def painted() -> np.ndarray:
    """Segment 1 in the cavity, 2 in the muscle, 3 outside."""
    distance, x = radius(), np.indices(GEOMETRY.shape)[2]
    labels = np.zeros(GEOMETRY.shape, np.uint8)
    labels[distance < 6.0] = 1
    labels[(abs(distance - 17.0) < 1.5) & (x % 4 == 0)] = 2
    labels[distance > 28.0] = 3
    return labels


SEGMENTS = [(CAVITY, 1), (MUSCLE, 2), (OUTSIDE, 3)]


@pytest.fixture(scope="module")
def hospital(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as a hospital might hand it over: everything in it names the patient."""
    root = tmp_path_factory.mktemp("hospital") / FOLDER
    root.mkdir()
    ball = root.parent / "ball.nii.gz"
    write_ball_scan(ball)
    scan = read_scan(ball)
    write_dicom(root / f"{NAME} series", scan)
    write_nifti(root / f"{FILE}.nii.gz", scan)
    write_nrrd(root / f"{FILE}.nrrd", scan.values, scan.geometry)
    write_metaimage(root / f"{FILE}.mha", scan)
    write_nrrd(root / f"{FILE}.seg.nrrd", painted(), GEOMETRY, segments=SEGMENTS)
    dabs = [[17.0, 0, 0], [0, 17.0, 0], [0, 0, 17.0], [-17.0, 0, 0]]
    write_markups(
        root / f"{FILE}.mrk.json",
        [
            (CAVITY, [[-4.0, 0, 0], [4.0, 0, 0]]),
            (MUSCLE, dabs),
            (OUTSIDE, [[-28, -28, -28], [28, -28, -28], [28, 28, -28], [28, 28, 28]]),
        ],
    )
    finished = np.where(radius() < INNER_MM, 1, np.where(radius() < OUTER_MM, 2, 0)).astype(np.uint8)
    write_nrrd(root / f"{FILE}_finished.seg.nrrd", finished, GEOMETRY, segments=SEGMENTS[:2])
    return root


class Ear:
    """Runs commands, and hears all that they print and log."""

    def __init__(self, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture) -> None:
        self.capfd, self.caplog = capfd, caplog
        caplog.set_level(logging.DEBUG)
        caplog.set_level(logging.WARNING, "matplotlib")

    def run(self, *arguments: object, code: int | None = 0) -> str:
        """Run a command; what it said must be free of planted text."""
        self.caplog.clear()
        self.capfd.readouterr()
        returned = main([str(argument) for argument in arguments])
        printed = self.capfd.readouterr()
        said = printed.out + printed.err + self.caplog.text
        if code is not None:
            assert returned == code, said
        assert found_in(said.encode(), TOKENS) == [], said
        return said


@pytest.fixture
def ear(capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture) -> Ear:
    return Ear(capfd, caplog)


def recipe_for(work: Path, scan: Path, markers: str) -> Path:
    path = work / "case.toml"
    path.write_text(RECIPE.format(scan=scan, markers=markers))
    return path


def markers_in(path: Path, more: str = "") -> str:
    return f"[[markers]]\npath = '{path}'\n{NAMES}\n{more}"


def test_the_search_sees_through_every_way_of_packing() -> None:
    self_check(TOKENS)


@pytest.mark.parametrize(
    "scan",
    [
        f"{NAME} series",
        pytest.param(f"{FILE}.nii.gz", marks=pytest.mark.slow),
        pytest.param(f"{FILE}.nrrd", marks=pytest.mark.slow),
        pytest.param(f"{FILE}.mha", marks=pytest.mark.slow),
    ],
    ids=["dicom", "nifti", "nrrd", "metaimage"],
)
def test_scan_to_session(hospital: Path, tmp_path: Path, ear: Ear, scan: str) -> None:
    """From a scan with names in every tag, through every command, to every kind of output."""
    work, out = tmp_path / "work", tmp_path / "out"
    work.mkdir()
    out.mkdir()
    source = hospital / scan
    suffix = ".mrk.json" if scan.endswith(".nrrd") else ".seg.nrrd"
    recipe = recipe_for(work, source, markers_in(hospital / f"{FILE}{suffix}", "radius_mm = 2.0"))
    for command in (("info", source), ("info", source, "--json"), ("info", recipe), ("validate", recipe)):
        ear.run(*command)
    ear.run("preview", source, "--out", out / "scan.png")
    ear.run("new", source, "--out", work / "new.toml")
    ear.run("build", recipe, "--out", out)
    case = out / "ball.case"
    case_id = open_bundle(case).manifest.case_id
    assert case_id is not None
    for command in (("info", case), ("info", case, "--json"), ("validate", case), ("build", recipe, "--out", out)):
        ear.run(*command)
    ear.run("preview", case, "--out", out / "case.png")
    script = work / "pull.toml"
    script.write_text(SCRIPT)
    outputs = [out / "end.ply", out / "film.gif", out / "pull.png"]
    pictures = ("--surface", outputs[0], "--animation", outputs[1], "--picture", outputs[2])
    said = ear.run("simulate", case, "--script", script, *pictures)
    assert case_id in said
    for path in [
        *outputs,
        out / "case.png",
        case / "case.json",
        out / "ball.report.html",
        *case.glob("*.glb"),
        *case.glob("*.nrrd"),
    ]:
        assert case_id in path.read_bytes().decode("latin-1"), path.name
    assert case_id in ear.run("simulate", case, "--script", script, "--json")
    for stage, source_of, result in (
        ("filter", source, "filtered.safetensors"),
        ("segment", out / "filtered.safetensors", "labels.safetensors"),
        ("walls", out / "labels.safetensors", "walls.safetensors"),
        ("grid", out / "walls.safetensors", "grid.safetensors"),
    ):
        ear.run(stage, source_of, out / result, "--recipe", recipe)
    assert found_in_tree(out, TOKENS) == {}
    written = [line for line in (work / "new.toml").read_text().splitlines() if not line.startswith("path = ")]
    assert found_in("\n".join(written).encode(), TOKENS) == []


@pytest.mark.parametrize("suffix", [".seg.nrrd", ".stl"])
def test_finished_segmentation(hospital: Path, tmp_path: Path, ear: Ear, suffix: str) -> None:
    finished = hospital / f"{FILE}_finished.seg.nrrd"
    if suffix == ".stl":
        finished = tmp_path / f"{NAME} parts"
        finished.mkdir()
        write_stl(finished / f"{MUSCLE}.stl", OUTER_MM)
        write_stl(finished / f"{MUSCLE}_{CAVITY}.stl", INNER_MM)
    names = f"names = {{ '{CAVITY}' = 'cavity', '{MUSCLE}' = 'muscle', '{MUSCLE}_{CAVITY}' = 'cavity' }}"
    recipe = recipe_for(
        tmp_path, hospital / f"{FILE}.nrrd", f"[segment]\nmethod = 'labels'\nfile = '{finished}'\n{names}"
    )
    out = tmp_path / "out"
    ear.run("build", recipe, "--out", out)
    assert found_in_tree(out, TOKENS) == {}
    files = (
        "labels.seg.nrrd",
        "labels.nii.gz",
        "labels.dcm",
        "x.stl",
        "x.ply",
        "x.3mf",
        "x.vtu",
        "x.vtk",
        "x.inp",
        "x.msh",
    )
    for name in files:
        ear.run("export", out / "ball.case", "--out", out / name)
    assert found_in_tree(out, TOKENS) == {}


def test_errors_about_a_series(hospital: Path, tmp_path: Path, ear: Ear) -> None:
    """What goes wrong with a planted series is said without a word of it."""
    source = hospital / f"{NAME} series"

    def broken(name: str) -> Path:
        copy = tmp_path / f"{NAME} {name}"
        shutil.copytree(source, copy)
        return copy

    gap = broken("gap")
    (gap / f"{FILE}_011.dcm").unlink()
    assert "missing" in ear.run("info", gap, code=1)
    ear.run("info", gap, "--interpolate-missing")
    cut = broken("cut")
    for path in list(cut.iterdir())[:3]:
        path.write_bytes(path.read_bytes()[:-700])
    ear.run(
        "build", recipe_for(tmp_path, cut, markers_in(hospital / f"{FILE}.seg.nrrd")), "--out", tmp_path / "o", code=1
    )
    half = broken("half")
    for path in list(half.iterdir())[:3]:
        path.write_bytes(path.read_bytes()[:5000])
    ear.run("info", half, code=None)
    two = broken("two")
    for path in sorted(two.iterdir())[:16]:
        dataset = pydicom.dcmread(path)
        dataset.SeriesInstanceUID += "1"
        dataset.save_as(path)
    said = ear.run("info", two, "--series", NAME, code=1)
    assert "series" in said
    ear.run("info", two)
    colour = broken("colour")
    for path in colour.iterdir():
        dataset = pydicom.dcmread(path)
        dataset.PhotometricInterpretation = token(16, upper=True)
        dataset.save_as(path)
    ear.run("info", colour, code=1)
    ear.run("info", tmp_path / NAME / DATE_FOLDER, code=1)


DATE_FOLDER = f"{NAME} gone"


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
def test_errors_about_a_file(hospital: Path, tmp_path: Path, ear: Ear, suffix: str) -> None:
    content = (hospital / f"{FILE}{suffix}").read_bytes()
    broken = tmp_path / f"{FILE}{suffix}"
    for cut in (0, 10, 100, 300, 340, 360, 400, 700, len(content) // 2, len(content) - 1):
        broken.write_bytes(content[:cut])
        ear.run("info", broken, code=1)
    for old, new in ((b"left-posterior", token().encode()), (b"float", token().encode()), (b"32", b"3Z"), (b"=", b"!")):
        broken.write_bytes(content.replace(old, new))
        ear.run("info", broken, code=None)


def test_errors_about_markers(hospital: Path, tmp_path: Path, ear: Ear) -> None:
    """Names of segments, lists and points that are no labels or lie elsewhere are told by number."""
    scan = hospital / f"{FILE}.nrrd"
    for suffix in (".seg.nrrd", ".mrk.json"):
        file = hospital / f"{FILE}{suffix}"
        unmapped = recipe_for(tmp_path, scan, f"[[markers]]\npath = '{file}'\n")
        assert "markers[1]" in ear.run("build", unmapped, "--out", tmp_path / "out", code=1)
    far = Geometry.of(shape=(32, 32, 32), spacing_mm=(2, 2, 2), origin_mm=(5000, -31, -31))
    elsewhere = tmp_path / f"{FILE}.seg.nrrd"
    write_nrrd(elsewhere, painted(), far, segments=SEGMENTS)
    ear.run("build", recipe_for(tmp_path, scan, markers_in(elsewhere)), "--out", tmp_path / "out", code=1)
    write_nrrd(elsewhere, painted(), GEOMETRY, segments=[*SEGMENTS, (token(), 3), (token(), 700000)])
    ear.run("build", recipe_for(tmp_path, scan, markers_in(elsewhere)), "--out", tmp_path / "out", code=1)
    beyond = tmp_path / f"{FILE}.mrk.json"
    write_markups(beyond, [(CAVITY, [[900.0, 0, 0], [901.0, 0, 0]])])
    ear.run("build", recipe_for(tmp_path, scan, markers_in(beyond)), "--out", tmp_path / "out", code=1)
    beyond.write_text(beyond.read_text()[:-40])
    ear.run("build", recipe_for(tmp_path, scan, markers_in(beyond)), "--out", tmp_path / "out", code=1)
    missing = recipe_for(tmp_path, scan, markers_in(tmp_path / f"{NAME}.nrrd"))
    ear.run("build", missing, "--out", tmp_path / "out", code=1)
    ear.run("validate", missing, code=1)
    assert found_in_tree(tmp_path / "out", TOKENS) == {}


def test_key_file_alone_says_whose_case_it_is(hospital: Path, tmp_path: Path, ear: Ear) -> None:
    out, key = tmp_path / "out", tmp_path / "keys.jsonl"
    recipe = recipe_for(tmp_path, hospital / f"{NAME} series", markers_in(hospital / f"{FILE}.seg.nrrd"))
    ear.run("build", recipe, "--out", out, "--key-file", key)
    case_id = open_bundle(out / "ball.case").manifest.case_id
    first = key.read_bytes()
    assert case_id.encode() in first
    assert set(found_in(first, TOKENS)) >= {NAME, "19370521"}
    assert key.stat().st_mode & 0o077 == 0
    ear.run("build", recipe, "--out", out, "--key-file", key)
    assert key.read_bytes() == first
    assert found_in_tree(out, TOKENS) == {}
    inside = ear.run("build", recipe, "--out", out, "--key-file", out / "ball.case" / "keys.jsonl", code=2)
    assert "the folder of a case, or lies in one" in inside


def test_places_that_cannot_be_read_are_not_named(hospital: Path, tmp_path: Path, ear: Ear) -> None:
    """Also where the system itself, or the parser of the command line, would quote them."""
    long_name = tmp_path / (NAME * 40)
    for place in (long_name, tmp_path / f"{NAME} gone", tmp_path / f"{NAME}\udcff"):
        for command in ("info", "validate", "new"):
            ear.run(command, place, code=None)
        ear.run("build", recipe_for(tmp_path, long_name, "[segment]\nmethod = 'threshold'\n"), code=1)
    case = tmp_path / "x.case"
    ear.run("export", case, "--out", tmp_path / "x.dcm", "--scan", tmp_path / NAME / "gone", code=1)
    ear.run("info", "a", f"{NAME}/b", code=2)
    ear.run("build", recipe_for(tmp_path, hospital / "x", "").parent, "--out", tmp_path / "out", code=1)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="who may do everything can read everything")
def test_places_without_rights_are_not_named(hospital: Path, tmp_path: Path, ear: Ear) -> None:
    locked = tmp_path / f"{NAME} locked"
    shutil.copytree(hospital / f"{NAME} series", locked / "series")
    locked.chmod(0)
    try:
        for command in ("info", "new", "validate", "preview"):
            ear.run(
                command, locked / "series", *(("--out", tmp_path / "x.png") if command == "preview" else ()), code=1
            )
        ear.run("build", recipe_for(tmp_path, locked / "series", ""), "--out", tmp_path / "out", code=1)
    finally:
        locked.chmod(0o700)


def test_a_fault_of_our_own_is_told_without_its_text(tmp_path: Path, ear: Ear, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(path: Path) -> None:
        raise KeyError(f"{NAME} {path}")

    monkeypatch.setattr("heartcase.cli.commands.validate.check_bundle", fail)
    said = ear.run("validate", tmp_path / NAME, code=70)
    assert "KeyError in cli/commands/validate.py" in said
    monkeypatch.setenv("HEARTCASE_DEBUG", "1")
    with pytest.raises(KeyError):
        main(["validate", str(tmp_path)])
