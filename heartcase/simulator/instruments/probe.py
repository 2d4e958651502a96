"""The probe: pushes aside what it touches (thesis 8.7.1; :mod:`heartcase.simulator.engine.shared.contact`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float32, Float64, Intp
from heartcase.simulator.engine.shared.contact import probe_row
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["Probe"]

TOUCH = 1e-3
"""Part of its size within which a node counts as touched by a probe: where it was pushed to is rounded."""


@dataclass(eq=False)
class Probe:
    """An ellipsoid that pushes nodes out of itself."""

    semi_axes: Float64
    """Semi-axes [cells], shape (3,)."""
    turn: Float64
    """Directions of the semi-axes in its columns, grid axes, shape (3, 3)."""
    centre: Float64
    """Where it is [cells, grid axes]."""
    target: Float64
    """Where it shall be at the end of the next steps [cells, grid axes]."""
    name: str = "probe"
    """Name in messages."""

    def row(self, step_count: int) -> Float32:
        """The probe on its way to the target, as the kernels read it."""
        return probe_row(self.centre, (self.target - self.centre) / step_count, self.semi_axes, self.turn)

    def touched(self, model: LatticeModel, displacement: Float32) -> Intp:
        """Free nodes on its surface or in it now.

        Parameters
        ----------
        model
            The lattice.
        displacement
            Way of each node from its rest position [cells], float32, shape (node_count, 3).
        """
        from_centre = (model.node_index + displacement - self.centre) @ self.turn / self.semi_axes
        is_touched = np.linalg.norm(from_centre, axis=1) <= 1.0 + TOUCH
        return np.flatnonzero(is_touched & ~model.node_is_fixed)
