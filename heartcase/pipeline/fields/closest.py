"""Kernels of the distance to the zero level of a smooth field.

Beside the zero level each node walks to its closest point on it, and there the level's normal and its second
fundamental form are noted. A node farther off takes the nearest of these points (by an exact transform of the nodes
beside the level, :mod:`heartcase.pipeline.kernels.feature_transform`, and by what its neighbours found), foretells its
own closest point by the level's bend there, and walks on from that: mostly one look at the field is enough, and what is
left of the way is added to second order. Along a normal the Hessian
``H`` of a distance turns into ``H (1 + a H)^-1`` at the distance ``a``; towards a centre of curvature it says nothing,
and the node walks as it can.

Points are in voxels (z, y, x); distances in mm. All loops are serial, so the result depends on nothing but the input.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.kernels.feature_transform import nearest_seeds
from heartcase.pipeline.kernels.vectors import put

__all__ = ["closest_points", "offset_for_interpolation"]

STEPS = 8
"""Most steps of the walk to a closest point."""
TOLERANCE = 0.01
"""How far from the zero level a closest point may lie, in voxels."""
OFF_VOXELS = 0.1
"""Off the level by less than this, in voxels, what is left of the way to it is foreseeable."""
GAIN_VOXELS = 0.02
"""So is what a step along the level would bring, where it is less than this, in voxels."""
SLIDE_VOXELS = 1.5
"""Farthest from the nearest known point, along the level, that a closest point is foretold."""
BEND_VOXELS = 0.2
"""Most that the level may fall away from its tangent plane on that way, in voxels."""
DAMPED = 0.5
"""Part of a step along the level that is taken where the bend is of no help."""
FOCUS = 0.35
"""Least factor by which the way to the node may shrink the level: at a centre of curvature it is zero."""


@kernel(inline="always")
def _cubic(t, w, row, bend):
    """Catmull-Rom weights, their first and, where asked for, second derivatives at t in [0, 1]; rows from ``row``."""
    t2 = t * t
    t3 = t2 * t
    w[row, 0] = 0.5 * (-t + 2.0 * t2 - t3)
    w[row, 1] = 0.5 * (2.0 - 5.0 * t2 + 3.0 * t3)
    w[row, 2] = 0.5 * (t + 4.0 * t2 - 3.0 * t3)
    w[row, 3] = 0.5 * (t3 - t2)
    w[row + 1, 0] = 0.5 * (-1.0 + 4.0 * t - 3.0 * t2)
    w[row + 1, 1] = 0.5 * (-10.0 * t + 9.0 * t2)
    w[row + 1, 2] = 0.5 * (1.0 + 8.0 * t - 9.0 * t2)
    w[row + 1, 3] = 0.5 * (3.0 * t2 - 2.0 * t)
    if bend:
        w[row + 2, 0] = 2.0 - 3.0 * t
        w[row + 2, 1] = -5.0 + 9.0 * t
        w[row + 2, 2] = 4.0 - 9.0 * t
        w[row + 2, 3] = 3.0 * t - 1.0


@kernel(inline="always")
def _sample(f, z, y, x, w, out, bend):
    """Tricubic value, gradient per voxel and, where asked for, Hessian at a point, clamped to the lattice.

    ``out``: value, z, y, x, zz, yy, xx, zy, zx, yx.
    """
    nz, ny, nx = f.shape
    z = min(max(z, 0.0), nz - 1.0)
    y = min(max(y, 0.0), ny - 1.0)
    x = min(max(x, 0.0), nx - 1.0)
    k = min(int(z), max(nz - 2, 0))
    j = min(int(y), max(ny - 2, 0))
    i = min(int(x), max(nx - 2, 0))
    _cubic(z - k, w, 0, bend)
    _cubic(y - j, w, 3, bend)
    _cubic(x - i, w, 6, bend)
    for n in range(10 if bend else 4):
        out[n] = 0.0
    within = 0 < k < nz - 2 and 0 < j < ny - 2 and 0 < i < nx - 2
    flat = f.reshape(-1)
    for c in range(4):
        kk = min(max(k + c - 1, 0), nz - 1)
        v0 = 0.0
        vy = 0.0
        vx = 0.0
        vyy = 0.0
        vxx = 0.0
        vyx = 0.0
        for b in range(4):
            jj = min(max(j + b - 1, 0), ny - 1)
            at = (kk * ny + jj) * nx
            # without clamps the four values of a row lie side by side
            if within:
                at += i - 1
                e0, e1, e2, e3 = flat[at], flat[at + 1], flat[at + 2], flat[at + 3]
            else:
                e0, e1 = flat[at + max(i - 1, 0)], flat[at + i]
                e2, e3 = flat[at + min(i + 1, nx - 1)], flat[at + min(i + 2, nx - 1)]
            row = w[6, 0] * e0 + w[6, 1] * e1 + w[6, 2] * e2 + w[6, 3] * e3
            slope = w[7, 0] * e0 + w[7, 1] * e1 + w[7, 2] * e2 + w[7, 3] * e3
            v0 += w[3, b] * row
            vy += w[4, b] * row
            vx += w[3, b] * slope
            if bend:
                curve = w[8, 0] * e0 + w[8, 1] * e1 + w[8, 2] * e2 + w[8, 3] * e3
                vyy += w[5, b] * row
                vxx += w[3, b] * curve
                vyx += w[4, b] * slope
        out[0] += w[0, c] * v0
        out[1] += w[1, c] * v0
        out[2] += w[0, c] * vy
        out[3] += w[0, c] * vx
        if bend:
            out[4] += w[2, c] * v0
            out[5] += w[0, c] * vyy
            out[6] += w[0, c] * vxx
            out[7] += w[1, c] * vy
            out[8] += w[1, c] * vx
            out[9] += w[0, c] * vyx


@copied
def _walk(f, h, k, j, i, foot, best, pace, w, out, is_seed):
    """Walk from a point near a node's closest one on the zero level to that; returns the node's distance to the level.

    The iteration of Chopp, SIAM J. Sci. Comput. 23, 2001: down the gradient to the level, and along it, there by
    Newton's step: ``pace`` (zz, yy, xx, zy, zx, yx) takes the bend of the level into account. ``best`` is a distance
    that is known already. For a seed ``foot`` becomes the closest point, as near the level as the tolerance says; for
    other nodes the walk ends as soon as what is left of it is foreseeable, and is added.
    """
    pz = foot[0]
    py = foot[1]
    px = foot[2]
    smallest = min(h[0], h[1], h[2])
    is_first = True
    shortest = best
    for _ in range(STEPS):
        _sample(f, pz, py, px, w, out, False)
        gz = out[1] / h[0]
        gy = out[2] / h[1]
        gx = out[3] / h[2]
        steep = gz * gz + gy * gy + gx * gx
        if steep < 0.04:
            return best
        rz = (k - pz) * h[0]
        ry = (j - py) * h[1]
        rx = (i - px) * h[2]
        along = (rz * gz + ry * gy + rx * gx) / steep
        tz = rz - along * gz
        ty = ry - along * gy
        tx = rx - along * gx
        sz = pace[0] * tz + pace[3] * ty + pace[4] * tx
        sy = pace[3] * tz + pace[1] * ty + pace[5] * tx
        sx = pace[4] * tz + pace[5] * ty + pace[2] * tx
        step = -out[0] / steep
        slide = np.sqrt(sz * sz + sy * sy + sx * sx)
        length = np.sqrt(rz * rz + ry * ry + rx * rx)
        gain = tz * sz + ty * sy + tx * sx
        off = out[0] / np.sqrt(steep)
        found = abs(np.sqrt(max(length * length - gain, 0.0)) + (off if along > 0.0 else -off))
        if abs(off) <= TOLERANCE * smallest and (length < shortest or (is_seed and is_first)):
            shortest = length
            best = found if gain < 2.0 * GAIN_VOXELS * smallest * length else length
            is_first = False
            if is_seed:
                foot[0] = pz
                foot[1] = py
                foot[2] = px
        if is_seed:
            if slide < TOLERANCE * smallest:
                return best
        elif abs(off) < OFF_VOXELS * smallest and gain < 2.0 * GAIN_VOXELS * smallest * length:
            return min(best, found)
        part = 1.0
        if slide > smallest:
            part = smallest / slide
        pz += (step * gz + part * sz) / h[0]
        py += (step * gy + part * sy) / h[1]
        px += (step * gx + part * sx) / h[2]
        if abs(step) * np.sqrt(steep) > 3.0 * smallest:
            return best
    return best


@kernel(inline="always")
def _square_to(h, k, j, i, foot, n):
    """Square of a node's distance to the n-th point, mm2."""
    dz = (k - foot[n, 0]) * h[0]
    dy = (j - foot[n, 1]) * h[1]
    dx = (i - foot[n, 2]) * h[2]
    return dz * dz + dy * dy + dx * dx


@copied
def _beside(f, seed):
    """Number the nodes beside the zero level in ``seed``, -1 elsewhere; returns their places."""
    nz, ny, nx = f.shape
    count = 0
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                inside = f[k, j, i] < 0.0
                found = (
                    (i > 0 and (f[k, j, i - 1] < 0.0) != inside)
                    or (i < nx - 1 and (f[k, j, i + 1] < 0.0) != inside)
                    or (j > 0 and (f[k, j - 1, i] < 0.0) != inside)
                    or (j < ny - 1 and (f[k, j + 1, i] < 0.0) != inside)
                    or (k > 0 and (f[k - 1, j, i] < 0.0) != inside)
                    or (k < nz - 1 and (f[k + 1, j, i] < 0.0) != inside)
                )
                seed[k, j, i] = count if found else -1
                if found:
                    count += 1
    place = np.empty((count, 3), np.int32)
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                n = seed[k, j, i]
                if n >= 0:
                    place[n, 0] = k
                    place[n, 1] = j
                    place[n, 2] = i
    return place


@copied
def _crossing(f, h, k, j, i, foot):
    """Closest crossing of the zero level on the lattice edges of a node beside it; returns its distance."""
    nz, ny, nx = f.shape
    here = np.float64(f[k, j, i])
    best = np.inf
    for axis in range(3):
        for sign in (-1, 1):
            c = k + (sign if axis == 0 else 0)
            b = j + (sign if axis == 1 else 0)
            a = i + (sign if axis == 2 else 0)
            if c < 0 or b < 0 or a < 0 or c >= nz or b >= ny or a >= nx:
                continue
            there = np.float64(f[c, b, a])
            if (there < 0.0) == (here < 0.0):
                continue
            t = here / (here - there)
            if t * h[axis] < best:
                best = t * h[axis]
                foot[0] = k + t * (c - k)
                foot[1] = j + t * (b - j)
                foot[2] = i + t * (a - i)
    return best


@copied
def _shape_at(f, h, foot, w, out, shape):
    """Unit normal (z, y, x) and second fundamental form (zz, yy, xx, zy, zx, yx; 1/mm) of the level at a point."""
    _sample(f, foot[0], foot[1], foot[2], w, out, True)
    n0 = out[1] / h[0]
    n1 = out[2] / h[1]
    n2 = out[3] / h[2]
    steep = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    if steep < 0.2:
        shape[:] = 0.0
        return
    n0 /= steep
    n1 /= steep
    n2 /= steep
    zz = out[4] / (h[0] * h[0] * steep)
    yy = out[5] / (h[1] * h[1] * steep)
    xx = out[6] / (h[2] * h[2] * steep)
    zy = out[7] / (h[0] * h[1] * steep)
    zx = out[8] / (h[0] * h[2] * steep)
    yx = out[9] / (h[1] * h[2] * steep)
    # onto the tangent plane from both sides
    m0 = zz * n0 + zy * n1 + zx * n2
    m1 = zy * n0 + yy * n1 + yx * n2
    m2 = zx * n0 + yx * n1 + xx * n2
    q = m0 * n0 + m1 * n1 + m2 * n2
    shape[0] = n0
    shape[1] = n1
    shape[2] = n2
    shape[3] = zz - 2.0 * m0 * n0 + q * n0 * n0
    shape[4] = yy - 2.0 * m1 * n1 + q * n1 * n1
    shape[5] = xx - 2.0 * m2 * n2 + q * n2 * n2
    shape[6] = zy - m0 * n1 - m1 * n0 + q * n0 * n1
    shape[7] = zx - m0 * n2 - m2 * n0 + q * n0 * n2
    shape[8] = yx - m1 * n2 - m2 * n1 + q * n1 * n2


@kernel(inline="always")
def _foretell(h, k, j, i, foot, n, shape, smallest, point, pace):
    """Where a node's closest point should be, by the level's bend at the n-th point; that point where it tells nothing.

    With the way ``r`` from it to the node, ``a = r . n`` and the rest ``t`` along the level, the closest point lies
    ``y = (1 + a H)^-1 t`` on along the level and ``-y . H y / 2`` along the normal. ``pace`` becomes that matrix.
    """
    point[0], point[1], point[2] = foot[n, 0], foot[n, 1], foot[n, 2]
    rz, ry, rx = (k - foot[n, 0]) * h[0], (j - foot[n, 1]) * h[1], (i - foot[n, 2]) * h[2]
    n0, n1, n2 = shape[n, 0], shape[n, 1], shape[n, 2]
    zz, yy, xx = shape[n, 3], shape[n, 4], shape[n, 5]
    zy, zx, yx = shape[n, 6], shape[n, 7], shape[n, 8]
    a = rz * n0 + ry * n1 + rx * n2
    t0, t1, t2 = rz - a * n0, ry - a * n1, rx - a * n2
    # 1 + a H; its third eigenvalue, along the normal, is one
    a00, a11, a22 = 1.0 + a * zz, 1.0 + a * yy, 1.0 + a * xx
    a01, a02, a12 = a * zy, a * zx, a * yx
    c00, c11, c22 = a11 * a22 - a12 * a12, a00 * a22 - a02 * a02, a00 * a11 - a01 * a01
    c01, c02, c12 = a02 * a12 - a01 * a22, a01 * a12 - a02 * a11, a01 * a02 - a00 * a12
    volume = a00 * c00 + a01 * c01 + a02 * c02
    # two factors below zero would make a positive product
    if volume < FOCUS or a00 + a11 + a22 < 1.0 + 2.0 * FOCUS:
        pace[:3] = DAMPED
        pace[3:] = 0.0
        return
    pace[0], pace[1], pace[2] = c00 / volume, c11 / volume, c22 / volume
    pace[3], pace[4], pace[5] = c01 / volume, c02 / volume, c12 / volume
    y0 = pace[0] * t0 + pace[3] * t1 + pace[4] * t2
    y1 = pace[3] * t0 + pace[1] * t1 + pace[5] * t2
    y2 = pace[4] * t0 + pace[5] * t1 + pace[2] * t2
    if y0 * y0 + y1 * y1 + y2 * y2 > SLIDE_VOXELS * SLIDE_VOXELS * smallest * smallest:
        return
    sag = 0.5 * (zz * y0 * y0 + yy * y1 * y1 + xx * y2 * y2 + 2.0 * (zy * y0 * y1 + zx * y0 * y2 + yx * y1 * y2))
    if abs(sag) > BEND_VOXELS * smallest:
        return
    point[0] += (y0 - sag * n0) / h[0]
    point[1] += (y1 - sag * n1) / h[1]
    point[2] += (y2 - sag * n2) / h[2]


@copied
def _nearest_of_neighbours(seed, foot, h, k, j, i, nearest):
    """The nearest of the points that a node and its 26 neighbours found, and the square of the distance."""
    nz, ny, nx = seed.shape
    best = _square_to(h, k, j, i, foot, nearest)
    for c in range(max(k - 1, 0), min(k + 2, nz)):
        for b in range(max(j - 1, 0), min(j + 2, ny)):
            for a in range(max(i - 1, 0), min(i + 2, nx)):
                other = seed[c, b, a]
                if other >= 0 and other != nearest:
                    length = _square_to(h, k, j, i, foot, other)
                    if length < best:
                        nearest, best = other, length
    return nearest, best


@kernel
def closest_points(f, h, reach, square):
    """Squared distance of the nodes near a field's zero level to it.

    Parameters
    ----------
    f
        float32 field, about a distance in mm near its zero level, shape [z, y, x].
    h
        float64 spacing (z, y, x) in mm.
    reach
        Distance in mm up to which nodes are visited.
    square
        float32, shape of ``f``, infinity on entry: receives the square of the distance in mm where it is visited.
    """
    w = np.empty((9, 4))
    out = np.empty(10)
    seed = np.empty(f.shape, np.int32)
    place = _beside(f, seed)
    count = len(place)
    if count == 0:
        return
    foot = np.empty((count, 3))
    length = np.empty(count)
    shape = np.empty((count, 9))
    point = np.empty(3)
    pace = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    smallest = min(h[0], h[1], h[2])
    nz, ny, nx = f.shape
    for n in range(count):
        k, j, i = place[n]
        length[n] = _walk(f, h, k, j, i, foot[n], _crossing(f, h, k, j, i, foot[n]), pace, w, out, True)
    first = foot.copy()
    for n in range(count):
        k, j, i = place[n]
        nearest, best = _nearest_of_neighbours(seed, first, h, k, j, i, n)
        if nearest != n:
            put(first[nearest], foot[n])
            length[n] = _walk(f, h, k, j, i, foot[n], np.sqrt(best), pace, w, out, True)
        _shape_at(f, h, foot[n], w, out, shape[n])
    far = reach + 2.0 * h.max()
    nearest_seeds(seed, place, h, far)
    least = reach + smallest
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                n = seed[k, j, i]
                if n < 0:
                    continue
                if place[n, 0] == k and place[n, 1] == j and place[n, 2] == i:
                    square[k, j, i] = length[n] * length[n]
                    continue
                if _square_to(h, k, j, i, foot, n) > far * far:
                    continue
                n, best = _nearest_of_neighbours(seed, foot, h, k, j, i, n)
                _foretell(h, k, j, i, foot, n, shape, smallest, point, pace)
                distance = _walk(f, h, k, j, i, point, np.sqrt(best), pace, w, out, False)
                if distance <= least:
                    square[k, j, i] = distance * distance


@copied
def _bend(d, limit):
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


@kernel
def offset_for_interpolation(d, limit):
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
