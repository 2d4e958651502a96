"""No stage's output changes without its version being raised.

The small case of ``stage_outputs.py`` goes through every stage, and ``stage_fingerprints.json`` has what came of it. On
a processor family that has a hash there, every bit must match. On another one, figures of each array must, to these
tolerances: counts 2%, standard deviations 2%, means and projections 5% of the array's standard deviation. When an
output was meant to change, raise its number in STAGE_VERSIONS and run

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

from heartcase.pipeline.runner import STAGE_VERSIONS, STAGES
from tests.pipeline.stage_outputs import INPUTS, sha256_of, stage_outputs, summary_of

FINGERPRINTS = Path(__file__).with_name("stage_fingerprints.json")
COUNT_TOLERANCE, MEAN_TOLERANCE, SPREAD_TOLERANCE = 0.02, 0.05, 0.02
FLOOR = 1e-5
"""Part of the mean that every figure may differ by: arrays of one value have no deviation."""
WRITE = "python -m tests.pipeline.test_stage_versions --write"

Outputs = Mapping[str, Mapping[str, np.ndarray]]


def cpu_family() -> str:
    return str(llvmlite.binding.get_host_cpu_name())


def problems_of(outputs: Outputs, stored: Mapping[str, Any], versions: Mapping[str, int], cpu: str) -> list[str]:
    """What is wrong with the versions, a line each."""
    problems: list[str] = []
    differing: set[str] = set()
    for stage in STAGES:
        fingerprint = stored.get(stage)
        if fingerprint is None:
            problems.append(f"{stage} has no fingerprint: run `{WRITE}`")
            continue
        is_blamed = not differing & set(_before(stage))
        if not _matches(outputs[stage], fingerprint, cpu):
            differing.add(stage)
        if versions[stage] != fingerprint["version"]:
            problems.append(f"the version of {stage} is not that of its fingerprint: run `{WRITE}`")
        elif stage in differing and is_blamed:
            problems.append(f"the output of {stage} changed: raise STAGE_VERSIONS['{stage}'] and run `{WRITE}`")
    return problems


def _before(stage: str) -> list[str]:
    return [earlier for one in INPUTS[stage] for earlier in (one, *_before(one))]


def _matches(arrays: Mapping[str, np.ndarray], fingerprint: Mapping[str, Any], cpu: str) -> bool:
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
    result = {}
    for stage in STAGES:
        old = stored.get(stage)
        keeps = old is not None and old["version"] == STAGE_VERSIONS[stage] and _matches(outputs[stage], old, "")
        hashes = {**(old["sha256"] if keeps and old else {}), cpu: sha256_of(outputs[stage])}
        summaries = {name: summary_of(array) for name, array in sorted(outputs[stage].items())}
        result[stage] = {
            "version": STAGE_VERSIONS[stage],
            "sha256": hashes,
            "arrays": old["arrays"] if keeps and old else summaries,
        }
    return result


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("heartcase.pipeline.report.build_report.build_report", lambda **_: "")
        return stage_outputs(tmp_path_factory.mktemp("stages"))


@pytest.fixture(scope="module")
def of_today(outputs):
    """Fingerprints as they would be written now, here."""
    return fingerprints_of(outputs, {}, cpu_family())


@pytest.fixture(scope="module")
def stored():
    return json.loads(FINGERPRINTS.read_text())


def test_no_output_changed_without_its_version(outputs, stored):
    assert problems_of(outputs, stored, STAGE_VERSIONS, cpu_family()) == []


def test_the_small_case_uses_every_stage(outputs):
    assert set(outputs) == set(STAGES) == set(INPUTS)
    assert set(np.unique(outputs["segment"]["labels"])) == {0, 1, 2, 3, 4}
    assert not np.array_equal(outputs["edit"]["tissue_mm"], outputs["walls"]["tissue_mm"])
    # The grown wall has the first free value.
    assert (outputs["walls"]["tissue"][outputs["walls"]["tissue_mm"] < 0] == 5).any()
    assert 0 < outputs["grid"]["fixed"].sum() < len(outputs["grid"]["fixed"])


@pytest.mark.parametrize("stage", STAGES)
def test_a_changed_output_is_found_and_the_right_stage_is_blamed(outputs, of_today, stage):
    cpu = cpu_family()
    assert problems_of(outputs, of_today, STAGE_VERSIONS, cpu) == []
    changed = {name: dict(arrays) for name, arrays in outputs.items()}
    for later in STAGES:
        if later == stage or stage in _before(later):
            name = max(changed[later], key=lambda key: changed[later][key].size)
            array = changed[later][name].copy()
            array.reshape(-1).view(np.uint8)[array.nbytes // 2] ^= 1
            changed[later][name] = array
    (problem,) = problems_of(changed, of_today, STAGE_VERSIONS, cpu)
    assert problem == f"the output of {stage} changed: raise STAGE_VERSIONS['{stage}'] and run `{WRITE}`"
    raised = {**STAGE_VERSIONS, stage: STAGE_VERSIONS[stage] + 1}
    (problem,) = problems_of(changed, of_today, raised, cpu)
    assert problem == f"the version of {stage} is not that of its fingerprint: run `{WRITE}`"


def test_on_another_processor_rounding_passes_and_a_real_change_does_not(outputs, of_today):
    random = np.random.Generator(np.random.PCG64(3))
    rounded = {
        stage: {
            name: (array * (1 + 1e-6 * random.normal(size=array.shape))).astype(array.dtype)
            if array.dtype.kind == "f"
            else array
            for name, array in arrays.items()
        }
        for stage, arrays in outputs.items()
    }
    assert problems_of(rounded, of_today, STAGE_VERSIONS, "another family") == []
    for stage, name, change in (
        ("filter", "values", lambda array: array * 1.03),
        ("segment", "labels", lambda array: np.roll(array, 1, axis=0)),
        ("walls", "tissue_mm", lambda array: array + 0.3),
        ("grid", "cells", lambda array: array[: int(0.97 * len(array))]),
        ("map", "weights", lambda array: array.astype(np.float64)),
    ):
        assert not _matches({**outputs[stage], name: change(outputs[stage][name])}, of_today[stage], "another family")
        gone = {key: value for key, value in outputs[stage].items() if key != name}
        assert not _matches(gone, of_today[stage], "another family")


def main(arguments: list[str]) -> int:
    stored = json.loads(FINGERPRINTS.read_text()) if FINGERPRINTS.exists() else {}
    with tempfile.TemporaryDirectory() as directory:
        outputs = stage_outputs(Path(directory))
    problems = problems_of(outputs, stored, STAGE_VERSIONS, cpu_family())
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
