"""Strokes of two cavities that touch: painting through a septum marks a hole in it.

Two strokes meet where the line of one comes within the brush of the other. The hole that they mark is a tube along both
lines around that place, as wide as the narrower brush.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from heartcase.schemas.arrays import Float64
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.settings import Stroke

__all__ = ["Meeting", "meetings_of"]

Point = tuple[float, float, float]

STEP_MM = 0.25
"""Distance between the points at which lines are looked at."""
TUBE_MM = 6.0
"""How far beyond the wider brush the tube goes along each line: more than half of any septum that is grown."""


class Meeting(NamedTuple):
    """A place where a stroke of one cavity runs into one of another."""

    numbers: tuple[int, int]
    """Numbers of the two strokes in the recipe, from 1."""
    values: tuple[int, int]
    """Label values of the two cavities, the lower first."""
    center_mm: Point
    """Middle between the nearest points of the two lines, world mm."""
    radius_mm: float
    """Radius of the narrower brush."""
    tubes_mm: tuple[tuple[Point, ...], tuple[Point, ...]]
    """The part of each line around the place."""


def meetings_of(strokes: Sequence[Stroke], table: LabelTable) -> tuple[Meeting, ...]:
    """Find where strokes of two different cavities meet; at most one place for each two strokes, in their order.

    Parameters
    ----------
    strokes
        The recipe's. Erasers, strokes of what is no cavity, and brushes of radius 0 mark no hole.
    table
        Label table.
    """
    lines: list[tuple[int, int, float, Float64]] = []
    for number, stroke in enumerate(strokes, start=1):
        label = None if stroke.label is None else table.find(stroke.label)
        if label is not None and label.role.is_blood and stroke.radius_mm > 0.0:
            lines.append((number, label.value, stroke.radius_mm, _sampled(stroke)))
    return tuple(_meetings(lines))


def _meetings(lines: Sequence[tuple[int, int, float, Float64]]) -> Iterator[Meeting]:
    for (one, value, radius, points), (other, other_value, other_radius, other_points) in combinations(lines, 2):
        if value == other_value:
            continue
        wider = max(radius, other_radius)
        away = np.maximum(points.min(axis=0), other_points.min(axis=0)) - np.minimum(
            points.max(axis=0), other_points.max(axis=0)
        )
        if away.max() > wider:
            continue
        distance, nearest = (np.asarray(one) for one in cKDTree(other_points).query(points))
        first = int(np.argmin(distance.round(6)))
        if distance[first] > wider:
            continue
        center = 0.5 * (points[first] + other_points[nearest[first]])
        tubes = (_part(points, first, wider + TUBE_MM), _part(other_points, int(nearest[first]), wider + TUBE_MM))
        low, high = sorted((value, other_value))
        yield Meeting((one, other), (low, high), _point(center), float(min(radius, other_radius)), tubes)


def _sampled(stroke: Stroke) -> Float64:
    """Points along a stroke's line, its own among them, shape (n, 3)."""
    corners = np.array(stroke.points_mm, np.float64)
    parts = [corners[:1]]
    for start, end in pairwise(corners):
        count = max(int(np.ceil(np.linalg.norm(end - start) / STEP_MM)), 1)
        parts.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    return np.concatenate(parts)


def _part(points: Float64, number: int, reach_mm: float) -> tuple[Point, ...]:
    """The run of a line around one of its points that stays within reach of it."""
    far = np.flatnonzero(np.linalg.norm(points - points[number], axis=1) > reach_mm)
    start = int(far[far < number].max(initial=-1)) + 1
    stop = int(far[far > number].min(initial=len(points)))
    return tuple(_point(point) for point in points[start:stop:2])


def _point(values: Float64) -> Point:
    x, y, z = (round(float(value), 3) for value in values)
    return x, y, z
