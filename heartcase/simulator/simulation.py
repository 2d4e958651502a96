"""A running simulation: steps, instruments, surface, watchdog."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arguments import whole_number
from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import STEPS_MAX
from heartcase.simulator.cutting.cuts import Step
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.dynamics.integrate import Energy, Verlet, energy
from heartcase.simulator.dynamics.measures import inverted_cells
from heartcase.simulator.dynamics.step_size import StepSizes, checked_step, pace_at
from heartcase.simulator.engine.backends import Backend
from heartcase.simulator.engine.shared.contact import NO_PROBES, probe_row
from heartcase.simulator.instruments.grab import Grab, close_grab, pose_of, require_grab
from heartcase.simulator.instruments.held_tissue import on_side_at
from heartcase.simulator.instruments.one_sided import OneSidedGrab
from heartcase.simulator.instruments.placing import is_number, is_point, point_in_lattice
from heartcase.simulator.instruments.probe import Probe, make_probe, require_probe
from heartcase.simulator.instruments.scissors import Scissors
from heartcase.simulator.instruments.wrench import Instrument, Wrench, wrench_on
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State
from heartcase.simulator.snapshot import Snapshot
from heartcase.simulator.surface.deform import PickingModel, SurfaceModel
from heartcase.simulator.tissue.checked import checked_gravity
from heartcase.simulator.tissue.excised_tissue import ExcisedTissue
from heartcase.simulator.tissue.operated_tissue import OperatedTissue
from heartcase.simulator.watchdog import Watch, find_runaway, find_trouble, watch

__all__ = ["SLEEP_MM", "Simulation"]


SLEEP_MM = 0.05
"""Movement that may be left out where nothing else is said, mm."""
SLEEP_HZ = 5.0
"""Slowest swing of tissue that sleeping shall not be seen in, Hz."""


class Simulation(ExcisedTissue, OperatedTissue):
    """Tissue in motion.

    Lengths are mm in LPS axes, times s, forces N. A frame is: lead the hands with :meth:`lead`, take steps with
    :meth:`step`, show :meth:`surface_now`.

    Parameters
    ----------
    model
        The lattice.
    surface, picking
        Surfaces that follow it, where they are wanted.
    tissue
        Where in its cells the tissue lies that blades cut (``Case.tissue``). When left out, inside ``surface``; where
        there is none, it fills its cells.
    step_s
        Time step, s; the case's default when left out.
    pace
        How many times as long as ``step_s`` the steps of elements may be, 1 or more: rows of steps are taken in fewer,
        longer ones as long as there is no probe; less long where pieces along cuts, or what stitches, patches and
        explicit springs tie together, are quicker than the rest. When left out, with the default step what the
        lattice's own limit allows, else 1; a GPU has none.
    damping_per_s
        Mass-proportional damping c in a = f/m - c v, 1/s; not negative, and below one over the step.
    gravity_m_s2
        Acceleration of gravity, LPS axes, m/s2.
    backend
        ``cpu`` (numba, float32), ``cuda`` (an NVIDIA GPU, float32) or ``reference`` (NumPy, float64).
    sleep_mm
        Movement that may be left out, mm: on the CPU, tissue that is slower and less accelerated than a swing of this
        size at 5 Hz, and far from all that moves, is not worked out. At 0 all is.
    skips_unmoved
        Work out again only what moved of the surfaces since they were last shown: the same to the bit, and quicker
        while part of the tissue rests. Without effect on what a GPU deforms.

    Raises
    ------
    SimulationError
        A step is beyond the lattice's own limit, the damping or gravity out of range, a surface of another lattice,
        or there is no such backend.
    """

    def __init__(
        self,
        model: LatticeModel,
        *,
        surface: SurfaceModel | None = None,
        picking: PickingModel | None = None,
        tissue: TissueSamples | None = None,
        step_s: float | None = None,
        pace: float | None = None,
        damping_per_s: float = 10.0,
        gravity_m_s2: Sequence[float] = (0.0, 0.0, 0.0),
        backend: Backend = "cpu",
        sleep_mm: float = SLEEP_MM,
        skips_unmoved: bool = True,
    ) -> None:
        super().__init__(
            model,
            surface=surface,
            picking=picking,
            tissue=tissue,
            step_s=step_s,
            pace=pace,
            backend=backend,
            skips_unmoved=skips_unmoved,
        )
        if not 0.0 <= damping_per_s * self.step_s < 1.0:
            message = (
                f"a damping of {damping_per_s:g}/s: give 0 to less than {1.0 / self.step_s:.6g}/s, one over the step"
            )
            raise SimulationError(message, place="damping_per_s")
        if not 0.0 <= sleep_mm < np.inf:
            raise SimulationError(f"a movement of {sleep_mm} mm cannot be left out: give 0 or more", place="sleep_mm")
        self.damping_per_s = float(damping_per_s)
        self.gravity_m_s2 = checked_gravity(gravity_m_s2)
        self.sleep_mm = float(sleep_mm)
        self.grabs: list[Grab] = []
        self.probes: list[Probe] = []
        self.open_scissors: list[Scissors] = []
        self.stitches = []
        self.patches = []
        units = model.units
        gravity = np.array(self.gravity_m_s2) @ model.geometry.direction_matrix / units.acceleration_m_s2
        step = self.step_s / units.time_s
        rate = 2.0 * np.pi * SLEEP_HZ * units.time_s
        still = sleep_mm / model.cell_mm * rate
        self.verlet = Verlet(
            step=step,
            damping=damping_per_s * units.time_s,
            gravity=(float(gravity[0]), float(gravity[1]), float(gravity[2])),
            still=(still, still * rate * step),
        )

    @property
    def instruments(self) -> tuple[Instrument, ...]:
        """Hands, forceps and retractors that hold, then probes, then scissors."""
        return (*self.grabs, *self.probes, *self.open_scissors)

    @property
    def time_s(self) -> float:
        """Simulated time, s."""
        return self.step_count * self.step_s

    def prepare(self) -> None:
        """Compile what will be needed, so that the first frame is as quick as the rest."""
        self._engine.advance(0, self.verlet)
        self._engine.advance(0, self.verlet, probe_row((0, 0, 0), (0, 0, 0), (1, 1, 1), np.eye(3))[None])
        self._engine.forces()
        self._engine.load(self.state)
        find_trouble(self.state)
        self._surfaces.prepare()

    def snapshot(self) -> Snapshot:
        """What :meth:`restore` goes back to: the state, what was cut, joined and sewn by now, and the instruments.

        It copies nothing twice.
        """
        return Snapshot.of(self.model, self.state, self.instruments, self.cuts, self.stitches, self.patches)

    def restore(self, point: State | Snapshot) -> None:
        """Go back, or on, to a snapshot: what follows gives the same bytes as it gave then.

        Instruments of that moment hold what they held, where they were, and go on to where they were led; others let
        go and are withdrawn. Stitches and patches are those of that moment, too. To a state alone: springs, stitches
        and patches stay as they are now, and all instruments let go.

        Raises
        ------
        SimulationError
            It is no snapshot and no state, or one of another lattice, or its springs are too stiff for the step.
            Nothing has changed.
        """
        if not isinstance(point, State | Snapshot):
            message = f"this is no snapshot but a {type(point).__name__}: give what snapshot() returned"
            raise SimulationError(message, place="restore")
        if not isinstance(point, Snapshot):
            point = Snapshot.of(self.model, point, (), self.cuts, self.stitches, self.patches)
        model, state = point.model, point.state
        before_cuts = self.uncut(model, point.cuts)
        is_same = before_cuts.is_of_lattice(self.uncut(self.model, self.cuts))
        if len(state.displacement) != model.node_count or not is_same:
            raise SimulationError("this is of another lattice: restore what this simulation gave", place="restore")
        if model is not self.model:
            if point.cuts is None:
                checked_step(StepSizes(model), self.step_s)
            else:
                self._check_explicit(model, point.cuts)
            self._set_model(model, point.cuts)
        instruments = [kept.put_back() for kept in point.instruments]
        self.grabs = [instrument for instrument in instruments if isinstance(instrument, Grab)]
        self.probes = [instrument for instrument in instruments if isinstance(instrument, Probe)]
        self.open_scissors = [instrument for instrument in instruments if isinstance(instrument, Scissors)]
        self.stitches = [stitch.put_back() for stitch in point.stitches]
        self.patches = [patch.put_back() for patch in point.patches]
        self._string()
        self._engine.load(state)
        self._hold()
        self._state = None

    def step(self, step_count: int = 1) -> None:
        """Take steps; hands reach where they are led to at the end of the last, in a straight line.

        Raises
        ------
        SimulationError
            The number of steps is no whole one or negative; or a position is not a number any more, or energy came from
            nowhere. The state before these steps is restored.
        """
        step_count = whole_number(step_count, "step_count", least=0, most=STEPS_MAX, error=SimulationError)
        if step_count == 0:
            return
        duration = step_count * self.verlet.step
        before, verlet = self.state, self._paced
        taken_count = verlet.row(step_count).step_count
        ways = [grab.way(self._engine.forces, duration) for grab in self.grabs]
        if taken_count < step_count and self.probes:
            farthest = max(
                (float(np.linalg.norm(end - start, axis=1).max(initial=0.0)) for start, end in ways), default=0.0
            )
            if not all(probe.keeps_away(self.model, before, duration, farthest) for probe in self.probes):
                # At longer steps elements that a probe holds pressed do not come to rest.
                verlet, taken_count = self.verlet, step_count
        led = []
        for start, end in ways:
            led.append((end, (end - start) / duration))
            self._place(self.grabs[len(led) - 1], start, led[-1][1])
        is_drawn = self._is_drawn
        if is_drawn:
            self._string(taken_count)
        rows = [probe.row(taken_count) for probe in self.probes]
        self._engine.advance(step_count, verlet, np.stack(rows) if rows else NO_PROBES)
        for probe, impulse in zip(self.probes, self._engine.probe_impulse if rows else (), strict=True):
            probe.wrench = -impulse / duration
        for grab, (end, velocity) in zip(self.grabs, led, strict=True):
            self._place(grab, end, velocity)
        self._state = None
        is_fed = bool(self.probes) or is_drawn or any(velocity.any() for _, velocity in led)
        self._watch(before, is_fed)
        if is_drawn:
            self._drawn()
            self._string()
        self._slip()
        for grab in self.grabs:
            grab.arrive()
        for probe in self.probes:
            probe.centre = probe.target

    def grab(self, center_mm: npt.ArrayLike, radius_mm: float, *, name: str = "grab") -> Grab:
        """Close a hand on the nodes within ``radius_mm`` of a point, LPS mm.

        Held are those that belong to no tissue across an incision from that nearest the ball's centre, and that can be
        reached along springs inside the ball from the nearest of them: a hand never bridges an incision, nor around its
        end (thesis 8.7.2). Nodes that another hand holds stay with it.

        Parameters
        ----------
        center_mm
            The ball's centre, LPS mm, shape (3,).
        radius_mm
            Its radius, mm; above 0.
        name
            Name in messages.

        Raises
        ------
        SimulationError
            There is no tissue to hold, the place is not a finite point, or the radius is not above 0.
        """
        among = None
        if is_point(center_mm) and is_number(radius_mm) and radius_mm > 0.0:
            center, radius = point_in_lattice(self.model, center_mm), radius_mm / self.model.cell_mm
            among = on_side_at(self.model, self.state.displacement, center, radius, self._sheet_triangles())
        grab = close_grab(
            self.model, self.state.displacement, center_mm, radius_mm, among=among, others=self.grabs, name=name
        )
        self.grabs.append(grab)
        self._hold()
        return grab

    def lead(self, grab: Grab, offset_mm: npt.ArrayLike, turn: npt.ArrayLike | None = None) -> None:
        """Lead a hand to a pose; it arrives with the end of the next :meth:`step`, each node in a straight line.

        Parameters
        ----------
        grab
            The hand.
        offset_mm
            Way of its centre from where it closed, LPS mm, shape (3,).
        turn
            Rotation about its centre since it closed, LPS axes, shape (3, 3); none when left out.

        Raises
        ------
        SimulationError
            It is no grab, or one that has let go, the offset is not finite, or the turn is no rotation.
        """
        require_grab(grab)
        if grab not in self.grabs:
            raise SimulationError("the hand has let go, or is not of this simulation: grab again", place=grab.name)
        grab.target = pose_of(self.model, offset_mm, turn, grab.name)

    def release(self, grab: Grab) -> None:
        """Let go: the nodes move on with the hand's velocity. A hand that has let go already stays so."""
        if grab not in self.grabs:
            return
        self.grabs.remove(grab)
        self._hold()

    def probe(
        self,
        center_mm: npt.ArrayLike,
        semi_axes_mm: npt.ArrayLike,
        *,
        turn: npt.ArrayLike | None = None,
        axis_mm: npt.ArrayLike | None = None,
        name: str = "probe",
    ) -> Probe:
        """Bring in a probe: it pushes nodes out of itself wherever it is moved (thesis 8.7.1).

        At up to a cell a step no cell is turned inside out by it, and tissue that it runs over goes ahead of it.

        Parameters
        ----------
        center_mm
            Its centre, LPS mm, shape (3,).
        semi_axes_mm
            Semi-axes of the ellipsoid, mm, shape (3,), or the radius of a ball; at least half a cell, or it slips
            through between the nodes.
        turn
            Directions of the semi-axes in its columns, LPS axes, shape (3, 3); those of LPS when left out.
        axis_mm
            Vector from one end to the other of the line that a ball is swept along, LPS mm, shape (3,): a capsule.
        name
            Name in messages.

        Raises
        ------
        SimulationError
            A number is not finite, a semi-axis too small, the turn no rotation, or what is swept along a line is no
            ball.
        """
        probe = make_probe(self.model, center_mm, semi_axes_mm, turn=turn, axis_mm=axis_mm, name=name)
        self.probes.append(probe)
        return probe

    def move(self, probe: Probe, center_mm: npt.ArrayLike) -> None:
        """Move a probe's centre, LPS mm; it arrives with the end of the next :meth:`step`, in a straight line.

        Parameters
        ----------
        probe
            The probe.
        center_mm
            Where its centre goes, LPS mm, shape (3,).

        Raises
        ------
        SimulationError
            It is no probe, or one that was withdrawn, or the centre is not finite.
        """
        require_probe(probe)
        if probe not in self.probes:
            raise SimulationError("the probe was withdrawn and cannot be moved: bring in another", place=probe.name)
        if not is_point(center_mm):
            raise SimulationError("the centre must be three finite numbers", place=probe.name)
        probe.target = point_in_lattice(self.model, center_mm)

    def withdraw(self, probe: Probe) -> None:
        """Take a probe away. One that was withdrawn already stays so."""
        if probe in self.probes:
            self.probes.remove(probe)

    def force_on(self, hand: Instrument) -> Float64:
        """Force that the tissue exerts on a hand, N, LPS axes, shape (3,).

        What a user feels: a hand that pulls to the left is pulled to the right. On a grab: of springs and cells on what
        it holds, now. On a probe: the opposite of the momentum that it gave the nodes in the last :meth:`step`, over
        the time that it took; zero where it touched nothing. Zero once a hand has let go.
        """
        return self.wrench_on(hand).force_n

    def wrench_on(self, hand: Instrument) -> Wrench:
        """Force that the tissue exerts on a hand, as of :meth:`force_on`, and its torque about the hand's centre.

        Raises
        ------
        SimulationError
            It is no instrument.
        """
        if not isinstance(hand, Instrument):
            message = f"this is no instrument but a {type(hand).__name__}: give what grab() or probe() returned"
            raise SimulationError(message, place="force")
        if hand not in self.instruments:
            return Wrench(np.zeros(3), np.zeros(3))
        return wrench_on(self.model, hand, self._engine.forces)

    def energy(self) -> Energy:
        """Kinetic and elastic energy now, J; threads are elastic, too."""
        masses = self._inverse_mass.copy()
        for grab in self.grabs:
            masses[grab.nodes] = 0
        threads_j = self._strung().energy(self.state.displacement) * self.model.units.energy_j
        now = energy(self.model, self.verlet, self.state, force=self._engine.forces(), inverse_mass=masses)
        return replace(now, elastic_j=now.elastic_j + threads_j)

    def watch(self) -> Watch:
        """Cells that are inside out and nodes that are held back, now."""
        led = np.zeros(self.model.node_count, dtype=bool)
        for grab in self.grabs:
            led[grab.nodes] = True
        return watch(self.model, self.state, self._paced.speed_limit, led)

    def inverted_cell_count(self) -> int:
        """Cells that are turned inside out now."""
        return int(inverted_cells(self.model, self.state.displacement).sum())

    @property
    def _paced(self) -> Verlet:
        """The scheme for a row of steps now, at the pace that all which is in the tissue allows."""
        if self.pace == 1.0:
            return self.verlet
        along = 0.0 if self.cuts is None else self.cuts.rate_along
        pace = pace_at(max(along, self._tied_rate), self.verlet.step, self.model.law)
        return replace(self.verlet, pace=min(self.pace, pace))

    def _place(self, grab: Grab, displacement: Float64, velocity: Float64) -> None:
        self._engine.prescribe(grab.nodes, displacement.astype(np.float32), velocity.astype(np.float32))

    def _carry(self, step: Step) -> None:
        for grab in self.grabs:
            grab.carry(*step.held(grab.nodes))
        one_sided = [grab for grab in self.grabs if isinstance(grab, OneSidedGrab)]
        if one_sided:
            sheets = self._sheet_triangles()
            for grab in one_sided:
                grab.keep_side(self.model, sheets)
        self._hold()
        self._rethread()

    def _hold(self) -> None:
        masses = self._inverse_mass.copy()
        for grab in self.grabs:
            masses[grab.nodes] = 0
        self._engine.set_inverse_mass(masses)

    def _watch(self, before: State, is_fed: bool) -> None:
        trouble = find_trouble(self.state)
        if trouble is None and not is_fed:
            trouble = find_runaway(self.model, self._paced, before, self.state, self._strung())
        if trouble is None:
            return
        ended_s = self.time_s
        self._engine.load(before)
        self._state = None
        for grab in self.grabs:
            grab.stay()
        for probe in self.probes:
            probe.target = probe.centre
            probe.wrench = np.zeros(6)
        self._stay()
        if self.instruments:
            trouble = f"{trouble} with {', '.join(one.name for one in self.instruments)} in the tissue"
        raise SimulationError(
            f"the simulation broke down between {self.time_s:.4f} s and {ended_s:.4f} s: {trouble}; "
            "pull more slowly or less far, or give a smaller step. The state before was restored",
            place="simulation",
        )
