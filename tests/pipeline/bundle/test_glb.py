from __future__ import annotations

import io
import json
import struct
from dataclasses import replace

import numpy as np
import pygltflib
import pytest
import trimesh
from PIL import Image

from heartcase.pipeline.bundle.glb import LPS_MM_TO_GLTF, glb_bytes
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import SurfaceSettings
from tests.pipeline.solids import lattice, tube, walled


@pytest.fixture(scope="module")
def surface():
    structures = walled(tube(6.0), 2.0, lattice((1.5, 1.5, 2.0), 11.0, centre=(40.0, -90.0, 7.0)))
    moved = walled(lambda p: tube(6.0)(p - [40.0, -90.0, 0.0]), 2.0, structures.geometry)
    return build_surface(moved, SurfaceSettings(triangle_count=3000, normal_map_size=128))


def chunks(data):
    magic, version, total = struct.unpack_from("<4sII", data, 0)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    text_length, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    assert text_length % 4 == 0
    start = 20 + text_length
    length, kind = struct.unpack_from("<I4s", data, start)
    assert kind == b"BIN\0"
    assert length % 4 == 0
    assert start + 8 + length == len(data)
    return json.loads(data[20:start]), data[start + 8 :]


def array(document, binary, number):
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    dtype = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
    assert view["byteOffset"] % 4 == 0
    assert view["byteLength"] == accessor["count"] * width * 4
    return np.frombuffer(binary, dtype, accessor["count"] * width, view["byteOffset"]).reshape(-1, width)


def test_structure_and_arrays(surface):
    document, binary = chunks(glb_bytes(surface))
    assert document["asset"]["version"] == "2.0"
    assert document["buffers"] == [{"byteLength": len(binary)}]
    primitives = document["meshes"][0]["primitives"]
    assert len(primitives) == 3
    shared = primitives[0]["attributes"]
    assert all(primitive["attributes"] == shared for primitive in primitives)
    position = array(document, binary, shared["POSITION"])
    assert np.array_equal(position, surface.vertices_mm[surface.render_to_welded])
    bounds = document["accessors"][shared["POSITION"]]
    assert np.array_equal(np.float32(bounds["min"]), position.min(axis=0))
    assert np.array_equal(np.float32(bounds["max"]), position.max(axis=0))
    assert np.array_equal(array(document, binary, shared["NORMAL"]), surface.normals[surface.render_to_welded])
    assert np.array_equal(array(document, binary, shared["TANGENT"]), surface.render_tangents)
    assert np.array_equal(array(document, binary, shared["TEXCOORD_0"]), surface.render_uv)
    indices = [array(document, binary, primitive["indices"]).reshape(-1, 3) for primitive in primitives]
    cut = surface.triangle_is_cut == 1
    assert np.array_equal(indices[0], surface.render_triangles[surface.triangle_label == 1])
    assert np.array_equal(indices[1], surface.render_triangles[~cut & (surface.triangle_label == 0)])
    assert np.array_equal(indices[2], surface.render_triangles[cut])
    materials = [document["materials"][primitive["material"]] for primitive in primitives]
    assert [material["name"] for material in materials] == ["cavity", "epicardium", "cut face"]
    colour = materials[0]["pbrMetallicRoughness"]["baseColorFactor"]
    # sRGB d0 = 208: ((208 / 255 + 0.055) / 1.055) ** 2.4
    assert colour[0] == pytest.approx(0.6308, abs=1e-4)
    assert colour[3] == 1.0
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= len(binary)


def test_the_picture_is_the_normal_map(surface):
    document, binary = chunks(glb_bytes(surface))
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    png = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    assert np.array_equal(np.array(Image.open(io.BytesIO(png))), surface.normal_map)
    assert b"tIME" not in png
    assert b"tEXt" not in png


def test_the_root_turns_patient_millimetres_into_metres_with_y_up(surface):
    scene = trimesh.load(io.BytesIO(glb_bytes(surface)), file_type="glb")
    low, high = scene.bounds
    mm = surface.vertices_mm.astype(float)
    expected = np.stack([mm[:, 0], mm[:, 2], -mm[:, 1]], axis=1) / 1000.0
    assert low == pytest.approx(expected.min(axis=0), abs=1e-6)
    assert high == pytest.approx(expected.max(axis=0), abs=1e-6)
    assert np.linalg.det(LPS_MM_TO_GLTF[:3, :3]) == pytest.approx(1e-9)
    whole = trimesh.util.concatenate([part.copy() for part in scene.geometry.values()])
    assert len(whole.faces) == len(surface.triangles)
    whole.merge_vertices(merge_tex=True, merge_norm=True)
    assert whole.volume == pytest.approx(surface.quality["volume_ml"] * 1000.0, rel=1e-4)


def test_an_independent_library_reads_it(surface):
    gltf = pygltflib.GLTF2.load_from_bytes(glb_bytes(surface))
    assert len(gltf.meshes[0].primitives) == 3
    assert gltf.textures[0].source == 0
    assert gltf.materials[0].normalTexture.index == 0


def test_without_a_map_there_is_no_texture():
    structures = walled(tube(6.0), 2.0, lattice(1.5, 10.0))
    plain = build_surface(structures, SurfaceSettings(triangle_count=1000), render=False)
    document, _ = chunks(glb_bytes(plain))
    assert set(document["meshes"][0]["primitives"][0]["attributes"]) == {"POSITION", "NORMAL"}
    assert not {"images", "textures", "samplers"} & set(document)


def test_the_same_bytes_twice(surface):
    assert glb_bytes(surface) == glb_bytes(surface)


@pytest.mark.parametrize("turned", [False, True])
def test_the_outside_looks_the_same_in_any_order_of_the_labels(surface, turned):
    names = ["morphologically right ventricular myocardium", "left ventricular myocardium"]
    muscles = [
        Label(value=value, name=name, role=Role.MYOCARDIUM)
        for value, name in zip((5, 6), reversed(names) if turned else names, strict=True)
    ]
    table = LabelTable(labels=(*surface.table, *muscles))
    document, _ = chunks(glb_bytes(replace(surface, table=table)))
    plain, _ = chunks(glb_bytes(surface))
    outside = [next(m for m in d["materials"] if m["name"] == "epicardium") for d in (document, plain)]
    colours = [material["pbrMetallicRoughness"]["baseColorFactor"] for material in outside]
    # #c1a29a, the colour of the left ventricle's myocardium in the default table, also where no label is one
    expected = [((int(c, 16) / 255 + 0.055) / 1.055) ** 2.4 for c in ("c1", "a2", "9a")]
    assert colours[0][:3] == pytest.approx(expected, abs=1e-6)
    assert colours[1] == colours[0]
