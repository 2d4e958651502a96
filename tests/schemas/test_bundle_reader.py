"""Opening cases: sound ones, and every kind of broken one."""

import json

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from heartcase.pipeline.bundle import write_bundle
from heartcase.schemas.bundle import ARRAYS, FileRole
from heartcase.schemas.bundle_check import check_bundle
from heartcase.schemas.bundle_reader import open_bundle
from heartcase.schemas.errors import BundleError
from tests.factories import block_case


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
    import hashlib

    bundle = open_bundle(case)
    path = bundle.path(role)
    arrays = {name: array.copy() for name, array in load_file(path).items()}
    change(arrays)
    save_file(arrays, path)

    def update(data):
        for entry in data["files"]:
            if entry["role"] == role.value:
                entry["size"] = path.stat().st_size
                entry["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()

    edit_manifest(case, update)


def test_a_sound_case_has_no_problems_and_gives_what_was_written(case):
    assert check_bundle(case) == ()
    bundle = open_bundle(case)
    grid = bundle.arrays(FileRole.GRID)
    assert bundle.manifest.simulation.node_count == len(grid["nodes"]) == 4 * 3 * 3
    assert (grid["cell_stiffness"] == 30.0).all()
    for role in (FileRole.GRID, FileRole.SURFACE, FileRole.MAPPING, FileRole.PICKING):
        independent = load_file(bundle.path(role))
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
        (lambda d: d["grid_geometry"].update(spacing_mm=[1e-30] * 3), "grid_geometry.spacing_mm"),
        (lambda d: d["grid_geometry"].update(size=[2, 2, 2]), "grid.cells"),
        (lambda d: d["grid_geometry"].update(direction=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "grid_geometry.direction"),
        (lambda d: d["simulation"].update(step_default_s=10), "simulation.step_default_s"),
        (lambda d: d.update(materials=[]), "materials"),
        (lambda d: d.update(warnings=["\x1b[2Jgone"]), "case.json.warnings[1]"),
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
    with pytest.raises(BundleError, match="missing"):
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
    ],
)
def test_values_out_of_range_are_found(case, role, change, words):
    rewrite_arrays(case, role, change)
    assert any(problem.place == words for problem in check_bundle(case))


def test_an_empty_path_is_explained(tmp_path):
    with pytest.raises(BundleError, match="nothing at this path"):
        open_bundle(tmp_path / "none.case")
    with pytest.raises(BundleError, match=r"holds no case\.json"):
        open_bundle(tmp_path)
