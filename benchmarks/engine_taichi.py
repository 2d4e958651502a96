"""The spring lattice written plainly in Taichi: a neighbour list, float32, all threads. Not ours: a peer."""

import contextlib
import io
import os

import numpy as np

from heartcase.schemas.arrays import Float, Float32, Integer
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.lattice.state import State

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

import taichi as ti

__all__ = ["TaichiLattice"]

STEPS_PER_CALL = 10
"""Steps unrolled into one kernel, each a parallel loop of its own: a call from Python costs as much as part of a step.
Even, so that the displacement is back in the first of its two fields."""


class TaichiLattice:
    """Fields of a lattice, and the compiled kernel."""

    def __init__(
        self,
        count: Integer,
        other: Integer,
        rest: Float,
        weight: Float,
        mass_inverse: Float,
        rule: Verlet,
    ) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            ti.init(arch=ti.cpu, default_fp=ti.f32, offline_cache=False)
        node_count, slots = other.shape
        spring = ti.types.struct(other=ti.i32, rest=ti.math.vec3, length=ti.f32, weight=ti.f32)
        springs = spring.field(shape=(node_count, slots))
        springs.other.from_numpy(other.astype(np.int32))
        springs.rest.from_numpy(rest.astype(np.float32))
        springs.length.from_numpy(np.linalg.norm(rest, axis=2).astype(np.float32))
        springs.weight.from_numpy(weight.astype(np.float32))
        spring_count = ti.field(ti.i32, node_count)
        spring_count.from_numpy(count.astype(np.int32))
        inverse = ti.field(ti.f32, node_count)
        inverse.from_numpy(mass_inverse.astype(np.float32))
        displacement = [ti.Vector.field(3, ti.f32, node_count) for _ in range(2)]
        velocity = ti.Vector.field(3, ti.f32, node_count)
        keep, kick, step = rule.keep, rule.kick, rule.step

        @ti.kernel
        def steps():  # type: ignore[no-untyped-def]
            for number in ti.static(range(STEPS_PER_CALL)):
                now, later = ti.static(displacement[number % 2], displacement[1 - number % 2])
                for n in velocity:
                    own = now[n]
                    force = ti.math.vec3(0.0)
                    for s in range(spring_count[n]):
                        spring = springs[n, s]
                        d = spring.rest + (now[spring.other] - own)
                        length = d.norm()
                        force += spring.weight * (length - spring.length) / length * d
                    v = velocity[n]
                    if inverse[n] > 0.0:
                        v = keep * v + kick * inverse[n] * force
                        velocity[n] = v
                    later[n] = own + step * v

        self._displacement, self._velocity, self._steps = displacement[0], velocity, steps

    def load(self, start: State) -> None:
        """Start from this state."""
        self._displacement.from_numpy(start.displacement)
        self._velocity.from_numpy(start.velocity)

    def advance(self, step_count: int) -> None:
        """Take steps: a multiple of STEPS_PER_CALL."""
        assert step_count % STEPS_PER_CALL == 0
        for _ in range(step_count // STEPS_PER_CALL):
            self._steps()
        ti.sync()

    def read(self) -> Float32:
        """The displacements."""
        displacement: Float32 = self._displacement.to_numpy()
        return displacement
