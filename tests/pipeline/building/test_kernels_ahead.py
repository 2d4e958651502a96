"""The list of kernels that a build compiles ahead is what a build calls: no more, no less."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from heartcase.pipeline.building.kernels_ahead import LIST, SCAN, kernels_needed
from heartcase.pipeline.stages.table import steps
from heartcase.schemas.recipe.recipe import load_recipe
from tests.pipeline.building.kernels_called import sample_recipe


def called(environment=os.environ, module="tests.pipeline.building.kernels_called"):
    """Kernels that a sample case calls, with the stage that calls each first, when all of them are in the cache.

    Or what another module's process calls.
    """
    compiled = []
    while True:
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder) / "called.json"
            command = [sys.executable, "-m", module, folder, str(output)]
            subprocess.run(command, check=True, env=environment)
            found = json.loads(output.read_text())
        compiled.append({key_of(one): one["seconds"] for one in found})
        # What this process had to compile, it had the types of functions in it that Python did not call.
        if not any(compiled[-1].values()):
            break
    times = {key: seconds for one in reversed(compiled) for key, seconds in one.items()}
    for one in found:
        one["seconds"] = times[key_of(one)]
    return found


def key_of(one):
    return one["module"], one["name"], json.dumps(one["types"])


def write(found, path=LIST):
    """One kernel a line."""
    parts = []
    for stage in found:
        kernels = [{name: one[name] for name in ("module", "name", "seconds", "types")} for one in found[stage]]
        lines = ",\n  ".join(json.dumps(one) for one in kernels)
        parts.append(f' "{stage}": [\n  {lines}\n ]' if kernels else f' "{stage}": []')
    path.write_text("{\n" + ",\n".join(parts) + "\n}\n")


def by_stage(found):
    return {
        stage: [one for one in found if one["stage"] == stage] for stage in (SCAN, *(step.name for step in steps()))
    }


def test_a_build_calls_what_is_listed_and_nothing_else():
    listed = {stage: {key_of(one) for one in kernels} for stage, kernels in json.loads(LIST.read_text()).items()}
    found = {stage: {key_of(one) for one in kernels} for stage, kernels in by_stage(called()).items()}
    advice = "run python -m tests.pipeline.building.test_kernels_ahead --write"
    for stage in found:
        assert found[stage] - listed[stage] == set(), f"called by {stage} and not listed: {advice}"
        assert listed[stage] - found[stage] == set(), f"listed and not called by {stage}: {advice}"


def test_only_stages_that_a_build_takes_are_compiled_for(tmp_path):
    recipe = load_recipe(sample_recipe(tmp_path))
    listed = json.loads(LIST.read_text())
    names = {one["name"] for one in listed["surface"]} - {one["name"] for one in listed["segment"]}
    assert {one.name for one in kernels_needed(recipe, until="segment")} & names == set()
    assert len(kernels_needed(recipe)) == sum(len(listed[step.name]) for step in steps())
    assert len(kernels_needed(recipe, makes_scan=True)) == len(kernels_needed(recipe)) + len(listed[SCAN])
    assert "surface" in recipe.parts
    bare = recipe.model_copy(update={"parts": ()})
    assert {one.name for one in kernels_needed(bare)} & names < names


if __name__ == "__main__" and sys.argv[1:] == ["--write"]:
    # With an empty cache, so that each kernel is compiled, and timed.
    with tempfile.TemporaryDirectory() as empty:
        write(by_stage(called(os.environ | {"NUMBA_CACHE_DIR": empty})))
