"""Damaged files are read or refused in a line: no traceback, no hang, no flood of memory, nothing else touched."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence

import pytest

from tests.fuzz.corpus import KINDS

USUAL, MANY = 60, 1000
NEEDS_LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the limit on memory is set as on Linux")


def fuzz(kinds: Sequence[str], count: int, seed: int) -> tuple[dict[str, dict], str]:
    """What came of each kind, and what went to standard error."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz.worker", str(count), str(seed), *kinds],
        capture_output=True,
        text=True,
        check=False,
    )
    results = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    return {result["kind"]: result for result in results}, done.stderr[-4000:]


def hold(result: dict, count: int, told: str) -> None:
    assert result["findings"] == [], "\n".join([*result["findings"][:5], told])
    assert result["read"] + result["refused"] == count
    # A damaged log of approvals is not refused: the case is a draft again, and the log's problems are told.
    assert result["kind"] == "approvals" or result["refused"] > 0.2 * count, result


@pytest.fixture(scope="module")
def usual():
    """All kinds by one process, as importing takes longer than a kind does."""
    return fuzz(KINDS, USUAL, seed=1)


@NEEDS_LINUX
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files(kind: str, usual) -> None:
    results, told = usual
    assert kind in results, told
    hold(results[kind], USUAL, told)


@NEEDS_LINUX
@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", KINDS)
def test_many_damaged_files(kind: str) -> None:
    results, told = fuzz([kind], MANY, seed=2)
    assert kind in results, told
    hold(results[kind], MANY, told)
