"""Threads that meet see what the others wrote; one that fails or is interrupted leaves nobody waiting."""

from __future__ import annotations

import multiprocessing
import sys
import time

import numpy as np
import pytest
from numba import njit

from heartcase.simulator.engine.cpu.barrier import ThreadTeam, raise_to, wait_at


@njit(nogil=True)
def pass_on(values, rounds, thread, thread_count, barrier):
    """In each round a thread adds its neighbour's last value to its own: wrong as soon as one runs ahead."""
    if not wait_at(barrier, thread_count):
        return -1
    for number in range(rounds):
        now, later = values[number % 2], values[1 - number % 2]
        later[thread] = (now[thread] + now[(thread + 1) % thread_count]) % 1_000_003
        wait_at(barrier, thread_count)
    return values[rounds % 2, thread]


def expected(start, rounds):
    values = start.copy()
    for _ in range(rounds):
        values = (values + np.roll(values, -1)) % 1_000_003
    return values


@pytest.mark.parametrize("run_count", [4, pytest.param(200, marks=pytest.mark.slow)])
@pytest.mark.parametrize("thread_count", [1, 2, 3, 7])
def test_nobody_runs_ahead(thread_count, run_count):
    """Also with more threads than cores."""
    start = np.arange(1, thread_count + 1)
    team, rounds = ThreadTeam(), 300
    for _ in range(run_count):
        values = np.stack([start, np.zeros_like(start)])
        result = team.run(thread_count, lambda *part: int(pass_on(values, rounds, *part)))  # noqa: B023
        np.testing.assert_array_equal(values[rounds % 2], expected(start, rounds))
        assert result == values[rounds % 2, 0]


@pytest.mark.parametrize("failing", [0, 1, 2])
def test_a_part_that_fails_leaves_nobody_waiting(failing):
    team, begun = ThreadTeam(), []

    def work(thread, thread_count, barrier):
        begun.append(thread)
        if thread == failing:
            raise ValueError(f"part {thread}")
        return int(pass_on(np.ones((2, 3), np.int64), 10, thread, thread_count, barrier))

    with pytest.raises(ValueError, match=f"part {failing}"):
        team.run(3, work)
    assert sorted(begun) == [0, 1, 2]
    values = np.ones((2, 3), np.int64)
    assert team.run(3, lambda *part: int(pass_on(values, 5, *part))) == 32


def test_an_interrupt_before_the_own_part_begins_leaves_the_work_undone():
    values = np.ones((2, 2), np.int64)

    def work(thread, thread_count, barrier):
        if thread == 0:
            time.sleep(0.05)
            raise KeyboardInterrupt
        return int(pass_on(values, 5, thread, thread_count, barrier))

    with pytest.raises(KeyboardInterrupt):
        ThreadTeam().run(2, work)
    np.testing.assert_array_equal(values, 1)


def run_in_fork(team, answer):
    values = np.ones((2, 2), np.int64)
    answer.put(team.run(2, lambda *part: int(pass_on(values, 5, *part))))


@pytest.mark.skipif(sys.platform == "win32", reason="processes do not fork there")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own():
    team, values = ThreadTeam(), np.ones((2, 2), np.int64)
    assert team.run(2, lambda *part: int(pass_on(values, 5, *part))) == 32
    context = multiprocessing.get_context("fork")
    answer = context.SimpleQueue()
    child = context.Process(target=run_in_fork, args=(team, answer))
    child.start()
    child.join(60)
    assert child.exitcode == 0
    assert answer.get() == 32


@njit(nogil=True)
def raise_all(array, value, thread, thread_count, barrier):
    wait_at(barrier, thread_count)
    for _ in range(1000):
        for place in range(len(array)):
            raise_to(array, place, np.int8(value + thread))
    return 0


def test_the_highest_value_stays_whoever_writes_last():
    array = np.array([0, 1, 5], np.int8)
    ThreadTeam().run(3, lambda *part: int(raise_all(array, 1, *part)))
    np.testing.assert_array_equal(array, [3, 3, 5])
