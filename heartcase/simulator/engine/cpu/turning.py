"""Probes push nodes out, and movements are shortened that would turn a corner: the CPU kernel's last part of a step.

Rounds with a barrier after each. Nodes inside a probe are pushed out of it; cells near a probe, those that have a
corner below LOOK_BELOW, and those of quick nodes see whether one of their corners would come to harm. Where one would,
which is seldom, they write what their corners allow, and nodes take the least of the cells around them. See
:mod:`heartcase.simulator.engine.shared.contact` and :mod:`heartcase.simulator.engine.shared.turning`. What probes
give is added up in as many sums as there are shares of windows, whatever the number of threads.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic

from heartcase.compiling.emitting import array_data
from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Float64, Int8, Int32, Int64
from heartcase.simulator.dynamics.integrate import WAY_LIMIT
from heartcase.simulator.engine.cpu.barrier import raise_to
from heartcase.simulator.engine.cpu.cells import is_flat_window
from heartcase.simulator.engine.cpu.chunks import SHARES, part_of
from heartcase.simulator.engine.cpu.ghosts import GhostArrays
from heartcase.simulator.engine.cpu.room import untouched
from heartcase.simulator.engine.cpu.vector_ir import Lanes, Window
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

__all__ = ["TurnArrays", "allow_cells", "look_at_cells", "push_out", "shorten", "turn_arrays"]

Vector = tuple[np.float32, np.float32, np.float32]

_CELL_ROWS = np.array([4, 3, 1, 0])
"""Number in a window's rows of the cells that have a node for their corner (j, k) = (0, 0), (1, 0), (0, 1), (1, 1)."""
_NODES = np.array(CORNER_NODES)
_ROW_COUNT = len(CORNER_ROWS)
NEAR_WINDOWS = 64
"""Windows of nodes that follow each other, of which it is known together whether a probe is near."""
FAR_STEPS = 64
"""Most steps in which a window of nodes is not looked at: those that a free node, which is held to WAY_LIMIT along each
axis, and a probe need at least to come near each other."""


QUICK = 0.1
"""Way in a step from which on the cells around a node are looked at [cells]. A slower node takes at most 0.3 L^2 of the
volume of a corner whose edges are L long: none of LOOK_BELOW is turned by it, unless they are 1.4 cells long."""


class TurnArrays(NamedTuple):
    """Room for what the rounds of a step tell one another; what is near is of the last step that had probes."""

    near: Int8
    """Number of the last probe near each lane's node, from one on, shape (lane_count,)."""
    is_near: Int8
    """One where a window of nodes has one near, two where it is pushed, shape (window_count,)."""
    is_quick: Int8
    """Whether a window of nodes has one that goes by more than QUICK in the step, shape (window_count,)."""
    near_in: Int64
    """Step of a row, from one on, in which one of each NEAR_WINDOWS windows was quick or had one near last, (any,)."""
    far_until: Int64
    """Step of a row up to which no probe can come near each window of nodes, shape (window_count,)."""
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
        np.zeros(window_count, np.int8),
        np.zeros(window_count // NEAR_WINDOWS + 1, np.int64),
        np.zeros(window_count, np.int64),
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


@intrinsic
def _least_squares(typing_context, now, later, rest, rows, window, before, after):
    """Least squares of the distances of a window's nodes from a point before a step, and from another after it."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:4], arguments, strict=False)
        u, u_later, at_rest, starts = (array_data(context, builder, *pair) for pair in arrays)
        here = Window(builder, starts, arguments[4])
        places, least = here.load_vector(at_rest), []
        for displacement, point in ((u, arguments[5]), (u_later, arguments[6])):
            moved = here.load_vector(displacement)
            at = [Lanes.filled(builder, builder.extract_value(point, axis)) for axis in range(3)]
            way = [places[axis] + moved[axis] - at[axis] for axis in range(3)]
            square = way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
            for apart in (4, 2, 1):
                square = square.lesser(square.at([place ^ apart for place in range(LANE_COUNT)]))
            least.append(square.lane(0))
        return context.make_tuple(builder, signature.return_type, least)

    point = types.UniTuple(types.float32, 3)
    pair = types.UniTuple(types.float32, 2)
    return pair(now, later, rest, rows, types.int64, point, point), codegen


@intrinsic
def _is_quick(typing_context, velocity, rows, window, square_most):
    """Whether a node of a window has a speed whose square is above some."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:2], arguments, strict=False)
        v, starts = (array_data(context, builder, *pair) for pair in arrays)
        x, y, z = Window(builder, starts, arguments[2]).load_vector(v)
        most = Lanes.filled(builder, arguments[3])
        return (x * x + y * y + z * z - most).is_any_positive()

    return types.boolean(velocity, rows, types.int64, types.float32), codegen


@kernel(cached=False)
def _steps_out_of_reach(
    window: int, now: Float32, later: Float32, rest: Float32, rows: Int64, probes: Float32, step_number: int
) -> int:
    """Steps from this one on in which no probe of a row can come near to a node of a window."""
    count, steps = FAR_STEPS, np.float32(step_number + 1)
    for number in range(len(probes)):
        probe = probes[number]
        px, py, pz = probe[3], probe[4], probe[5]
        x, y, z = probe[0] + steps * px, probe[1] + steps * py, probe[2] + steps * pz
        least = _least_squares(now, later, rest, rows, window, (x - px, y - py, z - pz), (x, y, z))
        # By more than what is rounded otherwise here.
        reach = np.float32(1.01) * probe[16]
        if not (least[0] > reach and least[1] > reach):
            return 0
        nearer = np.float32(2 * WAY_LIMIT) + np.float32(sqrt(px * px + py * py + pz * pz))
        left = np.float32(sqrt(least[1])) - np.float32(sqrt(reach))
        count = min(count, 1 + int(min(left / nearer, np.float32(FAR_STEPS))))
    return count


@kernel
def push_out(
    thread: int,
    thread_count: int,
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
    """Push the nodes of a thread's windows out of the probes; mark what is near, or quick.

    Impulses are added to ``given``.
    """
    fastest = np.float32(QUICK) / step
    for share in range(thread, SHARES, thread_count):
        first, end = part_of(share, len(rows))
        for window in range(first, end):
            is_quick = _is_quick(velocity, rows, window, fastest * fastest)
            turn.is_quick[window] = is_quick
            if is_quick:
                turn.near_in[window // NEAR_WINDOWS] = step_number + 1
            if step_number > 0 and step_number < turn.far_until[window]:
                continue
            start = rows[window, 4]
            turn.near[start : start + LANE_COUNT] = 0
            turn.is_near[window] = 0
            if is_asleep[window]:
                turn.far_until[window] = 0
                continue
            far = _steps_out_of_reach(window, now, later, rest, rows, probes, step_number)
            turn.far_until[window] = step_number + far
            if far > 0:
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
                    turn.near_in[window // NEAR_WINDOWS] = step_number + 1
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
                    _give_at(given[share, number], rest, now, lane, probes[number], step_number, what)


@kernel
def _find_corners(starts: Int64, place: int, now: Float32, later: Float32, position: Float32, moved: Float32) -> None:
    """Write where a cell's corners are, shape (8, 3), and how they move in the step.

    ``starts``: lane at the first i of the cell's part in the rows of its corners; ``place``: its lane from there.
    """
    for corner in range(8):
        i, j, k = corner & 1, corner >> 1 & 1, corner >> 2
        lane = starts[2 * k + j] + place + i
        for axis in range(3):
            before = now[axis * BANK_LANES + lane]
            position[corner, axis] = before
            moved[corner, axis] = later[axis * BANK_LANES + lane] - before
        position[corner, 0] += np.float32(i)
        position[corner, 1] += np.float32(j)
        position[corner, 2] += np.float32(k)


@kernel
def _look_at_cell(
    starts: Int64,
    place: int,
    now: Float32,
    later: Float32,
    volume_most: np.float32,
    has_probes: bool,
    is_quick: bool,
    turn: TurnArrays,
    position: Float32,
    moved: Float32,
) -> bool:
    """Mark one cell if it is to be looked after, and whether one of its corners would come to harm then.

    A cell of quick nodes is looked after where a corner would, whatever its volume.

    As of :func:`_find_corners`, of which the rows of a vector each are room.
    """
    near = np.int8(0)
    if has_probes:
        for corner in range(8):
            i, j, k = corner & 1, corner >> 1 & 1, corner >> 2
            near = max(near, turn.near[starts[2 * k + j] + place + i])
    own = starts[0] + place
    _find_corners(starts, place, now, later, position, moved)
    volumes = np.empty(8, np.float32)
    is_flat = False
    for corner in range(8):
        n0, n1, n2, n3 = _NODES[corner, 0], _NODES[corner, 1], _NODES[corner, 2], _NODES[corner, 3]
        volumes[corner] = _volume(_edge(position, n0, n1), _edge(position, n0, n2), _edge(position, n0, n3))
        is_flat = is_flat or volumes[corner] < volume_most
    if near == 0 and not is_flat and not is_quick:
        return False
    does_harm = False
    for corner in range(8):
        n0, n1, n2, n3 = _NODES[corner, 0], _NODES[corner, 1], _NODES[corner, 2], _NODES[corner, 3]
        a, b, c = _edge(position, n0, n1), _edge(position, n0, n2), _edge(position, n0, n3)
        m0, m1, m2, m3 = _row(moved, n0), _row(moved, n1), _row(moved, n2), _row(moved, n3)
        does_harm = does_harm or _harms(volumes[corner], a, b, c, m0, m1, m2, m3)
    if near == 0 and not is_flat and not does_harm:
        return False
    turn.watched[own] = np.int8(1) + near
    if does_harm:
        raise_to(turn.harm, 0, np.int8(1))
    return True


@kernel
def _allow(
    starts: Int64,
    place: int,
    now: Float32,
    later: Float32,
    inverse_mass: Float32,
    volume_most: np.float32,
    turn: TurnArrays,
    position: Float32,
    moved: Float32,
) -> None:
    """Write what a cell that is looked after allows its corners' nodes; as of :func:`_look_at_cell`."""
    own = starts[0] + place
    is_near = turn.watched[own] > 1
    free = np.empty(8, np.bool_)
    for corner in range(8):
        turn.allowed[corner * BANK_LANES + own] = np.float32(1)
        free[corner] = inverse_mass[starts[corner >> 1] + place + (corner & 1)] > 0
    _find_corners(starts, place, now, later, position, moved)
    for corner in range(8):
        n0, n1, n2, n3 = _NODES[corner, 0], _NODES[corner, 1], _NODES[corner, 2], _NODES[corner, 3]
        a, b, c = _edge(position, n0, n1), _edge(position, n0, n2), _edge(position, n0, n3)
        m0, m1, m2, m3 = _row(moved, n0), _row(moved, n1), _row(moved, n2), _row(moved, n3)
        volume, c0, c1, c2, c3 = _charges(a, b, c, m0, m1, m2, m3)
        # Without a probe near it is one with a corner below the most.
        if not is_near and volume >= volume_most and not _harms(volume, a, b, c, m0, m1, m2, m3):
            continue
        each = _budget(volume, c0, c1, c2, c3, free[n0], free[n1], free[n2], free[n3])
        charges = (c0, c1, c2, c3)
        for number in range(4):
            node = _NODES[corner, number]
            at = node * BANK_LANES + own
            turn.allowed[at] = min(turn.allowed[at], _limit(each, charges[number], free[node]))


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


@kernel(cached=False)
def _volume_most(looks_after_flat: bool) -> np.float32:
    """Volume of a corner below which its cell is looked after."""
    return np.float32(LOOK_BELOW) if looks_after_flat else np.float32(0)


@kernel
def look_at_cells(
    thread: int,
    thread_count: int,
    now: Float32,
    later: Float32,
    rows: Int64,
    numbers: Float32,
    touches: Int64,
    touched_ends: Int32,
    in_pairs: Int8,
    is_flat: Int8,
    looks_after_flat: bool,
    has_probes: bool,
    step_number: int,
    turn: TurnArrays,
) -> None:
    """Write which cells of a thread's windows are to be looked after, and whether a corner would come to harm."""
    position, moved = np.empty((8, 3), np.float32), np.empty((8, 3), np.float32)
    for share in range(thread, SHARES, thread_count):
        first, end = part_of(share, len(rows))
        for window in range(first, end):
            is_due, is_quick = looks_after_flat and is_flat[window] > 0, False
            if has_probes and (looks_after_flat or not is_due):
                low, high = touched_ends[window]
                may_be = False
                for near in turn.near_in[low // NEAR_WINDOWS : high // NEAR_WINDOWS + 1]:
                    may_be = may_be or near == step_number + 1
                if may_be:
                    for touched in touches[window]:
                        if touched >= 0 and turn.is_near[touched]:
                            is_due = True
                        if touched >= 0 and turn.is_quick[touched]:
                            is_quick = looks_after_flat
                # Harm leaves a corner below LOOK_BELOW.
                is_quick = is_quick and is_flat_window(later, numbers, rows, window, in_pairs[window]) > 0
                is_due = is_due or is_quick
            if not is_due and not turn.is_watched[window]:
                continue
            is_watched = False
            for number in range(CELL_LANES):
                part, place = number // PART_LANES, number % PART_LANES
                starts = rows[window, _ROW_COUNT * part : _ROW_COUNT * (part + 1)]
                turn.watched[starts[0] + place] = 0
                # Without stiffness there is no cell, or one that was cut.
                if is_due and numbers[window, 0, number] > 0:
                    most = _volume_most(looks_after_flat)
                    how = (most, has_probes, is_quick, turn, position, moved)
                    does = _look_at_cell(starts, place, now, later, *how)
                    is_watched = is_watched or does
            turn.is_watched[window] = is_watched
            if is_watched:
                for touched in touches[window]:
                    if touched >= 0:
                        turn.is_beside[touched] = 1


@kernel
def allow_cells(
    thread: int,
    thread_count: int,
    now: Float32,
    later: Float32,
    inverse_mass: Float32,
    rows: Int64,
    numbers: Float32,
    looks_after_flat: bool,
    turn: TurnArrays,
) -> None:
    """Write what the cells of a thread's windows that are looked after allow their corners' nodes."""
    position, moved = np.empty((8, 3), np.float32), np.empty((8, 3), np.float32)
    for share in range(thread, SHARES, thread_count):
        first, end = part_of(share, len(rows))
        for window in range(first, end):
            if not turn.is_watched[window]:
                continue
            for number in range(CELL_LANES):
                part, place = number // PART_LANES, number % PART_LANES
                starts = rows[window, _ROW_COUNT * part : _ROW_COUNT * (part + 1)]
                if numbers[window, 0, number] > 0 and turn.watched[starts[0] + place] > 0:
                    most = _volume_most(looks_after_flat)
                    _allow(starts, place, now, later, inverse_mass, most, turn, position, moved)


@kernel(cached=False)
def _least(turn: TurnArrays, cell: int, corner: int, part: np.float32, owner: np.int64) -> tuple[np.float32, np.int64]:
    """What a cell allows the node at its corner, and the number of the probe near it, where that is less."""
    allowed = turn.allowed[corner * BANK_LANES + cell]
    if turn.watched[cell] > 0 and allowed < part:
        return allowed, np.int64(turn.watched[cell]) - 1
    return part, owner


@kernel
def shorten(
    thread: int,
    thread_count: int,
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
    """Let the nodes of a thread's windows go as far as the cells around them allow."""
    for share in range(thread, SHARES, thread_count):
        first, end = part_of(share, len(rows))
        for window in range(first, end):
            if not turn.is_beside[window]:
                continue
            turn.is_beside[window] = 0
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
                    _give_at(given[share, owner - 1], rest, now, lane, probes[owner - 1], step_number, what)
