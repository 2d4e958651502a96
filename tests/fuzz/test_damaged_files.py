"""Damaged files are read or refused in a line: no traceback, no hang, no flood of memory, nothing else touched."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.fuzz.corpus import KINDS

USUAL, MANY = 60, 1000
NEEDS_LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the limit on memory is set as on Linux")


def fuzz(kind: str, count: int, seed: int) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz.worker", kind, str(count), str(seed)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    result = json.loads(done.stdout.strip().splitlines()[-1])
    assert result["findings"] == [], "\n".join(result["findings"][:5])
    assert result["read"] + result["refused"] == count
    # A damaged log of approvals is not refused: the case is a draft again, and the log's problems are told.
    assert kind == "approvals" or result["refused"] > 0.2 * count, result


@NEEDS_LINUX
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files(kind: str) -> None:
    fuzz(kind, USUAL, seed=1)


@NEEDS_LINUX
@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", KINDS)
def test_many_damaged_files(kind: str) -> None:
    fuzz(kind, MANY, seed=2)
