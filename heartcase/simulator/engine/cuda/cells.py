"""The cells of a model on a CUDA device: what the engine needs where more than springs acts."""

from __future__ import annotations

from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float64, UInt32
from heartcase.simulator.engine.shared.cell_lanes import cell_numbers, inverse_shared, share_numbers
from heartcase.simulator.engine.shared.lanes import SHARE_NUMBERS, LaneLayout
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import LOOK_STEPS

__all__ = ["CellsOnDevice", "plain_launch"]

PLAIN_THREADS = 128
"""Threads of a block in the kernels without a grid-wide barrier."""


def plain_launch(count: int) -> tuple[int, int]:
    """Blocks and threads of each, so that there is a thread for each of so many."""
    return -(-count // PLAIN_THREADS), PLAIN_THREADS


class CellsOnDevice:
    """Arrays of the cells, and the kernels that work them out."""

    def __init__(self, cuda: Any, model: LatticeModel, layout: LaneLayout) -> None:
        from heartcase.simulator.engine.cuda import cell_kernels as kernel_cuda_cells
        from heartcase.simulator.engine.cuda import turn_kernels

        self.kernels, self._turn_kernels = kernel_cuda_cells, turn_kernels
        self._cuda = cuda
        self._layout = layout
        self._count = model.cell_count
        self._node_count = model.node_count
        corners = model.cell_corners.T
        self._corner_lane = cuda.to_device(layout.node_lane[corners].astype(np.uint32).ravel())
        self._node_cell = cuda.to_device(_cells_of_nodes(model, kernel_cuda_cells.NO_CELL).ravel())
        self._corner_node = cuda.to_device(corners.astype(np.uint32).ravel())
        self._force = cuda.to_device(np.zeros(24 * self._count, np.float32))
        self._gradient = self._stress = cuda.to_device(np.zeros(1, np.float32))
        counts = (model.node_count, self._count)
        near, watched, flags = (cuda.to_device(np.zeros(count, np.int32)) for count in (*counts, 4))
        self._turn = near, watched, cuda.to_device(np.ones(8 * self._count, np.float32)), flags
        self._given = cuda.to_device(np.zeros(0, np.float32))
        self.set_model(model)

    def set_model(self, model: LatticeModel) -> None:
        """Go on with the springs, cuts and law of another model of the same nodes."""
        law = model.law
        self._has_elements, self._has_guard = law.is_element, law.has_corner_guard
        self._always = law.acts_in_cells
        self._numbers = self._cuda.to_device(cell_numbers(model).ravel())
        self._has_sharing = model.shares_strain
        if self._has_sharing and len(self._stress) == 1:
            counts = (self._count, model.node_count)
            room = [self._cuda.to_device(np.zeros(SHARE_NUMBERS * count, np.float32)) for count in counts]
            self._gradient, self._stress = room
        self._shares = self._cuda.to_device(share_numbers(model).ravel())
        self._inverse_shared = self._cuda.to_device(inverse_shared(model))
        self._law = self._cuda.to_device(np.array(law.constants, np.float32))

    @property
    def always_act(self) -> bool:
        """Whether cells have to be worked out in every state."""
        return self._always

    @property
    def look_steps(self) -> int:
        """Steps between two looks for states in which cells have to be worked out, 0 for none."""
        return LOOK_STEPS if self._has_guard and not self._always else 0

    @property
    def may_act(self) -> bool:
        """Whether there is a state in which cells have to be worked out."""
        return self._always or self._has_guard

    @property
    def looked_at(self) -> tuple[Any, Any]:
        """What a look reads: ``corner_lane`` and ``numbers``."""
        return self._corner_lane, self._numbers

    def arguments(self) -> tuple[Any, ...]:
        """What ``advance_with_cells`` wants of the cells, from ``corner_lane`` to ``has_sharing``."""
        arrays = (self._corner_lane, self._numbers, self._force, self._law, self._node_cell)
        return (*arrays, *self._sharing)

    @property
    def _sharing(self) -> tuple[Any, ...]:
        """What kernels want from ``corner_node`` to ``has_sharing``."""
        arrays = (self._corner_node, self._shares, self._inverse_shared, self._gradient, self._stress)
        return (*arrays, self._has_elements, self._has_guard, self._has_sharing)

    def turn(self, probe_count: int) -> tuple[Any, ...]:
        """Room for what keeps corners from turning; what the probes gave is in the last, zero at first."""
        if len(self._given) != 6 * probe_count * self._node_count:
            self._given = self._cuda.to_device(np.zeros(6 * probe_count * self._node_count, np.float32))
        return (*self._turn, self._given)

    def clear_given(self, probe_count: int) -> None:
        """Forget what the probes gave."""
        given = self.turn(probe_count)[-1]
        if probe_count:
            self._turn_kernels.clear_given[plain_launch(len(given))](given)

    @property
    def probe_impulse(self) -> Float64:
        """What each probe gave, shape (probe_count, 6)."""
        given = self._given.copy_to_host().reshape(-1, 6, self._node_count)
        total: Float64 = given.sum(axis=2, dtype=np.float64)
        return total

    def add_forces(self, displacement: Any, first: int, nodes: Any, force: Any) -> None:
        """Add the forces of the cells to those on some nodes, shape (at least len(nodes), 3)."""
        if not self.may_act:
            return
        if self._has_sharing:
            stretch = self.kernels.stretch_cells[plain_launch(self._count)]
            stretch(displacement, first, self._corner_lane, self._numbers, self._gradient)
            share = self.kernels.share_strain[plain_launch(len(self._inverse_shared))]
            means = (self._gradient, self._shares, self._inverse_shared, self._stress)
            share(*means, self._law, self._node_cell)
        work = self.kernels.work_cells[plain_launch(self._count)]
        work(displacement, first, self._corner_lane, self._numbers, self._force, self._law, *self._sharing)
        add = self.kernels.add_cell_forces[plain_launch(len(nodes))]
        add(self._force, self._node_cell, self._node_count, self._count, nodes, force)


def _cells_of_nodes(model: LatticeModel, no_cell: int) -> UInt32:
    """Cell that has each node for its corner, corner by corner, then further ones: eight times the cell and the corner.

    A node of a lattice that was cut may be the same corner of several cells. Shape (8 or more, node_count).
    """
    nodes = model.cell_corners.astype(np.int64)
    cells, corners = np.indices(nodes.shape)
    order = np.lexsort((cells.ravel(), corners.ravel(), nodes.ravel()))
    node, corner, cell = nodes.ravel()[order], corners.ravel()[order], cells.ravel()[order]
    is_first = np.diff(8 * node + corner, prepend=-1) != 0
    more = np.flatnonzero(~is_first)
    place = np.arange(len(more)) - np.searchsorted(node[more], node[more])
    table = np.full((8 + int(place.max(initial=-1)) + 1, model.node_count), no_cell, np.uint32)
    table[corner[is_first], node[is_first]] = cell[is_first]
    table[8 + place, node[more]] = 8 * cell[more] + corner[more]
    return table
