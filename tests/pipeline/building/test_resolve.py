"""Settings that a recipe leaves open are found once in a build, and have a value from then on."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from heartcase.pipeline.building.lock import lock_recipe
from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.data import Scan
from heartcase.pipeline.image import filter_scan
from heartcase.pipeline.stages.resolve import SettingRules, resolve_recipe
from heartcase.pipeline.stages.stage import Node, Work, have
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe, plain_recipe
from heartcase.schemas.recipe.resolved import (
    DiffusionFilter,
    GridByCellSize,
    GridByNodeCount,
    NoFilter,
    ResolvedRecipe,
    ResolvedSegment,
    ResolvedWalls,
)
from heartcase.schemas.recipe.settings import FilterSettings, GridSettings, SegmentSettings, WallsSettings
from tests.ball import write_ball_recipe, write_ball_scan

GEOMETRY = Geometry.of(shape=(6, 5, 4), spacing_mm=(0.7, 1.1, 3.0))
SCAN = Scan(np.random.default_rng(1).normal(100.0, 9.0, GEOMETRY.shape).astype(np.float32), GEOMETRY, "CT")


def asked(settings=""):
    text = 'heartcase_recipe = 1\nname = "x"\nscan = {path = "x"}\n[segment]\nmethod = "labels"\nfile = "y"\n'
    return parse_recipe(text + settings)


def work_with(scan, recipe):
    work = Work(recipe, None)
    work.outputs.scan = Node("", lambda: scan)
    return work


def test_a_build_looks_for_a_scans_noise_once(tmp_path, monkeypatch):
    """For the filter and for the report together, and where all is stated for the report alone."""
    counts = []
    found = filter_scan.estimate_noise
    monkeypatch.setattr(filter_scan, "estimate_noise", lambda values: counts.append(1) or found(values))
    write_ball_scan(tmp_path / "scan.nii.gz")
    path = write_ball_recipe(tmp_path / "scan.nii.gz", tmp_path / "ball.toml", parts="parts = []")
    recipe = load_recipe(path)
    assert build_case(recipe, directory=tmp_path, out=tmp_path / "out").report.exists()
    assert len(counts) == 1
    locked = lock_recipe(recipe, directory=tmp_path, out=tmp_path)
    counts.clear()
    again = build_case(locked, directory=tmp_path, out=tmp_path / "out")
    assert "report" in again.seconds
    assert "filter" in again.reused
    assert len(counts) == 1


@pytest.mark.parametrize(
    ("settings", "kinds"),
    [
        ("", (DiffusionFilter, GridByNodeCount)),
        ("[filter]\nmethod = 'none'\n[grid]\ncell_mm = 2.5\n", (NoFilter, GridByCellSize)),
        ("[filter]\nconductance = 0.5\n[grid]\nnode_count = 900\n", (DiffusionFilter, GridByNodeCount)),
        ("[walls]\nsmoothing_mm = 0.0\nband_mm = 30.0\nfind_ends = true\n", (DiffusionFilter, GridByNodeCount)),
    ],
)
def test_what_is_stated_stays_and_the_rest_gets_a_value(settings, kinds):
    recipe = asked(settings)
    resolved = resolve_recipe(recipe, SCAN)
    assert isinstance(resolved, ResolvedRecipe)
    assert (type(resolved.filter), type(resolved.grid)) == kinds
    assert type(resolved.walls) is ResolvedWalls
    assert type(resolved.segment) is ResolvedSegment
    for part in ("filter", "segment", "walls", "grid"):
        stated = getattr(recipe, part).model_dump(exclude_unset=True)
        assert stated.items() <= getattr(resolved, part).model_dump().items()
    # nothing else is another thing than before
    parts = {"case_id", "filter", "segment", "walls", "grid"}
    assert resolved.model_dump(exclude=parts) == recipe.model_dump(exclude=parts)
    assert list(resolved.model_dump()) == list(recipe.model_dump())
    # and records are those of the plain types with the same values
    plain = recipe.model_copy(
        update={
            "case_id": resolved.case_id,
            "filter": FilterSettings(**resolved.filter.model_dump()),
            "segment": SegmentSettings(**resolved.segment.model_dump()),
            "walls": WallsSettings(**resolved.walls.model_dump()),
            "grid": GridSettings(**resolved.grid.model_dump()),
        }
    )
    assert resolved.model_dump_json() == plain.model_dump_json()


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        (DiffusionFilter, FilterSettings(method="gradient_diffusion", conductance=1.0)),
        (DiffusionFilter, FilterSettings(method="gradient_diffusion", time_step=0.1)),
        (DiffusionFilter, FilterSettings(conductance=1.0, time_step=0.1)),
        (DiffusionFilter, FilterSettings(method="none", conductance=1.0, time_step=0.1)),
        (NoFilter, FilterSettings()),
        (ResolvedSegment, SegmentSettings(noise_floor=1.0)),
        (ResolvedSegment, SegmentSettings(shape_sigma_mm=1.0)),
        (ResolvedWalls, WallsSettings(band_mm=3.0)),
        (ResolvedWalls, WallsSettings(smoothing_mm=3.0)),
        (GridByCellSize, GridSettings()),
        (GridByNodeCount, GridSettings()),
        (GridByNodeCount, GridSettings(cell_mm=2.0)),
    ],
)
def test_a_setting_without_a_value_is_refused(kind, settings):
    with pytest.raises(ValidationError):
        kind.of(settings)


def test_resolved_settings_cannot_be_changed():
    resolved = resolve_recipe(asked(), SCAN)
    with pytest.raises(ValidationError, match="frozen"):
        resolved.walls.band_mm = 1.0
    with pytest.raises(ValidationError, match="frozen"):
        resolved.grid = GridByCellSize(cell_mm=1.0)


def test_a_build_resolves_its_recipe_once():
    work = work_with(SCAN, asked())
    resolved = work.resolve()
    assert work.recipe is resolved
    assert work.resolve() is resolved
    assert resolved == resolve_recipe(asked(), SCAN)
    assert work.rules is work.rules


def test_a_band_that_is_too_narrow_for_another_table_is_widened_again():
    thick = [
        label.model_copy(update={"wall_thickness_mm": 40.0}) for label in asked().labels if label.wall_thickness_mm
    ]
    resolved = resolve_recipe(asked(), SCAN)
    wider = SettingRules(SCAN).resolve(resolved.model_copy(update={"labels": tuple(thick)}))
    assert resolved.walls.band_mm < 40.0
    assert wider.walls.band_mm == pytest.approx(43.0)


def test_a_single_voxel_needs_no_rule():
    geometry = Geometry.of(shape=(1, 1, 1), spacing_mm=(1.0, 1.0, 1.0))
    scan = Scan(np.full((1, 1, 1), 7.0, np.float32), geometry)
    resolved = resolve_recipe(plain_recipe(), scan)
    assert np.isfinite(resolved.filter.time_step)
    np.testing.assert_array_equal(filter_scan.filter_scan(scan, resolved.filter).values, scan.values)


def test_a_stage_before_the_one_that_it_needs_says_so():
    with pytest.raises(LookupError, match="in their order"):
        have(None)
    with pytest.raises(LookupError, match="in their order"):
        Work(asked(), None).resolve()
