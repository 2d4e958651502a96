"""A kernel is compiled anew when anything that was compiled into it changes, in whatever module that is."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import heartcase
from heartcase.compiling.sources import imported_modules, source_stamp

PACKAGE = Path(heartcase.__file__).parent

FACTOR = "FACTOR = {}\n"
HELPER = """
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from heartcase.compiling.kernel import kernel
from heartcase.simulator.probe_factor import FACTOR

@kernel(cached=False)
def scaled(x):
    return FACTOR * x

@intrinsic
def emitted(typing_context, x):
    def codegen(context, builder, signature, arguments):
        return builder.fmul(arguments[0], ir.Constant(ir.DoubleType(), float(FACTOR)))
    return types.float64(types.float64), codegen
"""
KERNEL = """
from numba import njit
from heartcase.compiling.kernel import kernel
from heartcase.simulator.probe_helper import emitted, scaled

@kernel
def kept(x):
    return scaled(x) + 10.0 * emitted(x)

@njit(cache=True)
def plain(x):
    return scaled(x) + 10.0 * emitted(x)
"""
RUN = """
from heartcase.simulator import probe_kernel as p
print(p.kept(1.0), sum(p.kept.stats.cache_hits.values()), p.plain(1.0))
"""


@pytest.fixture
def package(tmp_path):
    shutil.copytree(PACKAGE, tmp_path / "heartcase", ignore=shutil.ignore_patterns("__pycache__"))
    simulator = tmp_path / "heartcase" / "simulator"
    (simulator / "probe_factor.py").write_text(FACTOR.format(2))
    (simulator / "probe_helper.py").write_text(HELPER)
    (simulator / "probe_kernel.py").write_text(KERNEL)
    return tmp_path


def run(package: Path, code: str = RUN) -> list[float]:
    environment = os.environ | {"PYTHONPATH": str(package), "NUMBA_CACHE_DIR": str(package / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=package, env=environment, capture_output=True, text=True, check=True
    )
    return [float(text) for text in done.stdout.split()]


def test_a_constant_two_modules_away_is_looked_at(package):
    assert run(package) == [22.0, 0, 22.0]
    assert run(package) == [22.0, 1, 22.0]
    (package / "heartcase" / "simulator" / "probe_factor.py").write_text(FACTOR.format(3))
    # numba's own cache, the last number, still gives what it was compiled with
    assert run(package) == [33.0, 0, 22.0]
    (package / "heartcase" / "cli" / "main.py").write_text("# nothing that this kernel imports\n")
    assert run(package) == [33.0, 1, 22.0]


def test_every_way_to_import_is_seen():
    source = """
import numpy, heartcase.schemas.errors as e
from heartcase.pipeline import (
    data,  # a module
    region,
)
from . import lanes
from .model import LatticeModel as Model
def late():
    from heartcase.schemas import lattice
"""
    found = imported_modules(source, "heartcase.simulator.spectrum")
    assert set(found) == {
        "heartcase.pipeline",
        "heartcase.pipeline.data",
        "heartcase.pipeline.region",
        "heartcase.schemas",
        "heartcase.schemas.errors",
        "heartcase.schemas.lattice",
        "heartcase.simulator",
        "heartcase.simulator.lanes",
        "heartcase.simulator.model",
        "heartcase.simulator.model.LatticeModel",
        "heartcase.simulator.model.Model",
        "heartcase.simulator.model.as",
        "heartcase.pipeline.a",
        "heartcase.pipeline.module",
    }


def test_modules_that_import_different_things_have_different_stamps():
    stamps = {source_stamp(str(file)) for file in (PACKAGE / "simulator").rglob("[a-z]*.py")}
    assert len(stamps) == len(list((PACKAGE / "simulator").rglob("[a-z]*.py")))


def test_what_a_module_that_is_gone_left_in_the_cache_is_compiled_anew(package):
    """A kernel's arguments may be of a class that the next heartcase has under another name."""
    simulator = package / "heartcase" / "simulator"
    (simulator / "probe_point.py").write_text("from typing import NamedTuple\nclass Point(NamedTuple):\n    x: float\n")
    lines = "from heartcase.simulator.probe_point import Point\n", "@kernel\ndef of_point(p):\n    return p.x\n"
    (simulator / "probe_kernel.py").write_text("".join((lines[0], KERNEL, lines[1])))
    code = RUN + "\nprint(p.of_point(p.Point(4.0)), sum(p.of_point.stats.cache_hits.values()))"
    assert run(package, code)[3:] == [4.0, 0]
    assert run(package, code)[3:] == [4.0, 1]
    (simulator / "probe_point.py").rename(simulator / "probe_place.py")
    (simulator / "probe_kernel.py").write_text("".join((lines[0].replace("_point", "_place"), KERNEL, lines[1])))
    assert run(package, code)[3:] == [4.0, 0]
    for kept in (package / "cache").rglob("probe_kernel.of_point-*.nb[ic]"):
        kept.write_bytes(kept.read_bytes()[: kept.stat().st_size // 2])
    assert run(package, code)[3:] == [4.0, 0]
    assert run(package, code)[3:] == [4.0, 1]


def test_what_a_folder_imports_from_beside_itself_is_looked_at(package):
    folder = package / "heartcase" / "simulator" / "probe_folder"
    folder.mkdir()
    (folder / "__init__.py").write_text("from .inner import f\n")
    (folder / "inner.py").write_text("f = 1\n")
    (package / "heartcase" / "loop").symlink_to(package, target_is_directory=True)
    (package / "user.py").write_text("from heartcase.simulator.probe_folder import f\n")
    say = "from heartcase.compiling.sources import source_stamp; print(int.from_bytes(source_stamp('user.py')[:6]))"
    before = run(package, say)
    assert run(package, say) == before
    (folder / "inner.py").write_text("f = 2\n")
    assert run(package, say) != before
