"""The spring lattice written plainly in NVIDIA Warp, on the CPU: a neighbour list, float32. Not ours: a peer."""

import tempfile
from pathlib import Path

import numpy as np
import warp as wp

from heartcase.schemas.arrays import Float, Float32, Integer
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.lattice.state import State

wp.config.log_level = wp.LOG_ERROR
wp.config.kernel_cache_dir = str(Path(tempfile.gettempdir()) / "heartcase-benchmark-warp")

__all__ = ["WarpLattice"]


@wp.kernel
def _step(
    now: wp.array(dtype=wp.vec3),
    later: wp.array(dtype=wp.vec3),
    velocity: wp.array(dtype=wp.vec3),
    count: wp.array(dtype=wp.int32),
    other: wp.array2d(dtype=wp.int32),
    rest: wp.array2d(dtype=wp.vec3),
    rest_length: wp.array2d(dtype=wp.float32),
    weight: wp.array2d(dtype=wp.float32),
    mass_inverse: wp.array(dtype=wp.float32),
    keep: wp.float32,
    kick: wp.float32,
    step: wp.float32,
):  # type: ignore[no-untyped-def]
    n = wp.tid()
    own = now[n]
    force = wp.vec3(0.0, 0.0, 0.0)
    for s in range(count[n]):
        d = rest[n, s] + (now[other[n, s]] - own)
        length = wp.length(d)
        force += weight[n, s] * (length - rest_length[n, s]) / length * d
    v = velocity[n]
    if mass_inverse[n] > 0.0:
        v = keep * v + kick * mass_inverse[n] * force
        velocity[n] = v
    later[n] = own + step * v


class WarpLattice:
    """Arrays of a lattice, and the two launches that steps alternate between."""

    def __init__(
        self,
        count: Integer,
        other: Integer,
        rest: Float,
        weight: Float,
        mass_inverse: Float,
        rule: Verlet,
    ) -> None:
        # No gradients: the kernel need not be compiled backwards too.
        wp.set_module_options({"enable_backward": False})
        node_count = len(count)
        with wp.ScopedDevice("cpu"):
            constants = [
                wp.array(count, dtype=wp.int32),
                wp.array(other, dtype=wp.int32),
                wp.array(rest, dtype=wp.vec3),
                wp.array(np.linalg.norm(rest, axis=2), dtype=wp.float32),
                wp.array(weight, dtype=wp.float32),
                wp.array(mass_inverse, dtype=wp.float32),
                rule.keep,
                rule.kick,
                rule.step,
            ]
            self._displacement = [wp.zeros(node_count, dtype=wp.vec3) for _ in range(2)]
            self._velocity = wp.zeros(node_count, dtype=wp.vec3)
            self._current = 0
            # Recorded: the arguments are packed once, not at every launch.
            self._launches = [
                wp.launch(
                    _step,
                    dim=node_count,
                    inputs=[self._displacement[k], self._displacement[1 - k], self._velocity, *constants],
                    record_cmd=True,
                )
                for k in range(2)
            ]

    def load(self, start: State) -> None:
        """Start from this state."""
        self._displacement[self._current].assign(start.displacement)
        self._velocity.assign(start.velocity)

    def advance(self, step_count: int) -> None:
        """Take steps."""
        for _ in range(step_count):
            self._launches[self._current].launch()
            self._current = 1 - self._current

    def read(self) -> Float32:
        """The displacements."""
        displacement: Float32 = self._displacement[self._current].numpy().copy()
        return displacement
