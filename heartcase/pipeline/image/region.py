"""Cutting the region of interest out of a scan."""

from __future__ import annotations

import dataclasses

import numpy as np

from heartcase.pipeline.data import Scan
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import RegionSettings

__all__ = ["crop_scan", "region_box"]

ALIGNMENT_TOLERANCE = 1e-4
"""Part of a voxel by which a region may overlap a voxel without taking it in: rounded digits in a recipe."""


def crop_scan(scan: Scan, region: RegionSettings | None) -> Scan:
    """Cut the region of interest out of a scan.

    Parameters
    ----------
    scan
        The scan.
    region
        A box along the scan's own axes; the whole scan when None.

    Returns
    -------
    Scan
        The smallest box of whole voxels that covers the region, as far as the scan reaches; values are copied.

    Raises
    ------
    StageError
        The region lies outside the scan.
    """
    if region is None:
        return scan
    start, size = region_box(scan.geometry, region)
    box = tuple(slice(first, first + count) for first, count in zip(start[::-1], size[::-1], strict=True))
    return dataclasses.replace(
        scan, values=np.ascontiguousarray(scan.values[box]).copy(), geometry=scan.geometry.cropped(start, size)
    )


def region_box(geometry: Geometry, region: RegionSettings) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    """First voxel (i, j, k) and number of voxels of the smallest box that covers a region, clipped to the lattice.

    Raises
    ------
    StageError
        The region lies outside the lattice.
    """
    center = geometry.world_to_index(region.center_mm)
    half = 0.5 * np.array(region.size_mm) / np.array(geometry.spacing_mm)
    # voxel n reaches from n - 1/2 to n + 1/2
    low = np.floor(center - half + 0.5 + ALIGNMENT_TOLERANCE).astype(int)
    high = np.ceil(center + half + 0.5 - ALIGNMENT_TOLERANCE).astype(int)
    low = np.maximum(low, 0)
    high = np.minimum(high, geometry.size)
    if np.any(high <= low):
        corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        reach = geometry.index_to_world(corners * np.array(geometry.size) - 0.5)
        bounds = ", ".join(
            f"{axis} {lower:.1f} to {upper:.1f}"
            for axis, lower, upper in zip("xyz", reach.min(axis=0), reach.max(axis=0), strict=True)
        )
        raise StageError(
            f"the region of interest lies outside the scan, which reaches over {bounds} mm (LPS); move center_mm there",
            place="region",
        )
    start = (int(low[0]), int(low[1]), int(low[2]))
    size = (int(high[0] - low[0]), int(high[1] - low[1]), int(high[2] - low[2]))
    return start, size
