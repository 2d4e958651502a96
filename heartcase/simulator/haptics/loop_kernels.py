"""One update of the servo loop in one kernel: :func:`heartcase.simulator.haptics.loop.servo_update` on numbers.

Beside a simulation that fills the caches, NumPy takes a third of a millisecond for it now and then.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.haptics.energy import KEPT, STILL_MM_S
from heartcase.simulator.haptics.poses import NEARLY_HALF_RAD, SMALL_RAD
from heartcase.simulator.haptics.settings import SECONDS_MOST

__all__ = [
    "ACCOUNT",
    "EARLIER",
    "HAND",
    "LOAD",
    "LOOP_WIDTH",
    "MOTION",
    "PART",
    "TIME",
    "TOOL",
    "WITHIN",
    "advance_loop",
]

TIME, HAND, TOOL, MOTION, WITHIN, LOAD, PART, ACCOUNT, EARLIER, LOOP_WIDTH = 0, 1, 13, 25, 31, 37, 43, 44, 46, 52
"""Where in the loop's numbers the parts of a ``ServoState`` begin, and how many there are.

Poses are a position and a rotation row by row, loads and motions two rows of three, the account what was put in and
what came back.
"""
_TURN = 3
"""Where in a pose its rotation begins."""
_SAMPLE_POSE, _SAMPLE_LOAD, _SAMPLE_STIFFNESS = 1, 13, 19


@kernel(cached=False)
def _set_gap(gap, one, other):
    """What leads from a pose to another: way, and rotation vector."""
    for axis in range(3):
        gap[axis] = other[axis] - one[axis]
    turn = np.empty(9)
    for row in range(3):
        for column in range(3):
            turn[3 * row + column] = (
                other[_TURN + 3 * row] * one[_TURN + 3 * column]
                + other[_TURN + 3 * row + 1] * one[_TURN + 3 * column + 1]
                + other[_TURN + 3 * row + 2] * one[_TURN + 3 * column + 2]
            )
    x, y, z = turn[7] - turn[5], turn[2] - turn[6], turn[3] - turn[1]
    angle = atan2(sqrt(x * x + y * y + z * z), turn[0] + turn[4] + turn[8] - 1.0)
    if angle < np.pi - NEARLY_HALF_RAD:
        scale = 0.5 if angle < SMALL_RAD else angle / (2.0 * sin(angle))
        gap[3], gap[4], gap[5] = scale * x, scale * y, scale * z
        return
    # Near half a turn the sine says little: the axis is the largest column of the symmetric part.
    best, largest = 0, -2.0
    for axis in range(3):
        if turn[4 * axis] > largest:
            best, largest = axis, turn[4 * axis]
    square = 0.0
    for axis in range(3):
        gap[3 + axis] = (turn[3 * axis + best] + turn[3 * best + axis]) / 2.0
        if axis == best:
            gap[3 + axis] -= cos(angle)
        square += gap[3 + axis] * gap[3 + axis]
    along = gap[3] * x + gap[4] * y + gap[5] * z
    scale = (angle if along >= 0.0 else -angle) / sqrt(square)
    for axis in range(3, 6):
        gap[axis] *= scale


@kernel(cached=False)
def _move(pose, way):
    """Move a pose by a way and a rotation vector."""
    for axis in range(3):
        pose[axis] += way[axis]
    x, y, z = way[3], way[4], way[5]
    angle = sqrt(x * x + y * y + z * z)
    square = angle * angle
    s, c = 1.0, 0.0
    if angle >= SMALL_RAD:
        s, c = sin(angle) / angle, (1.0 - cos(angle)) / square
    first = (1.0 + c * (x * x - square), c * x * y - s * z, c * x * z + s * y)
    second = (c * x * y + s * z, 1.0 + c * (y * y - square), c * y * z - s * x)
    third = (c * x * z - s * y, c * y * z + s * x, 1.0 + c * (z * z - square))
    for column in range(3):
        a, b, d = pose[_TURN + column], pose[_TURN + 3 + column], pose[_TURN + 6 + column]
        pose[_TURN + column] = first[0] * a + first[1] * b + first[2] * d
        pose[_TURN + 3 + column] = second[0] * a + second[1] * b + second[2] * d
        pose[_TURN + 6 + column] = third[0] * a + third[1] * b + third[2] * d


@kernel(cached=False)
def _size(load, row):
    return sqrt(load[3 * row] ** 2 + load[3 * row + 1] ** 2 + load[3 * row + 2] ** 2)


@kernel
def advance_loop(loop, time_s, waited_s, hand, hand_motion, has_tissue, tissue, settings):
    """Take the loop to its next update.

    Parameters
    ----------
    loop
        Numbers of the loop, written, float64, shape (LOOP_WIDTH,).
    time_s, waited_s
        The time now, and the time from the update before until what it gave was put out, s.
    hand, hand_motion
        What the device says: pose, mm, float64, shape (12,), and motion, mm/s, rad/s, shape (6,).
    has_tissue, tissue
        Whether there is a state of the tissue, and the newest, as of ``TissueSample.row``, shape (21,).
    settings
        Period, ages of the fade, time of its rise, and of spending, s; the account's damping, N s/mm; then by
        twos, for force and torque: stiffness, damping, mass, most of the tissue's stiffness, lever, limit, slew of
        ``ServoSettings``; shape (20,).
    """
    period_s, full_for_s, none_from_s, rise_s = settings[0], settings[1], settings[2], settings[3]
    spending_s, payback = settings[4], settings[5]
    gap, moved, pull, wanted = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    old_hand, tool, motion = loop[HAND:TOOL], loop[TOOL:MOTION], loop[MOTION:WITHIN]
    within, load, earlier = loop[WITHIN:LOAD], loop[LOAD:PART], loop[EARLIER:LOOP_WIDTH]
    seconds = max(time_s - loop[TIME], 0.0)
    dt = min(max(seconds, 0.1 * period_s), SECONDS_MOST)

    # The account at the hand.
    _set_gap(moved, old_hand, hand)
    waited = min(waited_s, seconds) / seconds if seconds > 0.0 else 0.0
    work = 0.0
    for axis in range(6):
        work += (load[axis] + waited * (earlier[axis] - load[axis])) * moved[axis]
        earlier[axis] = load[axis]
    loop[ACCOUNT] += max(-work, 0.0)
    loop[ACCOUNT + 1] += max(work, 0.0)
    credit_mj = (1.0 - KEPT) * loop[ACCOUNT] - loop[ACCOUNT + 1]

    # The part that is put out.
    part = 0.0
    if has_tissue:
        fading = (none_from_s - (time_s - tissue[0])) / (none_from_s - full_for_s)
        part = min(max(fading, 0.0), loop[PART] + seconds / rise_s, 1.0)

    # The tool behind the coupling.
    is_felt = has_tissue and part > 0.0
    way = np.empty(6)
    if is_felt:
        _set_gap(way, tissue[_SAMPLE_POSE:_SAMPLE_LOAD], tool)
    _set_gap(gap, tool, hand)
    for row in range(2):
        stiffness, damping, mass, tissue_most = (
            settings[6 + row],
            settings[8 + row],
            settings[10 + row],
            settings[12 + row],
        )
        yields = 0.0
        if is_felt:
            yields = min(max(tissue[_SAMPLE_STIFFNESS + row], 0.0), tissue_most)
        held = mass + dt * damping + dt * dt * (stiffness + yields)
        for axis in range(3 * row, 3 * row + 3):
            wish = stiffness * gap[axis] + damping * hand_motion[axis]
            if is_felt:
                wish += tissue[_SAMPLE_LOAD + axis] - yields * way[axis]
            motion[axis] = (mass * motion[axis] + dt * wish) / held
            pull[axis] = -(stiffness * (gap[axis] - dt * motion[axis]) + damping * (hand_motion[axis] - motion[axis]))
    for axis in range(6):
        way[axis] = dt * motion[axis]
    _move(tool, way)

    # What the account allows of it.
    square, power = 0.0, 0.0
    for axis in range(6):
        speed = moved[axis] / dt
        power += pull[axis] * speed
        speed *= settings[14 + axis // 3]
        square += speed * speed
    taken = 0.0
    if square >= STILL_MM_S * STILL_MM_S:
        taken = max(power - max(credit_mj, 0.0) / spending_s, 0.0) / square
        if credit_mj < 0.0:
            taken += min(payback, -credit_mj / (square * period_s))
    for axis in range(6):
        lever = settings[14 + axis // 3]
        wanted[axis] = pull[axis] - taken * (moved[axis] / dt) * lever * lever

    # Limits of size and change, then the fade.
    for row in range(2):
        most = settings[16 + row]
        size = _size(wanted, row)
        if size > most:
            for axis in range(3 * row, 3 * row + 3):
                wanted[axis] *= most / size
        for axis in range(3 * row, 3 * row + 3):
            wanted[axis] -= within[axis]
        most, size = settings[18 + row] * seconds, _size(wanted, row)
        share = most / size if size > most else 1.0
        for axis in range(3 * row, 3 * row + 3):
            within[axis] += wanted[axis] * share
            load[axis] = part * within[axis]
    loop[TIME], loop[PART] = time_s, part
    for axis in range(12):
        old_hand[axis] = hand[axis]
