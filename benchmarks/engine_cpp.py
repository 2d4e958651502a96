"""``engine_kernel.cpp``, compiled for this machine and loaded. Not ours: a peer on our layout, written by hand."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.runner.cases import MethodSkipped
from heartcase.schemas.arrays import Float32
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.engine.shared.lanes import lane_layout
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State

__all__ = ["CppLattice"]


SOURCE = Path(__file__).with_name("engine_kernel.cpp")
COMPILERS = ("c++", "g++", "clang++")
OPTIONS = ("-std=c++17", "-O3", "-march=native", "-ffp-contract=fast", "-fopenmp", "-shared", "-fPIC")

TWO_CELLS = np.float32(0.5)
"""Lengths of the kernel per cell: exact both ways."""


class CppLattice:
    """Arrays of a lattice in lanes, and the compiled kernel.

    Raises
    ------
    MethodSkipped
        There is no compiler, or it does not compile this.
    """

    def __init__(self, model: LatticeModel, mass_inverse: Float32, rule: Verlet) -> None:
        self._advance = _compiled().advance
        self._layout = lane_layout(model)
        lane_count = self._layout.lane_count
        self._displacement = _aligned((2, 3, lane_count))
        self._velocity = _aligned((3, lane_count))
        self._weight = _aligned((9, lane_count))
        self._weight[:] = self._layout.spring_weight(model).reshape(self._weight.shape)
        self._mass_inverse = _aligned((lane_count,))
        self._mass_inverse[self._layout.node_lane] = mass_inverse
        self._rows = np.ascontiguousarray(self._layout.window_rows, np.int32)
        gravity = TWO_CELLS * np.array(rule.gravity)
        self._current = 0
        self._constants = np.array([rule.step, rule.keep, rule.kick, *gravity], np.float32)

    def load(self, start: State) -> None:
        """Start from this state."""
        lanes = self._layout.node_lane
        self._displacement[self._current][:, lanes] = TWO_CELLS * start.displacement.T
        self._velocity[:, lanes] = TWO_CELLS * start.velocity.T

    def advance(self, step_count: int) -> None:
        """Take steps."""
        arrays = (self._displacement, self._velocity, self._weight, self._mass_inverse, self._rows)
        self._current = self._advance(
            *(_pointer(array) for array in arrays),
            ctypes.c_int64(len(self._rows)),
            ctypes.c_int64(self._layout.lane_count),
            ctypes.c_int(self._current),
            ctypes.c_int(step_count),
            _pointer(self._constants),
        )

    def read(self) -> Float32:
        """The displacements."""
        return np.ascontiguousarray(self._displacement[self._current][:, self._layout.node_lane].T) / TWO_CELLS


def _compiled() -> ctypes.CDLL:
    """The kernel's library, from a temporary folder that is gone once it is loaded."""
    compiler = next((path for name in COMPILERS if (path := shutil.which(name))), None)
    if compiler is None:
        raise MethodSkipped(f"it needs a C++ compiler: {', '.join(COMPILERS[:-1])} or {COMPILERS[-1]}")
    with tempfile.TemporaryDirectory(prefix="heartcase-benchmark-cpp-", ignore_cleanup_errors=True) as directory:
        library = Path(directory) / "engine_kernel.so"
        done = subprocess.run(
            [compiler, *OPTIONS, str(SOURCE), "-o", str(library)], capture_output=True, text=True, check=False
        )
        if done.returncode:
            said = next((line for line in done.stderr.splitlines() if "error" in line), "it gives no reason")
            raise MethodSkipped(f"{Path(compiler).name} does not compile engine_kernel.cpp: {said}")
        return ctypes.CDLL(str(library))


def _aligned(shape: tuple[int, ...]) -> Float32:
    """Zeros that start on a cache line."""
    line = 16
    room = np.zeros(int(np.prod(shape)) + line, np.float32)
    shift = -(room.ctypes.data // room.itemsize) % line
    return room[shift : shift + int(np.prod(shape))].reshape(shape)


def _pointer(array: npt.NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
