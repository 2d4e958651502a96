"""The whole build on a small scan: what it makes, what it reuses, what a crash leaves."""

import functools
import hashlib
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import SimpleITK

from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.stages.table import stage_names
from heartcase.pipeline.warnings import warnings_of
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import BundleError, HeartcaseError, ScanError, UsageError
from heartcase.schemas.recipe.recipe import load_recipe
from tests.ball import write_ball_recipe, write_ball_scan
from tests.crash import Crash, crash_after

pytestmark = pytest.mark.usefixtures("plain_reports")


@pytest.fixture(scope="module")
def scan_directory(tmp_path_factory):
    directory = tmp_path_factory.mktemp("patient-JANE-DOE")
    write_ball_scan(directory / "JANE-DOE.nii.gz")
    return directory


def make_recipe(scan_directory, folder, **options):
    return write_ball_recipe(scan_directory / "JANE-DOE.nii.gz", folder / "ball.toml", **options)


def build(path, out, **options):
    return build_case(load_recipe(path), directory=path.parent, out=out, **options)


def contents(directory):
    return {path.name: path.read_bytes() for path in sorted(directory.iterdir())}


@pytest.fixture(scope="module")
def built(scan_directory, tmp_path_factory):
    folder = tmp_path_factory.mktemp("built")
    path = make_recipe(scan_directory, folder)
    return path, folder / "out", build(path, folder / "out")


def test_what_is_said_of_a_place_that_is_not_there_is_a_warning_of_the_case(scan_directory, tmp_path):
    path = make_recipe(scan_directory, tmp_path)
    other = '[[labels]]\nvalue = 3\nname = "other"\nrole = "blood"\n'
    said = '[[walls.contact]]\nbetween = ["cavity", "other"]\nposition_mm = [14, 0, 0]\nradius_mm = 3\nis_open = true\n'
    path.write_text(path.read_text() + other + said)
    manifest = build(path, tmp_path / "out").manifest
    found = [
        one for one in warnings_of(manifest) if one.text.startswith("walls.contact[1]: the recipe says that cavity")
    ]
    assert [one.grade for one in found] == ["anatomy"]


def test_a_scan_and_markers_become_a_sound_case(built):
    _, _, result = built
    assert check_bundle(result.case) == ()
    bundle = open_bundle(result.case)
    # A shell from 14 to 20 mm: 4/3 pi (20^3 - 14^3) = 22.0 ml; the border moves by less than a third of a voxel.
    true_ml = 4 / 3 * np.pi * (20**3 - 14**3) / 1000
    assert bundle.manifest.simulation.tissue_volume_ml == pytest.approx(true_ml, rel=0.08)
    assert {entry.role for entry in bundle.manifest.files} == {role for role in FileRole if role.level == 0} - {
        FileRole.SCAN
    }
    case_id = bundle.manifest.case_id
    assert case_id
    assert f'"extras":{{"case_id":"{case_id}"}}'.encode() in bundle.path(FileRole.RENDER).read_bytes()
    assert f"heartcase_case_id:={case_id}\n".encode() in bundle.path(FileRole.LABELS).read_bytes()
    vertices = bundle.arrays(FileRole.SURFACE, ["vertices"])["vertices"]
    radius = np.linalg.norm(vertices, axis=1)
    inner, outer = radius[radius < 17], radius[radius >= 17]
    assert np.median(inner) == pytest.approx(14, abs=0.6)
    assert np.median(outer) == pytest.approx(20, abs=0.6)
    label = bundle.arrays(FileRole.SURFACE, ["vertex_label"])["vertex_label"]
    assert (label[radius < 17] == 1).all()
    assert (label[radius >= 17] == 0).all()


def test_stages_are_recorded_in_their_order_although_two_run_at_once(built):
    _, _, result = built
    recorded = [record.stage for record in result.manifest.stages]
    assert recorded == [stage for stage in stage_names() if stage in recorded]
    assert {"grid", "surface"} < set(recorded)
    assert min(result.seconds["grid"], result.seconds["surface"]) > 0.0


def test_a_surface_is_kept_when_the_grid_beside_it_fails(scan_directory, tmp_path):
    path = make_recipe(scan_directory, tmp_path)
    sound = path.read_text()
    path.write_text(sound.replace("position_mm = [0, 0, 20]", "position_mm = [0, 0, 200]"))
    assert path.read_text() != sound
    with pytest.raises(HeartcaseError, match="pins"):
        build(path, tmp_path / "out")
    path.write_text(sound)
    assert "surface" in build(path, tmp_path / "out").reused


def test_the_second_build_computes_and_writes_nothing(built):
    path, out, first = built
    before = {p: p.stat().st_mtime_ns for p in [*first.case.iterdir(), first.report]}
    second = build(path, out)
    assert not second.changed
    assert set(second.reused) >= {"filter", "segment", "walls", "grid", "surface", "map", "bundle"}
    assert before == {p: p.stat().st_mtime_ns for p in [*first.case.iterdir(), first.report]}


def test_a_forced_build_and_one_elsewhere_give_the_same_bytes(built, scan_directory, tmp_path):
    path, _out, first = built
    before = contents(first.case)
    other = make_recipe(scan_directory, tmp_path / "elsewhere")
    assert contents(build(other, tmp_path / "out", force=True).case) == before
    assert path != other


def test_only_what_depends_on_a_changed_setting_is_computed_again(built, scan_directory, tmp_path):
    _, out, _first = built
    changed = make_recipe(scan_directory, tmp_path / "changed", cell_mm=5.0)
    result = build(changed, tmp_path / "out", cache=out / ".heartcase-cache")
    assert set(result.reused) == {"filter", "segment", "walls", "surface"}
    assert open_bundle(result.case).manifest.simulation.cell_mm == 5.0


def test_parts_that_are_not_wanted_are_not_made(built, scan_directory, tmp_path):
    _, out, _first = built
    bare = make_recipe(scan_directory, tmp_path / "bare", parts="parts = []")
    result = build(bare, tmp_path / "out", cache=out / ".heartcase-cache")
    assert [entry.role for entry in result.manifest.files] == [FileRole.GRID]
    assert "surface" not in result.seconds


def test_stopping_early_leaves_the_case_alone_and_the_work_in_the_cache(built, scan_directory, tmp_path):
    path = make_recipe(scan_directory, tmp_path / "until")
    result = build(path, tmp_path / "out", until="walls")
    assert result.case is None
    assert not (tmp_path / "out" / "ball.case").exists()
    assert set(result.seconds) == {"read", "filter", "markers", "segment", "walls"}
    with pytest.raises(UsageError, match="there is no stage"):
        build(path, tmp_path / "out", until="wall")


def test_a_missing_scan_is_explained_and_the_old_case_stays(built):
    path, out, first = built
    before = contents(first.case)
    text = path.read_text()
    try:
        broken = text.replace('JANE-DOE.nii.gz"', 'gone.nii.gz"\norigin = "ask the archive for it"')
        path.write_text(broken)
        with pytest.raises(ScanError, match="ask the archive for it"):
            build(path, out)
    finally:
        path.write_text(text)
    assert contents(first.case) == before


def test_no_patient_name_from_a_path_is_in_any_output(scan_directory, tmp_path):
    """In a process of its own, so that the report has its pictures and their captions."""
    path = make_recipe(scan_directory, tmp_path / "named")
    out = tmp_path / "out"
    command = [sys.executable, "-m", "heartcase", "build", str(path), "--out", str(out)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "JANE" not in run.stdout + run.stderr
    report = (out / "ball.report.html").read_text()
    assert report.count("data:image/") > 10
    for file in out.rglob("*"):
        assert "JANE" not in file.name
        if file.is_file():
            assert b"JANE" not in file.read_bytes(), file.name


def memoised(monkeypatch):
    """Compute each stage once for the whole test: the files are what is tested."""
    for module, name in (
        ("formats.read_scan", "read_scan"),
        ("image.filter_scan", "filter_scan"),
        ("watershed.segment_scan", "segment_scan"),
        ("walls.grow_walls", "grow_walls"),
        ("walls.grow_walls", "structure_volumes_ml"),
        ("cells.build_grid", "build_grid"),
        ("mesh.build_surface", "build_surface"),
        ("cells.map_surface", "map_surface"),
        ("report.build_report", "build_report"),
        ("bundle.glb", "glb_bytes"),
        ("formats.write_images", "segmentation_nrrd_bytes"),
    ):
        loaded = importlib.import_module(f"heartcase.pipeline.{module}")
        function = getattr(loaded, name)
        outputs = {}

        @functools.wraps(function)
        def once(*args, _function=function, _outputs=outputs, **kwargs):
            if "output" not in _outputs:
                _outputs["output"] = _function(*args, **kwargs)
            return _outputs["output"]

        monkeypatch.setattr(loaded, name, once)


@pytest.mark.parametrize("stride", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_a_crash_at_any_file_operation_of_a_build_leaves_a_whole_case_and_the_next_build_resumes(
    stride, scan_directory, tmp_path, monkeypatch
):
    memoised(monkeypatch)
    old = make_recipe(scan_directory, tmp_path / "recipe")
    old.write_text(old.read_text().replace('name = "ball"', 'name = "ball"\nlandmarks = []'))
    build(old, tmp_path / "old")
    new = tmp_path / "recipe" / "new.toml"
    point = '[[landmarks]]\nname = "apex"\nkind = "point"\npoints_mm = [[0, 0, 20]]\n'
    new.write_text(old.read_text().replace("landmarks = []", "") + point)
    build(new, tmp_path / "new")
    old_case, new_case = contents(tmp_path / "old" / "ball.case"), contents(tmp_path / "new" / "ball.case")
    assert old_case["case.json"] != new_case["case.json"]
    new_page = (tmp_path / "new" / "ball.report.html").read_bytes()
    seen = set()
    operations = 0
    while True:
        out = tmp_path / "out"
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        shutil.copytree(tmp_path / "old" / "ball.case", out / "ball.case")
        try:
            with crash_after(operations):
                build(new, out)
        except Crash:
            assert check_bundle(out / "ball.case") == (), f"after operation {operations}"
            manifest = (out / "ball.case" / "case.json").read_bytes()
            assert manifest in (old_case["case.json"], new_case["case.json"])
            seen.add(manifest)
            stored = {p.name.split("-")[0] for p in (out / ".heartcase-cache").glob("[a-z]*-*.json")}
            stored -= {"basins", "bundle"}
            resumed = build(new, out)
            assert stored <= set(resumed.reused), f"after operation {operations}"
            assert contents(out / "ball.case") == new_case
            # Whether the crash came before the report, while it was written or after it.
            assert (out / "ball.report.html").read_bytes() == new_page
            assert not list(out.rglob(".heartcase-tmp-*"))
            operations += stride
            continue
        break
    assert operations > 60
    assert len(seen) == 2


@pytest.mark.skipif(os.name != "posix", reason="sends SIGKILL")
def test_a_killed_build_resumes(built, scan_directory, tmp_path):
    _, _, first = built
    path = make_recipe(scan_directory, tmp_path / "killed")
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "heartcase", "build", str(path), "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not list(out.glob(".heartcase-cache/walls-*.json")):
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (out / "ball.case" / "case.json").exists() or check_bundle(out / "ball.case") == ()
    result = build(path, out)
    assert {"filter", "segment", "walls"} <= set(result.reused)
    assert contents(result.case) == contents(first.case)


def test_the_report_names_every_stage_and_structure(built):
    text = built[2].report.read_text()
    for word in ("cavity", "muscle", "Not a medical device", "ball"):
        assert word in text
    assert all(stage in text for stage in stage_names() if stage != "edit")


def test_the_command_line_reports_as_json(built):
    path, out, _ = built
    run = subprocess.run(
        [sys.executable, "-m", "heartcase", "build", str(path), "--out", str(out), "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    data = json.loads(run.stdout)
    assert data["changed"] is False
    assert data["simulation"]["cell_mm"] == 4.0


def test_an_error_of_a_stage_is_one_line_and_exit_code_one(scan_directory, tmp_path):
    path = make_recipe(scan_directory, tmp_path / "unpinned")
    path.write_text(path.read_text().replace("position_mm = [0, 0, 20]", "position_mm = [0, 0, 200]"))
    with pytest.raises(HeartcaseError):
        build(path, tmp_path / "out")
    run = subprocess.run(
        [sys.executable, "-m", "heartcase", "build", str(path), "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 1
    assert "Traceback" not in run.stderr
    assert [line for line in run.stderr.splitlines() if line.startswith("heartcase: ")]


def test_a_damaged_case_is_mended_by_building_again(tmp_path):
    """Also where the damage left every size as it was, or put a link in a file's place."""
    write_ball_scan(tmp_path / "ball.nii.gz")
    recipe = load_recipe(write_ball_recipe(tmp_path / "ball.nii.gz", tmp_path / "ball.toml", cell_mm=5.0))
    build_case(recipe, directory=tmp_path, out=tmp_path)
    case = tmp_path / "ball.case"
    grid, report = next(case.glob("grid-*")), tmp_path / "ball.report.html"
    sound = grid.read_bytes()
    page = report.read_bytes()

    def flip():
        damaged = bytearray(sound)
        damaged[-3] ^= 1
        grid.write_bytes(damaged)

    def link():
        (tmp_path / "elsewhere").write_bytes(sound)
        grid.unlink()
        grid.symlink_to(tmp_path / "elsewhere")

    for damage in (flip, link, lambda: report.write_text("another page")):
        damage()
        result = build_case(recipe, directory=tmp_path, out=tmp_path)
        assert "bundle" not in result.reused
        assert check_bundle(case) == ()
        assert not grid.is_symlink()
        assert b"Bundle hash" in report.read_bytes()
    assert "bundle" in build_case(recipe, directory=tmp_path, out=tmp_path).reused
    assert len(page) > 1000


def test_a_case_whose_report_cannot_be_drawn_is_whole_and_the_next_build_draws_it(tmp_path, monkeypatch):
    """The case comes first, for whoever waits for it; its report is that of the old case until it is drawn."""
    write_ball_scan(tmp_path / "ball.nii.gz")
    path = write_ball_recipe(tmp_path / "ball.nii.gz", tmp_path / "ball.toml", cell_mm=5.0)
    case, report = tmp_path / "ball.case", tmp_path / "ball.report.html"
    build_case(load_recipe(path), directory=tmp_path, out=tmp_path)
    old, page = (case / "case.json").read_bytes(), report.read_bytes()
    path.write_text(path.read_text().replace("cell_mm = 5.0", "cell_mm = 6.0"))

    def fail(_):
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr("heartcase.pipeline.report.build_report.build_report", fail)
        with pytest.raises(MemoryError):
            build_case(load_recipe(path), directory=tmp_path, out=tmp_path)
    new = (case / "case.json").read_bytes()
    assert check_bundle(case) == ()
    assert new != old
    assert report.read_bytes() == page
    result = build_case(load_recipe(path), directory=tmp_path, out=tmp_path)
    assert not result.changed
    assert "bundle" not in result.reused
    assert (case / "case.json").read_bytes() == new
    assert hashlib.sha256(new).hexdigest().encode() in report.read_bytes()
    assert "bundle" in build_case(load_recipe(path), directory=tmp_path, out=tmp_path).reused


def test_the_case_is_told_of_before_its_report_is_drawn(tmp_path, monkeypatch):
    write_ball_scan(tmp_path / "ball.nii.gz")
    path = write_ball_recipe(tmp_path / "ball.nii.gz", tmp_path / "ball.toml", cell_mm=5.0)
    heard = []

    class Ear:
        def stage_started(self, stage, *, seconds_expected, seconds_after):
            heard.append((stage, "started", (tmp_path / "ball.case" / "case.json").exists()))
            assert (seconds_after == 0.0) == (stage == "report")

        def stage_finished(self, stage, *, seconds, reused):
            heard.append((stage, "finished", (tmp_path / "ball.report.html").exists()))

    build_case(load_recipe(path), directory=tmp_path, out=tmp_path, listener=Ear())
    assert heard[-4:] == [
        ("bundle", "started", False),
        ("bundle", "finished", False),
        ("report", "started", True),
        ("report", "finished", True),
    ]


def test_the_same_recipe_gives_the_same_bytes_whatever_was_built_before(tmp_path):
    """A setting that changes no array is still in the case's provenance."""
    write_ball_scan(tmp_path / "ball.nii.gz")
    path = write_ball_recipe(tmp_path / "ball.nii.gz", tmp_path / "ball.toml", cell_mm=5.0)
    build_case(load_recipe(path), directory=tmp_path, out=tmp_path / "one")
    path.write_text(path.read_text().replace("radius_mm = 8\n", "radius_mm = 8.01\n"))
    recipe = load_recipe(path)
    for out in ("one", "two"):
        build_case(recipe, directory=tmp_path, out=tmp_path / out)
    one, two = (tmp_path / out / "ball.case" / "case.json" for out in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()
    assert b"8.01" in one.read_bytes()


def test_another_case_is_not_replaced_in_silence(tmp_path):
    write_ball_scan(tmp_path / "ball.nii.gz")
    path = write_ball_recipe(tmp_path / "ball.nii.gz", tmp_path / "ball.toml", cell_mm=5.0)
    first = build_case(load_recipe(path), directory=tmp_path, out=tmp_path).manifest
    path.write_text(path.read_text() + "[region]\ncenter_mm = [0, 0, 0]\nsize_mm = [60, 60, 60]\n")
    assert build_case(load_recipe(path), directory=tmp_path, out=tmp_path).manifest.case_id == first.case_id
    scan = SimpleITK.ReadImage(str(tmp_path / "ball.nii.gz"))
    SimpleITK.WriteImage(scan + 1.0, str(tmp_path / "ball.nii.gz"))
    for until in (None, "bundle"):
        with pytest.raises(BundleError, match="another case of this name"):
            build_case(load_recipe(path), directory=tmp_path, out=tmp_path, until=until)
    assert open_bundle(tmp_path / "ball.case").manifest.case_id == first.case_id
    second = build_case(load_recipe(path), directory=tmp_path, out=tmp_path, replace=True).manifest
    assert second.case_id != first.case_id


def test_files_of_others_in_a_case_are_never_removed(tmp_path):
    write_ball_scan(tmp_path / "ball.nii.gz")
    recipe = load_recipe(write_ball_recipe(tmp_path / "ball.nii.gz", tmp_path / "ball.toml", cell_mm=5.0))
    case = tmp_path / "ball.case"
    case.mkdir()
    (case / "labels-hand-made.nrrd").write_bytes(b"mine")
    with pytest.raises(BundleError, match="something else"):
        build_case(recipe, directory=tmp_path, out=tmp_path)
    assert (case / "labels-hand-made.nrrd").read_bytes() == b"mine"
