"""Synthetic MRI and CT of the phantom in a chest of lungs, fat, soft tissue and liver.

Signal per voxel is the mean over the voxel's volume (partial volume). Contrast to noise is (blood - myocardium) /
sigma, with sigma the standard deviation of the Gaussian noise: of each of the two channels of an MRI, whose
magnitude then follows Rice's distribution (Gudbjartsson and Patz, 1995), and of the Hounsfield units of a CT.

What :mod:`heartcase.phantom.scan.artefacts` adds is off unless asked for: breathing and ghosts of an MRI, texture of
the noise and streaks of a CT. It leaves the noise of a seed as it is (but for its texture).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.anatomy.regions import CAVITY_COUNT, materials
from heartcase.phantom.scan.artefacts import acquired_by_lines, breathing, line_weights, streaked, textured_noise
from heartcase.schemas.arrays import Complex64, Float32, Float64, UInt8
from heartcase.schemas.errors import UsageError
from heartcase.schemas.geometry import Geometry

__all__ = [
    "CT_UNITS",
    "MRI_UNITS",
    "SPECIMEN_UNITS",
    "UNDILUTED_HU",
    "CtArtefacts",
    "MriArtefacts",
    "SyntheticScan",
    "acquire_ct",
    "acquire_mri",
    "noise_free",
]


LUNG, BLOOD, MYOCARDIUM, VESSEL_WALL, FAT, SOFT_TISSUE, LIVER, CAVAL_BLOOD = range(8)
MRI_UNITS: tuple[float, ...] = (40.0, 1000.0, 420.0, 350.0, 180.0, 330.0, 480.0)
"""Signal of lung, blood, myocardium, vessel wall, fat, soft tissue and liver in a fat-suppressed SSFP sequence."""
CT_UNITS: tuple[float, ...] = (-800.0, 350.0, 110.0, 70.0, -90.0, 55.0, 95.0)
"""Hounsfield units of the same with contrast medium in all chambers."""
SPECIMEN_UNITS: tuple[float, ...] = (-1000.0, -1000.0, 100.0, 100.0, -1000.0, -1000.0, -1000.0)
"""Hounsfield units of the same for a plastinated heart in air: tissue full of plastic, air in all cavities."""
UNDILUTED_HU = 900.0
"""Hounsfield units of contrast medium that is still on its way through the superior vena cava."""
_PART = 200_000
_VOXELS_SHARE = 0.1
"""Part of the time that the voxels' middles take; the rest goes to the points of those at borders."""
_SUPERIOR_CAVA = 6
"""Place of the superior vena cava among the phantom's lumens."""
_MOTION_STREAM = 1
"""Number of the random numbers that motion takes, so that the noise is the same with and without it."""


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
    """(blood - myocardium) / noise_sd, without sign."""
    noise_sd: float
    """Standard deviation of the Gaussian noise (of each channel for MRI)."""


@dataclass(frozen=True)
class MriArtefacts:
    """What disturbs an MRI. All is off unless said."""

    motion_mm: float = 0.0
    """Window of the respiratory gating, 5 in the usual protocol: during the scan the heart's places are spread evenly
    over so many mm along the patient's z. The truth is where the heart is by and large."""
    lines_per_breath: float = 0.0
    """0: places without order, which blur and smear. Above: a periodic motion, which makes ghosts."""
    ghost: float = 0.0
    """Amplitude a of lines that rise and fall, 1 + a cos(2 pi n / p): two ghosts of a / 2 times the signal."""
    ghost_period: float = 4.0
    """Their period p in lines: the ghosts lie 1 / p of the field of view to each side."""
    phase_axis: int = 1
    """Axis of the phase encoding, along which ghosts lie: 0 (i), 1 (j: back to front in axial slices) or 2 (k)."""

    def __post_init__(self) -> None:
        if self.phase_axis not in (0, 1, 2):
            raise UsageError("the axis of the phase encoding is 0 (i), 1 (j) or 2 (k)", place="phase axis")
        # Their own checks, also of what is switched off.
        line_weights(1, self.ghost, self.ghost_period)
        breathing(1, self.motion_mm, np.random.Generator(np.random.PCG64(0)), lines_per_breath=self.lines_per_breath)


@dataclass(frozen=True)
class CtArtefacts:
    """What disturbs a CT. All is off unless said."""

    texture: bool = False
    """Noise as filtered back-projection leaves it, instead of white noise; the same standard deviation."""
    texture_peak_per_mm: float = 0.25
    """Frequency of the texture's highest power, cycles per mm."""
    slice_correlation: float = 0.2
    """Correlation of the texture in neighbouring slices, 0 to 0.7."""
    streak: float = 0.0
    """Hounsfield units by which beam hardening darkens the worst place of the scan."""
    streak_above: float = 200.0
    """Hounsfield units above which tissue hardens the beam."""
    caval_hu: float | None = None
    """Hounsfield units of the blood in the superior vena cava, such as ``UNDILUTED_HU``; None is as all blood."""


def acquire_mri(
    phantom: HeartPhantom,
    geometry: Geometry,
    *,
    contrast_to_noise: float = 14.5,
    bias: float = 0.08,
    seed: int = 1,
    supersampling: int = 3,
    signal: Float64 | None = None,
    artefacts: MriArtefacts | None = None,
    told: Callable[[float], None] = lambda _: None,
) -> SyntheticScan:
    """Steady-state free precession MRI with fat suppression: magnitude of a complex signal.

    Parameters
    ----------
    phantom, geometry, supersampling, told
        As in :func:`noise_free`.
    contrast_to_noise
        (blood - myocardium) / sigma; 14.5 is sigma 40 where blood is 1000. Infinity makes no noise.
    bias
        Largest relative deviation of the receiver's sensitivity in the scan, a quadratic field.
    seed
        Seed of the noise and of the bias field.
    signal
        What :func:`noise_free` gives for the same phantom, lattice and ``MRI_UNITS``, where it is at hand; not changed.
    artefacts
        Motion and ghosts; None is neither.

    Returns
    -------
    SyntheticScan
        ``values`` float32, never negative.

    Raises
    ------
    UsageError
        A setting is out of its range.
    """
    _check(contrast_to_noise, supersampling)
    if not 0.0 <= bias < 1.0:
        raise UsageError("the bias must be at least 0 and below 1", place="bias")
    generator = np.random.Generator(np.random.PCG64(seed))
    if signal is None:
        signal = noise_free(phantom, geometry, MRI_UNITS, supersampling=supersampling, told=told)
    signal = signal * (1.0 + bias * _bias_field(geometry.shape, generator))
    sigma = (MRI_UNITS[BLOOD] - MRI_UNITS[MYOCARDIUM]) / contrast_to_noise
    image = _disturbed(signal, geometry, artefacts or MriArtefacts(), seed)
    real = image.real + sigma * generator.standard_normal(geometry.shape)
    imaginary = sigma * generator.standard_normal(geometry.shape)
    if np.iscomplexobj(image):
        imaginary += image.imag
    return SyntheticScan(np.hypot(real, imaginary).astype(np.float32), geometry, "MR", contrast_to_noise, sigma)


def acquire_ct(
    phantom: HeartPhantom,
    geometry: Geometry,
    *,
    contrast_to_noise: float = 8.0,
    seed: int = 1,
    supersampling: int = 3,
    signal: Float64 | None = None,
    units: tuple[float, ...] = CT_UNITS,
    slice_thickness_mm: float | None = None,
    in_air: bool = False,
    artefacts: CtArtefacts | None = None,
    told: Callable[[float], None] = lambda _: None,
) -> SyntheticScan:
    """CT with contrast medium in all chambers, in Hounsfield units with Gaussian noise.

    Parameters
    ----------
    phantom, geometry, supersampling, slice_thickness_mm, in_air, told
        As in :func:`noise_free`.
    contrast_to_noise
        (blood - myocardium) / sigma without sign; 8 is sigma 30 HU (137 HU in a specimen). Infinity makes no noise.
    seed
        Seed of the noise.
    signal
        What :func:`noise_free` gives for the same phantom, lattice, units (with ``caval_hu`` as an eighth) and slice
        thickness, where it is at hand; not changed.
    units
        Hounsfield units per tissue: ``CT_UNITS``, or ``SPECIMEN_UNITS`` for a plastinated heart.
    artefacts
        Texture and streaks; None is white noise without streaks.

    Returns
    -------
    SyntheticScan
        ``values`` float32, not clipped.

    Raises
    ------
    UsageError
        A setting is out of its range.
    """
    _check(contrast_to_noise, supersampling)
    artefacts = artefacts or CtArtefacts()
    if artefacts.caval_hu is not None:
        units = (*units[:CAVAL_BLOOD], artefacts.caval_hu)
    generator = np.random.Generator(np.random.PCG64(seed))
    if signal is None:
        signal = noise_free(
            phantom,
            geometry,
            units,
            supersampling=supersampling,
            slice_thickness_mm=slice_thickness_mm,
            in_air=in_air,
            told=told,
        )
    pixel_mm = (geometry.spacing_mm[1], geometry.spacing_mm[0])
    if artefacts.streak != 0.0:
        signal = streaked(signal, pixel_mm, above=artefacts.streak_above, darkest=artefacts.streak)
    sigma = abs(units[BLOOD] - units[MYOCARDIUM]) / contrast_to_noise
    noise: Float64 | Float32
    if artefacts.texture:
        noise = textured_noise(
            geometry.shape,
            pixel_mm,
            generator,
            peak_per_mm=artefacts.texture_peak_per_mm,
            slice_correlation=artefacts.slice_correlation,
        )
    else:
        noise = generator.standard_normal(geometry.shape)
    noisy = signal + sigma * noise
    return SyntheticScan(noisy.astype(np.float32), geometry, "CT", contrast_to_noise, sigma)


def noise_free(
    phantom: HeartPhantom,
    geometry: Geometry,
    units: tuple[float, ...],
    *,
    supersampling: int = 3,
    slice_thickness_mm: float | None = None,
    in_air: bool = False,
    told: Callable[[float], None] = lambda _: None,
) -> Float64:
    """Mean signal of each voxel for a signal per tissue.

    Parameters
    ----------
    phantom
        The heart.
    geometry
        Lattice of the scan.
    units
        Signal of lung, blood, myocardium, vessel wall, fat, soft tissue and liver; then, where it differs from other
        blood, of that in the superior vena cava.
    supersampling
        Points per voxel and axis where a voxel may hold a border.
    slice_thickness_mm
        Extent of a voxel along k, with gaps to its neighbours where that is less than their distance; None is none. A
        slice is as thick everywhere (its profile is a box).
    in_air
        Nothing lies around the heart, and its vessels end where they are cut off: a specimen.
    told
        Hears now and then how much is done, from 0 to 1.

    Returns
    -------
    Float64
        Shape ``geometry.shape``.

    Raises
    ------
    UsageError
        The slices are not thicker than 0, or thicker than their distance; or units are missing.
    """
    if not CAVAL_BLOOD <= len(units) <= CAVAL_BLOOD + 1:
        raise UsageError("the signals of 7 tissues are needed (8 with the superior vena cava's blood)", place="units")
    thickness = geometry.spacing_mm[2] if slice_thickness_mm is None else slice_thickness_mm
    if not 0.0 < thickness <= geometry.spacing_mm[2]:
        raise UsageError(
            f"slices must be thicker than 0 mm and at most as thick as they are apart, {geometry.spacing_mm[2]:g} mm",
            place="slice thickness",
        )
    caval = len(units) > CAVAL_BLOOD
    signal_of = np.array(units)
    # One voxel more on each side: a border may cut a corner of the outermost voxels.
    padded = geometry.cropped((-1, -1, -1), tuple(n + 2 for n in geometry.size))  # type: ignore[arg-type]
    shape = padded.shape
    tissue = np.empty(shape, np.uint8)
    clearance = np.empty(shape)
    plane = np.stack(np.meshgrid(np.arange(shape[2]), np.arange(shape[1]), indexing="xy"), axis=-1)
    for k in range(shape[0]):
        index = np.concatenate([plane, np.full((*plane.shape[:2], 1), k)], axis=-1)
        found, near = _tissues(phantom, padded.index_to_world(index.reshape(-1, 3)), caval, in_air)
        tissue[k], clearance[k] = found.reshape(shape[1:]), near.reshape(shape[1:])
        told(_VOXELS_SHARE * (k + 1) / shape[0] if supersampling > 1 else (k + 1) / shape[0])
    inner = (slice(1, -1),) * 3
    signal = signal_of[tissue[inner]]
    if supersampling > 1:
        half_diagonal = 0.5 * float(np.linalg.norm(geometry.spacing_mm))
        border = (clearance < half_diagonal) | (ndimage.minimum_filter(tissue, 3) != ndimage.maximum_filter(tissue, 3))
        border = border[inner]
        centres = np.argwhere(border)[:, ::-1]
        offsets = np.indices((supersampling,) * 3).reshape(3, -1).T
        fractions = (offsets + 0.5) / supersampling - 0.5
        fractions[:, 2] *= thickness / geometry.spacing_mm[2]
        mean = np.empty(len(centres))
        step = max(1, _PART // len(fractions))
        for first in range(0, len(centres), step):
            part = centres[first : first + step, None, :] + fractions
            found, _ = _tissues(phantom, geometry.index_to_world(part.reshape(-1, 3)), caval, in_air)
            mean[first : first + step] = signal_of[found].reshape(-1, len(fractions)).mean(axis=1)
            told(_VOXELS_SHARE + (1.0 - _VOXELS_SHARE) * min((first + step) / len(centres), 1.0))
        signal[border] = mean
    return signal


def _disturbed(signal: Float64, geometry: Geometry, artefacts: MriArtefacts, seed: int) -> Float64 | Complex64:
    """The signal as motion and ghosts leave it; the same array where there are none."""
    if artefacts.motion_mm == 0.0 and artefacts.ghost == 0.0:
        return signal
    phase_axis = 2 - artefacts.phase_axis
    count = geometry.shape[phase_axis]
    weights = line_weights(count, artefacts.ghost, artefacts.ghost_period) if artefacts.ghost > 0.0 else None
    shifts = None
    if artefacts.motion_mm > 0.0:
        generator = np.random.Generator(np.random.PCG64([seed, _MOTION_STREAM]))
        shifts = breathing(count, artefacts.motion_mm, generator, lines_per_breath=artefacts.lines_per_breath)
    i, j, k = np.linalg.inv(geometry.index_to_world_matrix)[:, 2]
    return acquired_by_lines(
        signal,
        phase_axis,
        weights=weights,
        shifts_mm=shifts,
        voxels_per_mm=(float(k), float(j), float(i)),
        centred=True,
    )


def _tissues(phantom: HeartPhantom, points: Float64, caval: bool, in_air: bool) -> tuple[UInt8, Float64]:
    """Tissue at points, and a lower bound on the distance to the next border of the heart's materials.

    The superior vena cava's blood is a tissue of its own where ``caval``. Where ``in_air`` there is nothing around the
    heart, and its vessels end where they are cut off.
    """
    tables, ends, canals, thickness, _ = phantom.truth.kernel_arguments
    material = np.empty(len(points), np.uint8)
    clearance = np.empty(len(points))
    hull = np.empty(len(points))
    materials(tables, ends, canals, thickness, np.ascontiguousarray(points), material, clearance, hull)
    outside = material == 0
    if in_air:
        is_tissue = np.isin(phantom.truth.label(points), phantom.truth.table.tissue_values)
        return np.where(is_tissue, MYOCARDIUM, LUNG).astype(np.uint8), clearance
    side = np.array((-1.0 if phantom.form.is_mirrored else 1.0, 1.0, 1.0))
    material[outside] = _surroundings(points[outside] * side / phantom.scale, hull[outside] / phantom.scale)
    if caval:
        blood = np.flatnonzero(material == BLOOD)
        lumens = phantom.anatomy.tables.evaluate(points[blood])[:, :CAVITY_COUNT]
        material[blood[lumens.argmin(axis=1) == _SUPERIOR_CAVA]] = CAVAL_BLOOD
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
