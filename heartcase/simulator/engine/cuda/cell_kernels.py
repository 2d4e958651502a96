"""The CUDA kernels for what acts in cells: elements, the volume term, corners that push back.

In a step every cell first writes its forces on its corners; all threads wait for one another; then every node gathers
those of the cells around it, adds its springs and moves; all threads wait again. Each sum is taken in one order, so
that the result does not depend on how cells and nodes are shared among threads. Where tissue is strained by the mean
around nodes, two more rounds go before: cells write their gradients, then nodes the stress of the mean of those around.

Arrays are ordered by number first, then cell or node, so that neighbouring threads read neighbouring words.
"""

from __future__ import annotations

import numpy as np
from numba import cuda

from heartcase.simulator.engine.cuda.flat_corners import any_corner_is_flat, corners_of
from heartcase.simulator.engine.cuda.flat_corners import cell_functions as _math
from heartcase.simulator.engine.cuda.intrinsics import load_four, store_four, wait_at_grid_barrier
from heartcase.simulator.engine.cuda.step_kernels import (
    force_of_springs,
    next_velocity,
    pull_by_tethers,
    pull_explicitly,
    rows_of,
    start_meeting,
    weights_of,
)
from heartcase.simulator.engine.cuda.turn_kernels import push_out, shorten, watch_cell
from heartcase.simulator.forces.cell_math import NOTHING_SHARED
from heartcase.simulator.lattice.moduli import LOOK_BELOW

__all__ = [
    "CELL_THREADS",
    "NO_CELL",
    "add_cell_forces",
    "advance_with_cells",
    "share_strain",
    "stretch_cells",
    "work_cells",
]

CELL_THREADS = 256
"""Most threads of a block: an element takes many registers."""
NO_CELL = 0xFFFFFFFF
"""Number of the cell where a node has none."""

_U = np.uint32
_O = np.float32(0.0)
_LOOK = np.float32(LOOK_BELOW)
_NO_CELL = _U(NO_CELL)
_NOTHING = NOTHING_SHARED


_gradient, _stretching, _element = _math.gradient, _math.stretching, _math.element
_volume_term, _corner_guard, _corner_lack = _math.volume_term, _math.corner_guard, _math.corner_lack


@cuda.jit(device=True)
def _store(cell_force, axis, cell, count, f, adds):
    for corner in range(8):
        place = _U((3 * corner + axis) * count + cell)
        cell_force[place] = cell_force[place] + f[corner] if adds else f[corner]


@cuda.jit(device=True)
def _moments(numbers, cell, count):
    return (
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


@cuda.jit(device=True)
def _add_nine(total, array, place, count, weight):
    """Three columns, and a weight times those whose nine numbers lie so many apart from a place on."""
    x, y, z = total
    return (
        (
            x[0] + weight * array[place],
            x[1] + weight * array[_U(place + count)],
            x[2] + weight * array[_U(place + 2 * count)],
        ),
        (
            y[0] + weight * array[_U(place + 3 * count)],
            y[1] + weight * array[_U(place + 4 * count)],
            y[2] + weight * array[_U(place + 5 * count)],
        ),
        (
            z[0] + weight * array[_U(place + 6 * count)],
            z[1] + weight * array[_U(place + 7 * count)],
            z[2] + weight * array[_U(place + 8 * count)],
        ),
    )


@cuda.jit(device=True)
def _store_nine(array, place, count, columns):
    for column in range(3):
        for axis in range(3):
            array[_U(place + (3 * column + axis) * count)] = columns[column][axis]


@cuda.jit(device=True)
def _stretch_cell(displacement, buffer, corner_lane, numbers, gradient, cell):
    """Write F - 1 of one cell."""
    count = _U(corner_lane.shape[0] // 8)
    u = corners_of(displacement, buffer, corner_lane, cell, count)
    _store_nine(gradient, cell, count, _gradient(u, _moments(numbers, cell, count)))


@cuda.jit(device=True)
def _share_strain(gradient, shares, inverse_shared, stress, law, node_cell, node):
    """Write the stress, per stiffness, of the mean gradient around one node."""
    node_count = _U(inverse_shared.shape[0])
    count = _U(gradient.shape[0] // 9)
    total = _NOTHING
    for corner in range(8):
        cell = node_cell[_U(corner * node_count + node)]
        if cell != _NO_CELL:
            total = _add_nine(total, gradient, cell, count, shares[_U(corner * count + cell)])
    for slot in range(8, node_cell.shape[0] // node_count):
        use = node_cell[_U(slot * node_count + node)]
        if use != _NO_CELL:
            cell = _U(use // 8)
            total = _add_nine(total, gradient, cell, count, shares[_U(use % 8 * count + cell)])
    inverse = inverse_shared[node]
    x, y, z = total
    mean = (
        (x[0] * inverse, x[1] * inverse, x[2] * inverse),
        (y[0] * inverse, y[1] * inverse, y[2] * inverse),
        (z[0] * inverse, z[1] * inverse, z[2] * inverse),
    )
    _store_nine(stress, node, node_count, _stretching(mean, (law[0], law[1], law[2], law[3], law[4])))


@cuda.jit(device=True)
def _work_cell(
    displacement, buffer, corner_lane, numbers, sharing, cell_force, law, cell, has_elements, has_guard, has_sharing
):
    """Write the forces of one cell on its corners; whether one of these is below LOOK_BELOW."""
    count = _U(corner_lane.shape[0] // 8)
    u = corners_of(displacement, buffer, corner_lane, cell, count)
    scale = numbers[cell]
    if has_elements:
        own, shared = scale, _NOTHING
        if has_sharing:
            corner_node, shares, inverse_shared, _, stress = sharing
            node_count = _U(inverse_shared.shape[0])
            own = shares[_U(8 * count + cell)]
            for corner in range(8):
                place = _U(corner * count + cell)
                shared = _add_nine(shared, stress, corner_node[place], node_count, shares[place])
        moments = _moments(numbers, cell, count)
        fx, fy, fz = _element(u, scale, own, moments, (law[0], law[1], law[2], law[3], law[4]), shared)
    else:
        fx, fy, fz = _volume_term(u, scale, law[0])
    _store(cell_force, 0, cell, count, fx, False)
    _store(cell_force, 1, cell, count, fy, False)
    _store(cell_force, 2, cell, count, fz, False)
    if has_guard and _corner_lack(u, _LOOK) > _O:
        fx, fy, fz = _corner_guard(u, numbers[_U(10 * count + cell)], law[5])
        _store(cell_force, 0, cell, count, fx, True)
        _store(cell_force, 1, cell, count, fy, True)
        _store(cell_force, 2, cell, count, fz, True)
        return scale > _O
    return False


@cuda.jit(device=True)
def _add_cell(f, cell_force, corner, cell, cell_count):
    place = _U(3 * corner * cell_count + cell)
    return (
        f[0] + cell_force[place],
        f[1] + cell_force[_U(place + cell_count)],
        f[2] + cell_force[_U(place + 2 * cell_count)],
    )


@cuda.jit(device=True)
def _add_cells(f, cell_force, node_cell, node, node_count, cell_count):
    """The force so far plus those of the cells around a node."""
    for corner in range(8):
        cell = node_cell[_U(corner * node_count + node)]
        if cell != _NO_CELL:
            f = _add_cell(f, cell_force, corner, cell, cell_count)
    for slot in range(8, node_cell.shape[0] // node_count):
        use = node_cell[_U(slot * node_count + node)]
        if use != _NO_CELL:
            f = _add_cell(f, cell_force, use % 8, use // 8, cell_count)
    return f


@cuda.jit
def advance_with_cells(
    displacement,
    velocity,
    spring_weight,
    window_rows,
    node_slot,
    lane_count,
    corner_lane,
    numbers,
    cell_force,
    law,
    node_cell,
    corner_node,
    shares,
    inverse_shared,
    gradient,
    stress,
    has_elements,
    has_guard,
    has_sharing,
    current,
    step_count,
    constants,
    arrivals,
    explicit_first,
    explicit_lane,
    explicit_offset,
    explicit_stiffness,
    tethers,
    row_step,
    rest,
    probes,
    turn,
    look_steps,
    taken,
):
    """Take steps in place; see :mod:`heartcase.simulator.engine.cuda.step_kernels` for what is not said here.

    Parameters
    ----------
    corner_lane
        Lane of each cell's corners, corner by corner, uint32, shape (8 * cell_count,).
    numbers
        Numbers of the cells (:func:`heartcase.simulator.engine.shared.cell_lanes.cell_numbers`), float32, shape (11 *
        cell_count,).
    cell_force
        Room for the forces on the corners, float32, shape (24 * cell_count,).
    law
        Constants of the law, float32, shape (6,): the element's, or the volume term's modulus; last the corners' floor.
    node_cell
        Cell that has a node for its corner, corner by corner, then further ones as eight times the cell and the corner,
        or NO_CELL, uint32, shape (any * node_count,); at least eight rows.
    corner_node
        Node of each cell's corners, corner by corner, uint32, shape (8 * cell_count,).
    shares
        Stiffness of each cell that is strained by its corners' means, and by itself
        (:func:`heartcase.simulator.engine.shared.lanes.share_numbers`), float32, shape (9 * cell_count,).
    inverse_shared
        Inverse of the stiffness that shares strain around each node, float32, shape (node_count,).
    gradient, stress
        Room for the gradient of each cell and the stress of each node's mean, float32, (9 * cell_count,) and
        (9 * node_count,).
    has_elements, has_guard, has_sharing
        Whether cells are elements, whether their corners push back, and whether elements share strain.
    step_count
        Steps to take; times seven times the number of blocks of threads at most 2**32 - 1.
    tethers, row_step
        As of :func:`heartcase.simulator.engine.cuda.step_kernels.pull_by_tethers`, and steps taken before in this row.
    rest
        Rest positions, i, j, k and one unused, float32, shape (4 * node_count,); read where there are probes.
    probes
        Probes as of :func:`heartcase.simulator.engine.shared.contact.probe_row`, float32, shape (probe_count,
        PROBE_SIZE).
    turn
        As of :mod:`heartcase.simulator.engine.cuda.turn_kernels`.
    look_steps
        Steps between two looks for flat corners, the first before the first step, which end the launch where there are
        none any more; 0 for no looks.
    """
    if cuda.grid(1) == 0:
        for flag in range(4):
            turn[3][flag] = 0
    start_meeting(arrivals)
    step, keep, kick, limit = constants[0], constants[1], constants[2], constants[6]
    gravity = (constants[3], constants[4], constants[5])
    count = _U(lane_count)
    node_count, cell_count = _U(node_slot.shape[0]), _U(corner_lane.shape[0] // 8)
    now, later = _U(current * count), _U((1 - current) * count)
    expected = _U(0)
    sharing = (corner_node, shares, inverse_shared, gradient, stress)
    done = step_count
    for step_number in range(step_count):
        if look_steps > 0 and step_number % look_steps == 0:
            look = _U(step_number // look_steps + 1)
            expected = _U(expected + cuda.gridDim.x)
            if not any_corner_is_flat(displacement, now, corner_lane, numbers, arrivals, expected, look):
                done = step_number
                break
        if has_sharing:
            for cell in range(cuda.grid(1), cell_count, cuda.gridsize(1)):
                _stretch_cell(displacement, now, corner_lane, numbers, gradient, _U(cell))
            expected = _U(expected + cuda.gridDim.x)
            wait_at_grid_barrier(arrivals, expected)
            for node in range(cuda.grid(1), node_count, cuda.gridsize(1)):
                _share_strain(gradient, shares, inverse_shared, stress, law, node_cell, _U(node))
            expected = _U(expected + cuda.gridDim.x)
            wait_at_grid_barrier(arrivals, expected)
        for cell in range(cuda.grid(1), cell_count, cuda.gridsize(1)):
            number = _U(cell)
            kinds = (has_elements, has_guard, has_sharing)
            _work_cell(displacement, now, corner_lane, numbers, sharing, cell_force, law, number, *kinds)
        expected = _U(expected + cuda.gridDim.x)
        wait_at_grid_barrier(arrivals, expected)
        watches = probes.shape[0] > 0
        if watches and cuda.grid(1) == 0:
            turn[3][3 - step_number % 2] = 0
        for node in range(cuda.grid(1), node_count, cuda.gridsize(1)):
            row = rows_of(window_rows, node_slot[node])
            lane = row[4]
            own = load_four(displacement, _U(now + lane))
            f = force_of_springs(displacement, now, own, row, weights_of(spring_weight, count, row))
            f = _add_cells(f, cell_force, node_cell, node, node_count, cell_count)
            if tethers[3].shape[0] > 0:
                f = pull_by_tethers(f, displacement, now, node, row_step + step_number, tethers)
            begin, end = explicit_first[node], explicit_first[node + 1]
            f = pull_explicitly(
                f, displacement, now, own, begin, end, explicit_lane, explicit_offset, explicit_stiffness
            )
            v = next_velocity(load_four(velocity, lane), f, keep, kick, gravity, limit)
            u = (own[0] + step * v[0], own[1] + step * v[1], own[2] + step * v[2], _O)
            if watches:
                place = load_four(rest, _U(node))
                u, v = push_out(own, u, v, place, probes, step_number, step, turn, node, node_count)
            store_four(velocity, lane, v[0], v[1], v[2], v[3])
            store_four(displacement, _U(later + lane), u[0], u[1], u[2], _O)
        if watches:
            expected = _U(expected + cuda.gridDim.x)
            wait_at_grid_barrier(arrivals, expected)
            volume_most = _LOOK if has_guard else _O
            for cell in range(cuda.grid(1), cell_count, cuda.gridsize(1)):
                where = (displacement, now, later, velocity, corner_lane, corner_node)
                watch_cell(*where, numbers[_U(cell)], volume_most, turn, step_number, _U(cell))
            expected = _U(expected + cuda.gridDim.x)
            wait_at_grid_barrier(arrivals, expected)
            for node in range(cuda.grid(1), node_count, cuda.gridsize(1)):
                lane = rows_of(window_rows, node_slot[node])[4]
                where = (displacement, now, later, velocity, lane, rest)
                shorten(*where, probes, step_number, turn, node_cell, _U(node), _NO_CELL)
        now, later = later, now
        expected = _U(expected + cuda.gridDim.x)
        wait_at_grid_barrier(arrivals, expected)
    if cuda.grid(1) == 0:
        taken[0] = done


@cuda.jit
def stretch_cells(displacement, first, corner_lane, numbers, gradient):
    """Write the gradients of all cells, for displacements from vector ``first`` on."""
    cell = cuda.grid(1)
    if cell < corner_lane.shape[0] // 8:
        _stretch_cell(displacement, _U(first), corner_lane, numbers, gradient, _U(cell))


@cuda.jit
def share_strain(gradient, shares, inverse_shared, stress, law, node_cell):
    """Write the stress of the mean gradient around all nodes."""
    node = cuda.grid(1)
    if node < inverse_shared.shape[0]:
        _share_strain(gradient, shares, inverse_shared, stress, law, node_cell, _U(node))


@cuda.jit
def work_cells(
    displacement,
    first,
    corner_lane,
    numbers,
    cell_force,
    law,
    corner_node,
    shares,
    inverse_shared,
    gradient,
    stress,
    has_elements,
    has_guard,
    has_sharing,
):
    """Write the forces of all cells, for displacements from vector ``first`` on."""
    cell = cuda.grid(1)
    if cell < corner_lane.shape[0] // 8:
        number, buffer = _U(cell), _U(first)
        sharing = (corner_node, shares, inverse_shared, gradient, stress)
        kinds = (has_elements, has_guard, has_sharing)
        _work_cell(displacement, buffer, corner_lane, numbers, sharing, cell_force, law, number, *kinds)


@cuda.jit
def add_cell_forces(cell_force, node_cell, node_count, cell_count, nodes, force):
    """Add the forces of the cells around some nodes to those that are there, shape (at least len(nodes), 3)."""
    number = cuda.grid(1)
    if number < nodes.shape[0]:
        f = (force[number, 0], force[number, 1], force[number, 2])
        f = _add_cells(f, cell_force, node_cell, nodes[number], _U(node_count), _U(cell_count))
        force[number, 0], force[number, 1], force[number, 2] = f[0], f[1], f[2]
