"""The sample cases from scan to mapping: sound meshes at every level of detail, vertices on their own side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from heartcase.cli.main import main
from heartcase.pipeline.artifacts.cache import Cache
from heartcase.pipeline.building.runner import Runner, SilentListener, run_stages
from heartcase.pipeline.mesh.decimation.decimate import folded_triangles, mesh_defects
from heartcase.pipeline.mesh.triangles.intersections import self_intersections
from heartcase.pipeline.stages.resolve import resolve_recipe
from heartcase.pipeline.stages.stage import StageOutputs, Work, have
from heartcase.schemas.recipe.recipe import load_recipe
from tests.pipeline.sides import sides

SAMPLES = Path(__file__).parents[2] / "sample_cases"


def outputs_of(name: str, folder: Path) -> StageOutputs:
    """Every stage of a sample case but the bundle."""
    recipe = load_recipe(SAMPLES / f"{name}.toml")
    directory = SAMPLES
    if name.endswith("_phantom"):
        size = name.removesuffix("_phantom")
        assert main(["phantom", str(folder / "out" / name), "--size", size, "--scan-only"]) == 0
        directory = folder / "sample_cases"
        directory.mkdir()
    if not (directory / recipe.scan.path).exists():
        pytest.skip("the scan is not at hand; the recipe says where to get it")
    runner = Runner(Cache(folder / "cache"), SilentListener(), force=False)
    work = Work(recipe, directory, cache=runner.cache)

    def after(stage):
        if stage == "read":
            work.recipe = resolve_recipe(recipe, have(work.outputs.scan).get())

    run_stages(runner, work, after=after)
    return work.outputs


@pytest.mark.slow
@pytest.mark.parametrize("name", ["adult_phantom", "child_phantom", "chest_ct"])
def test_a_sample_case_is_sound_and_its_vertices_are_on_their_own_side(name, tmp_path):
    nodes = outputs_of(name, tmp_path)
    structures, grid = have(nodes.structures).get(), have(nodes.grid).get()
    surface, mapped = have(nodes.surface).get(), have(nodes.grid_map).get()
    assert len(surface.levels) == len(mapped.levels) == 2
    for level, tie in ((surface, mapped), *zip(surface.levels, mapped.levels, strict=True)):
        vertices = level.vertices_mm.astype(np.float64)
        assert mesh_defects(vertices, level.triangles).is_clean
        assert folded_triangles(vertices, level.triangles).sum() == 0
        assert len(self_intersections(vertices, level.triangles)) == 0
        mesh = trimesh.Trimesh(vertices, level.triangles, process=False)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        found = sides(structures, level, grid, tie)
        assert not found.wrong.any(), (len(level.triangles), vertices[found.wrong].tolist())
    assert surface.quality["distance_p99_mm"] < 0.5 * min(structures.geometry.spacing_mm)
