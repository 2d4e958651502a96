"""The filter stage: edge-preserving smoothing of the scan (thesis 11.1.2).

Perona and Malik's gradient anisotropic diffusion, du/dt = div(c grad u) with c = exp(-|grad u|^2 / (2 K^2)), in
mm: the flux through each voxel face is taken with the full gradient there, as in Gerig, Kuebler, Kikinis and Jolesz,
"Nonlinear anisotropic filtering of MRI data", IEEE Trans. Medical Imaging 11 (1992). K is ``conductance`` times the
root mean square gradient of the scan, taken anew before each step, so a setting serves every scanner's intensities.
"""

from __future__ import annotations

import dataclasses
import math
from decimal import ROUND_DOWN, Context

import numba
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Scan
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.settings import FilterSettings

__all__ = ["diffuse", "filter_scan", "resolve_filter", "time_step_limit"]

Float32 = npt.NDArray[np.float32]

TIME_STEP_TOLERANCE = 1e-6
"""Relative excess over the limit that a time step typed with rounded digits may have."""


def filter_scan(scan: Scan, settings: FilterSettings) -> Scan:
    """Smooth a scan and keep its edges.

    Parameters
    ----------
    scan
        The scan.
    settings
        Method, number of steps, conductance, time step.

    Returns
    -------
    Scan
        The same scan with smoothed values; the very same object for ``method="none"``.

    Raises
    ------
    StageError
        The scan holds values that are not finite, or the time step is beyond the stability limit.
    """
    if settings.method == "none":
        return scan
    bad = int(np.size(scan.values) - np.count_nonzero(np.isfinite(scan.values)))
    if bad:
        raise StageError(
            f"{bad} voxels of the scan are NaN or infinite; give them the intensity of air or crop them away",
            place="filter",
        )
    limit = time_step_limit(scan.geometry)
    time_step = resolve_filter(settings, scan.geometry).time_step or limit
    if time_step > limit * (1.0 + TIME_STEP_TOLERANCE):
        shown = Context(prec=4, rounding=ROUND_DOWN).create_decimal_from_float(limit)
        raise StageError(
            f"{time_step:g} is beyond the stability limit of this scan's spacing, {shown:f} mm2; "
            "give at most that, or leave it out",
            place="filter.time_step",
        )
    values = diffuse(
        scan.values,
        scan.geometry.spacing_mm,
        iterations=settings.iterations,
        conductance=settings.conductance,
        time_step=time_step,
    )
    return dataclasses.replace(scan, values=values)


def resolve_filter(settings: FilterSettings, geometry: Geometry) -> FilterSettings:
    """Settings with the time step that they leave to the scan's lattice filled in."""
    limit = time_step_limit(geometry)
    if settings.method == "none" or settings.time_step is not None or not math.isfinite(limit):
        return settings
    return settings.model_copy(update={"time_step": limit})


def time_step_limit(geometry: Geometry) -> float:
    """Longest stable diffusion step, in mm2: 1 / (4 sum 1/h^2) over the axes that have more than one voxel.

    Up to there every spatial frequency is damped by a factor between 0 and 1 (the largest eigenvalue of the discrete
    Laplacian is 4 sum 1/h^2 and no conductance exceeds one), and each new value is an average of old ones with
    weights that are not negative. Twice as long a step still obeys the maximum principle, but turns the sign of the
    finest frequency, which is mostly noise, instead of removing it.
    """
    total = sum(h**-2 for h, n in zip(geometry.spacing_mm, geometry.size, strict=True) if n > 1)
    return 0.25 / total if total > 0.0 else math.inf


def diffuse(
    values: Float32, spacing_mm: tuple[float, float, float], *, iterations: int, conductance: float, time_step: float
) -> Float32:
    """Gradient anisotropic diffusion of a volume; no flux through the outer faces.

    Parameters
    ----------
    values
        Finite float32, shape [z, y, x]; not changed.
    spacing_mm
        Voxel spacing along x, y, z, mm.
    iterations
        Number of explicit steps.
    conductance
        K in units of the root mean square gradient.
    time_step
        Length of a step, mm2.

    Returns
    -------
    ndarray
        float32, same shape.
    """
    inner = (slice(1, -1),) * 3
    old = np.pad(np.asarray(values, np.float32), 1, mode="edge")
    new = np.empty_like(old)
    inverse_spacing = 1.0 / np.array(spacing_mm)
    weight = np.where(np.array(values.shape[::-1]) > 1, time_step * inverse_spacing**2, 0.0).astype(np.float32)
    for _ in range(iterations):
        mean_square = float(_square_gradient_sums(old, inverse_spacing).sum()) / values.size
        if not mean_square > 0.0:
            break
        scale = (inverse_spacing / math.sqrt(2.0 * mean_square * conductance**2)).astype(np.float32)
        _step(old, new, scale, weight)
        _copy_edges(new)
        old, new = new, old
    return np.ascontiguousarray(old[inner])


def _copy_edges(padded: Float32) -> None:
    """Repeat the outermost voxels in the layer around them."""
    padded[0], padded[-1] = padded[1], padded[-2]
    padded[:, 0], padded[:, -1] = padded[:, 1], padded[:, -2]
    padded[:, :, 0], padded[:, :, -1] = padded[:, :, 1], padded[:, :, -2]


@numba.njit(cache=True, nogil=True, parallel=True)
def _square_gradient_sums(u, inverse_spacing):  # type: ignore[no-untyped-def]
    """Sum over each slice of the squared central-difference gradient; ``u`` has a layer of padding."""
    nz, ny, nx = u.shape
    sums = np.zeros(nz - 2)
    hx, hy, hz = 0.5 * inverse_spacing[0], 0.5 * inverse_spacing[1], 0.5 * inverse_spacing[2]
    for k in numba.prange(1, nz - 1):
        total = 0.0
        for j in range(1, ny - 1):
            for i in range(1, nx - 1):
                gx = (np.float64(u[k, j, i + 1]) - u[k, j, i - 1]) * hx
                gy = (np.float64(u[k, j + 1, i]) - u[k, j - 1, i]) * hy
                gz = (np.float64(u[k + 1, j, i]) - u[k - 1, j, i]) * hz
                total += gx * gx + gy * gy + gz * gz
        sums[k - 1] = total
    return sums


@numba.njit(cache=True, nogil=True, inline="always")
def _exp_of_minus(x):  # type: ignore[no-untyped-def]
    """exp(-x) for float32 x >= 0 to 2e-7, without a library call, so that the loop around it is vectorised."""
    t = min(x, np.float32(87.0)) * np.float32(1.4426950408889634)
    whole = np.int32(t)
    # 2^-f on [0, 1): Taylor series in (f - 1/2) ln 2
    r = (np.float32(0.5) - (t - np.float32(whole))) * np.float32(0.6931471805599453)
    p = np.float32(1.0 / 5040.0) * r + np.float32(1.0 / 720.0)
    p = p * r + np.float32(1.0 / 120.0)
    p = p * r + np.float32(1.0 / 24.0)
    p = p * r + np.float32(1.0 / 6.0)
    p = p * r + np.float32(0.5)
    p = p * r + np.float32(1.0)
    p = p * r + np.float32(1.0)
    power = np.int32((np.int32(127) - whole) << np.int32(23)).view(np.float32)
    return p * power * np.float32(0.7071067811865476)


@numba.njit(cache=True, nogil=True, inline="always")
def _conductance(along, side, side_near, other, other_near):  # type: ignore[no-untyped-def]
    """Conductance of a face from the scaled gradient there.

    ``along`` is the difference across the face; the others are the central differences times two along the other
    axes at the voxel and at its neighbour.
    """
    across = side + side_near
    beside = other + other_near
    return _exp_of_minus(along * along + np.float32(0.0625) * (across * across + beside * beside))


@numba.njit(cache=True, nogil=True)
def _step_row(new, o, ym, yp, zm, zp, mm, mp, pm, pp, scale, weight):  # type: ignore[no-untyped-def]
    """One row of a step: ``o`` is the row, ``ym`` to ``zp`` its neighbours, ``mm`` to ``pp`` those at z, y -1 or +1."""
    sx, sy, sz = scale[0], scale[1], scale[2]
    wx, wy, wz = weight[0], weight[1], weight[2]
    for i in range(new.size):
        c = o[i + 1]
        gx = (o[i + 2] - o[i]) * sx
        gy = (yp[i + 1] - ym[i + 1]) * sy
        gz = (zp[i + 1] - zm[i + 1]) * sz
        low = o[i] - c
        low *= _conductance(low * sx, gy, (yp[i] - ym[i]) * sy, gz, (zp[i] - zm[i]) * sz)
        high = o[i + 2] - c
        high *= _conductance(high * sx, gy, (yp[i + 2] - ym[i + 2]) * sy, gz, (zp[i + 2] - zm[i + 2]) * sz)
        change = wx * (low + high)
        low = ym[i + 1] - c
        low *= _conductance(low * sy, gx, (ym[i + 2] - ym[i]) * sx, gz, (pm[i + 1] - mm[i + 1]) * sz)
        high = yp[i + 1] - c
        high *= _conductance(high * sy, gx, (yp[i + 2] - yp[i]) * sx, gz, (pp[i + 1] - mp[i + 1]) * sz)
        change += wy * (low + high)
        low = zm[i + 1] - c
        low *= _conductance(low * sz, gx, (zm[i + 2] - zm[i]) * sx, gy, (mp[i + 1] - mm[i + 1]) * sy)
        high = zp[i + 1] - c
        high *= _conductance(high * sz, gx, (zp[i + 2] - zp[i]) * sx, gy, (pp[i + 1] - pm[i + 1]) * sy)
        change += wz * (low + high)
        new[i] = c + change


@numba.njit(cache=True, nogil=True, parallel=True)
def _step(u, new, scale, weight):  # type: ignore[no-untyped-def]
    """One Jacobi step from ``u`` into ``new``; both have a layer of padding, of ``new`` only the inside is set."""
    nz, ny, nx = u.shape
    for k in numba.prange(1, nz - 1):
        down, here, up = u[k - 1], u[k], u[k + 1]
        for j in range(1, ny - 1):
            _step_row(
                new[k, j, 1 : nx - 1],
                here[j],
                here[j - 1],
                here[j + 1],
                down[j],
                up[j],
                down[j - 1],
                down[j + 1],
                up[j - 1],
                up[j + 1],
                scale,
                weight,
            )
