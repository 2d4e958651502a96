"""The forces of one cell, for the kernels, in float32.

They are those of :mod:`heartcase.simulator.forces.cell_forces`, without cancellation. With H = F - I, what nearly
cancels is worked out by itself::

    I_C - 3 = 2 tr H + |H|^2,      J - 1 = tr H + tr(cof H) + det H,      cof F = I (1 + tr H) - H^T + cof H

so that at rest the force is exactly zero, and a small strain keeps all its digits. The functions are written once, for
numbers and for the vectors of lanes: they use only the operators of arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from heartcase.simulator.forces.cell_forces import (
    EDGE_SQUARES,
    WARP_FREE,
    WARP_STIFFNESS,
)

__all__ = ["NOTHING_SHARED", "CellMath", "make_cell_math"]

NOTHING_SHARED = ((np.float32(0.0),) * 3,) * 3
"""What an element takes from its corners' means where it is all stretched as it is itself."""


class CellMath(NamedTuple):
    """The functions of one cell, for one target: :func:`make_cell_math`."""

    gradient: Any
    stretching: Any
    element: Any
    volume_term: Any
    corner_guard: Any
    corner_lack: Any


def make_cell_math(compiled: Callable[[Any], Any], positive_part: Callable[[Any], Any]) -> CellMath:
    """The functions of one cell, for one target.

    Vectors are tuples (x, y, z); the corners' displacements are a tuple of eight, by the corner's number.

    Parameters
    ----------
    compiled
        Makes a function that kernels of the target can call.
    positive_part
        max(x, 0) for the target's numbers.

    Returns
    -------
    gradient
        ``(u, moments)`` to the columns of F - 1. ``moments`` are the tissue's means of x, y, z, yz, xz, xy (and
        variances along x, y, z).
    stretching
        ``(h, law)`` to the columns of the derivative of what stretching stores, from those of F - 1; ``law`` is (mu,
        lambda + mu / 3, E', nu, E).
    element
        ``(u, scale, own, moments, law, shared)`` to the forces. ``own`` is what of the covered stiffness ``scale`` is
        stretched as the cell is; ``shared`` are the columns of the stress that the rest takes from its corners' means,
        times its stiffness, or NOTHING_SHARED.
    volume_term
        ``(u, scale, modulus)`` to the forces.
    corner_guard
        ``(u, scale, floor)`` to the forces.
    corner_lack
        ``(u, volume)``: by how much the flattest corners are below a volume, summed up; zero where none is.

    Those of forces give the x, y and z components, eight values each, by the corner's number.
    """
    one, two, half, quarter = np.float32(1.0), np.float32(2.0), np.float32(0.5), np.float32(0.25)
    zero, third, sixth = np.float32(0.0), np.float32(1.0 / 3.0), np.float32(1.0 / 6.0)
    square, far_square = np.float32(EDGE_SQUARES[0]), np.float32(EDGE_SQUARES[3])
    warp_free, warp_stiffness = np.float32(WARP_FREE), np.float32(2.0 * WARP_STIFFNESS)
    eighth = np.float32(0.125)

    @compiled
    def dot(a, b):
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

    @compiled
    def cross(a, b):
        return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])

    @compiled
    def modes(u, axis):
        """Columns of G, then q_1 to q_4, one component of each."""
        s0, d0 = u[0][axis] + u[1][axis], u[1][axis] - u[0][axis]
        s1, d1 = u[2][axis] + u[3][axis], u[3][axis] - u[2][axis]
        s2, d2 = u[4][axis] + u[5][axis], u[5][axis] - u[4][axis]
        s3, d3 = u[6][axis] + u[7][axis], u[7][axis] - u[6][axis]
        ds0, dd0, ds1, dd1 = d0 + d1, d1 - d0, d2 + d3, d3 - d2
        ss0, sd0, ss1, sd1 = s0 + s1, s1 - s0, s2 + s3, s3 - s2
        return (
            (ds0 + ds1) * quarter,
            (sd0 + sd1) * quarter,
            (ss1 - ss0) * quarter,
            (sd1 - sd0) * half,
            (ds1 - ds0) * half,
            (dd0 + dd1) * half,
            dd1 - dd0,
        )

    @compiled
    def at_corners(x, y, z, yz, xz, xy, xyz):
        """One component at the eight corners, of the forces on the modes: the transpose of :func:`modes`."""
        x, y, z, yz, xz, xy = x * quarter, y * quarter, z * quarter, yz * half, xz * half, xy * half
        above, below = z + yz, z - yz
        far_above, near_above, far_below, near_below = y + above, below - y, y - above, y + below
        with_z, without_z, with_y, without_y = x + xz, x - xz, xy + xyz, xy - xyz
        low, high = without_z - without_y, without_z + without_y
        low_above, high_above = with_z - with_y, with_z + with_y
        return (
            -(near_below + low),
            low - near_below,
            far_below - high,
            far_below + high,
            near_above - low_above,
            near_above + low_above,
            far_above - high_above,
            far_above + high_above,
        )

    @compiled
    def added_up(start, v1, w1, v2, w2, v3, w3):
        """A vector and three more with their weights, added up."""
        return (
            start[0] + v1[0] * w1 + v2[0] * w2 + v3[0] * w3,
            start[1] + v1[1] * w1 + v2[1] * w2 + v3[1] * w3,
            start[2] + v1[2] * w1 + v2[2] * w2 + v3[2] * w3,
        )

    @compiled
    def added(start, v, w):
        return start[0] + v[0] * w, start[1] + v[1] * w, start[2] + v[2] * w

    @compiled
    def minus(v, w):
        return v[0] - w[0], v[1] - w[1], v[2] - w[2]

    @compiled
    def cofactor_columns(h):
        """Columns of the cofactors of a matrix of columns."""
        return cross(h[1], h[2]), cross(h[2], h[0]), cross(h[0], h[1])

    @compiled
    def change_of_volume(h, cofactors):
        """Trace of H, D - 1, 1 / D and d."""
        trace = h[0][0] + h[1][1] + h[2][2]
        stretch = trace * two + dot(h[0], h[0]) + dot(h[1], h[1]) + dot(h[2], h[2])
        swelling = trace + (cofactors[0][0] + cofactors[1][1] + cofactors[2][2]) + dot(h[0], cofactors[0])
        beyond = stretch * sixth
        inverse = one / (beyond + one)
        return trace, beyond, inverse, swelling * inverse

    @compiled
    def stress(h, cofactors, c0, c1, c2):
        """Columns of c0 I + c1 H + c2 (H^T - cof H)."""
        x, y, z = h
        cx, cy, cz = cofactors
        return (
            (c0 + c1 * x[0] + c2 * (x[0] - cx[0]), c1 * x[1] + c2 * (y[0] - cx[1]), c1 * x[2] + c2 * (z[0] - cx[2])),
            (c1 * y[0] + c2 * (x[1] - cy[0]), c0 + c1 * y[1] + c2 * (y[1] - cy[1]), c1 * y[2] + c2 * (z[1] - cy[2])),
            (c1 * z[0] + c2 * (x[2] - cz[0]), c1 * z[1] + c2 * (y[2] - cz[1]), c0 + c1 * z[2] + c2 * (z[2] - cz[2])),
        )

    @compiled
    def pulled_back(h, q):
        """F^T q."""
        return q[0] + dot(h[0], q), q[1] + dot(h[1], q), q[2] + dot(h[2], q)

    @compiled
    def pushed_forward(h, e):
        """F e."""
        return (
            e[0] + h[0][0] * e[0] + h[1][0] * e[1] + h[2][0] * e[2],
            e[1] + h[0][1] * e[0] + h[1][1] * e[1] + h[2][1] * e[2],
            e[2] + h[0][2] * e[0] + h[1][2] * e[1] + h[2][2] * e[2],
        )

    @compiled
    def volume_term(u, scale, modulus):
        mx, my, mz = modes(u, 0), modes(u, 1), modes(u, 2)
        h = ((mx[0], my[0], mz[0]), (mx[1], my[1], mz[1]), (mx[2], my[2], mz[2]))
        cofactors = cofactor_columns(h)
        trace, _, inverse, d = change_of_volume(h, cofactors)
        b = modulus * d
        a = -(b * d * third)
        x, y, z = stress(h, cofactors, a + b + b * trace, a, -b)
        f = -(scale * inverse)
        nil = f * zero
        fx = at_corners(f * x[0], f * y[0], f * z[0], nil, nil, nil, nil)
        fy = at_corners(f * x[1], f * y[1], f * z[1], nil, nil, nil, nil)
        fz = at_corners(f * x[2], f * y[2], f * z[2], nil, nil, nil, nil)
        return fx, fy, fz

    @compiled
    def gradient(u, moments):
        """Columns of H = F - 1."""
        mx, my, mz = modes(u, 0), modes(u, 1), modes(u, 2)
        m0, m1, m2, myz, mxz, mxy = moments[0], moments[1], moments[2], moments[3], moments[4], moments[5]
        q1, q2, q3, q4 = (mx[3], my[3], mz[3]), (mx[4], my[4], mz[4]), (mx[5], my[5], mz[5]), (mx[6], my[6], mz[6])
        return (
            added_up((mx[0], my[0], mz[0]), q2, m2, q3, m1, q4, myz),
            added_up((mx[1], my[1], mz[1]), q1, m2, q3, m0, q4, mxz),
            added_up((mx[2], my[2], mz[2]), q1, m1, q2, m0, q4, mxy),
        )

    @compiled
    def stretched(h, cofactors, trace, beyond, d, s, less, law):
        """Columns of s times D times what stretching gives, less a multiple of F."""
        mu = law[0]
        b = law[1] * d
        a = s * (mu * (beyond + d * third) - b * d * third) - less
        return stress(h, cofactors, a + s * (b + (b - mu) * trace), a + s * mu, s * (mu - b))

    @compiled
    def stretching(h, law):
        cofactors = cofactor_columns(h)
        trace, beyond, inverse, d = change_of_volume(h, cofactors)
        return stretched(h, cofactors, trace, beyond, d, inverse, zero, law)

    @compiled
    def element(u, scale, own, moments, law, shared):
        mx, my, mz = modes(u, 0), modes(u, 1), modes(u, 2)
        m0, m1, m2, myz, mxz, mxy, sx, sy, sz = moments
        mu, _, plate, ratio, youngs = law
        q1, q2, q3, q4 = (mx[3], my[3], mz[3]), (mx[4], my[4], mz[4]), (mx[5], my[5], mz[5]), (mx[6], my[6], mz[6])
        h = gradient(u, moments)
        cofactors = cofactor_columns(h)
        trace, beyond, inverse, d = change_of_volume(h, cofactors)
        squared = (dot(q1, q1) + dot(q2, q2) + dot(q3, q3)) * square + dot(q4, q4) * far_square
        warp = positive_part(squared - warp_free) / (squared + one)
        inverse_bent = one / (beyond + one + squared * sixth)
        # Stress is worked out times D, so what H gives is weighted by D over its own divisor. All are forces: negative.
        s = -(scale * inverse)
        weight = s * ((beyond + one) * inverse_bent)
        plate_w, shear_w, youngs_w = plate * weight, mu * weight, youngs * weight

        a1, a2, a3, a4 = pulled_back(h, q1), pulled_back(h, q2), pulled_back(h, q3), pulled_back(h, q4)
        px, py, pz = plate_w * sx, plate_w * sy, plate_w * sz
        twist_x, twist_y = shear_w * sx * (a2[1] + a3[2]), shear_w * sy * (a1[0] + a3[2])
        twist_z = shear_w * sz * (a1[0] + a2[1])
        e1 = (twist_y + twist_z, pz * (a1[1] + ratio * a2[0]), py * (a1[2] + ratio * a3[0]))
        e2 = (pz * (a2[0] + ratio * a1[1]), twist_x + twist_z, px * (a2[2] + ratio * a3[1]))
        e3 = (py * (a3[0] + ratio * a1[2]), px * (a3[1] + ratio * a2[2]), twist_x + twist_y)
        e4 = (youngs_w * sy * sz * a4[0], youngs_w * sx * sz * a4[1], youngs_w * sx * sy * a4[2])
        linear = (dot(a1, e1) + dot(a2, e2) + dot(a3, e3) + dot(a4, e4)) * half

        falling = linear * inverse_bent * third
        by_square = s * (warp_stiffness * warp * (one - warp * half) * (beyond + one)) - falling
        x, y, z = stretched(h, cofactors, trace, beyond, d, -(own * inverse), falling, law)
        x = added_up(x, q1, e1[0], q2, e2[0], q3, e3[0])
        y = added_up(y, q1, e1[1], q2, e2[1], q3, e3[1])
        z = added_up(z, q1, e1[2], q2, e2[2], q3, e3[2])
        x, y, z = added(x, q4, e4[0]), added(y, q4, e4[1]), added(z, q4, e4[2])
        x, y, z = minus(x, shared[0]), minus(y, shared[1]), minus(z, shared[2])

        f1, f2 = pushed_forward(h, e1), pushed_forward(h, e2)
        f3, f4 = pushed_forward(h, e3), pushed_forward(h, e4)
        f1 = (f1[0] + m2 * y[0] + m1 * z[0], f1[1] + m2 * y[1] + m1 * z[1], f1[2] + m2 * y[2] + m1 * z[2])
        f2 = (f2[0] + m2 * x[0] + m0 * z[0], f2[1] + m2 * x[1] + m0 * z[1], f2[2] + m2 * x[2] + m0 * z[2])
        f3 = (f3[0] + m1 * x[0] + m0 * y[0], f3[1] + m1 * x[1] + m0 * y[1], f3[2] + m1 * x[2] + m0 * y[2])
        f4 = added_up(f4, x, myz, y, mxz, z, mxy)
        bent, far_bent = by_square * square, by_square * far_square
        f1, f2 = added(f1, q1, bent), added(f2, q2, bent)
        f3, f4 = added(f3, q3, bent), added(f4, q4, far_bent)
        fx = at_corners(x[0], y[0], z[0], f1[0], f2[0], f3[0], f4[0])
        fy = at_corners(x[1], y[1], z[1], f1[1], f2[1], f3[1], f4[1])
        fz = at_corners(x[2], y[2], z[2], f1[2], f2[2], f3[2], f4[2])
        return fx, fy, fz

    @compiled
    def edge(low, high, along):
        return along[0] + (high[0] - low[0]), along[1] + (high[1] - low[1]), along[2] + (high[2] - low[2])

    @compiled
    def edges(u):
        """The four edges along i by (j, k) of their corners, those along j by (i, k), along k by (i, j)."""
        i, j, k = (one, zero, zero), (zero, one, zero), (zero, zero, one)
        return (
            (edge(u[0], u[1], i), edge(u[2], u[3], i), edge(u[4], u[5], i), edge(u[6], u[7], i)),
            (edge(u[0], u[2], j), edge(u[1], u[3], j), edge(u[4], u[6], j), edge(u[5], u[7], j)),
            (edge(u[0], u[4], k), edge(u[1], u[5], k), edge(u[2], u[6], k), edge(u[3], u[7], k)),
        )

    @compiled
    def plus(a, b):
        return a[0] + b[0], a[1] + b[1], a[2] + b[2]

    @compiled
    def farther(along, slope, outward, v, w):
        return (
            along * slope[0] + outward * (v[0] + w[0]),
            along * slope[1] + outward * (v[1] + w[1]),
            along * slope[2] + outward * (v[2] + w[2]),
        )

    @compiled
    def push(a, b, c, scale, floor):
        """Forces on the far ends of the three edges of a corner."""
        bc, ca, ab = cross(b, c), cross(c, a), cross(a, b)
        own = (bc[0] + ca[0] + ab[0], bc[1] + ca[1] + ab[1], bc[2] + ca[2] + ab[2])
        inverse = one / (half + quarter * (dot(bc, bc) + dot(ca, ca) + dot(ab, ab) + dot(own, own)))
        lack = positive_part(floor - dot(a, bc))
        along = scale * lack * inverse
        outward = along * lack * inverse * quarter
        bc_own, ca_own, ab_own = plus(bc, own), plus(ca, own), plus(ab, own)
        return (
            farther(along, bc, outward, cross(ca_own, c), cross(b, ab_own)),
            farther(along, ca, outward, cross(ab_own, a), cross(c, bc_own)),
            farther(along, ab, outward, cross(bc_own, b), cross(a, ca_own)),
        )

    @compiled
    def ends(n, i0, i1, i2, i3, j0, j1, j2, j3, k0, k1, k2, k3):
        """One component at the eight corners, of forces on the far ends of the edges."""
        return (
            -(i0[n] + j0[n] + k0[n]),
            i0[n] - j1[n] - k1[n],
            j0[n] - i1[n] - k2[n],
            i1[n] + j1[n] - k3[n],
            k0[n] - i2[n] - j2[n],
            i2[n] + k1[n] - j3[n],
            j2[n] + k2[n] - i3[n],
            i3[n] + j3[n] + k3[n],
        )

    @compiled
    def corner_guard(u, scale, floor):
        along_i, along_j, along_k = edges(u)
        s = scale * eighth
        p0 = push(along_i[0], along_j[0], along_k[0], s, floor)
        p1 = push(along_i[0], along_j[1], along_k[1], s, floor)
        p2 = push(along_i[1], along_j[0], along_k[2], s, floor)
        p3 = push(along_i[1], along_j[1], along_k[3], s, floor)
        p4 = push(along_i[2], along_j[2], along_k[0], s, floor)
        p5 = push(along_i[2], along_j[3], along_k[1], s, floor)
        p6 = push(along_i[3], along_j[2], along_k[2], s, floor)
        p7 = push(along_i[3], along_j[3], along_k[3], s, floor)
        i0, i1, i2, i3 = plus(p0[0], p1[0]), plus(p2[0], p3[0]), plus(p4[0], p5[0]), plus(p6[0], p7[0])
        j0, j1, j2, j3 = plus(p0[1], p2[1]), plus(p1[1], p3[1]), plus(p4[1], p6[1]), plus(p5[1], p7[1])
        k0, k1, k2, k3 = plus(p0[2], p4[2]), plus(p1[2], p5[2]), plus(p2[2], p6[2]), plus(p3[2], p7[2])
        fx = ends(0, i0, i1, i2, i3, j0, j1, j2, j3, k0, k1, k2, k3)
        fy = ends(1, i0, i1, i2, i3, j0, j1, j2, j3, k0, k1, k2, k3)
        fz = ends(2, i0, i1, i2, i3, j0, j1, j2, j3, k0, k1, k2, k3)
        return fx, fy, fz

    @compiled
    def lack(a, b, c, volume):
        return positive_part(volume - dot(a, cross(b, c)))

    @compiled
    def corner_lack(u, volume):
        along_i, along_j, along_k = edges(u)
        return (
            lack(along_i[0], along_j[0], along_k[0], volume)
            + lack(along_i[0], along_j[1], along_k[1], volume)
            + lack(along_i[1], along_j[0], along_k[2], volume)
            + lack(along_i[1], along_j[1], along_k[3], volume)
            + lack(along_i[2], along_j[2], along_k[0], volume)
            + lack(along_i[2], along_j[3], along_k[1], volume)
            + lack(along_i[3], along_j[2], along_k[2], volume)
            + lack(along_i[3], along_j[3], along_k[3], volume)
        )

    return CellMath(gradient, stretching, element, volume_term, corner_guard, corner_lack)
