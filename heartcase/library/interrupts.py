"""Ctrl-C while processes start and end: a terminal sends it to all of them, and only the main one is to answer."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from types import FrameType

__all__ = ["held_interrupts", "inherited_deafness"]


@contextlib.contextmanager
def held_interrupts(say: Callable[[str], None] | None = None) -> Iterator[None]:
    """Let what is done finish before Ctrl-C is heard: once, as KeyboardInterrupt, at the end.

    Parameters
    ----------
    say
        Told at once, the first time, that it was heard.
    """
    if threading.current_thread() is not threading.main_thread():
        # Python hears signals in its main thread only.
        yield
        return
    heard = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal heard
        if say is not None and not heard:
            say("interrupted: stopping the workers, which takes some seconds")
        heard = True

    before = signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if heard:
            raise KeyboardInterrupt


@contextlib.contextmanager
def inherited_deafness() -> Iterator[None]:
    """Threads that are started meanwhile, and the processes that these start, never hear Ctrl-C.

    A process that is still importing cannot have been told yet to leave it to the main one: it would end with a
    traceback. Where threads have no signals of their own (Windows) this does nothing.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # It lifts the mask of the thread in which it starts, which would be one of these.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
