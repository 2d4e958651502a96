"""Implicit shapes: signed distances in mm, negative inside, of primitives and of smooth combinations of them.

A primitive's value is its signed distance (the exactness is stated with each). Smooth combinations keep the
Lipschitz bound of 1 but are distances only away from the blend: :mod:`heartcase.phantom.anatomy.tables` turns any shape
into a true distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline, PchipInterpolator

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float64

__all__ = [
    "Capsule",
    "Ellipsoid",
    "HalfSpace",
    "Intersection",
    "Narrowing",
    "Offset",
    "Shape",
    "Shell",
    "Tube",
    "Union",
    "complement",
    "smooth_max",
    "smooth_min",
]

Vector = Sequence[float] | Float64


class Shape(Protocol):
    """Anything with a signed value at points."""

    def distance(self, points: Float64) -> Float64:
        """Signed distance in mm at world points, shape (n, 3) -> (n,), negative inside."""
        ...


def smooth_min(a: Float64, b: Float64, blend_mm: float) -> Float64:
    """Minimum with a cubic blend where the two differ by less than ``blend_mm``; equals ``min`` elsewhere.

    The blend is twice continuously differentiable and lies at most ``blend_mm / 6`` below the minimum.
    """
    if blend_mm <= 0.0:
        return np.minimum(a, b)
    overlap = np.maximum(blend_mm - np.abs(a - b), 0.0) / blend_mm
    blended: Float64 = np.minimum(a, b) - overlap**3 * (blend_mm / 6.0)
    return blended


def smooth_max(a: Float64, b: Float64, blend_mm: float) -> Float64:
    """Maximum with a cubic blend: the mirror image of :func:`smooth_min`."""
    return -smooth_min(-a, -b, blend_mm)


@dataclass(frozen=True)
class HalfSpace:
    """All points behind a plane: exact distance."""

    position_mm: Vector
    """A point of the plane."""
    normal: Vector
    """Direction out of the half space, any length."""

    def distance(self, points: Float64) -> Float64:
        """Signed distance in mm, shape (n, 3) -> (n,)."""
        normal = np.asarray(self.normal, dtype=float)
        value: Float64 = (points - np.asarray(self.position_mm, dtype=float)) @ (normal / np.linalg.norm(normal))
        return value


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid: distance exact to 1e-9 of its size, inside and outside."""

    center_mm: Vector
    """Centre."""
    radii_mm: Vector
    """Semi-axes along the rows of ``axes``."""
    axes: npt.ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """Orthonormal rows: directions of the semi-axes."""

    def distance(self, points: Float64) -> Float64:
        """Signed distance in mm, shape (n, 3) -> (n,)."""
        local = (points - np.asarray(self.center_mm, dtype=float)) @ np.asarray(self.axes, dtype=float).T
        value: Float64 = _ellipsoid_distance(np.ascontiguousarray(local), np.asarray(self.radii_mm, dtype=float))
        return value


@kernel
def _ellipsoid_distance(local, radii):
    # Foot of the perpendicular: x_i = r_i^2 y_i / (t + r_i^2) with t the largest root of g. g is convex and falls, so
    # Newton from the left of the root converges monotonically.
    count = local.shape[0]
    value = np.empty(count)
    scale = max(radii[0], radii[1], radii[2])
    y = np.empty(3)
    for n in range(count):
        level = 0.0
        t = -np.inf
        for axis in range(3):
            y[axis] = max(abs(local[n, axis]), 1e-9 * scale)
            level += (y[axis] / radii[axis]) ** 2
            t = max(t, radii[axis] * y[axis] - radii[axis] ** 2)
        for _ in range(120):
            g = -1.0
            slope = 0.0
            for axis in range(3):
                ratio = radii[axis] * y[axis] / (t + radii[axis] ** 2)
                g += ratio * ratio
                slope -= 2.0 * ratio * ratio / (t + radii[axis] ** 2)
            step = -g / slope
            t += step
            if abs(step) <= 1e-13 * scale * scale:
                break
        total = 0.0
        for axis in range(3):
            total += (y[axis] * t / (t + radii[axis] ** 2)) ** 2
        value[n] = np.sqrt(total) if level > 1.0 else -np.sqrt(total)
    return value


@dataclass(frozen=True)
class Capsule:
    """A cylinder with round ends: exact distance."""

    start_mm: Vector
    """Centre of the first end."""
    end_mm: Vector
    """Centre of the second end."""
    radius_mm: float
    """Radius."""

    def distance(self, points: Float64) -> Float64:
        """Signed distance in mm, shape (n, 3) -> (n,)."""
        start = np.asarray(self.start_mm, dtype=float)
        along = np.asarray(self.end_mm, dtype=float) - start
        fraction = np.clip((points - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        value: Float64 = np.linalg.norm(points - start - fraction[:, None] * along, axis=1) - self.radius_mm
        return value


@dataclass(frozen=True)
class Narrowing:
    """A place where a tube is narrower."""

    near_mm: Vector
    """The tube is narrowest where its line is nearest to this point."""
    ratio: float
    """Its radius there against what it would be."""
    length_mm: float
    """Distance along the line after which the narrowing has gone down to a factor 1 / e."""


class Tube:
    """A tube along a smooth centreline (a cubic spline through points) with a smoothly varying radius.

    The distance is exact where the radius is constant and less than the radius of curvature; where the radius
    changes with slope s along the line it is off by the factor ``sqrt(1 + s^2)``.

    Parameters
    ----------
    points_mm
        Points that the centreline passes, shape (n, 3), n >= 2.
    radii_mm
        Radius at each of them.
    flat_start, flat_end
        Cut the end square at its point instead of rounding it.
    trim_mm
        End the line this much before its last point.
    narrowings
        Where it is narrower.
    """

    def __init__(
        self,
        points_mm: npt.ArrayLike,
        radii_mm: npt.ArrayLike,
        *,
        flat_start: bool = False,
        flat_end: bool = False,
        trim_mm: float = 0.0,
        narrowings: Sequence[Narrowing] = (),
    ) -> None:
        points = np.asarray(points_mm, dtype=float)
        radii = np.broadcast_to(np.asarray(radii_mm, dtype=float), (len(points),))
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        self.line = CubicSpline(at, points)
        self._plain_radius = PchipInterpolator(at, radii)
        self.length_mm = float(at[-1]) - trim_mm
        self._narrowings = [
            (self.nearest_mm(np.asarray(one.near_mm, dtype=float)), one.ratio, one.length_mm) for one in narrowings
        ]
        self._at = np.linspace(0.0, self.length_mm, max(8, int(self.length_mm / (0.25 * radii.min())) + 1))
        self._flat = np.array([flat_start, flat_end])

    def frame(self, at_mm: float) -> tuple[Float64, Float64, float]:
        """Centre, unit direction and radius at a position along the line."""
        direction = self.line(at_mm, 1)
        return self.line(at_mm), direction / np.linalg.norm(direction), float(self.radius(at_mm))

    def radius(self, at_mm: npt.ArrayLike) -> Float64:
        """Radius at positions along the line, mm."""
        at = np.asarray(at_mm, dtype=float)
        radius: Float64 = np.asarray(self._plain_radius(at))
        for centre, ratio, length in self._narrowings:
            radius = radius * (1.0 - (1.0 - ratio) * np.exp(-(((at - centre) / length) ** 2)))
        return radius

    def nearest_mm(self, point_mm: Float64) -> float:
        """Position along the line that is nearest to a point, to a thousandth of its length."""
        at = np.linspace(0.0, self.length_mm, 1001)
        return float(at[np.argmin(np.linalg.norm(self.line(at) - point_mm, axis=1))])

    def distance(self, points: Float64) -> Float64:
        """Signed distance in mm, shape (n, 3) -> (n,)."""
        at = _nearest_parameter(np.ascontiguousarray(points), self._at, self.line(self._at), self.line.x, self.line.c)
        value: Float64 = np.linalg.norm(points - self.line(at), axis=1) - self.radius(at)
        for end, at_end, sign in ((0, 0.0, -1.0), (1, self.length_mm, 1.0)):
            if self._flat[end]:
                centre, direction, radius = self.frame(at_end)
                axial = sign * (points - centre) @ direction
                near = np.linalg.norm(points - centre, axis=1) < 3.0 * radius
                beyond = near & (axial > 0.0)
                radial = np.linalg.norm(points - centre - (sign * axial)[:, None] * direction, axis=1) - radius
                value = np.where(near, np.maximum(value, axial), value)
                value = np.where(beyond, np.hypot(np.maximum(radial, 0.0), axial), value)
        return value


@kernel
def _nearest_parameter(points, at, samples, breaks, coefficients):
    count = points.shape[0]
    found = np.empty(count)
    last = len(breaks) - 2
    step = at[1] - at[0]
    for n in range(count):
        best = 0
        lowest = np.inf
        for s in range(len(at)):
            dx = points[n, 0] - samples[s, 0]
            dy = points[n, 1] - samples[s, 1]
            dz = points[n, 2] - samples[s, 2]
            square = dx * dx + dy * dy + dz * dz
            if square < lowest:
                lowest = square
                best = s
        t = at[best]
        for _ in range(6):
            piece = min(max(np.searchsorted(breaks, t, side="right") - 1, 0), last)
            u = t - breaks[piece]
            slope = 0.0
            curve = 0.0
            for axis in range(3):
                a = coefficients[0, piece, axis]
                b = coefficients[1, piece, axis]
                c = coefficients[2, piece, axis]
                d = coefficients[3, piece, axis]
                gap = ((a * u + b) * u + c) * u + d - points[n, axis]
                first = (3.0 * a * u + 2.0 * b) * u + c
                slope += gap * first
                curve += first * first + gap * (6.0 * a * u + 2.0 * b)
            move = -slope / curve if curve > 1e-6 else -np.sign(slope) * 0.5 * step
            t = min(max(t + min(max(move, -step), step), 0.0), at[-1])
            if abs(move) < 1e-9:
                break
        found[n] = t
    return found


@dataclass(frozen=True)
class Offset:
    """A shape grown (or with a negative offset shrunk) by a distance."""

    shape: Shape
    """What is grown."""
    by_mm: float
    """How far."""

    def distance(self, points: Float64) -> Float64:
        """Signed value in mm, shape (n, 3) -> (n,)."""
        return self.shape.distance(points) - self.by_mm


@dataclass(frozen=True)
class Shell:
    """The layer of a thickness outside a shape."""

    shape: Shape
    """What the layer lies on."""
    thickness_mm: float
    """Thickness."""

    def distance(self, points: Float64) -> Float64:
        """Signed value in mm, shape (n, 3) -> (n,)."""
        inner = self.shape.distance(points)
        value: Float64 = np.maximum(inner - self.thickness_mm, -inner)
        return value


@dataclass(frozen=True)
class Union:
    """Shapes joined, with blended seams."""

    shapes: Sequence[Shape]
    """The shapes, joined in order."""
    blend_mm: float = 0.0
    """Width of the blend; 0 leaves the seam sharp."""

    def distance(self, points: Float64) -> Float64:
        """Signed value in mm, shape (n, 3) -> (n,)."""
        value = self.shapes[0].distance(points)
        for shape in self.shapes[1:]:
            value = smooth_min(value, shape.distance(points), self.blend_mm)
        return value


@dataclass(frozen=True)
class Intersection:
    """What shapes have in common, with blended edges."""

    shapes: Sequence[Shape]
    """The shapes, intersected in order."""
    blend_mm: float = 0.0
    """Width of the blend; 0 leaves the edge sharp."""

    def distance(self, points: Float64) -> Float64:
        """Signed value in mm, shape (n, 3) -> (n,)."""
        value = self.shapes[0].distance(points)
        for shape in self.shapes[1:]:
            value = smooth_max(value, shape.distance(points), self.blend_mm)
        return value


@dataclass(frozen=True)
class _Complement:
    shape: Shape

    def distance(self, points: Float64) -> Float64:
        return -self.shape.distance(points)


def complement(shape: Shape, *, gap_mm: float = 0.0) -> Shape:
    """Everything that is at least ``gap_mm`` away from a shape."""
    return _Complement(Offset(shape, gap_mm))
