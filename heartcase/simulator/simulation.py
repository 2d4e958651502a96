"""A running simulation: steps, hands, surface, watchdog."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.contact import probe_row
from heartcase.simulator.engine import Backend, make_engine
from heartcase.simulator.instruments import Grab, nodes_in_reach
from heartcase.simulator.integrate import Energy, Verlet, energy
from heartcase.simulator.measures import inverted_cells
from heartcase.simulator.model import LatticeModel
from heartcase.simulator.state import State
from heartcase.simulator.step_size import checked_step, own_step_limit
from heartcase.simulator.surface import DeformedSurface, PickingModel, SurfaceModel, deform, deform_picking
from heartcase.simulator.watchdog import find_trouble

__all__ = ["Simulation"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]


class Simulation:
    """Tissue in motion.

    Lengths are mm in LPS axes, times s, forces N. A frame is: lead the hands with :meth:`lead`, take steps with
    :meth:`step`, show :meth:`surface_now`.

    Parameters
    ----------
    model
        The lattice.
    surface, picking
        Surfaces that follow it, where they are wanted.
    step_s
        Time step, s; the case's default when left out.
    damping_per_s
        Mass-proportional damping c in a = f/m - c v, 1/s.
    gravity_m_s2
        Acceleration of gravity, LPS axes, m/s2.
    backend
        ``cpu`` (numba, float32), ``cuda`` (an NVIDIA GPU, float32) or ``reference`` (NumPy, float64).

    Raises
    ------
    SimulationError
        The step is beyond the lattice's own limit, or there is no such backend.
    """

    def __init__(
        self,
        model: LatticeModel,
        *,
        surface: SurfaceModel | None = None,
        picking: PickingModel | None = None,
        step_s: float | None = None,
        damping_per_s: float = 10.0,
        gravity_m_s2: Sequence[float] = (0.0, 0.0, 0.0),
        backend: Backend = "cpu",
    ) -> None:
        self.model = model
        self.surface = surface
        self.picking = picking
        self.step_s = checked_step(model, step_s)
        self.grabs: list[Grab] = []
        units = model.units
        gravity = np.asarray(gravity_m_s2) @ model.geometry.direction_matrix / units.acceleration_m_s2
        self.verlet = Verlet(
            step=self.step_s / units.time_s,
            damping=damping_per_s * units.time_s,
            gravity=(float(gravity[0]), float(gravity[1]), float(gravity[2])),
        )
        self._inverse_mass = model.inverse_mass
        self._engine = make_engine(model, backend)
        self._state: State | None = None

    @property
    def state(self) -> State:
        """The state now, in grid units; not to be changed."""
        if self._state is None:
            self._state = self._engine.read()
        return self._state

    @property
    def step_count(self) -> int:
        """Steps taken."""
        return self.state.step_count

    @property
    def time_s(self) -> float:
        """Simulated time, s."""
        return self.step_count * self.step_s

    @property
    def step_limit_s(self) -> float:
        """Largest step that is stable at rest with the springs that there are now, s."""
        return own_step_limit(self.model)

    def prepare(self) -> None:
        """Compile what will be needed, so that the first frame is as quick as the rest."""
        self._engine.advance(0, self.verlet)
        self._engine.advance(0, self.verlet, probe_row((0, 0, 0), (0, 0, 0), (1, 1, 1), np.eye(3))[None])
        self._engine.forces()
        if self.surface is not None:
            self.surface_now()
        if self.picking is not None:
            self.picking_now()

    def restore(self, state: State) -> None:
        """Go back, or on, to a state that was read before. Hands that hold now let go."""
        self.grabs.clear()
        self._engine.load(state)
        self._engine.set_inverse_mass(self._inverse_mass)
        self._state = None

    def step(self, step_count: int = 1) -> None:
        """Take steps; hands reach where they are led to at the end of the last, in a straight line.

        Raises
        ------
        SimulationError
            Something moved beyond all physics, or is not a number any more. The state before these steps is restored.
        """
        if step_count < 0:
            raise SimulationError(f"cannot take {step_count} steps: restore a state to go back", place="step")
        if step_count == 0:
            return
        before = self.state
        for grab in self.grabs:
            velocity = (grab.target - grab.offset) / (step_count * self.verlet.step)
            self._place(grab, grab.offset, velocity)
        self._engine.advance(step_count, self.verlet)
        for grab in self.grabs:
            velocity = (grab.target - grab.offset) / (step_count * self.verlet.step)
            self._place(grab, grab.target, velocity)
        self._state = None
        self._watch(before)
        for grab in self.grabs:
            grab.offset = grab.target

    def grab(self, center_mm: npt.ArrayLike, radius_mm: float, *, name: str = "grab") -> Grab:
        """Close a hand on the nodes within ``radius_mm`` of a point, LPS mm.

        Held are those that can be reached along springs inside the ball from the node nearest its centre, so that a
        hand never bridges an incision (thesis 8.7.2). Nodes that another hand holds stay with it.

        Raises
        ------
        SimulationError
            There is no tissue to hold, or the place is not a finite point.
        """
        if not (np.isfinite(np.asarray(center_mm, dtype=float)).all() and np.isfinite(radius_mm)):
            raise SimulationError("the centre and the radius must be finite numbers", place=name)
        nodes = nodes_in_reach(self.model, self.state.displacement, center_mm, radius_mm)
        for other in self.grabs:
            nodes = np.setdiff1d(nodes, other.nodes, assume_unique=True)
        if not len(nodes):
            raise SimulationError("another hand holds all the tissue in the grab: grab elsewhere", place=name)
        grab = Grab(nodes=nodes, closed_at=self.state.displacement[nodes], name=name)
        self.grabs.append(grab)
        self._hold()
        return grab

    def lead(self, grab: Grab, offset_mm: npt.ArrayLike) -> None:
        """Lead a hand to an offset from where it closed, LPS mm; it arrives with the end of the next :meth:`step`.

        Raises
        ------
        SimulationError
            The offset is not finite.
        """
        if not np.isfinite(np.asarray(offset_mm, dtype=float)).all():
            raise SimulationError("the offset must be finite numbers", place=grab.name)
        grab.target = self.model.to_grid(offset_mm)

    def release(self, grab: Grab) -> None:
        """Let go: the nodes move on with the hand's velocity. A hand that has let go already stays so."""
        if grab not in self.grabs:
            return
        self.grabs.remove(grab)
        self._hold()

    def force_on(self, grab: Grab) -> Float64:
        """Force that the tissue exerts on a hand now, N, LPS axes, shape (3,)."""
        pull = self._engine.forces(grab.nodes).sum(axis=0, dtype=np.float64)
        force: Float64 = pull @ self.model.geometry.direction_matrix.T * self.model.units.force_n
        return force

    def energy(self) -> Energy:
        """Kinetic and elastic energy now, J."""
        masses = self._inverse_mass.copy()
        for grab in self.grabs:
            masses[grab.nodes] = 0
        return energy(self.model, self.verlet, self.state, force=self._engine.forces(), inverse_mass=masses)

    def inverted_cell_count(self) -> int:
        """Cells that are turned inside out now: tissue that springs alone do not bring back."""
        return int(inverted_cells(self.model, self.state.displacement).sum())

    def displacement_mm(self) -> Float64:
        """Displacement of every node now, LPS mm, shape (node_count, 3)."""
        return self.model.to_mm(self.state.displacement)

    def positions_mm(self) -> Float64:
        """Position of every node now, LPS mm, shape (node_count, 3)."""
        return self.model.rest_positions_mm() + self.displacement_mm()

    def surface_now(self) -> DeformedSurface:
        """The visible surface now.

        Raises
        ------
        SimulationError
            The simulation was made without one.
        """
        if self.surface is None:
            raise SimulationError("this simulation has no surface: load the case with needs=('surface',)")
        return deform(self.model, self.surface, self.state.displacement)

    def picking_now(self) -> DeformedSurface:
        """The one-to-one surface now.

        Raises
        ------
        SimulationError
            The simulation was made without one.
        """
        if self.picking is None:
            raise SimulationError("this simulation has no picking surface: load the case with needs=('picking',)")
        return deform_picking(self.model, self.picking, self.state.displacement)

    def _place(self, grab: Grab, offset: Float64, velocity: Float64) -> None:
        velocities = np.broadcast_to(velocity.astype(np.float32), grab.closed_at.shape)
        self._engine.prescribe(grab.nodes, (grab.closed_at + offset).astype(np.float32), velocities)

    def _hold(self) -> None:
        masses = self._inverse_mass.copy()
        for grab in self.grabs:
            masses[grab.nodes] = 0
        self._engine.set_inverse_mass(masses)

    def _watch(self, before: State) -> None:
        led = np.zeros(self.model.node_count, dtype=bool)
        for grab in self.grabs:
            led[grab.nodes] = True
        trouble = find_trouble(self.state, self.verlet.step, led)
        if trouble is None:
            return
        ended_s = self.time_s
        self._engine.load(before)
        self._state = None
        for grab in self.grabs:
            grab.target = grab.offset
        holders = " and ".join(grab.name for grab in self.grabs)
        raise SimulationError(
            f"the simulation broke down between {self.time_s:.4f} s and {ended_s:.4f} s: {trouble}"
            f"{f' while {holders} held the tissue' if holders else ''}; pull more slowly or less far, or give a "
            "smaller step. The state before was restored",
            place="simulation",
        )
