"""Vessels drawn as a line with a radius, such as coronary arteries, as closed surfaces of their own."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from heartcase.schemas.arrays import Float32, Float64, Int32, Int64
from heartcase.schemas.landmarks import Landmark

__all__ = ["VESSEL_COLOUR", "TubeMesh", "tube_mesh", "vessel_tubes"]


VESSEL_COLOUR = "#b3001b"
"""Colour of vessels, ``#rrggbb``."""
_SMALLEST_STEP = 1e-3
"""Points nearer to each other than this, mm, count as one."""


@dataclass(frozen=True)
class TubeMesh:
    """A closed tube with round ends."""

    vertices_mm: Float32
    """LPS mm, shape (vertex_count, 3)."""
    normals: Float32
    """Unit normals outward, shape (vertex_count, 3)."""
    triangles: Int32
    """Vertex numbers, counter-clockwise from outside, shape (triangle_count, 3)."""


def vessel_tubes(landmarks: Iterable[Landmark], *, side_count: int = 16) -> dict[str, TubeMesh]:
    """Tubes of the landmarks that are vessels (polylines with a radius), by name; one without a length has none."""
    tubes = {}
    for one in landmarks:
        if one.is_vessel and one.radius_mm is not None:
            points = _apart(np.array(one.points_mm, dtype=np.float64))
            if len(points) > 1:
                tubes[one.name] = tube_mesh(points, one.radius_mm, side_count=side_count)
    return tubes


def tube_mesh(points_mm: npt.ArrayLike, radius_mm: float, *, side_count: int = 16) -> TubeMesh:
    """The surface at a distance from a smooth line.

    The line is the cubic spline through the points, by the length of the chords. Rings of vertices stand across it,
    each turned against the one before as little as possible (parallel transport by double reflection: Wang et al.,
    ACM Transactions on Graphics 27, 2008, article 2). All vertices lie at the radius from the line, as long as it
    bends no sharper than that; the middles of triangles lie within it by ``1 - cos(pi / side_count)`` of the radius.

    Parameters
    ----------
    points_mm
        At least two points, no two after each other the same, LPS mm, shape (n, 3).
    radius_mm
        The radius.
    side_count
        Vertices of a ring, at least 3.
    """
    points = np.asarray(points_mm, dtype=np.float64)
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    line = CubicSpline(at, points)
    ring_step = 2.0 * np.pi / side_count * radius_mm
    along = np.linspace(0.0, at[-1], max(2, 1 + int(np.ceil(at[-1] / (2.0 * ring_step)))))
    centres = line(along)
    tangents = line(along, 1)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    aside, across = _frames(centres, tangents)

    # Rings of the round ends: their centre, and how far along the tangent and how wide their unit vectors are.
    lean = np.arange(1, max(2, side_count // 4)) / max(2, side_count // 4) * 0.5 * np.pi
    ring = np.concatenate([np.zeros(len(lean), np.intp), np.arange(len(along)), np.full(len(lean), len(along) - 1)])
    lean = np.concatenate([-lean[::-1], np.zeros(len(along)), lean])
    angle = 2.0 * np.pi * np.arange(side_count) / side_count
    out = np.cos(angle)[:, None] * aside[ring, None, :] + np.sin(angle)[:, None] * across[ring, None, :]
    normals = np.cos(lean)[:, None, None] * out + np.sin(lean)[:, None, None] * tangents[ring, None, :]
    poles = np.stack([-tangents[0], tangents[-1]])
    normals = np.concatenate([normals.reshape(-1, 3), poles])
    centre = np.concatenate([np.repeat(centres[ring], side_count, axis=0), centres[[0, -1]]])
    vertices = centre + radius_mm * normals
    return TubeMesh(
        vertices.astype(np.float32), normals.astype(np.float32), _triangles(len(ring), side_count).astype(np.int32)
    )


def _apart(points: Float64) -> Float64:
    """The points without those that repeat the one before."""
    kept = [0]
    for n in range(1, len(points)):
        if np.linalg.norm(points[n] - points[kept[-1]]) > _SMALLEST_STEP:
            kept.append(n)
    return points[kept]


def _frames(centres: Float64, tangents: Float64) -> tuple[Float64, Float64]:
    """Two unit vectors across each tangent, such that (aside, across, tangent) is right-handed."""
    aside = np.empty_like(tangents)
    first = np.cross(tangents[0], np.eye(3)[int(np.argmin(np.abs(tangents[0])))])
    aside[0] = first / np.linalg.norm(first)
    for n in range(len(tangents) - 1):
        step = centres[n + 1] - centres[n]
        mirrored = aside[n] - 2.0 * (step @ aside[n]) / (step @ step) * step
        tangent = tangents[n] - 2.0 * (step @ tangents[n]) / (step @ step) * step
        second = tangents[n + 1] - tangent
        size = second @ second
        moved = mirrored - (2.0 * (second @ mirrored) / size * second if size > 0.0 else 0.0)
        moved -= (moved @ tangents[n + 1]) * tangents[n + 1]
        aside[n + 1] = moved / np.linalg.norm(moved)
    return aside, np.cross(tangents, aside)


def _triangles(ring_count: int, side_count: int) -> Int64:
    """Rings of vertices one after the other, then the pole before the first and the one after the last."""
    here = np.arange(side_count)
    after = np.roll(here, -1)
    start = side_count * np.arange(ring_count - 1)[:, None]
    a, b, c, d = start + here, start + after, start + side_count + here, start + side_count + after
    sides = np.concatenate([np.stack([a, b, d], axis=-1).reshape(-1, 3), np.stack([a, d, c], axis=-1).reshape(-1, 3)])
    last = side_count * (ring_count - 1)
    pole = np.full(side_count, side_count * ring_count)
    ends = np.concatenate(
        [np.stack([pole, after, here], axis=1), np.stack([pole + 1, last + here, last + after], axis=1)]
    )
    return np.concatenate([sides, ends])
