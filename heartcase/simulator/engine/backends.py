"""Engines, which advance a state: one interface, one engine per backend, equal within the rounding of float32."""

from __future__ import annotations

from typing import Literal, Protocol, get_args

import numpy as np

from heartcase.schemas.arrays import Float32, Float64, Intp
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.integrate import Verlet, next_velocity, verlet_step
from heartcase.simulator.engine.shared.contact import NO_PROBES, keep_outside
from heartcase.simulator.forces.reference import elastic_forces
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import PreciseState, State
from heartcase.simulator.lattice.tethers import Tethers

__all__ = ["Backend", "Engine", "ReferenceEngine", "make_engine"]

Backend = Literal["cpu", "cuda", "reference"]


class Engine(Protocol):
    """Holds a state and advances it. All arrays in grid units and axes, one row per node."""

    step_count: int
    """Steps taken."""

    @property
    def probe_impulse(self) -> Float64:
        """What each probe gave the nodes in the last row of steps: momentum and its moment about the probe's centre.

        In grid units, shape (probe_count, 6).
        """

    @property
    def threads_pay(self) -> bool:
        """Whether the host has threads idle that would make its work quicker."""

    def load(self, state: State) -> None:
        """Start from this state."""

    def read(self) -> State:
        """A copy of the state."""

    def prescribe(self, nodes: Intp, displacement: Float32, velocity: Float32) -> None:
        """Set where nodes are and how they move on, whatever pulls at them, shape (len(nodes), 3) each."""

    def set_inverse_mass(self, inverse_mass: Float32) -> None:
        """Inverse masses [1 / full cell], shape (node_count,); nodes at zero keep their velocity."""

    def advance(self, step_count: int, verlet: Verlet, probes: Float32 = NO_PROBES) -> None:
        """Take steps; probes (:func:`heartcase.simulator.engine.shared.contact.probe_row`) move on in each of the row.

        A GPU takes all steps as they are, whatever the pace.
        """

    def set_springs(self, model: LatticeModel) -> None:
        """Go on with the springs, also the explicit ones, of another model of the same nodes and law."""

    def set_tethers(self, tethers: Tethers) -> None:
        """Go on with other tethers; in the next row they change in each step, and stay as they came in."""

    def forces(self, nodes: Intp | None = None) -> Float32:
        """Spring forces now, shape (node_count, 3), or on some nodes, shape (len(nodes), 3)."""


def make_engine(model: LatticeModel, backend: Backend, before: Engine | None = None) -> Engine:
    """The engine of a backend, with the state at rest.

    Parameters
    ----------
    model
        The lattice.
    backend
        The backend.
    before
        An engine of a lattice before it, whose layout may be gone on with: it is the same without, and takes longer.

    Raises
    ------
    SimulationError
        There is no such backend, or it cannot run here.
    """
    if backend == "cpu":
        from heartcase.simulator.engine.cpu.engine import CpuEngine

        return CpuEngine(model, before if isinstance(before, CpuEngine) else None)
    if backend == "cuda":
        from heartcase.simulator.engine.cuda.engine import CudaEngine

        return CudaEngine(model)
    if backend == "reference":
        return ReferenceEngine(model)
    raise SimulationError(f"there is no backend {backend!r}: choose from {', '.join(get_args(Backend))}")


class ReferenceEngine:
    """Plain NumPy in float64: slow, obvious, the truth that the others are held against."""

    threads_pay = False

    def __init__(self, model: LatticeModel) -> None:
        self.model = model
        self.tethers = Tethers.none()
        self.inverse_mass = model.inverse_mass.astype(np.float64)
        self.probe_impulse: Float64 = np.zeros((0, 6))
        self.load(State.at_rest(model.node_count))

    def load(self, state: State) -> None:
        """Start from this state."""
        self.displacement, self.velocity = state.displacement.astype(np.float64), state.velocity.astype(np.float64)
        if isinstance(state, PreciseState):
            self.displacement, self.velocity = state.precise_displacement.copy(), state.precise_velocity.copy()
        self.step_count = state.step_count

    def read(self) -> State:
        """A copy of the state, rounded to float32, and as it is."""
        return PreciseState.of(self.displacement, self.velocity, self.step_count)

    def prescribe(self, nodes: Intp, displacement: Float32, velocity: Float32) -> None:
        """Set where nodes are and how they move on."""
        self.displacement[nodes] = displacement
        self.velocity[nodes] = velocity

    def set_inverse_mass(self, inverse_mass: Float32) -> None:
        """Inverse masses; nodes at zero keep their velocity."""
        self.inverse_mass = inverse_mass.astype(np.float64)

    def advance(self, step_count: int, verlet: Verlet, probes: Float32 = NO_PROBES) -> None:
        """Take steps."""
        self.probe_impulse = np.zeros((len(probes), 6))
        row = verlet.row(step_count)
        for step_number in range(row.step_count):
            more = self.tethers.after(step_number).forces(self.displacement)
            start = (self.displacement, self.velocity, self.inverse_mass)
            numbers = row.numbers_of(step_number)
            later, velocity = verlet_step(self.model, verlet, *start, more=more, numbers=numbers)
            how = (self.model, probes, step_number, numbers[0], self.inverse_mass)
            later, velocity, impulse = keep_outside(*how, self.displacement, later, velocity)
            self.probe_impulse += impulse
            self.displacement, self.velocity = later, velocity
        if row.last is not None:
            pull = self.tethers.after(row.step_count).forces(self.displacement)
            force = elastic_forces(self.model, self.displacement) + pull
            self.velocity = next_velocity(row.last, self.velocity, force, self.inverse_mass)
        self.step_count += step_count

    def set_springs(self, model: LatticeModel) -> None:
        """Go on with the springs, also the explicit ones, of another model of the same nodes."""
        self.model = model

    def set_tethers(self, tethers: Tethers) -> None:
        """Go on with other tethers."""
        self.tethers = tethers

    def forces(self, nodes: Intp | None = None) -> Float32:
        """Spring forces now, on some nodes or all."""
        pull = self.tethers.forces(self.displacement)
        force = (elastic_forces(self.model, self.displacement) + pull).astype(np.float32)
        return force if nodes is None else force[nodes]
