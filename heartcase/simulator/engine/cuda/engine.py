"""The engine on a CUDA device: the state stays there, and the host reads what it asks for.

Where ``NUMBA_ENABLE_CUDASIM=1`` is set before numba is loaded, the same code runs in numba's simulator: exact and very
slow, for tests without a device.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numba
import numpy as np

from heartcase.schemas.arrays import Float32, Float64, Intp
from heartcase.schemas.errors import SimulationError, how_to_install
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.engine.cuda.cells import CellsOnDevice, plain_launch
from heartcase.simulator.engine.shared.contact import NO_PROBES, moved_on
from heartcase.simulator.engine.shared.lanes import lane_layout
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State
from heartcase.simulator.lattice.tethers import Tethers, TethersByNode

__all__ = ["CudaEngine", "Launch", "plan_launch"]


WARP = 32
"""Threads that a multiprocessor runs in step."""
NODE_SETS_KEPT = 16
"""Sets of nodes whose forces were asked for that stay on the device."""
STEPS_PER_LAUNCH = 100_000
"""So that Ctrl-C is heard within seconds, and the count at the grid-wide barrier stays in its 32 bits; whole looks."""


@dataclass(frozen=True)
class Launch:
    """How the nodes are shared among threads."""

    block_count: int
    """Blocks of threads."""
    thread_count: int
    """Threads of each block."""
    sweep_count: int
    """Sweeps that hold all nodes; one where each thread has a node for good."""
    share: int
    """Nodes of each block of threads in a sweep."""


def plan_launch(node_count: int, block_count: int, thread_count: int) -> Launch:
    """Share nodes evenly among at most so many blocks of threads with at most so many threads.

    A block of threads takes ``share`` neighbouring nodes, so that most of what it reads is its own; a sweep takes
    ``share * block_count`` nodes.
    """
    sweep_count = -(-node_count // (block_count * thread_count))
    share = -(-node_count // (sweep_count * block_count))
    share = min(-(-share // WARP) * WARP, thread_count)
    return Launch(
        block_count=min(block_count, -(-node_count // share)), thread_count=share, sweep_count=sweep_count, share=share
    )


class _SharedMemory:
    """Memory of the host that the device reads and writes in place: what is small passes without a copy."""

    def __init__(self, cuda: Any, node_count: int) -> None:
        self.nodes = cuda.mapped_array(node_count, np.uint32)
        self.displacement = cuda.mapped_array((node_count, 3), np.float32)
        self.velocity = cuda.mapped_array((node_count, 3), np.float32)
        self.event = cuda.event()
        """Past once the device has read what was written here."""


class CudaEngine:
    """The CUDA kernels: float32, many steps in one launch.

    Parameters
    ----------
    model
        The lattice.
    resident
        Whether each thread keeps a node for good: by default where the device has room for all nodes.

    Raises
    ------
    SimulationError
        There is no CUDA device, or what it needs is not installed.
    """

    threads_pay = False

    def __init__(self, model: LatticeModel, *, resident: bool | None = None) -> None:
        self._cuda = _cuda()
        from heartcase.simulator.engine.cuda import node_copy_kernels, step_kernels

        self._kernels, self._node_kernels = step_kernels, node_copy_kernels
        self.model = model
        layout = lane_layout(model)
        self._layout = layout
        self._lane_count = layout.lane_count
        cuda = self._cuda
        self._node_lane = cuda.to_device(layout.node_lane.astype(np.uint32))
        self._node_slot = cuda.to_device(layout.node_slot.astype(np.uint32))
        self._window_rows = cuda.to_device(layout.window_rows.astype(np.uint32).ravel())
        self._cells = CellsOnDevice(cuda, model, layout)
        self.set_springs(model)
        self.set_tethers(Tethers.none())
        self._displacement = cuda.to_device(np.zeros(8 * layout.lane_count, np.float32))
        self._velocity = cuda.to_device(np.zeros(4 * layout.lane_count, np.float32))
        self._arrivals = cuda.to_device(np.zeros(2, np.uint32))
        self._taken = cuda.mapped_array(1, np.uint32)
        self._nothing = cuda.to_device(np.zeros(0, np.float32))
        self._no_probes = self._probes = cuda.to_device(NO_PROBES)
        self._nodes_seen: dict[bytes, Any] = {}
        self._shown = _SharedMemory(cuda, model.node_count)
        self._given: _SharedMemory | None = None
        self._constants: dict[Verlet, Any] = {}
        self._current = 0
        self._row_step = 0
        self.step_count = 0
        self._resident = resident
        self._plans: dict[tuple[bool, bool], tuple[Launch, bool]] = {}
        self._plan_with_cells: tuple[int, int] | None = None
        self._advance(0, self._constants_of(Verlet(0.0)), 0)
        self.set_inverse_mass(model.inverse_mass)

    def load(self, state: State) -> None:
        """Start from this state."""
        self.prescribe(np.arange(self.model.node_count), state.displacement, state.velocity)
        self.step_count = state.step_count

    def read(self) -> State:
        """A copy of the state."""
        first = self._current * self._lane_count
        gather = self._node_kernels.gather_nodes[plain_launch(self.model.node_count)]
        gather(self._displacement, first, self._node_lane, self._shown.displacement)
        gather(self._velocity, 0, self._node_lane, self._shown.velocity)
        self._cuda.synchronize()
        return State(np.array(self._shown.displacement), np.array(self._shown.velocity), self.step_count)

    def displacement_on_device(self) -> Any:
        """Displacement of every node [cells] on the device, shape (node_count, 3), until it is asked for again."""
        first = self._current * self._lane_count
        gather = self._node_kernels.gather_nodes[plain_launch(self.model.node_count)]
        gather(self._displacement, first, self._node_lane, self._by_node)
        return self._by_node

    def prescribe(self, nodes: Intp, displacement: Float32, velocity: Float32) -> None:
        """Set where nodes are and how they move on."""
        if not len(nodes):
            return
        if self._given is None or len(self._given.nodes) < len(nodes):
            self._cuda.synchronize()
            self._given = _SharedMemory(self._cuda, len(nodes))
        given = self._given
        given.event.synchronize()
        given.nodes[: len(nodes)] = nodes
        given.displacement[: len(nodes)] = displacement
        given.velocity[: len(nodes)] = velocity
        self._node_kernels.scatter_nodes[plain_launch(len(nodes))](
            len(nodes),
            given.nodes,
            given.displacement,
            given.velocity,
            self._node_lane,
            self._current * self._lane_count,
            self._displacement,
            self._velocity,
        )
        given.event.record()

    def set_inverse_mass(self, inverse_mass: Float32) -> None:
        """Inverse masses; nodes at zero keep their velocity."""
        self._node_kernels.write_inverse_mass[plain_launch(len(inverse_mass))](
            self._cuda.to_device(np.ascontiguousarray(inverse_mass, np.float32)), self._node_lane, self._velocity
        )

    def advance(self, step_count: int, verlet: Verlet, probes: Float32 = NO_PROBES) -> None:
        """Take steps. Some may be under way when this returns; whatever reads the state waits for them."""
        constants = self._constants_of(verlet)
        cells = self._cells
        self._row_step = 0
        cells.clear_given(len(probes))
        if not step_count and (cells.may_act or len(probes)):
            # compile it before it is needed in the middle of a scene
            self._advance_with_cells(0, constants, probes, 0)
        works_cells = cells.always_act or len(probes) > 0
        look_steps = 0 if works_cells else cells.look_steps
        left, idle_launches = step_count, 0
        while True:
            count, looks = min(left, STEPS_PER_LAUNCH), look_steps
            if idle_launches == 2:
                # Each kernel leaves it to the other: their looks are rounded otherwise.
                works_cells, count, looks = True, min(left, look_steps), 0
            if works_cells:
                self._advance_with_cells(count, constants, probes, looks)
            else:
                self._advance(count, constants, looks)
            try:
                if look_steps or count < left:
                    self._cuda.synchronize()
            finally:
                if looks:
                    # what a look found is for the other kernel
                    works_cells ^= int(self._taken[0]) < count
                    count = int(self._taken[0])
                self._current = (self._current + count) % 2
                self.step_count += count
                self._row_step += count
            idle_launches = 0 if count else idle_launches + 1
            probes = moved_on(probes, count)
            left -= count
            if not left:
                return

    @property
    def probe_impulse(self) -> Float64:
        """What each probe gave the nodes in the last row of steps, shape (probe_count, 6); waits for it."""
        return self._cells.probe_impulse

    def set_springs(self, model: LatticeModel) -> None:
        """Go on with the springs of another model of the same nodes."""
        weight = self._layout.spring_weight(model, model.acting_weight)
        self._spring_weight = self._cuda.to_device(weight)
        self._cells.set_model(model)
        self._uniform_weight = self._cuda.to_device(self._layout.uniform_weight(model))
        springs = self._layout.springs_apart(model)
        self._explicit_count = len(springs.other)
        self._explicit = (
            self._cuda.to_device(springs.first.astype(np.uint32)),
            self._cuda.to_device(self._layout.node_lane[springs.other].astype(np.uint32)),
            self._cuda.to_device(springs.offset.ravel()),
            self._cuda.to_device(np.column_stack([springs.stiffness, springs.excess]).ravel()),
        )

    def set_tethers(self, tethers: Tethers) -> None:
        """Go on with other tethers."""
        by_node = TethersByNode.of(tethers)
        first = np.zeros(self.model.node_count + 1, np.uint32)
        first[by_node.nodes + 1] = np.diff(by_node.first)
        self._tethers_are_there = tethers.count > 0
        self._tethers = (
            self._cuda.to_device(np.cumsum(first).astype(np.uint32)),
            self._cuda.to_device(by_node.number.astype(np.uint32)),
            self._cuda.to_device(by_node.share.astype(np.float32)),
            self._cuda.to_device(self._layout.node_lane[tethers.nodes].astype(np.uint32).ravel()),
            self._cuda.to_device(tethers.shares.ravel()),
            self._cuda.to_device(tethers.shapes().ravel()),
        )

    def forces(self, nodes: Intp | None = None) -> Float32:
        """Spring forces now, on some nodes or all."""
        nodes = np.arange(self.model.node_count) if nodes is None else nodes
        if not len(nodes):
            return np.zeros((0, 3), np.float32)
        self._kernels.node_forces[plain_launch(len(nodes))](
            self._displacement,
            self._spring_weight,
            self._window_rows,
            self._node_slot,
            self._lane_count,
            self._current,
            *self._explicit,
            self._tethers,
            self._on_device(nodes),
            self._shown.displacement,
        )
        first = self._current * self._lane_count
        self._cells.add_forces(self._displacement, first, self._on_device(nodes), self._shown.displacement)
        self._cuda.synchronize()
        return np.array(self._shown.displacement[: len(nodes)])

    def _advance(self, step_count: int, constants: Any, look_steps: int) -> None:
        kind = (self._explicit_count > 0, self._tethers_are_there)
        if kind not in self._plans:
            self._plans[kind] = self._plan(kind, constants)
        launch, is_resident = self._plans[kind]
        self._start(launch, step_count, constants, look_steps, kind=kind, is_resident=is_resident)

    def _advance_with_cells(self, step_count: int, constants: Any, probes: Float32, look_steps: int) -> None:
        kernel = self._cells.kernels.advance_with_cells
        rest = self._rest if len(probes) else self._nothing
        hands = (
            *self._explicit,
            self._tethers,
            self._row_step,
            rest,
            self._on_device_probes(probes) if len(probes) else self._no_probes,
        )
        turn = self._cells.turn(len(probes))

        def start(count: int, threads: tuple[int, int]) -> None:
            kernel[threads](
                self._displacement,
                self._velocity,
                self._spring_weight,
                self._window_rows,
                self._node_slot,
                self._lane_count,
                *self._cells.arguments(),
                self._current,
                count,
                constants,
                self._arrivals,
                *hands,
                turn,
                look_steps,
                self._taken,
            )

        if self._plan_with_cells is None:
            start(0, (1, WARP))
            overload = next(iter(kernel.overloads.values()), None) or kernel.overloads[()]
            blocks, threads = _fitting(overload.max_cooperative_grid_blocks, self._cells.kernels.CELL_THREADS)
            self._plan_with_cells = min(blocks, -(-self.model.node_count // threads)), threads
        start(step_count, self._plan_with_cells)

    def _start(
        self,
        launch: Launch,
        step_count: int,
        constants: Any,
        look_steps: int,
        *,
        kind: tuple[bool, bool],
        is_resident: bool,
    ) -> None:
        state = (self._displacement, self._velocity, self._spring_weight)
        where = (self._window_rows, self._node_slot, self._lane_count)
        what = (self._current, step_count, constants, self._arrivals)
        looks = (*self._cells.looked_at, look_steps, self._taken)
        hands = (*self._explicit, self._tethers, self._row_step, *looks)
        threads = (launch.block_count, launch.thread_count)
        if is_resident:
            self._kernels.advance_resident[kind][threads](*state, *where, *what, *hands)
        else:
            sweeps = (launch.sweep_count, launch.share)
            arguments = (*state, self._uniform_weight, *where, *sweeps, *what, *hands)
            self._kernels.advance_streaming[kind][threads](*arguments)

    def _plan(self, kind: tuple[bool, bool], constants: Any) -> tuple[Launch, bool]:
        """Compile the kernel that suits the number of nodes, and share them so that all threads run at once."""
        kernels, node_count = self._kernels, self.model.node_count
        for family, is_resident in ((kernels.advance_resident, True), (kernels.advance_streaming, False)):
            if self._resident not in (None, is_resident):
                continue
            one = Launch(1, WARP, 1, WARP)
            self._start(one, 0, constants, 0, kind=kind, is_resident=is_resident)
            most = kernels.RESIDENT_THREADS if is_resident else kernels.STREAMING_THREADS
            overloads = family[kind].overloads
            overload = next(iter(overloads.values()), None) or overloads[()]
            launch = plan_launch(node_count, *_fitting(overload.max_cooperative_grid_blocks, most))
            if launch.sweep_count == 1 or not is_resident:
                return launch, is_resident
        raise SimulationError(f"the device has no room to keep {node_count} nodes in registers: leave resident out")

    def _constants_of(self, verlet: Verlet) -> Any:
        if verlet not in self._constants:
            self._constants = {verlet: self._cuda.to_device(np.array(verlet.numbers, np.float32))}
        return self._constants[verlet]

    def _on_device(self, nodes: Intp) -> Any:
        """Numbers of nodes on the device, kept for the next time: a hand asks for the same every frame."""
        key = nodes.tobytes()
        if key not in self._nodes_seen:
            if len(self._nodes_seen) == NODE_SETS_KEPT:
                del self._nodes_seen[next(iter(self._nodes_seen))]
            self._nodes_seen[key] = self._cuda.to_device(np.asarray(nodes, np.uint32))
        return self._nodes_seen[key]

    def _on_device_probes(self, probes: Float32) -> Any:
        """Probes on the device, in the same memory as long as there are as many."""
        if self._probes.shape != probes.shape:
            self._probes = self._cuda.to_device(probes)
        else:
            self._probes.copy_to_device(probes)
        return self._probes

    @cached_property
    def _by_node(self) -> Any:
        return self._cuda.device_array((self.model.node_count, 3), np.float32)

    @cached_property
    def _rest(self) -> Any:
        """Rest positions by node on the device, i, j, k and one unused [cells]."""
        rest = np.zeros((self.model.node_count, 4), np.float32)
        rest[:, :3] = self.model.node_index
        return self._cuda.to_device(rest.ravel())


def _fitting(blocks_at_once: Callable[[int], int], thread_count: int) -> tuple[int, int]:
    """Blocks that the device runs at once and their threads: at most so many, fewer where its registers are fewer.

    Raises
    ------
    SimulationError
        Not one block of the fewest threads fits.
    """
    while thread_count >= WARP:
        block_count = blocks_at_once(thread_count)
        if block_count:
            return block_count, thread_count
        thread_count = thread_count // 2 // WARP * WARP
    raise SimulationError("the device cannot run the kernels: choose the backend 'cpu'", place="backend")


def _cuda() -> Any:
    """Numba's CUDA target, where it works.

    Raises
    ------
    SimulationError
        It does not.
    """
    remedy = (
        "choose the backend 'cpu', or take a machine with an NVIDIA GPU and its driver and the extra [cuda]: "
        + how_to_install("cuda")
    )
    try:
        from numba import cuda
    except (ImportError, OSError, RuntimeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise SimulationError(f"numba cannot load CUDA ({reason}): {remedy}", place="backend") from None
    if not cuda.is_available():
        raise SimulationError(f"there is no CUDA device: {remedy}", place="backend")
    if not numba.config.ENABLE_CUDASIM:
        _check_library()
        # The first launch of a kernel compiles it, with one block of threads, and a hand moves few nodes.
        _cuda_config().CUDA_LOW_OCCUPANCY_WARNINGS = 0
    return cuda


def _check_library() -> None:
    """Refuse a NumPy that numba's CUDA target does not know, which it says only when it compiles.

    Raises
    ------
    SimulationError
        It does not know this one.
    """
    try:
        importlib.import_module("numba.cuda.cudaimpl")
    except AttributeError as error:
        raise SimulationError(
            f"numba-cuda does not know NumPy {np.__version__} ({error}): {how_to_install('cuda')}",
            place="backend",
        ) from None


def _cuda_config() -> Any:
    """Settings of numba's CUDA target, which has its own in newer versions."""
    try:
        return importlib.import_module("numba.cuda.core.config")
    except ImportError:
        return numba.config
