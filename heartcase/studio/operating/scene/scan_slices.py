"""Slices of a case's scan through any plane, as greys: of the scan in its recipe, or of that in the case."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from heartcase.pipeline.stages.read import region_of_scan
from heartcase.schemas.arrays import Float32, Float64, UInt8
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import HeartcaseError, UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text
from heartcase.simulator.load import load_case

__all__ = ["ScanSlice", "ScanSlices", "has_scan", "open_scan"]

_PIXELS_MAX = 512
"""Longest side of a slice: finer than its voxels it never is."""
_SHOWN_PERCENT = (1.0, 99.0)
"""What of 100 voxels is below black, and below white."""


@dataclass(frozen=True)
class ScanSlice:
    """A slice: a picture, and where it lies."""

    greys: UInt8
    """Grey, and 255 inside of the scan, 0 beside it, half at its rim, shape (rows, columns, 2)."""
    origin_mm: Float64
    """Outer corner of the first pixel, LPS mm, shape (3,)."""
    width_mm: float
    """How far the picture goes to the right."""
    height_mm: float
    """How far it goes down."""


class ScanSlices:
    """A scan that is sliced.

    Parameters
    ----------
    values
        Intensities, shape ``geometry.shape``.
    geometry
        Where the voxel centres lie.
    """

    def __init__(self, values: Float32, geometry: Geometry) -> None:
        self._values = values
        self._geometry = geometry
        sample = values[
            :: max(1, values.shape[0] // 64), :: max(1, values.shape[1] // 64), :: max(1, values.shape[2] // 64)
        ]
        low, high = (float(one) for one in np.percentile(sample, _SHOWN_PERCENT))
        self.window = (low, high if high > low else low + 1.0)
        """Intensities that are black and white at first."""
        self.range = (min(float(values.min()), low), max(float(values.max()), self.window[1]))
        """The lowest and the highest intensity."""

    def through(
        self,
        point_mm: npt.ArrayLike,
        right: npt.ArrayLike,
        down: npt.ArrayLike,
        window: tuple[float, float] | None = None,
    ) -> ScanSlice:
        """The slice through a point: all of the scan that lies in the plane.

        Parameters
        ----------
        point_mm
            A point of the plane, LPS mm, shape (3,).
        right, down
            Directions of the picture, LPS, unit length, at right angles, shape (3,).
        window
            Intensities that are black and white; as at first when left out.
        """
        geometry = self._geometry
        axes = np.array([right, down], dtype=float)
        size = np.array(geometry.size)
        corners = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)]) * size - 0.5
        reach = (geometry.index_to_world(corners) - np.asarray(point_mm, dtype=float)) @ axes.T
        low, high = reach.min(axis=0), reach.max(axis=0)
        pixel_mm = max(min(geometry.spacing_mm), float((high - low).max()) / _PIXELS_MAX)
        columns, rows = (max(1, int(np.ceil(one))) for one in (high - low) / pixel_mm)
        origin = np.asarray(point_mm, dtype=float) + low @ axes
        across, along = (np.arange(columns) + 0.5) * pixel_mm, (np.arange(rows) + 0.5) * pixel_mm
        places = origin + along[:, None, None] * axes[1] + across[None, :, None] * axes[0]
        index = geometry.world_to_index(places)
        within_mm = (np.minimum(index + 0.5, size - 0.5 - index) * geometry.spacing_mm).min(axis=-1)
        inside = np.rint(255.0 * np.clip(0.5 + within_mm / pixel_mm, 0.0, 1.0))
        found = map_coordinates(self._values, np.moveaxis(index[..., ::-1], -1, 0), order=1, mode="nearest")
        black, white = self.window if window is None else window
        grey = np.rint(255.0 * np.clip((found - black) / (white - black), 0.0, 1.0)).astype(np.uint8)
        greys = np.stack([grey, inside.astype(np.uint8)], axis=-1)
        return ScanSlice(greys, origin, columns * pixel_mm, rows * pixel_mm)


def has_scan(case: Path, recipe: Path | None) -> bool:
    """Whether there may be a scan to slice: a recipe that the case was built from, or one in the case."""
    return recipe is not None or open_bundle(case).has(FileRole.SCAN)


def open_scan(case: Path, recipe: Path | None) -> ScanSlices:
    """The scan of a case: that of its recipe where it is still what the case was built from, else the case's own.

    Parameters
    ----------
    case
        The case's folder.
    recipe
        The recipe that it was built from, where that is known.

    Raises
    ------
    UsageError
        There is none, or it is another one. Nothing in it tells where it lies, or what it is called.
    """
    bundle = open_bundle(case)
    reason = "the case holds no scan, and its recipe is not known: open the case from its recipe"
    if recipe is not None:
        try:
            scan = region_of_scan(parse_recipe(read_recipe_text(recipe), needs_markers=False), recipe.parent)
        except HeartcaseError:
            reason = "the recipe's scan cannot be read: open the recipe, it says why"
        else:
            if scan.values_sha256 == bundle.manifest.scan_sha256:
                return ScanSlices(scan.values, scan.geometry)
            reason = "the recipe's scan or its region is no longer what the case was built from: build the case again"
    if bundle.has(FileRole.SCAN):
        stored = load_case(case, needs=("grid", "scan")).scan
        assert stored is not None
        values = stored.stored * np.float32(stored.values.slope) + np.float32(stored.values.intercept)
        return ScanSlices(values, stored.geometry)
    raise UsageError(reason, place="scan")
