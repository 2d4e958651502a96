"""The CUDA kernels for what acts in cells: elements, the volume term, corners that push back.

In a step every cell first writes its forces on its corners; all threads meet; then every node gathers those of the
cells around it, adds its springs and moves; all threads meet again. Each sum is taken in one order, so that the result
does not depend on how cells and nodes are shared among threads.

Arrays are ordered by number first, then cell or node, so that neighbouring threads read neighbouring words.
"""

from __future__ import annotations

import numpy as np
from numba import cuda

from heartcase.simulator.cell_forces import CORNER_FLOOR
from heartcase.simulator.cell_math import make_cell_math
from heartcase.simulator.intrinsics_cuda import load_four, meet, store_four
from heartcase.simulator.kernel_cuda import (
    force_of_springs,
    keep_outside,
    next_velocity,
    pull_explicitly,
    rows_of,
    start_meeting,
    weights_of,
)

__all__ = ["CELL_THREADS", "NO_CELL", "add_cell_forces", "advance_with_cells", "look_at_cells", "work_cells"]

CELL_THREADS = 256
"""Most threads of a block: an element takes many registers."""
NO_CELL = 0xFFFFFFFF
"""Number of the cell where a node has none."""

_U = np.uint32
_O = np.float32(0.0)
_FLOOR = np.float32(CORNER_FLOOR)
_NO_CELL = _U(NO_CELL)


@cuda.jit(device=True)
def _positive_part(value):
    return value if value > _O else _O


_element, _volume_term, _corner_guard, _corner_lack = make_cell_math(cuda.jit(device=True), _positive_part)


@cuda.jit(device=True)
def _corner(displacement, buffer, corner_lane, place):
    u = load_four(displacement, _U(buffer + corner_lane[place]))
    return u[0], u[1], u[2]


@cuda.jit(device=True)
def _corners(displacement, buffer, corner_lane, cell, count):
    return (
        _corner(displacement, buffer, corner_lane, _U(cell)),
        _corner(displacement, buffer, corner_lane, _U(count + cell)),
        _corner(displacement, buffer, corner_lane, _U(2 * count + cell)),
        _corner(displacement, buffer, corner_lane, _U(3 * count + cell)),
        _corner(displacement, buffer, corner_lane, _U(4 * count + cell)),
        _corner(displacement, buffer, corner_lane, _U(5 * count + cell)),
        _corner(displacement, buffer, corner_lane, _U(6 * count + cell)),
        _corner(displacement, buffer, corner_lane, _U(7 * count + cell)),
    )


@cuda.jit(device=True)
def _store(cell_force, axis, cell, count, f, adds):
    for corner in range(8):
        place = _U((3 * corner + axis) * count + cell)
        cell_force[place] = cell_force[place] + f[corner] if adds else f[corner]


@cuda.jit(device=True)
def _work_cell(displacement, buffer, corner_lane, numbers, cell_force, law, cell, has_elements, has_guard):
    """Write the forces of one cell on its corners."""
    count = _U(corner_lane.shape[0] // 8)
    u = _corners(displacement, buffer, corner_lane, cell, count)
    scale = numbers[cell]
    if has_elements:
        moments = (
            numbers[_U(count + cell)],
            numbers[_U(2 * count + cell)],
            numbers[_U(3 * count + cell)],
            numbers[_U(4 * count + cell)],
            numbers[_U(5 * count + cell)],
            numbers[_U(6 * count + cell)],
            numbers[_U(7 * count + cell)],
            numbers[_U(8 * count + cell)],
            numbers[_U(9 * count + cell)],
        )
        fx, fy, fz = _element(u, scale, moments, (law[0], law[1], law[2], law[3], law[4]))
    else:
        fx, fy, fz = _volume_term(u, scale, law[0])
    _store(cell_force, 0, cell, count, fx, False)
    _store(cell_force, 1, cell, count, fy, False)
    _store(cell_force, 2, cell, count, fz, False)
    if has_guard and _corner_lack(u, _FLOOR) > _O:
        fx, fy, fz = _corner_guard(u, numbers[_U(count + cell)])
        _store(cell_force, 0, cell, count, fx, True)
        _store(cell_force, 1, cell, count, fy, True)
        _store(cell_force, 2, cell, count, fz, True)


@cuda.jit(device=True)
def _add_cells(f, cell_force, node_cell, node, node_count, cell_count):
    """The force so far plus those of the cells around a node."""
    for corner in range(8):
        cell = node_cell[_U(corner * node_count + node)]
        if cell != _NO_CELL:
            place = _U(3 * corner * cell_count + cell)
            f = (
                f[0] + cell_force[place],
                f[1] + cell_force[_U(place + cell_count)],
                f[2] + cell_force[_U(place + 2 * cell_count)],
            )
    return f


@cuda.jit
def advance_with_cells(
    displacement,
    velocity,
    spring_weight,
    presence,
    window_rows,
    node_slot,
    lane_count,
    corner_lane,
    numbers,
    cell_force,
    law,
    node_cell,
    has_elements,
    has_guard,
    current,
    step_count,
    constants,
    arrivals,
    explicit_first,
    explicit_lane,
    explicit_offset,
    explicit_stiffness,
    rest,
    probes,
):
    """Take steps in place; see :mod:`heartcase.simulator.kernel_cuda` for what is not said here.

    Parameters
    ----------
    presence
        Above zero where there is a spring, whether it acts or not, float32, shape (9 * lane_count,).
    corner_lane
        Lane of each cell's corners, corner by corner, uint32, shape (8 * cell_count,).
    numbers
        Numbers of the cells (:func:`heartcase.simulator.lanes.cell_numbers`), float32, shape (10 * cell_count,).
    cell_force
        Room for the forces on the corners, float32, shape (24 * cell_count,).
    law
        Constants of the law, float32, shape (5,): the element's, or the volume term's modulus.
    node_cell
        Cell that has a node for its corner, corner by corner, or NO_CELL, uint32, shape (8 * node_count,).
    has_elements, has_guard
        Whether cells are elements, and whether their corners push back.
    step_count
        Steps to take; times twice the number of blocks of threads at most 2**32 - 1.
    """
    start_meeting(arrivals)
    step, keep, kick, limit = constants[0], constants[1], constants[2], constants[6]
    gravity = (constants[3], constants[4], constants[5])
    count = _U(lane_count)
    node_count, cell_count = _U(node_slot.shape[0]), _U(corner_lane.shape[0] // 8)
    now, later = _U(current * count), _U((1 - current) * count)
    expected = _U(0)
    for step_number in range(step_count):
        for cell in range(cuda.grid(1), cell_count, cuda.gridsize(1)):
            _work_cell(displacement, now, corner_lane, numbers, cell_force, law, _U(cell), has_elements, has_guard)
        expected = _U(expected + cuda.gridDim.x)
        meet(arrivals, expected)
        for node in range(cuda.grid(1), node_count, cuda.gridsize(1)):
            row = rows_of(window_rows, node_slot[node])
            lane = row[4]
            own = load_four(displacement, _U(now + lane))
            f = force_of_springs(displacement, now, own, row, weights_of(spring_weight, count, row))
            f = _add_cells(f, cell_force, node_cell, node, node_count, cell_count)
            begin, end = explicit_first[node], explicit_first[node + 1]
            f = pull_explicitly(
                f, displacement, now, own, begin, end, explicit_lane, explicit_offset, explicit_stiffness
            )
            v = next_velocity(load_four(velocity, lane), f, keep, kick, gravity, limit)
            u = (own[0] + step * v[0], own[1] + step * v[1], own[2] + step * v[2], _O)
            if probes.shape[0] > 0:
                place = load_four(rest, _U(node))
                beside = weights_of(presence, count, row)
                u, v = keep_outside(displacement, now, own, u, v, place, row, beside, probes, step_number, step)
            store_four(velocity, lane, v[0], v[1], v[2], v[3])
            store_four(displacement, _U(later + lane), u[0], u[1], u[2], _O)
        now, later = later, now
        expected = _U(expected + cuda.gridDim.x)
        meet(arrivals, expected)


@cuda.jit
def work_cells(displacement, first, corner_lane, numbers, cell_force, law, has_elements, has_guard):
    """Write the forces of all cells, for displacements from vector ``first`` on."""
    cell = cuda.grid(1)
    if cell < corner_lane.shape[0] // 8:
        _work_cell(displacement, _U(first), corner_lane, numbers, cell_force, law, _U(cell), has_elements, has_guard)


@cuda.jit
def add_cell_forces(cell_force, node_cell, cell_count, nodes, force):
    """Add the forces of the cells around some nodes to those that are there, shape (at least len(nodes), 3)."""
    number = cuda.grid(1)
    if number < nodes.shape[0]:
        f = (force[number, 0], force[number, 1], force[number, 2])
        node_count = _U(node_cell.shape[0] // 8)
        f = _add_cells(f, cell_force, node_cell, nodes[number], node_count, _U(cell_count))
        force[number, 0], force[number, 1], force[number, 2] = f[0], f[1], f[2]


@cuda.jit
def look_at_cells(displacement, first, corner_lane, numbers, volume, is_flat):
    """Set a flag, shape (1,), where a corner of a cell has less than a volume."""
    cell = cuda.grid(1)
    count = _U(corner_lane.shape[0] // 8)
    if cell < count:
        u = _corners(displacement, _U(first), corner_lane, _U(cell), count)
        if _corner_lack(u, volume) * numbers[cell] > _O:
            is_flat[0] = 1
