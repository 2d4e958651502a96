"""Estimating the noise of a scan from the scan alone.

Blocks of 2 x 2 x 2 voxels are taken apart into orthonormal Haar wavelets. In tissue of one kind every coefficient but
the mean is noise. The finest coefficient, a difference along all axes at once, sees few edges: its median absolute
value gives sigma (Donoho and Johnstone, "Ideal spatial adaptation by wavelet shrinkage", Biometrika 81, 1994). It is
taken over the flattest blocks only: white noise makes it independent of what flatness is judged by, the differences
along one axis.

Both numbers are those of white noise. Scanners interpolate and reconstruct with smooth kernels, so neighbours share
noise, and the finest coefficient then sees less than half of it; the differences along one axis, which are what a
gradient sees, still hold it. So ``difference_sigma`` is there too: it has more bias from edges (it is
too high) and little from correlation.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Bool, Float32, Float64

__all__ = ["NoiseEstimate", "estimate_noise"]


_BLOCK_COUNT = 200_000
"""Blocks that are looked at, at most: more would not make the estimate better."""
_MEDIAN_OF_NORMAL = 0.6744897501960817
"""Median of the absolute value of a standard normal variable."""
_FLAT_QUANTILE = 0.25
"""Part of the blocks that counts as flat."""
_LOW_QUANTILE = 0.1
"""Part of the blocks that surely lies in tissue of one kind."""
_LOW_CHI_SQUARE = {1: 0.015790774093431, 2: 0.210721031315653, 3: 0.584374374155183}
"""That quantile of the chi-square distribution, by degrees of freedom."""
_INNER_COUNT_MIN = 10_000
"""Blocks that must remain inside the range of values: the flat ones among fewer say sigma to no better than 3%."""
_CLAMP_SIGMAS = 4.0
"""Distance from the end of the range, in sigma, below which clamping or a magnitude image changes the noise."""


@dataclass(frozen=True)
class NoiseEstimate:
    """The noise of a scan; both are zero where there is none, or none can be told from the tissue."""

    sigma: float
    """Standard deviation of the noise, from the finest differences; that of each channel for a magnitude MRI."""
    difference_sigma: float
    """Standard deviation of the white noise that makes differences between neighbours as large."""


def estimate_noise(values: Float32) -> NoiseEstimate:
    """Standard deviation of a scan's noise.

    Left out are blocks in padding and clamped air (constant at the end of the range of values) and, where enough
    others remain, those within four sigma of the end of the range, where clamping or the magnitude of an MRI (Rice's
    distribution) makes the noise smaller.

    Parameters
    ----------
    values
        Finite float32, shape [z, y, x]; axes of one voxel do not count.

    Returns
    -------
    NoiseEstimate
        In the unit of ``values``.
    """
    axes = [axis for axis in range(3) if values.shape[axis] > 1]
    if not axes:
        return NoiseEstimate(0.0, 0.0)
    corners = _corners(values, axes)
    lowest, highest = corners.min(axis=0), corners.max(axis=0)
    kept = _off_plateaus(lowest, highest)
    if not kept.any():
        return NoiseEstimate(0.0, 0.0)
    corners = corners[:, kept]
    floor, ceiling = float(lowest[kept].min()), float(highest[kept].max())
    mean = corners.mean(axis=0)
    finest = np.abs(_coefficient(corners, tuple(range(len(axes)))))
    energy = np.zeros_like(mean)
    for axis in range(len(axes)):
        energy += np.square(_coefficient(corners, (axis,)))
    inner = np.ones(mean.size, np.bool_)
    for _ in range(3):
        margin = _CLAMP_SIGMAS * _finest_sigma(finest[inner], energy[inner])
        within = (mean > floor + margin) & (mean < ceiling - margin)
        if np.count_nonzero(within) < max(0.05 * mean.size, _INNER_COUNT_MIN):
            break
        inner = within
    low = float(np.quantile(energy[inner], _LOW_QUANTILE))
    return NoiseEstimate(
        sigma=_finest_sigma(finest[inner], energy[inner]),
        difference_sigma=float(np.sqrt(low / _LOW_CHI_SQUARE[len(axes)])),
    )


def _corners(values: Float32, axes: list[int]) -> Float64:
    """The voxels of each block, float64, shape [2, 4 or 8 voxels, blocks].

    Along each axis they lie an odd number of voxels apart, so that slices interpolated between others have their share.
    """
    steps = [1, 1, 1]
    counts = list(values.shape)
    while math.prod(counts) > _BLOCK_COUNT:
        axis = counts.index(max(counts))
        steps[axis] += 2
        counts[axis] = math.ceil((values.shape[axis] - 1) / steps[axis])
    found = []
    for offsets in itertools.product((0, 1), repeat=len(axes)):
        places = [slice(None)] * 3
        for axis, offset in zip(axes, offsets, strict=True):
            places[axis] = slice(offset, values.shape[axis] - 1 + offset, steps[axis])
        found.append(values[tuple(places)].astype(np.float64).ravel())
    return np.stack(found)


def _coefficient(corners: Float64, axes: tuple[int, ...]) -> Float64:
    """Orthonormal Haar coefficient of each block: differences along some axes, sums along the others."""
    total = np.zeros(corners.shape[1])
    axis_count = corners.shape[0].bit_length() - 1
    for corner, offsets in zip(corners, itertools.product((0, 1), repeat=axis_count), strict=True):
        if sum(offsets[axis] for axis in axes) % 2:
            total -= corner
        else:
            total += corner
    return total / math.sqrt(corners.shape[0])


def _off_plateaus(lowest: Float64, highest: Float64) -> Bool:
    """Blocks without a voxel at a plateau at the end of the range: padding, clamped air, saturation, one by one."""
    kept = np.ones(lowest.size, np.bool_)
    while kept.any():
        plateau = lowest[kept].min()
        if not np.any(highest[kept] == plateau):
            break
        kept &= lowest != plateau
    while kept.any():
        plateau = highest[kept].max()
        if not np.any(lowest[kept] == plateau):
            break
        kept &= highest != plateau
    return kept


def _finest_sigma(finest: Float64, energy: Float64) -> float:
    """Sigma from the finest coefficients, absolute, of the flattest blocks."""
    flat = energy <= np.quantile(energy, _FLAT_QUANTILE)
    return float(np.median(finest[flat])) / _MEDIAN_OF_NORMAL
