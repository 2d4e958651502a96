"""A strip that lies askew in its cells, bent by a pure moment or pulled: what a thin wall does wherever it lies.

Lengths are in cells, stresses in k/h, so that E = 2.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.elasticity_voxels import COVERAGE_MIN, located, voxelised
from benchmarks.statics import solve_linear, stiffness
from heartcase.schemas.arrays import Bool, Float64, Intp
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import ForceLaw

LENGTH, WIDTH = 12.0, 3
_THIN = 0.75
_SAMPLES, _SAMPLES_OF_THIN = 20, 40
"""Samples of a cell along each axis, and in walls below _THIN: whole numbers of them are in walls of 0.3 cells."""
_PER_CELL = 8


@dataclass(frozen=True)
class Strip:
    """A strip that is tilted about y, then about its own length; in the plane of x and z where it is not rolled."""

    thickness: float
    """In cells."""
    angle_deg: float
    """From the x axis."""
    roll_deg: float = 0.0
    """About its length."""
    start: tuple[float, float, float] = (0.3, 0.0, 0.7)
    """Middle of its first edge, but half the width along y: where it lies in the cells."""

    @property
    def axes(self) -> tuple[Float64, Float64, Float64]:
        """Unit vectors along the strip, through it and across it."""
        a, b = np.radians([self.angle_deg, self.roll_deg])
        along, through = np.array([np.cos(a), 0.0, np.sin(a)]), np.array([-np.sin(a), 0.0, np.cos(a)])
        across = np.array([0.0, 1.0, 0.0])
        return along, np.cos(b) * through - np.sin(b) * across, np.cos(b) * across + np.sin(b) * through

    @property
    def _origin(self) -> Float64:
        return np.array(self.start) + np.array([0.0, WIDTH / 2.0, 0.0])

    def model(self, law: ForceLaw, cell_mm: float, *, coverage_min: float = COVERAGE_MIN) -> LatticeModel:
        """Its cells."""
        samples = _SAMPLES_OF_THIN if self.thickness < _THIN else _SAMPLES
        along, through, across = self.axes

        def is_tissue(x: Float64) -> Bool:
            d = x - self._origin
            on = d @ along
            is_within = (np.abs(d @ through) <= self.thickness / 2.0) & (np.abs(d @ across) <= WIDTH / 2.0)
            return (on >= 0.0) & (on <= LENGTH) & is_within

        def is_near(x: Float64) -> Bool:
            near: Bool = np.abs((x - self._origin) @ through) <= (self.thickness + np.sqrt(3.0)) / 2.0
            return near

        reach = np.abs(through) * self.thickness / 2.0 + np.abs(across) * WIDTH / 2.0
        low = np.floor(self._origin + np.minimum(LENGTH * along, 0.0) - reach).astype(int)
        high = np.ceil(self._origin + np.maximum(LENGTH * along, 0.0) + reach).astype(int)
        low, high = ((int(i), int(j), int(k)) for i, j, k in (low, high))
        options = {"samples": samples, "coverage_min": coverage_min, "is_near": is_near}
        return voxelised(is_tissue, low, high, 1.0, law, cell_mm, **options)

    def rotation_over_beam(self, model: LatticeModel) -> float:
        """Rotation of one end against the other, over M L / (E I), under moments at its ends."""
        along, _, _ = self.axes
        places, height = self._section()
        u = self._under(model, height)
        turns = []
        for place in (0.0, LENGTH):
            slides = self._displacement(model, u, places + place * along) @ along
            turns.append((slides * height).sum() / (height * height).sum())
        moment = (height * height).sum() * self.thickness / _PER_CELL**2
        inertia = WIDTH * self.thickness**3 / 12.0
        return float((turns[1] - turns[0]) * ForceLaw().youngs_modulus * inertia / (moment * LENGTH))

    def stretch_over_bar(self, model: LatticeModel) -> float:
        """Stretch of its middle half over that of a bar, under a stress of one at its ends."""
        along, _, _ = self.axes
        places, height = self._section()
        u = self._under(model, np.ones_like(height))
        near, far = (
            (self._displacement(model, u, places + part * LENGTH * along) @ along).mean() for part in (0.25, 0.75)
        )
        return float((far - near) / (LENGTH / 2.0) * ForceLaw().youngs_modulus)

    def _section(self) -> tuple[Float64, Float64]:
        """Points of the first end, shape (count, 3), and how high they lie from the strip's middle."""
        _, through, across = self.axes
        q = ((np.arange(_PER_CELL) + 0.5) / _PER_CELL - 0.5) * self.thickness
        y = (np.arange(_PER_CELL * WIDTH) + 0.5) / _PER_CELL - WIDTH / 2.0
        Q, Y = (grid.ravel() for grid in np.meshgrid(q, y, indexing="ij"))
        return self._origin + Q[:, None] * through + Y[:, None] * across, Q

    def _under(self, model: LatticeModel, stress: Float64) -> Float64:
        """Displacement under a stress along the strip at the points of its last end, and against it at the first."""
        along, _, _ = self.axes
        places, _ = self._section()
        load = np.zeros((model.node_count, 3))
        for place, sign in ((0.0, -1.0), (LENGTH, 1.0)):
            nodes, shares = located(model, places + place * along)
            pushes = (shares * (sign * stress * self.thickness / _PER_CELL**2)[:, None])[:, :, None] * along
            np.add.at(load, nodes, pushes)
        held = _floating(model)
        u, _ = solve_linear(stiffness(model), load, (held, np.zeros(len(held))))
        return u

    @staticmethod
    def _displacement(model: LatticeModel, u: Float64, points: Float64) -> Float64:
        nodes, shares = located(model, points)
        moved: Float64 = np.einsum("pc,pca->pa", shares, u[nodes])
        return moved


def _floating(model: LatticeModel) -> Intp:
    """Six degrees of freedom that keep it in place; nothing pulls at them, for the loads hold each other."""
    x = model.node_index.astype(float)
    root = int(x.sum(axis=1).argmin())
    away = x - x[root]
    far = int((away * away).sum(axis=1).argmax())
    normals = np.cross(away[far], away)
    side = int((normals * normals).sum(axis=1).argmax())
    # It turns about the first by the far node's two directions across, and about the line by the side's own.
    across = np.delete(np.arange(3), np.abs(away[far]).argmax())
    return np.unique(
        [3 * root, 3 * root + 1, 3 * root + 2, *(3 * far + across), 3 * side + np.abs(normals[side]).argmax()]
    )
