"""Gradient magnitude of a scan in true mm: the landscape that the watershed floods (thesis 11.1.1)."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Float32

__all__ = ["gradient_magnitude"]


BLUR_REACH = 4.0
"""Standard deviations after which the Gaussian is cut off."""
PART = 1024
"""Voxels of a slice that are blurred together across the slices, so that they stay in the cache."""


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
    weights, reach = _blur_weights(count, sigma)
    blurred = np.empty(values.shape, np.float32)
    blur = (_blur_along_z, _blur_along_y, _blur_rows)[axis]
    blur(np.ascontiguousarray(values), weights, reach, blurred)
    return blurred


def _blur_weights(count: int, sigma: float) -> tuple[Float32, int]:
    """What the voxels of a line give to each blurred one, shape (blurred, voxel), and how far away they are at most."""
    reach = math.ceil(BLUR_REACH * sigma) + 1
    padded = np.pad(np.eye(count), [(reach, reach), (0, 0)], mode="reflect", reflect_type="odd")
    weights = ndimage.gaussian_filter1d(padded, sigma, axis=0, mode="nearest", truncate=BLUR_REACH)
    return np.ascontiguousarray(weights[reach : reach + count], np.float32), reach


@kernel(fastmath={"contract"})
def _add_four(one, two, three, four, weights, out):
    a, b, c, d = weights[0], weights[1], weights[2], weights[3]
    for i in range(len(out)):
        out[i] += a * one[i] + b * two[i] + c * three[i] + d * four[i]


@kernel(fastmath={"contract"})
def _add_one(row, weight, out):
    for i in range(len(out)):
        out[i] += weight * row[i]


@copied
def _blur_row(row, weights, reach, padded, out):
    count = len(row)
    out[:] = np.float32(0.0)
    if count <= 2 * reach:
        for i in range(count):
            for n in range(max(i - reach, 0), min(i + reach + 1, count)):
                out[i] += weights[i, n] * row[n]
        return
    # what lies past the ends is reflected, so that all voxels have the same weights
    for i in range(count):
        padded[reach + i] = row[i]
    for t in range(1, reach + 1):
        padded[reach - t] = row[0] + row[0] - row[t]
        padded[reach + count - 1 + t] = row[count - 1] + row[count - 1] - row[count - 1 - t]
    kernel = weights[reach, : 2 * reach + 1]
    t = 0
    while t + 4 <= len(kernel):
        _add_four(
            padded[t : t + count],
            padded[t + 1 : t + 1 + count],
            padded[t + 2 : t + 2 + count],
            padded[t + 3 : t + 3 + count],
            kernel[t : t + 4],
            out,
        )
        t += 4
    while t < len(kernel):
        _add_one(padded[t : t + count], kernel[t], out)
        t += 1


@loop_kernel
def _blur_rows(values, weights, reach, blurred):
    nz, ny, nx = values.shape
    for k in numba.prange(nz):
        padded = np.empty(nx + 2 * reach, np.float32)
        for j in range(ny):
            _blur_row(values[k, j], weights, reach, padded, blurred[k, j])


@copied
def _blur_sheet(rows, weights, reach, blurred):
    """Blur across the rows of a sheet of them."""
    count = len(rows)
    for here in range(count):
        out = blurred[here]
        out[:] = np.float32(0.0)
        n, stop = max(here - reach, 0), min(here + reach + 1, count)
        while n + 4 <= stop:
            _add_four(rows[n], rows[n + 1], rows[n + 2], rows[n + 3], weights[here, n : n + 4], out)
            n += 4
        while n < stop:
            _add_one(rows[n], weights[here, n], out)
            n += 1


@loop_kernel
def _blur_along_y(values, weights, reach, blurred):
    for k in numba.prange(values.shape[0]):
        _blur_sheet(values[k], weights, reach, blurred[k])


@loop_kernel
def _blur_along_z(values, weights, reach, blurred):
    nz, ny, nx = values.shape
    slices, blurred_slices = values.reshape(nz, ny * nx), blurred.reshape(nz, ny * nx)
    for part in numba.prange((ny * nx + PART - 1) // PART):
        low, high = part * PART, min((part + 1) * PART, ny * nx)
        _blur_sheet(slices[:, low:high], weights, reach, blurred_slices[:, low:high])


@copied
def _row_lengths(row, ym, yp, zm, zp, hx, hy, hz, out):
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


@loop_kernel
def _slope_lengths(values, spacing, length):
    nz, ny, _ = values.shape
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
