"""The landscape that the watershed floods: the gradient, and below the noise the shape of the structures.

Steep places are ridges. Where two structures are open to each other, as a ventricle and an atrium are through their
valve, the gradient is nothing but noise, and the lowest pass is anywhere. There the *shape* decides: the gradient of
the blurred scan is small in the middle of a chamber and larger in a narrow, which has walls nearby. What it adds cannot
exceed about the gradient of the noise, so that steep borders hardly move:

    height = g + c * s / sqrt(c^2 + s^2)

with the gradient magnitude g, that of the blurred scan s, and c 1.6 times the tenth percentile of g. So flat a tenth
of a scan is noise alone, whatever else is in it; a median would not do, as in a real chest half of the voxels are lung,
fat and bone with a texture of their own, several times as steep as blood. ``heartcase bench accuracy`` puts it beside a
watershed of the gradient alone: chambers are mostly divided better, the myocardium can lose a little. Blur and share
were chosen on phantoms, so those are no independent test of them.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from heartcase.compiling.kernel import loop_kernel
from heartcase.pipeline.image.gradient import gradient_magnitude
from heartcase.schemas.arrays import Float32

__all__ = ["landscape"]


SHAPE_SHARE = 1.6
"""Most that the shape adds, in units of the gradient of the flattest voxels."""
FLAT_QUANTILE = 0.1
"""Part of the voxels that surely lies in tissue of one kind: the gradient there is noise alone."""
SAMPLE_VOXELS = 200_000
"""Voxels of which the percentile is taken, at least where there are as many."""


def landscape(
    values: npt.ArrayLike, spacing_mm: tuple[float, float, float], *, gradient_sigma_mm: float, shape_sigma_mm: float
) -> Float32:
    """Height of each voxel for the watershed.

    Parameters
    ----------
    values
        Finite intensities, shape [z, y, x].
    spacing_mm
        Voxel spacing along x, y, z, mm.
    gradient_sigma_mm
        Standard deviation of the Gaussian blur before the gradient is taken, mm; 0 blurs nothing.
    shape_sigma_mm
        Standard deviation of the blur for the shape, mm; 0 takes the gradient alone.

    Returns
    -------
    ndarray
        Intensity per mm, float32, same shape, >= 0.
    """
    height = gradient_magnitude(values, spacing_mm, sigma_mm=gradient_sigma_mm)
    if shape_sigma_mm > 0.0:
        most = SHAPE_SHARE * _of_flat(height)
        if most > 0.0:
            shape = gradient_magnitude(values, spacing_mm, sigma_mm=shape_sigma_mm)
            _add_shape(height.reshape(-1), shape.reshape(-1), np.float32(most))
    return height


def _of_flat(height: Float32) -> float:
    """Tenth percentile of what is not zero, such as padding is; of evenly spread voxels."""
    sample = height.ravel()[:: max(height.size // SAMPLE_VOXELS, 1)]
    sample = sample[sample > 0.0]
    return float(np.quantile(sample, FLAT_QUANTILE)) if len(sample) else 0.0


@loop_kernel
def _add_shape(height, shape, most):
    for n in numba.prange(len(height)):
        part = shape[n] / most
        height[n] += most * part / np.sqrt(np.float32(1.0) + part * part)
