"""Sleep: windows of the CPU kernel whose tissue rests are not worked out, from one check to the next.

A window is still when, in a step, each of its nodes is slower than a speed and the force on it changes its velocity by
less than a difference, or than the rounding of float32 does; the second keeps a swing at its turning point awake, and
tissue that is about to be pulled along. It is the force that counts: a node of less than half a cell's mass may change
its velocity by more. Blocks of
8 x 8 x 8 cells in which one node is not still, and the blocks around them, stay awake until the next check: a wave
takes longer through one block than that. All others sleep: they stand where they are, and what was left of their
velocity is lost. Every ROUSE_STEPS steps, and at the start of each row of steps, all tissue is worked out and checked,
so nothing can creep up on tissue that sleeps.

Which windows sleep follows from the state at the start of a row and nothing else.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int8, Int32, Int64
from heartcase.schemas.bundle.lattice import distinct_keys, lattice_keys
from heartcase.simulator.engine.cpu.barrier import raise_to
from heartcase.simulator.engine.shared.contact import REACH
from heartcase.simulator.engine.shared.lane_kernels import bounds
from heartcase.simulator.engine.shared.lanes import BANK_LANES, LANE_COUNT, LaneLayout
from heartcase.simulator.lattice.model import LatticeModel

__all__ = [
    "CHECK_STEPS",
    "ROUNDING",
    "ROUSE_STEPS",
    "SleepArrays",
    "check",
    "feel_probes",
    "remember",
    "rouse",
    "settle",
    "sleep_arrays",
]


CHECK_STEPS = 8
"""Steps between two checks: less than a wave takes through a block; it passes at most a cell in a step."""
ROUSE_STEPS = 64
"""Steps after which all tissue is worked out once; a multiple of CHECK_STEPS."""
PULLED, QUICK = np.int8(1), np.int8(2)
"""Why a block is not still."""
_BLOCK = 8
_PLACES_PER_WINDOW = 16
"""Blocks of a lattice's box over its windows up to which a table holds the number of each."""
_MASS = np.float32(0.5)
"""Mass up to which it is the force on a node that counts, not how it is accelerated [full cells]."""
ROUNDING = 32.0 * float(np.finfo(np.float32).eps)
"""Rounding of the forces on a node per displacement [k], of any sign."""


class SleepArrays(NamedTuple):
    """What the kernel needs to let windows sleep."""

    blocks_of_window: Int32
    """Blocks in which a window begins and ends, shape (window_count, 2)."""
    beside: Int32
    """The up to 27 blocks that touch a block, itself among them, then -1, shape (block_count, 27)."""
    is_moving: Int8
    """Room for why blocks are not still, shape (block_count,)."""
    is_quick: Int8
    """Whether it was their speed at the last check, shape (block_count,)."""
    is_awake: Int8
    """Blocks that are awake, shape (block_count,)."""
    is_asleep: Int8
    """Windows that sleep, shape (window_count,)."""
    awake: Int64
    """Windows of nodes that are awake come first, shape (window_count,)."""
    awake_cells: Int64
    """Windows of cells that are awake come first, shape (cell_window_count,)."""
    counts: Int64
    """How many windows of nodes and of cells are awake, shape (2,)."""
    before: Float32
    """Room for the velocities before a step, three numbers a lane."""


def sleep_arrays(model: LatticeModel, layout: LaneLayout, cell_window_count: int, before: Float32) -> SleepArrays:
    """The windows of a layout in their blocks; all are awake at first. Room for velocities is given."""
    window_count = layout.window_count
    places = np.empty((window_count, 2, 3), np.int32)
    _blocks_of_windows(model.node_index, layout.slots.by_lane, layout.slots.first, places)
    number, beside = _numbered_blocks(places)
    return SleepArrays(
        number,
        beside,
        np.zeros(len(beside), np.int8),
        np.zeros(len(beside), np.int8),
        np.ones(len(beside), np.int8),
        np.zeros(window_count, np.int8),
        np.arange(window_count),
        np.arange(cell_window_count),
        np.array([window_count, cell_window_count]),
        before,
    )


def _numbered_blocks(places: Int32) -> tuple[Int32, Int32]:
    """Numbers of blocks at some places (i, j, k), shape (any, 2, 3), and those of all blocks around each."""
    (i, j, k), (i_most, j_most, k_most) = bounds(places.reshape(-1, 3)).tolist()
    shape = (k_most - k + 3, j_most - j + 3, i_most - i + 3)
    if shape[0] * shape[1] * shape[2] > _PLACES_PER_WINDOW * (len(places) + 64):
        return _searched_blocks(places)
    table, number = np.zeros(shape, np.int32), np.empty(places.shape[:2], np.int32)
    beside = np.empty((_number_blocks(places, np.array([i, j, k]), table, number), 27), np.int32)
    _blocks_beside(table, beside)
    return number, beside


def _searched_blocks(places: Int32) -> tuple[Int32, Int32]:
    """The same of blocks that lie far apart."""
    keys = lattice_keys(places.reshape(-1, 3))
    used = distinct_keys(keys)
    blocks = np.empty((len(used), 3), places.dtype)
    number = np.searchsorted(used, keys)
    blocks[number] = places.reshape(-1, 3)
    around = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    near = lattice_keys((blocks[:, None] + around).reshape(-1, 3)).reshape(len(blocks), -1)
    place = np.minimum(np.searchsorted(used, near), len(used) - 1)
    beside = np.where(used[place] == near, place, -1)
    return number.reshape(-1, 2).astype(np.int32), np.sort(beside, axis=1)[:, ::-1].astype(np.int32)


@kernel
def _blocks_of_windows(node_index: Int32, by_lane: Int32, first: Int32, places: Int32) -> None:
    """Write the places (i, j, k) of the blocks in which each window begins and ends, shape (window_count, 2, 3)."""
    for window in range(len(places)):
        for axis in range(3):
            places[window, 0, axis] = node_index[by_lane[first[window]], axis] // _BLOCK
            places[window, 1, axis] = node_index[by_lane[first[window + 1] - 1], axis] // _BLOCK


@kernel
def _number_blocks(places: Int32, low: Int64, table: Int32, number: Int32) -> int:
    """Number blocks at some places by k, j and i; returns how many there are.

    ``table``: zeros, shape (k, j, i), written from one before the least place on with the number and one more.
    """
    flat = table.ravel()
    for place in range(len(places)):
        for end in range(2):
            i, j, k = places[place, end, 0] - low[0], places[place, end, 1] - low[1], places[place, end, 2] - low[2]
            at = ((k + 1) * table.shape[1] + j + 1) * table.shape[2] + i + 1
            number[place, end] = at
            flat[at] = 1
    count = 0
    for at in range(len(flat)):
        if flat[at]:
            count += 1
            flat[at] = count
    for place in range(len(places)):
        for end in range(2):
            number[place, end] = flat[number[place, end]] - 1
    return count


@kernel
def _blocks_beside(table: Int32, beside: Int32) -> None:
    """Write the numbers of all blocks around each block, descending, then -1; of a table as of the kernel above."""
    beside[:] = -1
    for k in range(1, table.shape[0] - 1):
        for j in range(1, table.shape[1] - 1):
            for i in range(1, table.shape[2] - 1):
                if not table[k, j, i]:
                    continue
                count = 0
                for dk in range(1, -2, -1):
                    for dj in range(1, -2, -1):
                        for di in range(1, -2, -1):
                            other = table[k + dk, j + dj, i + di]
                            if other:
                                beside[table[k, j, i] - 1, count] = other - 1
                                count += 1


@kernel
def rouse(sleep: SleepArrays, is_first: bool) -> bool:
    """Wake all windows; before the first step of a row, also forget what the last check said.

    Returns whether one was asleep.
    """
    awake, awake_cells, counts = sleep.awake, sleep.awake_cells, sleep.counts
    if is_first:
        sleep.is_quick[:] = 0
    if counts[0] == len(awake) and counts[1] == len(awake_cells):
        return False
    sleep.is_awake[:] = 1
    sleep.is_asleep[:] = 0
    for number in range(len(awake)):
        awake[number] = number
    for number in range(len(awake_cells)):
        awake_cells[number] = number
    counts[0], counts[1] = len(awake), len(awake_cells)
    return True


@kernel
def remember(first: int, end: int, rows: Int64, velocity: Float32, sleep: SleepArrays) -> None:
    """Keep the velocities of some of the windows that are awake for a check after the step.

    Not those of blocks that were quick at the last check.
    """
    blocks_of_window, is_quick, awake, before = sleep.blocks_of_window, sleep.is_quick, sleep.awake, sleep.before
    for number in range(first, end):
        window = awake[number]
        if is_quick[blocks_of_window[window, 0]] and is_quick[blocks_of_window[window, 1]]:
            continue
        lane = rows[window, 4]
        for axis in range(3):
            for place in range(lane, lane + LANE_COUNT):
                before[axis * BANK_LANES + place] = velocity[axis * BANK_LANES + place]


@kernel
def check(
    first: int,
    end: int,
    rows: Int64,
    displacement: Float32,
    velocity: Float32,
    inverse_mass: Float32,
    still: Float32,
    sleep: SleepArrays,
) -> None:
    """Mark the blocks of some of the windows that are awake as moving, where not all nodes are still.

    ``still``: speed, change of it in a step, and what rounding may add to that per cell of displacement.
    """
    blocks_of_window, is_moving, is_quick = sleep.blocks_of_window, sleep.is_moving, sleep.is_quick
    awake, before = sleep.awake, sleep.before
    for number in range(first, end):
        window = awake[number]
        low, high = blocks_of_window[window]
        if is_moving[low] == QUICK and is_moving[high] == QUICK:
            continue
        lane = rows[window, 4]
        # Counted without a way out, so that it is done in vectors. A node that is led moves as slowly as it likes.
        count = 0
        for axis in range(3):
            for place in range(lane, lane + LANE_COUNT):
                now = velocity[axis * BANK_LANES + place]
                count += (abs(now) >= still[0]) | ((inverse_mass[place] == 0) & (now != 0))
        why = QUICK if count else PULLED
        if not count:
            if is_moving[low] and is_moving[high]:
                continue
            if is_quick[low] and is_quick[high]:
                count = 1
            else:
                for axis in range(3):
                    for place in range(lane, lane + LANE_COUNT):
                        change = still[1] + still[2] * abs(displacement[axis * BANK_LANES + place])
                        change *= max(_MASS * inverse_mass[place], np.float32(1))
                        count += abs(velocity[axis * BANK_LANES + place] - before[axis * BANK_LANES + place]) >= change
        if count:
            raise_to(is_moving, low, why)
            raise_to(is_moving, high, why)


@kernel
def feel_probes(
    first: int,
    end: int,
    rows: Int64,
    displacement: Float32,
    rest: Float32,
    probes: Float32,
    step_number: int,
    sleep: SleepArrays,
) -> None:
    """Mark the blocks of some windows as moving where a probe on its way comes near until the next check."""
    blocks_of_window, is_moving = sleep.blocks_of_window, sleep.is_moving
    for window in range(first, end):
        low, high = blocks_of_window[window]
        lane = rows[window, 4]
        for number in range(len(probes)):
            px, py, pz = probes[number, 3], probes[number, 4], probes[number, 5]
            way = sqrt(px * px + py * py + pz * pz)
            if way == 0 or (is_moving[low] and is_moving[high]):
                continue
            reach = sqrt(probes[number, 16]) + REACH + (CHECK_STEPS + 1) * way
            for place in range(lane, lane + LANE_COUNT):
                square = np.float32(0)
                for axis in range(3):
                    centre = probes[number, axis] + step_number * probes[number, 3 + axis]
                    gap = rest[axis * BANK_LANES + place] + displacement[axis * BANK_LANES + place] - centre
                    square += gap * gap
                if square <= reach * reach:
                    raise_to(is_moving, low, PULLED)
                    raise_to(is_moving, high, PULLED)


@kernel
def settle(now: Float32, other: Float32, velocity: Float32, rows: Int64, touches: Int64, sleep: SleepArrays) -> bool:
    """After a check, put windows to sleep that are far from what moves, and wake those that are not.

    Both buffers of the displacement then hold that of windows that sleep. Returns whether any did.
    """
    blocks_of_window, beside, is_moving, is_quick, is_awake, is_asleep, awake, awake_cells, counts, _ = sleep
    has_changed = False
    for block in range(len(is_moving)):
        is_near = False
        for near in beside[block]:
            if near >= 0 and is_moving[near]:
                is_near = True
                break
        has_changed = has_changed or is_near != (is_awake[block] == 1)
        is_awake[block] = is_near
    for block in range(len(is_moving)):
        is_quick[block] = is_moving[block] == QUICK
        is_moving[block] = 0
    if not has_changed:
        return False
    count = 0
    for window in range(len(rows)):
        if is_awake[blocks_of_window[window, 0]] or is_awake[blocks_of_window[window, 1]]:
            awake[count] = window
            count += 1
            is_asleep[window] = 0
        elif not is_asleep[window]:
            lane = rows[window, 4]
            for axis in range(3):
                for place in range(axis * BANK_LANES + lane, axis * BANK_LANES + lane + LANE_COUNT):
                    velocity[place] = 0
                    other[place] = now[place]
            is_asleep[window] = 1
    counts[0] = count
    count = 0
    for window in range(len(awake_cells)):
        for touched in touches[window]:
            if touched >= 0 and not is_asleep[touched]:
                awake_cells[count] = window
                count += 1
                break
    counts[1] = count
    return True
