"""``heartcase bench``: run time against error, ours beside its peers in one run."""

from __future__ import annotations

import importlib.util
import json
import multiprocessing
import os
import platform
import statistics
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import ModuleType

import click
from rich.console import Console

from heartcase import __version__
from heartcase.schemas.benchmark import BenchmarkCase, BenchmarkRecord, load_cases
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write

__all__ = ["command", "run_method"]


@click.command()
@click.argument("names", nargs=-1)
@click.option("--list", "only_list", is_flag=True, help="List the cases and their methods.")
@click.option(
    "--json", "json_file", type=click.Path(path_type=Path, readable=False), help="Write the records to this file."
)
@click.option(
    "--dir",
    "directory",
    type=click.Path(path_type=Path, readable=False),
    default=Path("benchmarks"),
    help="benchmarks/",
)
def command(names: tuple[str, ...], only_list: bool, json_file: Path | None, directory: Path) -> None:
    """Run the benchmark cases whose names start with NAMES (all when left out).

    Each method runs in a process of its own: once to warm up, then repeatedly; the median is reported with the error.
    """
    cases = [case for case in load_cases(directory) if not names or case.name.startswith(names)]
    if not cases:
        raise UsageError(f"no case starts with {' or '.join(names)}; see 'heartcase bench --list'", place="NAMES")
    if only_list:
        for case in cases:
            click.echo(f"{case.name:<32} {', '.join(case.methods)}")
        return
    console = Console(stderr=True)
    records: list[BenchmarkRecord] = []
    for case in cases:
        for method in case.methods:
            with console.status(f"{case.name}: {method}"):
                record = _in_own_process(directory, case, method)
            records.append(record)
            click.echo(_line(record, records))
    if json_file is not None:
        data = [record.model_dump(mode="json") for record in records]
        json_file.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(json_file, (json.dumps(data, indent=1) + "\n").encode())


def _line(record: BenchmarkRecord, records: list[BenchmarkRecord]) -> str:
    ours = next((r for r in records if r.case == record.case and r.method == "heartcase"), record)
    ratio = "" if record is ours else f"  ({record.seconds / ours.seconds:.3g} x ours)"
    memory = f"{record.peak_memory_mb:,.0f} MB" if record.peak_memory_mb is not None else "memory unknown"
    lines = [f"{record.case:<30} {record.method:<12} {record.seconds:10.4f} s  {memory:>10}{ratio}"]
    lines += [f"{'':<34}{name}: {value:.5g}" for name, value in record.errors.items()]
    return "\n".join(lines)


def _in_own_process(directory: Path, case: BenchmarkCase, method: str) -> BenchmarkRecord:
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=spawn) as pool:
        return pool.submit(run_method, directory, case, method).result()


def _load_module(directory: Path, name: str) -> ModuleType:
    path = directory / f"{name}.py"
    if not path.is_file():
        raise UsageError(f"there is no module {name}.py in the benchmark directory", place="cases.toml")
    sys.path.insert(0, str(directory.resolve()))
    spec = importlib.util.spec_from_file_location(f"heartcase_benchmark_{name}", path)
    if spec is None or spec.loader is None:
        raise UsageError(f"the module {name}.py cannot be loaded", place="cases.toml")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def run_method(directory: Path, case: BenchmarkCase, method: str) -> BenchmarkRecord:
    """Run one method on one case in this process.

    The module has ``prepare(params) -> inputs``, ``METHODS: name -> function(inputs) -> output`` and
    ``errors(inputs, output) -> dict``.
    """
    module = _load_module(directory, case.module)
    if method not in module.METHODS:
        raise UsageError(f"{case.name}: the module has no method {method!r}", place="cases.toml")
    inputs = module.prepare(dict(case.params))
    run = module.METHODS[method]
    output = run(inputs)
    seconds = []
    for _ in range(case.repeats):
        start = time.perf_counter()
        output = run(inputs)
        seconds.append(time.perf_counter() - start)
    memory = _peak_memory_mb()
    return BenchmarkRecord(
        case=case.name,
        method=method,
        seconds=statistics.median(seconds),
        errors={name: float(value) for name, value in module.errors(inputs, output).items()},
        params=case.params,
        repeats=case.repeats,
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
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{processor}, {cores} cores, {platform.system()}, Python {platform.python_version()}"
