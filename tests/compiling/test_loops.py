"""Loops that threads share: each turn once, at any number of threads, with the errors of any part."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.compiling.kernel import KERNELS, kernel, loop_kernel
from heartcase.compiling.loops import PARTS_A_THREAD, LoopKernel, loop_part
from tests.compiling.all_modules import import_all


@loop_kernel
def _count(first, end, counts, add=1):
    """Count turns."""
    step = add * 1
    for n in numba.prange(first, end):
        counts[n] += step


@loop_kernel
def _square(values, squares):
    for n in numba.prange(len(values)):
        squares[n] = values[n] * values[n]


@loop_kernel
def _refuse(counts, bad):
    for n in numba.prange(len(counts)):
        if n == bad:
            raise ValueError("bad")
        counts[n] += 1


@kernel
def _numba_counts(first, end, counts, add):
    for n in range(first, end):
        counts[n] += add


def at_threads(count, work):
    before = numba.get_num_threads()
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    try:
        return work()
    finally:
        numba.set_num_threads(before)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 70), st.integers(0, 70), st.integers(1, 2), st.integers(1, 3))
def test_each_turn_is_taken_once(first, length, threads, add):
    counts, plain = np.zeros(200, np.int64), np.zeros(200, np.int64)
    at_threads(threads, lambda: _count(first, first + length, counts, add=add))
    _numba_counts(first, first + length, plain, add)
    np.testing.assert_array_equal(counts, plain)


def test_bounds_that_hold_nothing_take_no_turn():
    counts = np.zeros(10, np.int64)
    _count(7, 3, counts)
    _square(np.zeros(0), np.zeros(0))
    assert not counts.any()


def test_the_function_itself_gives_the_same():
    counts = np.zeros(10, np.int64)
    _count.py_func(2, 9, counts)
    found = np.zeros(10, np.int64)
    _count(2, 9, found)
    np.testing.assert_array_equal(found, counts)


def test_types_are_those_of_the_function():
    squares = np.zeros(100)
    _square(np.arange(100.0), squares)
    kind = numba.types.Array(numba.float64, 1, "C")
    assert (kind, kind) in _square.overloads
    np.testing.assert_array_equal(squares, np.arange(100.0) ** 2)
    other = numba.types.Array(numba.float32, 1, "C")
    assert (other, other) not in _square.overloads
    _square.compile((other, other))
    assert (other, other) in _square.overloads
    assert _square in KERNELS


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("bad", [0, 37, 99])
def test_an_error_of_any_part_is_raised_when_no_other_runs(threads, bad):
    counts = np.zeros(100, np.int64)
    with pytest.raises(ValueError, match="bad"):
        at_threads(threads, lambda: _refuse(counts, bad))
    kept = counts.copy()
    assert kept.max() <= 1
    _refuse(np.zeros(100, np.int64), -1)
    np.testing.assert_array_equal(counts, kept)


def test_many_callers_at_once_get_their_own_results():
    def one(seed):
        values = np.random.default_rng(seed).normal(size=1000 + seed)
        squares = np.full_like(values, np.nan)
        _square(values, squares)
        return np.array_equal(squares, values**2)

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(one, range(200)))


def test_a_caller_goes_on_where_all_helpers_are_busy(monkeypatch):
    numba.set_num_threads(min(2, numba.config.NUMBA_NUM_THREADS))
    if numba.get_num_threads() < 2:
        pytest.skip("numba may use one thread only here")
    free = threading.Event()
    with ThreadPoolExecutor(1) as busy:
        busy.submit(free.wait)
        monkeypatch.setattr("heartcase.compiling.loops._threads", lambda: busy)
        squares = np.zeros(1000)
        _square(np.arange(1000.0), squares)
        np.testing.assert_array_equal(squares, np.arange(1000.0) ** 2)
        free.set()


def test_parts_that_a_thread_began_are_waited_for_where_no_other_can_be_had(monkeypatch):
    done = []

    class Few(ThreadPoolExecutor):
        def submit(self, *given):
            if done or self._threads:
                raise RuntimeError("can't start new thread")
            return super().submit(*given)

    def part(number, count, *_):
        if threading.current_thread() is not threading.main_thread():
            time.sleep(0.2)
        done.append(number)

    made = LoopKernel(_square.py_func, lambda _: part)
    with Few(2) as pool:
        monkeypatch.setattr("heartcase.compiling.loops._threads", lambda: pool)
        monkeypatch.setattr(numba, "get_num_threads", lambda: 3)
        made(np.zeros(4), np.zeros(4))
    assert sorted(done) == list(range(3 * PARTS_A_THREAD))


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as POSIX does")
def test_an_interrupted_loop_ends_when_no_part_runs_any_more(monkeypatch):
    begun, ended = [], []

    def part(number, *_):
        begun.append(number)
        if threading.current_thread() is threading.main_thread():
            time.sleep(0.1)
        else:
            time.sleep(0.8)
        ended.append(number)

    made = LoopKernel(_square.py_func, lambda _: part)
    monkeypatch.setattr(numba, "get_num_threads", lambda: 2)
    # who runs the tests may have signals ignored
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            made(np.zeros(4), np.zeros(4))
    finally:
        signal.signal(signal.SIGINT, before)
    count = len(ended)
    time.sleep(0.9)
    assert len(ended) == count


def test_one_thread_takes_the_loop_whole_and_two_in_parts(monkeypatch):
    taken = []
    made = LoopKernel(_square.py_func, lambda part: lambda *given: taken.append(given[:2]))
    at_threads(1, lambda: made(np.zeros(4), np.zeros(4)))
    assert taken == [(0, 1)]
    taken.clear()
    if numba.config.NUMBA_NUM_THREADS > 1:
        at_threads(2, lambda: made(np.zeros(4), np.zeros(4)))
        assert sorted(taken) == [(n, 2 * PARTS_A_THREAD) for n in range(2 * PARTS_A_THREAD)]


def _returns(values):
    for n in numba.prange(len(values)):
        values[n] += 1
    return values


def _adds_up(values):
    total = 0.0
    for n in numba.prange(len(values)):
        total += values[n]


def _carries(values, total):
    for n in numba.prange(len(values)):
        total += values[n]


def _two_loops(values):
    for n in numba.prange(len(values)):
        values[n] += 1
    for n in numba.prange(len(values)):
        values[n] += 1


def _branches(values):
    if len(values) > 3:
        values[:] = 0
    for n in numba.prange(len(values)):
        values[n] += 1


def _by_steps(values):
    for n in numba.prange(0, len(values), 2):
        values[n] += 1


@pytest.mark.parametrize("function", [_returns, _adds_up, _carries, _two_loops, _branches, _by_steps])
def test_other_functions_are_refused(function):
    with pytest.raises(ValueError, match=f"{function.__name__} is no loop_kernel"):
        loop_part(function)


def test_a_part_keeps_the_lines_and_names_of_its_function():
    part = loop_part(_count.py_func)
    assert part.__code__.co_filename == _count.py_func.__code__.co_filename
    lines = {line for _, _, line in part.__code__.co_lines() if line}
    written = {line for _, _, line in _count.py_func.__code__.co_lines() if line}
    assert max(lines) == max(written)
    assert part.__name__ == "_count"
    assert part.__defaults__ == (1,)


def test_every_loop_kernel_of_the_package_can_be_parted():
    import_all()
    loops = [one for one in KERNELS if isinstance(one, LoopKernel) and one.__module__.startswith("heartcase.")]
    assert len(loops) > 40
    for one in loops:
        assert loop_part(one.py_func)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system forks no processes")
def test_a_forked_process_has_threads_of_its_own():
    squares = np.zeros(1000)
    _square(np.arange(1000.0), squares)
    code = (
        "import os, numpy as np; from tests.compiling.test_loops import _square, at_threads\n"
        "values = np.arange(1000.0); out = np.zeros(1000); at_threads(2, lambda: _square(values, out))\n"
        "child = os.fork()\n"
        "out[:] = 0; at_threads(2, lambda: _square(values, out)); same = (out == values**2).all()\n"
        "if not child: os._exit(0 if same else 3)\n"
        "assert same and os.waitpid(child, 0)[1] == 0\n"
    )
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True, timeout=120)


def test_a_kernel_that_is_called_when_the_interpreter_ends_works_alone():
    code = (
        "import atexit, numpy as np; from tests.compiling.test_loops import _square, at_threads\n"
        "values = np.arange(1000.0); out = np.zeros(1000)\n"
        "atexit.register(lambda: print(float(np.abs(out - values**2).max())))\n"
        "atexit.register(lambda: at_threads(2, lambda: _square(values, out)))\n"
        "at_threads(2, lambda: _square(values, np.zeros(1000)))\n"
    )
    found = subprocess.run([sys.executable, "-c", code], check=True, timeout=120, capture_output=True, text=True)
    assert found.stdout.strip() == "0.0"
    assert not found.stderr
