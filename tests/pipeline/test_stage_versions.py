"""No stage's output changes without its version being raised.

The small cases of ``stage_outputs.py`` go through every stage, and ``stage_fingerprints.json`` has what came of it. On
a processor family that has a hash there, every bit must match. On another one, figures of each array must, to these
tolerances: counts 2%, standard deviations 2%, means and projections 5% of the array's standard deviation. When an
output was meant to change, raise the version in its module in pipeline/stages and run

    python -m tests.pipeline.test_stage_versions --write

Only the first stage of a chain that differs is blamed: with another input, another output is no surprise. So raise and
write for one stage before the next is worked on.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import llvmlite.binding
import numpy as np
import pytest

from heartcase.pipeline.stages.table import stage_names, stage_versions
from tests.pipeline.stage_outputs import INPUTS, Arrays, Outputs, inputs_of, sha256_of, stage_outputs, summary_of

STAGES, VERSIONS = stage_names(), stage_versions()
FINGERPRINTS = Path(__file__).with_name("stage_fingerprints.json")
COUNT_TOLERANCE, MEAN_TOLERANCE, SPREAD_TOLERANCE = 0.02, 0.05, 0.02
FLOOR = 1e-5
"""Part of the mean that every figure may differ by: arrays of one value have no deviation."""
WRITE = "python -m tests.pipeline.test_stage_versions --write"


def cpu_family() -> str:
    return str(llvmlite.binding.get_host_cpu_name())


def problems_of(outputs: Outputs, stored: Mapping[str, Any], versions: Mapping[str, int], cpu: str) -> list[str]:
    """What is wrong with the versions, a line each."""
    problems: list[str] = []
    differing: set[tuple[str, str]] = set()
    for stage in STAGES:
        of_stage = {recipe: arrays[stage] for recipe, arrays in outputs.items() if stage in arrays}
        fingerprint = stored.get(stage, {"version": versions[stage], "recipes": {}})
        if fingerprint["recipes"].keys() != of_stage.keys():
            problems.append(f"{stage} has no fingerprint of some recipe: run `{WRITE}`")
        known = of_stage.keys() & fingerprint["recipes"].keys()
        changed = {name for name in known if not _matches(of_stage[name], fingerprint["recipes"][name], cpu)}
        differing |= {(name, stage) for name in changed}
        # A recipe in which an input of the stage changed says nothing about the stage itself.
        is_blamed = any(not differing & {(name, before) for before in inputs_of(name, stage)} for name in changed)
        if versions[stage] != fingerprint["version"]:
            problems.append(f"the version of {stage} is not that of its fingerprint: run `{WRITE}`")
        elif is_blamed:
            problems.append(f"the output of {stage} changed: raise the version in stages/{stage}.py and run `{WRITE}`")
    return problems


def _matches(arrays: Arrays, fingerprint: Mapping[str, Any], cpu: str) -> bool:
    if cpu in fingerprint["sha256"]:
        return bool(fingerprint["sha256"][cpu] == sha256_of(arrays))
    if arrays.keys() != fingerprint["arrays"].keys():
        return False
    return all(_is_near(summary_of(array), fingerprint["arrays"][name]) for name, array in arrays.items())


def _is_near(found: Mapping[str, Any], stored: Mapping[str, Any]) -> bool:
    if found["dtype"] != stored["dtype"] or found["shape"][1:] != stored["shape"][1:]:
        return False
    if found["shape"] and abs(found["shape"][0] - stored["shape"][0]) > COUNT_TOLERANCE * stored["shape"][0]:
        return False
    near = MEAN_TOLERANCE * stored["std"] + FLOOR * abs(stored["mean"])
    if abs(found["mean"] - stored["mean"]) > near:
        return False
    if abs(found["std"] - stored["std"]) > SPREAD_TOLERANCE * stored["std"] + FLOOR * abs(stored["mean"]):
        return False
    if found["shape"] != stored["shape"]:
        return True
    return bool(np.abs(np.subtract(found["projections"], stored["projections"])).max() <= near)


def fingerprints_of(outputs: Outputs, stored: Mapping[str, Any], cpu: str) -> dict[str, Any]:
    """New fingerprints; the hashes of other families stay where they still hold."""
    result: dict[str, Any] = {}
    for stage in STAGES:
        old = stored.get(stage, {})
        before = old.get("recipes", {}) if old.get("version") == VERSIONS[stage] else {}
        result[stage] = {
            "version": VERSIONS[stage],
            "recipes": {
                recipe: _fingerprint_of(arrays[stage], before.get(recipe), cpu)
                for recipe, arrays in outputs.items()
                if stage in arrays
            },
        }
    return result


def _fingerprint_of(arrays: Arrays, old: Mapping[str, Any] | None, cpu: str) -> dict[str, Any]:
    kept = old if old is not None and _matches(arrays, old, "") else None
    return {
        "sha256": {**(kept["sha256"] if kept else {}), cpu: sha256_of(arrays)},
        "arrays": kept["arrays"] if kept else {name: summary_of(array) for name, array in sorted(arrays.items())},
    }


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    return stage_outputs(tmp_path_factory.mktemp("stages"))


@pytest.fixture(scope="module")
def of_today(outputs):
    """Fingerprints as they would be written now, here."""
    return fingerprints_of(outputs, {}, cpu_family())


@pytest.fixture(scope="module")
def stored():
    return json.loads(FINGERPRINTS.read_text())


def test_no_output_changed_without_its_version(outputs, stored):
    assert problems_of(outputs, stored, VERSIONS, cpu_family()) == []


def test_the_small_cases_use_every_stage_and_every_way_through_it(outputs):
    main_case = outputs["watershed"]
    assert set(main_case) == set(STAGES) == set(INPUTS)
    assert set(np.unique(main_case["segment"]["labels"])) == {0, 1, 2, 3, 4}
    assert not np.array_equal(main_case["edit"]["tissue_mm"], main_case["walls"]["tissue_mm"])
    # The grown wall has the first free value.
    assert (main_case["walls"]["tissue"][main_case["walls"]["tissue_mm"] < 0] == 5).any()
    assert 0 < main_case["grid"]["fixed"].sum() < len(main_case["grid"]["fixed"])
    # The patch has one, too.
    edited = outputs["labels"]["edit"]
    assert set(np.unique(edited["tissue"][edited["tissue_mm"] < 0])) == {3, 4, 5}
    assert set(np.unique(outputs["labels"]["segment"]["labels"])) == {0, 1, 2, 3}
    assert len(outputs["labels"]["grid"]["nodes"]) == pytest.approx(900, rel=0.1)
    assert set(np.unique(outputs["threshold"]["segment"]["labels"])) == {0, 1, 4}
    assert set(np.unique(outputs["points"]["markers"]["labels"])) == {0, 1, 2, 9, 255}
    assert "markers" not in outputs["threshold"]
    # Whole Hounsfield units for CT of more than 256 of them, all 65,536 numbers for anything else.
    slopes = {name: arrays["bundle"]["scan_values"][0] for name, arrays in outputs.items() if name != "watershed"}
    assert slopes["threshold"] == 1.0
    assert slopes["points"] < 256 / 65_535 < slopes["labels"]


@pytest.mark.parametrize("stage", STAGES)
def test_a_changed_output_is_found_and_the_right_stage_is_blamed(outputs, of_today, stage):
    cpu = cpu_family()
    assert problems_of(outputs, of_today, VERSIONS, cpu) == []
    for recipe in (name for name, arrays in outputs.items() if stage in arrays):
        changed = {name: {one: dict(arrays) for one, arrays in stages.items()} for name, stages in outputs.items()}
        for later in changed[recipe]:
            if later == stage or stage in inputs_of(recipe, later):
                arrays = changed[recipe][later]
                name = max(arrays, key=lambda key: arrays[key].size)
                array = arrays[name].copy()
                array.reshape(-1).view(np.uint8)[array.nbytes // 2] ^= 1
                arrays[name] = array
        (problem,) = problems_of(changed, of_today, VERSIONS, cpu)
        assert problem == f"the output of {stage} changed: raise the version in stages/{stage}.py and run `{WRITE}`"
        raised = {**VERSIONS, stage: VERSIONS[stage] + 1}
        (problem,) = problems_of(changed, of_today, raised, cpu)
        assert problem == f"the version of {stage} is not that of its fingerprint: run `{WRITE}`"


def test_what_one_recipe_shows_is_not_hidden_by_another(outputs, of_today):
    """One recipe's changed input is no excuse for a stage that changed in a recipe whose input did not."""
    changed = {name: {one: dict(arrays) for one, arrays in stages.items()} for name, stages in outputs.items()}
    for recipe, stage, name in (("threshold", "segment", "labels"), ("labels", "grid", "nodes")):
        changed[recipe][stage][name] = changed[recipe][stage][name] + 1
    blamed = [problem.split()[3] for problem in problems_of(changed, of_today, VERSIONS, cpu_family())]
    assert blamed == ["segment", "grid"]


def test_a_recipe_that_is_new_or_gone_needs_new_fingerprints(outputs, of_today):
    fewer = {name: dict(arrays) for name, arrays in outputs.items() if name != "threshold"}
    said = problems_of(fewer, of_today, VERSIONS, cpu_family())
    expected = [f"{stage} has no fingerprint of some recipe: run `{WRITE}`" for stage in outputs["threshold"]]
    assert sorted(said) == sorted(expected)
    # and hides no change of the others
    fewer["points"]["markers"] = {"labels": fewer["points"]["markers"]["labels"] + 1}
    blamed = [line for line in problems_of(fewer, of_today, VERSIONS, cpu_family()) if "output" in line]
    assert [line.split()[3] for line in blamed] == ["markers"]


def test_on_another_processor_rounding_passes_and_a_real_change_does_not(outputs, of_today):
    random = np.random.Generator(np.random.PCG64(3))
    rounded = {
        recipe: {
            stage: {
                name: (array * (1 + 1e-6 * random.normal(size=array.shape))).astype(array.dtype)
                if array.dtype.kind == "f"
                else array
                for name, array in arrays.items()
            }
            for stage, arrays in stages.items()
        }
        for recipe, stages in outputs.items()
    }
    assert problems_of(rounded, of_today, VERSIONS, "another family") == []
    for stage, name, change in (
        ("filter", "values", lambda array: array * 1.03),
        ("segment", "labels", lambda array: np.roll(array, 1, axis=0)),
        ("walls", "tissue_mm", lambda array: array + 0.3),
        ("grid", "cells", lambda array: array[: int(0.97 * len(array))]),
        ("map", "weights", lambda array: array.astype(np.float64)),
    ):
        for recipe, stages in outputs.items():
            if stage not in stages:
                continue
            arrays, fingerprint = stages[stage], of_today[stage]["recipes"][recipe]
            assert not _matches({**arrays, name: change(arrays[name])}, fingerprint, "another family")
            gone = {key: value for key, value in arrays.items() if key != name}
            assert not _matches(gone, fingerprint, "another family")


def main(arguments: list[str]) -> int:
    stored = json.loads(FINGERPRINTS.read_text()) if FINGERPRINTS.exists() else {}
    with tempfile.TemporaryDirectory() as directory:
        outputs = stage_outputs(Path(directory))
    problems = problems_of(outputs, stored, VERSIONS, cpu_family())
    for problem in problems:
        print(problem)
    if arguments != ["--write"]:
        return int(bool(problems))
    unraised = [problem for problem in problems if problem.startswith("the output of")]
    if unraised:
        print("nothing was written")
        return 1
    FINGERPRINTS.write_text(json.dumps(fingerprints_of(outputs, stored, cpu_family()), indent=1, sort_keys=True) + "\n")
    print(f"wrote {FINGERPRINTS.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
