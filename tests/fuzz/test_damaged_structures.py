"""Well-formed TOML and JSON with the wrong things in it: read, or refused in a line for each problem."""

from __future__ import annotations

import copy
import json
import math
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.pipeline.formats.labels.point_lists import read_point_lists
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import MANIFEST_NAME
from heartcase.schemas.errors import HeartcaseError, Problem
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.simulator.load import load_case
from heartcase.simulator.session.script import load_script
from tests.factories import block_case

ROOT = Path(__file__).parents[2]
USUAL, MANY = 100, 1000

SCALARS = (
    st.booleans()
    | st.integers(-(10**30), 10**30)
    | st.floats(allow_nan=True, allow_infinity=True)
    | st.text(max_size=20)
    | st.sampled_from(["", "../../etc/passwd", "a" * 5000, "\x1b[31m", "\u202e", "0", "1.0", "LPS", "aorta"])
)
VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
)


def places_in(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all that is inside a value."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    found = []
    for key, inner in items:
        found += [(*path, key), *places_in(inner, (*path, key))]
    return found


@st.composite
def damaged(draw: st.DrawFn, sound: dict[str, Any]) -> dict[str, Any]:
    """A copy in which one to four values are replaced, lost, doubled, or new."""
    value = copy.deepcopy(sound)
    for _ in range(draw(st.integers(1, 4))):
        path = draw(st.sampled_from(places_in(value)))
        holder: Any = value
        for key in path[:-1]:
            holder = holder[key]
        kind = draw(st.sampled_from(["replace", "replace", "lose", "add", "double"]))
        if kind == "replace":
            holder[path[-1]] = draw(VALUES)
        elif kind == "lose":
            del holder[path[-1]]
        elif isinstance(holder, dict):
            holder[draw(st.text(max_size=8))] = draw(VALUES) if kind == "add" else copy.deepcopy(holder[path[-1]])
        else:
            holder.insert(path[-1], draw(VALUES) if kind == "add" else copy.deepcopy(holder[path[-1]]))
        if not value:
            return copy.deepcopy(sound)
    return value


def toml_of(data: dict[str, Any]) -> str:
    """TOML text of a value, all tables but the outermost written inline."""

    def inline(value: Any) -> str:
        if isinstance(value, bool):
            return "true" if value else "false"
        if isinstance(value, dict):
            return "{" + ", ".join(f"{inline(key)} = {inline(inner)}" for key, inner in value.items()) + "}"
        if isinstance(value, list):
            return "[" + ", ".join(inline(inner) for inner in value) + "]"
        if isinstance(value, float):
            return repr(value) if math.isfinite(value) else "nan" if math.isnan(value) else f"{value:+f}"[:4]
        if isinstance(value, int):
            return str(value)
        plain = value.encode("utf-8", "replace").decode().replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else f"\\u{ord(c) % 0x10000:04x}" for c in plain) + '"'

    return "\n".join(f"{inline(key)} = {inline(value)}" for key, value in data.items())


def refuses_in_words(read: Callable[[], object]) -> None:
    """Read; only a :class:`HeartcaseError` of printable lines may come of it."""
    problems: tuple[Problem, ...] | None = None
    try:
        read()
    except HeartcaseError as error:
        problems = error.problems
    assert problems != ()
    for problem in problems or ():
        line = str(problem)
        assert line.strip()
        assert line.isprintable(), ascii(line)
        assert len(line) < 2000, len(line)


def many(test: Callable[..., None], strategy: st.SearchStrategy[Any], count: int, **fixed: Any) -> None:
    """Run a test on so many examples."""

    # The usual run is the same every time; the long one looks further each time.
    @settings(
        max_examples=count,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        database=None,
        derandomize=count == USUAL,
    )
    @given(strategy)
    def run(data: Any) -> None:
        test(data, **fixed)

    run()


RECIPE = tomllib.loads((ROOT / "sample_cases" / "chest_ct.toml").read_text()) | {
    "ends": [{"label": "aorta", "position_mm": [0.0, 0.0, 0.0], "axis": [0.0, 0.0, 1.0], "radius_mm": 9.0}],
    "edits": [{"kind": "add", "label": "aorta", "radius_mm": 2.0, "points_mm": [[0.0, 0.0, 0.0]]}],
    "markers": [{"path": "a.nrrd", "names": {"x": "aorta"}}],
}
SCRIPT = tomllib.loads((ROOT / "sample_cases" / "pull.toml").read_text())
POINT = {"id": "1", "label": "aorta", "position": [1.0, 2.0, 3.0], "positionStatus": "defined"}
MARKUPS = {
    "markups": [
        {"type": "Curve", "coordinateSystem": "LPS", "name": "aorta", "controlPoints": [POINT, POINT]},
        {"type": "Fiducial", "coordinateSystem": "RAS", "controlPoints": [POINT]},
    ]
}


def read_damaged_recipe(data: Any, folder: Path) -> None:
    path = folder / "case.toml"
    path.write_text(toml_of(data), encoding="utf-8")
    refuses_in_words(lambda: load_recipe(path))


def read_damaged_script(data: Any, folder: Path) -> None:
    path = folder / "pull.toml"
    path.write_text(toml_of(data), encoding="utf-8")
    refuses_in_words(lambda: load_script(path))


def read_damaged_markups(data: Any, folder: Path) -> None:
    path = folder / "points.mrk.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    refuses_in_words(lambda: read_point_lists(path))


def read_damaged_manifest(data: Any, folder: Path) -> None:
    case = folder / "block.case"
    (case / MANIFEST_NAME).write_text(json.dumps(data), encoding="utf-8")
    for problem in check_bundle(case):
        assert str(problem).isprintable(), ascii(str(problem))
        assert len(str(problem)) < 2000
    refuses_in_words(lambda: load_case(case, needs=("grid", "surface", "picking")))


def manifest_in(folder: Path) -> Any:
    write_bundle(folder / "block.case", block_case())
    data = json.loads((folder / "block.case" / MANIFEST_NAME).read_text())
    shutil.rmtree(folder / "block.case")
    write_bundle(folder / "block.case", block_case())
    return data


READERS: dict[str, tuple[Callable[..., None], Callable[[Path], Any]]] = {
    "recipe": (read_damaged_recipe, lambda folder: RECIPE),
    "script": (read_damaged_script, lambda folder: SCRIPT),
    "markups": (read_damaged_markups, lambda folder: MARKUPS),
    "manifest": (read_damaged_manifest, manifest_in),
}


@pytest.mark.parametrize("kind", READERS)
def test_damaged_structures(kind: str, tmp_path: Path) -> None:
    test, sound = READERS[kind]
    many(test, damaged(sound(tmp_path)), USUAL, folder=tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kind", READERS)
def test_many_damaged_structures(kind: str, tmp_path: Path) -> None:
    test, sound = READERS[kind]
    many(test, damaged(sound(tmp_path)), MANY, folder=tmp_path)
