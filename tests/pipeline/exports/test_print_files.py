"""PLY and 3MF, read by others and by what their specifications say."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
import pyvista
import trimesh

from heartcase.pipeline.exports.ply_and_3mf import ply_bytes, three_mf_bytes
from tests.pipeline.exports.shapes import TABLE, hollow_ball

CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
TITLE = "hollow model of case HC-0001"


@pytest.fixture(scope="module")
def mesh():
    ball = hollow_ball()
    return replace(ball, vertices_mm=ball.vertices_mm + np.array([14.98765, -73.3333, 7.77777], np.float32))


def test_ply_holds_every_face_with_label_and_colour(mesh, tmp_path):
    content = ply_bytes(mesh, case_id="HC-0001")
    assert content == ply_bytes(mesh, case_id="HC-0001")
    header = content[: content.index(b"end_header")].decode("ascii")
    assert "comment SPACE=LPS\ncomment patient LPS, mm; case HC-0001\n" in header
    assert "comment label 2 aorta\n" in header
    read = trimesh.load(io.BytesIO(content), file_type="ply", process=False)
    np.testing.assert_array_equal(read.vertices, mesh.vertices_mm)
    np.testing.assert_array_equal(read.faces, mesh.triangles)
    np.testing.assert_array_equal(read.vertex_normals.astype(np.float32), mesh.normals)
    faces = read.metadata["_ply_raw"]["face"]["data"]
    for name, expected in (
        ("label", mesh.triangle_label),
        ("tissue", mesh.triangle_tissue),
        ("is_cut", mesh.triangle_is_cut),
    ):
        np.testing.assert_array_equal(np.asarray(faces[name]).ravel(), expected)
    colours = {value: [int(TABLE[value].colour[at : at + 2], 16) for at in (1, 3, 5)] for value in (1, 7)}
    expected = np.where((mesh.triangle_label == 1)[:, None], colours[1], colours[7])
    np.testing.assert_array_equal(read.visual.face_colors[:, :3], expected)
    (tmp_path / "model.ply").write_bytes(content)
    seen = pyvista.read(tmp_path / "model.ply")
    assert (seen.n_points, seen.n_cells) == (len(mesh.vertices_mm), len(mesh.triangles))
    np.testing.assert_array_equal(seen.cell_data["RGB"], expected)


def test_3mf_is_what_the_core_specification_asks_for(mesh):
    content = three_mf_bytes(mesh, title=TITLE)
    assert content == three_mf_bytes(mesh, title=TITLE)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        types = ElementTree.fromstring(archive.read("[Content_Types].xml"))
        relations = ElementTree.fromstring(archive.read("_rels/.rels"))
        root = ElementTree.fromstring(archive.read(relations[0].get("Target").removeprefix("/")))
    assert {entry.get("Extension") for entry in types} == {"rels", "model"}
    assert relations[0].get("Type") == "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    assert (root.tag, root.get("unit")) == (f"{CORE}model", "millimeter")
    assert root.find(f"{CORE}metadata[@name='Title']").text == TITLE
    (group,) = root.iter(f"{CORE}basematerials")
    (thing,) = root.iter(f"{CORE}object")
    (item,) = root.iter(f"{CORE}item")
    assert item.get("objectid") == thing.get("id") != group.get("id") == thing.get("pid")
    assert [(base.get("name"), base.get("displaycolor")) for base in group] == [
        ("left ventricle", "#D41515FF"),
        ("muscle", "#A0A0A0FF"),
    ]
    vertices = np.array([[float(v.get(axis)) for axis in "xyz"] for v in root.iter(f"{CORE}vertex")], np.float32)
    np.testing.assert_array_equal(vertices, mesh.vertices_mm)
    faces = [[int(t.get(key)) for key in ("v1", "v2", "v3", "p1")] for t in root.iter(f"{CORE}triangle")]
    np.testing.assert_array_equal(np.array(faces)[:, :3], mesh.triangles)
    np.testing.assert_array_equal(np.array(faces)[:, 3], np.where(mesh.triangle_label == 1, 0, 1))
    assert {t.get("pid") for t in root.iter(f"{CORE}triangle")} == {group.get("id")}
    move = np.array([float(number) for number in item.get("transform").split()]).reshape(4, 3)
    np.testing.assert_array_equal(move[:3], np.eye(3))
    placed = vertices + move[3]
    assert ((placed.min(axis=0) >= 0.0) & (placed.min(axis=0) < 0.002)).all()


def test_3mf_in_trimesh(mesh):
    pytest.importorskip("lxml", reason="trimesh reads 3MF with lxml")
    scene = trimesh.load_scene(io.BytesIO(three_mf_bytes(mesh, title=TITLE)), file_type="3mf")
    assert scene.units == "millimeter"
    read = scene.to_mesh()
    assert read.is_watertight
    assert read.is_winding_consistent
    own = trimesh.Trimesh(mesh.vertices_mm.astype(float), mesh.triangles, process=False)
    assert read.volume == pytest.approx(own.volume, rel=1e-6)
    assert read.extents == pytest.approx(own.extents, abs=1e-4)


def test_3mf_in_its_consortiums_library(mesh):
    lib3mf = pytest.importorskip("lib3mf", reason="the reference implementation of 3MF is not installed")
    document = lib3mf.get_wrapper().CreateModel()
    reader = document.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromBuffer(three_mf_bytes(mesh, title=TITLE))
    assert reader.GetWarningCount() == 0
    assert document.GetUnit() == lib3mf.ModelUnit.MilliMeter
    things = document.GetMeshObjects()
    assert things.MoveNext()
    thing = things.GetCurrentMeshObject()
    assert thing.IsManifoldAndOriented()
    assert thing.GetName() == TITLE
    assert (thing.GetVertexCount(), thing.GetTriangleCount()) == (len(mesh.vertices_mm), len(mesh.triangles))
    assert not things.MoveNext()
