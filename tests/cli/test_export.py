"""A finished segmentation in, a case, and its labels out and in again: identical."""

import json
import shutil
import zipfile
from dataclasses import replace

import meshio
import nibabel
import nrrd
import numpy as np
import pydicom
import pytest
import pyvista
import trimesh
from scipy.spatial.transform import Rotation

from heartcase.cli.main import main
from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.exports import models
from heartcase.pipeline.formats.labels.write_dicom_seg import dicom_seg_bytes
from heartcase.pipeline.formats.write_images import write_segmentation
from heartcase.pipeline.markers.load_markers import load_segmentation
from heartcase.pipeline.warnings import WarningGrade
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle, read_manifest
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table
from heartcase.schemas.recipe.recipe import load_recipe
from tests.cli.small_case import write_case
from tests.pipeline.formats.dicom_series import write_series

pytestmark = pytest.mark.usefixtures("plain_reports")

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


VESSELS = """
[[landmarks]]
name = "right coronary artery"
kind = "polyline"
points_mm = [[12, 0, 0], [8, 9, 2], [0, 12, 4]]
radius_mm = 1.5
[[landmarks]]
name = "great cardiac vein"
kind = "polyline"
points_mm = [[-12, 0, 0], [-12, 0, 10]]
radius_mm = 1
[[landmarks]]
name = "incision"
kind = "polyline"
points_mm = [[0, 0, 12], [4, 0, 12]]
depth_mm = 3
"""


@pytest.fixture(scope="module")
def whole(built):
    """A case of the same scan with a surface too."""
    text = RECIPE.replace('name = "finished"', 'name = "whole"').replace(
        '["labels"]', '["labels", "surface", "render"]'
    )
    (built / "whole.toml").write_text(text + "[surface]\ntriangle_count = 4000\nnormal_map_size = 0\n" + VESSELS)
    return build_case(load_recipe(built / "whole.toml"), directory=built, out=built).case


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
    (note,) = [line for line in result.warnings if "grown again" in line.text]
    assert note.grade is WarningGrade.NOTE
    assert "the aorta wall is not taken from the finished segmentation" in note.text
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
    assert (
        "must end in one of: .seg.nrrd, .dcm, .nii.gz, .nrrd, .stl, .ply, .3mf, .glb, .vtu," in capsys.readouterr().err
    )
    bare, _ = write_case(tmp_path)
    assert export(bare, tmp_path / "x.dcm") == 2
    assert "made without labels: add 'labels' to parts" in capsys.readouterr().err
    assert not (tmp_path / "x.dcm").exists()


def test_a_corrected_segmentation_reruns_only_what_follows(built):
    recipe = load_recipe(built / "recipe.toml")
    told = Told()
    build_case(recipe, directory=built, out=built / "again", cache=built / ".heartcase-cache", listener=told)
    assert set(told.computed) == {"read", "segment", "bundle", "report"}
    write_segmentation(painted(radius_mm=8.0), built / "finished.seg.nrrd")
    told = Told()
    try:
        result = build_case(
            recipe, directory=built, out=built / "again", cache=built / ".heartcase-cache", listener=told
        )
    finally:
        write_segmentation(painted(), built / "finished.seg.nrrd")
    assert result.changed
    assert told.computed == ["read", "segment", "walls", "grid", "bundle", "report"]
    assert "filter" in result.reused
    assert "walls" not in result.reused


MODELS = [
    *(
        (model, suffix)
        for model in ("hollow", "solid", "vessels")
        for suffix in (".stl", ".ply", ".3mf", ".vtu", ".vtk")
    ),
    *(("cells", suffix) for suffix in (".inp", ".msh", ".vtu", ".vtk")),
    ("hollow", ".glb"),
]


@pytest.mark.parametrize(("model", "suffix"), MODELS)
def test_models_are_the_same_bytes_and_hold_nobody(whole, built, tmp_path, capsys, model, suffix):
    for name in ("a", "b"):
        assert export(whole, tmp_path / f"{name}{suffix}", "--model", model) == 0
    content = (tmp_path / f"a{suffix}").read_bytes()
    assert content == (tmp_path / f"b{suffix}").read_bytes()
    if suffix == ".3mf":
        with zipfile.ZipFile(tmp_path / f"a{suffix}") as archive:
            content += archive.read("3D/3dmodel.model")
    for secret in (b"Jane", b"JANE", b"20230117", b"1.2.826.0.1.3680043", b"whole", str(built).encode()):
        assert secret not in content
    said = capsys.readouterr()
    assert said.out.count("wrote ") == 2
    assert all(line.startswith("warning: ") for line in said.err.splitlines())


def test_the_glb_is_the_cases_own_and_is_refused_when_it_is_damaged(whole, case, tmp_path, capsys):
    own = read_manifest(whole).file(FileRole.RENDER)
    assert export(whole, tmp_path / "heart.glb") == 0
    assert (tmp_path / "heart.glb").read_bytes() == (whole / own.name).read_bytes()
    capsys.readouterr()
    assert export(whole, tmp_path / "x.glb", "--model", "solid") == 2
    assert ".glb holds hollow" in capsys.readouterr().err
    assert export(case[2], tmp_path / "x.glb") > 0
    assert "no part 'render'" in capsys.readouterr().err
    broken = tmp_path / "broken.case"
    shutil.copytree(whole, broken)
    content = bytearray((broken / own.name).read_bytes())
    content[-1] ^= 1
    (broken / own.name).write_bytes(content)
    assert export(broken, tmp_path / "x.glb") > 0
    assert "is damaged" in capsys.readouterr().err
    assert not (tmp_path / "x.glb").exists()


def test_printed_models_are_closed_and_as_large_as_the_case_says(whole, tmp_path, capsys):
    manifest = open_bundle(whole).manifest
    volumes = manifest.quality["volumes_ml"]
    tissue = sum(volumes[label.name] for label in manifest.labels if label.role.is_tissue and label.name in volumes)
    blood = sum(volumes[label.name] for label in manifest.labels if label.role.is_blood and label.name in volumes)
    for model, expected in (("hollow", tissue), ("solid", blood)):
        capsys.readouterr()
        assert export(whole, tmp_path / "x.stl", "--model", model, "--json") == 0
        told = json.loads(capsys.readouterr().out)
        assert (told["format"], told["model"]) == (".stl", model)
        for suffix in (".stl", ".ply"):
            assert export(whole, tmp_path / f"x{suffix}", "--model", model) == 0
            mesh = trimesh.load(tmp_path / f"x{suffix}")
            assert mesh.is_watertight
            assert mesh.is_winding_consistent
            assert mesh.volume / 1000.0 == pytest.approx(expected, rel=0.03)
            assert told["print_check"]["volume_ml"] == pytest.approx(mesh.volume / 1000.0, rel=1e-5)
            assert told["print_check"]["extent_mm"] == pytest.approx(mesh.extents, abs=1e-3)
            shells = [shell.volume for shell in mesh.split(only_watertight=False)]
            assert told["print_check"]["piece_count"] == sum(volume > 0 for volume in shells)
            assert told["print_check"]["closed_hollow_count"] == sum(volume < 0 for volume in shells)
            # where the heart lies in the scan, not beside it or mirrored
            assert np.abs(mesh.bounds.mean(axis=0) - (3, 3, 2)).max() < 4.0
    assert export(whole, tmp_path / "default.stl") == 0
    assert export(whole, tmp_path / "hollow.stl", "--model", "hollow") == 0
    assert (tmp_path / "default.stl").read_bytes() == (tmp_path / "hollow.stl").read_bytes()


def test_an_exported_cast_read_as_an_stl_part_is_the_blood(whole, tmp_path, capsys):
    """The header says LPS, so nothing is assumed, and the voxels are those of the case."""
    labels = load_segmentation(tmp_path / "l.nrrd", {}, *_table_and_geometry(whole, tmp_path))
    (tmp_path / "parts").mkdir()
    assert export(whole, tmp_path / "parts" / "aorta.stl", "--model", "solid") == 0
    table, geometry = open_bundle(whole).manifest.labels, labels.geometry
    cast = load_segmentation(tmp_path / "parts", {}, table, geometry)
    assert cast.warnings == ()
    blood = np.isin(labels.labels, table.blood_values)
    inside = cast.labels == table["aorta"].value
    assert 2 * (blood & inside).sum() / (blood.sum() + inside.sum()) > 0.985


def _table_and_geometry(case, directory):
    manifest = open_bundle(case).manifest
    assert export(case, directory / "l.nrrd") == 0
    return manifest.labels, manifest.scan_geometry


def test_vessels_are_surfaces_of_their_own(whole, tmp_path, capsys):
    assert export(whole, tmp_path / "x.ply", "--model", "vessels") == 0
    solid = trimesh.load(tmp_path / "x.ply", process=False)
    parts = solid.split()
    assert len(parts) == 2
    straight = min(parts, key=lambda part: part.centroid[0])
    # Of a circle's area a regular polygon of 16 sides has 0.974.
    assert straight.volume == pytest.approx(np.pi * 10.0 + 4.0 / 3.0 * np.pi, rel=0.04)
    np.testing.assert_allclose(straight.bounds, [[-13, -1, -1], [-11, 1, 11]], atol=0.05)
    said = capsys.readouterr()
    assert f"wrote the vessels to {tmp_path / 'x.ply'}, " in said.out
    content = (tmp_path / "x.ply").read_bytes()
    assert b"label 1 right coronary artery" in content
    assert b"label 2 great cardiac vein" in content
    assert b"incision" not in content


def test_a_case_without_vessels_is_told(case, tmp_path, capsys):
    assert export(case[2], tmp_path / "x.stl", "--model", "vessels") == 2
    assert "--model: the case has no vessels of their own" in capsys.readouterr().err
    assert not (tmp_path / "x.stl").exists()


def test_thin_walls_are_warned_of_and_written_all_the_same(whole, tmp_path, capsys):
    assert export(whole, tmp_path / "x.stl", "--min-thickness-mm", 3, "--json") == 0
    said = capsys.readouterr()
    told = json.loads(said.out)
    (line,) = [line for line in said.err.splitlines() if "is thinner than 3 mm" in line]
    assert line == f"warning: {told['warnings'][0]}"
    thin = told["print_check"]["thin"]
    assert 0.05 < thin["area_fraction"] < 0.6
    # the wall that was grown around the aorta is 2 mm thick
    place = np.array(thin["largest_patch_mm"]) - (6, 6, 10)
    assert np.linalg.norm(place) < 8.0
    assert (tmp_path / "x.stl").stat().st_size == told["bytes"]
    assert export(whole, tmp_path / "x.stl", "--min-thickness-mm", 0.5) == 0
    assert "thinner" not in capsys.readouterr().err


def test_the_grid_as_hexahedra_has_the_volumes_of_the_case(whole, tmp_path):
    figures = open_bundle(whole).manifest.simulation
    assert export(whole, tmp_path / "x.msh") == 0
    assert export(whole, tmp_path / "x.vtu", "--model", "cells") == 0
    mesh = meshio.read(tmp_path / "x.msh")
    corners = mesh.points[mesh.cells_dict["hexahedron"]]
    edges = np.stack([corners[:, n] - corners[:, 0] for n in (1, 3, 4)], axis=1)
    volumes = np.linalg.det(edges)
    assert volumes.sum() == pytest.approx(figures.cell_count * figures.cell_mm**3, rel=1e-9)
    tissue = (volumes * mesh.cell_data["coverage"][0]).sum() / 1000.0
    assert tissue == pytest.approx(figures.tissue_volume_ml, rel=1e-6)
    seen = pyvista.read(tmp_path / "x.vtu")
    assert seen.cell_quality("scaled_jacobian")["scaled_jacobian"].min() == pytest.approx(1.0, abs=1e-9)
    assert seen["fixed"].sum() == figures.fixed_node_count


WRONG = [
    (
        ("x.stl", "--model", "cells"),
        "--model: .stl holds hollow, solid, vessels; cells is written as .inp, .msh, .vtu, .vtk",
    ),
    (
        ("x.inp", "--model", "hollow"),
        "--model: .inp holds cells; hollow is written as .stl, .ply, .3mf, .glb, .vtu, .vtk",
    ),
    (("x.dcm", "--model", "solid"), "--model: .dcm holds labels, and no model: leave it out"),
    (("x.vtu", "--min-thickness-mm", "2"), "--min-thickness-mm: serves only for .stl, .ply, .3mf: leave it out"),
    (("x.stl", "--scan", "nowhere"), "--scan: serves only for .seg.nrrd and .dcm: leave it out"),
    (("x.obj",), "--out: the file must end in one of: "),
]


@pytest.mark.parametrize(
    ("request_made", "says"), WRONG, ids=lambda value: value[0] if isinstance(value, tuple) else ""
)
def test_wrong_requests_are_told_in_one_line(whole, tmp_path, capsys, request_made, says):
    name, *options = request_made
    (tmp_path / name).write_bytes(b"as it was")
    assert export(whole, tmp_path / name, *options) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"heartcase: {says}")
    assert (tmp_path / name).read_bytes() == b"as it was"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_all_that_is_wrong_is_told_at_once(whole, tmp_path, capsys):
    assert export(whole, tmp_path / "x.inp", "--model", "solid", "--min-thickness-mm", "2", "--scan", "nowhere") == 2
    assert len(capsys.readouterr().err.splitlines()) == 3


def test_a_case_without_the_part_is_told(case, tmp_path, capsys):
    """The first case has labels and no surface, the second a surface and no labels."""
    _, _, path = case
    bare, _ = write_case(tmp_path)
    for source, model, part in ((path, "hollow", "surface"), (bare, "solid", "labels")):
        for suffix in (".stl", ".vtu"):
            target = tmp_path / f"x{suffix}"
            target.write_bytes(b"as it was")
            assert export(source, target, "--model", model) != 0
            (line,) = capsys.readouterr().err.splitlines()
            assert part in line
            assert "build" in line
            assert target.read_bytes() == b"as it was"
    assert export(path, tmp_path / "cells.vtk", "--model", "cells") == 0


def test_a_target_that_cannot_be_written_is_told(whole, tmp_path, capsys):
    for suffix in (".3mf", ".inp"):
        assert export(whole, tmp_path / "nowhere" / f"x{suffix}") == 2
        assert capsys.readouterr().err.splitlines()[-1].startswith("heartcase: --out: cannot be written: ")
        (tmp_path / f"folder{suffix}").mkdir()
        assert export(whole, tmp_path / f"folder{suffix}") == 2
        assert capsys.readouterr().err.splitlines()[-1].startswith("heartcase: --out: cannot be written: ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.3mf", "folder.inp"]


def test_a_surface_that_is_not_closed_is_refused(whole, tmp_path, capsys, monkeypatch):

    def with_a_gap(bundle, **more):
        mesh = hollow_model(bundle, **more)
        names = ("triangles", "triangle_label", "triangle_tissue", "triangle_is_cut", "triangle_kind")
        return replace(mesh, **{name: getattr(mesh, name)[1:] for name in names})

    hollow_model = models.hollow_model
    monkeypatch.setattr(models, "hollow_model", with_a_gap)
    (tmp_path / "x.stl").write_bytes(b"as it was")
    assert export(whole, tmp_path / "x.stl") == 1
    assert "surface: the surface is not closed at 3 edges" in capsys.readouterr().err
    assert (tmp_path / "x.stl").read_bytes() == b"as it was"
    # ParaView shows it all the same
    assert export(whole, tmp_path / "x.vtu") == 0
