"""Kernels compiled ahead, in other processes, while this one already works: numba's cache is what they share.

A list says which kernels, for which types. Each process is given the next of them. This process waits for one that it
needs and that is being compiled (:mod:`heartcase.compiling.compile_lock`), and compiles one itself that it needs and
that is yet to be begun. So nothing is compiled twice.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from heartcase.schemas.files import atomic_write

__all__ = ["Called", "Progress", "compiled_ahead", "core_count", "serve"]

_ROOT = Path(__file__).parents[2]
_SERVE = (
    "import sys; sys.path.append(sys.argv[1]); from heartcase.compiling.compile_ahead import serve;"
    "serve(sys.argv[2], int(sys.argv[3]))"
)
_BEHIND = 10
"""How far processes stand behind others that leave them the processors."""
_FIRST_SECONDS = 5.0
"""Of the list, after which the pace of this machine is known."""
_NOTE_NAME = "heartcase-compiled.txt"
_NOTED_MOST = 2000
"""Lines of the note; several versions of Python may share one."""


@dataclass(frozen=True)
class Called:
    """A kernel and the types that it is called with."""

    module: str
    name: str
    types: tuple[Any, ...]
    """As :func:`heartcase.compiling.signatures.as_json` writes them."""
    seconds: float
    """What compiling it took once on some machine, with what it calls; in proportion to each other."""


@dataclass(frozen=True)
class Progress:
    """How far compiling is."""

    done: int
    """Kernels that are in the cache."""
    failed: int
    """Kernels that could not be compiled ahead."""
    total: int
    """Kernels of the list."""
    seconds_left: float
    """Estimate, from how fast it went so far."""
    is_measured: bool = True
    """Whether it went far enough for that; the estimate is that of the list's machine until then."""


def core_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def compiled_ahead(
    wanted: Sequence[Called],
    *,
    processes: int,
    told: Callable[[Progress], None] = lambda _: None,
    is_behind: bool = False,
) -> Iterator[None]:
    """Compile kernels in other processes while the body runs; they are ended with it, however it ends.

    What was compiled before, from this code for this processor, is noted in the cache and left out; where nothing is
    left, no process is started. A process that cannot be started, or fails, is done without: what it would have
    compiled is compiled when it is called.

    Parameters
    ----------
    wanted
        In the order in which they will be needed.
    processes
        How many processes; 0 for none.
    told
        Called as kernels are done, from other threads than the caller's.
    is_behind
        Whether the processes leave the processors to all that others do.
    """
    note = None if processes < 1 or not wanted or getattr(sys, "frozen", False) else _note()
    if note is None:
        yield
        return
    noted = _read(note)
    left = [(one, line) for one, line in zip(wanted, _lines_of(wanted), strict=True) if line not in noted]
    if not left:
        yield
        return
    with _temporary_folder(note.parent) as unfinished:
        team = _ProcessTeam([one for one, _ in left], processes, told, unfinished, is_behind=is_behind)
        try:
            team.begin()
            yield
        finally:
            team.end()
            _add(note, [line for one, line in left if one in team.done])


@contextlib.contextmanager
def _temporary_folder(cache: Path) -> Iterator[str]:
    """A folder in numba's cache for files that are being written; what killed processes left there goes with it.

    Empty where none can be made: then there is no place for a cache either.
    """
    try:
        folder = tempfile.mkdtemp(prefix="heartcase-unfinished-", dir=cache)
    except OSError:
        folder = ""
    try:
        yield folder
    finally:
        if folder:
            shutil.rmtree(folder, ignore_errors=True)


class _ProcessTeam:
    """The processes, and a thread for each that hands it one kernel after the other."""

    def __init__(
        self,
        wanted: Sequence[Called],
        processes: int,
        told: Callable[[Progress], None],
        unfinished: str,
        *,
        is_behind: bool,
    ) -> None:
        self.waiting = deque(wanted)
        self.unfinished = unfinished
        self.is_behind = is_behind
        self.total = len(wanted)
        self.done: list[Called] = []
        self.done_seconds, self.all_seconds = 0.0, sum(one.seconds for one in wanted)
        self.told = told
        self.started = time.monotonic()
        self.lock = threading.Lock()
        self.is_ended = False
        self.processes: list[subprocess.Popen[str]] = []
        self.process_count = min(processes, self.total)
        self.failed_count = 0
        self.leading_count = self.process_count
        self.threads: list[threading.Thread] = []

    def begin(self) -> None:
        """Start the processes."""
        self.told(self._progress())
        for _ in range(self.process_count):
            thread = threading.Thread(target=self._lead, daemon=True)
            thread.start()
            self.threads.append(thread)

    def end(self) -> None:
        """End all processes, and wait until they are gone."""
        with self.lock:
            self.is_ended = True
            processes = list(self.processes)
        for process in processes:
            process.kill()
        for thread in self.threads:
            thread.join()

    def _lead(self) -> None:
        self._lead_one()
        with self.lock:
            self.leading_count -= 1
            if self.leading_count == 0 and not self.is_ended:
                # what a process had in hand that died, or that none could be started for, nobody compiles any more
                failed_count = self.total - len(self.done)
                if failed_count != self.failed_count:
                    self.failed_count = failed_count
                    self.told(self._progress())

    def _lead_one(self) -> None:
        """Start a process, and hand it one kernel after the other."""
        with self.lock:
            if self.is_ended:
                return
            try:
                process = _start(self.unfinished, is_behind=self.is_behind)
            except OSError:
                return
            self.processes.append(process)
        with process:
            while (one := self._next()) is not None:
                answer = _ask(process, one)
                if answer not in ("done", "failed"):
                    break
                with self.lock:
                    self.done += [one] if answer == "done" else []
                    self.failed_count += answer == "failed"
                    self.done_seconds += one.seconds
                    # Nobody is told of progress once the caller went on.
                    if not self.is_ended:
                        self.told(self._progress())
            process.kill()

    def _next(self) -> Called | None:
        with self.lock:
            return self.waiting.popleft() if self.waiting and not self.is_ended else None

    def _progress(self) -> Progress:
        left = self.all_seconds - self.done_seconds
        # At first, how long it takes is known from the machine of the list only.
        pace = 1.0 / self.process_count
        is_measured = self.done_seconds > _FIRST_SECONDS
        if is_measured:
            pace = (time.monotonic() - self.started) / self.done_seconds
        return Progress(len(self.done), self.failed_count, self.total, left * pace, is_measured)


def _start(unfinished: str, *, is_behind: bool = False) -> subprocess.Popen[str]:
    """A process that compiles what it is told to; it finds this package also where this process found it.

    Files that it has not written to their end yet lie in the folder ``unfinished``.
    """
    return subprocess.Popen(
        [sys.executable, "-P", "-c", _SERVE, str(_ROOT), unfinished, str(_BEHIND if is_behind else 0)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )


def _ask(process: subprocess.Popen[str], one: Called) -> str:
    """What a process answers that was asked to compile a kernel: nothing, where it is gone."""
    request = json.dumps({"module": one.module, "name": one.name, "types": one.types})
    try:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(request + "\n")
        process.stdin.flush()
        return process.stdout.readline().strip()
    except OSError:
        return ""


def serve(unfinished: str, niceness: int = 0) -> None:
    """Compile the kernels that are named on standard input, one a line, until it is closed; answer each with a line.

    Parameters
    ----------
    unfinished
        Folder for what is being written to the cache; beside what it will be where this is empty.
    niceness
        How far this process stands behind others, where the system knows that.
    """
    if niceness and hasattr(os, "nice"):
        os.nice(niceness)
    from heartcase.compiling.kernel import write_unfinished_to
    from heartcase.compiling.signatures import from_json

    write_unfinished_to(unfinished)

    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        request = json.loads(line)
        try:
            kernel = getattr(importlib.import_module(request["module"]), request["name"])
            kernel.compile(tuple(from_json(one) for one in request["types"]))
            answer = "done"
        except Exception:  # of whatever kind: who calls the kernel is told of it
            answer = "failed"
        answers.write(f"{answer}\n")
        answers.flush()
    # Who started this was killed, and the last of its processes tidies up.
    with contextlib.suppress(OSError):
        os.rmdir(unfinished)


def _note() -> Path | None:
    """The file in numba's cache that says what is in it."""
    from heartcase.compiling.kernel import cache_folder

    try:
        # a function that is decorated by another package has its cache there
        return Path(cache_folder(core_count)) / _NOTE_NAME
    except RuntimeError:  # there is no place for a cache
        return None


def _lines_of(wanted: Sequence[Called]) -> list[str]:
    """What the note says of each kernel: a digest of code, types, versions and processor."""
    import llvmlite.binding
    import numba

    from heartcase.compiling.sources import source_stamp

    about = repr(
        (
            sys.version,
            numba.__version__,
            llvmlite.__version__,
            llvmlite.binding.get_host_cpu_name(),
            sorted(llvmlite.binding.get_host_cpu_features().items()),
        )
    )
    stamps = {}
    for module in {one.module for one in wanted}:
        with contextlib.suppress(ImportError, OSError):
            spec = importlib.util.find_spec(module)
            stamps[module] = source_stamp(spec.origin) if spec is not None and spec.origin is not None else b""
    return [
        hashlib.sha256(repr((about, stamps.get(one.module), one.module, one.name, one.types)).encode()).hexdigest()[:16]
        for one in wanted
    ]


def _read(note: Path) -> list[str]:
    try:
        return note.read_text("ascii").split()
    except (OSError, ValueError):
        return []


def _add(note: Path, lines: Sequence[str]) -> None:
    """Note what is in the cache now; what another process notes at the same time may be lost, which costs time only."""
    if lines:
        with contextlib.suppress(OSError):
            noted = [one for one in _read(note) if one not in lines] + list(lines)
            atomic_write(note, "\n".join(noted[-_NOTED_MOST:]).encode())
