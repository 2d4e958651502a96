"""The grab: closes on the nodes in a sphere, leads them, lets go (thesis 8.7.2)."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import sqrt

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float, Float32, Float64, Int64, Intp
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.instruments.placing import is_number, is_point, point_in_lattice, turn_in_grid
from heartcase.simulator.lattice.loose_nodes import loose_first
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["DETOUR_MAX", "Grab", "Pose", "along_springs", "close_grab", "nodes_in_reach", "pose_of", "require_grab"]

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
        return self._placed(pose, self.arms)

    def _placed(self, pose: Pose, arms: Float64) -> Float64:
        """Displacements at a pose of nodes that lie so in the hand before it is turned."""
        return self.closed_at + (arms @ pose.turn.T - self.arms) + pose.offset

    def way(self, forces: Callable[[Intp], Float32], duration: float) -> tuple[Float64, Float64]:
        """Displacements of the nodes at the start and at the end of the next steps [cells], (count, 3) each.

        Parameters
        ----------
        forces
            Force of the tissue on some nodes now [grid units], shape (count, 3).
        duration
            How long the steps take [units of time].
        """
        return self.displacement_at(self.pose), self.displacement_at(self.target)

    def arrive(self) -> None:
        """The steps were taken: it is where it was led to."""
        self.pose = self.target

    def stay(self) -> None:
        """The steps were not taken: it is led nowhere."""
        self.target = self.pose

    def lead_part(self, share: float) -> None:
        """Lead it so far towards where it is led, 0 to 1; nodes are there in a straight line, as in all of the way."""
        pose, target = self.pose, self.target
        self.target = Pose(
            pose.offset + share * (target.offset - pose.offset), pose.turn + share * (target.turn - pose.turn)
        )

    def carry(self, nodes: Intp, place: Int64) -> None:
        """Hold other nodes from now on: those of a lattice that was cut further, each from the one at ``place``."""
        self.nodes = nodes
        self.closed_at, self.arms = self.closed_at[place], self.arms[place]

    def arms_now(self) -> Float64:
        """Vectors from the hand's centre to where its nodes are now [cells, grid axes], shape (count, 3)."""
        return self.arms @ self.pose.turn.T

    def wrench(self, pull: Float) -> Float64:
        """Sum of the forces on its nodes, shape (count, 3), and of their moments about its centre now, shape (6,)."""
        arms = self.arms_now()
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
    among: Bool | None = None,
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
    among
        Nodes that may be held, as of :func:`nodes_in_reach`.
    others
        Hands that hold already.
    name
        Name in messages.

    Raises
    ------
    SimulationError
        There is no tissue to hold, the place is not a finite point, or the radius is not above 0.
    """
    if not (is_point(center_mm) and is_number(radius_mm)):
        raise SimulationError("the centre and the radius must be finite numbers, three and one", place=name)
    if radius_mm <= 0:
        raise SimulationError(f"the radius must be above 0 mm (found {radius_mm:g})", place=name)
    nodes = nodes_in_reach(model, displacement, center_mm, radius_mm, among)
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


def nodes_in_reach(
    model: LatticeModel,
    displacement: Float32,
    center_mm: npt.ArrayLike,
    radius_mm: float,
    among: Bool | None = None,
) -> Intp:
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
    among
        Nodes that may be held, shape (node_count,), one of them within the sphere; all when left out. The way to them
        may lead along others.

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
    # A hand holds tissue, and no patch.
    distance[loose_first(model) :] = np.inf
    nearest = int((distance if among is None else np.where(among, distance, np.inf)).argmin())
    if distance[nearest] > radius:
        raise SimulationError(
            f"there is no tissue within {radius_mm:.3g} mm of the grab; the nearest is "
            f"{distance[nearest] * model.cell_mm:.1f} mm from its centre: move it there or give a larger radius",
            place="grab",
        )
    inside = distance <= radius
    reach = DETOUR_MAX * (radius + distance[nearest]) + 1.0
    held = along_springs(model, inside, starts=[nearest], reach=np.full(model.node_count, reach))
    held = held[~model.node_is_fixed[held] & (among is None or among[held])]
    if not len(held):
        raise SimulationError("all the tissue in the grab is fixed: grab elsewhere", place="grab")
    return held


def along_springs(model: LatticeModel, inside: Bool, *, starts: Sequence[int], reach: Float64) -> Intp:
    """Nodes inside whose shortest way along springs inside, by rest length, is at most their reach, ascending.

    Parameters
    ----------
    model
        The lattice, without the springs that were cut.
    inside
        Which nodes may be on the way, shape (node_count,).
    starts
        Nodes at which ways begin.
    reach
        Longest way to each node [cells], shape (node_count,).
    """
    springs = np.flatnonzero(inside[model.spring_nodes].all(axis=1))
    beside: dict[int, list[tuple[int, float]]] = {}
    lengths = model.spring_length[springs].tolist()
    for (lower, higher), length in zip(model.spring_nodes[springs].tolist(), lengths, strict=True):
        beside.setdefault(lower, []).append((higher, length))
        beside.setdefault(higher, []).append((lower, length))
    way = dict.fromkeys(starts, 0.0)
    queue = [(0.0, start) for start in sorted(way)]
    while queue:
        so_far, node = heapq.heappop(queue)
        if so_far > way[node]:
            continue
        for other, length in beside.get(node, ()):
            there = so_far + length
            if there <= reach[other] and there < way.get(other, np.inf):
                way[other] = there
                heapq.heappush(queue, (there, other))
    return np.array(sorted(way), dtype=np.intp)
