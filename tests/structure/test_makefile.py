"""The Makefile does not silently keep the environment of another Python."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ASKED = "{}.{}".format(*sys.version_info[:2])


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@pytest.mark.parametrize(("there", "python", "is_refused"), [
    ("2.7", f"PYTHON={sys.executable}", True),
    (ASKED, f"PYTHON={sys.executable}", False),
    ("2.7", None, False),
    (None, f"PYTHON={sys.executable}", False),
])  # fmt: skip
def test_an_environment_of_another_python_is_told(tmp_path, there, python, is_refused):
    venv = tmp_path / "venv"
    if there is not None:
        (venv / "bin").mkdir(parents=True)
        (venv / "bin" / "python").write_text(f"#!/bin/sh\necho {there}\n")
        (venv / "bin" / "python").chmod(0o755)
    command = ["make", "--no-print-directory", "same-python", f"VENV={venv}", *([python] if python else [])]
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHON", "MAKEFLAGS")}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode != 0) == is_refused, done.stderr
    if is_refused:
        assert (
            f"was made with Python 2.7 but PYTHON={sys.executable} is {ASKED}: add VENV={venv}-{ASKED}" in done.stderr
        )
    # What makes an environment, or takes one that is there, asks this first.
    made = [
        line for line in (ROOT / "Makefile").read_text().splitlines() if "/installed: " in line and "gpu: $" not in line
    ]
    assert len(made) == 3
    assert all(line.endswith("| same-python") for line in made)
