"""A thread that works out the newest of what it is given, beside the steps."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

__all__ = ["NewestWorker"]

Given = TypeVar("Given")
Made = TypeVar("Made")


class NewestWorker(Generic[Given, Made]):
    """A thread that works out the newest thing it was given, one after another; those that wait meanwhile are left out.

    ``newest`` is the last result; None where there is none yet.

    Parameters
    ----------
    work
        Works a thing out.
    name
        Name of the thread.
    heard
        Called by the thread whenever there is a new result.
    """

    def __init__(self, work: Callable[[Given], Made], *, name: str, heard: Callable[[], None] = lambda: None) -> None:
        self.newest: Made | None = None
        self._work = work
        self._heard = heard
        self._given: Given | None = None
        self._wake = threading.Condition()
        self._is_closing = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def ask(self, given: Given) -> None:
        """Work this out next; one that waits is left out."""
        with self._wake:
            self._given = given
            self._wake.notify_all()

    def close(self) -> None:
        """End the thread."""
        with self._wake:
            self._is_closing = True
            self._wake.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._wake:
                while self._given is None and not self._is_closing:
                    self._wake.wait()
                if self._is_closing:
                    return
                given, self._given = self._given, None
            assert given is not None
            with np.errstate(all="ignore"):
                self.newest = self._work(given)
            self._heard()
