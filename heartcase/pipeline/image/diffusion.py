"""Anisotropic diffusion of a volume, by gradient or by curvature: the explicit schemes and their kernels.

By gradient, the flux through each voxel face is taken with the full gradient there (Gerig, Kuebler, Kikinis and
Jolesz, "Nonlinear anisotropic filtering of MRI data", IEEE Trans. Medical Imaging 11, 1992). By curvature, the level
sets move, du/dt = |grad u| div(c grad u / |grad u|), so that a border is smoothed along itself and hardly across
(Whitaker and Xue, "Variable-conductance, level-set curvature for image denoising", Proc. ICIP, 2001); |grad u| before
the divergence is the upwind one of Osher and Sethian (Journal of Computational Physics 79, 1988), of slopes times their
conductance. What goes through a face is worked out once and used by the voxels on both sides of it, a row of faces at a
time.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Float32, Float64

__all__ = ["diffuse", "mean_square_gradient"]


_SLAB = 8
"""Planes that one task goes through; fixed, so that the result does not depend on the number of threads."""
_BLOCK = 2048
"""Voxels of a plane that are worked on together, in whole rows: their fluxes stay in the first-level cache."""
_DIFFERENCE_LIMIT = 1e18
"""Largest scaled difference: its square is still a float32."""
_SCALE_LIMIT = 1e36
"""Largest factor of a difference."""


def diffuse(
    values: Float32,
    spacing_mm: tuple[float, float, float],
    *,
    iterations: int,
    conductance: float,
    time_step: float,
    by_curvature: bool = False,
) -> Float32:
    """Anisotropic diffusion of a volume; no flux through the outer faces.

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
    by_curvature
        Move the level sets by their curvature instead of letting intensity flow down its gradient.

    Returns
    -------
    ndarray
        float32, same shape.
    """
    old = np.ascontiguousarray(values, np.float32)
    extent = float(old.max()) - float(old.min())
    if not extent > 0.0:
        return old.copy()
    inverse_spacing = 1.0 / np.array(spacing_mm)
    per_face = inverse_spacing if by_curvature else time_step * inverse_spacing**2
    weight = np.where(np.array(old.shape[::-1]) > 1, per_face, 0.0).astype(np.float32)
    # slopes that carry the level sets, in extents per mm: their squares are float32 whatever the unit of the values
    slope = _scale(inverse_spacing / extent)
    pace = np.float32(time_step * extent) if by_curvature else np.float32(0.0)
    edges = np.empty((2, -(-old.shape[0] // _SLAB), old[0].size), np.float32)
    for step in range(iterations):
        mean_square = mean_square_gradient(old, spacing_mm, extent)
        if not mean_square > 0.0:
            break
        # the exponent is in powers of two
        factor = math.sqrt(math.log2(math.e) / (2.0 * mean_square)) / conductance
        scale = _scale(np.minimum(inverse_spacing * factor, _DIFFERENCE_LIMIT / extent))
        # all steps but the first are taken in place: memory that comes fresh from the system costs as much as a step
        new = np.empty_like(old) if step == 0 else old
        _keep_edges(edges, _planes(old))
        _step(_planes(old), _planes(new), old.shape[2], scale, weight, edges, slope, pace)
        old = new
    return old if old is not values else old.copy()


def _scale(factors: Float64) -> Float32:
    """Factors of differences as float32, none of them infinite."""
    clipped: Float32 = np.minimum(factors, _SCALE_LIMIT).astype(np.float32)
    return clipped


def _planes(volume: Float32) -> Float32:
    """View of shape [z, y * x]."""
    return volume.reshape(volume.shape[0], -1)


def mean_square_gradient(values: Float32, spacing_mm: tuple[float, float, float], extent: float) -> float:
    """Mean over the voxels of the squared central-difference gradient, per mm2; the outermost voxels are repeated.

    Parameters
    ----------
    values
        Finite float32, shape [z, y, x].
    spacing_mm
        Voxel spacing along x, y, z, mm.
    extent
        Highest minus lowest value, above zero: the squares are taken in its units, where float32 holds them.
    """
    scale = _scale(0.5 / (np.array(spacing_mm) * extent))
    sums = np.empty(len(values))
    _sum_square_gradients(np.ascontiguousarray(values, np.float32), scale, sums)
    return float(sums.sum()) / values.size * extent**2


@loop_kernel
def _sum_square_gradients(u, scale, sums):
    """Sum the squared central differences times ``scale`` over each plane."""
    nz, ny, nx = u.shape
    for k in numba.prange(nz):
        row_sum = np.zeros(nx, np.float32)
        down, here, up = u[max(k - 1, 0)], u[k], u[min(k + 1, nz - 1)]
        for j in range(ny):
            _add_squares(row_sum, here[j], here[max(j - 1, 0)], here[min(j + 1, ny - 1)], down[j], up[j], scale)
        sums[k] = row_sum.astype(np.float64).sum()


@kernel(fastmath={"contract"})
def _add_squares(row_sum, here, ym, yp, zm, zp, scale):
    """Add the squared central differences of a row times ``scale`` to ``row_sum``."""
    sx, sy, sz = scale[0], scale[1], scale[2]
    last = here.size - 1
    for i in range(1, last):
        gx = (here[i + 1] - here[i - 1]) * sx
        gy = (yp[i] - ym[i]) * sy
        gz = (zp[i] - zm[i]) * sz
        row_sum[i] += gx * gx + gy * gy + gz * gz
    for i in range(0, last + 1, max(last, 1)):
        gx = (here[min(i + 1, last)] - here[max(i - 1, 0)]) * sx
        gy = (yp[i] - ym[i]) * sy
        gz = (zp[i] - zm[i]) * sz
        row_sum[i] += gx * gx + gy * gy + gz * gz


@kernel(fastmath={"contract"})
def _differences(out, low, high, scale):
    """Scaled differences of two rows."""
    for i in range(out.size):
        out[i] = (high[i] - low[i]) * scale


@kernel(fastmath={"contract"})
def _fluxes(out, low, high, scale, side, side_beyond, other, other_beyond):
    """Difference times conductance, 2 to the minus squared scaled gradient, of a row of faces between two rows.

    ``side`` and ``other`` are a quarter of the scaled differences along the other two axes (central ones, times two) in
    the voxels at ``low``, the ones ``beyond`` those at ``high``.
    """
    for i in range(out.size):
        difference = high[i] - low[i]
        along = difference * scale
        across = side[i] + side_beyond[i]
        beside = other[i] + other_beyond[i]
        exponent = min(along * along + across * across + beside * beside, np.float32(125.0))
        whole = np.int32(exponent + np.float32(0.5))
        # 2^r on [-1/2, 1/2] to 1e-7: the Chebyshev interpolant of degree five
        r = np.float32(whole) - exponent
        p = np.float32(0.0013390863) * r + np.float32(0.009676032)
        p = p * r + np.float32(0.05550357)
        p = p * r + np.float32(0.24022107)
        p = p * r + np.float32(0.6931472)
        p = p * r + np.float32(1.0000001)
        power = np.int32((np.int32(127) - whole) << np.int32(23)).view(np.float32)
        out[i] = difference * (p * power)


@kernel(fastmath={"contract"})
def _power_of_half(exponent):
    """2 to the minus ``exponent``, which is at least 0; no less than 2^-125."""
    exponent = min(exponent, np.float32(125.0))
    whole = np.int32(exponent + np.float32(0.5))
    # the same interpolant as in _fluxes, whose loop stays as it is: its bytes are those of earlier cases
    r = np.float32(whole) - exponent
    p = np.float32(0.0013390863) * r + np.float32(0.009676032)
    p = p * r + np.float32(0.05550357)
    p = p * r + np.float32(0.24022107)
    p = p * r + np.float32(0.6931472)
    p = p * r + np.float32(1.0000001)
    return p * np.int32((np.int32(127) - whole) << np.int32(23)).view(np.float32)


@kernel(fastmath={"contract"}, error_model="numpy")
def _normals(out, low, high, scale, side, side_beyond, other, other_beyond):
    """The unit normal's part through a row of faces times conductance; the arguments are those of :func:`_fluxes`."""
    for i in range(out.size):
        along = (high[i] - low[i]) * scale
        across = side[i] + side_beyond[i]
        beside = other[i] + other_beyond[i]
        square = along * along + across * across + beside * beside
        # where nothing slopes there is no normal
        out[i] = along / np.sqrt(square + np.float32(1e-30)) * _power_of_half(square)


@kernel(fastmath={"contract"})
def _carriers(out, low, high, slope, scale):
    """Slopes at a row of faces times conductance."""
    for i in range(out.size):
        difference = high[i] - low[i]
        along = difference * scale
        out[i] = difference * slope * _power_of_half(along * along)


@copied
def _x_differences(out, rows, nx, scale):
    """Scaled central differences along x of whole rows; the ends of a row are repeated."""
    count = rows.size
    _differences(out[1 : count - 1], rows[: count - 2], rows[2:], scale)
    for start in range(0, count, nx):
        end = start + nx - 1
        out[start] = (rows[min(start + 1, end)] - rows[start]) * scale
        out[end] = (rows[end] - rows[max(end - 1, start)]) * scale


@copied
def _y_differences(out, plane, start, nx, scale):
    """Scaled central differences along y of the whole rows of a plane that start at voxel ``start``."""
    stop, size = start + out.size, plane.size
    low, high = max(start, nx), min(stop, size - nx)
    if high > low:
        _differences(out[low - start : high - start], plane[low - nx : high - nx], plane[low + nx : high + nx], scale)
    if start == 0:
        _differences(out[:nx], plane[:nx], plane[min(nx, size - nx) :], scale)
    if stop == size:
        _differences(out[out.size - nx :], plane[max(size - 2 * nx, 0) :], plane[size - nx :], scale)


@kernel(fastmath={"contract"})
def _add_divergence(new, old, weight, x_flux, y_low, y_high, z_low, z_high):
    """New values of whole rows; ``x_flux`` holds one face more than there are voxels."""
    wx, wy, wz = weight[0], weight[1], weight[2]
    for i in range(new.size):
        change = wx * (x_flux[i + 1] - x_flux[i])
        change += wy * (y_high[i] - y_low[i])
        change += wz * (z_high[i] - z_low[i])
        new[i] = old[i] + change


@kernel(fastmath={"contract"})
def _move_level_sets(
    new, old, weight, pace, x_flux, y_low, y_high, z_low, z_high, x_step, y_before, y_after, z_before, z_after
):
    """New values of whole rows: the divergence of the normals times the upwind slope.

    ``x_step`` holds the slope at one face more than there are voxels, the others those at the low and the high face of
    each voxel.
    """
    wx, wy, wz = weight[0], weight[1], weight[2]
    none = np.float32(0.0)
    for i in range(new.size):
        speed = wx * (x_flux[i + 1] - x_flux[i])
        speed += wy * (y_high[i] - y_low[i])
        speed += wz * (z_high[i] - z_low[i])
        # what rises takes from the higher neighbours, what falls from the lower ones
        sign = np.float32(1.0) if speed > none else np.float32(-1.0)
        a, b = max(sign * x_step[i + 1], none), max(-sign * x_step[i], none)
        c, d = max(sign * y_after[i], none), max(-sign * y_before[i], none)
        e, f = max(sign * z_after[i], none), max(-sign * z_before[i], none)
        new[i] = old[i] + pace * speed * np.sqrt(a * a + b * b + c * c + d * d + e * e + f * f)


@copied
def _steps(x_step, y_step, z_step, here, down, up, start, stop, nx, slope, scale):
    """Slopes that carry level sets at the faces of whole rows of plane ``here``; none at the volume's outer faces.

    ``y_step`` holds a row of faces more than there are rows of voxels.
    """
    count, size = stop - start, here.size
    _carriers(x_step[1:count], here[start : stop - 1], here[start + 1 : stop], slope[0], scale[0])
    x_step[0 : count + 1 : nx] = np.float32(0.0)
    low, high = max(start, nx), min(stop + nx, size)
    y_step[: low - start] = np.float32(0.0)
    y_step[high - start : count + nx] = np.float32(0.0)
    if high > low:
        _carriers(y_step[low - start : high - start], here[low - nx : high - nx], here[low:high], slope[1], scale[1])
    _carriers(z_step[0, :count], down[start:stop], here[start:stop], slope[2], scale[2])
    _carriers(z_step[1, :count], here[start:stop], up[start:stop], slope[2], scale[2])


@copied
def _through_faces(out, low, high, scale, side, side_beyond, other, other_beyond, pace):
    """What goes through a row of faces: intensity, or the normal where level sets move."""
    if pace > np.float32(0.0):
        _normals(out, low, high, scale, side, side_beyond, other, other_beyond)
    else:
        _fluxes(out, low, high, scale, side, side_beyond, other, other_beyond)


@copied
def _z_fluxes(out, here, up, start, nx, scale, work, pace):
    """Fluxes from plane ``here`` to plane ``up`` for whole rows that start at voxel ``start``."""
    count = out.size
    stop = start + count
    quarter_x, quarter_y = np.float32(0.25) * scale[0], np.float32(0.25) * scale[1]
    x_here, x_up, y_here, y_up = work[0][:count], work[1][:count], work[2][:count], work[3][:count]
    _x_differences(x_here, here[start:stop], nx, quarter_x)
    _x_differences(x_up, up[start:stop], nx, quarter_x)
    _y_differences(y_here, here, start, nx, quarter_y)
    _y_differences(y_up, up, start, nx, quarter_y)
    _through_faces(out, here[start:stop], up[start:stop], scale[2], x_here, x_up, y_here, y_up, pace)


@loop_kernel
def _keep_edges(edges, planes):
    """Copy the first and the last plane of each slab: its neighbours need them after they are overwritten."""
    nz = planes.shape[0]
    for slab in numba.prange(edges.shape[1]):
        edges[0, slab] = planes[slab * _SLAB]
        edges[1, slab] = planes[min((slab + 1) * _SLAB, nz) - 1]


@loop_kernel
def _step(planes, new, nx, scale, weight, edges, slope, pace):
    """One Jacobi step; ``planes`` and ``new``, maybe the same, hold a plane of rows of ``nx`` voxels in each row."""
    for slab in numba.prange(edges.shape[1]):
        _step_slab(planes, new, nx, slab, scale, weight, edges, slope, pace)


@copied
def _step_slab(planes, new, nx, slab, scale, weight, edges, slope, pace):
    """The step in the planes of a slab, a block of rows at a time, each plane from a copy of what it held before."""
    nz, size = planes.shape
    first, last = slab * _SLAB, min((slab + 1) * _SLAB, nz)
    kept = np.empty((2, size), np.float32)
    block = nx * max(1, _BLOCK // nx)
    quarter = np.float32(0.25) * scale
    work = np.empty((4, block + nx), np.float32)
    x_side = np.empty(block + nx, np.float32)
    y_side = np.empty(block + nx, np.float32)
    z_side = np.empty(block + nx, np.float32)
    x_flux = np.zeros(block + 1, np.float32)
    x_step = np.empty(block + 1, np.float32)
    y_step = np.empty(block + nx, np.float32)
    z_step = np.empty((2, block), np.float32)
    y_flux = np.empty(block + nx, np.float32)
    z_low = np.zeros(size, np.float32)
    z_high = np.zeros(block, np.float32)
    if first > 0:
        for start in range(0, size, block):
            stop = min(start + block, size)
            _z_fluxes(z_low[start:stop], edges[1, slab - 1], planes[first], start, nx, scale, work, pace)
    for k in range(first, last):
        here = kept[k % 2]
        for n in range(size):
            here[n] = planes[k, n]
        down, up = kept[(k - 1) % 2], planes[min(k + 1, nz - 1)]
        if k == first:
            down = edges[1, slab - 1] if k > 0 else here
        if k + 1 == last:
            up = edges[0, slab + 1] if last < nz else here
        y_flux[:nx] = 0.0
        for start in range(0, size, block):
            stop = min(start + block, size)
            # the row beyond the block is needed for the faces between
            beyond = min(stop + nx, size)
            count, sides = stop - start, beyond - start
            _x_differences(x_side[:sides], here[start:beyond], nx, quarter[0])
            _y_differences(y_side[:count], here, start, nx, quarter[1])
            _differences(z_side[:sides], down[start:beyond], up[start:beyond], quarter[2])
            _through_faces(
                x_flux[1:count],
                here[start : stop - 1],
                here[start + 1 : stop],
                scale[0],
                y_side[: count - 1],
                y_side[1:count],
                z_side[: count - 1],
                z_side[1:count],
                pace,
            )
            x_flux[nx : count + 1 : nx] = 0.0
            y_flux[sides : count + nx] = 0.0
            _through_faces(
                y_flux[nx:sides],
                here[start : beyond - nx],
                here[start + nx : beyond],
                scale[1],
                x_side[: sides - nx],
                x_side[nx:sides],
                z_side[: sides - nx],
                z_side[nx:sides],
                pace,
            )
            if k + 1 < nz:
                _z_fluxes(z_high[:count], here, up, start, nx, scale, work, pace)
            else:
                z_high[:] = 0.0
            if pace > np.float32(0.0):
                _steps(x_step, y_step, z_step, here, down, up, start, stop, nx, slope, scale)
                _move_level_sets(
                    new[k, start:stop],
                    here[start:stop],
                    weight,
                    pace,
                    x_flux,
                    y_flux[:count],
                    y_flux[nx : count + nx],
                    z_low[start:stop],
                    z_high[:count],
                    x_step,
                    y_step[:count],
                    y_step[nx : count + nx],
                    z_step[0, :count],
                    z_step[1, :count],
                )
            else:
                _add_divergence(
                    new[k, start:stop],
                    here[start:stop],
                    weight,
                    x_flux,
                    y_flux[:count],
                    y_flux[nx : count + nx],
                    z_low[start:stop],
                    z_high[:count],
                )
            for n in range(nx):
                y_flux[n] = y_flux[count + n]
            for n in range(count):
                z_low[start + n] = z_high[n]
