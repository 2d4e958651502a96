"""A finished segmentation in, a case, and its labels out and in again: identical."""

import json
import shutil

import nibabel
import nrrd
import numpy as np
import pydicom
import pytest
from scipy.spatial.transform import Rotation

from heartcase.cli.main import main
from heartcase.pipeline.cautions import Severity, severity_of
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.formats.write_dicom_seg import dicom_seg_bytes
from heartcase.pipeline.markers import load_segmentation
from heartcase.pipeline.run import build_case
from heartcase.pipeline.write import write_segmentation
from heartcase.schemas.bundle_reader import open_bundle
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table
from heartcase.schemas.recipe import load_recipe
from tests.cli.small_case import write_case
from tests.pipeline.formats.dicom_series import write_series

TURN = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix()
SIZE, SPACING = np.array((30, 26, 20)), np.array((1.5, 1.75, 2.25))
SCAN = Geometry.of(
    shape=tuple(SIZE[::-1]), origin_mm=-TURN @ ((SIZE - 1) * SPACING / 2), spacing_mm=SPACING, direction=TURN
)
RECIPE = """
heartcase_recipe = 1
name = "finished"
parts = ["labels"]
[scan]
path = "Jane Doe"
[region]
center_mm = [0, 0, 0]
size_mm = [40, 40, 38]
[segment]
method = "labels"
file = "finished.seg.nrrd"
[filter]
iterations = 1
[[pins]]
position_mm = [0, 0, 14]
radius_mm = 6
[grid]
cell_mm = 4
"""


def painted(radius_mm=9.0):
    """A ventricle in its myocardium, with half an aorta beside it, on the scan's lattice."""
    k, j, i = np.meshgrid(*[np.arange(n) for n in SCAN.shape], indexing="ij")
    points = SCAN.index_to_world(np.stack([i, j, k], axis=-1))
    distance = np.linalg.norm(points, axis=-1)
    labels = np.where(distance < radius_mm, 1, np.where(distance < 15.0, 9, 0)).astype(np.uint8)
    labels[np.linalg.norm(points - (6, 6, 10), axis=-1) < 4.0] = 5
    return Segmentation(labels, SCAN, default_label_table())


class Told:
    def __init__(self):
        self.computed = []

    def stage_started(self, stage, *, seconds_expected, seconds_after):
        self.computed.append(stage)

    def stage_finished(self, stage, *, seconds, reused):
        pass


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    directory = tmp_path_factory.mktemp("labels")
    values = (painted().labels * 20 + np.arange(SCAN.size[0])).astype(np.int16)
    write_series(
        directory / "Jane Doe",
        values,
        SCAN.index_to_world([(0, 0, k) for k in range(SCAN.size[2])]),
        orientation=TURN[:, :2].T.ravel(),
        pixel_spacing=(SPACING[1], SPACING[0]),
        FrameOfReferenceUID="1.2.826.0.1.3680043.8.498.4711",
        PatientName="Doe^Jane",
        PatientID="JANE42",
        StudyDate="20230117",
    )
    write_segmentation(painted(), directory / "finished.seg.nrrd")
    (directory / "recipe.toml").write_text(RECIPE)
    build_case(load_recipe(directory / "recipe.toml"), directory=directory, out=directory)
    return directory


@pytest.fixture(scope="module")
def case(built):
    """The labels as they are in the case, and the case."""
    path = built / "finished.case"
    manifest = open_bundle(path).manifest
    entry = next(entry for entry in manifest.files if entry.role.value == "labels")
    values, header = nrrd.read(str(path / entry.name))
    assert header["space"] == "left-posterior-superior"
    return values.transpose(2, 1, 0), manifest, path


def export(path, out, *options):
    return main(["export", str(path), "--out", str(out), *map(str, options)])


def test_finished_labels_are_in_the_case_as_they_are(case, built):
    labels, manifest, _ = case
    whole = painted()
    start = np.rint(SCAN.world_to_index(manifest.scan_geometry.origin_mm)).astype(int)[::-1]
    assert (start > 0).any()
    cut = tuple(slice(s, s + n) for s, n in zip(start, manifest.scan_geometry.shape, strict=True))
    for value in (1, 5):
        own, given = labels == value, whole.labels[cut] == value
        assert 2 * (own & given).sum() / (own.sum() + given.sum()) > 0.95


@pytest.mark.parametrize("suffix", [".seg.nrrd", ".dcm", ".nii.gz", ".nrrd"])
@pytest.mark.parametrize("with_scan", [False, True])
def test_case_labels_out_and_in_again_are_identical(case, built, tmp_path, suffix, with_scan):
    labels, manifest, path = case
    assert len(np.unique(labels)) >= 5
    if with_scan and suffix not in (".seg.nrrd", ".dcm"):
        assert export(path, tmp_path / f"x{suffix}", "--scan", built / "Jane Doe") == 2
        return
    options = ("--scan", built / "Jane Doe") if with_scan else ()
    for name in ("a", "b"):
        assert export(path, tmp_path / f"{name}{suffix}", *options) == 0
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    again = load_segmentation(tmp_path / f"a{suffix}", {}, manifest.labels, manifest.scan_geometry)
    np.testing.assert_array_equal(again.labels, labels)
    own = load_segmentation(tmp_path / f"a{suffix}", {}, manifest.labels, None)
    assert own.geometry.matches(manifest.scan_geometry, tolerance_mm=1e-4)
    np.testing.assert_array_equal(own.labels, labels)
    # on the whole scan each label lies where it lay in the cropped case
    whole = load_segmentation(tmp_path / f"a{suffix}", {}, manifest.labels, SCAN)
    np.testing.assert_array_equal(np.bincount(whole.labels.ravel())[1:], np.bincount(labels.ravel())[1:])


def test_the_exports_open_on_the_scan_and_hold_nobody(case, built, tmp_path, capsys):
    _, manifest, path = case
    for suffix in (".seg.nrrd", ".dcm", ".nii.gz", ".nrrd"):
        assert export(path, tmp_path / f"x{suffix}") == 0
        for secret in (b"Jane", b"JANE", b"20230117", b"4711", str(built).encode()):
            assert secret not in (tmp_path / f"x{suffix}").read_bytes()
    assert export(path, tmp_path / "y.dcm", "--scan", built / "Jane Doe") == 0
    alone, laid = pydicom.dcmread(tmp_path / "x.dcm"), pydicom.dcmread(tmp_path / "y.dcm")
    assert laid.FrameOfReferenceUID == "1.2.826.0.1.3680043.8.498.4711" != alone.FrameOfReferenceUID
    assert laid.PatientID == alone.PatientID == str(laid.PatientName)
    assert b"Jane" not in (tmp_path / "y.dcm").read_bytes()
    assert export(path, tmp_path / "y.seg.nrrd", "--scan", built / "Jane Doe") == 0
    offset = nrrd.read_header(str(tmp_path / "y.seg.nrrd"))["Segmentation_ReferenceImageExtentOffset"]
    index = SCAN.world_to_index(manifest.scan_geometry.origin_mm)
    np.testing.assert_allclose([int(n) for n in offset.split()], index, atol=1e-6)
    assert nibabel.load(tmp_path / "x.nii.gz").shape == manifest.scan_geometry.size
    capsys.readouterr()
    assert export(path, tmp_path / "z.dcm", "--json") == 0
    assert json.loads(capsys.readouterr().out)["bytes"] == (tmp_path / "z.dcm").stat().st_size


def test_labels_are_not_tied_to_another_patients_scan(case, built, tmp_path, capsys):
    _, _, path = case
    folder = tmp_path / "John Roe"
    shutil.copytree(built / "Jane Doe", folder)
    first = sorted(folder.iterdir())[SCAN.size[2] // 2]
    dataset = pydicom.dcmread(first)
    pixels = dataset.pixel_array.copy()
    pixels[13, 15] += 1
    dataset.PixelData = pixels.tobytes()
    dataset.save_as(first)
    for suffix in (".dcm", ".seg.nrrd"):
        assert export(path, tmp_path / f"x{suffix}", "--scan", folder) == 2
        said = capsys.readouterr().err
        assert "--scan: this is not the scan that the case was made from" in said
        assert "Roe" not in said
        assert not (tmp_path / f"x{suffix}").exists()


@pytest.mark.parametrize("suffix", [".seg.nrrd", ".dcm"])
def test_exported_labels_corrected_elsewhere_make_a_case_again(case, built, tmp_path, suffix):
    """What docs/labels.md promises: out, corrected, in again; the grown walls of the file are grown anew."""
    labels, manifest, path = case
    wall = manifest.labels["aorta wall"].value
    assert (labels == wall).any()
    corrected = labels.copy()
    corrected[labels == 1] = 9
    k, j, i = (int(n) for n in np.argwhere(labels == 1).mean(axis=0).round())
    corrected[k - 2 : k + 3, j - 3 : j + 4, i - 3 : i + 4] = 1
    if suffix == ".dcm":
        content = dicom_seg_bytes(Segmentation(corrected, manifest.scan_geometry, manifest.labels), case_id="HC-0001")
        (tmp_path / "finished.dcm").write_bytes(content)
    else:
        # as 3D Slicer does: the volume changed, the table of segments kept
        assert export(path, tmp_path / "x.seg.nrrd", "--scan", built / "Jane Doe") == 0
        values, header = nrrd.read(str(tmp_path / "x.seg.nrrd"))
        np.testing.assert_array_equal(values.T, labels)
        nrrd.write(str(tmp_path / "finished.seg.nrrd"), np.asfortranarray(corrected.T), header)
    text = RECIPE.replace("finished.seg.nrrd", f"finished{suffix}")
    (tmp_path / "recipe.toml").write_text(text.replace("Jane Doe", str(built / "Jane Doe")))
    result = build_case(load_recipe(tmp_path / "recipe.toml"), directory=tmp_path, out=tmp_path / "out")
    (note,) = [line for line in result.warnings if "grown again" in line]
    assert severity_of(note) is Severity.NOTE
    assert "the aorta wall is not taken from the finished segmentation" in note
    assert any("grown again" in line for line in result.manifest.warnings)
    assert "grown again" in result.report.read_text()
    entry = next(entry for entry in result.manifest.files if entry.role.value == "labels")
    again = nrrd.read(str(result.case / entry.name))[0].T
    for value in (1, 5, 9, wall):
        before, after = corrected == value, again == value
        overlap = 2 * (before & after).sum() / (before.sum() + after.sum())
        assert overlap > (0.85 if value == wall else 0.9), (value, overlap)


def test_what_cannot_be_exported_is_said(case, built, tmp_path, capsys):
    _, _, path = case
    assert export(path, tmp_path / "x.pdf") == 2
    assert "must end in one of: .seg.nrrd, .dcm" in capsys.readouterr().err
    bare, _ = write_case(tmp_path)
    assert export(bare, tmp_path / "x.dcm") == 2
    assert "made without labels: add 'labels' to parts" in capsys.readouterr().err
    assert not (tmp_path / "x.dcm").exists()


def test_a_corrected_segmentation_reruns_only_what_follows(built):
    recipe = load_recipe(built / "recipe.toml")
    told = Told()
    build_case(recipe, directory=built, out=built / "again", cache=built / ".heartcase-cache", listener=told)
    assert set(told.computed) == {"read", "segment", "bundle"}
    write_segmentation(painted(radius_mm=8.0), built / "finished.seg.nrrd")
    told = Told()
    try:
        result = build_case(
            recipe, directory=built, out=built / "again", cache=built / ".heartcase-cache", listener=told
        )
    finally:
        write_segmentation(painted(), built / "finished.seg.nrrd")
    assert result.changed
    assert told.computed == ["read", "segment", "walls", "grid", "bundle"]
    assert "filter" in result.reused
    assert "walls" not in result.reused
