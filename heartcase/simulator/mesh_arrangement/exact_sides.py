"""On which side of a triangle, or of a line, something lies, in whole numbers and never on it: kernels.

The tissue counts as moved against the sheets by less than any number, first along y, then z, then x, as the samples are
(:mod:`heartcase.simulator.cutting.crossings`). So a corner of the surface is on one side of each triangle of a sheet, a
line passes another on one side, and whatever is asked about the two, all answers are of one and the same arrangement.
Coordinates may differ by up to 256 cells: products of three differences then fit into 64 bits.
"""

from __future__ import annotations

from heartcase.compiling.kernel import kernel

__all__ = ["line_side", "sheet_side", "tissue_side", "volume"]


@kernel(cached=False)
def _normal(p, q, r):
    ax, ay, az = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    bx, by, bz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@kernel(cached=False)
def volume(p, q, r, m):
    """Six times the volume of a tetrahedron, above zero where p, q, r turn counter-clockwise seen from m."""
    x, y, z = _normal(p, q, r)
    return x * (m[0] - p[0]) + y * (m[1] - p[1]) + z * (m[2] - p[2])


@kernel(cached=False)
def _first_sign(x, y, z):
    """Sign of the component that moves most."""
    chosen = y if y != 0 else z if z != 0 else x
    return 1 if chosen > 0 else -1 if chosen < 0 else 0


@kernel(cached=False)
def tissue_side(p, q, r, m):
    """Side of a sheet's triangle on which a corner of the surface lies: 1 before it, -1 behind, 0 if it has no area."""
    found = volume(p, q, r, m)
    if found != 0:
        return 1 if found > 0 else -1
    x, y, z = _normal(p, q, r)
    return _first_sign(x, y, z)


@kernel(cached=False)
def sheet_side(a, b, c, p):
    """Side of a surface's triangle on which a corner of a sheet lies."""
    found = volume(a, b, c, p)
    if found != 0:
        return 1 if found > 0 else -1
    x, y, z = _normal(a, b, c)
    return -_first_sign(x, y, z)


@kernel(cached=False)
def line_side(a, b, p, q):
    """Side on which the surface's edge from a to b passes the sheet's from p to q; 0 if they are parallel and touch."""
    found = volume(a, b, p, q)
    if found != 0:
        return 1 if found > 0 else -1
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    return _first_sign(uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx)
