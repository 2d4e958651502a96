"""What the CPU kernel is given, in groups: nodes, cells, instruments, the steps to take, and the thread that does."""

from __future__ import annotations

from typing import NamedTuple

from heartcase.schemas.arrays import Float32, Float64, Int8, Int64
from heartcase.simulator.engine.cpu.barrier import Barrier
from heartcase.simulator.engine.cpu.ghosts import GhostArrays
from heartcase.simulator.engine.cpu.instruments import Constants, ExplicitArrays
from heartcase.simulator.engine.cpu.tethers import TetherArrays
from heartcase.simulator.engine.cpu.turning import TurnArrays

__all__ = [
    "CellArrays",
    "CellWork",
    "InstrumentArrays",
    "Kinds",
    "NodeArrays",
    "SharingArrays",
    "StepRow",
    "ThreadPlace",
]

Kinds = tuple[int, bool, bool]
"""What acts in the cells, whether springs act, and whether corners are guarded."""


class NodeArrays(NamedTuple):
    """Nodes and their springs."""

    displacement: Float32
    """Two buffers [cells], six numbers a lane; the steps alternate between them."""
    velocity: Float32
    """Half a step before [cells / unit of time], three numbers a lane."""
    weight: Float32
    """Spring stiffness by direction [k], nine numbers a lane; read where springs are worked out from both ends."""
    window_numbers: Float32
    """The same and then the inverse mass, of each window's lanes by themselves, with one more window of zeros, shape
    (window_count + 1, 10, 8); read where each spring is worked out once."""
    tension: Float32
    """Room for the tensions of the springs over their lengths [k], zeros at first, nine numbers a lane; of length 0
    where each is to be worked out from both ends."""
    inverse_mass: Float32
    """[1 / full cell], 0 where there is no node or its motion is prescribed, shape (lane_count,)."""
    rows: Int64
    """Lane at each window's first i in its nine rows, shape (window_count, 9); in memory one more row follows, that of
    a window of empty lanes."""
    rest: Float32
    """Rest positions [cells], three numbers a lane; read where there are probes."""


class CellArrays(NamedTuple):
    """The cells beside their sharing of strain."""

    rows: Int64
    """Rows of the windows that hold cells, as of CellLayout, shape (count, 16)."""
    in_pairs: Int8
    """Whether a window's parts follow each other two by two, likewise, shape (count,)."""
    numbers: Float32
    """Numbers of the cells, of each window's lanes by themselves, shape (count, CELL_NUMBERS, CELL_LANES)."""
    force: Float32
    """Room for their forces on the nodes of each chunk, three numbers a lane, of CHUNKS_PER_ROOM chunks side by side,
    shape (any, any)."""
    law: Float32
    """Constants of the law."""
    is_flat: Int8
    """Whether each window of cells is looked after."""
    is_touched: Int8
    """Whether such cells belong to each window of nodes."""
    touches: Int64
    """Windows of nodes that a window of cells belongs to, -1 for none, shape (count, any)."""


class SharingArrays(NamedTuple):
    """What elements need that share strain; of length 0 where none do."""

    shares: Float32
    """Stiffness of each cell that is strained by the mean around each corner, and by itself [k/h], of each window of
    cells by itself, shape (cell_window_count, 9, CELL_LANES)."""
    node_shares: Float32
    """The same of the eight cells around each node, with their corner there, then the inverse of all that shares strain
    around it [h/k], zero where nothing does, of each window of nodes by itself, shape (window_count, 9, 8)."""
    ghost_shares: Float32
    """The same of each ghost's cell, in the order of ``GhostArrays.ghost_number``, shape (irregular_count * 8,)."""
    ghost_sums: Float32
    """Room for what irregular cells add to the sums around the nodes of each window with ghosts, zeros at first, shape
    (any, 9, 8)."""
    gradient: Float32
    """Room for F - 1 of each cell, nine numbers a lane."""
    stress: Float32
    """Room for the stress of the mean strain around each node, nine numbers a lane."""
    is_sharing: Int8
    """Whether a cell of a window shares strain, shape (cell_window_count,)."""


class CellWork(NamedTuple):
    """What is done in the cells."""

    cells: CellArrays
    """The cells."""
    kinds: Kinds
    """What acts."""
    sharing: SharingArrays
    """Of elements that share strain."""
    ghosts: GhostArrays
    """Of irregular cells."""


class InstrumentArrays(NamedTuple):
    """What instruments do to the tissue."""

    explicit: ExplicitArrays
    """Explicit springs, and those of the lattice that are irregular."""
    probes: Float32
    """As of :func:`heartcase.simulator.engine.shared.contact.probe_row`, shape (probe_count, PROBE_SIZE)."""
    turn: TurnArrays
    """Room for what keeps corners from turning."""
    given: Float64
    """What each probe gave, momentum and its moment, is added to this in shares, shape (SHARES, probe_count, 6)."""
    tethers: TetherArrays
    """What stitches pull with."""


class StepRow(NamedTuple):
    """A number of steps that follow each other."""

    current: int
    """Buffer that holds the displacement now."""
    step_count: int
    """Steps to take."""
    first_step: int
    """Steps that were taken before in this row: probes have moved so far, and looks and checks are counted from
    there."""
    first_constants: Constants
    """Of the first step: step, keep, kick, the three components of gravity and the speed limit, grid units."""
    constants: Constants
    """Of the others."""
    last_constants: Constants
    """Of one more in which nothing moves on."""
    has_last: bool
    """Whether there is that one."""
    still: Float32
    """Speed below which a node is still, change of it in a step [cells / unit of time], and what rounding may add to
    that per cell of displacement, shape (3,); zeros where no tissue sleeps."""


class ThreadPlace(NamedTuple):
    """One of the threads that take the same steps."""

    thread: int
    """Its number."""
    thread_count: int
    """How many there are."""
    barrier: Barrier
    """Where threads wait for one another."""
