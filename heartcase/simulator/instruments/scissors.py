"""Scissors: two jaws that cut what lies between them as they close, from the hinge to the tips."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.instruments.placing import is_point, jaw_axes, point_in_lattice
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["OPENING_MAX", "Scissors", "bring_scissors"]

OPENING_MAX = np.pi / 2
"""Largest angle between the jaws."""
_AT_HINGE = 0.02
"""Half the height between the jaws beside the hinge, where they meet, over their length."""
_OVERLAP = 0.25
"""How far behind the closing point a snip begins, so that two that follow each other leave nothing between [cells]."""


@dataclass(eq=False)
class Scissors:
    """Two jaws at a hinge. The point at which their edges meet goes from the hinge to the tips as they close."""

    hinge: Float64
    """Where the jaws are joined [cells, frame of the nodes], shape (3,)."""
    axes: Float64
    """Along the jaws, from one jaw to the other, along the hinge: in rows, grid axes, shape (3, 3)."""
    length: float
    """Length of the jaws from the hinge [cells]."""
    opening: float
    """Angle between the jaws where they are fully open."""
    angle: float
    """Angle between them now."""
    name: str = "scissors"
    """Name in messages."""
    wrench: Float64 = field(default_factory=lambda: np.zeros(6))
    """Force and torque of the tissue on them: none, as a cut takes no force here."""

    def closing_point(self, angle: float) -> float:
        """How far from the hinge the edges meet at an angle [cells]: in proportion to how far they have closed."""
        return self.length * float(np.clip(1.0 - angle / self.opening, 0.0, 1.0))

    def sheet(self, angle: float) -> Float64 | None:
        """What is cut as they close to an angle from where they are, as poses of a blade, shape (2, 2, 3); or None.

        At each distance from the hinge the blade reaches from edge to edge of the fully open jaws.
        """
        first, last = self.closing_point(self.angle), self.closing_point(angle)
        if last <= first:
            return None
        first = max(first - _OVERLAP, 0.0)
        away = np.array([first, last])
        half = np.maximum(away * np.tan(self.opening / 2), _AT_HINGE * self.length)
        edge = np.stack([-half, half], axis=1)
        poses: Float64 = self.hinge + away[:, None, None] * self.axes[0] + edge[..., None] * self.axes[1]
        return poses

    def place(
        self, model: LatticeModel, hinge_mm: npt.ArrayLike, direction: npt.ArrayLike, closing: npt.ArrayLike
    ) -> None:
        """Put them elsewhere; they touch nothing on the way.

        Parameters
        ----------
        model
            The lattice.
        hinge_mm
            Where the jaws are joined, LPS mm, shape (3,).
        direction
            From the hinge towards the tips of the closed jaws, LPS, shape (3,), of any length.
        closing
            From one jaw to the other, LPS, shape (3,), of any length.

        Raises
        ------
        SimulationError
            With everything that is wrong in what was given.
        """
        self.hinge, self.axes = _placed(model, hinge_mm, direction, closing, self.name)


def bring_scissors(
    model: LatticeModel,
    hinge_mm: npt.ArrayLike,
    direction: npt.ArrayLike,
    closing: npt.ArrayLike,
    *,
    length_mm: float,
    opening_deg: float,
    name: str = "scissors",
) -> Scissors:
    """Fully open scissors at a place.

    Parameters
    ----------
    model
        The lattice.
    hinge_mm
        Where the jaws are joined, LPS mm, shape (3,).
    direction
        From the hinge towards the tips of the closed jaws, LPS, shape (3,), of any length.
    closing
        From one jaw to the other, LPS, shape (3,), of any length.
    length_mm
        Length of the jaws from the hinge, mm; above 0.
    opening_deg
        Angle between the fully open jaws, degrees; above 0 and at most 90.
    name
        Name in messages.

    Raises
    ------
    SimulationError
        With everything that is wrong in what was given.
    """
    problems = []
    if not 0.0 < length_mm < np.inf:
        problems.append(Problem(name, f"the length must be above 0 mm (found {length_mm:g})"))
    if not 0.0 < opening_deg <= np.degrees(OPENING_MAX):
        problems.append(Problem(name, f"the jaws open by more than 0 and at most 90 degrees (found {opening_deg:g})"))
    if problems:
        raise SimulationError(problems)
    hinge, axes = _placed(model, hinge_mm, direction, closing, name)
    opening = float(np.radians(opening_deg))
    return Scissors(hinge, axes, length_mm / model.cell_mm, opening, opening, name)


def _placed(
    model: LatticeModel, hinge_mm: npt.ArrayLike, direction: npt.ArrayLike, closing: npt.ArrayLike, name: str
) -> tuple[Float64, Float64]:
    axes, problems = jaw_axes(model, direction, closing, name)
    if not is_point(hinge_mm):
        problems.append(Problem(name, "the hinge must be three finite numbers"))
    if problems:
        raise SimulationError(problems)
    return point_in_lattice(model, hinge_mm), axes
