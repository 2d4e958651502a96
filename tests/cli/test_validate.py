"""``heartcase validate`` lists everything that is wrong with a case at once."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from heartcase.cli.main import main
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.formats.write_images import segmentation_nrrd_bytes
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.manifest import read_manifest
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import BundleError
from tests.golden.make import CASE
from tests.readers.damage import CaseCopy

Manifest = dict[str, Any]
Plant = Callable[[CaseCopy], object]

CAVITY, MUSCLE, WALL = 1, 2, 3


def full_case(directory: Path) -> Path:
    """The golden case with the one part that it does not have, labels."""
    case = directory / "full.case"
    shutil.copytree(CASE, case)
    manifest = read_manifest(case)
    labels = np.zeros(manifest.scan_geometry.shape, np.uint8)
    labels[1:3, 2:5, 3:6] = MUSCLE
    content = segmentation_nrrd_bytes(Segmentation(labels, manifest.scan_geometry, manifest.labels))
    copy = CaseCopy(case)
    copy.manifest["files"].append({"role": "labels", "name": "labels-0.seg.nrrd"})
    copy.write("labels", content)
    return case


def values(role: str, array: str, change: Callable[[list[Any]], list[Any]]) -> Plant:
    """Change an array's values; size and hash agree again."""
    return lambda case: case.set_values(role, array, change(case.values(role, array)))


def value(role: str, array: str, new: float, at: int = 0) -> Plant:
    return values(role, array, lambda old: [*old[:at], new, *old[at + 1 :]])


def header(role: str, change: Callable[[dict[str, Any]], object]) -> Plant:
    def plant(case: CaseCopy) -> None:
        described, data = case.header(role)
        change(described)
        case.write_header(role, described, data)

    return plant


def text(role: str, old: bytes, new: bytes) -> Plant:
    """Replace text in a file; it must be there."""

    def plant(case: CaseCopy) -> None:
        content = case.path(role).read_bytes()
        assert old in content
        case.write(role, content.replace(old, new, 1))

    return plant


def in_manifest(change: Callable[[Manifest], object]) -> Plant:
    return lambda case: change(case.manifest)


def negative(old: list[float]) -> list[float]:
    return [-one for one in old]


def turned(old: list[int]) -> list[int]:
    return [old[n + (0, 1, -1)[n % 3]] for n in range(len(old))]


def mirrored(geometry: str, axis: int) -> Plant:
    def plant(manifest: Manifest) -> None:
        for row in manifest[geometry]["direction"]:
            row[axis] = -row[axis]

    return in_manifest(plant)


def simulation(**figures: float) -> Plant:
    return in_manifest(lambda m: m["simulation"].update(figures))


def frames(change: Callable[[list[dict[str, Any]]], object]) -> Plant:
    return in_manifest(lambda m: change(m["coordinates"]["frames"]))


PLANTS: dict[str, tuple[Plant, str, str]] = {
    "NaN": (value("mapping", "offset", np.nan), "mapping.offset", "not finite"),
    "number too high": (value("surface", "triangles", 10**6, at=12), "surface.triangles", "only 0 to"),
    "unknown label": (value("grid", "cell_label", 240), "grid.cell_label", "label"),
    "no flag": (value("grid", "fixed", 7), "grid.fixed", "0 or 1"),
    "coverage": (value("grid", "cell_coverage", 2.0), "grid.cell_coverage", "above 1"),
    "negative stiffness": (value("grid", "cell_stiffness", -1.0), "grid.cell_stiffness", "above zero"),
    "density": (value("grid", "cell_density", 2.1e4), "grid.cell_density", "must not be above 20000"),
    "moments": (value("grid", "cell_moments", 0.6), "grid.cell_moments", "from -0.5 to 0.5"),
    "order": (values("grid", "cells", lambda a: a[3:6] + a[:3] + a[6:]), "grid.cells", "ascend"),
    "weights": (value("mapping", "weights", 9.0), "mapping.weights", "sum to one"),
    "step": (simulation(step_default_s=1.0), "simulation.step_default_s", "beyond"),
    "step that is not the cells'": (simulation(step_limit_s=0.5), "simulation.step_limit_s", "the cells give"),
    "steps": (simulation(steps_per_second=1.0), "simulation.steps_per_second", "the cells give"),
    "volume": (simulation(tissue_volume_ml=999.0), "simulation.tissue_volume_ml", "the cells give"),
    "count": (simulation(fixed_node_count=99), "simulation.fixed_node_count", "99"),
    "node count": (simulation(node_count=5), "simulation.node_count", "says 5"),
    "left-handed": (mirrored("grid_geometry", 0), "grid_geometry.direction", "right-handed"),
    "mirrored scan": (mirrored("scan_geometry", 0), "scan_geometry", "outside the scan"),
    "far landmark": (
        in_manifest(lambda m: m["landmarks"][1].update(points_mm=[[1e9, 0, 0]])),
        "landmarks[2]",
        "100 m",
    ),
    "landmark twice": (
        in_manifest(lambda m: m["landmarks"].append(m["landmarks"][2])),
        "landmarks[6]",
        "one before it",
    ),
    "another void": (
        values("surface", "triangle_label", lambda a: [0] * len(a)),
        "surface.triangle_kind",
        "both sides",
    ),
    "no material": (in_manifest(lambda m: m["materials"].pop(0)), "materials", "none"),
    "two materials": (in_manifest(lambda m: m["materials"].append(m["materials"][-1])), "materials", "more than one"),
    "another stiffness": (
        in_manifest(lambda m: m["materials"][-1].update(youngs_modulus_kpa=1.0)),
        "grid.cell_stiffness",
        "of their materials",
    ),
    "glTF mirrored": (in_manifest(lambda m: m["gltf_from_lps"][2].__setitem__(1, 0.001)), "gltf_from_lps", "mirrored"),
    "Unity mirrored": (frames(lambda f: f[1]["from_lps_mm"][0].__setitem__(0, -1)), "coordinates.frames[2]", "unity"),
    "one more frame": (frames(lambda f: f.append(f[1] | {"name": "Unity"})), "coordinates.frames", "each once"),
    "open": (values("surface", "triangles", lambda a: a[3:6] + a[3:]), "surface.triangles", "open"),
    "normals": (value("surface", "normals", 5.0), "surface.normals", "length one"),
    "mapped normals": (values("mapping", "normal", negative), "mapping.normal", "normals of the surface"),
    "nearest node": (values("mapping", "nearest_node", lambda a: [0] * len(a)), "mapping.nearest_node", "far from"),
    "picking nodes": (values("picking", "nodes", lambda a: a[::-1]), "picking.nodes", "boundary"),
    "picking turned": (values("picking", "triangles", turned), "picking.triangles", "do not enclose the cells"),
    "GLB mirrored": (text("render", b'"matrix":[0.001,', b'"matrix":[-1e-3,'), "files.render", "mirrored"),
    "labels moved": (text("labels", b"space origin: (-", b"space origin: (+"), "files.labels", "scan_geometry"),
    "hash": (in_manifest(lambda m: m["files"][-1].update(sha256="0" * 64)), "files.labels", "was changed"),
    "stray file": (lambda case: (case.folder / "JANE-DOE.dcm").write_bytes(b"x"), "files", "does not list"),
}
"""Name -> what plants a problem, its place, and words of its message; none hides another."""
SHAPELESS: dict[str, tuple[Plant, str, str]] = {
    "unknown key": (in_manifest(lambda m: m.update(colour="red")), "case.json.colour", "unknown setting"),
    "wrong type": (in_manifest(lambda m: m.update(modality=7)), "case.json.modality", "text"),
    "missing key": (in_manifest(lambda m: m.pop("software_version")), "case.json.software_version", "is missing"),
    "negative": (simulation(cell_count=-1), "case.json.simulation.cell_count", "at least 1"),
    "landmark": (
        in_manifest(lambda m: m["landmarks"][0].update(name="")),
        "case.json.landmarks[1].name",
        "empty",
    ),
    "colour": (
        in_manifest(lambda m: m["labels"]["labels"][1].update(colour="red")),
        "case.json.labels.labels[2].colour",
        "#",
    ),
    "direction": (
        in_manifest(lambda m: m["scan_geometry"].pop("spacing_mm")),
        "case.json.scan_geometry.spacing_mm",
        "is missing",
    ),
    "array's type": (
        header("grid", lambda h: h["fixed"].update(dtype="I8")),
        "grid.fixed",
        "must be uint8",
    ),
    "array missing": (header("mapping", lambda h: h.pop("tangent")), "mapping.tangent", "is missing"),
    "one byte more": (
        lambda case: case.path("grid").write_bytes(case.path("grid").read_bytes() + b"x"),
        "files.grid",
        "bytes instead of",
    ),
}
"""The same, of a manifest or a part that does not fit the format. A file is appended to last."""

HIDES: dict[str, Collection[str]] = {
    "number too high": ("open", "another void"),
    "left-handed": ("mirrored scan",),
    "coverage": ("volume",),
    "negative stiffness": ("another stiffness", "step that is not the cells'", "steps"),
    "density": ("step that is not the cells'", "steps"),
    "array's type": ("no flag", "count"),
    "direction": ("mirrored scan", "labels moved"),
}
"""Name -> what cannot be looked for in what it leaves."""


def plant(case: Path, names: Collection[str]) -> None:
    """Plant problems in a sound case."""
    copy = CaseCopy(case)
    for name, (change, _, _) in (PLANTS | SHAPELESS).items():
        if name in names:
            change(copy)
    copy.save()


def is_listed(name: str, said: list[str]) -> bool:
    _, place, words = (PLANTS | SHAPELESS)[name]
    return any(line.startswith(f"{place}:") and words in line for line in said)


def hidden(names: Collection[str]) -> set[str]:
    return {one for name in names for one in HIDES.get(name, ())}


def test_everything_planted_is_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = full_case(tmp_path)
    assert main(["validate", str(case)]) == 0
    names = set(PLANTS) - hidden(PLANTS)
    plant(case, names)
    capsys.readouterr()
    assert main(["validate", str(case)]) == 1
    out = capsys.readouterr().out
    assert [name for name in names if not is_listed(name, out.splitlines())] == []
    assert "JANE" not in out
    assert main(["validate", str(case), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["valid"] is False
    assert len(told["problems"]) >= len(names)


@pytest.mark.parametrize("name", PLANTS | SHAPELESS)
def test_each_is_listed_alone(tmp_path: Path, name: str) -> None:
    case = full_case(tmp_path)
    plant(case, {name})
    assert is_listed(name, [str(problem) for problem in check_bundle(case)])


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sets(st.sampled_from(sorted(PLANTS | SHAPELESS)), min_size=2))
def test_no_problem_hides_another(tmp_path_factory: pytest.TempPathFactory, names: set[str]) -> None:
    case = full_case(tmp_path_factory.mktemp("planted"))
    plant(case, names)
    said = [str(problem) for problem in check_bundle(case)]
    assert [name for name in names - hidden(names) if not is_listed(name, said)] == []


def test_a_lost_file_hides_nothing_in_the_others(tmp_path: Path) -> None:
    case = full_case(tmp_path)
    names = {name for name, (_, place, _) in PLANTS.items() if not place.startswith("picking")} - hidden(PLANTS)
    plant(case, names)
    next(case.glob("picking-*")).unlink()
    said = [str(problem) for problem in check_bundle(case)]
    assert any("files.picking" in line and "is missing" in line for line in said)
    assert [name for name in names if not is_listed(name, said)] == []


def test_a_file_that_was_cut_off_is_told_in_one_line_with_what_to_do(tmp_path: Path) -> None:
    case = full_case(tmp_path)
    grid = next(case.glob("grid-*"))
    grid.write_bytes(grid.read_bytes()[:-1000])
    with pytest.raises(BundleError) as error:
        open_bundle(case)
    (said,) = map(str, error.value.problems)
    assert said.startswith("files.grid: has ")
    assert "copy the case again" in said


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('name = "x"\nscan = { path = "a.nii" }\n[grid]\ncell_mm = 3\n', "heartcase_recipe: is missing"),
        ("[scan]\npath = heart.nii\n", 'text needs "quotation marks"'),
        ('heartcase_recipe = 1\nname = "Müller"\nscan = { path = "a.nii" }\n', "letters a to z without accents"),
        ("seconds = 2.0\ndampening_per_s = 3\n", "dampening_per_s: unknown setting: did you mean 'damping_per_s'?"),
    ],
)
def test_what_a_text_is_meant_as(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: str) -> None:
    path = tmp_path / "x.toml"
    path.write_text(text, encoding="utf-8")
    assert main(["validate", str(path)]) == 1
    said = capsys.readouterr().out
    assert words in said
    assert "script" not in said


def test_what_is_not_there_is_told_without_guessing_what_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["validate", str(tmp_path / "nope.toml")]) == 1
    assert capsys.readouterr().out.startswith("PATH: there is nothing at this path: check its spelling\n")


def test_a_misspelled_command_is_told_with_the_nearest_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["biuld", "x.toml"]) == 2
    assert capsys.readouterr().err.count("build") == 1
    assert main(["qqqq"]) == 2
    assert "mean" not in capsys.readouterr().err


def test_a_scan_that_is_not_there_is_told_beside_markers_that_are_missing(tmp_path, capsys):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text('heartcase_recipe = 1\nname = "x"\n[scan]\npath = "nowhere.nii.gz"\n', encoding="utf-8")
    assert main(["validate", str(recipe)]) == 1
    said = capsys.readouterr().out
    assert "2 problems found" in said
    assert "scan.path: there is no such file" in said
    assert "the watershed needs markers" in said
