"""Explicit springs in the CPU kernel: they pull before a step."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int64
from heartcase.simulator.engine.cpu.chunks import ChunkArrays
from heartcase.simulator.engine.shared.lanes import BANK_LANES

__all__ = ["Constants", "ExplicitArrays", "pull_explicitly"]

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
