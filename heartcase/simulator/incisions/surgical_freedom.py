"""How freely an instrument moves through an opening: a straight shaft that may touch no tissue.

Two volumes. The *volume of surgical freedom* of a target follows Houlihan et al. (Frontiers in Bioengineering and
Biotechnology 9, 2021, 628797): the tip rests on the target, the shaft sweeps all ways in which it can stand, and what
it sweeps is a cone with the target as its apex and an irregular base; with shafts of one length, volumes of different
approaches compare. They take the cone from points that a probe touched; here it is the sum over directions, of a solid
angle W, up to the length L: W L^3 / 3. The *reach* is the volume of all places that the tip can come to through the
opening.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.incisions.directions import cone_directions, cone_solid_angle_sr, fan, points_in
from heartcase.simulator.incisions.segments import can_stand, touches
from heartcase.simulator.incisions.triangle_tree import TriangleTree

__all__ = ["Reach", "Shaft", "freedom_at_target_mm3", "reach"]


@dataclass(frozen=True)
class Shaft:
    """A straight instrument, and the directions that are tried.

    Raises
    ------
    SimulationError
        A number is out of range: all of them.
    """

    axis: tuple[float, float, float]
    """From the tip outward, in the middle of the directions, LPS axes."""
    half_angle_deg: float = 60.0
    """How far it may lean from the axis, degrees."""
    length_mm: float = 100.0
    """From the tip to the hand, mm."""
    radius_mm: float = 1.5
    """Radius of the shaft, mm: no tissue may be nearer to its axis."""
    direction_count: int = 400
    """Directions that are tried with the tip on a target."""

    def __post_init__(self) -> None:
        problems = []
        if not 0.0 < self.length_mm < np.inf:
            problems.append(Problem("length_mm", "must be above 0 mm"))
        if not (np.isfinite(self.axis).all() and np.any(self.axis)):
            problems.append(Problem("axis", "give three finite numbers that are not all zero"))
        if not 0.0 <= self.radius_mm < np.inf:
            problems.append(Problem("radius_mm", "must be 0 mm or more"))
        if problems:
            raise SimulationError(problems)

    def directions(self) -> Float64:
        """Unit vectors from the tip outward, shape (direction_count, 3)."""
        return cone_directions(self.axis, self.half_angle_deg, self.direction_count)


@dataclass(frozen=True)
class Reach:
    """Where the tip can be."""

    volume_mm3: float
    """Volume of these places, mm3."""
    tips_mm: Float64
    """Middles of the cubes that they were looked for in, mm, shape (count, 3)."""
    spacing_mm: float
    """Edge of a cube, mm."""


def freedom_at_target_mm3(tree: TriangleTree, target_mm: npt.ArrayLike, shaft: Shaft, *, tip_free_mm: float) -> float:
    """Volume of surgical freedom with the tip on a target, mm3.

    Parameters
    ----------
    tree
        The tissue's surface now.
    target_mm
        Where the tip rests, mm, shape (3,).
    shaft
        The instrument.
    tip_free_mm
        Length at the tip that may touch: the tip rests on tissue, mm.
    """
    target = np.asarray(target_mm, dtype=float)
    directions = shaft.directions()
    starts = target + min(tip_free_mm, shaft.length_mm) * directions
    is_free = ~touches(tree, starts, target + shaft.length_mm * directions, shaft.radius_mm)
    angle = float(is_free.mean()) * cone_solid_angle_sr(shaft.half_angle_deg)
    return angle * shaft.length_mm**3 / 3.0


def reach(
    tree: TriangleTree,
    opening_mm: npt.ArrayLike,
    shaft: Shaft,
    *,
    depth_mm: float,
    spacing_mm: float = 1.0,
    gate_count: int = 150,
) -> Reach:
    """Where the tip can be with the shaft through an opening.

    Parameters
    ----------
    tree
        The tissue's surface now.
    opening_mm
        The opening's rim, a closed curve, mm, shape (count, 3): the axis of the shaft goes through what it spans.
    shaft
        The instrument.
    depth_mm
        How far from the middle of the opening tips are looked for, mm.
    spacing_mm
        Edge of the cubes that are looked at, mm: the volume is a sum of them.
    gate_count
        Points of the opening through which the shaft is tried.

    Raises
    ------
    SimulationError
        The opening is no closed curve of finite points, or a length is not above 0.
    """
    rim = np.asarray(opening_mm, dtype=float)
    problems = []
    if rim.ndim != 2 or rim.shape[0] < 3 or rim.shape[1] != 3 or not np.isfinite(rim).all():
        problems.append(Problem("opening_mm", "the opening must be a curve of at least three finite points"))
    problems += [
        Problem(name, "must be above 0 mm")
        for name, value in (("depth_mm", depth_mm), ("spacing_mm", spacing_mm))
        if not 0.0 < value < np.inf
    ]
    if problems:
        raise SimulationError(problems)
    middle = rim.mean(axis=0)
    count = int(np.ceil(depth_mm / spacing_mm))
    steps = (np.arange(-count, count) + 0.5) * spacing_mm
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    # Within the depth, and on the side of the opening to which the shaft points.
    inward = -np.asarray(shaft.axis, dtype=float) / np.linalg.norm(shaft.axis)
    grid = grid[(np.linalg.norm(grid, axis=1) <= depth_mm) & (grid @ inward > 0.0)]
    tips = middle + grid
    gates = np.concatenate([middle[None], points_in(rim, gate_count)])
    how = (-inward, shaft.half_angle_deg, shaft.length_mm, shaft.radius_mm)
    tips = tips[can_stand(tree, tips, gates, fan(rim), *how)]
    return Reach(len(tips) * spacing_mm**3, tips, spacing_mm)
