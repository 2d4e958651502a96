"""Steps of the spring lattice of a whole heart: ours, the textbook loop in three ways, and a kernel by hand in C++."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numba
import numpy as np
import numpy.typing as npt

from benchmarks.lattices import heart_lattice
from benchmarks.runner.cases import MethodSkipped
from heartcase.schemas.arrays import Float, Float32, Float64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.integrate import Verlet, verlet_step
from heartcase.simulator.dynamics.step_size import default_step
from heartcase.simulator.engine.backends import Backend, Engine, make_engine
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import RATIO_MIN, ForceLaw
from heartcase.simulator.lattice.state import State

Neighbours = tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]


@dataclass(frozen=True)
class Inputs:
    """A lattice, a state away from rest, and a number of steps."""

    model: LatticeModel
    start: State
    verlet: Verlet
    step_count: int
    checked_steps: int
    """Steps after which the state is compared with the reference's."""
    memory: dict[str, Any]

    @cached_property
    def neighbours(self) -> Neighbours:
        """Lists of neighbours, for the methods that need them."""
        return _neighbour_list(self.model)


class Lattice(Protocol):
    """A way to take steps: what it needs is made and compiled before the clock starts, and the state stays in it."""

    def load(self, start: State) -> None:
        """Start from this state."""

    def advance(self, step_count: int) -> None:
        """Take steps."""

    def read(self) -> Float:
        """The displacements."""


def prepare(params: dict[str, Any]) -> Inputs:
    model = heart_lattice(params["node_count"], params.get("split", 1), params.get("scale", 1.0))
    law, ratio = params.get("law", "springs"), params.get("poissons_ratio", RATIO_MIN)
    model = model.with_law(ForceLaw(law, ratio, shares_strain=params.get("shares_strain", True)))
    # So little that no corner is flat and no node at the speed limit: the other methods know of neither.
    generator = np.random.Generator(np.random.PCG64(1))
    displacement = generator.normal(0.0, 0.005, (model.node_count, 3)).astype(np.float32)
    displacement[model.node_is_fixed] = 0.0
    start = State(displacement, np.zeros_like(displacement))
    verlet = Verlet(default_step(model) / model.units.time_s, damping=10.0 * model.units.time_s)
    return Inputs(model, start, verlet, params["step_count"], params.get("checked_steps", params["step_count"]), {})


def heartcase(inputs: Inputs) -> Lattice:
    return _advanced(inputs, lambda: _ours(inputs, "cpu"))


def heartcase_cuda(inputs: Inputs) -> Lattice:
    """Ours on a GPU."""
    return _advanced(inputs, lambda: _ours(inputs, "cuda"))


def textbook_cuda(inputs: Inputs) -> Lattice:
    """The textbook's loop on a GPU: float32, one launch per step."""
    _ours(inputs, "cuda")
    from benchmarks.engine_cuda_textbook import CudaTextbook

    return _advanced(inputs, lambda: CudaTextbook(*inputs.neighbours, inputs.model.inverse_mass, inputs.verlet))


def textbook(inputs: Inputs) -> Lattice:
    return _advanced(inputs, lambda: Textbook(inputs))


def taichi(inputs: Inputs) -> Lattice:
    """The textbook's loop in Taichi: float32, all cores."""
    try:
        from benchmarks.engine_taichi import TaichiLattice
    except ImportError:
        raise MethodSkipped("it needs taichi: pip install '.[bench]'") from None
    return _advanced(inputs, lambda: TaichiLattice(*inputs.neighbours, inputs.model.inverse_mass, inputs.verlet))


def warp(inputs: Inputs) -> Lattice:
    """The textbook's loop in NVIDIA Warp: float32, one core, for Warp uses no more of a CPU."""
    try:
        from benchmarks.engine_warp import WarpLattice
    except ImportError:
        raise MethodSkipped("it needs warp-lang: pip install '.[bench]'") from None
    return _advanced(inputs, lambda: WarpLattice(*inputs.neighbours, inputs.model.inverse_mass, inputs.verlet))


def cpp(inputs: Inputs) -> Lattice:
    """Our layout in C++ with vector intrinsics: what the machine can do."""
    from benchmarks.engine_cpp import CppLattice

    return _advanced(inputs, lambda: CppLattice(inputs.model, inputs.model.inverse_mass, inputs.verlet))


def _advanced(inputs: Inputs, make: Callable[[], Lattice]) -> Lattice:
    """A lattice some steps on: the first call makes it, the next go on from where it is, as a simulation does."""
    if "lattice" not in inputs.memory:
        inputs.memory["lattice"] = make()
        inputs.memory["lattice"].load(inputs.start)
    lattice: Lattice = inputs.memory["lattice"]
    lattice.advance(inputs.step_count)
    return lattice


def _ours(inputs: Inputs, backend: Backend) -> Ours:
    try:
        return Ours(make_engine(inputs.model, backend), inputs.verlet)
    except SimulationError as error:
        raise MethodSkipped(str(error)) from None


@dataclass
class Ours:
    """The engine with its rule."""

    engine: Engine
    rule: Verlet

    def load(self, start: State) -> None:
        """Start from this state."""
        self.engine.load(start)

    def advance(self, step_count: int) -> None:
        """Take steps."""
        self.engine.advance(step_count, self.rule)
        self.engine.forces(np.zeros(1, np.intp))  # waits for a device

    def read(self) -> Float32:
        """The displacements."""
        return self.engine.read().displacement


class Textbook:
    """One core, float64, the way it is written in a lecture."""

    def __init__(self, inputs: Inputs) -> None:
        self.neighbours, self.rule = inputs.neighbours, inputs.verlet
        self.mass_inverse = inputs.model.inverse_mass.astype(float)

    def load(self, start: State) -> None:
        """Start from this state."""
        self.displacement, self.velocity = start.displacement.astype(float), start.velocity.astype(float)

    def advance(self, step_count: int) -> None:
        """Take steps."""
        rule = self.rule
        for _ in range(step_count):
            _textbook_step(
                self.displacement,
                self.velocity,
                self.mass_inverse,
                *self.neighbours,
                rule.keep,
                rule.kick,
                rule.step,
            )

    def read(self) -> Float64:
        """The displacements."""
        return self.displacement


def _neighbour_list(model: LatticeModel) -> Neighbours:
    """Number of neighbours, and node, rest vector and weight of each; (node_count,) and (node_count, 18, ...)."""
    here = np.concatenate([model.spring_nodes[:, 0], model.spring_nodes[:, 1]])
    there = np.concatenate([model.spring_nodes[:, 1], model.spring_nodes[:, 0]])
    offset = np.concatenate([model.spring_offset, -model.spring_offset])
    order = np.argsort(here, kind="stable")
    count = np.bincount(here, minlength=model.node_count)
    slot = np.arange(len(here)) - np.repeat(np.cumsum(count) - count, count)
    here = here[order]
    other = np.zeros((model.node_count, 18), np.int64)
    rest = np.zeros((model.node_count, 18, 3))
    weight = np.zeros((model.node_count, 18))
    other[here, slot], rest[here, slot] = there[order], offset[order]
    weight[here, slot] = np.tile(model.spring_weight, 2)[order]
    return count, other, rest, weight


@numba.njit
def _textbook_step(u, v, mass_inverse, count, other, rest, weight, keep, kick, step):  # type: ignore[no-untyped-def]
    force = np.empty_like(u)
    for n in range(len(u)):
        fx = fy = fz = 0.0
        for s in range(count[n]):
            j = other[n, s]
            rx, ry, rz = rest[n, s, 0], rest[n, s, 1], rest[n, s, 2]
            dx, dy, dz = rx + u[j, 0] - u[n, 0], ry + u[j, 1] - u[n, 1], rz + u[j, 2] - u[n, 2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            pull = weight[n, s] * (length - np.sqrt(rx * rx + ry * ry + rz * rz)) / length
            fx += pull * dx
            fy += pull * dy
            fz += pull * dz
        force[n, 0], force[n, 1], force[n, 2] = fx, fy, fz
    for n in range(len(u)):
        for c in range(3):
            if mass_inverse[n] > 0.0:
                v[n, c] = keep * v[n, c] + kick * mass_inverse[n] * force[n, c]
            u[n, c] += step * v[n, c]


METHODS = {
    "heartcase": heartcase,
    "textbook": textbook,
    "taichi": taichi,
    "warp": warp,
    "cpp": cpp,
    "heartcase_cuda": heartcase_cuda,
    "textbook_cuda": textbook_cuda,
}


def errors(inputs: Inputs, lattice: Lattice) -> dict[str, float]:
    """Difference to the NumPy reference in float64 after as many steps from the start."""
    lattice.load(inputs.start)
    lattice.advance(inputs.checked_steps)
    displacement, velocity = inputs.start.displacement.astype(float), inputs.start.velocity.astype(float)
    mass_inverse = inputs.model.inverse_mass.astype(float)
    for _ in range(inputs.checked_steps):
        displacement, velocity = verlet_step(inputs.model, inputs.verlet, displacement, velocity, mass_inverse)
    return {
        f"largest difference to the reference after {inputs.checked_steps} steps [cells]": float(
            np.abs(lattice.read() - displacement).max()
        ),
        "nodes [1]": float(inputs.model.node_count),
        "steps per run [1]": float(inputs.step_count),
        "real steps per second needed [1/s]": 1.0 / default_step(inputs.model),
    }
