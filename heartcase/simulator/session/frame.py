"""What a session shows of a moment."""

from __future__ import annotations

from dataclasses import dataclass, field

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import Problem
from heartcase.schemas.recording.commands import Done, Navigation
from heartcase.simulator.instruments.forceps import Forceps
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.retractor import Retractor
from heartcase.simulator.instruments.scissors import Scissors
from heartcase.simulator.instruments.wrench import Instrument
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State
from heartcase.simulator.patching.patches import PatchState
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.deform import DeformedSurface
from heartcase.simulator.suturing.stitches import StitchState

__all__ = ["Frame", "InstrumentFrame", "Refusal", "TopologyChange", "instrument_frames"]


@dataclass(frozen=True)
class InstrumentFrame:
    """An instrument in a frame."""

    name: str
    """Its name."""
    kind: str
    """``grab``, ``forceps``, ``retractor``, ``probe`` or ``scissors``."""
    center_mm: Float64
    """Where its centre is, LPS mm, shape (3,)."""
    turn: Float64
    """Its rotation since it closed, LPS axes, shape (3, 3); of a probe the directions of its semi-axes in columns, of
    scissors those along the jaws, from jaw to jaw and along the hinge."""
    force_n: Float64
    """Force of the tissue on it, N, LPS axes, shape (3,)."""
    torque_n_mm: Float64
    """Torque of the tissue about its centre, N mm, LPS axes, shape (3,)."""
    pinch_n: float | None = None
    """Of forceps: force with which the tissue presses each jaw away from the other, N."""
    pull_n_mm: Float64 | None = None
    """Of a retractor: pull of the tissue along its line, N/mm, one value for each cell or so, shape (any,)."""


@dataclass(frozen=True)
class TopologyChange:
    """The lattice is another one than in the frame before."""

    kind: str
    """The command that changed it, or ``history`` where the session went back or on."""
    node_count: int
    """Nodes by now."""
    spring_count: int
    """Springs of the lattice by now."""
    explicit_count: int
    """Explicit springs by now."""

    @classmethod
    def to(cls, model: LatticeModel, kind: str) -> TopologyChange:
        """The change of a ``kind`` that led to ``model``."""
        return cls(kind, model.node_count, model.spring_count, model.explicit.count)


@dataclass(frozen=True)
class Refusal:
    """A command that was not done; nothing has changed by it."""

    command: Done | Navigation
    """The command."""
    problems: tuple[Problem, ...]
    """Why."""


@dataclass(frozen=True)
class Frame:
    """A moment of a session: tissue, instruments and what they feel, and what came about since the last frame."""

    step: int
    """Steps taken since the start."""
    time_s: float
    """Simulated time, s."""
    model: LatticeModel
    """The lattice by now; another object than in the frame before where it has changed."""
    state: State
    """Displacements and velocities, grid units; not to be changed."""
    surface: DeformedSurface | None
    """The visible surface, where it was asked for."""
    instruments: dict[str, InstrumentFrame]
    """Name -> instrument in the tissue."""
    topology: tuple[TopologyChange, ...] = ()
    """How the lattice changed since the last frame."""
    refused: tuple[Refusal, ...] = ()
    """Commands since the last frame that were not done, and why."""
    stitches: dict[str, StitchState] = field(default_factory=dict)
    """Name -> stitch in the tissue: the force in it, where it is, how long."""
    patches: dict[str, PatchState] = field(default_factory=dict)
    """Name -> patch on the tissue: a surface of kind ``patch``, and the force in each stitch of its rim."""
    breakdown: str | None = None
    """Why the steps of this frame were not taken, where the watchdog stopped them; the state is that before them."""
    coming_cuts: int = 0
    """Cuts that were begun and are not made yet."""

    @property
    def displacement_mm(self) -> Float64:
        """Displacement of every node, LPS mm, shape (node_count, 3)."""
        return self.model.to_mm(self.state.displacement)


def instrument_frames(simulation: Simulation) -> dict[str, InstrumentFrame]:
    """All instruments in the tissue now."""
    return {one.name: _instrument_frame(simulation, one) for one in simulation.instruments}


def _instrument_frame(simulation: Simulation, instrument: Instrument) -> InstrumentFrame:
    model = simulation.model
    to_world = model.geometry.direction_matrix
    wrench = simulation.wrench_on(instrument)
    if isinstance(instrument, Grab):
        kind, centre = "grab", instrument.centre_at(instrument.pose, model)
        turn = to_world @ instrument.pose.turn @ to_world.T
    elif isinstance(instrument, Scissors):
        kind, centre, turn = "scissors", instrument.hinge, to_world @ instrument.axes.T
    else:
        kind, centre, turn = "probe", instrument.centre, to_world @ instrument.turn
    pinch_n, pull_n_mm = None, None
    if isinstance(instrument, Forceps):
        kind, pinch_n = "forceps", simulation.pinch_force_n(instrument)
    elif isinstance(instrument, Retractor):
        kind, pull_n_mm = "retractor", simulation.retraction_n_mm(instrument)
    centre_mm = model.geometry.index_to_world(centre - 0.5)
    return InstrumentFrame(
        instrument.name, kind, centre_mm, turn, wrench.force_n, wrench.torque_n_mm, pinch_n, pull_n_mm
    )
