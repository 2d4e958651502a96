"""What the CPU kernel does for hands: explicit springs pull before a step, probes push after it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from heartcase.simulator.contact import make_contact
from heartcase.simulator.lanes import LANE_COUNT

__all__ = ["Constants", "ExplicitArrays", "keep_window_outside", "pull_explicitly"]

Float32 = npt.NDArray[np.float32]
Int64 = npt.NDArray[np.int64]
Constants = tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]
ExplicitArrays = tuple[Int64, Int64, Int64, Float32, Float32]


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def pull_explicitly(
    now: Float32, velocity: Float32, inverse_mass: Float32, explicit: ExplicitArrays, constants: Constants
) -> None:
    """Give the velocities before a step what the explicit springs will add to them in it.

    The step keeps a part of the velocity, so they are given the more.
    """
    lanes, first, other, offset, stiffness = explicit
    for number in range(len(lanes)):
        lane = lanes[number]
        x, y, z = np.float32(0), np.float32(0), np.float32(0)
        for spring in range(first[number], first[number + 1]):
            there = other[spring]
            dx = offset[spring, 0] + (now[0, there] - now[0, lane])
            dy = offset[spring, 1] + (now[1, there] - now[1, lane])
            dz = offset[spring, 2] + (now[2, there] - now[2, lane])
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            if length > 0:
                pull = stiffness[spring] * (length - offset[spring, 3]) / length
                x, y, z = x + pull * dx, y + pull * dy, z + pull * dz
        scale = constants[2] / constants[1] * inverse_mass[0, lane]
        for axis, force in enumerate((x, y, z)):
            velocity[axis, lane] += scale * force


_pushed_out, _allowed_share = make_contact(njit(nogil=True))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def keep_window_outside(
    now: Float32,
    later: Float32,
    velocity: Float32,
    presence: Float32,
    inverse_mass: Float32,
    rest: Float32,
    row: Int64,
    probes: Float32,
    step_number: int,
    step: np.float32,
) -> None:
    """Keep the nodes of a window out of the probes after a step; see :mod:`heartcase.simulator.contact`."""
    for place in range(LANE_COUNT):
        lane = row[4] + place
        if inverse_mass[0, lane] <= 0:
            continue
        u = (later[0, lane], later[1, lane], later[2, lane])
        start = u
        is_near = False
        for probe in range(len(probes)):
            u, is_in_reach = _pushed_out((rest[0, lane], rest[1, lane], rest[2, lane]), u, probes[probe], step_number)
            is_near = is_near or is_in_reach
        if not is_near:
            continue
        own = (now[0, lane], now[1, lane], now[2, lane])
        m = (u[0] - own[0], u[1] - own[1], u[2] - own[2])
        left, near, below = lane - 1, row[3] + place, row[1] + place
        far, above = row[5] + place, row[7] + place
        one = np.float32(1)
        ahead = (
            (now[0, lane + 1] - own[0] + one, now[1, lane + 1] - own[1], now[2, lane + 1] - own[2]),
            (now[0, far] - own[0], now[1, far] - own[1] + one, now[2, far] - own[2]),
            (now[0, above] - own[0], now[1, above] - own[1], now[2, above] - own[2] + one),
        )
        behind = (
            (now[0, left] - own[0] - one, now[1, left] - own[1], now[2, left] - own[2]),
            (now[0, near] - own[0], now[1, near] - own[1] - one, now[2, near] - own[2]),
            (now[0, below] - own[0], now[1, below] - own[1], now[2, below] - own[2] - one),
        )
        has_ahead = (presence[0, lane] > 0, presence[2, lane] > 0, presence[6, lane] > 0)
        has_behind = (presence[0, left] > 0, presence[2, near] > 0, presence[6, below] > 0)
        share = _allowed_share(m, ahead, behind, has_ahead, has_behind)
        if share < 1 or u != start:
            for axis, way in enumerate(m):
                later[axis, lane] = own[axis] + share * way
                velocity[axis, lane] = share * way / step
