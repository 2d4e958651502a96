"""A locked recipe builds the same case, whatever defaults a later heartcase has."""

import hashlib
import os
import struct
import tomllib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from heartcase.pipeline.building.lock import (
    check_lock,
    lock_recipe,
    recipe_text,
    setting_changes,
    stage_changes,
    unlocked_recipe,
)
from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.data import Scan
from heartcase.pipeline.stages.read import region_of_scan
from heartcase.pipeline.stages.resolve import resolve_recipe
from heartcase.schemas.errors import RecipeError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe
from heartcase.schemas.toml import toml_text
from tests.ball import write_ball_recipe, write_ball_scan
from tests.pipeline.altered_defaults import altered_defaults
from tests.pipeline.stage_tables import with_versions
from tests.schemas.recipes import recipes

EDITS = """
[[edits]]
kind = "remove"
label = "muscle"
radius_mm = 4
points_mm = [[10, 0, 0], [24, 0, 0]]
[[edits]]
kind = "close_defect"
position_mm = [17, 0, 0]
diameter_mm = 12
axis = [1, 0, 0]
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    directory = tmp_path_factory.mktemp("lock")
    write_ball_scan(directory / "scan.nii.gz")
    path = write_ball_recipe(
        directory / "scan.nii.gz", directory / "ball.toml", parts='parts = ["surface"]', more=EDITS
    )
    # Grid and walls are left to their rules, so that the lock has something to work out.
    path.write_text(path.read_text().replace("[grid]\ncell_mm = 4.0\n", ""))
    return directory


@pytest.fixture(scope="module")
def locked(work):
    recipe = load_recipe(work / "ball.toml")
    text = recipe_text(lock_recipe(recipe, directory=work, out=work))
    (work / "ball.lock.toml").write_text(text)
    return text


def relocked(text, **changes):
    """The locked recipe with some of its tables changed."""
    data = tomllib.loads(text)
    for key, change in changes.items():
        data[key] = change(data[key])
    return parse_recipe(toml_text(data))


def test_every_setting_is_stated_and_locking_again_changes_nothing(work, locked):
    recipe = parse_recipe(locked)
    assert check_lock(recipe, work, scan_of(work)) == ()
    again = recipe_text(lock_recipe(recipe, directory=work, out=work))
    assert again == locked
    # What rules find for voxels of 2 mm and no grown wall, by their own formulas.
    assert recipe.filter.time_step == pytest.approx(1 / (4 * 3 / 2.0**2))
    assert recipe.walls.smoothing_mm == pytest.approx(0.8 * 2.0)
    assert recipe.walls.band_mm == pytest.approx(3 * 2.0)
    assert recipe.grid.node_count == 30_000
    assert recipe.case_id is not None
    assert [label.value for label in recipe.labels] == [0, 1, 2]


def scan_of(work):
    return region_of_scan(load_recipe(work / "ball.toml"), work)


@pytest.mark.usefixtures("plain_reports")
def test_the_locked_recipe_builds_the_same_bytes_by_the_same_keys(work, locked, monkeypatch):
    small = work / "small.toml"
    small.write_text((work / "ball.toml").read_text() + "\n[grid]\ncell_mm = 5.0\n")
    recipe = load_recipe(small)
    text = recipe_text(lock_recipe(recipe, directory=work, out=work))
    first = build_case(recipe, directory=work, out=work / "first")
    case = (first.case / "case.json").read_bytes()
    store = work / "first" / ".heartcase-cache"
    second = build_case(parse_recipe(text), directory=work, out=work / "second", cache=store)
    assert (second.case / "case.json").read_bytes() == case
    assert set(second.reused) >= {"filter", "segment", "walls", "edit", "grid", "surface", "map"}
    with altered_defaults(monkeypatch) as count:
        assert count > 40
        later = parse_recipe(text)
        third = build_case(later, directory=work, out=work / "second", cache=store)
        assert not third.changed
        assert set(third.reused) >= {*second.reused, "bundle"}
    assert third.warnings == first.warnings


def test_later_defaults_change_a_recipe_but_not_its_lock(work, locked, monkeypatch):
    plain, scan = (work / "ball.toml").read_text(), scan_of(work)
    before = resolve_recipe(parse_recipe(locked), scan).model_dump(mode="json")
    unset = tomllib.loads(locked)["lock"]["unset"]
    assert {"region", "scan.series", "labels.snomed", "edits[remove].into", "grid.cell_mm"} <= set(unset)
    with altered_defaults(monkeypatch):
        assert resolve_recipe(parse_recipe(locked), scan).model_dump(mode="json") == before
        # The plain recipe does not withstand it.
        with pytest.raises(RecipeError, match="leave label out"):
            parse_recipe(plain)
        # Without the list of what stays unset, a default of a later version gets in.
        with pytest.raises(RecipeError, match="cell_mm or node_count, not both"):
            relocked(locked, lock=lambda table: table | {"unset": []})


@given(recipe=recipes())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
def test_any_recipe_resolves_to_a_fixed_point(recipe):
    geometry = Geometry.of(shape=(4, 3, 2), spacing_mm=(0.7, 1.1, 3.0))
    scan = Scan(np.zeros(geometry.shape, np.float32), geometry, "CT")
    resolved = resolve_recipe(recipe, scan)
    again = resolve_recipe(resolved, scan)
    assert again == resolved
    assert again.filter is resolved.filter
    assert again.walls is resolved.walls
    assert again.grid is resolved.grid
    assert parse_recipe(recipe_text(resolved)).model_dump() == resolved.model_dump()


def test_what_a_scan_is_known_by_never_changes():
    """Locks and identifiers of years ago hold this hash: size, affine, values, little-endian, and nothing else."""
    geometry = Geometry.of(shape=(1, 2, 3), spacing_mm=(0.5, 2, 4), origin_mm=(-1e-9, 20.25, -30))
    scan = Scan(np.array([[[1, -2, 3.5], [0, 5, 6]]], np.float32), geometry, "CT", {"kvp": 1}, ("a warning",))
    affine = [0.5, 0, 0, 0, 0, 2, 0, 20.25, 0, 0, 4, -30, 0, 0, 0, 1]
    content = struct.pack("<3q", 3, 2, 1) + struct.pack("<16d", *affine) + struct.pack("<6f", 1, -2, 3.5, 0, 5, 6)
    assert scan.values_sha256 == hashlib.sha256(content).hexdigest()
    assert scan.values_sha256 is scan.values_sha256, "worked out once"


def test_paths_start_at_the_lock(work, tmp_path):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    recipe = load_recipe(work / "ball.toml")
    locked = lock_recipe(recipe, directory=work, out=folder)
    assert not os.path.isabs(locked.scan.path)
    assert (folder / locked.scan.path).resolve() == (work / "scan.nii.gz").resolve()
    assert locked.missing_files(folder) == ()
    absolute = recipe.model_copy(update={"scan": recipe.scan.model_copy(update={"path": str(work / "scan.nii.gz")})})
    assert lock_recipe(absolute, directory=work, out=folder).scan.path == str(work / "scan.nii.gz")


def test_another_scan_is_refused_unless_it_is_accepted(work, locked):
    scan = scan_of(work)
    values = scan.values.copy()
    values[3, 4, 5] += 1
    other = Scan(values, scan.geometry, scan.modality)
    with pytest.raises(RecipeError, match=r"scan: its values or its place .* --accept-inputs"):
        check_lock(parse_recipe(locked), work, other)
    (warning,) = check_lock(parse_recipe(locked), work, other, accept_inputs=True)
    assert "its values or its place are not those" in warning.text
    # What a header says beside geometry and values is no part of it.
    assert check_lock(parse_recipe(locked), work, Scan(scan.values, scan.geometry, "CT", {"a": 1})) == ()


def test_other_markers_are_refused_by_their_number(work, tmp_path):
    (tmp_path / "JANE-DOE.mrk.json").write_text('{"markups": []}')
    recipe = load_recipe(work / "ball.toml")
    named = parse_recipe(
        (work / "ball.toml").read_text().replace('"scan.nii.gz"', f'"{work / "scan.nii.gz"}"')
        + '[[markers]]\npath = "JANE-DOE.mrk.json"\n'
    )
    locked = lock_recipe(named, directory=tmp_path, out=tmp_path)
    assert check_lock(locked, tmp_path, scan_of(work)) == ()
    (tmp_path / "JANE-DOE.mrk.json").write_text('{"markups": [1]}')
    with pytest.raises(RecipeError) as error:
        check_lock(locked, tmp_path, scan_of(work))
    assert [problem.place for problem in error.value.problems] == ["markers[1]"]
    assert "JANE" not in str(error.value)
    assert recipe.lock is None


@pytest.mark.parametrize(
    ("table", "change"),
    [
        ("filter", {"iterations": 9}),
        ("walls", {"band_mm": 7.0}),
        ("grid", {"node_count": 31_000}),
        ("surface", {"triangle_count": 2001}),
    ],
)
def test_a_lock_that_was_edited_is_built_with_a_warning(work, locked, table, change):
    edited = relocked(locked, **{table: lambda settings: settings | change})
    (warning,) = check_lock(edited, work, scan_of(work))
    assert "the locked recipe was edited after it was locked" in warning.text
    # locking it again makes the edit its own
    again = lock_recipe(edited, directory=work, out=work)
    assert getattr(again, table).model_dump().items() >= change.items()
    assert check_lock(again, work, scan_of(work)) == ()


def test_what_says_the_same_is_no_edit(work, locked):
    scan = scan_of(work)
    data = tomllib.loads(locked)
    turned = toml_text({key: data[key] for key in reversed(data)}) + "# a note\n"
    assert check_lock(parse_recipe(turned), work, scan) == ()
    # a lock of before this hash was kept says nothing about it
    older = relocked(locked, lock=lambda table: {k: v for k, v in table.items() if k != "settings_sha256"})
    assert check_lock(older, work, scan) == ()


def test_other_stage_versions_are_the_first_warning(work, locked, monkeypatch):
    with_versions(monkeypatch, walls=99, markers=98)
    recipe = relocked(locked, surface=lambda table: {k: v for k, v in table.items() if k != "atlas"})
    first, second, third = check_lock(recipe, work, scan_of(work))
    assert "walls 99" in first.text
    assert "markers 98" in first.text
    # a line that was taken out is an edit as well
    assert "was edited after it was locked" in second.text
    assert 'surface.atlas, which takes the default, "cone"' in third.text
    assert stage_changes(recipe.lock.stages).keys() == {"walls", "markers"}
    threshold = recipe.model_copy(update={"segment": recipe.segment.model_copy(update={"method": "threshold"})})
    assert "markers" not in check_lock(threshold, work, scan_of(work))[0].text


def test_unlocking_gives_the_recipe_back(work, locked, monkeypatch):
    recipe = parse_recipe((work / "ball.toml").read_text())
    unlocked = unlocked_recipe(parse_recipe(locked))
    assert resolve_recipe(unlocked, scan_of(work)) == resolve_recipe(recipe, scan_of(work))
    assert setting_changes(parse_recipe(locked), unlocked) == ()
    with altered_defaults(monkeypatch, only=["FilterSettings", "SurfaceSettings", "MaterialSettings"]):
        later = unlocked_recipe(parse_recipe(locked))
        places = {change.place for change in setting_changes(parse_recipe(locked), later)}
    assert {"filter.iterations", "surface.atlas"} <= places
    assert "surface.triangle_count" not in places
