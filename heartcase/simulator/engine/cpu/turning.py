"""Probes push nodes out, and movements are shortened that would turn a corner: the CPU kernel's last part of a step.

Three rounds with a barrier after each. Nodes inside a probe are pushed out of it; cells near a probe, and those that
have a corner below LOOK_BELOW, write what their corners allow; nodes take the least of the cells around them. See
:mod:`heartcase.simulator.engine.shared.contact` and :mod:`heartcase.simulator.engine.shared.turning`. What probes
give is added up in as many sums as there are shares of windows, whatever the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Float64, Int8, Int64
from heartcase.simulator.engine.cpu.barrier import raise_to
from heartcase.simulator.engine.cpu.ghosts import GhostArrays
from heartcase.simulator.engine.cpu.room import untouched
from heartcase.simulator.engine.shared.contact import make_contact
from heartcase.simulator.engine.shared.lanes import (
    BANK_LANES,
    CELL_LANES,
    CORNER_ROWS,
    LANE_COUNT,
    PART_LANES,
    LaneLayout,
)
from heartcase.simulator.engine.shared.turning import CORNER_NODES, make_turn_math
from heartcase.simulator.lattice.moduli import LOOK_BELOW

__all__ = ["TurnArrays", "push_out", "shorten", "turn_arrays", "watch_cells"]

Vector = tuple[np.float32, np.float32, np.float32]

_CELL_ROWS = np.array([4, 3, 1, 0])
"""Number in a window's rows of the cells that have a node for their corner (j, k) = (0, 0), (1, 0), (0, 1), (1, 1)."""
_NODES = np.array(CORNER_NODES)
_ROW_COUNT = len(CORNER_ROWS)


class TurnArrays(NamedTuple):
    """Room for what the rounds of a step tell one another; what is near is of the last step that had probes."""

    near: Int8
    """Number of the last probe near each lane's node, from one on, shape (lane_count,)."""
    is_near: Int8
    """One where a window of nodes has one near, two where it is pushed, shape (window_count,)."""
    is_watched: Int8
    """Whether each window of cells was looked after, shape (cell_window_count,)."""
    watched: Int8
    """One for a cell that is looked after, and the number of the probe near it, shape (lane_count,)."""
    is_beside: Int8
    """Whether each window of nodes belongs to such a cell, shape (window_count,)."""
    allowed: Float32
    """What such a cell allows its corners' nodes, eight numbers a lane; written before it is read."""
    harm: Int8
    """Whether a corner that is looked after would come to harm in this step, shape (1,)."""


def turn_arrays(layout: LaneLayout, cell_window_count: int) -> TurnArrays:
    """The room of a layout; nothing is near, nothing is watched."""
    lane_count, window_count = layout.lane_count, layout.window_count
    return TurnArrays(
        untouched((lane_count,), np.int8),
        np.zeros(window_count, np.int8),
        np.zeros(cell_window_count, np.int8),
        untouched((lane_count,), np.int8),
        np.zeros(window_count, np.int8),
        untouched((layout.length(8),)),
        np.zeros(1, np.int8),
    )


_pushed_out = make_contact(kernel(cached=False))
_charges, _limit, _budget, _harms, _volume = make_turn_math(kernel(cached=False))


@kernel(cached=False)
def _vector(array: Float32, lane: int) -> Vector:
    return array[lane], array[BANK_LANES + lane], array[2 * BANK_LANES + lane]


@kernel(cached=False)
def _give(total: Float64, gx: float, gy: float, gz: float, ax: float, ay: float, az: float) -> None:
    """Add an impulse and its moment by an arm."""
    total[0] += gx
    total[1] += gy
    total[2] += gz
    total[3] += ay * gz - az * gy
    total[4] += az * gx - ax * gz
    total[5] += ax * gy - ay * gx


@kernel(cached=False)
def _give_at(
    total: Float64, rest: Float32, now: Float32, lane: int, probe: Float32, step_number: int, given: Vector
) -> None:
    """Add an impulse on a lane's node to what a probe gave."""
    arm = np.empty(3, np.float64)
    for axis in range(3):
        centre = np.float64(probe[axis]) + (step_number + 1) * np.float64(probe[3 + axis])
        place = axis * BANK_LANES + lane
        arm[axis] = np.float64(rest[place]) + np.float64(now[place]) - centre
    _give(total, given[0], given[1], given[2], arm[0], arm[1], arm[2])


@kernel
def push_out(
    first: int,
    end: int,
    now: Float32,
    later: Float32,
    velocity: Float32,
    inverse_mass: Float32,
    rest: Float32,
    rows: Int64,
    is_asleep: Int8,
    probes: Float32,
    step_number: int,
    step: np.float32,
    turn: TurnArrays,
    given: Float64,
) -> None:
    """Push the nodes of some windows out of the probes; mark what is near. Impulses are added to ``given``."""
    for window in range(first, end):
        turn.is_near[window] = 0
        start = rows[window, 4]
        turn.near[start : start + LANE_COUNT] = 0
        if is_asleep[window]:
            continue
        for lane in range(start, start + LANE_COUNT):
            mass_inverse = inverse_mass[lane]
            if mass_inverse <= 0:
                continue
            own, place = _vector(now, lane), _vector(rest, lane)
            for number in range(len(probes)):
                u, contact = _pushed_out(place, own, _vector(later, lane), probes[number], step_number)
                if contact == 0:
                    continue
                turn.near[lane] = number + 1
                turn.is_near[window] = max(turn.is_near[window], np.int8(contact))
                if contact == 1:
                    continue
                gained = np.empty(3, np.float64)
                for axis in range(3):
                    at = axis * BANK_LANES + lane
                    later[at] = u[axis]
                    new = np.float32((u[axis] - own[axis]) / step)
                    gained[axis] = (np.float64(new) - np.float64(velocity[at])) / np.float64(mass_inverse)
                    velocity[at] = new
                what = (gained[0], gained[1], gained[2])
                _give_at(given[number], rest, now, lane, probes[number], step_number, what)


@kernel
def _watch_cell(
    starts: Int64,
    place: int,
    now: Float32,
    later: Float32,
    inverse_mass: Float32,
    volume_most: np.float32,
    has_probes: bool,
    turn: TurnArrays,
    position: Float32,
    moved: Float32,
) -> bool:
    """Write what one cell allows; whether it is to be looked after at all. Rows of a vector each are room.

    ``starts``: lane at the first i of the cell's part in the rows of its corners; ``place``: its lane from there.
    """
    near = np.int8(0)
    lanes = np.empty(8, np.int64)
    free = np.empty(8, np.bool_)
    for corner in range(8):
        i, j, k = corner & 1, corner >> 1 & 1, corner >> 2
        lane = starts[2 * k + j] + place + i
        lanes[corner] = lane
        free[corner] = inverse_mass[lane] > 0
        if has_probes:
            near = max(near, turn.near[lane])
        for axis in range(3):
            before = now[axis * BANK_LANES + lane]
            position[corner, axis] = before
            moved[corner, axis] = later[axis * BANK_LANES + lane] - before
        position[corner, 0] += np.float32(i)
        position[corner, 1] += np.float32(j)
        position[corner, 2] += np.float32(k)
    own = starts[0] + place
    is_watched = bool(near > 0)
    is_flat = False
    for corner in range(8):
        turn.allowed[corner * BANK_LANES + own] = np.float32(1)
        n0, n1, n2, n3 = _NODES[corner, 0], _NODES[corner, 1], _NODES[corner, 2], _NODES[corner, 3]
        a, b, c = _edge(position, n0, n1), _edge(position, n0, n2), _edge(position, n0, n3)
        is_flat = is_flat or _volume(a, b, c) < volume_most
    for corner in range(8):
        n0, n1, n2, n3 = _NODES[corner, 0], _NODES[corner, 1], _NODES[corner, 2], _NODES[corner, 3]
        a, b, c = _edge(position, n0, n1), _edge(position, n0, n2), _edge(position, n0, n3)
        m0, m1, m2, m3 = _row(moved, n0), _row(moved, n1), _row(moved, n2), _row(moved, n3)
        volume, c0, c1, c2, c3 = _charges(a, b, c, m0, m1, m2, m3)
        harms = _harms(volume, a, b, c, m0, m1, m2, m3)
        if near == 0 and volume >= volume_most and not (is_flat and harms):
            continue
        if harms:
            raise_to(turn.harm, 0, np.int8(1))
        is_watched = True
        each = _budget(volume, c0, c1, c2, c3, free[n0], free[n1], free[n2], free[n3])
        charges = (c0, c1, c2, c3)
        for number in range(4):
            node = _NODES[corner, number]
            at = node * BANK_LANES + own
            turn.allowed[at] = min(turn.allowed[at], _limit(each, charges[number], free[node]))
    turn.watched[own] = np.int8(1) + near if is_watched else np.int8(0)
    return is_watched


@kernel(cached=False)
def _row(array: Float32, number: int) -> Vector:
    return array[number, 0], array[number, 1], array[number, 2]


@kernel(cached=False)
def _edge(position: Float32, low: int, high: int) -> Vector:
    return (
        position[high, 0] - position[low, 0],
        position[high, 1] - position[low, 1],
        position[high, 2] - position[low, 2],
    )


@kernel
def watch_cells(
    first: int,
    end: int,
    now: Float32,
    later: Float32,
    inverse_mass: Float32,
    rows: Int64,
    numbers: Float32,
    touches: Int64,
    is_flat: Int8,
    looks_after_flat: bool,
    has_probes: bool,
    turn: TurnArrays,
) -> None:
    """Write what the cells of some windows allow their corners' nodes, where they are to be looked after."""
    position, moved = np.empty((8, 3), np.float32), np.empty((8, 3), np.float32)
    for window in range(first, end):
        is_due = looks_after_flat and is_flat[window] > 0
        if has_probes and not is_due:
            for touched in touches[window]:
                if touched >= 0 and turn.is_near[touched]:
                    is_due = True
        if not is_due and not turn.is_watched[window]:
            continue
        is_watched = False
        for number in range(CELL_LANES):
            part, place = number // PART_LANES, number % PART_LANES
            starts = rows[window, _ROW_COUNT * part : _ROW_COUNT * (part + 1)]
            turn.watched[starts[0] + place] = 0
            # Without stiffness there is no cell, or one that was cut.
            if is_due and numbers[window, 0, number] > 0:
                most = np.float32(LOOK_BELOW) if looks_after_flat else np.float32(0)
                does = _watch_cell(starts, place, now, later, inverse_mass, most, has_probes, turn, position, moved)
                is_watched = is_watched or does
        turn.is_watched[window] = is_watched
        if is_watched:
            for touched in touches[window]:
                if touched >= 0:
                    turn.is_beside[touched] = 1


@kernel(cached=False)
def _least(turn: TurnArrays, cell: int, corner: int, part: np.float32, owner: np.int64) -> tuple[np.float32, np.int64]:
    """What a cell allows the node at its corner, and the number of the probe near it, where that is less."""
    allowed = turn.allowed[corner * BANK_LANES + cell]
    if turn.watched[cell] > 0 and allowed < part:
        return allowed, np.int64(turn.watched[cell]) - 1
    return part, owner


@kernel
def shorten(
    first: int,
    end: int,
    now: Float32,
    later: Float32,
    velocity: Float32,
    inverse_mass: Float32,
    rest: Float32,
    rows: Int64,
    probes: Float32,
    step_number: int,
    turn: TurnArrays,
    given: Float64,
    ghosts: GhostArrays,
) -> None:
    """Let the nodes of some windows go as far as the cells around them allow."""
    for window in range(first, end):
        if not turn.is_beside[window]:
            continue
        turn.is_beside[window] = 0
        if not turn.harm[0]:
            continue
        ghosted = ghosts.node_first[window]
        row = rows[window]
        for place in range(LANE_COUNT):
            lane = row[4] + place
            mass_inverse = inverse_mass[lane]
            if mass_inverse <= 0:
                continue
            part, owner = np.float32(1), np.int64(0)
            for corner in range(8):
                cell = row[_CELL_ROWS[corner >> 1]] + place - (corner & 1)
                part, owner = _least(turn, cell, corner, part, owner)
            while ghosted < ghosts.node_first[window + 1] and ghosts.node_lane[ghosted] < lane:
                ghosted += 1
            if ghosted < ghosts.node_first[window + 1] and ghosts.node_lane[ghosted] == lane:
                for at in range(ghosts.ghost_first[ghosted], ghosts.ghost_first[ghosted + 1]):
                    ghost = ghosts.ghost_number[at]
                    part, owner = _least(turn, ghosts.cell_lane[ghost], ghost % 8, part, owner)
            if part >= 1:
                continue
            lost = np.empty(3, np.float64)
            for axis in range(3):
                at = axis * BANK_LANES + lane
                before = velocity[at]
                later[at] = now[at] + part * (later[at] - now[at])
                velocity[at] = part * before
                lost[axis] = (np.float64(velocity[at]) - np.float64(before)) / np.float64(mass_inverse)
            if owner > 0:
                what = (lost[0], lost[1], lost[2])
                _give_at(given[owner - 1], rest, now, lane, probes[owner - 1], step_number, what)
