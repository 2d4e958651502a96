"""Levels of detail: coarser surfaces with maps and mappings of their own, in the case and out of it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from heartcase.cli.main import main
from heartcase.pipeline.artifacts.serialise import artifact_from_bytes, artifact_to_bytes
from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.data import Surface
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import ARRAYS, LEVEL_MAX, LEVELS, VERSION_WITHOUT_SEPTA, FileRole
from heartcase.schemas.bundle.reader import OpenBundle, open_bundle
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.schemas.recipe.settings import SurfaceSettings
from heartcase.simulator.load import load_case
from heartcase.simulator.surface.deform import deform
from tests.ball import write_ball_recipe, write_ball_scan
from tests.pipeline.mesh.test_normal_map import area_weighted, degrees, mixed, samples, shaded, unit
from tests.pipeline.solids import lattice, solid, sphere, walled

pytestmark = pytest.mark.usefixtures("plain_reports")

COUNTS = (900, 300)


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("levels")
    write_ball_scan(folder / "scan.nii.gz")
    levels = f"level_counts = {list(COUNTS)}\n"
    recipe = write_ball_recipe(folder / "scan.nii.gz", folder / "ball.toml", surface=levels)
    return build_case(load_recipe(recipe), directory=folder, out=folder / "out").case


@pytest.fixture(scope="module")
def surface():
    settings = SurfaceSettings(triangle_count=6000, level_counts=(2000, 600), normal_map_size=512)
    return build_surface(walled(sphere(12.0), 3.0, lattice(0.8, 17.0)), settings)


def test_each_level_is_a_sound_surface_of_about_so_many_triangles(surface):
    assert [len(one.triangles) for one in (surface, *surface.levels)] == [6000, 2000, 600]
    errors = [one.quality["distance_mean_mm"] for one in (surface, *surface.levels)]
    assert errors == sorted(errors)
    for one in surface.levels:
        for name in ("open_edge_count", "non_manifold_edge_count", "self_intersection_count", "flipped_triangle_count"):
            assert one.quality[name] == 0
        assert one.quality["shell_count"] == surface.quality["shell_count"]
        assert one.normal_map.shape == (256, 256, 3)
        assert one.levels == ()
        assert set(np.unique(one.triangle_kind)) == set(np.unique(surface.triangle_kind))


def test_the_map_of_each_level_beats_the_mesh_against_the_true_normals(surface):
    for one in surface.levels:
        triangle, weights = samples(one, 20_000)
        at = mixed(weights, one.vertices_mm[one.triangles[triangle]])
        true = unit(at) * np.where(one.triangle_label[triangle] == 0, 1.0, -1.0)[:, None]
        without = degrees(unit(mixed(weights, area_weighted(one)[one.triangles[triangle]])), true).mean()
        assert degrees(shaded(one, triangle, weights), true).mean() < 0.65 * without


def test_a_level_that_is_not_coarser_is_left_out():
    structures = solid(sphere(6.0), lattice(1.5, 10.0))
    plain = build_surface(structures, SurfaceSettings(normal_map_size=0, level_counts=()), render=False)
    count = len(plain.triangles)
    made = build_surface(
        structures, SurfaceSettings(normal_map_size=0, level_counts=(count + 100, count // 2)), render=False
    )
    assert [len(one.triangles) for one in made.levels] == [count // 2]
    assert np.array_equal(made.vertices_mm, plain.vertices_mm)


def test_levels_are_kept_with_their_stage_s_output(surface):
    again = artifact_from_bytes(artifact_to_bytes(surface), Surface)
    assert artifact_to_bytes(again) == artifact_to_bytes(surface)
    assert len(again.levels) == 2
    for one, other in zip(again.levels, surface.levels, strict=True):
        assert np.array_equal(one.vertices_mm, other.vertices_mm)
        assert np.array_equal(one.normal_map, other.normal_map)
        assert one.quality == other.quality
    plain = replace(surface, levels=())
    assert artifact_from_bytes(artifact_to_bytes(plain), Surface).levels == ()


def test_a_case_holds_surface_mapping_and_view_of_each_level(case):
    assert check_bundle(case) == ()
    bundle = open_bundle(case)
    assert bundle.levels == (0, 1, 2)
    for level, count in enumerate((None, *COUNTS)):
        mesh = bundle.arrays(FileRole.SURFACE.at(level))
        mapping = bundle.arrays(FileRole.MAPPING.at(level))
        assert len(mapping["weights"]) == len(mesh["vertices"])
        assert count is None or count - 2 <= len(mesh["triangles"]) <= 1.3 * count
        assert bundle.path(FileRole.RENDER.at(level)).read_bytes()[:4] == b"glTF"
    figures = json.loads((case / "case.json").read_text())["quality"]["levels"]
    sizes = [len(bundle.arrays(FileRole.SURFACE.at(n), ["triangles"])["triangles"]) for n in (1, 2)]
    assert [one["surface"]["triangle_count"] for one in figures] == sizes


def test_only_the_level_that_is_asked_for_is_read(case, monkeypatch):
    read = []
    arrays = OpenBundle.arrays

    def watched(bundle, role, names=None):
        read.append(role)
        return arrays(bundle, role, names)

    monkeypatch.setattr(OpenBundle, "arrays", watched)
    for level in range(LEVEL_MAX + 1):
        read.clear()
        loaded = load_case(case, needs=("surface", "tangents", "colours"), level=level)
        assert {role.level for role in read} == {0, level}
        assert {role for role in read if role.level == 0 and level} <= {FileRole.GRID}
        mesh = arrays(open_bundle(case), FileRole.SURFACE.at(level))
        still = deform(loaded.model, loaded.surface, np.zeros((loaded.model.node_count, 3), np.float32))
        assert np.abs(still.vertices_mm - mesh["vertices"]).max() < 1e-3
        assert np.abs(still.normals - mesh["normals"]).max() < 1e-3


def test_a_level_that_is_not_there_is_told(case, tmp_path, capsys):
    with pytest.raises(UsageError, match="no level of detail 3; it has 0, 1, 2"):
        load_case(case, level=3)
    load_case(case, needs=("grid",), level=3)
    assert main(["export", str(case), "-o", str(tmp_path / "x.vtu"), "--level", "1", "--model", "solid"]) == 2
    assert "only the hollow model has levels" in capsys.readouterr().err
    assert main(["simulate", str(case), "--seconds", "0.001", "--level", "2"]) == 0


def test_a_damaged_level_is_found_under_its_own_name(case, tmp_path):
    import shutil

    from tests.readers.damage import CaseCopy

    shutil.copytree(case, tmp_path / "x.case")
    damaged = CaseCopy(tmp_path / "x.case")
    weights = damaged.values("mapping_1", "weights")
    weights[0] += 0.5
    damaged.set_values("mapping_1", "weights", weights)
    places = {problem.place for problem in check_bundle(damaged.folder)}
    assert "mapping_1.weights" in places
    assert not any(place.startswith(("mapping.", "surface.")) for place in places)


def test_roles_of_levels():
    for role, (finest, level) in LEVELS.items():
        assert (role.finest, role.level) == (finest, level)
        assert finest.at(level) is role
        assert role.at(0) is finest
        if finest in ARRAYS:
            assert [spec.name for spec in ARRAYS[role]] == [spec.name for spec in ARRAYS[finest]]
    assert FileRole.GRID.at(2) is FileRole.GRID
    with pytest.raises(ValueError, match="no level of detail"):
        FileRole.SURFACE.at(LEVEL_MAX + 1)


def test_a_case_of_version_1_1_is_still_read(case, tmp_path):
    """As 1.1 wrote it: no kinds, no levels."""
    import shutil

    shutil.copytree(case, tmp_path / "old.case")
    manifest = json.loads((tmp_path / "old.case" / "case.json").read_text())
    assert manifest["format_version"] == VERSION_WITHOUT_SEPTA
    manifest["format_version"] = "1.1"
    kept = []
    for entry in manifest["files"]:
        if entry["role"] in LEVELS or entry["role"] == "render":
            (tmp_path / "old.case" / entry["name"]).unlink()
            continue
        if entry["role"] == "surface":
            _without_array(tmp_path / "old.case", entry, "triangle_kind")
        kept.append(entry)
    manifest["files"] = kept
    (tmp_path / "old.case" / "case.json").write_text(json.dumps(manifest))
    assert check_bundle(tmp_path / "old.case") == ()
    mesh = open_bundle(tmp_path / "old.case").arrays(FileRole.SURFACE)
    assert "triangle_kind" not in mesh
    assert load_case(tmp_path / "old.case").surface is not None
    assert main(["export", str(tmp_path / "old.case"), "-o", str(tmp_path / "x.vtu")]) == 0


def _without_array(folder, entry, name):
    import hashlib

    from heartcase.pipeline.bundle.aligned import aligned_safetensors

    bundle = open_bundle(folder)
    arrays = {key: np.array(value) for key, value in bundle.arrays(FileRole.SURFACE).items() if key != name}
    made = aligned_safetensors(arrays)
    (folder / entry["name"]).write_bytes(made.content)
    entry["size"], entry["sha256"] = len(made.content), hashlib.sha256(made.content).hexdigest()
    entry["arrays"] = [one | {"offset": made.offsets[one["name"]]} for one in entry["arrays"] if one["name"] != name]
    entry["arrays"].sort(key=lambda one: one["offset"])


def test_the_mapping_ties_each_level(case):
    whole = open_bundle(case)
    nodes = len(whole.arrays(FileRole.GRID, ["nodes"])["nodes"])
    for level in (1, 2):
        assert whole.arrays(FileRole.MAPPING.at(level), ["triangle_nodes"])["triangle_nodes"].max() < nodes
