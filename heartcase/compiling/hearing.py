"""Who wants to hear that a kernel is compiled, as it is not in the cache; numba, which takes long to load, is not."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["compiling_now", "is_compiling", "tell_of_compiling", "told_when_compiling"]

_ears: list[Callable[[], None]] = []
_running: list[object] = []
"""One for each kernel that is being compiled, or looked for in the cache."""


@contextmanager
def told_when_compiling(told: Callable[[], None], *, after_s: float) -> Iterator[None]:
    """Be told, once, when kernels have been compiling for some time while the body runs.

    Parameters
    ----------
    told
        Called from another thread.
    after_s
        How long one kernel or several have been compiling by then, s: what is compiled sooner is not told.
    """
    lock = threading.Lock()
    timers: list[threading.Timer] = []
    is_told = False

    def ring() -> None:
        nonlocal is_told
        with lock:
            timers.clear()
            if is_told or not is_compiling():
                return
            is_told = True
        told()

    def hear() -> None:
        with lock:
            if is_told or timers:
                return
            timers.append(threading.Timer(after_s, ring))
            timers[0].daemon = True
            timers[0].start()

    _ears.append(hear)
    try:
        yield
    finally:
        _ears.remove(hear)
        with lock:
            is_told = True
            for one in timers:
                one.cancel()


@contextmanager
def compiling_now() -> Iterator[None]:
    """While a kernel is compiled, or loaded from the cache."""
    token = object()
    _running.append(token)
    try:
        yield
    finally:
        _running.remove(token)


def is_compiling() -> bool:
    """Whether a kernel is being compiled, or loaded, by any thread."""
    return bool(_running)


def tell_of_compiling() -> None:
    """A kernel is not in the cache, and is compiled now."""
    for hear in tuple(_ears):
        hear()
