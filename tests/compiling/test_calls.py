"""Lent tuples and functions called by place, against the same in Python; and that numba's cache brings them back."""

import os
import subprocess
import sys
from typing import NamedTuple

import numba
import numpy as np
import pytest

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import kernel
from heartcase.compiling.tuple_addresses import lend


class Inner(NamedTuple):
    values: np.ndarray
    factor: float


class Outer(NamedTuple):
    inner: Inner
    which: np.ndarray


@called
def _one(outer, n):
    if n < 0:
        raise ValueError("below zero")
    return outer.inner.factor * outer.inner.values[outer.which[n]]


@kernel(parallel=True)
def _all(outer, out):
    lent = lend(outer)
    for n in numba.prange(len(out)):
        out[n] = _one(lent, n)


@kernel
def _at(outer, n):
    return _one(lend(outer), n)


def outer() -> Outer:
    return Outer(Inner(np.arange(50.0), 3.0), np.arange(49, -1, -1, dtype=np.int32))


def test_lent_tuples_and_called_functions_give_what_python_does():
    out = np.empty(50)
    _all(outer(), out)
    np.testing.assert_array_equal(out, 3.0 * np.arange(49.0, -1.0, -1.0))
    with pytest.raises(ValueError, match="below zero"):
        _at(outer(), -1)


def test_another_process_loads_them_and_compiles_nothing(tmp_path):
    code = (
        "import numpy as np; from tests.compiling import test_calls as t; out = np.empty(50); t._all(t.outer(), out);"
        "print(out.sum(), sum(t._all.stats.cache_misses.values()))"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    printed = [
        subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert [line.split() for line in printed] == [["3675.0", "1"], ["3675.0", "0"]]


@copied
def _twice(outer, n):
    return 2.0 * _one(outer, n)


@kernel
def _twice_at(outer, n):
    return _twice(lend(outer), n)


@kernel
def _four_times_at(outer, n):
    return 2.0 * _twice(lend(outer), n)


def test_what_was_compiled_with_code_from_the_cache_is_loaded_alone(tmp_path):
    """The second process compiles its kernel with ``_twice`` from the cache, the third finds all that kernel calls."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    printed = []
    for name in ("_twice_at", "_four_times_at", "_four_times_at"):
        code = (
            f"from tests.compiling import test_calls as t; f = t.{name}; value = f(t.outer(), 9);"
            "print(value, sum(f.stats.cache_misses.values()), sum(t._twice.stats.cache_hits.values()))"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        printed.append(done.stdout.split())
    assert printed == [["240.0", "1", "0"], ["480.0", "1", "1"], ["480.0", "0", "0"]]
