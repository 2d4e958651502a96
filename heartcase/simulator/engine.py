"""What advances a state: one interface, one engine per backend. All agree within the rounding of float32."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol, get_args

import numpy as np
import numpy.typing as npt

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.forces_reference import spring_forces
from heartcase.simulator.integrate import Verlet, verlet_step
from heartcase.simulator.model import LatticeModel
from heartcase.simulator.pace import Pace
from heartcase.simulator.state import State

__all__ = ["Backend", "CpuEngine", "Engine", "ReferenceEngine", "make_engine"]

Backend = Literal["cpu", "reference"]
Float32 = npt.NDArray[np.float32]

PARALLEL_BLOCKS_MIN = 1024
"""Blocks from which on more than one thread pays."""


class Engine(Protocol):
    """Holds a state and advances it. All arrays in grid units and axes, one row per node."""

    def load(self, state: State) -> None:
        """Start from this state."""

    def read(self) -> State:
        """A copy of the state."""

    def prescribe(self, nodes: npt.NDArray[np.intp], displacement: Float32, velocity: Float32) -> None:
        """Set where nodes are and how they move on, whatever pulls at them, shape (len(nodes), 3) each."""

    def set_inverse_mass(self, inverse_mass: Float32) -> None:
        """Inverse masses [1 / full cell], shape (node_count,); nodes at zero keep their velocity."""

    def advance(self, step_count: int, verlet: Verlet) -> None:
        """Take steps."""

    def forces(self) -> Float32:
        """Spring forces on every node now, shape (node_count, 3)."""


def make_engine(model: LatticeModel, backend: Backend) -> Engine:
    """The engine of a backend, with the state at rest.

    Raises
    ------
    SimulationError
        There is no such backend.
    """
    if backend == "cpu":
        return CpuEngine(model)
    if backend == "reference":
        return ReferenceEngine(model)
    raise SimulationError(f"there is no backend {backend!r}: choose from {', '.join(get_args(Backend))}")


class ReferenceEngine:
    """Plain NumPy in float64: slow, obvious, the truth that the others are held against."""

    def __init__(self, model: LatticeModel) -> None:
        self.model = model
        self.inverse_mass = inverse_mass(model).astype(np.float64)
        self.load(State.at_rest(model.node_count))

    def load(self, state: State) -> None:
        """Start from this state."""
        self.displacement = state.displacement.astype(np.float64)
        self.velocity = state.velocity.astype(np.float64)
        self.step_count = state.step_count

    def read(self) -> State:
        """A copy of the state, rounded to float32."""
        return State(self.displacement.astype(np.float32), self.velocity.astype(np.float32), self.step_count)

    def prescribe(self, nodes: npt.NDArray[np.intp], displacement: Float32, velocity: Float32) -> None:
        """Set where nodes are and how they move on."""
        self.displacement[nodes] = displacement
        self.velocity[nodes] = velocity

    def set_inverse_mass(self, inverse_mass: Float32) -> None:
        """Inverse masses; nodes at zero keep their velocity."""
        self.inverse_mass = inverse_mass.astype(np.float64)

    def advance(self, step_count: int, verlet: Verlet) -> None:
        """Take steps."""
        for _ in range(step_count):
            self.displacement, self.velocity = verlet_step(
                self.model, verlet, self.displacement, self.velocity, self.inverse_mass
            )
        self.step_count += step_count

    def forces(self) -> Float32:
        """Spring forces on every node now."""
        return spring_forces(self.model, self.displacement).astype(np.float32)


class CpuEngine:
    """The numba kernel: float32, all cores, vectors of 8 lanes."""

    def __init__(self, model: LatticeModel) -> None:
        from heartcase.simulator.lanes import lane_layout

        self.layout = lane_layout(model)
        lane_count = self.layout.lane_count
        self.weight = _aligned(self.layout.spring_weight.shape)
        self.weight[:] = self.layout.spring_weight
        self.displacement = _aligned((2, 3, lane_count))
        self.velocity = _aligned((3, lane_count))
        self.force = _aligned((3, lane_count))
        self.inverse_mass = _aligned((1, lane_count))
        self.set_inverse_mass(inverse_mass(model))
        self.pace = Pace()
        self.current = 0
        self.step_count = 0

    def load(self, state: State) -> None:
        """Start from this state."""
        self.prescribe(np.arange(len(self.layout.node_lane)), state.displacement, state.velocity)
        self.step_count = state.step_count

    def read(self) -> State:
        """A copy of the state."""
        lanes = self.layout.node_lane
        displacement = np.ascontiguousarray(self.displacement[self.current][:, lanes].T)
        return State(displacement, np.ascontiguousarray(self.velocity[:, lanes].T), self.step_count)

    def prescribe(self, nodes: npt.NDArray[np.intp], displacement: Float32, velocity: Float32) -> None:
        """Set where nodes are and how they move on."""
        lanes = self.layout.node_lane[nodes]
        self.displacement[self.current][:, lanes] = displacement.T
        self.velocity[:, lanes] = velocity.T

    def set_inverse_mass(self, inverse_mass: Float32) -> None:
        """Inverse masses; nodes at zero keep their velocity."""
        self.inverse_mass[0, self.layout.node_lane] = inverse_mass

    def advance(self, step_count: int, verlet: Verlet) -> None:
        """Take steps."""
        from heartcase.simulator.kernel_cpu import advance, advance_alone

        numbers = (verlet.step, verlet.keep, verlet.kick, *verlet.gravity)
        constants = tuple(np.float32(number) for number in numbers)

        def in_one_way(kernel: Callable[..., int]) -> Callable[[int], None]:
            def take(count: int) -> None:
                self.current = kernel(
                    self.displacement,
                    self.velocity,
                    self.weight,
                    self.inverse_mass,
                    self.layout.block_rows,
                    self.current,
                    count,
                    constants,
                )

            return take

        if self.layout.block_count < PARALLEL_BLOCKS_MIN:
            in_one_way(advance_alone)(step_count)
        else:
            self.pace.run(step_count, (in_one_way(advance_alone), in_one_way(advance)))
        self.step_count += step_count

    def forces(self) -> Float32:
        """Spring forces on every node now."""
        from heartcase.simulator.kernel_cpu import lane_forces

        lane_forces(self.displacement[self.current], self.weight, self.force, self.layout.block_rows)
        return np.ascontiguousarray(self.force[:, self.layout.node_lane].T)


def inverse_mass(model: LatticeModel) -> Float32:
    """Inverse masses [1 / full cell], zero where a node is fixed, shape (node_count,)."""
    return np.where(model.node_is_fixed, np.float32(0), 1 / model.node_mass).astype(np.float32)


def _aligned(shape: tuple[int, ...]) -> Float32:
    """Zeros that start on a cache line: a vector load across two lines costs double."""
    line = 16
    room = np.zeros(int(np.prod(shape)) + line, np.float32)
    shift = -(room.ctypes.data // room.itemsize) % line
    return room[shift : shift + int(np.prod(shape))].reshape(shape)
