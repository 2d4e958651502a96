"""What CUDA threads do after a step: probes push nodes out, and movements are shortened that would turn a corner.

As :mod:`heartcase.simulator.engine.cpu.turning`: a node, then a cell, then a node at a time, with a grid-wide barrier
after each round. What probes give is added up node by node, so that the sums do not depend on the threads.

``turn`` is (number of the last probe near each node, from one on, and one for a cell that is looked after plus the
number of the probe near it, int32, (node_count,) and (cell_count,); what cells allow their corners' nodes, float32,
(8 * cell_count,); whether any cell is to be looked after in an even and an odd step, and whether a corner
that is looked after would come to harm in them, int32, (4,); momentum and its moment
about its centre that each probe gave each node, float32, (probe_count * 6 * node_count,)).
"""

from __future__ import annotations

import numpy as np
from numba import cuda

from heartcase.simulator.engine.cuda.intrinsics import load_four, store_four
from heartcase.simulator.engine.shared.contact import make_contact
from heartcase.simulator.engine.shared.turning import CORNER_NODES, make_turn_math

__all__ = ["clear_given", "push_out", "shorten", "watch_cell"]

_U = np.uint32
_O, _ONE = np.float32(0.0), np.float32(1.0)

_pushed_out = make_contact(cuda.jit(device=True))
_math = make_turn_math(cuda.jit(device=True))
_charges, _limit, _budget, _harms = _math.charges, _math.limit, _math.budget, _math.harms


@cuda.jit(device=True)
def _give(given, number, node, node_count, probe, step_number, place, own, gx, gy, gz):
    """Add an impulse on a node to what a probe gave."""
    steps = np.float32(step_number + 1)
    ax = place[0] - (probe[0] + steps * probe[3]) + own[0]
    ay = place[1] - (probe[1] + steps * probe[4]) + own[1]
    az = place[2] - (probe[2] + steps * probe[5]) + own[2]
    at = 6 * number * node_count + node
    given[at] += gx
    given[at + node_count] += gy
    given[at + 2 * node_count] += gz
    given[at + 3 * node_count] += ay * gz - az * gy
    given[at + 4 * node_count] += az * gx - ax * gz
    given[at + 5 * node_count] += ax * gy - ay * gx


@cuda.jit(device=True)
def push_out(own, u, v, place, probes, step_number, step, turn, node, node_count):
    """Displacement and velocity of a node after the probes pushed it out; marks whether one is near."""
    near = turn[0]
    near[node] = 0
    if v[3] <= _O:
        return u, v
    for number in range(probes.shape[0]):
        new, contact = _pushed_out(place, own, (u[0], u[1], u[2]), probes[number], step_number)
        if contact > 0:
            near[node] = number + 1
        if contact == 2:
            vx, vy, vz = (new[0] - own[0]) / step, (new[1] - own[1]) / step, (new[2] - own[2]) / step
            gx, gy, gz = (vx - v[0]) / v[3], (vy - v[1]) / v[3], (vz - v[2]) / v[3]
            _give(turn[4], number, node, node_count, probes[number], step_number, place, own, gx, gy, gz)
            u, v = (new[0], new[1], new[2], _O), (vx, vy, vz, v[3])
    return u, v


@cuda.jit(device=True)
def _position(displacement, buffer, corner_lane, corner, cell, count):
    u = load_four(displacement, _U(buffer + corner_lane[_U(corner * count + cell)]))
    return u[0] + np.float32(corner & 1), u[1] + np.float32(corner >> 1 & 1), u[2] + np.float32(corner >> 2)


@cuda.jit(device=True)
def _less(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@cuda.jit(device=True)
def watch_cell(
    displacement, now, later, velocity, corner_lane, corner_node, scale, volume_most, turn, step_number, cell
):
    """Write what a cell allows its corners' nodes, where it is to be looked after."""
    near, watched, allowed, flags, _ = turn
    count = _U(watched.shape[0])
    owner = 0
    watched[cell] = 0
    # Without stiffness it was cut.
    if scale <= _O:
        return
    for corner in range(8):
        owner = max(owner, near[corner_node[_U(corner * count + cell)]])
        allowed[_U(corner * count + cell)] = _ONE
    for corner in range(8):
        nodes = CORNER_NODES[corner]
        n0, n1, n2, n3 = nodes[0], nodes[1], nodes[2], nodes[3]
        p0 = _position(displacement, now, corner_lane, n0, cell, count)
        p1 = _position(displacement, now, corner_lane, n1, cell, count)
        p2 = _position(displacement, now, corner_lane, n2, cell, count)
        p3 = _position(displacement, now, corner_lane, n3, cell, count)
        m0 = _less(_position(displacement, later, corner_lane, n0, cell, count), p0)
        m1 = _less(_position(displacement, later, corner_lane, n1, cell, count), p1)
        m2 = _less(_position(displacement, later, corner_lane, n2, cell, count), p2)
        m3 = _less(_position(displacement, later, corner_lane, n3, cell, count), p3)
        a, b, c = _less(p1, p0), _less(p2, p0), _less(p3, p0)
        volume, c0, c1, c2, c3 = _charges(a, b, c, m0, m1, m2, m3)
        harms = _harms(volume, a, b, c, m0, m1, m2, m3)
        if owner == 0 and volume >= volume_most and not (volume_most > _O and harms):
            continue
        if harms:
            flags[2 + step_number % 2] = 1
        watched[cell] = 1 + owner
        free0 = load_four(velocity, corner_lane[_U(n0 * count + cell)])[3] > _O
        free1 = load_four(velocity, corner_lane[_U(n1 * count + cell)])[3] > _O
        free2 = load_four(velocity, corner_lane[_U(n2 * count + cell)])[3] > _O
        free3 = load_four(velocity, corner_lane[_U(n3 * count + cell)])[3] > _O
        each = _budget(volume, c0, c1, c2, c3, free0, free1, free2, free3)
        charges, free = (c0, c1, c2, c3), (free0, free1, free2, free3)
        for number in range(4):
            at = _U(nodes[number] * count + cell)
            allowed[at] = min(allowed[at], _limit(each, charges[number], free[number]))


@cuda.jit(device=True)
def shorten(displacement, now, later, velocity, lane, rest, probes, step_number, turn, node_cell, node, no_cell):
    """Let a node go as far as the cells around it allow."""
    near, watched, allowed, flags, given = turn
    node_count, cell_count = _U(near.shape[0]), _U(watched.shape[0])
    v = load_four(velocity, lane)
    if v[3] <= _O or flags[2 + step_number % 2] == 0:
        return
    part, owner = _ONE, 0
    for corner in range(8):
        cell = node_cell[_U(corner * node_count + node)]
        if cell == no_cell or watched[cell] == 0:
            continue
        if allowed[_U(corner * cell_count + cell)] < part:
            part, owner = allowed[_U(corner * cell_count + cell)], watched[cell] - 1
    for slot in range(8, node_cell.shape[0] // node_count):
        use = node_cell[_U(slot * node_count + node)]
        cell, corner = use // 8, use % 8
        if use == no_cell or watched[cell] == 0:
            continue
        if allowed[_U(corner * cell_count + cell)] < part:
            part, owner = allowed[_U(corner * cell_count + cell)], watched[cell] - 1
    if part >= _ONE:
        return
    own, u = load_four(displacement, _U(now + lane)), load_four(displacement, _U(later + lane))
    store_four(
        displacement,
        _U(later + lane),
        own[0] + part * (u[0] - own[0]),
        own[1] + part * (u[1] - own[1]),
        own[2] + part * (u[2] - own[2]),
        _O,
    )
    store_four(velocity, lane, part * v[0], part * v[1], part * v[2], v[3])
    if owner > 0:
        lost = (part - _ONE) / v[3]
        place = load_four(rest, _U(node))
        probe = probes[owner - 1]
        _give(given, owner - 1, node, node_count, probe, step_number, place, own, lost * v[0], lost * v[1], lost * v[2])


@cuda.jit
def clear_given(given):
    """Set what the probes gave to zero."""
    place = cuda.grid(1)
    if place < given.shape[0]:
        given[place] = _O
