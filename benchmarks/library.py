"""What a library costs beside its stages: finding which of a thousand cases are stale.

The peer reads every file that a recipe names and compares hashes. Both have to find the same cases: those of which the
recipe, the scan or a file of the case was changed.
"""

from __future__ import annotations

import hashlib
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.library.plan import CaseRecord, files_written, is_up_to_date, plan_library, write_record

RECIPE = """heartcase_recipe = 1
name = "case-{number}"
[scan]
path = "scan-{number}.nii"
[[strokes]]
label = "left ventricle"
radius_mm = 1.4
points_mm = {points}
[[strokes]]
label = "background"
radius_mm = 2.0
points_mm = [[50.0, 50.0, 50.0], [60.0, 50.0, 50.0]]
"""


@dataclass(frozen=True)
class Inputs:
    """Folder of the recipes, folder of the cases, hash of what each was made from, names of the stale ones."""

    library: Path
    out: Path
    sha256: dict[str, str]
    stale: frozenset[str]


@dataclass(frozen=True)
class Output:
    """Names of the cases that were found to be stale."""

    stale: frozenset[str]


def prepare(params: dict[str, Any]) -> Inputs:
    """Recipes with a long stroke, scans and cases of a few kilobytes: less than a real library's."""
    count, changed_count = int(params.pop("case_count")), int(params.pop("changed_count"))
    folder = Path(tempfile.mkdtemp(prefix="heartcase-benchmark-library-"))
    library, out = folder / "recipes", folder / "out"
    library.mkdir()
    random = np.random.Generator(np.random.PCG64(1))
    for number in range(count):
        points = random.uniform(-40.0, 40.0, (100, 3)).round(1).tolist()
        (library / f"{number}.toml").write_text(RECIPE.format(number=number, points=points))
        (library / f"scan-{number}.nii").write_bytes(random.bytes(int(params["scan_kb"]) << 10))
    params.pop("scan_kb")
    for case in plan_library(library):
        path = out / f"{case.name}.case" / "case.json"
        path.parent.mkdir(parents=True)
        path.write_bytes(random.bytes(1000))
        write_record(CaseRecord(case.name, case.stamp, files=files_written(out, [f"{case.name}.case/case.json"])), out)
    sha256 = {f"case-{number}": _sha256(library, out, number) for number in range(count)}
    changed = random.choice(count, changed_count, replace=False)
    for turn, number in enumerate(changed.tolist()):
        recipe, scan = library / f"{number}.toml", library / f"scan-{number}.nii"
        if turn % 3 == 0:
            recipe.write_text(recipe.read_text().replace("radius_mm = 1.4", "radius_mm = 1.5"))
        elif turn % 3 == 1:
            scan.write_bytes(scan.read_bytes()[:-1] + b"\1")
        else:
            (out / f"case-{number}.case" / "case.json").unlink()
    return Inputs(library, out, sha256, frozenset(f"case-{number}" for number in changed.tolist()))


def heartcase(inputs: Inputs) -> Output:
    cases = plan_library(inputs.library)
    return Output(frozenset(case.name for case in cases if not is_up_to_date(case, inputs.out)))


def hashes(inputs: Inputs) -> Output:
    """Read everything."""
    numbers = {name: int(name.removeprefix("case-")) for name in inputs.sha256}
    found = {name: _sha256(inputs.library, inputs.out, number) for name, number in numbers.items()}
    return Output(frozenset(name for name, sha256 in found.items() if sha256 != inputs.sha256[name]))


def _sha256(library: Path, out: Path, number: int) -> str:
    text = (library / f"{number}.toml").read_text()
    case = out / f"case-{number}.case" / "case.json"
    content = (text.encode(), (library / tomllib.loads(text)["scan"]["path"]).read_bytes())
    return hashlib.sha256(b"".join((*content, case.read_bytes() if case.exists() else b""))).hexdigest()


METHODS = {"heartcase": heartcase, "hashes": hashes}


def errors(inputs: Inputs, output: Output) -> dict[str, float]:
    return {
        "cases judged wrongly [1]": float(len(output.stale ^ inputs.stale)),
        "cases [1]": float(len(inputs.sha256)),
        "stale [1]": float(len(inputs.stale)),
    }
