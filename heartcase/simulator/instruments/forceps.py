"""The forceps: a grab that closes on the tissue between two jaws."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float, Float32, Float64, Intp
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.held_tissue import (
    is_across,
    nodes_reached,
    on_own_side,
    tissue_at_rest,
    tissue_now,
)
from heartcase.simulator.instruments.one_sided import OneSidedGrab
from heartcase.simulator.instruments.placing import is_point, jaw_axes, point_in_lattice
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["SQUEEZE_MIN", "Forceps", "close_forceps"]

SQUEEZE_MIN = 0.25
"""Part of its thickness to which tissue between the jaws is squeezed at most: closer they do not come."""
_BESIDE = 0.5
"""How far beside the jaws the tissue of a cell may have its middle that they hold [cells]: jaws may be narrow."""


@dataclass(eq=False)
class Forceps(OneSidedGrab):
    """Nodes between two jaws, which are pressed together and led.

    The jaws are parallel plates. Tissue between them is squeezed alike all through, from its own thickness to the gap
    between the jaws, and comes to lie in the middle between them.
    """

    axis: Float64 = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """Direction from one jaw to the other when the hand closed, grid axes, shape (3,)."""
    span: tuple[float, float] = (0.0, 0.0)
    """Where, along ``axis`` from its centre, the tissue began and ended that it closed on [cells]."""
    gap: float = np.inf
    """Gap between the jaws [cells]."""
    gap_target: float = np.inf
    """What it shall be at the end of the next steps [cells]."""

    @property
    def thickness(self) -> float:
        """Thickness of the tissue that it closed on [cells]."""
        return self.span[1] - self.span[0]

    def squeezed(self, gap: float) -> Float64:
        """Vectors from its centre to the nodes, before it turns, at a gap of the jaws [cells], shape (count, 3)."""
        (low, high), across = self.span, self.arms @ self.axis
        if gap < high - low:
            moved = (across - (low + high) / 2) * (gap / (high - low))
        else:
            moved = across - max(high - gap / 2, 0.0) + max(-gap / 2 - low, 0.0)
        return self.arms + (moved - across)[:, None] * self.axis

    def way(self, forces: Callable[[Intp], Float32], duration: float) -> tuple[Float64, Float64]:
        """Displacements of the nodes at the start and at the end of the next steps [cells], (count, 3) each.

        Parameters
        ----------
        forces
            Gives the force of the tissue on some nodes now [grid units], shape (count, 3).
        duration
            Time that the steps take [grid units].
        """
        start, end = self.squeezed(self.gap), self.squeezed(self.gap_target)
        return self._placed(self.pose, start), self._placed(self.target, end)

    def arrive(self) -> None:
        """The steps were taken: it is where it was led to, and closed so far."""
        super().arrive()
        self.gap = self.gap_target

    def stay(self) -> None:
        """The steps were not taken: it is led nowhere."""
        super().stay()
        self.gap_target = self.gap

    def lead_part(self, share: float) -> None:
        """Lead it, and close it, so far towards where it is led; nodes are there in a straight line."""
        super().lead_part(share)
        self.gap_target = self.gap + share * (self.gap_target - self.gap)

    def arms_now(self) -> Float64:
        """Vectors from the hand's centre to where its nodes are now [cells, grid axes], shape (count, 3)."""
        return self.squeezed(self.gap) @ self.pose.turn.T

    def pinch(self, pull: Float) -> float:
        """Force with which the tissue presses each jaw away from the other [grid units]; below 0 where it is stretched.

        Half the difference of what the nodes above and below the middle of the tissue are pushed along the axis by:
        in tissue that is squeezed alike all through, forces inside it cancel, and what is left is stress by area.

        Parameters
        ----------
        pull
            Force of the tissue on each node [grid units], shape (count, 3).
        """
        above = np.sign(self.arms @ self.axis - (self.span[0] + self.span[1]) / 2)
        return float(0.5 * (above * (pull @ (self.pose.turn @ self.axis))).sum())

    def squeeze_to(self, gap: float) -> None:
        """Close, or open, to a gap [cells] with the end of the next steps; not below SQUEEZE_MIN of the thickness."""
        self.gap_target = max(gap, SQUEEZE_MIN * self.thickness)


def close_forceps(
    model: LatticeModel,
    displacement: Float32,
    tip_mm: npt.ArrayLike,
    direction: npt.ArrayLike,
    closing: npt.ArrayLike,
    *,
    length_mm: float,
    width_mm: float,
    opening_mm: float,
    sheets: Float64,
    others: Sequence[Grab] = (),
    name: str = "forceps",
) -> Forceps:
    """Forceps that take hold of the tissue between their jaws, which are still open.

    Between the jaws is a cell whose tissue has its middle there, or up to half a cell beside them. Held are nodes of
    such cells that can be reached along springs between the jaws from the one nearest the middle, and that belong to no
    tissue on the other side of an incision. Nodes that another hand holds stay with it.

    Parameters
    ----------
    model
        The lattice.
    displacement
        Displacement of the nodes [cells, grid axes], shape (node_count, 3).
    tip_mm
        Middle between the tips of the jaws, LPS mm, shape (3,).
    direction
        Along the jaws towards the tips, LPS, shape (3,), of any length.
    closing
        From one jaw to the other, LPS, shape (3,), of any length.
    length_mm, width_mm
        Length and width of the jaws, mm; above 0.
    opening_mm
        Gap between the open jaws, mm; above 0.
    sheets
        Triangles of all that was cut, at rest [cells, frame of the nodes], shape (triangle_count, 3, 3).
    others
        Hands that hold already.
    name
        Name in messages.

    Raises
    ------
    SimulationError
        There is no tissue between the jaws that can be held, or with everything that is wrong in what was given.
    """
    axes, problems = jaw_axes(model, direction, closing, name)
    if not is_point(tip_mm):
        problems.append(Problem(name, "the tip must be three finite numbers"))
    sizes = {"length": length_mm, "width": width_mm, "opening": opening_mm}
    problems += [
        Problem(name, f"the {what} must be above 0 mm (found {size:g})")
        for what, size in sizes.items()
        if not 0.0 < size < np.inf
    ]
    if problems:
        raise SimulationError(problems)
    length, width, opening = (size / model.cell_mm for size in sizes.values())
    tip = point_in_lattice(model, tip_mm)
    middle = tip - 0.5 * length * axes[0]
    places = (tissue_now(model, displacement) - middle) @ axes.T
    reach = np.array([0.5 * length + _BESIDE, 0.5 * opening, 0.5 * width + _BESIDE])
    between = np.flatnonzero((np.abs(places) <= reach).all(axis=1))
    if not len(between):
        raise SimulationError("there is no tissue between the jaws: move them there, or open them further", place=name)
    nearest = between[np.linalg.norm(places[between], axis=1).argmin()]
    rest = tissue_at_rest(model)
    root = np.broadcast_to(rest[nearest], (len(between), 3))
    between = between[~is_across(sheets, root, rest[between])]
    nodes = nodes_reached(model, between, np.array([nearest]))
    between = between[np.isin(model.cell_corners[between], nodes).all(axis=1)]
    nodes = nodes[~model.node_is_fixed[nodes]]
    nodes = nodes[on_own_side(model, sheets, nodes, np.broadcast_to(rest[nearest], (len(nodes), 3)))]
    if not len(nodes):
        raise SimulationError("all the tissue between the jaws is fixed: take hold elsewhere", place=name)
    for other in others:
        nodes = np.setdiff1d(nodes, other.nodes, assume_unique=True)
    if not len(nodes):
        raise SimulationError("other hands hold all the tissue between the jaws: take hold elsewhere", place=name)
    closed_at = displacement[nodes]
    span = _span(model, between, (tissue_now(model, displacement)[between] - tip) @ axes[1], axes[1])
    # Tissue of cells reaches a little beyond where their middles are: the jaws are apart at least as far as it.
    gap = max(opening, 2.0 * max(-span[0], span[1]))
    return Forceps(
        nodes=nodes,
        closed_at=closed_at,
        arms=model.node_index[nodes] + closed_at - tip,
        name=name,
        axis=axes[1],
        roots=np.tile(rest[nearest], (len(nodes), 1)),
        span=span,
        gap=gap,
        gap_target=gap,
    )


def _span(model: LatticeModel, cells: Intp, middles: Float64, axis: Float64) -> tuple[float, float]:
    """Where the tissue of some cells begins and ends along an axis, as a plate of their mean and variance would."""
    moments = model.cell_moments[cells].astype(float)
    mean, (xx, yy, zz, yz, xz, xy) = moments[:, :3] @ axis, moments[:, 3:].T
    x, y, z = axis
    square = x * x * xx + y * y * yy + z * z * zz + 2.0 * (y * z * yz + x * z * xz + x * y * xy)
    weight = model.cell_coverage[cells].astype(float)
    weight /= weight.sum()
    middle = float(weight @ middles)
    variance = float(weight @ (square - mean**2 + (middles - middle) ** 2))
    half = float(np.sqrt(3.0 * max(variance, 0.0)))
    return middle - half, middle + half
