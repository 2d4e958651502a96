"""Instruments in the CPU kernel: explicit springs pull before a step, probes push after it."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int64
from heartcase.simulator.engine.cpu.chunks import ChunkArrays
from heartcase.simulator.engine.shared.contact import make_contact
from heartcase.simulator.engine.shared.lanes import BANK_LANES, LANE_COUNT

__all__ = ["Constants", "ExplicitArrays", "keep_window_outside", "pull_explicitly"]

Constants = tuple[np.float32, ...]
ExplicitArrays = tuple[Int64, Int64, Int64, Int64, Float32, Float32, Float32]
Vector = tuple[np.float32, np.float32, np.float32]


@kernel(cached=False)
def _vector(array: Float32, lane: int) -> Vector:
    return array[lane], array[BANK_LANES + lane], array[2 * BANK_LANES + lane]


@kernel(cached=False)
def _apart(array: Float32, lane: int, own: Vector) -> Vector:
    there = _vector(array, lane)
    return there[0] - own[0], there[1] - own[1], there[2] - own[2]


@kernel
def pull_explicitly(
    chunk: int,
    now: Float32,
    velocity: Float32,
    inverse_mass: Float32,
    explicit: ExplicitArrays,
    constants: Constants,
    chunks: ChunkArrays,
) -> None:
    """Give a chunk's velocities before a step what the explicit springs will add to them in it.

    The step keeps a part of the velocity, so they are given the more.
    """
    lanes, windows, first, other, offset, excess, stiffness = explicit
    for number in range(len(lanes)):
        if chunks.chunk_of[windows[number]] != chunk:
            continue
        lane = lanes[number]
        own = _vector(now, lane)
        x, y, z = np.float32(0), np.float32(0), np.float32(0)
        for spring in range(first[number], first[number + 1]):
            there = other[spring]
            wx, wy, wz = _apart(now, there, own)
            ox, oy, oz = offset[spring, 0], offset[spring, 1], offset[spring, 2]
            dx, dy, dz = ox + wx, oy + wy, oz + wz
            square = dx * dx + dy * dy + dz * dz
            if square > 0:
                e = (ox + dx) * wx + (oy + dy) * wy + (oz + dz) * wz + excess[spring]
                pull = stiffness[spring] * e / (square + offset[spring, 3] * np.sqrt(square))
                x, y, z = x + pull * dx, y + pull * dy, z + pull * dz
        scale = constants[2] / constants[1] * inverse_mass[lane]
        for axis, force in enumerate((x, y, z)):
            velocity[axis * BANK_LANES + lane] += scale * force


_pushed_out, _allowed_share = make_contact(kernel(cached=False))


@kernel
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
    """Keep a window's nodes out of the probes after a step; see :mod:`heartcase.simulator.engine.shared.contact`."""
    for place in range(LANE_COUNT):
        lane = row[4] + place
        if inverse_mass[lane] <= 0:
            continue
        u = _vector(later, lane)
        start = u
        is_near = False
        for probe in range(len(probes)):
            u, is_in_reach = _pushed_out(_vector(rest, lane), u, probes[probe], step_number)
            is_near = is_near or is_in_reach
        if not is_near:
            continue
        own = _vector(now, lane)
        m = (u[0] - own[0], u[1] - own[1], u[2] - own[2])
        left, near, below = lane - 1, row[3] + place, row[1] + place
        right, far, above = lane + 1, row[5] + place, row[7] + place
        one = np.float32(1)
        along, across, up = _apart(now, right, own), _apart(now, far, own), _apart(now, above, own)
        ahead = (
            (along[0] + one, along[1], along[2]),
            (across[0], across[1] + one, across[2]),
            (up[0], up[1], up[2] + one),
        )
        along, across, up = _apart(now, left, own), _apart(now, near, own), _apart(now, below, own)
        behind = (
            (along[0] - one, along[1], along[2]),
            (across[0], across[1] - one, across[2]),
            (up[0], up[1], up[2] - one),
        )
        has_ahead = (presence[lane] > 0, presence[2 * BANK_LANES + lane] > 0, presence[6 * BANK_LANES + lane] > 0)
        has_behind = (presence[left] > 0, presence[2 * BANK_LANES + near] > 0, presence[6 * BANK_LANES + below] > 0)
        share = _allowed_share(m, ahead, behind, has_ahead, has_behind)
        if share < 1 or u != start:
            for axis, way in enumerate(m):
                later[axis * BANK_LANES + lane] = own[axis] + share * way
                velocity[axis * BANK_LANES + lane] = share * way / step
