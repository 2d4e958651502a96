"""The landscape that the watershed floods: the gradient, and below the noise the shape of the structures.

Steep places are ridges. Where two structures are open to each other, as a ventricle and an atrium are through their
valve, the gradient is nothing but noise, and the lowest pass is anywhere. There the *shape* decides: the gradient of
the blurred scan is small in the middle of a chamber and larger in a narrow, which has walls nearby. What it adds cannot
exceed about the gradient of the noise, so that steep borders hardly move:

    height = g + c * s / sqrt(c^2 + s^2)

with the gradient magnitude g, that of the blurred scan s, and c 1.6 times the tenth percentile of g. So flat a tenth
of a scan is noise alone, whatever else is in it; a median would not do, as in a real chest half of the voxels are lung,
fat and bone with a texture of their own, several times as steep as blood. ``heartcase bench accuracy`` puts it beside a
watershed of the gradient alone: chambers are mostly divided better, the myocardium can lose a little.

In a CT blood is so smooth that even this leaves the label that first finds a way through a valve the whole next
chamber. So nothing is lower than a *noise floor*, 3.5 times that percentile: what lies below is flat, and labels that
mark one flat meet half way (:mod:`heartcase.pipeline.watershed.division`). In MR the border of a vena cava with its
atrium would be half way too, and there the scan knows better: no floor (``heartcase bench accuracy-default``). Blur,
share and floor were chosen on phantoms, so those are no independent test of them.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from heartcase.compiling.kernel import loop_kernel
from heartcase.pipeline.image.gradient import gradient_magnitude
from heartcase.schemas.arrays import Float32
from heartcase.schemas.recipe.resolved import ResolvedSegment
from heartcase.schemas.recipe.settings import SegmentSettings

__all__ = ["landscape", "resolve_segment"]


SHAPE_SHARE = 1.6
"""Most that the shape adds, in units of the gradient of the flattest voxels."""
FLAT_QUANTILE = 0.1
"""Part of the voxels that surely lies in tissue of one kind: the gradient there is noise alone."""
SAMPLE_VOXELS = 200_000
"""Voxels of which the percentile is taken, at least where there are as many."""
CT_SHAPE_SIGMA_MM, SHAPE_SIGMA_MM = 2.0, 3.0
"""Blur for the shape where the settings leave it out, mm: for a CT and for others."""
CT_NOISE_FLOOR, NOISE_FLOOR = 3.5, 0.0
"""Floor where the settings leave it out. With 3.75 in a CT, myocardium of few strokes runs into the liver."""


def resolve_segment(settings: SegmentSettings, modality: str) -> ResolvedSegment:
    """Settings with what they leave to the kind of scan filled in; resolved ones come back as they are.

    Parameters
    ----------
    settings
        Any.
    modality
        Of the scan: ``CT``, ``MR`` or ``unknown``.
    """
    if isinstance(settings, ResolvedSegment):
        return settings
    is_ct = modality == "CT"
    shape_sigma_mm, noise_floor = settings.shape_sigma_mm, settings.noise_floor
    if shape_sigma_mm is None:
        shape_sigma_mm = CT_SHAPE_SIGMA_MM if is_ct else SHAPE_SIGMA_MM
    if noise_floor is None:
        noise_floor = CT_NOISE_FLOOR if is_ct else NOISE_FLOOR
    return ResolvedSegment.of(settings, shape_sigma_mm=shape_sigma_mm, noise_floor=noise_floor)


def landscape(
    values: npt.ArrayLike,
    spacing_mm: tuple[float, float, float],
    *,
    gradient_sigma_mm: float,
    shape_sigma_mm: float,
    noise_floor: float = 0.0,
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
    noise_floor
        Least height, in tenth percentiles of the gradient; 0 for none.

    Returns
    -------
    ndarray
        Intensity per mm, float32, same shape, >= 0.
    """
    height = gradient_magnitude(values, spacing_mm, sigma_mm=gradient_sigma_mm)
    flat = _of_flat(height)
    if shape_sigma_mm > 0.0 and flat > 0.0:
        shape = gradient_magnitude(values, spacing_mm, sigma_mm=shape_sigma_mm)
        _add_shape(height.reshape(-1), shape.reshape(-1), np.float32(SHAPE_SHARE * flat))
    if noise_floor > 0.0:
        np.maximum(height, np.float32(noise_floor * flat), out=height)
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
