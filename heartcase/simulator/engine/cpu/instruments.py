"""Explicit springs in the CPU kernel: they pull before a step."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int64
from heartcase.simulator.engine.shared.lanes import BANK_LANES

__all__ = ["Constants", "ExplicitArrays", "pull_explicitly"]

Constants = tuple[np.float32, ...]
ExplicitArrays = tuple[Int64, Int64, Int64, Float32, Float32]
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
    now: Float32, velocity: Float32, inverse_mass: Float32, explicit: ExplicitArrays, constants: Constants
) -> None:
    """Give the velocities before a step what the explicit springs will add to them in it.

    The step keeps a part of the velocity, so they are given the more.
    """
    lanes, first, other, offset, stiffness = explicit
    for number in range(len(lanes)):
        lane = lanes[number]
        own = _vector(now, lane)
        x, y, z = np.float32(0), np.float32(0), np.float32(0)
        for spring in range(first[number], first[number + 1]):
            there = other[spring]
            way = _apart(now, there, own)
            dx, dy, dz = offset[spring, 0] + way[0], offset[spring, 1] + way[1], offset[spring, 2] + way[2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            if length > 0:
                pull = stiffness[spring] * (length - offset[spring, 3]) / length
                x, y, z = x + pull * dx, y + pull * dy, z + pull * dz
        scale = constants[2] / constants[1] * inverse_mass[lane]
        for axis, force in enumerate((x, y, z)):
            velocity[axis * BANK_LANES + lane] += scale * force
