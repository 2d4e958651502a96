"""The command ``heartcase build`` as a user meets it: the first time with nothing compiled, and with all compiled.

Each run is a process of its own. In a first one, numba's cache is an empty folder, Python has read no source of ours
before (those of other packages it has, as after an installation), and the scan is there already. The peer compiles
every kernel when it is called, in the one process.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import heartcase as heartcase_package
from benchmarks.build import write_inputs
from heartcase.schemas.bundle.check import check_bundle


@dataclass(frozen=True)
class Inputs:
    """A directory with scan and recipe, our source, of which a first build has a copy, and numba's cache."""

    directory: Path
    source: Path
    cache: Path
    first: bool


@dataclass(frozen=True)
class Output:
    """How the command went."""

    returncode: int
    seconds: float
    seconds_to_case: float
    """From the start of the process to the moment at which ``case.json`` is replaced."""
    load: float
    """Of the machine over the last minute, when the command ended; that of other programs is in it."""


_KEPT = Path(tempfile.gettempdir()) / "heartcase-benchmark-numba"
"""numba's cache of warm builds."""


def prepare(params: dict[str, Any]) -> Inputs:
    first = params.pop("first")
    directory = Path(tempfile.mkdtemp(prefix="heartcase-benchmark-first-"))
    write_inputs(params, directory)
    package = Path(heartcase_package.__file__).parent
    if first:
        copy = directory / "source" / package.name
        package = shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__"))
    inputs = Inputs(directory, package.parent, directory / "numba" if first else _KEPT, first)
    if not first:
        _build(inputs, _AHEAD)
    return inputs


_AHEAD = ""
_NOT_AHEAD = "import heartcase.pipeline.building.kernels_ahead as ahead; ahead.core_count = lambda: 0;"
_COMMAND = "import sys; from heartcase.cli.main import main; sys.exit(main(sys.argv[1:]))"


def heartcase(inputs: Inputs) -> Output:
    return _build(inputs, _AHEAD)


def without_compiling_ahead(inputs: Inputs) -> Output:
    return _build(inputs, _NOT_AHEAD)


METHODS = {"heartcase": heartcase, "without_compiling_ahead": without_compiling_ahead}


def _build(inputs: Inputs, before: str) -> Output:
    if inputs.first:
        shutil.rmtree(inputs.cache, ignore_errors=True)
        for made in list(inputs.source.rglob("__pycache__")):
            shutil.rmtree(made)
    manifest = inputs.directory / "bench.case" / "case.json"
    manifest.unlink(missing_ok=True)
    arguments = ["build", str(inputs.directory / "recipe.toml"), "--out", str(inputs.directory), "--force"]
    start, seconds_to_case = time.perf_counter(), float("nan")
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", before + _COMMAND, *arguments],
        env=_environment(inputs),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    while process.poll() is None:
        if seconds_to_case != seconds_to_case and manifest.exists():
            seconds_to_case = time.perf_counter() - start
        time.sleep(0.02)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return Output(process.returncode, time.perf_counter() - start, seconds_to_case, load)


def _environment(inputs: Inputs) -> dict[str, str]:
    """Variables of this process, with a cache of numba's, and our source before all else."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    places = os.pathsep.join([str(inputs.source), *filter(None, [kept.get("PYTHONPATH")])])
    return kept | {"NUMBA_CACHE_DIR": str(inputs.cache), "PYTHONPATH": places}


def errors(inputs: Inputs, output: Output) -> dict[str, float]:
    """Problems of the case, how long the command took until the case could be used, and the machine's load."""
    problems = len(check_bundle(inputs.directory / "bench.case")) + (output.returncode != 0)
    shutil.rmtree(inputs.directory)
    return {
        "problems of the case [1]": float(problems),
        "scan to case [s]": output.seconds_to_case,
        "scan to case and report [s]": output.seconds,
        "load of the machine, cores [1]": output.load,
    }
