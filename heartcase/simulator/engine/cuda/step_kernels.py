"""The CUDA kernels: a thread per node, many steps in one launch.

Nodes lie in the lanes of :mod:`heartcase.simulator.engine.shared.lanes`. The force is
:mod:`heartcase.simulator.engine.cpu.springs`'s, spring for spring in the same order. All threads wait for one another
after every step, so that one launch takes as many steps as the host wants. A step reads only the displacements of the
one before and writes only its own nodes: the result does not depend on how the nodes are shared among threads.

Two kernels take the same steps to the same bits. ``advance_resident`` gives each thread one node, whose springs,
mass and velocity stay in registers from the first step to the last: all that is read in a step are displacements.
``advance_streaming`` sweeps over any number of nodes, forth and back, and reads their constants in every step.

Vectors are stored by fours, so that a node's is read in one access: x, y, z of the displacement and one unused; x, y,
z of the velocity and the inverse mass.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numba import cuda

from heartcase.simulator.engine.cuda.flat_corners import any_corner_is_flat
from heartcase.simulator.engine.cuda.intrinsics import load_four, register_limit, store_four, wait_at_grid_barrier
from heartcase.simulator.engine.shared.lanes import LANE_COUNT
from heartcase.simulator.lattice.tethers import END_NODES

__all__ = [
    "RESIDENT_THREADS",
    "STREAMING_THREADS",
    "advance_resident",
    "advance_streaming",
    "force_of_springs",
    "next_velocity",
    "node_forces",
    "pull_by_tethers",
    "pull_explicitly",
    "rows_of",
    "start_meeting",
    "weights_of",
]

RESIDENT_THREADS = 512
"""Most threads of a block of ``advance_resident``; one block fits on a multiprocessor of 65,536 registers."""
STREAMING_THREADS = 640
"""Most threads of a block of ``advance_streaming``; one block fits."""

_U = np.uint32
_LANE_COUNT = _U(LANE_COUNT)
_ROW_COUNT = _U(9)
_TINY = np.float32(1e-30)
"""Keeps the division defined where two nodes lie on one spot."""
_M, _O, _P = np.float32(-1.0), np.float32(0.0), np.float32(1.0)
_ROW_OF_SHAPE, _NODES_OF_TETHER = _U(8), _U(2 * END_NODES)
_EDGE, _DIAGONAL = np.float32(1.0), np.float32(np.sqrt(2.0))


@cuda.jit(device=True, fastmath=True)
def _add_pull(total, own, displacement, place, offset, length, weight):
    """The force so far plus the pull of one spring; see :mod:`heartcase.simulator.engine.cpu.springs`."""
    other = load_four(displacement, _U(place))
    Dx, Dy, Dz = other[0] - own[0], other[1] - own[1], other[2] - own[2]
    dx, dy, dz = Dx + offset[0], Dy + offset[1], Dz + offset[2]
    e = (dx + offset[0]) * Dx + (dy + offset[1]) * Dy + (dz + offset[2]) * Dz
    d_squared = dx * dx + _TINY + dy * dy + dz * dz
    pull = weight * e / (d_squared + length * sqrt(d_squared))
    return total[0] + pull * dx, total[1] + pull * dy, total[2] + pull * dz


@cuda.jit(device=True, fastmath=True)
def force_of_springs(displacement, buffer, own, row, weight):
    """Sum of the pulls of a node's 18 springs.

    ``buffer`` is where the displacements begin, ``own`` the node's, ``row`` the lanes at its i in the nine ROWS,
    ``weight`` the stiffness of the springs along the nine DIRECTIONS, each before its opposite.
    """
    behind, here, ahead = buffer + row[3], buffer + row[4], buffer + row[5]
    below, above = buffer + row[1], buffer + row[7]
    f = (_O, _O, _O)
    f = _add_pull(f, own, displacement, here + 1, (_P, _O, _O), _EDGE, weight[0])
    f = _add_pull(f, own, displacement, here - 1, (_M, _O, _O), _EDGE, weight[1])
    f = _add_pull(f, own, displacement, ahead - 1, (_M, _P, _O), _DIAGONAL, weight[2])
    f = _add_pull(f, own, displacement, behind + 1, (_P, _M, _O), _DIAGONAL, weight[3])
    f = _add_pull(f, own, displacement, ahead, (_O, _P, _O), _EDGE, weight[4])
    f = _add_pull(f, own, displacement, behind, (_O, _M, _O), _EDGE, weight[5])
    f = _add_pull(f, own, displacement, ahead + 1, (_P, _P, _O), _DIAGONAL, weight[6])
    f = _add_pull(f, own, displacement, behind - 1, (_M, _M, _O), _DIAGONAL, weight[7])
    f = _add_pull(f, own, displacement, buffer + row[6], (_O, _M, _P), _DIAGONAL, weight[8])
    f = _add_pull(f, own, displacement, buffer + row[2], (_O, _P, _M), _DIAGONAL, weight[9])
    f = _add_pull(f, own, displacement, above - 1, (_M, _O, _P), _DIAGONAL, weight[10])
    f = _add_pull(f, own, displacement, below + 1, (_P, _O, _M), _DIAGONAL, weight[11])
    f = _add_pull(f, own, displacement, above, (_O, _O, _P), _EDGE, weight[12])
    f = _add_pull(f, own, displacement, below, (_O, _O, _M), _EDGE, weight[13])
    f = _add_pull(f, own, displacement, above + 1, (_P, _O, _P), _DIAGONAL, weight[14])
    f = _add_pull(f, own, displacement, below - 1, (_M, _O, _M), _DIAGONAL, weight[15])
    f = _add_pull(f, own, displacement, buffer + row[8], (_O, _P, _P), _DIAGONAL, weight[16])
    return _add_pull(f, own, displacement, buffer + row[0], (_O, _M, _M), _DIAGONAL, weight[17])


@cuda.jit(device=True)
def rows_of(window_rows, slot):
    """Lanes at a slot's i in the nine ROWS; number 4 is its own. A slot is a window's number times eight plus i."""
    first, i = _U(slot // _LANE_COUNT * _ROW_COUNT), _U(slot % _LANE_COUNT)
    return (
        _U(window_rows[first] + i),
        _U(window_rows[_U(first + 1)] + i),
        _U(window_rows[_U(first + 2)] + i),
        _U(window_rows[_U(first + 3)] + i),
        _U(window_rows[_U(first + 4)] + i),
        _U(window_rows[_U(first + 5)] + i),
        _U(window_rows[_U(first + 6)] + i),
        _U(window_rows[_U(first + 7)] + i),
        _U(window_rows[_U(first + 8)] + i),
    )


@cuda.jit(device=True)
def weights_of(spring_weight, lane_count, row):
    """Stiffness of a node's 18 springs; a spring's is stored at its lower node."""
    own = row[4]
    return (
        spring_weight[own],
        spring_weight[_U(own - 1)],
        spring_weight[_U(lane_count + own)],
        spring_weight[_U(lane_count + row[3] + 1)],
        spring_weight[_U(2 * lane_count + own)],
        spring_weight[_U(2 * lane_count + row[3])],
        spring_weight[_U(3 * lane_count + own)],
        spring_weight[_U(3 * lane_count + row[3] - 1)],
        spring_weight[_U(4 * lane_count + own)],
        spring_weight[_U(4 * lane_count + row[2])],
        spring_weight[_U(5 * lane_count + own)],
        spring_weight[_U(5 * lane_count + row[1] + 1)],
        spring_weight[_U(6 * lane_count + own)],
        spring_weight[_U(6 * lane_count + row[1])],
        spring_weight[_U(7 * lane_count + own)],
        spring_weight[_U(7 * lane_count + row[1] - 1)],
        spring_weight[_U(8 * lane_count + own)],
        spring_weight[_U(8 * lane_count + row[0])],
    )


@cuda.jit(device=True)
def _window_weights(spring_weight, uniform_weight, lane_count, slot, row):
    """:func:`_weights`, read only where the springs of the slot's window are not all alike."""
    alike = uniform_weight[_U(slot // _LANE_COUNT)]
    if alike > _O:
        return (
            alike, alike, alike, alike, alike, alike, alike, alike, alike,
            alike, alike, alike, alike, alike, alike, alike, alike, alike,
        )  # fmt: skip
    return weights_of(spring_weight, lane_count, row)


@cuda.jit(device=True)
def _within(value, limit):
    """A velocity within its limit; what is not a number stays, for the watchdog to see."""
    if value > limit:
        return limit
    return -limit if value < -limit else value


@cuda.jit(device=True, fastmath=True)
def next_velocity(v, force, keep, kick, gravity, limit):
    """See :mod:`heartcase.simulator.dynamics.integrate`; where the inverse mass ``v[3]`` is zero the velocity stays."""
    mass_inverse = v[3]
    if mass_inverse > _O:
        return (
            _within(keep * v[0] + kick * (force[0] * mass_inverse + gravity[0]), limit),
            _within(keep * v[1] + kick * (force[1] * mass_inverse + gravity[1]), limit),
            _within(keep * v[2] + kick * (force[2] * mass_inverse + gravity[2]), limit),
            mass_inverse,
        )
    return v


@cuda.jit(device=True)
def pull_explicitly(f, displacement, buffer, own, begin, end, explicit_lane, explicit_offset, explicit_stiffness):
    """The force so far plus the pulls of a node's explicit springs."""
    for spring in range(begin, end):
        other = load_four(displacement, _U(buffer + explicit_lane[spring]))
        offset = load_four(explicit_offset, _U(spring))
        wx, wy, wz = other[0] - own[0], other[1] - own[1], other[2] - own[2]
        dx, dy, dz = offset[0] + wx, offset[1] + wy, offset[2] + wz
        square = dx * dx + dy * dy + dz * dz
        if square > _O:
            e = (offset[0] + dx) * wx + (offset[1] + dy) * wy + (offset[2] + dz) * wz
            e = e + explicit_stiffness[_U(2 * spring + 1)]
            pull = explicit_stiffness[_U(2 * spring)] * e / (square + offset[3] * sqrt(square))
            f = (f[0] + pull * dx, f[1] + pull * dy, f[2] + pull * dz)
    return f


@cuda.jit(device=True)
def pull_by_tethers(f, displacement, buffer, node, row_step, tethers):
    """The force so far plus the pulls of a node's tethers, each worked out anew, in a step of a row.

    ``tethers``: where those of each node begin and the last end, uint32, shape (node_count + 1,); number of each,
    uint32, and the node's share in it, float32, shape (any,); lanes, uint32, and shares, float32, of the 16 nodes of
    each, shape (16 * count,); :meth:`heartcase.simulator.lattice.tethers.Tethers.shapes`, shape (8 * count,).
    """
    for at in range(tethers[0][node], tethers[0][node + 1]):
        tether = tethers[1][at]
        shape = _U(_ROW_OF_SHAPE * tether)
        x, y, z = tethers[5][shape], tethers[5][shape + _U(1)], tethers[5][shape + _U(2)]
        for place in range(_NODES_OF_TETHER):
            entry = _U(_NODES_OF_TETHER * tether + place)
            share = tethers[4][entry]
            other = load_four(displacement, _U(buffer + tethers[3][entry]))
            x, y, z = x + share * other[0], y + share * other[1], z + share * other[2]
        square = x * x + y * y + z * z
        if square > _O:
            distance = sqrt(square)
            passed = np.float32(row_step)
            stretch = distance - (tethers[5][shape + _U(4)] + passed * tethers[5][shape + _U(6)])
            if stretch > _O:
                most = tethers[5][shape + _U(5)] + passed * tethers[5][shape + _U(7)]
                pull = tethers[2][at] * (min(tethers[5][shape + _U(3)] * stretch, most) / distance)
                f = (f[0] - pull * x, f[1] - pull * y, f[2] - pull * z)
    return f


@cuda.jit(device=True)
def start_meeting(arrivals):
    """Set count and looks to zero; numba's own barrier makes it launch the grid only if all of it runs at once."""
    if cuda.grid(1) == 0:
        arrivals[0] = 0
        arrivals[1] = 0
    cuda.cg.this_grid().sync()


def _make_advance_resident(has_hands: bool, has_tethers: bool) -> Any:
    @cuda.jit(fastmath=True, **register_limit(128))
    def advance_resident(
        displacement,
        velocity,
        spring_weight,
        window_rows,
        node_slot,
        lane_count,
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
        corner_lane,
        numbers,
        look_steps,
        taken,
    ):
        """Take steps in place, with a thread for every node.

        Parameters
        ----------
        displacement
            Two buffers of lanes, x, y, z [cells] and one unused, float32, shape (2 * lane_count * 4,); the steps
            alternate between them.
        velocity
            x, y, z half a step before [cells / unit of time] and inverse mass [1 / full cell], 0 where motion is
            prescribed, float32, shape (lane_count * 4,).
        spring_weight
            Spring stiffness by direction [k], float32, shape (9 * lane_count,).
        window_rows
            Lane at each window's first i in its nine rows, uint32, shape (window_count * 9,).
        node_slot
            Number of each node's window times eight plus its place there, uint32, shape (node_count,).
        lane_count
            Number of lanes.
        current
            Buffer that holds the displacement now; the other after an odd number of steps.
        step_count
            Steps to take; twice of them times the number of blocks of threads at most 2**32 - 1.
        constants
            Step, keep, kick, the three components of gravity and the speed limit, grid units, float32, shape (7,).
        arrivals
            Room for the barrier's count and the looks, uint32, shape (2,).
        explicit_first
            Where the explicit springs of each node begin, and the last end, uint32, shape (node_count + 1,).
        explicit_lane, explicit_offset, explicit_stiffness
            Lane at the other end, uint32, shape (count,); offset to it with rest length, float32, shape (4 * count,);
            stiffness and excess by twos, float32, shape (2 * count,)
            (:class:`heartcase.simulator.lattice.explicit_springs.SpringsByNode`).
        tethers
            As of :func:`pull_by_tethers`.
        row_step
            Steps that were taken before in this row.
        corner_lane, numbers
            As of :func:`heartcase.simulator.engine.cuda.cell_kernels.advance_with_cells`.
        look_steps
            Steps between two looks for flat corners, the first before the first step, which end the launch where there
            are any; 0 for no looks.
        taken
            Written: steps that were taken, uint32, shape (1,).
        """
        start_meeting(arrivals)
        number = cuda.grid(1)
        is_used = number < node_slot.shape[0]
        slot = _U(0)
        if is_used:
            slot = node_slot[number]
        count = _U(lane_count)
        row = rows_of(window_rows, slot)
        lane = row[4]
        weight = weights_of(spring_weight, count, row)
        step, keep, kick, limit = constants[0], constants[1], constants[2], constants[6]
        gravity = (constants[3], constants[4], constants[5])
        now, later = _U(current * count), _U((1 - current) * count)
        u = load_four(displacement, _U(now + lane))
        v = load_four(velocity, lane)
        begin, end = _U(0), _U(0)
        if has_hands and is_used:
            begin, end = explicit_first[number], explicit_first[number + 1]
        expected = _U(0)
        done = step_count
        for step_number in range(step_count):
            if look_steps > 0 and step_number % look_steps == 0:
                look = _U(step_number // look_steps + 1)
                expected = _U(expected + cuda.gridDim.x)
                if any_corner_is_flat(displacement, now, corner_lane, numbers, arrivals, expected, look):
                    done = step_number
                    break
            if is_used:
                f = force_of_springs(displacement, now, u, row, weight)
                if has_tethers:
                    f = pull_by_tethers(f, displacement, now, number, row_step + step_number, tethers)
                if has_hands and begin < end:
                    f = pull_explicitly(
                        f, displacement, now, u, begin, end, explicit_lane, explicit_offset, explicit_stiffness
                    )
                v = next_velocity(v, f, keep, kick, gravity, limit)
                u = (u[0] + step * v[0], u[1] + step * v[1], u[2] + step * v[2], _O)
                store_four(displacement, _U(later + lane), u[0], u[1], u[2], _O)
            now, later = later, now
            expected = _U(expected + cuda.gridDim.x)
            wait_at_grid_barrier(arrivals, expected)
        if is_used:
            store_four(velocity, lane, v[0], v[1], v[2], v[3])
        if number == 0:
            taken[0] = done

    return advance_resident


def _make_advance_streaming(has_hands: bool, has_tethers: bool) -> Any:
    @cuda.jit(fastmath=True, **register_limit(96))
    def advance_streaming(
        displacement,
        velocity,
        spring_weight,
        uniform_weight,
        window_rows,
        node_slot,
        lane_count,
        sweep_count,
        share,
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
        corner_lane,
        numbers,
        look_steps,
        taken,
    ):
        """``advance_resident`` for any number of nodes.

        Parameters
        ----------
        uniform_weight
            Stiffness of all springs of a window's nodes where they are all alike, else 0 [k], float32, shape
            (window_count,).
        sweep_count, share
            A sweep is a stretch of ``share`` nodes, at most one per thread, for every block of threads; so many sweeps
            hold all nodes. Every other step takes them in the opposite order, while the last ones' memory is near.
        """
        start_meeting(arrivals)
        step, keep, kick, limit = constants[0], constants[1], constants[2], constants[6]
        gravity = (constants[3], constants[4], constants[5])
        count = _U(lane_count)
        now, later = _U(current * count), _U((1 - current) * count)
        expected = _U(0)
        done = step_count
        for step_number in range(step_count):
            if look_steps > 0 and step_number % look_steps == 0:
                look = _U(step_number // look_steps + 1)
                expected = _U(expected + cuda.gridDim.x)
                if any_corner_is_flat(displacement, now, corner_lane, numbers, arrivals, expected, look):
                    done = step_number
                    break
            for sweep in range(sweep_count):
                turn = sweep if step_number % 2 == 0 else sweep_count - 1 - sweep
                number = (turn * cuda.gridDim.x + cuda.blockIdx.x) * share + cuda.threadIdx.x
                if cuda.threadIdx.x < share and number < node_slot.shape[0]:
                    slot = node_slot[number]
                    row = rows_of(window_rows, slot)
                    lane = row[4]
                    weight = _window_weights(spring_weight, uniform_weight, count, slot, row)
                    own = load_four(displacement, _U(now + lane))
                    f = force_of_springs(displacement, now, own, row, weight)
                    if has_tethers:
                        f = pull_by_tethers(f, displacement, now, number, row_step + step_number, tethers)
                    if has_hands:
                        begin, end = explicit_first[number], explicit_first[number + 1]
                        f = pull_explicitly(
                            f, displacement, now, own, begin, end, explicit_lane, explicit_offset, explicit_stiffness
                        )
                    v = next_velocity(load_four(velocity, lane), f, keep, kick, gravity, limit)
                    u = (own[0] + step * v[0], own[1] + step * v[1], own[2] + step * v[2], _O)
                    store_four(velocity, lane, v[0], v[1], v[2], v[3])
                    store_four(displacement, _U(later + lane), u[0], u[1], u[2], _O)
            now, later = later, now
            expected = _U(expected + cuda.gridDim.x)
            wait_at_grid_barrier(arrivals, expected)
        if cuda.grid(1) == 0:
            taken[0] = done

    return advance_streaming


_KINDS = [(has_hands, has_tethers) for has_hands in (False, True) for has_tethers in (False, True)]
advance_resident = {kind: _make_advance_resident(*kind) for kind in _KINDS}
"""The kernel without and with what explicit springs, and tethers, take: registers, hence time, where there are none."""
advance_streaming = {kind: _make_advance_streaming(*kind) for kind in _KINDS}
"""Likewise."""


@cuda.jit(fastmath=True)
def node_forces(
    displacement,
    spring_weight,
    window_rows,
    node_slot,
    lane_count,
    current,
    explicit_first,
    explicit_lane,
    explicit_offset,
    explicit_stiffness,
    tethers,
    nodes,
    force,
):
    """Write the spring forces [grid units] on some nodes, shape (at least len(nodes), 3)."""
    number = cuda.grid(1)
    if number < nodes.shape[0]:
        node = nodes[number]
        count = _U(lane_count)
        now = _U(current * count)
        row = rows_of(window_rows, node_slot[node])
        own = load_four(displacement, _U(now + row[4]))
        f = force_of_springs(displacement, now, own, row, weights_of(spring_weight, count, row))
        if explicit_lane.shape[0] > 0:
            begin, end = explicit_first[node], explicit_first[node + 1]
            f = pull_explicitly(
                f, displacement, now, own, begin, end, explicit_lane, explicit_offset, explicit_stiffness
            )
        if tethers[3].shape[0] > 0:
            f = pull_by_tethers(f, displacement, now, node, 0, tethers)
        force[number, 0], force[number, 1], force[number, 2] = f[0], f[1], f[2]
