"""The probe: pushes aside what it touches (thesis 8.7.1; :mod:`heartcase.simulator.engine.shared.contact`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Float64, Intp
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.engine.shared.contact import probe_row
from heartcase.simulator.instruments.placing import is_point, point_in_lattice, turn_in_grid
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["Probe", "make_probe"]

PROBE_MIN = 0.5
"""Smallest semi-axis of a probe [cells]."""
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


def make_probe(
    model: LatticeModel,
    center_mm: npt.ArrayLike,
    semi_axes_mm: npt.ArrayLike,
    *,
    turn: npt.ArrayLike | None = None,
    name: str = "probe",
) -> Probe:
    """A probe at a place of the lattice.

    Parameters
    ----------
    model
        The lattice.
    center_mm
        Its centre, LPS mm, shape (3,).
    semi_axes_mm
        Semi-axes of the ellipsoid, mm, shape (3,), or the radius of a ball; at least half a cell.
    turn
        Directions of the semi-axes in its columns, LPS axes, shape (3, 3); those of LPS when left out.
    name
        Name in messages.

    Raises
    ------
    SimulationError
        A number is not finite, a semi-axis too small, or the turn no rotation.
    """
    semi_axes = np.full(3, np.nan)
    if np.shape(semi_axes_mm) in ((), (3,)):
        semi_axes = np.broadcast_to(np.asarray(semi_axes_mm, dtype=float), 3) / model.cell_mm
    problems = []
    if not is_point(center_mm):
        problems.append(Problem(name, "the centre must be three finite numbers"))
    if not (np.isfinite(semi_axes) & (semi_axes >= PROBE_MIN)).all():
        least = PROBE_MIN * model.cell_mm
        problems.append(Problem(name, f"give a radius or three semi-axes of at least half a cell, {least:.3g} mm"))
    if problems:
        raise SimulationError(problems)
    direction = model.geometry.direction_matrix
    axes = direction.T @ np.eye(3) if turn is None else turn_in_grid(model, turn, name) @ direction.T
    centre = point_in_lattice(model, center_mm)
    return Probe(semi_axes=semi_axes, turn=axes, centre=centre, target=centre, name=name)
