"""The landscape that the watershed floods: the gradient, and below the noise the shape of the structures.

Steep places are ridges. Where two structures are open to each other, as a ventricle and an atrium are through their
valve, the gradient is nothing but noise, and the lowest pass is anywhere. There the *shape* decides: the gradient of
the blurred scan is small in the middle of a chamber and larger in a narrow, which has walls nearby. What it adds cannot
exceed about the gradient of the noise, so that steep borders hardly move:

    height = g + c * s / sqrt(c^2 + s^2)

with the gradient magnitude g, that of the blurred scan s, and c 1.2 times the tenth percentile of g. So flat a tenth
of a scan is noise alone, whatever else is in it; a median would not do, as in a real chest half of the voxels are lung,
fat and bone with a texture of their own, several times as steep as blood. ``heartcase bench accuracy`` puts it beside a
watershed of the gradient alone: chambers are mostly divided better, the myocardium can lose a little.

Even so the label that first finds a way through a valve may take the whole next chamber: of many low passes the lowest
is an accident of the noise. So nothing is lower than a *noise floor*, 4 times that percentile in a CT and 6 times in
other scans; less where a scan has so little noise that the percentile is near that of its borders. What lies below is
flat, and labels that mark one flat share it by the shortest ways
(:mod:`heartcase.pipeline.watershed.flat_minima.division`). A step there costs 1 + h^4, with the height h from before
the floor in tenth percentiles: so a weak border, or a narrow, still is where labels meet, unless it is far nearer to
the one marker than to the other. (Ways that add up are those of a geodesic distance, Criminisi, Sharp and Blake, ECCV
2008; their highest pass is that of a watershed. This takes the one below the floor and the other above it.) ``heartcase
bench accuracy-default`` measures it. Blur, share, floor and exponent were chosen on phantoms, so those are no
independent test of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from heartcase.compiling.kernel import loop_kernel
from heartcase.pipeline.image.gradient import gradient_magnitude
from heartcase.schemas.arrays import Float32, UInt16
from heartcase.schemas.recipe.resolved import ResolvedSegment
from heartcase.schemas.recipe.settings import SegmentSettings

__all__ = ["Landscape", "landscape", "resolve_segment"]


SHAPE_SHARE = 1.2
"""Most that the shape adds, in units of the gradient of the flattest voxels."""
MOST_COST = 65_535
"""Largest cost of a voxel."""
AXIS_PARTS = 8
"""Lengths of steps are whole numbers of this part of the shortest."""
FLAT_QUANTILE = 0.1
"""Part of the voxels that surely lies in tissue of one kind: the gradient there is noise alone."""
STEEP_QUANTILE = 0.99
"""Part of the voxels that no border reaches above: the gradient there is that of the steepest borders."""
NOISE_BELOW = 32.0
"""Noise is lower than those by so much at least; a scan without noise has no flatter voxels than borders. It is 65 to
160 in scans as of ``heartcase bench accuracy-default``."""
SAMPLE_VOXELS = 200_000
"""Voxels of which the percentile is taken, at least where there are as many."""
SHAPE_SIGMA_MM = 3.0
"""Blur for the shape where the settings leave it out, mm."""
CT_NOISE_FLOOR, NOISE_FLOOR = 4.0, 6.0
"""Floor where the settings leave it out: for a CT, in which myocardium of few strokes runs into the liver from 4.5 on,
and for others."""


@dataclass(frozen=True)
class Landscape:
    """What the watershed floods, and how flat minima are divided."""

    height: Float32
    """Intensity per mm, float32, shape [z, y, x], >= 0."""
    cost: UInt16 | None
    """Cost of a step into each voxel where it is flat, uint16 >= 1, same shape; None without a noise floor."""
    axis_cost: tuple[int, int, int]
    """Cost of a step along z, y and x besides: its length, in some unit."""


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
    shape_sigma_mm, noise_floor = settings.shape_sigma_mm, settings.noise_floor
    if shape_sigma_mm is None:
        shape_sigma_mm = SHAPE_SIGMA_MM
    if noise_floor is None:
        noise_floor = CT_NOISE_FLOOR if modality == "CT" else NOISE_FLOOR
    return ResolvedSegment.of(settings, shape_sigma_mm=shape_sigma_mm, noise_floor=noise_floor)


def landscape(
    values: npt.ArrayLike,
    spacing_mm: tuple[float, float, float],
    *,
    gradient_sigma_mm: float,
    shape_sigma_mm: float,
    noise_floor: float = 0.0,
) -> Landscape:
    """What the watershed floods.

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
    Landscape
        Heights, and what steps through flat voxels cost.
    """
    height = gradient_magnitude(values, spacing_mm, sigma_mm=gradient_sigma_mm)
    flat, noise = _levels(height)
    if shape_sigma_mm > 0.0 and flat > 0.0:
        shape = gradient_magnitude(values, spacing_mm, sigma_mm=shape_sigma_mm)
        _add_shape(height.reshape(-1), shape.reshape(-1), np.float32(SHAPE_SHARE * flat))
    cost = None
    if noise_floor > 0.0 and noise > 0.0:
        cost = np.empty(height.shape, np.uint16)
        _raise_to(height.reshape(-1), np.float32(noise), np.float32(noise_floor * noise), cost.reshape(-1))
    return Landscape(height, cost, _axis_cost(spacing_mm))


def _axis_cost(spacing_mm: tuple[float, float, float]) -> tuple[int, int, int]:
    """Lengths of a step along z, y and x, in the smallest whole numbers that are near enough."""
    x, y, z = (round(AXIS_PARTS * one / min(spacing_mm)) for one in spacing_mm)
    common = math.gcd(x, y, z)
    return z // common, y // common, x // common


def _levels(height: Float32) -> tuple[float, float]:
    """Gradient of the flattest voxels, and of what counts as noise; padding, which is 0, is left out."""
    sample = height.ravel()[:: max(height.size // SAMPLE_VOXELS, 1)]
    sample = sample[sample > 0.0]
    if not len(sample):
        return 0.0, 0.0
    flat, steep = (float(level) for level in np.quantile(sample, (FLAT_QUANTILE, STEEP_QUANTILE)))
    return flat, min(flat, steep / NOISE_BELOW)


@loop_kernel
def _raise_to(height, unit, floor, cost):
    for n in numba.prange(len(height)):
        square = (min(height[n], floor) / unit) ** 2
        cost[n] = np.uint16(min(np.float32(1.5) + square * square, np.float32(MOST_COST)))
        height[n] = max(height[n], floor)


@loop_kernel
def _add_shape(height, shape, most):
    for n in numba.prange(len(height)):
        part = shape[n] / most
        height[n] += most * part / np.sqrt(np.float32(1.0) + part * part)
