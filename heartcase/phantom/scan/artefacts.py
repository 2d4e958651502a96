"""What a scanner adds to the true signal: motion and ghosts of an MRI; texture of the noise and streaks of a CT.

Arrays in, arrays out. Volumes are indexed ``[z, y, x]``, and axis numbers here are those of the array. All runs in one
thread, so the same inputs give the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import fft, ndimage, sparse

from heartcase.schemas.arrays import Complex64, Float, Float32, Float64
from heartcase.schemas.errors import UsageError

__all__ = [
    "acquired_by_lines",
    "breathing",
    "coarse_blocks",
    "hardening_error",
    "line_weights",
    "streaked",
    "textured_noise",
]


_STILL_VOXELS = 1e-6
_BLEND_VOXELS = 16
"""Voxels over which a padded axis goes from its last value to its first one."""
_HANN_PEAK = 0.30567369
"""Where f cos(pi f / 2)^4 is highest: pi f / 2 tan(pi f / 2) = 1/4."""
_CORRELATION_LIMIT = float(np.sqrt(0.5))
_SLICES_AT_ONCE = 32


def breathing(
    count: int, window_mm: float, generator: np.random.Generator, *, lines_per_breath: float = 0.0
) -> Float64:
    """Where the heart was, along the direction of breathing, when each of an MRI's lines was read.

    Parameters
    ----------
    count
        Number of lines.
    window_mm
        Width of the gating window: positions are spread evenly over it, half to each side of zero.
    generator
        Source of the order, or of the breath's phase.
    lines_per_breath
        0: no line knows of the next, as where breaths and heartbeats have nothing to do with each other. Above: lines
        in which the position goes forth and back once, at constant speed (which too is an even spread).

    Returns
    -------
    Float64
        Positions in mm, shape (count,), from the lowest spatial frequency (negative) to the highest.

    Raises
    ------
    UsageError
        The window is negative, or the breath is shorter than two lines.
    """
    if not 0.0 <= window_mm < np.inf:
        raise UsageError("the window of the motion must be at least 0 mm", place="motion")
    if lines_per_breath != 0.0 and not 2.0 <= lines_per_breath < np.inf:
        raise UsageError("a breath must last at least 2 lines, or 0 for no order", place="lines per breath")
    if lines_per_breath == 0.0:
        evenly = (np.arange(count) + 0.5) / count - 0.5
        return window_mm * generator.permutation(evenly)
    turns = (np.arange(count) / lines_per_breath + generator.random()) % 1.0
    return window_mm * (np.abs(2.0 * turns - 1.0) - 0.5)


def line_weights(count: int, amplitude: float, period: float) -> Float64:
    """Amplitudes of an MRI's lines that rise and fall periodically, 1 + a cos(2 pi n / p), with n = 0 in the centre.

    By the shift theorem the image gets two ghosts of a / 2 times its signal, count / p voxels to each side; with p = 2
    both fall on the same place. Lines of a period that does not divide ``count`` give ghosts between the voxels.

    Parameters
    ----------
    count
        Number of lines.
    amplitude
        a, from 0 up to and without 1.
    period
        p in lines, at least 2.

    Returns
    -------
    Float64
        Shape (count,), from the lowest spatial frequency (negative) to the highest.

    Raises
    ------
    UsageError
        An amplitude or a period is out of its range.
    """
    if not 0.0 <= amplitude < 1.0:
        raise UsageError("the ghosts' amplitude must be at least 0 and below 1", place="ghost")
    if not 2.0 <= period < np.inf:
        raise UsageError("the ghosts' period must be at least 2 lines", place="ghost period")
    weights: Float64 = 1.0 + amplitude * np.cos(2.0 * np.pi * (np.arange(count) - count // 2) / period)
    return weights


def acquired_by_lines(
    signal: Float,
    phase_axis: int,
    *,
    weights: Float64 | None = None,
    shifts_mm: Float64 | None = None,
    voxels_per_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    centred: bool = False,
) -> Complex64:
    """Image of an object that moves, or whose signal changes, from one line of k-space to the next.

    A line is everything with one frequency along ``phase_axis``, read while the object stood at shift s: its values are
    those of the object at rest times exp(-2 pi i f s) (the shift theorem; for what follows in the image see Wood and
    Henkelman, 1985). Shifts without order blur along the motion and smear along ``phase_axis``; periodic ones make
    ghosts. Along ``phase_axis`` what leaves on one side comes back on the other, as in a scanner; along the other axes,
    which a scanner reads with more room than it keeps, the outermost values go on outside.

    Parameters
    ----------
    signal
        Signal of the object at rest, three axes; not changed.
    phase_axis
        Axis whose frequencies are read one after the other, 0 to 2.
    weights
        Amplitude of each line, shape (n,), from the lowest frequency to the highest; None is 1 everywhere.
    shifts_mm
        Shift at each line, shape (n,), in the same order; None is no motion.
    voxels_per_mm
        What 1 mm of the shift is in voxels along each axis of ``signal``.
    centred
        Take off the shifts the one that fits the object best in the sense of least squares, so that the object lies, by
        and large, where it lay at rest. (Else it lies where it was at the few lines in the centre of k-space.)

    Returns
    -------
    Complex64
        The image, shape of ``signal``; its magnitude is what is looked at.
    """
    shifts = np.zeros(signal.shape[phase_axis]) if shifts_mm is None else np.asarray(shifts_mm, dtype=float)
    reach = float(np.abs(shifts).max()) * np.abs(np.array(voxels_per_mm))
    moving = [axis for axis in range(3) if reach[axis] > _STILL_VOXELS]
    spectrum = signal.astype(np.complex64)
    for axis in moving:
        if axis != phase_axis:
            spectrum = _closed(spectrum, axis, 1 + int(np.ceil(reach[axis])) * (2 if centred else 1))
    axes = sorted({phase_axis, *moving})
    spectrum = fft.fftn(spectrum, axes=axes, overwrite_x=True, workers=1)

    # cycles per mm of the shift, as far as each axis adds to them, ready to be added to each other
    frequency = np.zeros((1, 1, 1))
    for axis in moving:
        along = voxels_per_mm[axis] * np.fft.fftfreq(spectrum.shape[axis])
        frequency = frequency + np.moveaxis(along[:, None, None], 0, axis)
    frequency = np.moveaxis(frequency, phase_axis, 0)
    lines = np.moveaxis(spectrum, phase_axis, 0)
    count = len(lines)
    frequency = np.broadcast_to(frequency, (count, *frequency.shape[1:]))
    shifts = np.fft.ifftshift(shifts)
    if moving and centred:
        shifts = shifts - _best_shift(lines, frequency, shifts)
    amplitudes = np.ones(count) if weights is None else np.fft.ifftshift(weights)
    for line, across, shift, amplitude in zip(lines, frequency, shifts, amplitudes, strict=True):
        line *= (amplitude * np.exp(-2j * np.pi * shift * across)).astype(np.complex64)
    image = fft.ifftn(spectrum, axes=axes, overwrite_x=True, workers=1)
    kept: Complex64 = image[tuple(slice(n) for n in signal.shape)]
    return kept


def _best_shift(lines: Complex64, frequency: Float64, shifts: Float64) -> float:
    """Shift s of the whole object for which sum |S|^2 f^2 (shift - s)^2 over k-space is least, mm.

    That is the least squared difference of the images, to the second order of the shifts.
    """
    weight = np.array(
        [
            float(np.sum((line.real**2 + line.imag**2) * across**2))
            for line, across in zip(lines, frequency, strict=True)
        ]
    )
    total = float(weight.sum())
    return float((weight * shifts).sum()) / total if total > 0.0 else 0.0


def _closed(values: Complex64, axis: int, margin: int) -> Complex64:
    """Values with a bridge behind the last ones along an axis: ``margin`` times the last, a blend, then the first."""
    length = fft.next_fast_len(values.shape[axis] + 2 * margin + _BLEND_VOXELS) - values.shape[axis]
    way = np.clip((np.arange(length) - margin + 0.5) / (length - 2 * margin), 0.0, 1.0)
    first_part = np.moveaxis((0.5 - 0.5 * np.cos(np.pi * way)).astype(np.float32)[:, None, None], 0, axis)
    first, last = np.take(values, [0], axis), np.take(values, [-1], axis)
    closed: Complex64 = np.concatenate([values, last + first_part * (first - last)], axis=axis)
    return closed


def textured_noise(
    shape: tuple[int, int, int],
    pixel_mm: tuple[float, float],
    generator: np.random.Generator,
    *,
    peak_per_mm: float = 0.25,
    slice_correlation: float = 0.2,
) -> Float32:
    """Gaussian noise with the texture of filtered back-projection: mean 0 in every slice, standard deviation 1.

    White noise of projections, filtered by the ramp f and a window A and projected back, has the power f A(f)^2: it
    rises from zero with the frequency (Riederer, Pelc and Chesler, 1978; Kijewski and Judy, 1987, for pixels, whose
    aliasing is left out here). A is Hann's window, cos(pi f / 2 c)^2 up to its cutoff c, about 3.27 times the
    frequency of the highest power. The standard deviation is that of the ensemble: any one array's differs by chance.

    Parameters
    ----------
    shape
        Shape ``[z, y, x]``; the texture is that of the planes of y and x.
    pixel_mm
        Spacing along y and x.
    generator
        Source of the noise.
    peak_per_mm
        Frequency of the highest power, cycles per mm; a soft kernel for body and heart has about 0.25.
    slice_correlation
        Correlation of neighbouring slices, from 0 to 0.7 (that of a kernel of three slices).

    Returns
    -------
    Float32
        The noise. Its opposite edges fit together.

    Raises
    ------
    UsageError
        A frequency or correlation is out of its range, or a slice is too small to hold the texture.
    """
    if not 0.0 < peak_per_mm < np.inf:
        raise UsageError("the texture's frequency must be above zero", place="texture")
    if not 0.0 <= slice_correlation <= _CORRELATION_LIMIT:
        raise UsageError("the correlation of slices must be from 0 to 0.7", place="slice correlation")
    if shape[1] * shape[2] < 2:
        raise UsageError("a slice of one pixel has no texture", place="texture")
    gain = _texture_gain(shape[1:], pixel_mm, peak_per_mm)
    # kernel (side, middle, side) with 2 side middle = correlation and power 1
    middle = np.sqrt(0.5 + 0.5 * np.sqrt(1.0 - 2.0 * slice_correlation**2))
    side, middle = np.float32(0.5 * slice_correlation / middle), np.float32(middle)
    noise = np.empty(shape, np.float32)
    slices = _filtered_slices(shape[1:], gain, generator)
    before, here = next(slices), next(slices)
    for k, after in zip(range(shape[0]), slices, strict=False):
        noise[k] = middle * here + side * (before + after)
        before, here = here, after
    return noise


def _texture_gain(shape: tuple[int, int], pixel_mm: tuple[float, float], peak_per_mm: float) -> Float32:
    """Factor for each frequency of a real slice's transform; the mean of its square over all frequencies is 1."""
    rows = np.fft.fftfreq(shape[0], pixel_mm[0])
    columns = np.fft.fftfreq(shape[1], pixel_mm[1])
    frequency = np.hypot(rows[:, None], columns)
    part = frequency * (_HANN_PEAK / peak_per_mm)
    power = np.where(part < 1.0, frequency * np.cos(0.5 * np.pi * part) ** 4, 0.0)
    mean = float(power.mean())
    if not mean > 0.0:
        raise UsageError("the slices are too small for a texture of so low a frequency", place="texture")
    gain: Float32 = np.sqrt(power[:, : shape[1] // 2 + 1] / mean).astype(np.float32)
    return gain


def _filtered_slices(shape: tuple[int, int], gain: Float32, generator: np.random.Generator) -> Iterator[Float32]:
    while True:
        white = generator.standard_normal(shape, dtype=np.float32)
        yield fft.irfft2(gain * fft.rfft2(white, workers=1), shape, workers=1)


def coarse_blocks(values: Float, most: int) -> tuple[Float64, tuple[int, int]]:
    """Means of the smallest blocks of pixels that leave at most ``most`` rows and columns.

    Parameters
    ----------
    values
        Slices, shape (n, y, x); beyond its edges there is zero.
    most
        Rows and columns at most.

    Returns
    -------
    tuple
        The means, and how many rows and columns one block has.
    """
    rows, columns = (-(-n // most) for n in values.shape[1:])
    full = [(0, 0), *((0, -n % block) for n, block in zip(values.shape[1:], (rows, columns), strict=True))]
    padded = np.pad(values.astype(float), full)
    blocks = padded.reshape(len(values), padded.shape[1] // rows, rows, padded.shape[2] // columns, columns)
    return blocks.mean(axis=(2, 4)), (rows, columns)


def hardening_error(dense: Float64, pixel_mm: tuple[float, float], *, angles: int = 180) -> Float64:
    """What beam hardening takes from slices with dense tissue: -1 times what p^2 gives, p the path through the tissue.

    A spectrum's mean energy rises on its way through dense tissue, so that a ray's attenuation is p - c p^2 instead of
    p (Joseph and Spital, 1978; Herman, 1979, for the polynomial). Filtered back-projection is linear: its error is c
    times what is returned here. p^2 makes dense things darker inside; rays through two of them have 2 p q more than
    both alone, which is the dark band from one to the other.

    Rays are parallel. Projections are exact integrals over strips of the width of a pixel.

    Parameters
    ----------
    dense
        Attenuation of the dense tissue, shape (n, y, x), 0 elsewhere; in a unit u per mm.
    pixel_mm
        Spacing along y and x.
    angles
        Directions of rays over half a turn.

    Returns
    -------
    Float64
        Shape of ``dense``, in u squared times mm.
    """
    count, rows, columns = dense.shape
    width = min(pixel_mm)
    y, x = ((np.arange(n) - 0.5 * (n - 1)) * step for n, step in zip((rows, columns), pixel_mm, strict=True))
    middle = int(np.ceil(0.5 * np.hypot(rows * pixel_mm[0], columns * pixel_mm[1]) / width)) + 1
    bins = 2 * middle + 1
    length = fft.next_fast_len(2 * bins, real=True)
    ramp = fft.rfft(_ramp_kernel(length), workers=1)[:, None] / width
    pixels = np.ascontiguousarray(dense.reshape(count, -1).T, dtype=float)
    error = np.zeros_like(pixels)
    for angle in np.pi * np.arange(angles) / angles:
        cosine, sine = float(np.cos(angle)), float(np.sin(angle))
        place = middle + (y[:, None] * sine + x * cosine).ravel() / width
        shares = _strip_shares(place, abs(cosine) * pixel_mm[1] / width, abs(sine) * pixel_mm[0] / width, bins)
        path = (shares.T @ pixels) * (pixel_mm[0] * pixel_mm[1] / width)
        filtered = fft.irfft(ramp * fft.rfft(path**2, length, axis=0, workers=1), length, axis=0, workers=1)
        error -= shares @ np.ascontiguousarray(filtered[:bins])
    error *= np.pi / angles
    return np.ascontiguousarray(error.T).reshape(dense.shape)


def _strip_shares(place: Float64, first_width: float, second_width: float, bins: int) -> sparse.csr_array:
    """Share of each pixel's area in each strip, shape (pixels, strips); a row's sum is 1.

    The shadow of a pixel is a trapezoid: two boxes of these widths, folded. Lengths are in strips.
    """
    a, b = (max(0.5 * width, 1e-6) for width in (first_width, second_width))
    touched = int(np.ceil(2.0 * (a + b))) + 1
    first = np.floor(place - a - b + 0.5).astype(np.int64)
    borders = (first[:, None] + np.arange(touched + 1) - 0.5) - place[:, None]
    # antiderivative of the trapezoid
    squares = [np.maximum(borders + edge, 0.0) ** 2 for edge in (a + b, a - b, b - a, -a - b)]
    below = (squares[0] - squares[1] - squares[2] + squares[3]) / (8.0 * a * b)
    shares = np.diff(below, axis=1)
    strips = np.clip(first[:, None] + np.arange(touched), 0, bins - 1)
    starts = np.arange(len(place) + 1) * touched
    return sparse.csr_array((shares.ravel(), strips.ravel(), starts), shape=(len(place), bins))


def _ramp_kernel(length: int) -> Float64:
    """The ramp filter band-limited to the bins, in space, cyclic (Kak and Slaney, 1988, chapter 3)."""
    n = np.fft.fftfreq(length, 1.0 / length).round()
    odd = n % 2.0 == 1.0
    kernel = np.zeros(length)
    kernel[odd] = -1.0 / (np.pi * n[odd]) ** 2
    kernel[0] = 0.25
    return kernel


def streaked(values: Float, pixel_mm: tuple[float, float], *, above: float, darkest: float, most: int = 128) -> Float64:
    """Slices with the dark bands of beam hardening by dense tissue (see :func:`hardening_error`).

    Parameters
    ----------
    values
        Hounsfield units, shape (n, y, x); not changed.
    pixel_mm
        Spacing along y and x.
    above
        What exceeds these Hounsfield units hardens the beam, in proportion to the excess.
    darkest
        By how much the most darkened place of the whole scan gets darker, in Hounsfield units. It lies in dense tissue
        where that is in one piece; the bands between several are weaker.
    most
        Rows and columns at most of the slices that are projected: bands are smooth.

    Returns
    -------
    Float64
        The slices; the same values where nothing is dense.

    Raises
    ------
    UsageError
        The darkening is negative or not finite.
    """
    if not 0.0 <= darkest < np.inf:
        raise UsageError("the streaks' darkening must be at least 0", place="streak")
    result = values.astype(float)
    at = np.flatnonzero((values > above).any(axis=(1, 2)))
    if darkest == 0.0 or len(at) == 0:
        return result
    errors = []
    block = (1, 1)
    for first in range(0, len(at), _SLICES_AT_ONCE):
        excess = np.maximum(values[at[first : first + _SLICES_AT_ONCE]] - above, 0.0)
        coarse, block = coarse_blocks(excess, most)
        errors.append(hardening_error(coarse, (pixel_mm[0] * block[0], pixel_mm[1] * block[1])))
    error = np.concatenate(errors)
    error *= darkest / -float(error.min())
    # centres of the pixels among those of the blocks
    places = np.meshgrid(
        *((np.arange(n) + 0.5) / step - 0.5 for n, step in zip(values.shape[1:], block, strict=True)), indexing="ij"
    )
    for k, change in zip(at, error, strict=True):
        result[k] += ndimage.map_coordinates(change, places, order=1, mode="nearest")
    return result
