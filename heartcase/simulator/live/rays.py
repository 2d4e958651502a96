"""From a place on the screen to a place in space: rays, what they hit first of a surface, planes that they cross."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64

__all__ = ["Eye", "Hit", "Pointer", "Ray", "first_hit", "on_plane"]

_AHEAD_MM = 1e-6
"""What is nearer to a ray's start is not in front of it."""


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
    """Number of the triangle."""
    normal: Float64
    """Unit normal of the triangle, towards the ray's start, LPS, shape (3,)."""
    distance_mm: float
    """How far along the ray, mm."""


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


def first_hit(ray: Ray, vertices_mm: npt.ArrayLike, triangles: npt.NDArray[Any]) -> Hit | None:
    """What a ray meets first of a surface; None where it meets nothing. Both sides of a triangle count.

    Vertices are looked at along the ray: a triangle is hit where the ray's own place lies inside of its outline (as of
    Woop, Benthin and Wald, Journal of Computer Graphics Techniques 2, 2013), so that no ray slips through an edge.

    Parameters
    ----------
    ray
        The ray.
    vertices_mm
        LPS mm, shape (vertex_count, 3).
    triangles
        Vertex numbers, shape (triangle_count, 3).
    """
    triangles = np.asarray(triangles)
    if not len(triangles):
        return None
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
    if not ahead.any():
        return None
    place = np.flatnonzero(ahead)[distance[ahead].argmin()]
    a, b, c = np.asarray(vertices_mm, dtype=float)[corners[place]]
    normal = np.cross(b - a, c - a)
    normal = normal / np.linalg.norm(normal)
    if normal @ ray.direction > 0.0:
        normal = -normal
    return Hit(ray.at(float(distance[place])), int(near[place]), normal, float(distance[place]))


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
