"""Gradient magnitude of a scan in true mm: the landscape that the watershed floods (thesis 11.1.1)."""

from __future__ import annotations

import math

import numba
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
    length = np.empty(smooth.shape, np.float32)
    _slope_lengths(np.ascontiguousarray(smooth), np.array(spacing, np.float32), length)
    return length


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


@numba.njit(cache=True, nogil=True)
def _row_lengths(row, ym, yp, zm, zp, hx, hy, hz, out):  # type: ignore[no-untyped-def]
    """Slopes of one row from itself and from its neighbours; ``hx`` to ``hz`` divide a central difference."""
    last = len(row) - 1
    for i in range(len(row)):
        y = (yp[i] - ym[i]) * hy
        z = (zp[i] - zm[i]) * hz
        out[i] = y * y + z * z
    for i in range(1, last):
        x = (row[i + 1] - row[i - 1]) * hx
        out[i] += x * x
    if last > 0:
        x = (row[1] - row[0]) * (hx + hx)
        out[0] += x * x
        x = (row[last] - row[last - 1]) * (hx + hx)
        out[last] += x * x
    for i in range(len(row)):
        out[i] = np.sqrt(out[i])


@numba.njit(cache=True, nogil=True, parallel=True)
def _slope_lengths(values, spacing, length):  # type: ignore[no-untyped-def]
    nz, ny, nx = values.shape
    half = np.float32(0.5)
    for line in numba.prange(nz * ny):
        k = line // ny
        j = line - k * ny
        # at the border the difference to the one neighbour there is
        km, kp = max(k - 1, 0), min(k + 1, nz - 1)
        jm, jp = max(j - 1, 0), min(j + 1, ny - 1)
        hz = np.float32(1.0) / (spacing[0] * np.float32(max(kp - km, 1)))
        hy = np.float32(1.0) / (spacing[1] * np.float32(max(jp - jm, 1)))
        _row_lengths(
            values[k, j],
            values[k, jm],
            values[k, jp],
            values[km, j],
            values[kp, j],
            half / spacing[2],
            hy,
            hz,
            length[k, j],
        )
