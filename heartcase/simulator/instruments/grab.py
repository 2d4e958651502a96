"""The grab: closes on the nodes in a sphere, leads them, lets go (thesis 8.7.2)."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import sqrt

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float, Float32, Float64, Intp
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.instruments.placing import is_point, point_in_lattice, turn_in_grid
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["Grab", "Pose", "close_grab", "nodes_in_reach", "pose_of", "require_grab"]

DETOUR_MAX = sqrt(1.5)
"""Longest way along lattice springs over the straight way, in an uncut lattice."""


@dataclass(frozen=True)
class Pose:
    """Offset and turn of a hand from where it closed."""

    offset: Float64 = field(default_factory=lambda: np.zeros(3))
    """Way of its centre [cells, grid axes], shape (3,)."""
    turn: Float64 = field(default_factory=lambda: np.eye(3))
    """Rotation about its centre, grid axes, shape (3, 3)."""


@dataclass(eq=False)
class Grab:
    """Nodes that a hand holds, and where it leads them."""

    nodes: Intp
    """Nodes held, ascending, shape (count,)."""
    closed_at: Float32
    """Their displacements when the hand closed [cells, grid axes], shape (count, 3)."""
    arms: Float64
    """Vectors from the hand's centre to the nodes when it closed [cells, grid axes], shape (count, 3)."""
    name: str = "grab"
    """Name in summaries."""
    pose: Pose = field(default_factory=Pose)
    """Where the hand is, from where it closed."""
    target: Pose = field(default_factory=Pose)
    """Where it shall be at the end of the next steps."""

    def centre_at(self, pose: Pose, model: LatticeModel) -> Float64:
        """Where the hand's centre is at a pose, in the lattice ``model`` [cells, grid axes], shape (3,)."""
        closed: Float64 = model.node_index[self.nodes[0]] + self.closed_at[0].astype(float) - self.arms[0]
        return closed + pose.offset

    def displacement_at(self, pose: Pose) -> Float64:
        """Displacements of the nodes at a pose [cells, grid axes], shape (count, 3)."""
        return self.closed_at + (self.arms @ pose.turn.T - self.arms) + pose.offset

    def wrench(self, pull: Float) -> Float64:
        """Sum of the forces on its nodes, shape (count, 3), and of their moments about its centre now, shape (6,)."""
        arms = self.arms @ self.pose.turn.T
        return np.concatenate([pull.sum(axis=0, dtype=np.float64), np.cross(arms, pull).sum(axis=0)])


def require_grab(grab: object) -> None:
    """SimulationError where something else was given for a grab."""
    if not isinstance(grab, Grab):
        raise SimulationError(f"this is no grab but a {type(grab).__name__}: give what grab() returned", place="grab")


def close_grab(
    model: LatticeModel,
    displacement: Float32,
    center_mm: npt.ArrayLike,
    radius_mm: float,
    *,
    others: Sequence[Grab] = (),
    name: str = "grab",
) -> Grab:
    """A hand that closes on the nodes in reach of a sphere; nodes that another hand holds stay with it.

    Parameters
    ----------
    model
        The lattice, without the springs that were cut.
    displacement
        Displacement of the nodes [cells, grid axes], shape (node_count, 3).
    center_mm
        Centre of the sphere, LPS mm, shape (3,).
    radius_mm
        Its radius, mm; above 0.
    others
        Hands that hold already.
    name
        Name in messages.

    Raises
    ------
    SimulationError
        There is no tissue to hold, the place is not a finite point, or the radius is not above 0.
    """
    if not (is_point(center_mm) and np.isfinite(radius_mm)):
        raise SimulationError("the centre and the radius must be finite numbers, three and one", place=name)
    if radius_mm <= 0:
        raise SimulationError(f"the radius must be above 0 mm (found {radius_mm:g})", place=name)
    nodes = nodes_in_reach(model, displacement, center_mm, radius_mm)
    for other in others:
        nodes = np.setdiff1d(nodes, other.nodes, assume_unique=True)
    if not len(nodes):
        raise SimulationError("another hand holds all the tissue in the grab: grab elsewhere", place=name)
    closed_at = displacement[nodes]
    arms = model.node_index[nodes] + closed_at - point_in_lattice(model, center_mm)
    return Grab(nodes=nodes, closed_at=closed_at, arms=arms, name=name)


def pose_of(model: LatticeModel, offset_mm: npt.ArrayLike, turn: npt.ArrayLike | None, name: str) -> Pose:
    """A pose of the hand of this name, from its offset, LPS mm, and its turn, LPS axes.

    Raises
    ------
    SimulationError
        The offset is not finite, or the turn is no rotation.
    """
    if not is_point(offset_mm):
        raise SimulationError("the offset must be three finite numbers", place=name)
    return Pose(model.to_grid(offset_mm), turn_in_grid(model, turn, name))


def nodes_in_reach(model: LatticeModel, displacement: Float32, center_mm: npt.ArrayLike, radius_mm: float) -> Intp:
    """Nodes in a sphere that can be reached along springs inside it, from the one nearest its centre.

    The way along the springs may not be longer than it is in uncut tissue, so that a grab never bridges an incision.
    Fixed nodes are left out.

    Parameters
    ----------
    model
        The lattice, without the springs that were cut.
    displacement
        Displacement of the nodes [cells, grid axes], shape (node_count, 3).
    center_mm
        Centre of the sphere, LPS mm.
    radius_mm
        Its radius, mm.

    Returns
    -------
    ndarray
        Node numbers, ascending; at least one.

    Raises
    ------
    SimulationError
        There is no tissue in the sphere, or only fixed nodes.
    """
    center = point_in_lattice(model, center_mm)
    radius = radius_mm / model.cell_mm
    distance = np.linalg.norm(model.node_index + displacement - center, axis=1)
    nearest = int(distance.argmin())
    if distance[nearest] > radius:
        raise SimulationError(
            f"there is no tissue within {radius_mm:.3g} mm of the grab; the nearest is "
            f"{distance[nearest] * model.cell_mm:.1f} mm from its centre: move it there or give a larger radius",
            place="grab",
        )
    inside = distance <= radius
    reach = DETOUR_MAX * (radius + distance[nearest]) + 1.0
    held = _along_springs(model, inside, start=nearest, reach=reach)
    held = held[~model.node_is_fixed[held]]
    if not len(held):
        raise SimulationError("all the tissue in the grab is fixed: grab elsewhere", place="grab")
    return held


def _along_springs(model: LatticeModel, inside: Bool, *, start: int, reach: float) -> Intp:
    """Nodes inside whose shortest way along springs inside, by rest length, is at most ``reach`` [cells]."""
    springs = np.flatnonzero(inside[model.spring_nodes].all(axis=1))
    beside: dict[int, list[tuple[int, float]]] = {}
    lengths = model.spring_length[springs].tolist()
    for (lower, higher), length in zip(model.spring_nodes[springs].tolist(), lengths, strict=True):
        beside.setdefault(lower, []).append((higher, length))
        beside.setdefault(higher, []).append((lower, length))
    way = {start: 0.0}
    queue = [(0.0, start)]
    while queue:
        so_far, node = heapq.heappop(queue)
        if so_far > way[node]:
            continue
        for other, length in beside.get(node, ()):
            there = so_far + length
            if there <= reach and there < way.get(other, np.inf):
                way[other] = there
                heapq.heappush(queue, (there, other))
    return np.array(sorted(way), dtype=np.intp)
