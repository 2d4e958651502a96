"""One process at a time compiles a kernel; the others wait for it, and take what it left in the cache.

Besides the time: numba chooses the name of a file for what it compiled from the index that it read before. Two
processes that compile a function for different types at once can choose the same name, and each then finds the other's
code there, which crashes, or computes something else.
"""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from numba.core.compiler_lock import global_compiler_lock

__all__ = ["compiled_by_one"]

_WAIT_S = 0.02
_LONGEST_WAIT_S = 600.0
"""A process that takes longer for one kernel is not waited for any more; then both compile it."""
_held: set[str] = set()
"""Lock files that this process holds: a kernel may call itself with other types."""


def compiled_by_one(
    compile_it: Callable[[Any], Any], is_known: Callable[[Any], bool], path: Callable[[], str]
) -> Callable[[Any], Any]:
    """Compile a kernel while no other process does.

    Parameters
    ----------
    compile_it
        Compiles for a signature, or loads from the cache.
    is_known
        Whether that is done for a signature in this process.
    path
        Gives that of the lock file, beside the kernel's files in the cache; called before the first is compiled.
    """

    def compile_alone(signature: Any) -> Any:
        # numba's lock first: another thread that holds it may be waiting for this file.
        with global_compiler_lock:
            if is_known(signature):
                return compile_it(signature)
            with _lock_of(path()), _no_collection():
                return compile_it(signature)

    return compile_alone


@contextmanager
def _no_collection() -> Iterator[None]:
    """Python's collector of cycles held back: it looks at all that numba holds, again and again."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@contextmanager
def _lock_of(path: str) -> Iterator[None]:
    if path in _held:
        yield
        return
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:  # a cache that cannot be written to has nothing to protect
        yield
        return
    _held.add(path)
    try:
        end = time.monotonic() + _LONGEST_WAIT_S
        while not _is_taken(descriptor) and time.monotonic() < end:
            time.sleep(_WAIT_S)
        yield
    finally:
        _held.discard(path)
        os.close(descriptor)


if os.name == "posix":
    import fcntl

    def _is_taken(descriptor: int) -> bool:
        """Whether the lock is this process's now; the system lets go of it when the process ends, however it ends."""
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        return False

else:
    import msvcrt

    def _is_taken(descriptor: int) -> bool:
        """Whether the lock is this process's now; the system lets go of it when the process ends, however it ends."""
        with suppress(OSError):
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
            return True
        return False
