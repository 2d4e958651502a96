"""The rim of a defect that is known by its middle, axis and radius: where the hole opens into a cavity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import SimulationError
from heartcase.schemas.landmarks import Landmark
from heartcase.simulator.incisions.segments import touches
from heartcase.simulator.incisions.triangle_tree import TriangleTree

__all__ = ["DefectRim", "defect_rim"]

ANGLE_COUNT = 72
"""Places around the rim."""
WIDER = 1.25
"""A hole ends where it is so much wider than at its middle."""
_STEP_MM = 0.25
_DEEP = 3.0
"""How far from the middle its end is looked for, in radii, and at least ``_DEEP_MM``."""
_DEEP_MM = 12.0
_HALVINGS = 12


@dataclass(frozen=True)
class DefectRim:
    """Where a defect opens into a cavity."""

    name: str
    """The defect's name."""
    points_mm: Float64
    """A closed curve, LPS mm, shape (count, 3)."""
    middle_mm: Float64
    """Middle of the hole itself, LPS mm, shape (3,)."""
    part_found: float
    """Part of the places around where the surface has an edge of the hole; elsewhere it is taken at the mean depth of
    the others, as wide as the landmark says [1]."""


def defect_rim(tree: TriangleTree, landmark: Landmark, towards_mm: npt.ArrayLike) -> DefectRim:
    """The rim of a defect on the side of a place.

    A ring of several points is the rim as it is. Else the hole is felt out from its axis to all sides, slice by slice:
    at each place around, the rim lies where the hole becomes wider than 1.25 times its radius.

    Parameters
    ----------
    tree
        The tissue's surface at rest.
    landmark
        The defect: a ring.
    towards_mm
        On which side: that of this place, such as the middle of an incision, LPS mm, shape (3,).

    Raises
    ------
    SimulationError
        It is no ring, or the surface has no hole there.
    """
    if landmark.kind != "ring":
        raise SimulationError(f"{landmark.name} is no ring: name a defect", place="defects")
    points = np.asarray(landmark.points_mm, dtype=float)
    if len(points) > 1:
        return DefectRim(landmark.name, points, points.mean(axis=0), 1.0)
    assert landmark.axis is not None
    assert landmark.radius_mm is not None
    middle, radius = points[0], landmark.radius_mm
    axis = np.asarray(landmark.axis, dtype=float)
    axis = axis / np.linalg.norm(axis)
    if (np.asarray(towards_mm, dtype=float) - middle) @ axis < 0.0:
        axis = -axis
    around = _around(axis)
    half = int(np.ceil(max(_DEEP * radius, _DEEP_MM) / _STEP_MM))
    depths = np.arange(-half, half + 1) * _STEP_MM
    wide = _widths(tree, middle + depths[:, None] * axis, around, 2.0 * radius)
    is_hole = wide <= WIDER * radius
    edge = np.array([_edge(column, half) for column in is_hole.T])
    found = edge >= 0
    if found.mean() < 0.5:
        raise SimulationError(
            f"the surface has no hole of {2 * radius:.1f} mm at {landmark.name}: look whether the case still has it",
            place="defects",
        )
    depth = np.where(found, depths[edge], depths[edge[found]].mean())
    width = np.where(found, wide[edge, np.arange(len(around))], radius)
    rim = middle + depth[:, None] * axis + width[:, None] * around
    return DefectRim(landmark.name, rim, middle, float(found.mean()))


def _around(axis: Float64) -> Float64:
    """Directions at right angles to an axis, shape (ANGLE_COUNT, 3)."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    angle = 2.0 * np.pi * np.arange(ANGLE_COUNT) / ANGLE_COUNT
    around: Float64 = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(axis, first)
    return around


def _widths(tree: TriangleTree, middles: Float64, around: Float64, most_mm: float) -> Float64:
    """How far it is from each place to the surface in each direction, mm, shape (place_count, direction_count)."""
    starts = np.repeat(middles, len(around), axis=0)
    ways = np.tile(around, (len(middles), 1))
    low, high = np.zeros(len(starts)), np.full(len(starts), most_mm)
    is_open = ~touches(tree, starts, starts + high[:, None] * ways)
    for _ in range(_HALVINGS):
        half = 0.5 * (low + high)
        is_hit = touches(tree, starts, starts + half[:, None] * ways)
        low, high = np.where(is_hit, low, half), np.where(is_hit, half, high)
    return np.where(is_open, np.inf, high).reshape(len(middles), len(around))


def _edge(is_hole: npt.NDArray[np.bool_], start: int) -> int:
    """Last slice of the hole that begins nearest to its middle, or -1."""
    inside = np.flatnonzero(is_hole)
    if not len(inside):
        return -1
    at = int(inside[np.argmin(np.abs(inside - start))])
    while at + 1 < len(is_hole) and is_hole[at + 1]:
        at += 1
    # A hole without an end is a closed vessel or the edge of what was looked at.
    return at if at + 1 < len(is_hole) else -1
