"""Writing files so that a crash at any moment leaves the old one or the new one, never half of one."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import time
from collections.abc import Iterator
from pathlib import Path

__all__ = [
    "LOCK_NAME",
    "TEMPORARY_PREFIX",
    "atomic_write",
    "exclusive",
    "is_there",
    "remove_leftovers",
    "sha256_of_file",
]

TEMPORARY_PREFIX = ".heartcase-tmp-"
"""What the names of unfinished files start with."""

LEFTOVER_AGE_S = 3600.0

_UNFINISHED: set[str] = set()
"""Names of the files that this process is writing."""

LOCK_NAME = ".heartcase-lock"
"""Lock file inside a directory, on systems that cannot lock the directory itself."""


def atomic_write(path: Path | str, data: bytes | memoryview, *, is_flushed: bool = True) -> None:
    """Put ``data`` into a file: written beside it under another name, flushed to disk, then renamed over it.

    Not flushed where ``is_flushed`` is false: for what is checked when it is read, and made again where it is damaged.
    """
    path = Path(path)
    # Nobody can guess the name, so nobody can have put a link there; nor does another thread write under it.
    temporary = path.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{secrets.token_hex(4)}-{path.name}")
    _UNFINISHED.add(temporary.name)
    try:
        with temporary.open("xb") as file:
            file.write(data)
            file.flush()
            if is_flushed:
                os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
    finally:
        _UNFINISHED.discard(temporary.name)
    if is_flushed:
        _flush_directory(path.parent)


def _flush_directory(directory: Path) -> None:
    if os.name != "posix":
        return
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_leftovers(directory: Path | str) -> None:
    """Remove what killed runs left unfinished in a directory; what a living process is writing stays."""
    for leftover in Path(directory).glob(f"{TEMPORARY_PREFIX}*"):
        if not _is_being_written(leftover):
            with contextlib.suppress(OSError):
                leftover.unlink()


def _is_being_written(temporary: Path) -> bool:
    process, _, _ = temporary.name.removeprefix(TEMPORARY_PREFIX).partition("-")
    if not process.isdecimal():
        return False
    if int(process) == os.getpid():
        return temporary.name in _UNFINISHED
    if os.name != "posix":
        # There is no harmless way to ask for a process by its number, so age decides.
        with contextlib.suppress(OSError):
            return time.time() - temporary.stat().st_mtime < LEFTOVER_AGE_S
        return False
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


@contextlib.contextmanager
def exclusive(directory: Path | str) -> Iterator[None]:
    """Hold the lock of a directory, waiting for it; it is let go when the process ends, however it ends."""
    if os.name == "posix":
        import fcntl

        descriptor = os.open(directory, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield
        finally:
            os.close(descriptor)
    else:
        import msvcrt

        descriptor = os.open(Path(directory) / LOCK_NAME, os.O_RDWR | os.O_CREAT)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_LOCK, 1)  # type: ignore[attr-defined]
            yield
        finally:
            os.close(descriptor)


def is_there(path: Path | str) -> bool:
    """Whether there is something at a path; nothing is where the system takes it for no path, as a name too long."""
    # pathlib raises of such a path.
    return os.path.exists(path)


def sha256_of_file(path: Path | str) -> str:
    """SHA-256 of a file's content as 64 hexadecimal digits."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
