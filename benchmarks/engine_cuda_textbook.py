"""The textbook's loop on a GPU: float32, a thread per node, a neighbour list, one launch per step."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numba import cuda

from heartcase.schemas.arrays import Float32
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.lattice.state import State

__all__ = ["CudaTextbook"]

THREADS = 128


class CudaTextbook:
    """Lists of neighbours by slot, so that threads side by side read side by side."""

    def __init__(self, count: Any, other: Any, rest: Any, weight: Any, mass_inverse: Any, rule: Verlet) -> None:
        self._lists = (
            cuda.to_device(count.astype(np.int32)),
            cuda.to_device(np.ascontiguousarray(other.T, np.int32)),
            cuda.to_device(np.ascontiguousarray(np.moveaxis(rest, 0, -1), np.float32)),
            cuda.to_device(np.ascontiguousarray(weight.T, np.float32)),
        )
        self._mass_inverse = cuda.to_device(mass_inverse.astype(np.float32))
        self._rule = tuple(np.float32(number) for number in (rule.keep, rule.kick, rule.step))

    def load(self, start: State) -> None:
        """Start from this state."""
        self._displacement = [cuda.to_device(np.ascontiguousarray(start.displacement.T)) for _ in range(2)]
        self._velocity = cuda.to_device(np.ascontiguousarray(start.velocity.T))

    def advance(self, step_count: int) -> None:
        """Take steps."""
        blocks = -(-self._mass_inverse.size // THREADS)
        for _ in range(step_count):
            now, later = self._displacement
            _step[blocks, THREADS](now, later, self._velocity, self._mass_inverse, *self._lists, *self._rule)
            self._displacement = [later, now]
        cuda.synchronize()

    def read(self) -> Float32:
        """The displacements."""
        return np.asarray(self._displacement[0].copy_to_host()).T


@cuda.jit(fastmath=True)
def _step(u, later, v, mass_inverse, count, other, rest, weight, keep, kick, step):  # type: ignore[no-untyped-def]
    n = cuda.grid(1)
    if n >= mass_inverse.size:
        return
    ux, uy, uz = u[0, n], u[1, n], u[2, n]
    fx = fy = fz = np.float32(0)
    for s in range(count[n]):
        j = other[s, n]
        rx, ry, rz = rest[s, 0, n], rest[s, 1, n], rest[s, 2, n]
        dx, dy, dz = rx + u[0, j] - ux, ry + u[1, j] - uy, rz + u[2, j] - uz
        length = sqrt(dx * dx + dy * dy + dz * dz)
        pull = weight[s, n] * (length - sqrt(rx * rx + ry * ry + rz * rz)) / length
        fx += pull * dx
        fy += pull * dy
        fz += pull * dz
    m = mass_inverse[n]
    if m > 0:
        v[0, n] = keep * v[0, n] + kick * m * fx
        v[1, n] = keep * v[1, n] + kick * m * fy
        v[2, n] = keep * v[2, n] + kick * m * fz
    later[0, n] = ux + step * v[0, n]
    later[1, n] = uy + step * v[1, n]
    later[2, n] = uz + step * v[2, n]
