"""Signed distances of shapes that reshape structures: canals of three cross-sections, strokes of a brush.

All are exact inside and out. The nearest point of an ellipse is the root of a convex function that Newton's iteration
reaches from one side (Eberly, Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid, 2013).
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import Reshaping
from heartcase.schemas.arrays import Float64
from heartcase.schemas.geometry import Geometry

__all__ = ["SHAPE_KINDS", "distance_on_lattice", "frame_of", "section_distance", "shape_distance"]


SHAPE_KINDS = {"cylinder": 0, "strokes": 1, "elliptic": 2, "slit": 3}
"""Name of a shape -> number that the kernels know it by."""
STEPS = 64
"""Most steps of the iteration to an ellipse's closest point."""


def distance_on_lattice(one: Reshaping, lattice: Geometry) -> Float64:
    """Signed distance to a shape at all points of a lattice, mm, negative inside, float64 ``lattice.shape``."""
    distance = np.empty(lattice.shape)
    points = np.array(one.points_mm, np.float64)
    _fill_lattice(
        SHAPE_KINDS[one.shape], points, float(one.radius_mm), np.ascontiguousarray(lattice.affine[:3]), distance
    )
    return distance


def frame_of(one: Reshaping) -> tuple[Float64, Float64, Float64, float, float]:
    """The cross-section of a canal.

    Returns
    -------
    tuple
        Unit vector along the canal, those of the long and the short diameter, and half of these diameters in mm. A
        round one takes any two directions.
    """
    points = np.array(one.points_mm)
    unit = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
    if one.shape == "cylinder":
        side = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
        side /= np.linalg.norm(side)
        return unit, side, np.cross(unit, side), one.radius_mm, one.radius_mm
    middle = 0.5 * (points[0] + points[1])
    long, short = points[2] - middle, points[3] - middle
    half_long, half_short = float(np.linalg.norm(long)), float(np.linalg.norm(short))
    return unit, long / half_long, short / half_short, half_long, half_short


def section_distance(one: Reshaping, u: Float64, v: Float64) -> Float64:
    """Signed distance to a canal's cross-section in its plane.

    Parameters
    ----------
    one
        A canal.
    u, v
        Coordinates along the long and the short diameter from the middle, mm, of one shape.

    Returns
    -------
    Float64
        mm, negative inside, of the coordinates' shape.
    """
    *_, long, short = frame_of(one)
    distance = np.empty(u.size)
    flat_u, flat_v = np.ascontiguousarray(u, np.float64).ravel(), np.ascontiguousarray(v, np.float64).ravel()
    _fill_section(SHAPE_KINDS[one.shape], long, short, flat_u, flat_v, distance)
    return distance.reshape(u.shape)


@copied
def _cylinder_distance(points, radius, x, y, z):
    """Signed distance to a cylinder with flat ends, exact inside and out."""
    ax = points[1, 0] - points[0, 0]
    ay = points[1, 1] - points[0, 1]
    az = points[1, 2] - points[0, 2]
    length = np.sqrt(ax * ax + ay * ay + az * az)
    px = x - points[0, 0]
    py = y - points[0, 1]
    pz = z - points[0, 2]
    along = (px * ax + py * ay + pz * az) / length
    across = np.sqrt(max(px * px + py * py + pz * pz - along * along, 0.0)) - radius
    beyond = abs(along - 0.5 * length) - 0.5 * length
    if across > 0.0 and beyond > 0.0:
        return np.sqrt(across * across + beyond * beyond)
    return max(across, beyond)


@copied
def _strokes_distance(points, radius, x, y, z):
    """Signed distance to the chain of capsules along a polyline."""
    lowest = np.inf
    for n in range(max(len(points) - 1, 1)):
        last = min(n + 1, len(points) - 1)
        ax = points[last, 0] - points[n, 0]
        ay = points[last, 1] - points[n, 1]
        az = points[last, 2] - points[n, 2]
        px = x - points[n, 0]
        py = y - points[n, 1]
        pz = z - points[n, 2]
        square = ax * ax + ay * ay + az * az
        t = 0.0
        if square > 0.0:
            t = min(max((px * ax + py * ay + pz * az) / square, 0.0), 1.0)
        px -= t * ax
        py -= t * ay
        pz -= t * az
        lowest = min(lowest, px * px + py * py + pz * pz)
    return np.sqrt(lowest) - radius


@copied
def _ellipse_distance(a, b, u, v):
    """Signed distance to an ellipse with half diameters ``a >= b``, exact to 1e-9 of its size."""
    # The foot is (a^2 u / (s + a^2 - b^2), b^2 v / s) with s the root of g, which is convex and falls; on the axes the
    # pole of g would hide the root, so points there are moved by a billionth.
    u = max(abs(u), 1e-9 * a)
    v = max(abs(v), 1e-9 * b)
    excess = (a - b) * (a + b)
    s = max(b * v, a * u - excess)
    for _ in range(STEPS):
        p = a * u / (s + excess)
        q = b * v / s
        g = p * p + q * q - 1.0
        step = 0.5 * g / (p * p / (s + excess) + q * q / s)
        s += step
        if step <= 1e-15 * s:
            break
    gap_u = u / (s + excess)
    gap_v = v / s
    size = abs(s - b * b) * np.sqrt(gap_u * gap_u + gap_v * gap_v)
    return size if (u / a) * (u / a) + (v / b) * (v / b) > 1.0 else -size


@copied
def _section(kind, a, b, u, v):
    """Signed distance to a cross-section in its plane."""
    if kind == 2:
        return _ellipse_distance(a, b, u, v)
    beyond = max(abs(u) - (a - b), 0.0)
    return np.sqrt(beyond * beyond + v * v) - b


@copied
def _prism_distance(kind, points, x, y, z):
    """Signed distance to a canal with flat ends whose cross-section is an ellipse or a slit.

    ``points``: the middles of the ends, and the tips of the long and of the short half diameter in the middle.
    """
    length = 0.0
    long = 0.0
    short = 0.0
    along = 0.0
    u = 0.0
    v = 0.0
    place = (x, y, z)
    for axis in range(3):
        middle = 0.5 * (points[0, axis] + points[1, axis])
        way = points[1, axis] - points[0, axis]
        side = points[2, axis] - middle
        up = points[3, axis] - middle
        gap = place[axis] - middle
        length += way * way
        long += side * side
        short += up * up
        along += gap * way
        u += gap * side
        v += gap * up
    length = np.sqrt(length)
    long = np.sqrt(long)
    short = np.sqrt(short)
    across = _section(kind, long, short, u / long, v / short)
    beyond = abs(along / length) - 0.5 * length
    if across > 0.0 and beyond > 0.0:
        return np.sqrt(across * across + beyond * beyond)
    return max(across, beyond)


@copied
def shape_distance(kind, points, radius, x, y, z):
    """Signed distance at a world point to the shape with a number of :data:`SHAPE_KINDS`, mm, negative inside."""
    if kind == 0:
        return _cylinder_distance(points, radius, x, y, z)
    if kind == 1:
        return _strokes_distance(points, radius, x, y, z)
    return _prism_distance(kind, points, x, y, z)


@kernel
def _fill_section(kind, long, short, u, v, distance):
    for n in range(len(u)):
        distance[n] = _section(kind, long, short, u[n], v[n])


@kernel
def _fill_lattice(kind, points, radius, to_world, distance):
    m = to_world
    for k in range(distance.shape[0]):
        for j in range(distance.shape[1]):
            for i in range(distance.shape[2]):
                x = m[0, 0] * i + m[0, 1] * j + m[0, 2] * k + m[0, 3]
                y = m[1, 0] * i + m[1, 1] * j + m[1, 2] * k + m[1, 3]
                z = m[2, 0] * i + m[2, 1] * j + m[2, 2] * k + m[2, 3]
                distance[k, j, i] = shape_distance(kind, points, radius, x, y, z)
