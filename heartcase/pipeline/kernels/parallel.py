"""Parallel work: two functions at the same time, and in which order a kernel's loop takes what it works on."""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import TypeVar

import numba

from heartcase.compiling.kernel import kernel

__all__ = [
    "all_side_by_side",
    "background_worker",
    "every_other",
    "in_one_thread",
    "may_share",
    "side_by_side",
    "two_workers",
]

A = TypeVar("A")
B = TypeVar("B")
_FEW_CORES = 2
"""With no more than these, work in the background leaves them to what is waited for."""
_NICENESS = 10
"""By which the scheduler lets such work wait."""


def side_by_side(first: Callable[[], A], second: Callable[[], B], *, second_in_background: bool = False) -> tuple[A, B]:
    """Do two pieces of work, at the same time where there are threads for it.

    Much of what is neither a kernel nor waits for one runs in one thread only, so even with two cores there is room.

    Parameters
    ----------
    first
        Done in the calling thread.
    second
        Done in another one.
    second_in_background
        The first takes longer: the second leaves it the cores where there are few (:func:`background_worker`).

    Returns
    -------
    tuple
        Both results.

    Raises
    ------
    Exception
        What either raised, the first one's first; by then both have ended.
    """
    if not may_share():
        return first(), second()
    with background_worker() if second_in_background else _pool(1) as pool:
        other = pool.submit(second)
        one = first()
    return one, other.result()


def two_workers() -> ThreadPoolExecutor:
    """A pool of two threads, or of one where the caller may use no more; kernels in them may use as many as here."""
    return _pool(min(2, numba.get_num_threads()))


def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, initializer=numba.set_num_threads, initargs=(numba.get_num_threads(),))


def background_worker(name: str = "") -> ThreadPoolExecutor:
    """A pool of one thread for work that is waited for last.

    Where there are few cores it takes what others leave idle of them, and its kernels use no other thread: so what is
    waited for first is there sooner. With more cores there is room for both.
    """
    return ThreadPoolExecutor(1, name, initializer=_begin_in_background, initargs=(numba.get_num_threads(),))


def _begin_in_background(thread_count: int) -> None:
    has_few = thread_count <= _FEW_CORES
    numba.set_num_threads(1 if has_few else thread_count)
    if has_few and sys.platform == "linux":
        # There it holds for the calling thread alone. Where it is not allowed, all is done but later.
        with suppress(OSError):
            os.nice(_NICENESS)


@contextmanager
def in_one_thread() -> Iterator[None]:
    """Have the kernels and pools that are called in this thread use no other one meanwhile.

    Little work is done sooner so where others use the cores too: who shares a loop waits for those that take part.
    """
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def all_side_by_side(tasks: Sequence[Callable[[], A]]) -> list[A]:
    """Do several pieces of work, two at a time as by :func:`side_by_side`, each begun in the order given.

    Returns
    -------
    list
        Their results, in the same order.

    Raises
    ------
    Exception
        What one raised; by then no other one runs any more.
    """
    waiting = deque(enumerate(tasks))
    results: dict[int, A] = {}

    def work() -> None:
        while (one := _next_of(waiting)) is not None:
            number, task = one
            try:
                results[number] = task()
            except BaseException:
                waiting.clear()
                raise

    side_by_side(work, work)
    return [results[number] for number in range(len(tasks))]


def _next_of(waiting: deque[A]) -> A | None:
    """Taken from the front, by one thread only; None where nothing is left."""
    try:
        return waiting.popleft()
    except IndexError:
        return None


def may_share() -> bool:
    """Whether :func:`side_by_side` really does two things at the same time here."""
    return int(numba.get_num_threads()) > 1


@kernel(inline="always")
def every_other(number, count):
    """The chunk to take as the ``number``-th of ``count``: first the even ones, then the odd ones.

    Threads take a few parts of a loop, and what lies side by side is often as hard as each other.
    """
    even = (count + 1) // 2
    return 2 * number if number < even else 2 * (number - even) + 1
