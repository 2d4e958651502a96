"""Where a septum lies at a place, from the labels: its middle, its normal and its thickness."""

from __future__ import annotations

from dataclasses import dataclass

import edt
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from heartcase.pipeline.data import Segmentation
from heartcase.schemas.arrays import Bool, Float32, Float64
from heartcase.schemas.base import Vector3
from heartcase.schemas.errors import UsageError
from heartcase.schemas.labels import LabelTable

__all__ = ["SeptumPlace", "septum_place"]

REACH_MM = 25.0
"""Farther from the place no cavity is looked for: more than the thickest septum."""
SMOOTHING_MM = 2.0
"""Blur of the distances, so that a step of voxels does not turn the normal."""


@dataclass(frozen=True)
class SeptumPlace:
    """A septum between two cavities, near a point."""

    position_mm: Vector3
    """Half-way between the two cavities, LPS mm."""
    axis: Vector3
    """Unit normal of the septum, from the first cavity to the second."""
    thickness_mm: float
    """Distance of the two cavities there."""
    between: tuple[str, str]
    """Names of the two cavities, the nearer one first."""


def septum_place(segmentation: Segmentation, table: LabelTable, point_mm: Vector3) -> SeptumPlace:
    """The septum near a point: between the two cavities of blood that are nearest to it.

    The normal is the gradient of the difference of the distances to the two cavities; the middle is where both are
    equally far, along the normal from the point.

    Parameters
    ----------
    segmentation
        Labels.
    table
        Says which of them are blood.
    point_mm
        Place in or near the septum, LPS mm.

    Raises
    ------
    UsageError
        The point lies outside the scan, or there are no two cavities near it.
    """
    geometry = segmentation.geometry
    index = geometry.world_to_index(np.array(point_mm))
    size = np.array(geometry.size)
    if np.any(index < -0.5) or np.any(index > size - 0.5):
        raise UsageError("lies outside the scan: click inside it", place="position_mm")
    spacing = np.array(geometry.spacing_mm)
    low = np.maximum(np.floor(index - REACH_MM / spacing), 0).astype(int)
    high = np.minimum(np.ceil(index + REACH_MM / spacing) + 1, size).astype(int)
    part = segmentation.labels[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
    there = sorted({int(value) for value in np.unique(part)} & set(table.blood_values))
    # at the point itself, in voxels from the box's corner as [z, y, x]
    at = (index - low)[::-1]
    distances = {value: _signed_mm(part == value, spacing) for value in there}
    near = sorted(there, key=lambda value: float(_read(distances[value], at)))
    near = [value for value in near if _read(distances[value], at) <= REACH_MM]
    if len(near) < 2:
        raise UsageError(
            f"there are no two cavities within {REACH_MM:g} mm: paint both, or click in the septum between them",
            place="position_mm",
        )
    first, second = near[:2]
    sigma = SMOOTHING_MM / spacing[::-1]
    # above 0 on the second one's side
    difference = gaussian_filter(distances[first] - distances[second], sigma)
    turn = geometry.direction_matrix
    middle = at
    for _ in range(4):
        slope = np.array([_read(np.gradient(difference, spacing[2 - axis], axis=axis), middle) for axis in range(3)])
        length = float(np.linalg.norm(slope))
        if length < 1e-3:
            break
        # the difference grows by 2 mm for each mm along the normal
        way = -_read(difference, middle) * slope / length**2
        middle = np.clip(middle + way / spacing[::-1], 0, np.array(part.shape) - 1)
    if length < 1e-3:
        raise UsageError("the septum has no direction here: click nearer to it, or type its axis", place="position_mm")
    axis = turn @ (slope[::-1] / length)
    thickness = float(_read(distances[first], middle) + _read(distances[second], middle))
    position = geometry.index_to_world(middle[::-1] + low)
    names = table[first].name, table[second].name
    return SeptumPlace(_plain(position), _plain(axis), max(thickness, 0.0), names)


def _signed_mm(mask: Bool, spacing: Float64) -> Float32:
    """Distance to a structure's border, mm; below 0 inside."""
    resolution = tuple(spacing[::-1])
    outside = edt.edt(np.ascontiguousarray(~mask), anisotropy=resolution)
    inside = edt.edt(np.ascontiguousarray(mask), anisotropy=resolution)
    half = 0.5 * float(spacing.min())
    found: Float32 = np.where(mask, half - inside, outside - half).astype(np.float32)
    return found


def _read(field: Float32, at: Float64) -> float:
    return float(map_coordinates(field, at[:, None], order=1, mode="nearest")[0])


def _plain(vector: Float64) -> Vector3:
    x, y, z = (float(one) for one in vector)
    return x, y, z
