"""``heartcase validate`` lists everything that is wrong with a case at once."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from heartcase.cli.main import main
from heartcase.pipeline.bundle import write_bundle
from heartcase.schemas.bundle import MANIFEST_NAME, FileRole
from heartcase.schemas.bundle_check import check_bundle
from heartcase.schemas.bundle_reader import open_bundle
from tests.factories import block_case

Manifest = dict[str, Any]


def overwrite(role: FileRole, array: str, change: Callable[[np.ndarray], None]) -> Callable[[Path, Manifest], None]:
    """Change an array's values where they lie in its file."""

    def plant(case: Path, manifest: Manifest) -> None:
        bundle = open_bundle(case)
        dtype, shape, offset = bundle.headers[role].arrays[array]
        change(np.memmap(bundle.path(role), dtype=np.dtype(dtype), mode="r+", offset=offset, shape=shape))

    return plant


def entry(manifest: Manifest, role: str) -> dict[str, Any]:
    return next(one for one in manifest["files"] if one["role"] == role)


def put(array: np.ndarray, where: Any, value: Any) -> None:
    array[where] = value


def in_manifest(change: Callable[[Manifest], object]) -> Callable[[Path, Manifest], None]:
    return lambda case, manifest: (change(manifest), None)[1]


PLANTS: dict[str, tuple[Callable[[Path, Manifest], None], str, str]] = {
    "NaN": (overwrite(FileRole.MAPPING, "offset", lambda a: put(a, 0, np.nan)), "mapping.offset", "not finite"),
    "number too high": (
        overwrite(FileRole.SURFACE, "triangles", lambda a: put(a, (0, 0), 10**6)),
        "surface.triangles",
        "only 0 to",
    ),
    "unknown label": (overwrite(FileRole.GRID, "cell_label", lambda a: put(a, 0, 240)), "grid.cell_label", "label"),
    "no flag": (overwrite(FileRole.GRID, "fixed", lambda a: put(a, 0, 7)), "grid.fixed", "0 or 1"),
    "coverage": (overwrite(FileRole.GRID, "cell_coverage", lambda a: put(a, 0, 2.0)), "grid.cell_coverage", "above 1"),
    "order": (overwrite(FileRole.GRID, "cells", lambda a: put(a, slice(None), a[::-1].copy())), "grid.cells", "ascend"),
    "weights": (overwrite(FileRole.MAPPING, "weights", lambda a: put(a, 0, 1.0)), "mapping.weights", "sum to one"),
    "hash": (
        in_manifest(lambda m: entry(m, "picking").update(sha256="0" * 64)),
        "files.picking",
        "was changed",
    ),
    "step": (
        in_manifest(lambda m: m["simulation"].update(step_default_s=1.0)),
        "simulation.step_default_s",
        "beyond",
    ),
    "count": (
        in_manifest(lambda m: m["simulation"].update(fixed_node_count=99)),
        "simulation.fixed_node_count",
        "99",
    ),
    "left-handed": (
        in_manifest(lambda m: m["grid_geometry"]["direction"].__setitem__(0, [-1.0, 0.0, 0.0])),
        "grid_geometry.direction",
        "right-handed",
    ),
    "far landmark": (
        in_manifest(lambda m: m.update(landmarks=[{"name": "far", "kind": "point", "points_mm": [[1e6, 0, 0]]}])),
        "landmarks.far",
        "100 m",
    ),
    "no material": (in_manifest(lambda m: m.update(materials=[])), "materials", "none"),
}
"""Name -> what plants a problem, its place, and words of its message; none hides another."""

SHAPELESS: dict[str, tuple[Callable[[Path, Manifest], None], str, str]] = {
    "unknown key": (in_manifest(lambda m: m.update(colour="red")), "case.json.colour", "unknown setting"),
    "wrong type": (in_manifest(lambda m: m.update(modality=7)), "case.json.modality", "text"),
    "missing key": (in_manifest(lambda m: m.pop("software_version")), "case.json.software_version", "is missing"),
    "negative": (
        in_manifest(lambda m: m["simulation"].update(tissue_volume_ml=-1.0)),
        "case.json.simulation.tissue_volume_ml",
        "at least 0",
    ),
}
"""The same, of a manifest that does not fit the format."""

HIDDEN_BY_SHAPE = {"step", "count"}
"""Not to be seen where ``simulation`` itself does not fit the format."""


def plant(case: Path, names: set[str]) -> None:
    """Plant problems in a sound case."""
    manifest = json.loads((case / MANIFEST_NAME).read_text())
    for name, (change, _, _) in (PLANTS | SHAPELESS).items():
        if name in names:
            change(case, manifest)
    (case / MANIFEST_NAME).write_text(json.dumps(manifest))


def is_listed(name: str, said: list[str]) -> bool:
    _, place, words = (PLANTS | SHAPELESS)[name]
    return any(line.startswith(f"{place}:") and words in line for line in said)


def test_everything_planted_is_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = tmp_path / "block.case"
    write_bundle(case, block_case())
    assert main(["validate", str(case)]) == 0
    plant(case, set(PLANTS))
    capsys.readouterr()
    assert main(["validate", str(case)]) == 1
    said = capsys.readouterr().out.splitlines()
    assert [name for name in PLANTS if not is_listed(name, said)] == []
    assert main(["validate", str(case), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["valid"] is False
    assert len(told["problems"]) >= len(PLANTS)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sets(st.sampled_from(sorted(PLANTS | SHAPELESS)), min_size=1))
def test_no_problem_hides_another(tmp_path_factory: pytest.TempPathFactory, names: set[str]) -> None:
    case = tmp_path_factory.mktemp("planted") / "block.case"
    write_bundle(case, block_case())
    plant(case, names)
    said = [str(problem) for problem in check_bundle(case)]
    hidden = HIDDEN_BY_SHAPE if "negative" in names else set()
    assert [name for name in names - hidden if not is_listed(name, said)] == []


def test_a_lost_file_hides_nothing_in_the_others(tmp_path: Path) -> None:
    case = tmp_path / "block.case"
    write_bundle(case, block_case())
    names = set(PLANTS) - {"hash"}
    plant(case, names)
    lost = next(case.glob("picking-*"))
    lost.unlink()
    said = [str(problem) for problem in check_bundle(case)]
    assert any("files.picking" in line and "is missing" in line for line in said)
    assert [name for name in names if not is_listed(name, said)] == []
