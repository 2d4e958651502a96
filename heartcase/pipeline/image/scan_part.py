"""The filtered scan as whole numbers of 16 bits, for viewers that show slices beside the tissue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.data import Scan
from heartcase.schemas.arrays import Int16
from heartcase.schemas.bundle.format import ScanValues

__all__ = ["ScanPart", "scan_part"]

_LOWEST, _HIGHEST = -32768, 32767

HOUNSFIELD_SPAN_MIN = 256.0
"""A scan that calls itself CT but spans less is not in Hounsfield units: whole numbers would be too coarse for it."""


@dataclass(frozen=True)
class ScanPart:
    """A scan in 16 bits."""

    intensity: Int16
    """Stored numbers, shape ``geometry.shape`` of the scan: [z, y, x]."""
    values: ScanValues
    """What a stored number stands for."""


def scan_part(scan: Scan) -> ScanPart:
    """Round a scan to 16 bits.

    CT is rounded to whole Hounsfield units, far below its noise. Everything else is spread over all 65,536 numbers,
    so the error is at most half a step: 1/131,070 of the span from the darkest to the brightest voxel.

    Parameters
    ----------
    scan
        The cropped, filtered scan.

    Returns
    -------
    ScanPart
        ``values.error_max`` is the largest difference that was found. Voxels that are not numbers become the darkest.
    """
    is_number = np.isfinite(scan.values)
    low = float(scan.values.min(initial=np.inf, where=is_number)) if is_number.any() else 0.0
    high = float(scan.values.max(initial=-np.inf, where=is_number)) if is_number.any() else 0.0
    is_hounsfield = scan.modality == "CT" and low >= _LOWEST and high <= _HIGHEST and high - low >= HOUNSFIELD_SPAN_MIN
    slope, intercept = 1.0, 0.0
    if not is_hounsfield:
        slope = (high - low) / (_HIGHEST - _LOWEST) or 1.0
        intercept = low - slope * _LOWEST
    stored = np.empty(scan.values.shape, np.int16)
    error_max = 0.0
    for number, plane in enumerate(scan.values):
        numbers = np.nan_to_num(plane.astype(np.float64), nan=low, posinf=high, neginf=low)
        rounded = np.clip(np.rint((numbers - intercept) / slope), _LOWEST, _HIGHEST)
        error_max = max(error_max, float(np.abs(slope * rounded + intercept - numbers).max()))
        stored[number] = rounded
    unit = "HU" if scan.modality == "CT" else "1"
    return ScanPart(stored, ScanValues(slope=slope, intercept=intercept, unit=unit, error_max=error_max))
