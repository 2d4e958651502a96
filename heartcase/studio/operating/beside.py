"""A process beside the server that works something out, and the thread that talks with it; one pair at a time."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

__all__ = ["Beside"]

_END_S = 2.0
"""How long a process that is ended is waited for, s."""


class Beside:
    """The process and its thread.

    Parameters
    ----------
    name
        What they are called.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._process: Any = None
        self._thread: threading.Thread | None = None

    def start(self, serve: Callable[..., None], *order: Any, talk: Callable[[Connection], None]) -> None:
        """Start a process, in place of the one before.

        Parameters
        ----------
        serve
            What it does, given its end of the line and the order; a new process must find it.
        order
            What else it is given.
        talk
            Talks with it over the other end, in a thread of its own.
        """
        self.end()
        context = multiprocessing.get_context("spawn")
        line, its_line = context.Pipe()
        self._process = context.Process(
            target=serve, args=(its_line, *order), daemon=True, name=f"heartcase-{self._name}"
        )
        self._process.start()
        its_line.close()
        self._thread = threading.Thread(target=_talk, args=(talk, line), name=self._name, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End the process and wait for its thread; nothing where there is none."""
        process, thread, self._process, self._thread = self._process, self._thread, None, None
        if process is not None:
            process.terminate()
            process.join(_END_S)
        if thread is not None:
            thread.join()

    @property
    def is_left(self) -> bool:
        """Asked by the thread that talks: whether its process was ended, or another took its place."""
        return self._thread is not threading.current_thread()


def _talk(talk: Callable[[Connection], None], line: Connection) -> None:
    with line:
        talk(line)
