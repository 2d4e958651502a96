"""Plane cross-sections of a lumen, to a fraction of a voxel, and planes turned and moved to lie across it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label as labelled
from scipy.ndimage import map_coordinates

from heartcase.schemas.arrays import Bool, Float32, Float64
from heartcase.schemas.geometry import Geometry

__all__ = ["Lumen", "Section", "across", "angle_between"]


ROUNDS = 4
"""Times that a plane is moved to the middle of its section and turned across the line of middles."""
RIVAL_SHARE = 0.5
"""Part of a section's size from which on another piece in its plane may be meant as well."""
ARM_PLACES = (-1.0, -0.5, 0.5)
"""How far before and behind the plane the line of middles is looked at, in radii of the section: farther on the heart's
side, as the tip may be near."""
NEAR_EXTENTS = 1.5
"""How far around its middle the next section of the same tube is looked for, in extents of the last and one radius."""
ALIKE = 1.45
"""Sections whose areas differ by more than this factor are not of one tube."""


@dataclass(frozen=True)
class Section:
    """The piece of a plane in a lumen that is nearest to a point."""

    middle: Float64
    """Its centroid, world mm."""
    axis: Float64
    """Unit normal of the plane."""
    area_mm2: float
    """Its area."""
    extent_mm: float
    """The farthest of its points from the centroid."""
    away_mm: float
    """Distance of its nearest point from the point that was asked for."""
    rival_mm: float
    """The same of the nearest other piece that is at least half as large; infinite where there is none."""
    is_whole: bool
    """Whether it ends within the part of the plane that was looked at, and within the volume."""

    @property
    def radius_mm(self) -> float:
        """Radius of a circle of its area."""
        return float(np.sqrt(self.area_mm2 / np.pi))

    @property
    def roundness(self) -> float:
        """Its part of the circle around it, 0 to 1."""
        return self.area_mm2 / (np.pi * max(self.extent_mm, self.radius_mm) ** 2)


@dataclass(frozen=True)
class Lumen:
    """A lumen as a field between voxels: 1 inside, 0 outside, half of it is the border."""

    field: Float32
    """Shape (z, y, x)."""
    geometry: Geometry
    """Its lattice."""

    @classmethod
    def of(cls, mask: Bool, geometry: Geometry) -> Lumen:
        """A lumen, cut to the box that holds it and one voxel around."""
        there = [np.flatnonzero(mask.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
        low = [max(int(one[0]) - 1, 0) for one in there]
        high = [min(int(one[-1]) + 2, size) for one, size in zip(there, mask.shape, strict=True)]
        part = mask[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
        size = (part.shape[2], part.shape[1], part.shape[0])
        return cls(part.astype(np.float32), geometry.cropped((low[2], low[1], low[0]), size))

    @property
    def step_mm(self) -> float:
        """Distance between the points of a section."""
        return 0.5 * min(self.geometry.spacing_mm)

    def section(self, point: Float64, axis: Float64, limit_mm: float) -> Section | None:
        """Cut the lumen by a plane.

        Parameters
        ----------
        point
            World mm.
        axis
            Normal of the plane, of length one.
        limit_mm
            How far around the point the plane is looked at.

        Returns
        -------
        Section or None
            The piece that holds the point, or else the nearest one; None where there is none.
        """
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        side /= np.linalg.norm(side)
        other = np.cross(axis, side)
        count = int(np.ceil(limit_mm / self.step_mm))
        flat = np.arange(-count, count + 1) * self.step_mm
        points = point + flat[:, None, None] * side + flat[None, :, None] * other
        index = np.moveaxis(self.geometry.world_to_index(points)[..., ::-1], -1, 0)
        # What lies beyond the outermost voxels' centres is continued to their faces, then there is nothing.
        value = map_coordinates(self.field, index, order=1, mode="nearest")
        last = np.array(self.geometry.size[::-1])[:, None, None] - 0.5
        is_outside = ((index < -0.5) | (index > last)).any(axis=0)
        inside = (value >= 0.5) & ~is_outside
        distance = np.hypot(flat[:, None], flat[None, :])
        inside &= distance <= limit_mm
        pieces, found = labelled(inside)
        if found == 0:
            return None
        nearest = int(np.argmin(np.where(inside, distance, np.inf).round(9)))
        piece = pieces == pieces.ravel()[nearest]
        u, v = np.nonzero(piece)
        u_mm, v_mm = flat[u].mean(), flat[v].mean()
        extent = float(np.hypot(flat[u] - u_mm, flat[v] - v_mm).max()) + 0.5 * self.step_mm
        is_whole = not bool((piece & (distance > limit_mm - 1.5 * self.step_mm)).any())
        middle = point + u_mm * side + v_mm * other
        sizes = np.bincount(pieces.ravel())
        rivals = np.flatnonzero(sizes >= RIVAL_SHARE * len(u))
        rivals = rivals[(rivals > 0) & (rivals != pieces.ravel()[nearest])]
        rival = float(distance[np.isin(pieces, rivals)].min(initial=np.inf))
        away = float(distance.ravel()[nearest])
        return Section(middle, axis, float(len(u)) * self.step_mm**2, extent, away, rival, is_whole)


def across(lumen: Lumen, point: Float64, axis: Float64, limit_mm: float) -> Section | None:
    """The section near a point whose plane lies across the lumen.

    Parameters
    ----------
    lumen
        What is cut.
    point
        Where to begin, world mm.
    axis
        About along the lumen; the section's axis points to the same side.
    limit_mm
        Sections that reach farther are no vessel's.

    Returns
    -------
    Section or None
        None where the lumen is not there, or wider than that.
    """
    found = lumen.section(point, axis, limit_mm)
    for _ in range(ROUNDS):
        if found is None or not found.is_whole:
            return None
        arm = max(found.radius_mm, *lumen.geometry.spacing_mm)
        # what reaches farther is not of the same tube
        limit_mm = min(limit_mm, NEAR_EXTENTS * found.extent_mm + arm)
        places, middles = [0.0], [found.middle]
        for place in ARM_PLACES:
            beside = lumen.section(found.middle + place * arm * found.axis, found.axis, limit_mm)
            if beside is not None and beside.is_whole and _is_alike(beside, found):
                places.append(place)
                middles.append(beside.middle)
        slope = (np.array(places) - np.mean(places)) @ np.array(middles)
        if len(middles) > 1 and slope @ found.axis > 0.0:
            axis = slope / np.linalg.norm(slope)
        found = lumen.section(found.middle, axis, limit_mm)
    return found if found is not None and found.is_whole else None


def _is_alike(one: Section, other: Section) -> bool:
    return 1.0 / ALIKE <= one.area_mm2 / other.area_mm2 <= ALIKE


def angle_between(one: Float64, other: Float64) -> float:
    """Angle between two directions, degrees."""
    cosine = float(one @ other / (np.linalg.norm(one) * np.linalg.norm(other)))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
