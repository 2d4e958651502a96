"""Writing cases: determinism, replacement, figures, and crashes at every file operation."""

import json
import math
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.bundle.write_bundle import simulation_figures, write_bundle
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.image.region import crop_scan
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import FileRole, Material
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import BundleError
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.simulator.load import load_case
from tests.ball import write_ball_recipe, write_ball_scan
from tests.crash import Crash, crash_after
from tests.factories import block_case, block_grid


def contents(directory):
    return {path.name: path.read_bytes() for path in sorted(directory.iterdir())}


def test_the_same_case_gives_the_same_bytes_and_touches_nothing_the_second_time(tmp_path):
    assert write_bundle(tmp_path / "a.case", block_case())
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "a.case").iterdir()}
    assert not write_bundle(tmp_path / "a.case", block_case())
    assert before == {p: p.stat().st_mtime_ns for p in (tmp_path / "a.case").iterdir()}
    write_bundle(tmp_path / "b.case", block_case())
    assert contents(tmp_path / "a.case") == contents(tmp_path / "b.case")


def test_an_old_case_is_replaced_and_its_files_removed(tmp_path):
    write_bundle(tmp_path / "a.case", block_case(size=(2, 2, 2)))
    write_bundle(tmp_path / "a.case", block_case(size=(4, 2, 2)))
    assert check_bundle(tmp_path / "a.case") == ()
    manifest = open_bundle(tmp_path / "a.case").manifest
    assert manifest.simulation.cell_count == 16
    assert {p.name for p in (tmp_path / "a.case").iterdir()} == {e.name for e in manifest.files} | {"case.json"}


def test_a_directory_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "holiday.case").mkdir()
    (tmp_path / "holiday.case" / "photo.jpg").write_bytes(b"x")
    with pytest.raises(BundleError, match="something else"):
        write_bundle(tmp_path / "holiday.case", block_case())
    assert contents(tmp_path / "holiday.case") == {"photo.jpg": b"x"}


def test_a_crash_at_any_file_operation_leaves_the_old_case_or_the_new_one(tmp_path):
    old, new = block_case(size=(2, 2, 2)), block_case(size=(4, 2, 2))
    write_bundle(tmp_path / "old.case", old)
    operations = 0
    outcomes = set()
    while True:
        case = tmp_path / "case.case"
        shutil.rmtree(case, ignore_errors=True)
        shutil.copytree(tmp_path / "old.case", case)
        try:
            with crash_after(operations) as counter:
                write_bundle(case, new)
        except Crash:
            assert check_bundle(case) == (), f"after operation {operations}"
            outcomes.add(open_bundle(case).manifest.simulation.cell_count)
            write_bundle(case, new)
            assert contents(case).keys() == {*new.files, "case.json"}
            assert open_bundle(case).manifest == new.manifest
            operations += 1
            continue
        break
    assert counter.count == operations > 15
    assert outcomes == {8, 16}


def test_step_sizes_follow_the_lattice_formulas():
    grid = block_grid(cell_mm=3.5)
    figures = simulation_figures(grid, [Material(label=9, youngs_modulus_kpa=30.0, density_kg_m3=1060.0)])
    stiffness = 0.4 * 30e3 * 3.5e-3
    mass = 1060.0 * 3.5e-3**3
    assert figures.step_default_s == pytest.approx(0.8 * 2 / math.sqrt(24 * stiffness / mass), rel=1e-12)
    assert figures.step_limit_s == pytest.approx(2 / math.sqrt(20 * stiffness / mass), rel=1e-12)
    # Worked out by hand: 0.34 ms at 3.5 mm.
    assert round(figures.step_default_s * 1e3, 2) == 0.34
    assert figures.tissue_volume_ml == pytest.approx(12 * 3.5**3 / 1000)


def test_wrong_shapes_and_values_are_refused_before_anything_is_written(tmp_path):
    import dataclasses

    from heartcase.pipeline.bundle import write_bundle as bundle

    grid = block_grid()
    broken = dataclasses.replace(grid, cell_coverage=np.full(len(grid.cells), np.nan, np.float32))
    with pytest.raises(BundleError, match=r"grid\.cell_coverage"):
        bundle.assemble_bundle(
            bundle.BundleParts(grid=broken),
            [Material(label=9, youngs_modulus_kpa=1.0, density_kg_m3=1.0)],
            bundle.BundleSource(geometry=grid.geometry, sha256="0" * 64),
            bundle.BundleRecord(name="x"),
        )


def test_no_clock_no_path_and_no_user_is_in_the_manifest(tmp_path):
    write_bundle(tmp_path / "a.case", block_case())
    text = (tmp_path / "a.case" / "case.json").read_text()
    json.loads(text)
    for secret in (str(tmp_path), os.path.expanduser("~"), Path.cwd().name + "/"):
        assert secret not in text


def test_the_scan_part_is_the_filtered_scan_to_the_error_that_it_states(tmp_path):
    write_ball_scan(tmp_path / "scan.nii.gz")
    path = write_ball_recipe(tmp_path / "scan.nii.gz", tmp_path / "ball.toml", parts='parts = ["scan"]')
    recipe = load_recipe(path)
    result = build_case(recipe, directory=tmp_path, out=tmp_path / "out")
    assert check_bundle(result.case) == ()
    bundle = open_bundle(result.case)
    scan = load_case(result.case, needs=("scan",)).scan
    filtered = filter_scan(crop_scan(read_scan(tmp_path / "scan.nii.gz"), None), recipe.filter)
    assert scan.geometry.matches(filtered.geometry)
    values = np.stack([scan.slice_at(number) for number in range(scan.geometry.size[2])])
    assert np.abs(values - filtered.values).max() <= bundle.manifest.scan_values.error_max + 1e-3
    assert bundle.manifest.scan_values.error_max < np.ptp(filtered.values) / 100_000
    assert {entry.role for entry in bundle.manifest.files} == {FileRole.GRID, FileRole.SCAN}
