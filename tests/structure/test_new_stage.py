"""A stage more: one module and one entry, and the build, its cache, its progress and its records know of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.artifacts.cache import Cache
from heartcase.pipeline.building.runner import Runner, run_stages
from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.write_images import write_scan
from heartcase.pipeline.stages import table
from heartcase.pipeline.stages.stage import Stage, Work
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import parse_recipe

RECIPE = """
heartcase_recipe = 1
name = "more"
[scan]
path = "scan.nrrd"
modality = "MR"
[segment]
method = "threshold"
[[segment.ranges]]
label = "left ventricle"
lower = 10.0
"""
DOUBLED = Stage(
    name="doubled",
    version=1,
    title="doubling the scan",
    deed="double the scan",
    subject="",
    output="doubled",
    kind=Scan,
    settings=lambda work: {"factor": 2},
    compute=lambda work: Scan(2 * work.outputs.scan.get().values, work.outputs.scan.get().geometry),
    inputs={"scan": "scan"},
)


@dataclass
class Ear:
    """Listens to a build."""

    heard: list

    def stage_started(self, stage, *, seconds_expected, seconds_after):
        self.heard.append(stage)

    def stage_finished(self, stage, *, seconds, reused):
        self.heard.append((stage, reused))


def test_a_stage_more_is_one_entry(tmp_path, monkeypatch):
    values = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
    write_scan(Scan(values, Geometry.of(shape=values.shape, spacing_mm=(1.0, 1.0, 1.0))), tmp_path / "scan.nrrd")
    recipe = parse_recipe(RECIPE)
    read, *others = table.STAGES
    monkeypatch.setattr(table, "STAGES", (read, DOUBLED, *others))
    for reused in (False, True):
        work = Work(recipe, tmp_path)
        ear = Ear([])
        run_stages(Runner(Cache(tmp_path / "cache"), ear, force=False), work, until="doubled")
        assert [record.stage for record in work.records] == ["read", "doubled"]
        assert work.records[1].settings == {"factor": 2}
        np.testing.assert_array_equal(work.outputs.of("doubled").get().values, 2 * values)
        assert ear.heard[-1] == ("doubled", reused)
    assert table.stage_versions()["doubled"] == 1
