"""Lines that are drawn on tissue with the mouse, and what a blade or a retractor makes of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.live.rays import Hit, Ray

__all__ = ["DrawnLine"]

POINT_EVERY_MM = 1.5
"""Points of a line are at least so far apart, mm."""
LENGTH_MIN_MM = 3.0
"""A line that is shorter is none, mm."""
_LEAP = 3.0
"""How many times further along the ray than across it the next point may be: over an edge the line does not leap."""
_LEVEL_MIN = 0.3
"""Mean of the normals of a line that goes all around something: there is no direction into it."""


@dataclass
class DrawnLine:
    """Points on the tissue that was pointed at, one after another."""

    points: list[Float64] = field(default_factory=list)
    """LPS mm, shape (3,) each."""
    normals: list[Float64] = field(default_factory=list)
    """Unit normals of the tissue there, towards the eye, LPS, shape (3,) each."""

    def add(self, ray: Ray, hit: Hit | None) -> None:
        """Go on to where a ray meets the tissue; where it meets none, or far behind the last point, nothing is added.

        Parameters
        ----------
        ray
            The ray through the mouse.
        hit
            What it meets.
        """
        if hit is None:
            return
        if self.points:
            way = hit.point_mm - self.points[-1]
            along = abs(float(way @ ray.direction))
            across = float(np.linalg.norm(way - (way @ ray.direction) * ray.direction))
            if np.linalg.norm(way) < POINT_EVERY_MM or along > _LEAP * (across + POINT_EVERY_MM):
                return
        self.points.append(hit.point_mm)
        self.normals.append(hit.normal)

    @property
    def line_mm(self) -> Float64:
        """The points, LPS mm, shape (count, 3)."""
        return np.array(self.points, dtype=float).reshape(-1, 3)

    @property
    def is_long_enough(self) -> bool:
        """Whether it is a line by now."""
        return float(np.linalg.norm(np.diff(self.line_mm, axis=0), axis=1).sum()) >= LENGTH_MIN_MM

    def inward(self, looking: Float64) -> Float64:
        """Direction into the tissue: against the mean of its normals, LPS, unit length, shape (3,).

        Parameters
        ----------
        looking
            Direction in which the eye looks: taken where the normals point to all sides, LPS, shape (3,).
        """
        mean = np.mean(self.normals, axis=0)
        size = float(np.linalg.norm(mean))
        return -mean / size if size >= _LEVEL_MIN else np.asarray(looking, dtype=float)

    def blade_poses_mm(self, looking: Float64, *, above_mm: float, depth_mm: float) -> Float64:
        """Poses of a blade that cuts along the line: above the tissue, and at its depth, LPS mm, (2, count, 3).

        Parameters
        ----------
        looking
            As of :meth:`inward`.
        above_mm
            How far above the line it begins, mm.
        depth_mm
            How far below the line it ends, mm.
        """
        into, line = self.inward(looking), self.line_mm
        return np.stack([line - above_mm * into, line + depth_mm * into])
