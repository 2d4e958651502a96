"""Two pieces of work at the same time."""

import os
import sys
import threading
import time

import numba
import pytest

from heartcase.pipeline.kernels.parallel import (
    all_side_by_side,
    background_worker,
    every_other,
    in_one_thread,
    may_share,
    side_by_side,
    two_workers,
)


@pytest.fixture
def two_threads():
    before = numba.get_num_threads()
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    numba.set_num_threads(2)
    yield
    numba.set_num_threads(before)


def test_both_results_come_back_and_both_run_at_once(two_threads):
    meeting = threading.Barrier(2, timeout=20.0)

    def first():
        meeting.wait()
        return threading.get_ident()

    def second():
        meeting.wait()
        return threading.get_ident(), numba.get_num_threads()

    one, (other, threads) = side_by_side(first, second)
    assert one == threading.get_ident() != other
    assert threads == 2


@pytest.mark.parametrize("count", [2, 3])
def test_with_few_cores_work_in_the_background_leaves_them_to_others(two_threads, count):
    if count > numba.config.NUMBA_NUM_THREADS:
        pytest.skip(f"fewer than {count} threads")
    numba.set_num_threads(count)

    def about():
        return numba.get_num_threads(), os.nice(0) if sys.platform == "linux" else 0

    before = about()
    one, other = side_by_side(about, about, second_in_background=True)
    with background_worker("of-a-test") as worker:
        assert worker.submit(about).result() == other
    assert one == about() == before
    is_behind = count == 2 and sys.platform == "linux"
    assert other == (1 if count == 2 else count, min(19, before[1] + 10) if is_behind else before[1])


def test_with_one_thread_one_comes_after_the_other():
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        assert side_by_side(threading.get_ident, threading.get_ident) == (threading.get_ident(),) * 2
    finally:
        numba.set_num_threads(before)


@pytest.mark.parametrize("which", [0, 1])
def test_an_error_of_either_comes_out_when_both_have_ended(two_threads, which):
    ended = []

    def fine():
        ended.append(1)

    def wrong():
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        side_by_side(*((wrong, fine) if which == 0 else (fine, wrong)))
    assert ended == [1]


def test_several_pieces_are_done_two_at_a_time_and_come_back_in_order(two_threads):
    meeting = threading.Barrier(2, timeout=20.0)

    def met(number):
        meeting.wait()
        return number, threading.get_ident()

    found = all_side_by_side([lambda number=number: met(number) for number in range(6)])
    assert [number for number, _ in found] == list(range(6))
    assert len({thread for _, thread in found}) == 2
    assert all_side_by_side([]) == []


def test_with_one_thread_several_pieces_come_one_after_the_other():
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        done = []
        assert all_side_by_side([lambda n=n: done.append(n) or n for n in range(5)]) == [0, 1, 2, 3, 4]
        assert done == [0, 1, 2, 3, 4]
    finally:
        numba.set_num_threads(before)


def test_after_an_error_no_further_piece_is_begun(two_threads):
    begun = []

    def wrong():
        raise IndexError("no")

    with pytest.raises(IndexError, match="no"):
        all_side_by_side([wrong, lambda: time.sleep(0.3), *[lambda: begun.append(1)] * 50])
    assert len(begun) <= 1


def test_every_chunk_is_taken_once_and_the_even_ones_first():
    for count in range(12):
        order = [every_other.py_func(number, count) for number in range(count)]
        assert order == [*range(0, count, 2), *range(1, count, 2)]


def test_a_pool_has_as_many_threads_as_its_caller_may_use_and_its_kernels_too(two_threads):
    def asked(pool):
        return pool._max_workers, pool.submit(numba.get_num_threads).result()

    with two_workers() as pool:
        assert asked(pool) == (2, 2)
    with in_one_thread():
        assert not may_share()
        with two_workers() as pool:
            assert asked(pool) == (1, 1)
    assert numba.get_num_threads() == 2


def test_as_many_threads_as_before_are_used_behind_an_error(two_threads):
    with pytest.raises(ZeroDivisionError), in_one_thread():
        _ = 1 / 0
    assert numba.get_num_threads() == 2
