"""The engine on the CPU: float32, all cores, vectors of 8 lanes, of 16 for cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import get_num_threads

from heartcase.schemas.arrays import Float32, Float64, Int32, Intp
from heartcase.simulator.dynamics.integrate import Row, Verlet
from heartcase.simulator.engine.cpu.arrays import (
    CellArrays,
    CellWork,
    InstrumentArrays,
    NodeArrays,
    SharingArrays,
    StepRow,
    ThreadPlace,
)
from heartcase.simulator.engine.cpu.autotune import Autotuner
from heartcase.simulator.engine.cpu.barrier import Barrier, ThreadTeam
from heartcase.simulator.engine.cpu.chunks import KEPT_NODES_MAX, SHARES, behind_windows, chunk_arrays, share_out
from heartcase.simulator.engine.cpu.ghosts import GhostArrays, ghost_arrays
from heartcase.simulator.engine.cpu.instruments import explicit_arrays
from heartcase.simulator.engine.cpu.kernel import (
    CHUNKS_PER_ROOM,
    ELEMENTS,
    NO_CELLS,
    SHARING_ELEMENTS,
    VOLUME_TERM,
    advance,
    lane_forces,
)
from heartcase.simulator.engine.cpu.room import aligned, untouched
from heartcase.simulator.engine.cpu.sleep import ROUNDING, Blocks, blocks_of, sleep_arrays
from heartcase.simulator.engine.cpu.springs import WINDOW_NUMBERS
from heartcase.simulator.engine.cpu.tethers import tether_arrays
from heartcase.simulator.engine.cpu.turning import turn_arrays
from heartcase.simulator.engine.shared.cell_lanes import CellLayout, cell_layout, inverse_shared, share_numbers
from heartcase.simulator.engine.shared.contact import NO_PROBES
from heartcase.simulator.engine.shared.lane_arrays import (
    copy_into_windows,
    read_vectors,
    write_vectors,
)
from heartcase.simulator.engine.shared.lanes import (
    CELL_LANES,
    CELL_NUMBERS,
    LANE_COUNT,
    SHARE_NUMBERS,
    LaneLayout,
    lane_layout,
)
from heartcase.simulator.engine.shared.spring_kernels import copy_from_windows
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel
from heartcase.simulator.lattice.state import State
from heartcase.simulator.lattice.tethers import Tethers

__all__ = ["PARALLEL_WINDOWS_MIN", "CpuEngine"]


PARALLEL_WINDOWS_MIN = 1024
"""Windows from which on more than one thread pays."""


@dataclass(frozen=True)
class _Plan:
    """What of an engine follows from nodes and cells alone; it is not written."""

    model: LatticeModel
    layout: LaneLayout
    cells: CellLayout
    ghosts: GhostArrays
    blocks: Blocks
    behind: Int32
    """Windows behind each window, where tensions are kept."""

    @classmethod
    def of(cls, model: LatticeModel) -> _Plan:
        """Of a lattice."""
        layout = lane_layout(model, in_banks=True)
        cells = cell_layout(model, layout)
        keeps_tensions = model.node_count <= KEPT_NODES_MAX
        behind = behind_windows(layout) if keeps_tensions else np.full((layout.window_count, 1), -1, np.int32)
        return cls(model, layout, cells, ghost_arrays(model, cells), blocks_of(model, layout), behind)

    def fits(self, model: LatticeModel) -> bool:
        """Whether another lattice has the same nodes and cells, of which no springs were removed."""
        names = ("node_index", "cells", "cell_corners", "cell_is_whole")
        pairs = [(getattr(self.model, name), getattr(model, name)) for name in names]
        if any(len(one) != len(other) for one, other in pairs) or not model.cell_is_whole.all():
            return False
        return all(one is other or np.array_equal(one, other) for one, other in pairs)


class CpuEngine:
    """The numba kernel over the lanes of :mod:`heartcase.simulator.engine.shared.lanes`.

    Parameters
    ----------
    model
        The lattice.
    before
        An engine whose layout is gone on with where its lattice has the same nodes and cells; that engine may be in
        use.
    """

    def __init__(self, model: LatticeModel, before: CpuEngine | None = None) -> None:
        known: _Plan | None = None if before is None else before._plan
        self._plan: _Plan = known if known is not None and known.fits(model) else _Plan.of(model)
        plan = self._plan
        self.layout = layout = plan.layout
        self._rows = layout.window_rows
        self._keeps_tensions = model.node_count <= KEPT_NODES_MAX
        # Displacement in two buffers, velocity and inverse mass share one array, what is seldom needed another. Each is
        # a view that reaches over the others' places: only the lanes of nodes are written.
        state, room = aligned((layout.length(10),)), untouched((layout.length(9),))
        self._buffers = state[: layout.length(6)]
        self.velocity = state[6 * layout.stride :][: layout.length(3)]
        self.inverse_mass = state[9 * layout.stride :][: layout.lane_count]
        self.force = room[: layout.length(3)]
        self._rest = room[3 * layout.stride :][: layout.length(3)]
        self._knows_rest = False
        self._weight: Float32 | None = None
        self._no_weight = aligned((0,))
        self.tension = aligned((layout.length(len(DIRECTIONS)) if self._keeps_tensions else 0,))
        self.window_numbers = aligned(
            (layout.window_count + 1 if self._keeps_tensions else 0, WINDOW_NUMBERS, LANE_COUNT)
        )
        self.cells, self._ghosts = plan.cells, plan.ghosts
        self.is_flat = np.zeros(len(self.cells.window_rows), np.int8)
        self.is_touched = np.zeros(layout.window_count, np.int8)
        self._turn = turn_arrays(layout, len(self.cells.window_rows))
        self.probe_impulse: Float64 = np.zeros((0, 6))
        self._given: Float64 = np.zeros((SHARES, 0, 6))
        self._sleep = sleep_arrays(plan.blocks, len(self.cells.window_rows), room[6 * layout.stride :])
        layer_count = int(np.ptp(model.node_index[:, 2])) + 1
        self._chunks = chunk_arrays(plan.behind, self.cells.touches, self._sleep, layer_count, self.cells.ghost_window)
        # Where no cell can act there is no room for what it does.
        may_act = model.law.acts_in_cells or model.law.has_corner_guard
        room_count = -(-(len(self._chunks.ends) - 1) // CHUNKS_PER_ROOM)
        self.cell_force = untouched((room_count, layout.length(3 * CHUNKS_PER_ROOM) if may_act else 0))
        self._means = aligned((0,)), aligned((0,))
        self.set_springs(model)
        self.set_tethers(Tethers.none())
        self.set_inverse_mass(model.inverse_mass)
        self.autotuner = Autotuner()
        self._team = ThreadTeam()
        self.current = 0
        self.step_count = 0

    @property
    def awake_part(self) -> float:
        """Part of the windows of nodes that the last step worked out."""
        return float(self._sleep.counts[0]) / self.layout.window_count

    @property
    def weight(self) -> Float32:
        """Spring stiffness by direction [k], nine numbers a lane; put together when it is first asked for."""
        if self._weight is None:
            weight = aligned((self.layout.length(len(DIRECTIONS)),))
            if self._keeps_tensions:
                copy_from_windows(self.window_numbers, self._rows, self.layout.stride, len(DIRECTIONS), weight)
            else:
                weight[:] = self.layout.spring_weight(self.model, self.model.acting_weight)
            self._weight = weight
        return self._weight

    @property
    def displacement(self) -> Float32:
        """The displacement now [cells], three numbers a lane."""
        return self._buffers[3 * self.layout.stride * self.current :][: self.layout.length(3)]

    def load(self, state: State) -> None:
        """Start from this state."""
        write_vectors(self.layout.node_lane, state.displacement, self.displacement)
        write_vectors(self.layout.node_lane, state.velocity, self.velocity)
        # Lanes without a cell are read, too, with a share of zero: no NaN of a state that broke down must be left.
        for means in self._means:
            means[:] = 0.0
        self.step_count = state.step_count

    def read(self) -> State:
        """A copy of the state."""
        return State(self._vectors(self.displacement), self._vectors(self.velocity), self.step_count)

    def prescribe(self, nodes: Intp, displacement: Float32, velocity: Float32) -> None:
        """Set where nodes are and how they move on."""
        places = self.layout.places(self.layout.node_lane[nodes], 3)
        self.displacement[places] = displacement
        self.velocity[places] = velocity

    def set_inverse_mass(self, inverse_mass: Float32) -> None:
        """Inverse masses; nodes at zero keep their velocity."""
        self.inverse_mass[self.layout.node_lane] = inverse_mass
        self.inverse_mass[self._ghosts.lane] = self.inverse_mass[self._ghosts.of_lane]
        if self._keeps_tensions:
            copy_into_windows(self.inverse_mass, self._rows, len(DIRECTIONS), self.window_numbers)

    def advance(self, step_count: int, verlet: Verlet, probes: Float32 = NO_PROBES) -> None:
        """Take steps."""
        row, taken = verlet.row(step_count), 0

        def with_threads(thread_count: int) -> Callable[[int], None]:
            def take(count: int) -> None:
                nonlocal taken
                self._take(thread_count, count, row, probes, taken)
                taken += count

            return take

        thread_count = min(get_num_threads(), len(self._chunks.before_counts))
        if self.layout.window_count < PARALLEL_WINDOWS_MIN or thread_count == 1:
            with_threads(1)(row.step_count)
        else:
            self.autotuner.run(row.step_count, (with_threads(1), with_threads(thread_count)))
        self.step_count += step_count

    @property
    def threads_pay(self) -> bool:
        """Whether more than one thread has been quicker lately: a busy machine has none to spare."""
        return bool(self.autotuner.seconds_per_step) and self.autotuner.quickest == 1

    def advance_by(
        self, thread_count: int, step_count: int, verlet: Verlet, probes: Float32, first_step: int = 0
    ) -> None:
        """Take steps as they are, with so many threads; the bits are the same with any number."""
        self._take(thread_count, step_count, replace(verlet, pace=1.0).row(step_count), probes, first_step)
        self.step_count += step_count

    def _take(self, thread_count: int, step_count: int, row: Row, probes: Float32, first_step: int) -> None:
        """Take so many steps of a row, from one of them on."""

        def part(thread: int, thread_count: int, barrier: Barrier) -> int:
            return int(advance(*arguments, ThreadPlace(thread, thread_count, barrier)))

        if len(probes) and not self._knows_rest:
            write_vectors(self.layout.node_lane, self.model.node_index, self._rest)
            self._knows_rest = True
        if first_step == 0:
            self._given = np.zeros((SHARES, len(probes), 6))
        of_first = row.first if first_step == 0 else row.others
        of_all = (of_first, row.others, row.last or row.others)
        first, others, last = (tuple(np.float32(number) for number in numbers) for numbers in of_all)
        has_last = row.last is not None and first_step + step_count == row.step_count
        still = np.array([*row.still, ROUNDING * row.others[2]], np.float32)
        arguments = (
            NodeArrays(
                self._buffers,
                self.velocity,
                self._no_weight if self._keeps_tensions else self.weight,
                self.window_numbers,
                self.tension,
                self.inverse_mass,
                self._rows,
                self._rest,
            ),
            CellWork(self._cell_arrays, self._kinds, self._sharing, self._ghosts),
            InstrumentArrays(self._explicit, probes, self._turn, self._given, self._tethers),
            StepRow(self.current, step_count, first_step, first, others, last, has_last, still),
            self._sleep,
            self._chunks,
        )
        self.current = self._team.run(thread_count, part)
        # Each share adds up step by step, wherever the row of steps is divided.
        self.probe_impulse = self._given.sum(axis=0)

    def set_springs(self, model: LatticeModel) -> None:
        """Go on with the springs of another model of the same nodes."""
        law = model.law
        self._weight = None
        if self._keeps_tensions:
            self.window_numbers[:, :-1] = 0
            has_springs = self.layout.write_window_weight(model, *model.scaled_weight, self.window_numbers)
        else:
            has_springs = bool(model.scaled_weight[0].any())
        in_cells = ELEMENTS if law.is_element else VOLUME_TERM if law.has_volume_term else NO_CELLS
        if model.shares_strain:
            in_cells = SHARING_ELEMENTS
        self._sharing = self._sharing_arrays(model)
        if model.shares_strain != bool(self._chunks.shares_strain[0]):
            self._chunks.shares_strain[0] = model.shares_strain
            share_out(self._chunks, self._sleep)
        numbers = self._cell_room(CELL_NUMBERS)
        self.cells.write_numbers(model, numbers)
        self._kinds = (in_cells, has_springs, law.has_corner_guard)
        self._cell_arrays = CellArrays(
            self.cells.window_rows,
            self.cells.in_pairs,
            numbers,
            self.cell_force,
            np.array(law.constants, np.float32),
            self.is_flat,
            self.is_touched,
            self.cells.touches,
        )
        self._springs_apart = self.layout.springs_apart(model)
        self._explicit = explicit_arrays(self.layout, self._springs_apart)
        self.model = model

    def set_tethers(self, tethers: Tethers) -> None:
        """Go on with other tethers."""
        self._tethers_apart = tethers
        self._tethers = tether_arrays(self.layout, tethers)

    def _sharing_arrays(self, model: LatticeModel) -> SharingArrays:
        """What elements need that share strain."""
        is_sharing = np.zeros(len(self.cells.window_rows), np.int8)
        if not model.shares_strain:
            none = aligned((0, SHARE_NUMBERS, CELL_LANES))
            return SharingArrays(none, none, aligned((0,)), none, *self._means, is_sharing)
        if not len(self._means[0]):
            length = self.layout.length(SHARE_NUMBERS)
            self._means = aligned((length,)), aligned((length,))
        # Cells that share nothing any more are not written, but read, with a share of zero: no NaN must be left.
        self._means[0][:] = 0.0
        shares, ghosts, layout = share_numbers(model), self._ghosts, self.layout
        around = aligned((layout.window_count, SHARE_NUMBERS, LANE_COUNT))
        self.cells.by_node_window(model, shares[:-1], inverse_shared(model), around)
        cell = layout.irregular_cells[ghosts.ghost_number // 8]
        by_window = self._cell_room(SHARE_NUMBERS)
        self.cells.write_by_window(shares, 0, by_window)
        windows = np.unique(self.cells.cell_slot[model.shared_stiffness.any(axis=1)] // CELL_LANES)
        is_sharing[windows] = 1
        return SharingArrays(
            by_window,
            around,
            shares[ghosts.ghost_number % 8, cell],
            aligned((int(ghosts.window_number.max(initial=-1)) + 1, SHARE_NUMBERS, LANE_COUNT)),
            *self._means,
            is_sharing,
        )

    def forces(self, nodes: Intp | None = None) -> Float32:
        """Spring forces now, on some nodes or all; only the windows that hold them are worked out."""
        rows = self.layout.window_rows if nodes is None else self.layout.windows_of(nodes)
        work = CellWork(self._cell_arrays, self._kinds, self._sharing, self._ghosts)
        lane_forces(self.displacement, self.weight, self.force, rows, work, self._rows, self._sleep, self._chunks)
        if nodes is None:
            force = self._vectors(self.force)
        else:
            force = self.force[self.layout.places(self.layout.node_lane[nodes], 3)]
        if len(self._springs_apart.other):
            apart = self._springs_apart.forces(self.read().displacement)
            force += apart if nodes is None else apart[nodes]
        if self._tethers_apart.count:
            apart = self._tethers_apart.forces(self.read().displacement)
            force += apart if nodes is None else apart[nodes]
        return force

    def _vectors(self, array: Float32) -> Float32:
        """Three numbers of each node, shape (node_count, 3)."""
        vectors = np.empty((len(self.layout.node_lane), 3), np.float32)
        read_vectors(self.layout.node_lane, array, vectors)
        return vectors

    def _cell_room(self, number_count: int) -> Float32:
        """Zeros for so many numbers of each window of cells."""
        return aligned((len(self.cells.window_rows), number_count, CELL_LANES))
