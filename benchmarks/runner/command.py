"""``python -m benchmarks``: run time against error, ours beside its peers in one run."""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import json
import multiprocessing
import platform
import signal
import statistics
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import click
from rich.console import Console

from benchmarks.runner.cases import BenchmarkCase, BenchmarkRecord, MethodSkipped, load_cases
from heartcase import __version__
from heartcase.compiling.compile_ahead import core_count
from heartcase.schemas.errors import Problem, UsageError
from heartcase.schemas.files import atomic_write

__all__ = ["command", "run_method"]


_FIRST_RUN: set[tuple[str, str]] = set()
"""Groups and methods that this process has warmed up."""


@dataclass
class _Outcome:
    """What was measured so far."""

    records: list[BenchmarkRecord] = field(default_factory=list)
    skipped: list[tuple[str, str, str]] = field(default_factory=list)
    """Case, method and reason of what was left out."""


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.argument("names", nargs=-1)
@click.option("--list", "only_list", is_flag=True, help="List the cases and their methods.")
@click.option(
    "--json", "json_file", type=click.Path(path_type=Path, readable=False), help="Write the records to this file."
)
@click.option(
    "--plots",
    "plot_directory",
    type=click.Path(path_type=Path, file_okay=False, readable=False),
    help="Write pictures of time against error to this folder.",
)
@click.option(
    "--report",
    "report_directory",
    type=click.Path(path_type=Path, file_okay=False, readable=False),
    help="Write a page with the machine, a table and the pictures to this folder.",
)
@click.option(
    "--dir",
    "directory",
    type=click.Path(path_type=Path, readable=False),
    default=Path(__file__).parents[1],
    show_default="that of the repository",
    help="Folder with a cases.toml and the modules that it names.",
)
def command(
    names: tuple[str, ...],
    only_list: bool,
    json_file: Path | None,
    plot_directory: Path | None,
    report_directory: Path | None,
    directory: Path,
) -> None:
    """Run the benchmark cases whose names start with NAMES (all when left out).

    Each method runs in a process of its own: once to warm up, then repeatedly; the median is reported with the error.
    The cases of a sweep share one process per method. A method that cannot run here is left out with its reason.
    Stop it at any moment: what was measured until then is written.
    """
    cases = [case for case in load_cases(directory) if not names or case.name.startswith(names)]
    if not cases:
        raise UsageError(f"no case starts with {' or '.join(names)}; see --list", place="NAMES")
    if only_list:
        for line in _listing(cases):
            click.echo(line)
        return
    if plot_directory is not None or report_directory is not None:
        # Without its library the command must fail before the long run, not after it.
        importlib.import_module("benchmarks.runner.report")
    _check_outputs(json_file, plot_directory, report_directory)
    outcome = _Outcome()
    try:
        _run(cases, directory, outcome)
    except BaseException:
        # Hours may have been measured until a case fails or somebody stops it.
        is_asked_for = any(path is not None for path in (json_file, plot_directory, report_directory))
        if outcome.records and is_asked_for:
            _write(outcome, json_file, plot_directory, report_directory)
            total = sum(len(case.methods) for case in cases)
            click.echo(f"stopped early: {len(outcome.records)} of {total} measurements were written", err=True)
        raise
    _write(outcome, json_file, plot_directory, report_directory)


def _check_outputs(json_file: Path | None, plot_directory: Path | None, report_directory: Path | None) -> None:
    """Refuse outputs that cannot be written, before the long run; nothing is left behind.

    Raises
    ------
    UsageError
        With every one of them.
    """
    problems = []
    if json_file is not None and json_file.is_dir():
        problems.append(Problem("--json", "is a folder: give a file name, for instance bench.json"))
    elif json_file is not None:
        problems += _folder_problems("--json", json_file.absolute().parent)
    for option, folder in (("--plots", plot_directory), ("--report", report_directory)):
        if folder is not None:
            problems += _folder_problems(option, folder.absolute())
    if problems:
        raise UsageError(problems)


def _folder_problems(option: str, folder: Path) -> list[Problem]:
    """Why no file can be made in a folder, or the folder itself cannot be."""
    try:
        there = next(path for path in (folder, *folder.parents) if path.exists())
        with tempfile.TemporaryFile(dir=there):
            return []
    except OSError as error:
        reason = (error.strerror or "the system gives no reason").lower()
        return [Problem(option, f"cannot be written to ({reason}): choose another place")]


def _write(
    outcome: _Outcome, json_file: Path | None, plot_directory: Path | None, report_directory: Path | None
) -> None:
    """Write what was measured wherever it is wanted."""
    records = outcome.records
    if json_file is not None:
        data = [record.model_dump(mode="json") for record in records]
        json_file.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(json_file, (json.dumps(data, indent=1) + "\n").encode())
    if plot_directory is not None:
        from benchmarks.runner.plots import write_plots

        for path in write_plots(records, plot_directory):
            click.echo(path.name)
    if report_directory is not None:
        from benchmarks.runner.report import write_report

        click.echo(write_report(records, outcome.skipped, report_directory).name)


def _listing(cases: list[BenchmarkCase]) -> list[str]:
    """One line for each case, and one for each sweep."""
    counts = Counter(case.group for case in cases if case.group is not None)
    lines: dict[str, str] = {}
    for case in cases:
        swept = f"  ({counts[case.group]} cases: {', '.join(case.sweep)})" if case.group is not None else ""
        name = case.group or case.name
        lines.setdefault(name, f"{name:<32} {', '.join(case.methods)}{swept}")
    return list(lines.values())


def _run(cases: list[BenchmarkCase], directory: Path, outcome: _Outcome) -> None:
    """Measure, and add each record, or what was left out, to the outcome; prints each as it comes."""
    console = Console(stderr=True)
    done, total, started = 0, sum(len(case.methods) for case in cases), time.monotonic()
    for _, grouped in itertools.groupby(cases, key=lambda case: case.group or case.name):
        swept = list(grouped)
        with contextlib.ExitStack() as stack:
            # A case after the other with its methods beside each other, so that all meet the same load of the machine.
            pools = {method: stack.enter_context(_process()) for method in swept[0].methods}
            stack.enter_context(_runs_end_with_us())
            for case in swept:
                for method, pool in pools.items():
                    left = _time_left(done, total, time.monotonic() - started)
                    with console.status(f"{done + 1} of {total}{left}: {case.name}, {method}"):
                        try:
                            record = pool.submit(run_method, directory, case, method).result()
                        except MethodSkipped as error:
                            reason = error.problems[0].message
                            outcome.skipped.append((case.name, method, reason))
                            click.echo(f"{case.name:<30} {method:<12} left out: {reason}")
                        else:
                            outcome.records.append(record)
                            click.echo(_line(record, outcome.records))
                    done += 1


def _time_left(done: int, total: int, seconds: float) -> str:
    """About how much longer, when enough is done to say."""
    if done < 3:
        return ""
    minutes = seconds / done * (total - done) / 60.0
    return f", about {minutes:.0f} min left" if minutes >= 1.0 else ", less than a minute left"


def _line(record: BenchmarkRecord, records: list[BenchmarkRecord]) -> str:
    ours = next((r for r in records if r.case == record.case and r.method == "heartcase"), record)
    ratio = "" if record is ours else f"  ({record.seconds / ours.seconds:.3g} x ours)"
    memory = f"{record.peak_memory_mb:,.0f} MB" if record.peak_memory_mb is not None else "memory unknown"
    lines = [f"{record.case:<30} {record.method:<12} {record.seconds:10.4f} s  {memory:>10}{ratio}"]
    lines += [f"{'':<34}{name}: {value:.5g}" for name, value in record.errors.items()]
    return "\n".join(lines)


def _process() -> ProcessPoolExecutor:
    """A process for the runs of one method; Ctrl-C, which a terminal sends to all, is for the command to answer."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, context, initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN))


@contextlib.contextmanager
def _runs_end_with_us() -> Iterator[None]:
    """End the processes on Ctrl-C, instead of waiting for what they are running."""
    try:
        yield
    except KeyboardInterrupt:
        for process in multiprocessing.active_children():
            process.terminate()
        raise


def _load_module(directory: Path, name: str) -> ModuleType:
    """A module of the folder, as part of this package: its neighbours import it by the same name."""
    full_name, path = f"benchmarks.{name}", directory.resolve() / f"{name}.py"
    loaded = sys.modules.get(full_name)
    if loaded is not None and loaded.__file__ == str(path):
        return loaded
    if not path.is_file():
        raise UsageError(f"there is no module {name}.py in the benchmark directory", place="cases.toml")
    spec = importlib.util.spec_from_file_location(full_name, path)
    if spec is None or spec.loader is None:
        raise UsageError(f"the module {name}.py cannot be loaded", place="cases.toml")
    module = importlib.util.module_from_spec(spec)
    sys.modules[full_name] = module
    spec.loader.exec_module(module)
    return module


def run_method(directory: Path, case: BenchmarkCase, method: str) -> BenchmarkRecord:
    """Run one method on one case in this process.

    The module has ``prepare(params) -> inputs``, ``METHODS: name -> function(inputs) -> output`` and
    ``errors(inputs, output) -> dict``; ``REPEATS: name -> runs`` where a method needs another number than the case. The
    first case of a sweep warms up the others.

    Raises
    ------
    UsageError
        The module or the method is not there.
    MethodSkipped
        The method cannot run here; its reason says what to do.
    """
    module = _load_module(directory, case.module)
    if method not in module.METHODS:
        raise UsageError(f"{case.name}: the module has no method {method!r}", place="cases.toml")
    inputs = module.prepare(dict(case.params))
    run = module.METHODS[method]
    output = None
    if case.group is None or (case.group, method) not in _FIRST_RUN:
        output = run(inputs)
        _FIRST_RUN.add((case.group or case.name, method))
    seconds = []
    repeats = int(getattr(module, "REPEATS", {}).get(method, case.repeats))
    for _ in range(repeats):
        start = time.perf_counter()
        output = run(inputs)
        seconds.append(time.perf_counter() - start)
    memory = _peak_memory_mb()
    return BenchmarkRecord(
        case=case.name,
        group=case.group,
        swept=tuple(case.sweep),
        method=method,
        seconds=statistics.median(seconds),
        errors={name: float(value) for name, value in module.errors(inputs, output).items()},
        params=case.params,
        repeats=repeats,
        peak_memory_mb=memory,
        machine=_machine(),
        version=__version__,
    )


def _peak_memory_mb() -> float | None:
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def _machine() -> str:
    processor = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text().splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
        processor = names[0] if names else processor
    return f"{processor}, {core_count()} cores, {platform.system()}, Python {platform.python_version()}"
