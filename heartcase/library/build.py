"""Building a library: what is stale goes to the workers of a Dask cluster, and comes back case by case.

A case is one task, so that a killed worker costs what it was building and nothing else: the scheduler gives the task to
another, which goes on from the stages that the cache holds. Each worker writes the record of a case when it is done;
where the scheduler is lost, the next build starts from those.
"""

from __future__ import annotations

import contextlib
import signal
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heartcase import __version__
from heartcase.compiling.compile_ahead import core_count
from heartcase.library.interrupts import held_interrupts, inherited_deafness
from heartcase.library.plan import CaseRecord, LibraryCase, is_up_to_date, read_record, write_record
from heartcase.library.progress import StageNews, TellingListener, heard
from heartcase.schemas.errors import Problem, UsageError

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "MEMORY_PER_CASE_MB",
    "Workers",
    "build_cases",
    "connected",
    "default_workers",
    "has_dashboard",
    "make_folders",
    "stale_cases",
]

MEMORY_PER_CASE_MB = 3000
"""What a worker is given at least where nothing is said, 10^6 bytes: a sample case takes 1,000 to 1,900, and in the
first build after an installation, when kernels are compiled, up to 3,300 (``heartcase library build sample_cases``)."""
_ATTEMPTS = 3
"""Workers that may be killed by a case before it counts as failed."""
_LOST_AFTER_S = 20
"""Time without the scheduler after which it counts as lost, s."""
_ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1") | {
    "MALLOC_TRIM_THRESHOLD_": str(1 << 29),
    "MALLOC_MMAP_THRESHOLD_": str(1 << 28),
}
"""Environment in which a worker starts. Dask's own allocation (65536 bytes, which also has each array mapped anew)
makes a case cost a seventh more time: 49.8 against 43.0 s for vsd-muscular-apical with its scan at hand."""
_LOOK_EVERY_S = 2.0
"""How often it is asked whether workers have joined, s."""
_POLL_S = 0.05
"""How often it is looked whether a case is done, s."""


@dataclass(frozen=True)
class Workers:
    """Worker processes on this machine."""

    count: int
    """How many."""
    thread_count: int
    """Threads of each; no byte of a case depends on it."""
    memory_mb: int
    """Memory beyond which a worker is stopped, 10^6 bytes."""


def default_workers(worker_count: int | None = None, memory_mb: int | None = None) -> Workers:
    """As many workers as there are cores and as memory allows.

    Parameters
    ----------
    worker_count
        How many; worked out when left out.
    memory_mb
        Memory of each, 10^6 bytes; an equal part of what there is when left out.

    Raises
    ------
    UsageError
        A number is not above zero.
    """
    if worker_count is not None and worker_count < 1:
        raise UsageError("give at least one worker", place="--workers")
    if memory_mb is not None and memory_mb < 500:
        raise UsageError("a worker needs 500 MB at the very least", place="--memory-mb")
    cores = core_count()
    there_mb = _memory_mb()
    fitting = max(1, there_mb // (memory_mb or MEMORY_PER_CASE_MB))
    count = worker_count or max(1, min(cores, fitting))
    return Workers(count, max(1, cores // count), memory_mb or max(500, there_mb // count))


@contextlib.contextmanager
def connected(
    workers: Workers | None, scheduler: str | None, *, say: Callable[[str], None] | None = None
) -> Iterator[Client]:
    """A client of a cluster on this machine, or of the scheduler at an address; a cluster made here ends with it.

    Ctrl-C while its workers start or end is heard when they have: Dask has no orderly way to stop half a start.

    Parameters
    ----------
    workers
        Workers on this machine; None where there is a scheduler.
    scheduler
        Its address.
    say
        Told that Ctrl-C was heard and what takes some seconds yet.

    Raises
    ------
    UsageError
        No scheduler answers at the address, or its workers have another heartcase.
    """
    import dask
    from distributed import Client, LocalCluster
    from distributed.utils import LoopRunner

    settings = {
        "distributed.scheduler.allowed-failures": _ATTEMPTS - 1,
        "distributed.comm.timeouts.connect": f"{_LOST_AFTER_S}s",
        "distributed.logging": {"distributed": "critical", "tornado": "critical", "bokeh": "critical"},
        "distributed.admin.log-format": "%(message)s",
    }
    with dask.config.set(settings):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout=_LOST_AFTER_S, set_as_default=False)
            except (OSError, TimeoutError, ValueError):
                message = (
                    "no Dask scheduler answers there: start one with  dask scheduler  and give the address it prints"
                )
                raise UsageError(message, place="--scheduler") from None
            with client:
                _check_versions(client)
                yield client
            return
        assert workers is not None
        threads = str(workers.thread_count)
        names = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS")
        environment = {
            "distributed.nanny.environ": dict.fromkeys(names, threads),
            "distributed.nanny.pre-spawn-environ": _ENVIRONMENT,
        }
        with contextlib.ExitStack() as stack:
            try:
                with held_interrupts(say):
                    stack.enter_context(_any_dashboard_port())
                    stack.enter_context(dask.config.set(environment))
                    runner = LoopRunner()
                    with inherited_deafness():
                        runner.start()
                    stack.callback(runner.stop)
                    cluster = LocalCluster(
                        n_workers=workers.count,
                        threads_per_worker=1,
                        memory_limit=workers.memory_mb * 1_000_000,
                        dashboard_address=":8787" if has_dashboard() else None,
                        silence_logs=50,
                        loop=runner.loop,
                    )
                    stack.enter_context(cluster)
                    client = stack.enter_context(Client(cluster, set_as_default=False))
                    client.register_plugin(_interrupts_are_ours())
                yield client
            finally:
                with held_interrupts():
                    stack.close()


def _interrupts_are_ours() -> Any:
    """Plugin of worker processes that leave Ctrl-C, which goes to all of a terminal's processes, to the main one.

    They end with it; by themselves they would each print where they were.
    """
    from distributed import WorkerPlugin

    class LeavesInterrupts(WorkerPlugin):  # type: ignore[misc]
        name = "heartcase-interrupts"

        def setup(self, worker: Any) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    return LeavesInterrupts()


@contextlib.contextmanager
def _any_dashboard_port() -> Iterator[None]:
    """Where another build has the port of Dask's pages one that is free is taken; the dashboard's is printed anyhow."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Port .* is already in use", category=UserWarning)
        yield


def stale_cases(cases: tuple[LibraryCase, ...], out: Path, *, force: bool = False) -> tuple[LibraryCase, ...]:
    """The cases that are to be built: those that can be, and are not as they would be built now.

    Parameters
    ----------
    cases
        The library's cases.
    out
        Folder of the built cases.
    force
        Whether cases that are up to date are built as well.
    """
    return tuple(case for case in cases if not case.problems and (force or not is_up_to_date(case, out)))


def make_folders(out: Path, cache: Path | None) -> None:
    """Make the folders of the cases and of the cache, before any worker starts.

    Raises
    ------
    UsageError
        One cannot be made.
    """
    problems = []
    for folder, place in ((out, "--out"), (cache, "--cache")):
        try:
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = (error.strerror or "the system gives no reason").lower()
            problems.append(Problem(place, f"the folder cannot be made: {reason}"))
    if problems:
        raise UsageError(problems)


def build_cases(
    cases: tuple[LibraryCase, ...],
    client: Client,
    *,
    out: Path,
    cache: Path | None = None,
    hear: Callable[[StageNews], None] | None = None,
) -> Iterator[CaseRecord]:
    """Build cases on a cluster; their records come as they are done, and ``hear`` is told of their stages.

    Those that a lost scheduler or killed workers kept from being built have a record that says so.

    Parameters
    ----------
    cases
        What to build: see :func:`stale_cases`.
    client
        Client of the cluster: see :func:`connected`.
    out
        Folder for the cases, reports and records; made when it is not there.
    cache
        Folder of the cache; in ``out`` when left out.
    """
    from distributed import as_completed
    from distributed.client import FutureCancelledError

    out.mkdir(parents=True, exist_ok=True)
    shared = str(cache.resolve()) if cache else None
    waiting = deque(cases)
    running: dict[Any, LibraryCase] = {}
    done = as_completed([], loop=client.loop, raise_errors=False)
    looked_s = -_LOOK_EVERY_S
    with contextlib.suppress(FutureCancelledError), heard(client) as news:

        def tell() -> None:
            ours = {(case.name, case.stamp) for case in running.values()}
            for one in news():
                if hear is not None and (one.case, one.stamp) in ours:
                    hear(one)

        while waiting or running:
            tell()
            if waiting and time.monotonic() - looked_s >= _LOOK_EVERY_S:
                looked_s = time.monotonic()
                # A case more than there are free threads would stand behind another while a worker becomes idle: the
                # scheduler cannot know how long a case takes, and moves none that is assigned.
                for _ in range(min(_thread_count(client) - len(running), len(waiting))):
                    case = waiting.popleft()
                    here = LibraryCase(case.name, case.recipe.resolve(), case.stamp)
                    key = f"{case.name}-{case.stamp}"
                    future = client.submit(_build_one, here, str(out.resolve()), shared, key=key, pure=False)
                    running[future] = case
                    done.add(future)
            if done.has_ready():
                future = next(done)
                tell()  # what its worker said last
                yield _record_of(future, running.pop(future), out)
                looked_s = -_LOOK_EVERY_S
            elif not running and client.status not in ("running", "connecting"):
                break
            else:
                time.sleep(_POLL_S)
    for case in sorted((*running.values(), *waiting), key=lambda one: one.name):
        yield _lost(case, "the scheduler was lost: build the library again, it goes on from here", out)


def _thread_count(client: Client) -> int:
    """How many cases the workers that are there can build at a time, at least one; 0 where no scheduler answers."""
    if client.status != "running":
        return 0
    try:
        threads: dict[str, int] = client.nthreads()
    except (OSError, TimeoutError):
        return 0
    return max(1, sum(threads.values()))


def _check_versions(client: Client) -> None:
    """UsageError where a worker that is there has no heartcase, or not this one."""
    try:
        versions = set(client.run(_version).values())
    except Exception:
        versions = {"none"}
    if versions - {__version__}:
        found = ", ".join(sorted(versions))
        raise UsageError(
            f"its workers have heartcase {found}, this is {__version__}: install the same", place="--scheduler"
        )


def _version() -> str:
    return __version__


def _build_one(case: LibraryCase, out: str, cache: str | None) -> CaseRecord:
    # What a worker needs is imported there: the client runs without the pipeline's libraries.
    from heartcase.library.worker import build_one

    return build_one(case, out, cache, TellingListener(case.name, case.stamp))


def _record_of(future: Any, case: LibraryCase, out: Path) -> CaseRecord:
    from distributed import KilledWorker

    if future.status == "finished":
        try:
            record: CaseRecord = future.result(timeout=_LOST_AFTER_S)
        except (OSError, TimeoutError):
            record = _lost(case, "its worker was lost: build the library again", out)
        return record
    error = future.exception() if future.status == "error" else None
    if isinstance(error, KilledWorker):
        words = f"{_ATTEMPTS} workers were killed while they built this: it may need more memory (--memory-mb)"
        return _lost(case, words, out)
    if isinstance(error, OSError):
        return _lost(case, "its worker cannot write to OUT: that must be the same folder for all workers", out)
    if error is not None:
        words = f"its worker could not begin ({type(error).__name__}): is the same heartcase installed on all of them?"
        return _lost(case, words, out)
    return _lost(case, "it was not built: the scheduler or its worker was lost; build the library again", out)


def _lost(case: LibraryCase, message: str, out: Path) -> CaseRecord:
    written = read_record(case.name, out)
    if written is not None and is_up_to_date(case, out):
        return written
    record = CaseRecord(case.name, case.stamp, (("", message),))
    write_record(record, out)
    return record


def _memory_mb() -> int:
    """Memory of this machine or of the container, 10^6 bytes."""
    from distributed.system import MEMORY_LIMIT

    return int(MEMORY_LIMIT / 1e6)


def has_dashboard() -> bool:
    """Whether what Dask draws its dashboard with is installed."""
    import importlib.util

    return importlib.util.find_spec("bokeh") is not None
