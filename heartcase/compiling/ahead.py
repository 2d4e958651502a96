"""Kernels compiled ahead, in other processes, while this one already works: numba's cache is what they share.

A list says which kernels, for which types. Each process is given the next of them. This process waits for one that it
needs and that is being compiled (:mod:`heartcase.compiling.one_at_a_time`), and compiles one itself that it needs and
that is yet to be begun. So nothing is compiled twice.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.util
import json
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Called", "Progress", "compiled_ahead", "core_count", "serve"]

_ROOT = Path(__file__).parents[2]
_SERVE = "from heartcase.compiling.ahead import serve; serve()"
_FIRST_SECONDS = 5.0
"""Of the list, after which the pace of this machine is known."""
_NOTE_PREFIX = "heartcase-compiled-"


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
    total: int
    """Kernels of the list."""
    seconds_left: float
    """Estimate, from how fast it went so far."""


def core_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def compiled_ahead(
    wanted: Sequence[Called], *, processes: int, told: Callable[[Progress], None] = lambda _: None
) -> Iterator[None]:
    """Compile kernels in other processes while the body runs; they are ended with it, however it ends.

    Where all of them were compiled before, by this code for this processor, no process is started. A process that
    cannot be started, or fails, is done without: what it would have compiled is compiled when it is called.

    Parameters
    ----------
    wanted
        In the order in which they will be needed.
    processes
        How many processes; 0 for none.
    told
        Called as kernels are done, from other threads than the caller's.
    """
    note = _note_of(wanted)
    if processes < 1 or not wanted or note is None or note.exists() or getattr(sys, "frozen", False):
        yield
        return
    crew = _Crew(wanted, processes, told)
    try:
        yield
    finally:
        crew.end()
        if crew.all_done:
            with contextlib.suppress(OSError):
                note.touch()


class _Crew:
    """The processes, and a thread for each that hands it one kernel after the other."""

    def __init__(self, wanted: Sequence[Called], processes: int, told: Callable[[Progress], None]) -> None:
        self.waiting = deque(wanted)
        self.total = len(wanted)
        self.done = 0
        self.done_seconds, self.all_seconds = 0.0, sum(one.seconds for one in wanted)
        self.told = told
        self.started = time.monotonic()
        self.lock = threading.Lock()
        self.is_ended = False
        self.processes: list[subprocess.Popen[str]] = []
        self.process_count = min(processes, self.total)
        self.threads = [threading.Thread(target=self._lead, daemon=True) for _ in range(self.process_count)]
        told(self._progress())
        for thread in self.threads:
            thread.start()

    @property
    def all_done(self) -> bool:
        return self.done == self.total

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
        with self.lock:
            if self.is_ended:
                return
            try:
                process = _start()
            except OSError:
                return
            self.processes.append(process)
        with process:
            while (one := self._next()) is not None:
                answer = _ask(process, one)
                if answer not in ("done", "failed"):
                    break
                with self.lock:
                    self.done += answer == "done"
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
        if self.done_seconds > _FIRST_SECONDS:
            pace = (time.monotonic() - self.started) / self.done_seconds
        return Progress(self.done, self.total, left * pace)


def _start() -> subprocess.Popen[str]:
    """A process that compiles what it is told to; it finds this package as this process did, and takes no other's."""
    path = os.pathsep.join(filter(None, (str(_ROOT), os.environ.get("PYTHONPATH", ""))))
    return subprocess.Popen(
        [sys.executable, "-P", "-c", _SERVE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
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


def serve() -> None:
    """Compile the kernels that are named on standard input, one a line, until it is closed; answer each with a line."""
    from heartcase.compiling.signatures import from_json

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


def _note_of(wanted: Sequence[Called]) -> Path | None:
    """The file that says that all of these are in the cache; named by code, types, versions and processor."""
    import llvmlite.binding
    import numba

    from heartcase.compiling.sources import source_stamp

    digest = hashlib.sha256()
    about = (sys.version, numba.__version__, llvmlite.__version__, llvmlite.binding.get_host_cpu_name())
    digest.update(repr((about, sorted(llvmlite.binding.get_host_cpu_features().items()))).encode())
    digest.update(repr(wanted).encode())
    try:
        for name in sorted({one.module for one in wanted}):
            spec = importlib.util.find_spec(name)
            if spec is None or spec.origin is None:
                return None
            digest.update(source_stamp(spec.origin))
        first = getattr(importlib.import_module(wanted[0].module), wanted[0].name) if wanted else None
        return Path(first._cache.cache_path) / f"{_NOTE_PREFIX}{digest.hexdigest()[:16]}" if first else None
    except (ImportError, AttributeError, OSError):
        return None
