"""The swinging bar in Newton, a physics engine on NVIDIA Warp, on the CPU: its VBD and XPBD. Not ours: a peer."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Literal

import newton
import numpy as np
import warp as wp

from heartcase.schemas.arrays import Float32, Float64, Int64
from heartcase.simulator.lattice.model import LatticeModel

wp.config.log_level = wp.LOG_ERROR
wp.config.kernel_cache_dir = str(Path(tempfile.gettempdir()) / "heartcase-benchmark-warp")

__all__ = ["NewtonBar", "Solver"]

Solver = Literal["vbd", "xpbd", "xpbd_springs"]
"""Vertex block descent on tetrahedra, and extended position-based dynamics on these or on the lattice's own springs."""

_FIVE_TETRAHEDRA = (
    ((1, 2, 4, 7), (0, 1, 2, 4), (3, 1, 7, 2), (5, 1, 4, 7), (6, 2, 7, 4)),
    ((0, 3, 5, 6), (1, 0, 3, 5), (2, 0, 6, 3), (4, 0, 5, 6), (7, 3, 6, 5)),
)
"""Corners of a cube's five tetrahedra, corner number x + 2 y + 4 z, for cells whose index is even or odd in sum."""


class NewtonBar:
    """A lattice's nodes as particles, free in space and without gravity, and what holds them together.

    Parameters
    ----------
    model
        Of cells that all are full and alike.
    displacement
        Where the nodes begin, at rest [cells], shape (node_count, 3).
    solver
        What steps it.
    iterations
        Of the solver in a step.
    youngs_pa, ratio, density
        Of the tissue.
    """

    def __init__(
        self,
        model: LatticeModel,
        displacement: Float32,
        *,
        solver: Solver,
        iterations: int,
        youngs_pa: float,
        ratio: float,
        density: float,
    ) -> None:
        self.length_m = float(model.units.length_m)
        rest = model.node_index.astype(float)
        rest = (rest - rest.mean(axis=0)) * self.length_m
        mass = np.zeros(model.node_count)
        np.add.at(mass, model.cell_corners, density * self.length_m**3 / 8.0)
        with wp.ScopedDevice("cpu"):
            builder = newton.ModelBuilder(gravity=wp.vec3(0.0, 0.0, 0.0))
            for place, weight in zip(rest, mass, strict=True):
                builder.add_particle(wp.vec3(*place), wp.vec3(0.0, 0.0, 0.0), float(weight), radius=1e-6)
            if solver == "xpbd_springs":
                stiffness = model.acting_weight.astype(float) * model.units.force_n / self.length_m
                for (low, high), one in zip(model.spring_nodes, stiffness, strict=True):
                    builder.add_spring(int(low), int(high), float(one), 0.0, 0.0)
            else:
                shear = youngs_pa / (2.0 * (1.0 + ratio))
                lame = 2.0 * shear * ratio / (1.0 - 2.0 * ratio)
                for corners in tetrahedra(model):
                    builder.add_tetrahedron(*(int(one) for one in corners), shear, lame, 0.0)
            if solver == "vbd":
                builder.color()
            self._model = builder.finalize(device="cpu")
            self._now, self._next = self._model.state(), self._model.state()
            self._control = self._model.control()
            self._rest = rest
            start = rest + displacement.astype(float) * self.length_m
            self._now.particle_q.assign(start.astype(np.float32))
            if solver == "vbd":
                self._solver = newton.solvers.SolverVBD(
                    self._model,
                    iterations=iterations,
                    particle_enable_self_contact=False,
                    particle_enable_tile_solve=False,
                )
            else:
                self._solver = newton.solvers.SolverXPBD(self._model, iterations=iterations)

    def step(self, count: int, step_s: float) -> None:
        """Take steps."""
        with wp.ScopedDevice("cpu"):
            for _ in range(count):
                self._now.clear_forces()
                self._solver.step(self._now, self._next, self._control, None, step_s)
                self._now, self._next = self._next, self._now

    @property
    def displacement(self) -> Float64:
        """Displacement of the nodes [cells], shape (node_count, 3)."""
        moved: Float64 = (self._now.particle_q.numpy().astype(float) - self._rest) / self.length_m
        return moved


def tetrahedra(model: LatticeModel) -> Int64:
    """Each cell as five tetrahedra that meet those beside it face to face, shape (5 cell_count, 4)."""
    corners = model.cell_corners.astype(np.int64)
    places = model.node_index[corners] - model.node_index[corners].min(axis=1, keepdims=True)
    order = np.argsort(places @ np.array([1, 2, 4]), axis=1)
    corners = np.take_along_axis(corners, order, axis=1)
    odd = model.cells.sum(axis=1) % 2
    found = np.array(_FIVE_TETRAHEDRA)[odd]
    tets: Int64 = np.take_along_axis(corners[:, None], found.reshape(len(corners), 1, 20), axis=2).reshape(-1, 4)
    edges = model.node_index[tets[:, 1:]] - model.node_index[tets[:, :1]]
    volume = np.linalg.det(edges.astype(float))
    tets[volume < 0] = tets[volume < 0][:, [0, 2, 1, 3]]
    return tets
