"""Simulated crashes: every operation on files is counted, and after the n-th the process 'dies'."""

from __future__ import annotations

import contextlib
import io
import os
from unittest import mock


class Crash(BaseException):
    """The process is gone: no handler may catch it, and nothing after it may touch a file."""


class _Counter:
    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.count = 0
        self.dead = False


@contextlib.contextmanager
def crash_after(limit: int, error: BaseException | type[BaseException] = Crash):
    """Let ``limit`` file operations happen, then raise :class:`Crash` at the next and at all that follow.

    Writes are split: the operation that crashes leaves half of its bytes in the file, as a power cut would.
    With an ``OSError`` the process lives and its disk is full instead.
    """
    counter = _Counter(limit)

    def guarded(function):
        def call(*args, **kwargs):
            if counter.dead or counter.count >= counter.limit:
                counter.dead = True
                raise error
            counter.count += 1
            return function(*args, **kwargs)

        return call

    real_open = io.open

    class _File:
        """A file whose writes count, and whose last write is torn."""

        def __init__(self, file) -> None:
            self._file = file

        def write(self, data):
            if counter.dead or counter.count >= counter.limit:
                if not counter.dead:
                    self._file.write(bytes(data)[: len(data) // 2])
                    self._file.flush()
                counter.dead = True
                raise error
            counter.count += 1
            return self._file.write(data)

        def __getattr__(self, name):
            return getattr(self._file, name)

        def __enter__(self):
            return self

        def __exit__(self, *error):
            self._file.close()

    def counting_open(file, mode="r", *args, **kwargs):
        if not set(mode) & set("wax+"):
            return real_open(file, mode, *args, **kwargs)
        return _File(guarded(real_open)(file, mode, *args, **kwargs))

    with contextlib.ExitStack() as stack:
        for name in ("replace", "rename", "unlink", "remove", "mkdir", "fsync", "rmdir"):
            stack.enter_context(mock.patch.object(os, name, guarded(getattr(os, name))))
        stack.enter_context(mock.patch.object(io, "open", counting_open))
        stack.enter_context(mock.patch("builtins.open", counting_open))
        yield counter
