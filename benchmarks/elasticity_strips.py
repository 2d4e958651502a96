"""A strip that lies askew in its cells, bent by a pure moment: what a thin wall does wherever it lies.

Lengths are in cells, stresses in k/h, so that E = 2.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from elasticity_voxels import located, voxelised
from statics import solve_linear, stiffness

from heartcase.simulator.force_law import ForceLaw
from heartcase.simulator.model import LatticeModel

Float64 = npt.NDArray[np.float64]

LENGTH, WIDTH = 12.0, 3
_START = (0.3, 0.0, 0.7)


@dataclass(frozen=True)
class Strip:
    """A strip in the plane of x and z, whole cells wide along y."""

    thickness: float
    """In cells."""
    angle_deg: float
    """From the x axis."""

    @property
    def axes(self) -> tuple[Float64, Float64]:
        """Unit vectors along the strip and through it."""
        a = np.radians(self.angle_deg)
        return np.array([np.cos(a), 0.0, np.sin(a)]), np.array([-np.sin(a), 0.0, np.cos(a)])

    def model(self, law: ForceLaw, cell_mm: float) -> LatticeModel:
        """Its cells."""
        along, through = self.axes

        def is_tissue(x: Float64) -> npt.NDArray[np.bool_]:
            d = x - _START
            on = d @ along
            return (on >= 0.0) & (on <= LENGTH) & (np.abs(d @ through) <= self.thickness / 2.0)

        high = np.ceil(_START + LENGTH * along + 2.0).astype(int)
        return voxelised(is_tissue, (-2, 0, -2), (int(high[0]), WIDTH, int(high[2])), 1.0, law, cell_mm)

    def rotation_over_beam(self, model: LatticeModel) -> float:
        """Rotation of one end against the other, over M L / (E I)."""
        along, through = self.axes
        per_cell = 8
        q = ((np.arange(per_cell) + 0.5) / per_cell - 0.5) * self.thickness
        y = (np.arange(per_cell * WIDTH) + 0.5) / per_cell
        Q, Y = (grid.ravel() for grid in np.meshgrid(q, y, indexing="ij"))
        share = self.thickness / per_cell / per_cell
        section = _START + Q[:, None] * through + Y[:, None] * np.array([0.0, 1.0, 0.0])
        load = np.zeros((model.node_count, 3))
        ends = [located(model, section + place * along) for place in (0.0, LENGTH)]
        for (nodes, shares), sign in zip(ends, (-1.0, 1.0), strict=True):
            pushes = (shares * (sign * Q * share)[:, None])[:, :, None] * along
            np.add.at(load, nodes, pushes)
        held = _floating(model)
        u, _ = solve_linear(stiffness(model), load, (held, np.zeros(len(held))))
        turns = []
        for nodes, shares in ends:
            slides = np.einsum("pc,pca->pa", shares, u[nodes]) @ along
            turns.append((slides * Q).sum() / (Q * Q).sum())
        moment = (Q * Q).sum() * share
        inertia = WIDTH * self.thickness**3 / 12.0
        return float((turns[1] - turns[0]) * ForceLaw().youngs_modulus * inertia / (moment * LENGTH))


def _floating(model: LatticeModel) -> npt.NDArray[np.intp]:
    """Six degrees of freedom that keep it in place; nothing pulls at them, for the moments hold each other."""
    x = model.node_index
    root = int((x[:, 0] + x[:, 1] + x[:, 2]).argmin())
    far = int(np.where(x[:, 1] == x[root, 1], x[:, 0], -1).argmax())
    side = int(np.where((x[:, [0, 2]] == x[root, [0, 2]]).all(axis=1), x[:, 1], -1).argmax())
    # turns about x by the side's z, about y by the far end's z, about z by the far end's y
    return np.unique([3 * root, 3 * root + 1, 3 * root + 2, 3 * far + 1, 3 * far + 2, 3 * side + 2])
