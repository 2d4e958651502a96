"""What ``check_bundle`` finds, with the bounds it finds it by: a little beyond each, and a little within."""

from __future__ import annotations

import json
import math
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heartcase.pipeline.bundle.glb import glb_bytes
from heartcase.pipeline.bundle.write_bundle import (
    BundleParts,
    BundleRecord,
    BundleSource,
    assemble_bundle,
    write_bundle,
)
from heartcase.pipeline.cells.map_surface import map_surface
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.formats.write_images import segmentation_nrrd_bytes
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import Material
from heartcase.schemas.bundle.manifest import read_manifest, salvaged_manifest, stated
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.bundle.safetensors_layout import HEADER_SIZE_MAX
from heartcase.schemas.errors import BundleError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import MapSettings
from heartcase.schemas.strict_json import parse_json
from tests.cell_fields import structures_of_cells
from tests.factories import MYOCARDIUM, block_case, block_grid, block_surface
from tests.golden.make import CASE
from tests.readers.damage import CaseCopy


@pytest.fixture
def golden(tmp_path: Path) -> CaseCopy:
    shutil.copytree(CASE, tmp_path / "x.case")
    return CaseCopy(tmp_path / "x.case")


def said(case: CaseCopy | Path) -> list[str]:
    folder = case.folder if isinstance(case, CaseCopy) else case
    return [str(problem) for problem in check_bundle(folder)]


def places(case: CaseCopy) -> set[str]:
    return {problem.place for problem in check_bundle(case.folder)}


# -------------------------------------------------------------------------------------------------------------- bounds


@pytest.mark.parametrize(("off", "is_sound"), [(5e-5, True), (3e-4, False)])
def test_weights_sum_to_one_within_a_ten_thousandth(golden: CaseCopy, off: float, is_sound: bool) -> None:
    weights = golden.values("mapping", "weights")
    weights[0] += off
    golden.set_values("mapping", "weights", weights)
    assert ("mapping.weights" not in places(golden)) == is_sound


@pytest.mark.parametrize(("factor", "is_sound"), [(1 + 5e-7, True), (1 + 1e-5, False)])
def test_the_cells_edge_is_the_grids_spacing(golden: CaseCopy, factor: float, is_sound: bool) -> None:
    golden.manifest["simulation"]["cell_mm"] *= factor
    golden.save()
    assert ("grid_geometry.spacing_mm" not in places(golden)) == is_sound


@pytest.mark.parametrize(("factor", "is_sound"), [(1 + 5e-6, True), (1 + 5e-5, False), (1 - 5e-5, False)])
@pytest.mark.parametrize("figure", ["step_limit_s", "step_default_s", "steps_per_second", "tissue_volume_ml"])
def test_figures_follow_from_the_cells(golden: CaseCopy, figure: str, factor: float, is_sound: bool) -> None:
    golden.manifest["simulation"][figure] *= factor
    golden.save()
    assert (said(golden) == []) == is_sound


@pytest.mark.parametrize(("gap_mm", "is_sound"), [(0.009, True), (0.012, False)])
def test_the_mapping_gives_vertices_back_to_a_hundredth_of_a_mm(
    golden: CaseCopy, gap_mm: float, is_sound: bool
) -> None:
    offset = golden.values("mapping", "offset")
    offset[1] += gap_mm
    golden.set_values("mapping", "offset", offset)
    normal_only = golden.values("mapping", "curvature")[0] == 0
    assert normal_only
    assert ("mapping" not in places(golden)) == is_sound


@pytest.mark.parametrize(("array", "most"), [("cell_density", 2e4), ("cell_stiffness", 1e6), ("cell_coverage", 1.0)])
def test_cells_have_their_limits(golden: CaseCopy, array: str, most: float) -> None:
    for factor, is_sound in ((1.0, True), (1.001, False)):
        golden.set_values("grid", array, [most * factor, *golden.values("grid", array)[1:]])
        assert (f"must not be above {most:g}" not in "\n".join(said(golden))) == is_sound


def test_a_header_of_more_than_a_mebibyte_is_not_parsed(golden: CaseCopy) -> None:
    header, data = golden.header("grid")
    for size, is_read in ((HEADER_SIZE_MAX, True), (HEADER_SIZE_MAX + 64, False)):
        text = json.dumps(header).encode().ljust(size)
        golden.write("grid", struct.pack("<Q", size) + text + data)
        assert (any("header is too long" in line for line in said(golden))) != is_read
    assert HEADER_SIZE_MAX == 1 << 20


@given(st.integers(0, 2), st.integers(0, 2), st.integers(0, 2))
def test_a_grid_across_the_scans_axes_is_found(i: int, j: int, k: int) -> None:
    turned = np.eye(3)[[i, j, k]]
    if sorted((i, j, k)) != [0, 1, 2] or np.linalg.det(turned) < 0 or (i, j, k) == (0, 1, 2):
        return
    content = block_case()
    scan = Geometry.of(shape=(40, 40, 40), origin_mm=(-50, -80, -30), spacing_mm=(3, 3, 3), direction=turned)
    manifest = content.manifest.model_copy(update={"scan_geometry": scan})
    from heartcase.schemas.bundle.values import figure_problems

    assert [problem.place for problem in figure_problems(manifest)] == ["grid_geometry.direction"]
    assert [*figure_problems(content.manifest)] == []


# ------------------------------------------------------------------------------------------------------------ surfaces


@pytest.mark.parametrize("change", [lambda a: a[:-3] + a[-6:-3], lambda a: a[:3] * (len(a) // 3)])
@pytest.mark.parametrize("part", ["surface", "picking"])
def test_a_surface_with_a_hole_is_found(golden: CaseCopy, part: str, change) -> None:
    golden.set_values(part, "triangles", change(golden.values(part, "triangles")))
    assert f"{part}.triangles: leave the surface open" in "\n".join(said(golden))


def test_normals_that_point_inwards_everywhere_are_found(golden: CaseCopy) -> None:
    for part, array in (("surface", "normals"), ("mapping", "normal")):
        golden.set_values(part, array, [-x for x in golden.values(part, array)])
    assert "surface.normals: point into the tissue" in "\n".join(said(golden))


def test_one_node_that_is_not_near_is_found(golden: CaseCopy) -> None:
    bundle = open_bundle(golden.folder)
    grid = bundle.manifest.grid_geometry
    from heartcase.schemas.bundle.format import FileRole

    nodes = grid.index_to_world(bundle.arrays(FileRole.GRID)["nodes"] - 0.5)
    vertex = bundle.arrays(FileRole.SURFACE)["vertices"][7]
    distance = np.linalg.norm(nodes - vertex, axis=1)
    order = np.argsort(distance)
    nearest = golden.values("mapping", "nearest_node")
    for node in order.tolist():
        excess = (distance[node] - distance.min()) / grid.spacing_mm[0]
        if 1.9 < excess < 2.1:
            continue
        golden.set_values("mapping", "nearest_node", [*nearest[:7], node, *nearest[8:]])
        assert ("mapping.nearest_node" not in places(golden)) == (excess < 2.0)
        if excess > 3.0:
            break


# ------------------------------------------------------------------------------------------------------- GLB and labels


def glb_with(case: CaseCopy, change) -> None:
    """Change the JSON of the GLB; its lengths agree."""
    content = case.path("render").read_bytes()
    length = struct.unpack_from("<I", content, 12)[0]
    document = json.loads(content[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    case.write("render", head + text + rest)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: None, None),
        (lambda d: d["nodes"][0]["matrix"].__setitem__(0, -0.001), "mirrored"),
        (lambda d: d["nodes"][0]["matrix"].__setitem__(12, 1.0), "mirrored"),
        (lambda d: d["nodes"][0].pop("matrix"), "not the surface"),
        (lambda d: d["nodes"].append({"mesh": 0}), "not the surface"),
        (lambda d: d["meshes"][0]["primitives"].pop(), "triangles are not"),
        (lambda d: d["meshes"][0]["primitives"][0].update(mode=1), "not the surface"),
        (lambda d: d["asset"]["extras"].update(case_id="HC-0002"), "another case"),
        (lambda d: d["accessors"][0].update(byteOffset=12), "not the surface"),
        (lambda d: d["accessors"][0].update(count=-1), "not the surface"),
        (lambda d: d["accessors"][0].update(count=10**12), "not the surface"),
        (lambda d: d.update(scenes=[{"nodes": []}]), "not the surface"),
        (lambda d: d.update(meshes=7), "not the surface"),
        (lambda d: d.update(asset=[]), "not the surface"),
        (lambda d: d["bufferViews"][1].update(byteOffset=0), "normals are not"),
    ],
)
def test_a_glb_that_is_not_the_surface_is_found(golden: CaseCopy, change, words: str | None) -> None:
    glb_with(golden, change)
    problems = said(golden)
    assert all(line.startswith("files.render: ") for line in problems)
    assert words is None if not problems else words is not None and words in "\n".join(problems)


def test_a_glb_of_zeros_or_of_another_length_is_found(golden: CaseCopy) -> None:
    content = golden.path("render").read_bytes()
    golden.write("render", content[:12] + bytes(len(content) - 12))
    assert "not the surface of a case" in "\n".join(said(golden))
    golden.write("render", content + b"\0" * 4)
    assert said(golden) == ["files.render: is cut off: its header states another length"]


def test_a_glb_of_another_surface_is_found(golden: CaseCopy) -> None:
    content = bytearray(golden.path("render").read_bytes())
    start = 28 + struct.unpack_from("<I", content, 12)[0]
    x = struct.unpack_from("<f", content, start)[0]
    struct.pack_into("<f", content, start, np.nextafter(np.float32(x), np.float32(1e9)))
    golden.write("render", bytes(content))
    assert said(golden) == ["files.render: its vertices are not those of the surface part"]


def test_tangents_are_those_of_the_glb_at_rest(tmp_path: Path) -> None:
    grid = block_grid((4, 3, 2))
    surface, _, picking = block_surface(grid)
    tangents = np.cross(surface.normals.astype(float), [0.3, -0.5, 0.8])
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    surface = type(surface)(
        **{
            **surface.__dict__,
            "render_tangents": np.column_stack([tangents, np.ones(len(tangents))]).astype(np.float32),
            "normal_map": np.full((4, 4, 3), 128, np.uint8),
        }
    )
    content = assemble_bundle(
        BundleParts(
            grid=grid,
            surface=surface,
            grid_map=map_surface(surface, grid, structures_of_cells(grid), MapSettings()),
            picking=picking,
            glbs=[glb_bytes(surface)],
        ),
        (Material(label=MYOCARDIUM, youngs_modulus_kpa=30.0, density_kg_m3=1060.0),),
        BundleSource(geometry=grid.geometry, sha256="0" * 64),
        BundleRecord(name="tangents"),
    )
    write_bundle(tmp_path / "t.case", content)
    assert said(tmp_path / "t.case") == []
    case = CaseCopy(tmp_path / "t.case")
    tangent = case.values("mapping", "tangent")
    for change in (lambda n, x: -x if n % 4 < 3 else x, lambda n, x: -x if n % 4 == 3 else x):
        case.set_values("mapping", "tangent", [change(n, x) for n, x in enumerate(tangent)])
        assert said(case) == ["mapping.tangent: does not give the tangents of the GLB at rest"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"\n", b"\n", None),
        (b"sizes: 8 7 6", b"sizes: 8 6 7", "does not lie where"),
        (b"left-posterior-superior", b"right-anterior-superior", "not in patient LPS"),
        (b"space origin: (-37.5", b"space origin: (-37.4", "does not lie where"),
        (b"space directions: (", b"space directions: (-", "does not lie where"),
        (b"space origin: (", b"space origin: (nan", "does not say where"),
        (b"space directions: (", b"space directions: none (", "does not say where"),
        (b"dimension: 3", b"dimension: 4", "does not say where"),
        (b"encoding: gzip", b"encoding: raw", "as many voxels"),
        (b"encoding: gzip", b"encoding: hex", "packed in a way"),
        (b"NRRD", b"NURD", "not the kind of file"),
    ],
)
def test_labels_must_lie_where_the_scan_does(golden: CaseCopy, old: bytes, new: bytes, words: str | None) -> None:
    add_labels(golden)
    content = golden.path("labels").read_bytes()
    assert old in content
    golden.write("labels", content.replace(old, new, 1))
    problems = said(golden)
    assert words is None if not problems else words is not None and words in "\n".join(problems)
    assert all(line.startswith("files.labels: ") for line in problems)


def add_labels(case: CaseCopy, value: int = 2) -> None:
    manifest = read_manifest(case.folder)
    labels = np.full(manifest.scan_geometry.shape, value, np.uint8)
    segmentation = Segmentation(labels, manifest.scan_geometry, manifest.labels)
    case.manifest["files"].append({"role": "labels", "name": "labels-0.seg.nrrd"})
    case.write("labels", segmentation_nrrd_bytes(segmentation))


def test_labels_that_were_cut_off_or_are_not_in_the_table_are_found(golden: CaseCopy) -> None:
    add_labels(golden, value=77)
    assert said(golden) == ["files.labels: holds label values that the label table does not have"]
    golden.write("labels", golden.path("labels").read_bytes()[:-12])
    assert any("as many voxels" in line for line in said(golden))
    golden.write("labels", b"NRRD")
    assert any("does not say where" in line for line in said(golden))


# ------------------------------------------------------------------------------------------------ what could hide text


def test_padding_metadata_and_other_arrays_are_not_a_place_for_text(golden: CaseCopy) -> None:
    header, data = golden.header("grid")
    begin, end = next(entry["data_offsets"] for name, entry in header.items() if name.startswith("_pad"))
    golden.write_header("grid", header, data[:begin] + b"JANE"[: end - begin].ljust(end - begin) + data[end:])
    assert said(golden) == ["files.grid: the padding between its arrays is not zero"]
    for metadata, is_sound in (({"format": "pt"}, True), ({"patient": "JANE"}, False), ({"format": "JANE"}, False)):
        shutil.rmtree(golden.folder)
        shutil.copytree(CASE, golden.folder)
        case = CaseCopy(golden.folder)
        header, data = case.header("grid")
        text = json.dumps(header | {"__metadata__": metadata}, separators=(",", ":")).encode()
        old = int.from_bytes(case.path("grid").read_bytes()[:8], "little")
        text = text.ljust(old + -(-(len(text) - old) // 64) * 64)
        case.write("grid", len(text).to_bytes(8, "little") + text + data)
        for entry in case.entry("grid")["arrays"]:
            entry["offset"] += len(text) - old
        case.save()
        assert (said(case) == []) == is_sound
        assert "JANE" not in "\n".join(said(case))


def test_what_lies_beside_the_parts_is_told_and_never_named(golden: CaseCopy) -> None:
    (golden.folder / ".heartcase-tmp-1-x").write_bytes(b"half")
    shutil.copy(golden.path("grid"), golden.folder / golden.path("grid").name.replace("grid-", "mapping-"))
    assert said(golden) == []  # what a killed build leaves
    (golden.folder / "mapping-03b15cc2c138fdc1.safetensors").write_bytes(b"JANE")
    (golden.folder / "jane").mkdir()
    (line,) = said(golden)
    assert line.startswith("files: 2 files or folders that case.json does not list")
    assert "jane" not in line.lower()


# ------------------------------------------------------------------------------------------------------- strict reading


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(alphabet=st.characters(exclude_categories=["Cs"])),
        lambda x: (
            st.lists(x, max_size=3)
            | st.dictionaries(st.text(alphabet=st.characters(exclude_categories=["Cs"])), x, max_size=3)
        ),
        max_leaves=12,
    ),
    st.booleans(),
)
def test_sound_json_is_read_as_the_library_reads_it(value, is_ascii: bool) -> None:
    text = json.dumps(value, ensure_ascii=is_ascii)
    assert parse_json(text.encode()) == json.loads(text)


@given(
    st.sampled_from(["1e309", "-1e309", "1E+400", "1.5e0000400", "9" * 310, "9" * 310 + ".5", "NaN", "-Infinity"]),
    st.sampled_from(["{}", "[{}]", '{{"a": {}}}', '{{"e123": [1, {} ]}}', "[0,{}\n]"]),
)
def test_no_number_beyond_float64_is_read(number: str, around: str) -> None:
    with pytest.raises(ValueError, match=r"range|no JSON"):
        parse_json(around.format(number).encode())


@pytest.mark.parametrize(("depth", "is_read"), [(64, True), (65, False), (5000, False), (10**5, False)])
def test_depth_is_bounded(depth: int, is_read: bool) -> None:
    text = b"[" * (depth - 1) + b'{"a": "]]]"}' + b"]" * (depth - 1)
    if is_read:
        assert parse_json(text)
    else:
        with pytest.raises(ValueError, match="deep"):
            parse_json(text)


def test_keys_that_place_a_case_have_no_default(golden: CaseCopy) -> None:
    for key in ("origin_mm", "spacing_mm", "direction"):
        removed = golden.manifest["scan_geometry"].pop(key)
        golden.save()
        with pytest.raises(BundleError, match=rf"scan_geometry\.{key}: is missing"):
            open_bundle(golden.folder)
        golden.manifest["scan_geometry"][key] = removed


def test_what_is_wrong_is_left_out_and_not_filled_in(golden: CaseCopy) -> None:
    golden.manifest["grid_geometry"]["direction"] = [[1, 0, 0]] * 3
    golden.manifest["simulation"]["cell_mm"] = math.pi * -1
    golden.manifest["scan_values"] = 3
    golden.save()
    manifest = salvaged_manifest(golden.folder)
    assert manifest is not None
    assert stated(manifest, "grid_geometry") is None
    assert stated(manifest, "grid_geometry.size") == (7, 6, 5)
    assert stated(manifest, "grid_geometry.direction") is None
    assert stated(manifest, "simulation.cell_mm") is None
    assert stated(manifest, "simulation.node_count") == 81
    assert {problem.place for problem in check_bundle(golden.folder)} == {
        "case.json.grid_geometry.direction",
        "case.json.simulation.cell_mm",
        "case.json.scan_values",
    }


def test_a_label_table_without_labels_is_said(golden: CaseCopy) -> None:
    golden.manifest["labels"] = {"labels": False}
    golden.save()
    assert "case.json.labels.labels" in {problem.place for problem in check_bundle(golden.folder)}
