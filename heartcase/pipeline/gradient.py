"""Gradient magnitude of a scan in true mm: the landscape that the watershed floods (thesis 11.1.1)."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy import ndimage

__all__ = ["gradient_magnitude"]

Float32 = npt.NDArray[np.float32]

BLUR_REACH = 4.0
"""Standard deviations after which the Gaussian is cut off."""


def gradient_magnitude(
    values: npt.ArrayLike, spacing_mm: tuple[float, float, float], *, sigma_mm: float = 0.0
) -> Float32:
    """Length of the intensity gradient at each voxel.

    The scan is continued past its outer faces by point reflection, so that a slope goes on there: with a mirror the
    gradient would fade towards the border and the watershed would leak around the structures along it.

    Parameters
    ----------
    values
        Finite intensities, shape [z, y, x].
    spacing_mm
        Voxel spacing along x, y, z, mm.
    sigma_mm
        Standard deviation of the Gaussian blur before the central differences; 0 blurs nothing.

    Returns
    -------
    ndarray
        Intensity per mm, float32, same shape, >= 0. An axis with one voxel has no slope.
    """
    smooth = np.asarray(values, np.float32)
    spacing = spacing_mm[::-1]
    if sigma_mm > 0.0:
        for axis, h in enumerate(spacing):
            smooth = _blur(smooth, axis, sigma_mm / h)
    square = np.zeros(smooth.shape, np.float32)
    for axis, h in enumerate(spacing):
        if smooth.shape[axis] > 1:
            slope = np.gradient(smooth, np.float32(h), axis=axis)
            square += slope * slope
    return np.sqrt(square, out=square)


def _blur(values: Float32, axis: int, sigma: float) -> Float32:
    """Gaussian blur along one axis, ``sigma`` in voxels, continued past the ends by point reflection."""
    count = values.shape[axis]
    if count == 1:
        return values
    reach = math.ceil(BLUR_REACH * sigma) + 1
    pad = [(0, 0)] * values.ndim
    pad[axis] = (reach, reach)
    padded = np.pad(values, pad, mode="reflect", reflect_type="odd")
    blurred = ndimage.gaussian_filter1d(padded, sigma, axis=axis, mode="nearest", truncate=BLUR_REACH)
    inner: Float32 = np.take(blurred, range(reach, reach + count), axis=axis)
    return inner
