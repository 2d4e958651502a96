"""Kernels of the distance to the zero level of a smooth field: closest points, found near it and handed on.

Points are in voxels (z, y, x); distances in mm. All loops are serial, so the result depends on nothing but the input.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["closest_points", "offset_for_interpolation"]

STEPS = 8
"""Most steps of the iteration to a closest point."""
TOLERANCE = 0.01
"""How far from the zero level a closest point may lie, in voxels."""


@numba.njit(cache=True, nogil=True)
def _cubic(t, w, d):  # type: ignore[no-untyped-def]
    """Catmull-Rom weights and their derivative at t in [0, 1]."""
    t2 = t * t
    t3 = t2 * t
    w[0] = 0.5 * (-t + 2.0 * t2 - t3)
    w[1] = 0.5 * (2.0 - 5.0 * t2 + 3.0 * t3)
    w[2] = 0.5 * (t + 4.0 * t2 - 3.0 * t3)
    w[3] = 0.5 * (t3 - t2)
    d[0] = 0.5 * (-1.0 + 4.0 * t - 3.0 * t2)
    d[1] = 0.5 * (-10.0 * t + 9.0 * t2)
    d[2] = 0.5 * (1.0 + 8.0 * t - 9.0 * t2)
    d[3] = 0.5 * (3.0 * t2 - 2.0 * t)


@numba.njit(cache=True, nogil=True)
def _value_and_gradient(f, z, y, x, w, out):  # type: ignore[no-untyped-def]
    """Tricubic value and gradient per voxel at a point, clamped to the lattice."""
    nz, ny, nx = f.shape
    z = min(max(z, 0.0), nz - 1.0)
    y = min(max(y, 0.0), ny - 1.0)
    x = min(max(x, 0.0), nx - 1.0)
    k = min(int(z), max(nz - 2, 0))
    j = min(int(y), max(ny - 2, 0))
    i = min(int(x), max(nx - 2, 0))
    _cubic(z - k, w[0], w[1])
    _cubic(y - j, w[2], w[3])
    _cubic(x - i, w[4], w[5])
    value = 0.0
    gz = 0.0
    gy = 0.0
    gx = 0.0
    for c in range(4):
        kk = min(max(k + c - 1, 0), nz - 1)
        for b in range(4):
            jj = min(max(j + b - 1, 0), ny - 1)
            row = 0.0
            slope = 0.0
            for a in range(4):
                v = f[kk, jj, min(max(i + a - 1, 0), nx - 1)]
                row += w[4, a] * v
                slope += w[5, a] * v
            value += w[0, c] * w[2, b] * row
            gz += w[1, c] * w[2, b] * row
            gy += w[0, c] * w[3, b] * row
            gx += w[0, c] * w[2, b] * slope
    out[0] = value
    out[1] = gz
    out[2] = gy
    out[3] = gx


@numba.njit(cache=True, nogil=True)
def _improve(f, h, k, j, i, foot, square, w, out, loose):  # type: ignore[no-untyped-def]
    """Walk from a node's present closest point to a closer one on the zero level; keep it if it is one."""
    pz = np.float64(foot[k, j, i, 0])
    py = np.float64(foot[k, j, i, 1])
    px = np.float64(foot[k, j, i, 2])
    best = np.sqrt(np.float64(square[k, j, i]))
    smallest = min(h[0], h[1], h[2])
    for _ in range(STEPS):
        _value_and_gradient(f, pz, py, px, w, out)
        gz = out[1] / h[0]
        gy = out[2] / h[1]
        gx = out[3] / h[2]
        steep = gz * gz + gy * gy + gx * gx
        if steep < 0.04:
            return
        rz = (k - pz) * h[0]
        ry = (j - py) * h[1]
        rx = (i - px) * h[2]
        along = (rz * gz + ry * gy + rx * gx) / steep
        tz = rz - along * gz
        ty = ry - along * gy
        tx = rx - along * gx
        step = -out[0] / steep
        slide = np.sqrt(tz * tz + ty * ty + tx * tx)
        if abs(out[0]) <= TOLERANCE * smallest * np.sqrt(steep):
            length = np.sqrt(rz * rz + ry * ry + rx * rx)
            if length < best or (loose and length < best + TOLERANCE * smallest):
                best = length
                foot[k, j, i, 0] = pz
                foot[k, j, i, 1] = py
                foot[k, j, i, 2] = px
                square[k, j, i] = length * length
                loose = False
            if slide < TOLERANCE * smallest:
                return
        part = 1.0
        if slide > smallest:
            part = smallest / slide
        pz += (step * gz + part * tz) / h[0]
        py += (step * gy + part * ty) / h[1]
        px += (step * gx + part * tx) / h[2]
        if abs(step) * np.sqrt(steep) > 3.0 * smallest:
            return


@numba.njit(cache=True, nogil=True)
def _offer(h, k, j, i, pz, py, px, foot, square):  # type: ignore[no-untyped-def]
    """Take a point of the zero level as a node's closest if it is closer than the present one."""
    dz = (k - pz) * h[0]
    dy = (j - py) * h[1]
    dx = (i - px) * h[2]
    length = dz * dz + dy * dy + dx * dx
    if length < square[k, j, i]:
        square[k, j, i] = length
        foot[k, j, i, 0] = pz
        foot[k, j, i, 1] = py
        foot[k, j, i, 2] = px


@numba.njit(cache=True, nogil=True)
def _seed(f, h, foot, square, nodes):  # type: ignore[no-untyped-def]
    """Nodes beside the zero level, with the closest of the crossings on their lattice edges."""
    nz, ny, nx = f.shape
    count = 0
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                here = f[k, j, i]
                inside = here < 0.0
                found = False
                for axis in range(3):
                    for sign in (-1, 1):
                        c = k + (sign if axis == 0 else 0)
                        b = j + (sign if axis == 1 else 0)
                        a = i + (sign if axis == 2 else 0)
                        if c < 0 or b < 0 or a < 0 or c >= nz or b >= ny or a >= nx:
                            continue
                        there = f[c, b, a]
                        if (there < 0.0) == inside:
                            continue
                        t = here / (here - there)
                        _offer(h, k, j, i, k + t * (c - k), j + t * (b - j), i + t * (a - i), foot, square)
                        found = True
                if found:
                    nodes[count, 0] = k
                    nodes[count, 1] = j
                    nodes[count, 2] = i
                    count += 1
    return count


@numba.njit(cache=True, nogil=True)
def _gather(h, k, j, i, foot, square):  # type: ignore[no-untyped-def]
    """Offer a node the closest points of its 26 neighbours."""
    nz, ny, nx = square.shape
    for c in range(max(k - 1, 0), min(k + 2, nz)):
        for b in range(max(j - 1, 0), min(j + 2, ny)):
            for a in range(max(i - 1, 0), min(i + 2, nx)):
                if square[c, b, a] < np.inf:
                    _offer(h, k, j, i, foot[c, b, a, 0], foot[c, b, a, 1], foot[c, b, a, 2], foot, square)


@numba.njit(cache=True, nogil=True)
def _spread(h, reach, foot, square, nodes, count):  # type: ignore[no-untyped-def]
    """Hand the closest points on, layer by layer, up to ``reach`` mm."""
    nz, ny, nx = square.shape
    start = 0
    while start < count:
        end = count
        for n in range(start, end):
            k = nodes[n, 0]
            j = nodes[n, 1]
            i = nodes[n, 2]
            if square[k, j, i] > reach * reach:
                continue
            for c in range(max(k - 1, 0), min(k + 2, nz)):
                for b in range(max(j - 1, 0), min(j + 2, ny)):
                    for a in range(max(i - 1, 0), min(i + 2, nx)):
                        if square[c, b, a] == np.inf:
                            nodes[count, 0] = c
                            nodes[count, 1] = b
                            nodes[count, 2] = a
                            count += 1
                        _offer(h, c, b, a, foot[k, j, i, 0], foot[k, j, i, 1], foot[k, j, i, 2], foot, square)
        start = end
    return count


@numba.njit(cache=True, nogil=True)
def closest_points(f, h, reach, foot, square, nodes):  # type: ignore[no-untyped-def]
    """Distance of the nodes near a field's zero level to it.

    Parameters
    ----------
    f
        float32 field, about a distance in mm near its zero level, shape [z, y, x].
    h
        float64 spacing (z, y, x) in mm.
    reach
        Distance in mm up to which nodes are visited.
    foot
        float32, shape (*f.shape, 3): receives the closest points, voxels (z, y, x).
    square
        float32, shape of ``f``, infinity on entry: receives the square of the distance in mm where it is visited.
    nodes
        int32 work space, shape (f.size, 3).

    Returns
    -------
    int
        Number of nodes visited; the first rows of ``nodes`` name them.
    """
    w = np.empty((6, 4))
    out = np.empty(4)
    count = _seed(f, h, foot, square, nodes)
    for n in range(count):
        _improve(f, h, nodes[n, 0], nodes[n, 1], nodes[n, 2], foot, square, w, out, True)
    count = _spread(h, reach, foot, square, nodes, count)
    for n in range(count):
        _gather(h, nodes[n, 0], nodes[n, 1], nodes[n, 2], foot, square)
    for n in range(count):
        _improve(f, h, nodes[n, 0], nodes[n, 1], nodes[n, 2], foot, square, w, out, False)
    return count


@numba.njit(cache=True, nogil=True)
def _bend(d, limit):  # type: ignore[no-untyped-def]
    """Sum of the second differences over 12, zero where a neighbour is unknown."""
    nz, ny, nx = d.shape
    bend = np.zeros(d.shape, np.float32)
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                twice = np.float32(2.0) * d[k, j, i]
                total = np.float32(0.0)
                if 0 < k < nz - 1:
                    total += d[k - 1, j, i] + d[k + 1, j, i] - twice
                if 0 < j < ny - 1:
                    total += d[k, j - 1, i] + d[k, j + 1, i] - twice
                if 0 < i < nx - 1:
                    total += d[k, j, i - 1] + d[k, j, i + 1] - twice
                if np.isfinite(total):
                    bend[k, j, i] = min(max(total / np.float32(12.0), -limit), limit)
    return bend


@numba.njit(cache=True, nogil=True)
def offset_for_interpolation(d, limit):  # type: ignore[no-untyped-def]
    """Take the mean error of trilinear interpolation off a sampled distance.

    Between samples the linear interpolant of a function exceeds it by ``h**2 / 12`` times its second derivative on
    average along each axis. The distance around a convex body is convex, so the body would come out too small.

    Parameters
    ----------
    d
        float32 [z, y, x]; not finite where it is unknown, and left alone there.
    limit
        Most that is taken off, in the field's unit.

    Returns
    -------
    ndarray
        The field without the second differences over 12, averaged over 27 neighbours against the voxels' noise.
    """
    nz, ny, nx = d.shape
    bend = _bend(d, limit)
    out = d.copy()
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                if not np.isfinite(d[k, j, i]):
                    continue
                total = np.float32(0.0)
                count = 0
                for c in range(max(k - 1, 0), min(k + 2, nz)):
                    for b in range(max(j - 1, 0), min(j + 2, ny)):
                        for a in range(max(i - 1, 0), min(i + 2, nx)):
                            total += bend[c, b, a]
                            count += 1
                out[k, j, i] = d[k, j, i] - total / np.float32(count)
    return out
