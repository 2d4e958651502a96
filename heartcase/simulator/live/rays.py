"""From a place on the screen to a place in space: rays, what they hit first of a surface, planes that they cross."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float64

__all__ = ["CutPlane", "Eye", "Hit", "Pointer", "Ray", "first_hit", "first_hit_beside", "on_plane"]

_AHEAD_MM = 1e-6
"""What is nearer to a ray's start is not in front of it."""
_FLAT = 1e-9
"""Slope of a ray against a plane below which it runs along it."""


@dataclass(frozen=True)
class Ray:
    """A half-line."""

    start_mm: Float64
    """Where it begins, LPS mm, shape (3,)."""
    direction: Float64
    """Where it goes, LPS, unit length, shape (3,)."""

    def at(self, distance_mm: float) -> Float64:
        """The place so far along it, LPS mm, shape (3,)."""
        return self.start_mm + distance_mm * self.direction


@dataclass(frozen=True)
class Hit:
    """What a ray meets first of a surface."""

    point_mm: Float64
    """Where, LPS mm, shape (3,)."""
    triangle: int
    """Number of the triangle; -1 where a cut plane was met in the tissue."""
    normal: Float64
    """Unit normal of the triangle, towards the ray's start, LPS, shape (3,)."""
    distance_mm: float
    """How far along the ray, mm."""


@dataclass(frozen=True)
class CutPlane:
    """A plane that opens what is looked at: what lies beyond it is neither seen nor pointed at."""

    normal: Float64
    """Unit vector to what is taken away, LPS, shape (3,)."""
    offset_mm: float
    """Where it lies along that vector, from the origin, mm."""

    def keeps(self, places_mm: npt.ArrayLike) -> Bool:
        """Whether each of some places is not beyond it, LPS mm, shape (n, 3)."""
        kept: Bool = np.asarray(places_mm, dtype=float) @ self.normal <= self.offset_mm
        return kept


@dataclass(frozen=True)
class Eye:
    """Who looks: where from, where to, and how wide."""

    position_mm: Float64
    """Where the camera is, LPS mm, shape (3,)."""
    focal_point_mm: Float64
    """What it looks at, LPS mm, shape (3,)."""
    up: Float64
    """What is up on the screen, more or less, LPS, shape (3,)."""
    view_angle_deg: float
    """Angle between the lowest and the highest ray, degrees; without effect in a parallel view."""
    parallel_scale_mm: float | None = None
    """Half the height of what is seen, mm, where rays are parallel; else None."""

    @property
    def axes(self) -> Float64:
        """Rows: right and up on the screen, and from what is seen to the eye; LPS, unit length, shape (3, 3)."""
        towards = self.position_mm - self.focal_point_mm
        towards = towards / np.linalg.norm(towards)
        right = np.cross(self.up, towards)
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(towards, right), towards])

    def ray(self, x: float, y: float, size: tuple[int, int]) -> Ray:
        """The ray through a place on the screen.

        Parameters
        ----------
        x, y
            Pixels from the lower left corner of the window, right and up.
        size
            Width and height of the window in pixels.
        """
        width, height = size
        right, up, towards = self.axes
        across, above = (2.0 * x - width) / height, (2.0 * y - height) / height
        if self.parallel_scale_mm is not None:
            aside = self.parallel_scale_mm * (across * right + above * up)
            return Ray(self.position_mm + aside, -towards)
        half = np.tan(np.radians(self.view_angle_deg) / 2.0)
        direction = half * (across * right + above * up) - towards
        return Ray(np.asarray(self.position_mm, dtype=float), direction / np.linalg.norm(direction))


@dataclass(frozen=True)
class Pointer:
    """Where the mouse points at a moment."""

    ray: Ray
    """The ray from the eye through the mouse."""
    hit: Hit | None
    """What it meets of the tissue that is shown; None where it passes by."""
    axes: Float64
    """Those of the eye: right, up, towards it; LPS, shape (3, 3)."""
    plane: CutPlane | None = None
    """The plane beyond which nothing is shown; None where all is."""


def first_hit(ray: Ray, vertices_mm: npt.ArrayLike, triangles: npt.NDArray[Any]) -> Hit | None:
    """What a ray meets first of a surface; None where it meets nothing. Both sides of a triangle count.

    Parameters
    ----------
    ray
        The ray.
    vertices_mm
        LPS mm, shape (vertex_count, 3).
    triangles
        Vertex numbers, shape (triangle_count, 3).
    """
    return _nearest(ray, vertices_mm, triangles, *_crossings(ray, vertices_mm, triangles))


def first_hit_beside(
    ray: Ray,
    vertices_mm: npt.ArrayLike,
    triangles: npt.NDArray[Any],
    plane: CutPlane,
    *,
    closed: npt.NDArray[Any] | None = None,
) -> Hit | None:
    """What a ray meets first of a surface that a plane cuts open: what lies beyond the plane is not there.

    Where the plane cuts the tissue itself, and is looked at from beyond, the plane is met: then the hit has no triangle
    (-1), and the plane's normal.

    Parameters
    ----------
    ray, vertices_mm, triangles
        As of :func:`first_hit`.
    plane
        The plane.
    closed
        All triangles of the closed surface around the tissue, where ``triangles`` are but those that are shown.
    """
    slope = float(ray.direction @ plane.normal)
    start = plane.offset_mm - float(ray.start_mm @ plane.normal)
    # beyond the plane all along the ray, before it, or behind it
    if abs(slope) < _FLAT:
        return first_hit(ray, vertices_mm, triangles) if start >= 0.0 else None
    at = start / slope
    near, far = (max(at, 0.0), np.inf) if slope < 0.0 else (0.0, at)
    if slope < 0.0 < at:
        whole = triangles if closed is None else closed
        numbers, distance = _crossings(ray, vertices_mm, whole)
        beyond = numbers[distance > at]
        a, b, c = np.moveaxis(np.asarray(vertices_mm, dtype=float)[np.asarray(whole)[beyond]], 1, 0)
        leaves = np.einsum("ij,j->i", np.cross(b - a, c - a), ray.direction) > 0.0
        # the ray goes out of the tissue once more often than into it where it begins inside
        if 2 * int(leaves.sum()) > len(leaves):
            return Hit(ray.at(at), -1, plane.normal, at)
    numbers, distance = _crossings(ray, vertices_mm, triangles)
    kept = (distance > near) & (distance < far)
    return _nearest(ray, vertices_mm, triangles, numbers[kept], distance[kept])


def _crossings(ray: Ray, vertices_mm: npt.ArrayLike, triangles: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], Float64]:
    """Numbers of the triangles that a ray meets, and how far along it, mm; in no order.

    Vertices are looked at along the ray: a triangle is hit where the ray's own place lies inside of its outline (as of
    Woop, Benthin and Wald, Journal of Computer Graphics Techniques 2, 2013), so that no ray slips through an edge.
    """
    triangles = np.asarray(triangles)
    if not len(triangles):
        return np.zeros(0, np.int64), np.zeros(0)
    side = np.eye(3)[np.abs(ray.direction).argmin()]
    right = np.cross(ray.direction, side)
    right /= np.linalg.norm(right)
    frame = np.stack([right, np.cross(ray.direction, right), ray.direction])
    x, y, depth = frame @ (np.asarray(vertices_mm, dtype=float) - ray.start_mm).T
    # Most outlines lie on one side of the ray. A corner on it counts as right and above: of the triangles around it one
    # reaches to the left and below, so that none is missed for it in a closed surface.
    left, below = (x < 0.0)[triangles].sum(axis=1), (y < 0.0)[triangles].sum(axis=1)
    near = np.flatnonzero((left > 0) & (left < 3) & (below > 0) & (below < 3))
    corners = triangles[near]
    u, v = x[corners], y[corners]
    doubled = np.roll(u, -1, axis=1) * np.roll(v, -2, axis=1) - np.roll(u, -2, axis=1) * np.roll(v, -1, axis=1)
    area = doubled.sum(axis=1)
    inside = ((doubled >= 0.0).all(axis=1) | (doubled <= 0.0).all(axis=1)) & (area != 0.0)
    near, doubled, area, corners = near[inside], doubled[inside], area[inside], corners[inside]
    distance = (doubled * depth[corners]).sum(axis=1) / area
    ahead = distance > _AHEAD_MM
    return near[ahead], distance[ahead]


def _nearest(
    ray: Ray, vertices_mm: npt.ArrayLike, triangles: npt.NDArray[Any], numbers: npt.NDArray[Any], distance: Float64
) -> Hit | None:
    if not len(numbers):
        return None
    place = int(distance.argmin())
    a, b, c = np.asarray(vertices_mm, dtype=float)[np.asarray(triangles)[numbers[place]]]
    normal = np.cross(b - a, c - a)
    normal = normal / np.linalg.norm(normal)
    if normal @ ray.direction > 0.0:
        normal = -normal
    return Hit(ray.at(float(distance[place])), int(numbers[place]), normal, float(distance[place]))


def on_plane(ray: Ray, point_mm: npt.ArrayLike, normal: npt.ArrayLike) -> Float64 | None:
    """Where a ray crosses a plane, LPS mm, shape (3,); None where it runs along it or away from it.

    Parameters
    ----------
    ray
        The ray.
    point_mm
        A point of the plane, LPS mm, shape (3,).
    normal
        Its normal, LPS, shape (3,), of any length.
    """
    slope = float(ray.direction @ np.asarray(normal, dtype=float))
    if abs(slope) < 1e-9:
        return None
    distance = float((np.asarray(point_mm, dtype=float) - ray.start_mm) @ np.asarray(normal, dtype=float)) / slope
    return ray.at(distance) if distance > 0.0 else None
