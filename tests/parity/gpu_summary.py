"""One page of what ``make gpu`` found: the device, the tests, the violent scripts, the benchmarks.

    python -m tests.parity.gpu_summary out/gpu

It reads ``tests.xml`` (pytest), ``violence.json`` (``tests.stress.many_violent_scripts``) and ``bench.json``
(``python -m benchmarks``), and writes ``summary.md`` beside them. What is not there is said to be missing.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numba
import numpy as np


def tests_told(path: Path) -> list[str]:
    """How many passed, and which did not."""
    suite = next(ElementTree.parse(path).getroot().iter("testsuite"))
    count, skipped = int(suite.get("tests", 0)), int(suite.get("skipped", 0))
    wrong = [
        f"{case.get('classname')}.{case.get('name')}"
        for case in suite.iter("testcase")
        if case.find("failure") is not None or case.find("error") is not None
    ]
    head = (
        f"{count - skipped - len(wrong)} of {count} passed, {skipped} skipped, in {float(suite.get('time', 0)):.0f} s."
    )
    none = ["- failed: not one test ran"] if count == skipped else []
    return [head, *none, *(f"- failed: `{name}`" for name in wrong)]


def violence_told(path: Path) -> list[str]:
    """What the scripts of each law left."""
    lines = [
        "| law | scripts | broke down | left cells | most cells | the others had none after | at the speed limit |",
        "|---|---|---|---|---|---|---|",
    ]
    for law, one in json.loads(path.read_text())["laws"].items():
        left = one["left_cells"]
        lines.append(
            f"| {law} | {one['scripts']} | {len(one['broke_down'])} | in {len(left)} | {max(left.values(), default=0)} "
            f"| {one['settled_s']:.2f} s | {len(one['at_the_limit'])} |"
        )
        lines += [f"- failed: {law}, script {broken['seed']}" for broken in one["broke_down"]]
    return lines


def benches_told(path: Path) -> list[str]:
    """Time and error of every case and method."""
    lines = ["| case | method | seconds | found |", "|---|---|---|---|"]
    records: list[dict[str, Any]] = json.loads(path.read_text())
    for one in records:
        found = "; ".join(f"{name}: {value:.4g}" for name, value in one["errors"].items())
        lines.append(f"| {one['case']} | {one['method']} | {one['seconds']:.4g} | {found} |")
    return lines


PARTS = (
    ("Tests", "tests.xml", tests_told),
    ("Violent scripts", "violence.json", violence_told),
    ("Benchmarks", "bench.json", benches_told),
)


def summary(folder: Path, head: str) -> str:
    """The page."""
    lines = ["# What a GPU showed", "", head]
    for title, name, told in PARTS:
        path = folder / name
        lines += ["", f"## {title}", ""]
        lines += told(path) if path.exists() else [f"`{name}` is missing: it was not run to its end."]
    return "\n".join(lines) + "\n"


def _commit() -> str:
    done = subprocess.run(["git", "rev-parse", "--short=7", "HEAD"], capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


if __name__ == "__main__":
    from tests.parity.gpu import device_told

    out = Path(sys.argv[1])
    head = f"{device_told()}; numba {numba.__version__}, NumPy {np.__version__}; `make gpu` at {_commit()}."
    (out / "summary.md").write_text(summary(out, head))
    print(out / "summary.md")
