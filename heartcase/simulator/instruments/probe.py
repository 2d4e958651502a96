"""The probe: pushes aside what it touches (thesis 8.7.1; :mod:`heartcase.simulator.engine.shared.contact`)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Float64, Intp
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.engine.shared.contact import probe_row
from heartcase.simulator.instruments.placing import as_numbers, is_point, point_in_lattice, turn_in_grid
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State

__all__ = ["Probe", "make_probe", "require_probe"]

PROBE_MIN = 0.5
"""Smallest semi-axis of a probe [cells]."""
AWAY = 2.0
"""Nearer than so to where tissue may get, a probe may touch it [cells]."""
TOUCH = 1e-3
"""Part of its size within which a node counts as touched by a probe: where it was pushed to is rounded."""


@dataclass(eq=False)
class Probe:
    """An ellipsoid, or a ball swept along a line, that pushes nodes out of itself."""

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
    half_axis: Float64 = field(default_factory=lambda: np.zeros(3))
    """From its centre to an end of the line that a capsule's ball is swept along [cells, grid axes], shape (3,)."""
    wrench: Float64 = field(default_factory=lambda: np.zeros(6))
    """Mean force of the tissue on it in the last row of steps, and torque about its centre [grid units], shape (6,)."""

    def row(self, step_count: int) -> Float32:
        """The probe on its way to the target, as the kernels read it."""
        return probe_row(
            self.centre, (self.target - self.centre) / step_count, self.semi_axes, self.turn, self.half_axis
        )

    def keeps_away(self, model: LatticeModel, state: State, duration: float, led: float = 0.0) -> bool:
        """Whether it touches nothing on the way to its target, if no node gets faster than the fastest is by much.

        Parameters
        ----------
        model
            The lattice.
        state
            How its nodes lie and go.
        duration
            How long it takes to get there [unit of time].
        led
            How far hands lead a node meanwhile, at most [cells].
        """
        reach = AWAY + self.semi_axes.max() + np.linalg.norm(self.half_axis)
        reach += max(led, duration * float(np.abs(state.velocity).max(initial=0.0)) * np.sqrt(3.0))
        way = (self.target - self.centre).astype(np.float32)
        to_nodes = model.node_index + state.displacement - self.centre.astype(np.float32)
        length = max(float(way @ way), 1e-12)
        to_nodes -= np.clip(to_nodes @ way / np.float32(length), 0.0, 1.0)[:, None] * way
        return bool(np.einsum("nx,nx->n", to_nodes, to_nodes).min() > reach**2)

    def touched(self, model: LatticeModel, displacement: Float32) -> Intp:
        """Free nodes on its surface or in it now.

        Parameters
        ----------
        model
            The lattice.
        displacement
            Way of each node from its rest position [cells], float32, shape (node_count, 3).
        """
        way = model.node_index + displacement - self.centre
        if self.half_axis.any():
            along = way @ self.half_axis / (self.half_axis @ self.half_axis)
            way = way - np.clip(along, -1.0, 1.0)[:, None] * self.half_axis
        is_touched = np.linalg.norm(way @ self.turn / self.semi_axes, axis=1) <= 1.0 + TOUCH
        return np.flatnonzero(is_touched & ~model.node_is_fixed)


def require_probe(probe: object) -> None:
    """SimulationError where something else was given for a probe."""
    if not isinstance(probe, Probe):
        raise SimulationError(
            f"this is no probe but a {type(probe).__name__}: give what probe() returned", place="probe"
        )


def make_probe(
    model: LatticeModel,
    center_mm: npt.ArrayLike,
    semi_axes_mm: npt.ArrayLike,
    *,
    turn: npt.ArrayLike | None = None,
    axis_mm: npt.ArrayLike | None = None,
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
    axis_mm
        Vector from one end to the other of the line that a ball is swept along, LPS mm, shape (3,): a capsule.
    name
        Name in messages.

    Raises
    ------
    SimulationError
        A number is not finite, a semi-axis too small, the turn no rotation, or what is swept along a line is no ball.
    """
    semi_axes = np.full(3, np.nan)
    given = as_numbers(semi_axes_mm)
    if given.shape in ((), (3,)):
        semi_axes = np.broadcast_to(given, 3) / model.cell_mm
    problems = []
    if not is_point(center_mm):
        problems.append(Problem(name, "the centre must be three finite numbers"))
    if not (np.isfinite(semi_axes) & (semi_axes >= PROBE_MIN)).all():
        least = PROBE_MIN * model.cell_mm
        problems.append(Problem(name, f"give a radius or three semi-axes of at least half a cell, {least:.3g} mm"))
    if axis_mm is not None and not is_point(axis_mm):
        problems.append(Problem(name, "the axis must be three finite numbers"))
    if axis_mm is not None and len(set(semi_axes)) > 1:
        problems.append(Problem(name, "only a ball is swept along an axis: give one radius"))
    if problems:
        raise SimulationError(problems)
    half_axis = np.zeros(3) if axis_mm is None else 0.5 * model.to_grid(axis_mm)
    direction = model.geometry.direction_matrix
    axes = direction.T @ np.eye(3) if turn is None else turn_in_grid(model, turn, name) @ direction.T
    centre = point_in_lattice(model, center_mm)
    return Probe(semi_axes=semi_axes, turn=axes, centre=centre, target=centre, name=name, half_axis=half_axis)
