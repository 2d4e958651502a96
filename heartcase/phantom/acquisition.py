"""Synthetic MRI and CT of the phantom in a chest of lungs, fat, soft tissue and liver.

Signal per voxel is the mean over the voxel's volume (partial volume). Contrast to noise is (blood - myocardium) /
sigma, with sigma the standard deviation of the Gaussian noise: of each of the two channels of an MRI, whose
magnitude then follows Rice's distribution (Gudbjartsson and Patz, 1995), and of the Hounsfield units of a CT.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from heartcase.phantom.heart import HeartPhantom
from heartcase.phantom.regions import materials
from heartcase.schemas.errors import UsageError
from heartcase.schemas.geometry import Geometry

__all__ = ["CT_UNITS", "MRI_UNITS", "SyntheticScan", "acquire_ct", "acquire_mri", "noise_free"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
UInt8 = npt.NDArray[np.uint8]

LUNG, BLOOD, MYOCARDIUM, VESSEL_WALL, FAT, SOFT_TISSUE, LIVER = range(7)
MRI_UNITS: tuple[float, ...] = (40.0, 1000.0, 420.0, 350.0, 180.0, 330.0, 480.0)
"""Signal of lung, blood, myocardium, vessel wall, fat, soft tissue and liver in a fat-suppressed SSFP sequence."""
CT_UNITS: tuple[float, ...] = (-800.0, 350.0, 110.0, 70.0, -90.0, 55.0, 95.0)
"""Hounsfield units of the same with contrast medium in all chambers."""
_PART = 200_000


@dataclass(frozen=True)
class SyntheticScan:
    """A synthetic scan."""

    values: Float32
    """Intensities, shape ``geometry.shape``; Hounsfield units for CT, arbitrary units (blood 1000) for MRI."""
    geometry: Geometry
    """Where the voxel centres lie."""
    modality: str
    """``MR`` or ``CT``."""
    contrast_to_noise: float
    """(blood - myocardium) / noise_sd."""
    noise_sd: float
    """Standard deviation of the Gaussian noise (of each channel for MRI)."""


def acquire_mri(
    phantom: HeartPhantom,
    geometry: Geometry,
    *,
    contrast_to_noise: float = 14.5,
    bias: float = 0.08,
    seed: int = 1,
    supersampling: int = 3,
    signal: Float64 | None = None,
) -> SyntheticScan:
    """Steady-state free precession MRI with fat suppression: magnitude of a complex signal.

    Parameters
    ----------
    phantom
        The heart.
    geometry
        Lattice of the scan.
    contrast_to_noise
        (blood - myocardium) / sigma; 14.5 is sigma 40 where blood is 1000. Infinity makes no noise.
    bias
        Largest relative deviation of the receiver's sensitivity in the scan, a quadratic field.
    seed
        Seed of the noise and of the bias field.
    supersampling
        Points per voxel and axis where a voxel may hold a border.
    signal
        What :func:`noise_free` gives for the same phantom, lattice and ``MRI_UNITS``, where it is at hand; not changed.

    Returns
    -------
    SyntheticScan
        ``values`` float32, never negative.
    """
    _check(contrast_to_noise, supersampling)
    if not 0.0 <= bias < 1.0:
        raise UsageError("the bias must be at least 0 and below 1", place="bias")
    generator = np.random.Generator(np.random.PCG64(seed))
    if signal is None:
        signal = noise_free(phantom, geometry, MRI_UNITS, supersampling=supersampling)
    signal = signal * (1.0 + bias * _bias_field(geometry.shape, generator))
    sigma = (MRI_UNITS[BLOOD] - MRI_UNITS[MYOCARDIUM]) / contrast_to_noise
    real = signal + sigma * generator.standard_normal(geometry.shape)
    imaginary = sigma * generator.standard_normal(geometry.shape)
    return SyntheticScan(np.hypot(real, imaginary).astype(np.float32), geometry, "MR", contrast_to_noise, sigma)


def acquire_ct(
    phantom: HeartPhantom,
    geometry: Geometry,
    *,
    contrast_to_noise: float = 8.0,
    seed: int = 1,
    supersampling: int = 3,
    signal: Float64 | None = None,
) -> SyntheticScan:
    """CT with contrast medium in all chambers, in Hounsfield units with Gaussian noise.

    Parameters
    ----------
    phantom
        The heart.
    geometry
        Lattice of the scan.
    contrast_to_noise
        (blood - myocardium) / sigma; 8 is sigma 30 HU. Infinity makes no noise.
    seed
        Seed of the noise.
    supersampling
        Points per voxel and axis where a voxel may hold a border.
    signal
        What :func:`noise_free` gives for the same phantom, lattice and ``CT_UNITS``, where it is at hand; not changed.
    """
    _check(contrast_to_noise, supersampling)
    generator = np.random.Generator(np.random.PCG64(seed))
    if signal is None:
        signal = noise_free(phantom, geometry, CT_UNITS, supersampling=supersampling)
    sigma = (CT_UNITS[BLOOD] - CT_UNITS[MYOCARDIUM]) / contrast_to_noise
    noisy = signal + sigma * generator.standard_normal(geometry.shape)
    return SyntheticScan(noisy.astype(np.float32), geometry, "CT", contrast_to_noise, sigma)


def noise_free(
    phantom: HeartPhantom, geometry: Geometry, units: tuple[float, ...], *, supersampling: int = 3
) -> Float64:
    """Mean signal of each voxel, shape ``geometry.shape``, float64, for a signal per tissue."""
    signal_of = np.array(units)
    # One voxel more on each side: a border may cut a corner of the outermost voxels.
    padded = geometry.cropped((-1, -1, -1), tuple(n + 2 for n in geometry.size))  # type: ignore[arg-type]
    shape = padded.shape
    tissue = np.empty(shape, np.uint8)
    clearance = np.empty(shape)
    plane = np.stack(np.meshgrid(np.arange(shape[2]), np.arange(shape[1]), indexing="xy"), axis=-1)
    for k in range(shape[0]):
        index = np.concatenate([plane, np.full((*plane.shape[:2], 1), k)], axis=-1)
        found, near = _tissues(phantom, padded.index_to_world(index.reshape(-1, 3)))
        tissue[k], clearance[k] = found.reshape(shape[1:]), near.reshape(shape[1:])
    inner = (slice(1, -1),) * 3
    signal = signal_of[tissue[inner]]
    if supersampling > 1:
        half_diagonal = 0.5 * float(np.linalg.norm(geometry.spacing_mm))
        border = (clearance < half_diagonal) | (ndimage.minimum_filter(tissue, 3) != ndimage.maximum_filter(tissue, 3))
        border = border[inner]
        centres = np.argwhere(border)[:, ::-1]
        offsets = np.indices((supersampling,) * 3).reshape(3, -1).T
        fractions = (offsets + 0.5) / supersampling - 0.5
        mean = np.empty(len(centres))
        step = max(1, _PART // len(fractions))
        for first in range(0, len(centres), step):
            part = centres[first : first + step, None, :] + fractions
            found, _ = _tissues(phantom, geometry.index_to_world(part.reshape(-1, 3)))
            mean[first : first + step] = signal_of[found].reshape(-1, len(fractions)).mean(axis=1)
        signal[border] = mean
    return signal


def _tissues(phantom: HeartPhantom, points: Float64) -> tuple[UInt8, Float64]:
    """Tissue at points, and a lower bound on the distance to the next border of the heart's materials."""
    tables, ends, canals, thickness, _ = phantom.truth.kernel_arguments
    material = np.empty(len(points), np.uint8)
    clearance = np.empty(len(points))
    hull = np.empty(len(points))
    materials(tables, ends, canals, thickness, np.ascontiguousarray(points), material, clearance, hull)
    outside = material == 0
    material[outside] = _surroundings(points[outside] / phantom.scale, hull[outside] / phantom.scale)
    return material, clearance


def _surroundings(points: Float64, hull: Float64) -> UInt8:
    """Chest around the heart; points and distance from the heart in mm of the adult."""
    x, y, z = points.T
    tissue = np.full(len(points), LUNG, np.uint8)
    diaphragm = -62.0 + 16.0 * np.exp(-((x + 45.0) ** 2 + (y - 5.0) ** 2) / (2.0 * 50.0**2))
    tissue[z < diaphragm] = SOFT_TISSUE
    tissue[z < diaphragm - 4.0] = LIVER
    chest = ((x - 5.0) / 150.0) ** 2 + ((y - 20.0) / 98.0) ** 2
    spine = np.hypot(x / 1.2, y - 88.0) < 21.0
    tissue[(chest > 1.0) | spine] = SOFT_TISSUE
    mediastinum = hull < 5.0 + 7.0 / (1.0 + np.exp(-(z - 35.0) / 6.0)) + 6.0 / (1.0 + np.exp(-(y - 45.0) / 5.0))
    tissue[mediastinum] = FAT
    return tissue


def _bias_field(shape: tuple[int, int, int], generator: np.random.Generator) -> Float64:
    """Random quadratic field with values from -1 to 1, shape ``shape``."""
    axes = np.meshgrid(
        *(np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1) for n in shape), indexing="ij", sparse=True
    )
    weights = generator.standard_normal(9)
    z, y, x = axes
    terms = (x, y, z, x * y, y * z, z * x, x * x, y * y, z * z)
    field = np.zeros(shape)
    for weight, term in zip(weights, terms, strict=True):
        field += weight * term
    field -= 0.5 * (field.max() + field.min())
    peak = float(np.abs(field).max())
    return field / peak if peak > 0.0 else field


def _check(contrast_to_noise: float, supersampling: int) -> None:
    if not contrast_to_noise > 0.0:
        raise UsageError("the contrast to noise must be above zero", place="noise")
    if supersampling < 1:
        raise UsageError("at least one point per voxel and axis is needed", place="supersampling")
