"""Opening cases: sound ones, and every kind of broken one."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of
from safetensors.numpy import load, load_file, save_file

from heartcase.pipeline.bundle.aligned import aligned_safetensors
from heartcase.pipeline.bundle.write_bundle import (
    BundleParts,
    BundleRecord,
    BundleSource,
    assemble_bundle,
    resolve_materials,
    write_bundle,
)
from heartcase.pipeline.data import Scan
from heartcase.pipeline.image.scan_part import scan_part
from heartcase.schemas.bundle.approval import approval_state
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import ALIGNMENT, ARRAYS, VERSION_WITHOUT_SEPTA, FileRole
from heartcase.schemas.bundle.lattice import FULL_MOMENTS
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import BundleError, UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import MaterialsSettings
from heartcase.simulator.load import load_case
from tests.factories import block_case, block_grid


@pytest.fixture
def case(tmp_path):
    directory = tmp_path / "block.case"
    write_bundle(directory, block_case())
    return directory


def edit_manifest(case, change):
    path = case / "case.json"
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def rewrite_arrays(case, role, change):
    """Change arrays of a part and keep size and hash in the manifest true, so that only the values are wrong."""
    bundle = open_bundle(case)
    path = bundle.path(role)
    arrays = {name: array.copy() for name, array in load_file(path).items() if not name.startswith("_")}
    change(arrays)
    file = aligned_safetensors(arrays)
    path.write_bytes(file.content)

    def update(entry):
        entry["arrays"] = [
            listed | {"offset": file.offsets[name], "shape": list(arrays[name].shape), "dtype": str(arrays[name].dtype)}
            for listed in entry["arrays"]
            if (name := listed["name"]) in arrays
        ]

    edit_entry(case, role, update)


def edit_entry(case, role, change):
    """Change a file's entry in the manifest, and make its size and hash true."""
    import hashlib

    path = open_path(case, role)

    def update(data):
        for entry in data["files"]:
            if entry["role"] == role.value:
                entry["size"] = path.stat().st_size
                entry["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
                change(entry)

    edit_manifest(case, update)


def open_path(case, role):
    data = json.loads((case / "case.json").read_text())
    return case / next(entry["name"] for entry in data["files"] if entry["role"] == role.value)


def test_a_sound_case_has_no_problems_and_gives_what_was_written(case):
    assert check_bundle(case) == ()
    bundle = open_bundle(case)
    grid = bundle.arrays(FileRole.GRID)
    assert bundle.manifest.simulation.node_count == len(grid["nodes"]) == 4 * 3 * 3
    assert (grid["cell_stiffness"] == 30.0).all()
    for role in (FileRole.GRID, FileRole.SURFACE, FileRole.MAPPING, FileRole.PICKING):
        independent = {name: a for name, a in load_file(bundle.path(role)).items() if not name.startswith("_")}
        ours = bundle.arrays(role)
        assert set(ours) == {spec.name for spec in ARRAYS[role]} == set(independent)
        for name, array in ours.items():
            np.testing.assert_array_equal(array, independent[name])
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0


def test_only_the_arrays_asked_for_are_mapped(case):
    assert set(open_bundle(case).arrays(FileRole.GRID, ["fixed"])) == {"fixed"}


def test_a_part_that_is_not_there_is_named(case):
    with pytest.raises(BundleError, match="no part 'render'"):
        open_bundle(case).path(FileRole.RENDER)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(format="other"), "does not say that it is"),
        (lambda d: d.update(format_version="2.0"), "is not 1.x"),
        (lambda d: d.update(required_extensions=["sutures"]), "'sutures' is not known"),
        (lambda d: d.pop("simulation"), "is missing"),
        (lambda d: d["files"][0].update(name="../escape.safetensors"), "characters that are not allowed"),
        (lambda d: d["files"][0].update(name="/etc/passwd"), "characters that are not allowed"),
        (lambda d: d["files"][0].update(size=3), "instead of 3"),
        (lambda d: d["files"].append(d["files"][0]), "is listed twice"),
        (lambda d: d["files"].pop(0), "has no grid"),
        (lambda d: d["simulation"].update(node_count=7), "says 7"),
        (lambda d: d.update(surprise=1), "unknown setting"),
        (lambda d: d["scan_geometry"].update(spacing_mm=[1, 1, "NaN"]), "finite"),
    ],
)
def test_a_broken_manifest_is_refused(case, change, words):
    edit_manifest(case, change)
    with pytest.raises(BundleError, match=words):
        open_bundle(case)
    assert check_bundle(case)


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda d: d["grid_geometry"].update(spacing_mm=[1e-3] * 3), "grid_geometry.spacing_mm"),
        (lambda d: d["grid_geometry"].update(size=[2, 2, 2]), "grid.cells"),
        (lambda d: d["grid_geometry"].update(direction=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "grid_geometry.direction"),
        (lambda d: d["simulation"].update(step_default_s=10), "simulation.step_default_s"),
        (lambda d: d.update(materials=[]), "materials"),
        (lambda d: d.update(warnings=["\x1b[2Jgone"]), "case.json.warnings[1]"),
        (lambda d: d.update(warnings=["a", "b"], warning_grades=["note"]), "case.json.warning_grades"),
        (lambda d: d.update(warnings=["a"], warning_grades=["bad"]), "case.json.warning_grades[1]"),
    ],
)
def test_a_manifest_at_odds_with_the_arrays_is_found(case, change, place):
    edit_manifest(case, change)
    assert place in {problem.place for problem in check_bundle(case)}


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"format": "heartcase-bundle"}', "[" * 100_000])
def test_a_manifest_that_is_not_json_or_not_ours_is_refused(case, text):
    (case / "case.json").write_text(text)
    with pytest.raises(BundleError):
        open_bundle(case)


def test_unknown_keys_of_a_newer_minor_version_are_ignored(case):
    def newer(data):
        data["format_version"] = "1.7"
        data["surprise"] = {"a": 1}
        data["simulation"]["more"] = 2

    edit_manifest(case, newer)
    assert open_bundle(case).manifest.simulation.cell_count == 12


def test_a_missing_a_cut_and_a_changed_file_are_all_reported(case):
    bundle = open_bundle(case)
    bundle.path(FileRole.SURFACE).unlink()
    mapping = bundle.path(FileRole.MAPPING)
    mapping.write_bytes(mapping.read_bytes()[:-4])
    picking = bundle.path(FileRole.PICKING)
    content = bytearray(picking.read_bytes())
    content[-1] ^= 1
    picking.write_bytes(content)
    text = "\n".join(map(str, check_bundle(case)))
    assert "files.surface: the file" in text
    assert "files.mapping: has" in text
    assert "files.picking: the content" in text
    edit_manifest(case, lambda d: d.update(surprise=1))
    more = "\n".join(map(str, check_bundle(case)))
    for line in ("surprise: unknown setting", "files.surface: the file", "files.mapping: the content"):
        assert line in more


def test_a_link_out_of_the_case_is_not_followed(case, tmp_path):
    path = open_bundle(case).path(FileRole.GRID)
    outside = tmp_path / "outside.safetensors"
    path.rename(outside)
    path.symlink_to(outside)
    with pytest.raises(BundleError, match="is a link"):
        open_bundle(case)


@pytest.mark.parametrize(
    "header", [b"\xff" * 8, (1 << 40).to_bytes(8, "little"), b"\x02\x00\x00\x00\x00\x00\x00\x00[]"]
)
def test_a_bad_header_is_refused(case, header):
    path = open_bundle(case).path(FileRole.GRID)
    content = header + path.read_bytes()[len(header) :]
    path.write_bytes(content)
    with pytest.raises(BundleError, match="header"):
        open_bundle(case)


@pytest.mark.parametrize(
    ("role", "change", "words"),
    [
        (FileRole.SURFACE, lambda a: a["triangles"].__setitem__((0, 0), 10_000), "surface.triangles"),
        (FileRole.SURFACE, lambda a: a["vertices"].__setitem__((0, 0), np.nan), "surface.vertices"),
        (FileRole.SURFACE, lambda a: a["triangle_label"].__setitem__(0, 99), "surface.triangle_label"),
        (FileRole.MAPPING, lambda a: a["triangle_nodes"].__setitem__((0, 0), -1), "mapping.triangle_nodes"),
        (FileRole.MAPPING, lambda a: a["weights"].__setitem__((0, 0), 3.0), "mapping.weights"),
        (FileRole.GRID, lambda a: a["cell_coverage"].__setitem__(0, 0.0), "grid.cell_coverage"),
        (FileRole.GRID, lambda a: a["cell_stiffness"].__setitem__(0, -1.0), "grid.cell_stiffness"),
        (FileRole.GRID, lambda a: a["fixed"].__setitem__(0, 2), "grid.fixed"),
        (FileRole.GRID, lambda a: a["fixed"].fill(1), "grid.fixed"),
        (FileRole.GRID, lambda a: a["cell_stiffness"].__setitem__(0, 1e38), "grid.cell_stiffness"),
        (FileRole.GRID, lambda a: a["cell_label"].__setitem__(0, 1), "materials"),
        (FileRole.SURFACE, lambda a: a["vertices"].__setitem__((0, 0), 500.0), "mapping"),
        (FileRole.MAPPING, lambda a: a["triangle_nodes"].__setitem__(0, 3), "mapping.triangle_nodes"),
        (FileRole.GRID, lambda a: a["nodes"].__setitem__((0, 0), 5), "grid.nodes"),
        (FileRole.GRID, lambda a: a["cells"].__setitem__(0, a["cells"][1]), "grid.cells"),
        (FileRole.PICKING, lambda a: a.update(nodes=a["nodes"][:-1]), "picking.triangles"),
        (FileRole.GRID, lambda a: a.update(fixed=a["fixed"][:-1]), "grid.fixed"),
        (FileRole.GRID, lambda a: a.update(cells=a["cells"].astype(np.float32)), "grid.cells"),
        (FileRole.GRID, lambda a: a.pop("fixed"), "grid.fixed"),
        (FileRole.GRID, lambda a: a.pop("cell_moments"), "grid.cell_moments"),
        (FileRole.GRID, lambda a: a.update(cell_moments=a["cell_moments"][:, :6].copy()), "grid.cell_moments"),
        (FileRole.GRID, lambda a: a["cell_moments"].__setitem__((1, 8), np.nan), "grid.cell_moments"),
        (FileRole.GRID, lambda a: a["cell_moments"].__setitem__((1, 0), -0.51), "grid.cell_moments"),
        (FileRole.GRID, lambda a: a["cell_moments"].__setitem__((1, 2), 0.3), "grid.cell_moments"),
    ],
)
def test_values_out_of_range_are_found(case, role, change, words):
    rewrite_arrays(case, role, change)
    assert any(problem.place == words for problem in check_bundle(case))


def test_moments_reach_the_simulator_and_a_case_of_version_1_2_has_none(tmp_path):
    grid = block_grid()
    x, y, z = np.random.Generator(np.random.PCG64(5)).uniform(-0.5, 0.5, (3, 50, len(grid.cells)))
    moments = np.stack([a.mean(axis=0) for a in (x, y, z, x * x, y * y, z * z, y * z, x * z, x * y)], axis=1)
    moments = moments.astype(np.float32)
    content = assemble_bundle(
        BundleParts(grid=dataclasses.replace(grid, cell_moments=moments)),
        resolve_materials(MaterialsSettings(), grid.table),
        BundleSource(geometry=grid.geometry, sha256="0" * 64),
        BundleRecord(name="moments"),
    )
    case = tmp_path / "moments.case"
    write_bundle(case, content)
    assert check_bundle(case) == ()
    np.testing.assert_array_equal(load_case(case, needs=("grid",)).model.cell_moments, moments)
    broken = moments.copy()
    broken[3, 4] = 0.0
    rewrite_arrays(case, FileRole.GRID, lambda arrays: arrays.update(cell_moments=broken))
    with pytest.raises(BundleError, match=r"grid\.cell_moments: has means of squares below"):
        load_case(case, needs=("grid",))
    rewrite_arrays(case, FileRole.GRID, lambda arrays: arrays.pop("cell_moments"))
    with pytest.raises(BundleError, match=r"grid\.cell_moments: is missing"):
        load_case(case, needs=("grid",))
    edit_manifest(case, lambda data: data.update(format_version="1.2"))
    assert check_bundle(case) == ()
    full = np.tile(FULL_MOMENTS, (len(moments), 1))
    np.testing.assert_array_equal(load_case(case, needs=("grid",)).model.cell_moments, full)


def test_an_empty_path_is_explained(tmp_path):
    with pytest.raises(BundleError, match=r"nothing at this path: no none\.case is in that folder; .*--out") as missing:
        open_bundle(tmp_path / "none.case")
    assert str(tmp_path) not in str(missing.value)
    for unlike in ("none", "-x.case", "Jane^Doe.case", f"{'x' * 65}.case"):
        with pytest.raises(BundleError, match=r"nothing at this path: check its spelling$"):
            open_bundle(tmp_path / unlike)
    with pytest.raises(BundleError, match=r"holds no case\.json"):
        open_bundle(tmp_path)


# The layout of version 1.1: every array at a multiple of 64 bytes, and listed in the manifest.


@given(
    st.dictionaries(
        st.from_regex(r"[a-z][a-z0-9_]{0,12}", fullmatch=True),
        st.sampled_from(["int32", "int16", "float32", "uint8"]).flatmap(
            lambda dtype: arrays_of.arrays(
                dtype, arrays_of.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=9)
            )
        ),
        max_size=6,
    )
)
def test_any_arrays_are_aligned_and_read_back_by_the_safetensors_library(arrays):
    file = aligned_safetensors(arrays)
    assert aligned_safetensors(arrays).content == file.content
    assert list(file.offsets) == list(arrays)
    independent = load(file.content)
    assert {name for name in independent if not name.startswith("_")} == set(arrays)
    for name, array in arrays.items():
        assert file.offsets[name] % ALIGNMENT == 0
        start = file.offsets[name]
        assert file.content[start : start + array.nbytes] == array.tobytes()
        np.testing.assert_array_equal(independent[name], array)
        assert independent[name].dtype == array.dtype
    assert not any(independent[name].any() for name in independent if name.startswith("_"))


def test_arrays_that_are_not_contiguous_are_written_in_c_order():
    turned = np.arange(12, dtype=np.int32).reshape(3, 4).T
    big_endian = np.arange(5, dtype=">f4")
    independent = load(aligned_safetensors({"turned": turned, "big": big_endian}).content)
    np.testing.assert_array_equal(independent["turned"], turned)
    np.testing.assert_array_equal(independent["big"], big_endian)


def test_the_manifest_alone_is_enough_to_read_an_array(case):
    """No header is parsed: offset, type and shape of case.json give what the safetensors library gives."""
    data = json.loads((case / "case.json").read_text())
    assert data["format_version"] == VERSION_WITHOUT_SEPTA
    for entry in data["files"]:
        content = (case / entry["name"]).read_bytes()
        independent = load(content)
        for listed in entry["arrays"]:
            start, shape = listed["offset"], listed["shape"]
            assert start % 64 == 0
            count = int(np.prod(shape))
            ours = np.frombuffer(content, f"<{np.dtype(listed['dtype']).str[1:]}", count, start).reshape(shape)
            np.testing.assert_array_equal(ours, independent[listed["name"]])
            assert listed["unit"]
            assert listed["meaning"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda e: e["arrays"][0].update(offset=e["arrays"][0]["offset"] + 64), "grid.cells: has offset"),
        (lambda e: e["arrays"][0].update(offset=e["arrays"][0]["offset"] + 4), r"arrays\[1\].offset: .*multiple of 64"),
        (lambda e: e["arrays"][2].update(dtype="int16"), "grid.cell_label: has type uint8 in its file, but int16"),
        (lambda e: e["arrays"][6].update(shape=[3, 36]), r"grid.nodes: has shape \(36, 3\) in its file"),
        (lambda e: e["arrays"].pop(), "grid.fixed: is not in the list of arrays"),
        (lambda e: e.pop("arrays"), "grid.cells: is not in the list"),
        (lambda e: e["arrays"].append(e["arrays"][0]), "lists an array twice"),
        (lambda e: e["arrays"].append(e["arrays"][0] | {"name": "colour"}), "grid.colour: is listed"),
    ],
)
def test_a_list_of_arrays_at_odds_with_the_file_is_refused(case, change, words):
    edit_entry(case, FileRole.GRID, change)
    with pytest.raises(BundleError, match=words):
        open_bundle(case)
    assert check_bundle(case)


def test_all_wrong_offsets_are_found_at_once(case):
    for role in (FileRole.GRID, FileRole.MAPPING):
        path = open_path(case, role)
        save_file({name: a for name, a in load_file(path).items() if not name.startswith("_")}, path)
        edit_entry(case, role, lambda entry: None)
    text = "\n".join(map(str, check_bundle(case)))
    for name in ("grid.nodes: has offset", "grid.cells: has offset", "mapping.weights: has offset"):
        assert name in text


def test_an_array_that_is_out_of_line_is_found_though_the_manifest_is_honest(case):
    path = open_path(case, FileRole.GRID)
    save_file({name: a for name, a in load_file(path).items() if not name.startswith("_")}, path)
    start = 8 + int.from_bytes(path.read_bytes()[:8], "little")
    header = json.loads(path.read_bytes()[8:start])

    def update(entry):
        for listed in entry["arrays"]:
            listed["offset"] = start + header[listed["name"]]["data_offsets"][0]

    edit_entry(case, FileRole.GRID, update)
    out_of_line = [problem for problem in check_bundle(case) if "multiple of 64" in problem.message]
    wrong = [name for name in header if (start + header[name]["data_offsets"][0]) % 64]
    assert len(out_of_line) == len(wrong) > 3


def test_a_hole_that_strict_readers_refuse_is_found(case):
    path = open_path(case, FileRole.GRID)
    path.write_bytes(path.read_bytes() + bytes(64))
    edit_entry(case, FileRole.GRID, lambda entry: None)
    assert "files.grid" in {problem.place for problem in check_bundle(case)}


def test_a_case_of_version_1_0_is_still_read(case):
    """As it was written then: packed arrays, no list of them, no coordinates."""
    for role in (FileRole.GRID, FileRole.SURFACE, FileRole.MAPPING, FileRole.PICKING):
        path = open_path(case, role)
        save_file({name: a for name, a in load_file(path).items() if not name.startswith("_")}, path)
        edit_entry(case, role, lambda entry: entry.pop("arrays"))

    def older(data):
        data["format_version"] = "1.0"
        data.pop("coordinates")
        data.pop("scan_values")
        data.pop("case_id")

    edit_manifest(case, older)
    assert check_bundle(case) == ()
    assert load_case(case).surface.vertex_count > 0


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda d: d["coordinates"]["frames"][1]["from_lps_mm"][2].__setitem__(1, -0.001), "coordinates.frames[2]"),
        (lambda d: d["coordinates"]["frames"][0].update(handedness="left"), "coordinates.frames[1]"),
        (lambda d: d["gltf_from_lps"][0].__setitem__(0, -0.001), "gltf_from_lps"),
        (lambda d: d["coordinates"].update(space="patient RAS"), "case.json.coordinates.space"),
        (lambda d: d["coordinates"].update(axes=["right", "back", "head"]), "coordinates.axes"),
    ],
)
def test_other_axes_than_the_formats_are_refused(case, change, place):
    edit_manifest(case, change)
    with pytest.raises(BundleError) as refused:
        open_bundle(case)
    assert place in {problem.place for problem in refused.value.problems}


def test_frames_of_a_newer_minor_version_are_ignored(case):
    def newer(data):
        data["format_version"] = "1.9"
        data["coordinates"]["frames"].append(
            data["coordinates"]["frames"][0] | {"name": "vulkan", "unit": "mm", "hand": 3}
        )

    edit_manifest(case, newer)
    assert [frame.name for frame in open_bundle(case).manifest.coordinates.frames] == ["gltf", "unity", "unreal"]
    assert check_bundle(case) == ()


# The scan part.


def scan_of(values, modality):
    return Scan(np.asarray(values, np.float32), Geometry.of(shape=np.shape(values)), modality=modality)


@given(
    arrays_of.arrays(np.float32, (2, 3, 4), elements=st.floats(-(2.0**20), 2.0**20, width=32, allow_subnormal=False)),
    st.sampled_from(["CT", "MR", "unknown"]),
)
def test_16_bits_keep_a_scan_to_the_error_that_is_stated(values, modality):
    part = scan_part(scan_of(values, modality))
    back = part.values.slope * part.intensity.astype(float) + part.values.intercept
    error = np.abs(back - values).max()
    assert error <= part.values.error_max * (1 + 1e-9)
    span = float(values.max()) - float(values.min())
    bound = 0.5 if part.values.slope == 1.0 else span / 131_070
    assert error <= bound + 4 * np.spacing(np.abs(values).max().astype(float))


def test_ct_is_kept_in_whole_hounsfield_units():
    part = scan_part(scan_of([[[-1024.0, 0.4, 3071.0, 40.5]]], "CT"))
    assert part.intensity.tolist() == [[[-1024, 0, 3071, 40]]]
    assert (part.values.slope, part.values.intercept, part.values.unit) == (1.0, 0.0, "HU")
    assert part.values.error_max == 0.5


def test_voxels_that_are_no_numbers_become_the_darkest():
    part = scan_part(scan_of([[[np.nan, 2.0, np.inf, 5.0, -np.inf]]], "MR"))
    assert part.intensity.tolist() == [[[-32768, -32768, 32767, 32767, -32768]]]
    assert scan_part(scan_of([[[np.nan]]], "MR")).values.slope == 1.0


@pytest.fixture
def case_with_scan(tmp_path):
    directory = tmp_path / "scan.case"
    values = np.arange(2 * 2 * 3, dtype=np.float32).reshape(2, 2, 3) * 100
    write_bundle(directory, block_case(scan=scan_part(scan_of(values, "CT"))))
    return directory, values


def test_the_scan_is_read_only_when_it_is_asked_for(case_with_scan):
    case, values = case_with_scan
    assert check_bundle(case) == ()
    assert load_case(case).scan is None
    scan = load_case(case, needs=("scan",)).scan
    assert scan.geometry.shape == values.shape
    for number, plane in enumerate(values):
        np.testing.assert_array_equal(scan.slice_at(number), plane)


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda d: d["scan_geometry"].update(size=[2, 3, 2]), "scan.intensity"),
        (lambda d: d.update(scan_values=None), "scan_values"),
    ],
)
def test_a_scan_that_does_not_fit_the_manifest_is_refused(case_with_scan, change, place):
    edit_manifest(case_with_scan[0], change)
    assert place in {problem.place for problem in check_bundle(case_with_scan[0])}


def test_a_case_without_the_scan_says_what_to_do(case):
    with pytest.raises(BundleError, match="no part 'scan': add it to 'parts'"):
        load_case(case, needs=("scan",))


def test_a_part_or_an_array_that_there_is_not_is_named_with_what_there_is(case):
    bundle = open_bundle(case)
    assert bundle.path("grid") == bundle.path(FileRole.GRID)
    assert set(bundle.arrays("grid", ["fixed"])) == {"fixed"}
    with pytest.raises(BundleError, match=r"no array 'nope', 'other'; it has cells"):
        bundle.arrays(FileRole.GRID, ["nope", "fixed", "other"])
    with pytest.raises(BundleError, match="no array 'nope'"):
        bundle.inspect_array(FileRole.GRID, "nope")
    with pytest.raises(UsageError, match=r"write \['nodes'\]"):
        bundle.arrays(FileRole.GRID, "nodes")
    for call in (bundle.path, bundle.has, bundle.arrays):
        with pytest.raises(BundleError, match=r"no part 'nope'; there are grid"):
            call("nope")


def test_a_part_without_arrays_says_where_its_file_is():
    golden = Path(__file__).parents[1] / "golden" / "lopsided.case"
    with pytest.raises(BundleError, match=r"'render' holds no arrays: read its file, render-.*glb"):
        open_bundle(golden).arrays(FileRole.RENDER)


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "\ud800"])
def test_a_name_that_no_path_may_have_is_a_case_that_is_not_there(name, tmp_path):
    path = f"{tmp_path}/{name}"
    for wanted in (name, path):
        with pytest.raises(BundleError, match="nothing at this path"):
            open_bundle(wanted)
        assert [problem.message for problem in check_bundle(wanted)] == [
            "there is nothing at this path: check its spelling"
        ]
        with pytest.raises(BundleError, match="no case at this path"):
            approval_state(wanted)
