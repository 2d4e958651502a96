"""Directions spread evenly over a cone, and curves divided into even pieces."""

from __future__ import annotations

from math import cos, pi, radians, sqrt

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import SimulationError

__all__ = ["cone_directions", "cone_solid_angle_sr", "divided", "fan", "patches", "points_in"]

_GOLDEN = pi * (3.0 - sqrt(5.0))


def cone_solid_angle_sr(half_angle_deg: float) -> float:
    """Solid angle of a cone, sr."""
    return 2.0 * pi * (1.0 - cos(radians(half_angle_deg)))


def cone_directions(axis: npt.ArrayLike, half_angle_deg: float, count: int) -> Float64:
    """Unit vectors spread evenly over a cone, each for the same solid angle; the first is nearest to the axis.

    Points on a golden spiral, by their height along the axis: the same ones in every run.

    Parameters
    ----------
    axis
        Middle of the cone, shape (3,); of any length.
    half_angle_deg
        Half of its opening, above 0 to 180 degrees.
    count
        How many, at least 1.

    Returns
    -------
    ndarray
        Shape (count, 3).

    Raises
    ------
    SimulationError
        The axis is zero or not finite, the angle out of range, or there are none.
    """
    middle = np.asarray(axis, dtype=float)
    length = np.linalg.norm(middle) if middle.shape == (3,) else 0.0
    if not 0.0 < length < np.inf:
        raise SimulationError("give an axis of three finite numbers that are not all zero", place="axis")
    if not 0.0 < half_angle_deg <= 180.0:
        raise SimulationError(f"give above 0 to 180 degrees (found {half_angle_deg:g})", place="half_angle_deg")
    if count < 1:
        raise SimulationError("give at least 1", place="count")
    middle = middle / length
    across = np.eye(3)[int(np.argmin(np.abs(middle)))]
    across = across - (across @ middle) * middle
    across /= np.linalg.norm(across)
    numbers = np.arange(count) + 0.5
    height = 1.0 - (1.0 - cos(radians(half_angle_deg))) * numbers / count
    radius = np.sqrt(np.maximum(1.0 - height**2, 0.0))
    angle = _GOLDEN * np.arange(count)
    spread = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    frame = np.stack([across, np.cross(middle, across), middle])
    directions: Float64 = spread @ frame
    return directions


def divided(curve_mm: npt.ArrayLike, spacing_mm: float, *, is_closed: bool) -> tuple[Float64, Float64]:
    """Points in the middle of even pieces of a curve, and how long each piece is.

    Parameters
    ----------
    curve_mm
        The curve's points, mm, shape (count, 3), at least two.
    spacing_mm
        Longest piece, mm, above 0.
    is_closed
        Whether the last point is joined with the first.

    Returns
    -------
    points_mm
        Shape (piece_count, 3).
    lengths_mm
        Shape (piece_count,); in all the length of the curve.
    """
    points = np.asarray(curve_mm, dtype=float).reshape(-1, 3)
    ends = np.roll(points, -1, axis=0) if is_closed else points[1:]
    starts = points[: len(ends)]
    lengths = np.linalg.norm(ends - starts, axis=1)
    pieces = np.maximum(np.ceil(lengths / spacing_mm).astype(int), 1)
    of = np.repeat(np.arange(len(starts)), pieces)
    number = np.arange(len(of)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    part = (number + 0.5) / pieces[of]
    return starts[of] + part[:, None] * (ends - starts)[of], lengths[of] / pieces[of]


def fan(rim_mm: Float64) -> Float64:
    """Triangles between a closed curve and the mean of its points, mm, shape (count, 3, 3)."""
    return np.stack([np.broadcast_to(rim_mm.mean(axis=0), rim_mm.shape), rim_mm, np.roll(rim_mm, -1, axis=0)], axis=1)


def patches(rim_mm: npt.ArrayLike, spacing_mm: float) -> Float64:
    """Small triangles between a closed curve and its middle, mm, shape (count, 3, 3): what fills an opening.

    Parameters
    ----------
    rim_mm
        The curve, mm, shape (point_count, 3); seen from its middle, it does not go back.
    spacing_mm
        About the longest way across a triangle, mm, above 0.
    """
    around, middle = _around(np.asarray(rim_mm, dtype=float).reshape(-1, 3), spacing_mm)
    ring_count = max(int(np.ceil(np.linalg.norm(around - middle, axis=1).max() / spacing_mm)), 1)
    part = np.arange(ring_count + 1)[:, None, None] / ring_count
    points = middle + part * (around - middle)
    after = np.roll(points, -1, axis=1)
    outer = np.stack([points[:-1], points[1:], after[1:]], axis=2)
    # The second half of each piece; the innermost ring has none, as it comes to a point.
    inner = np.stack([points[1:-1], after[2:], after[1:-1]], axis=2)
    return np.concatenate([outer.reshape(-1, 3, 3), inner.reshape(-1, 3, 3)])


def points_in(rim_mm: npt.ArrayLike, count: int) -> Float64:
    """Points spread evenly over what a closed curve spans, on a golden spiral, mm, shape (count, 3)."""
    rim = np.asarray(rim_mm, dtype=float).reshape(-1, 3)
    length = float(np.linalg.norm(rim - np.roll(rim, 1, axis=0), axis=1).sum())
    around, middle = _around(rim, max(length / 720.0, 1e-9))
    turns = np.arange(count) * _GOLDEN / (2.0 * pi)
    edge = around[((turns % 1.0) * len(around)).astype(int)]
    part = np.sqrt((np.arange(count) + 0.5) / count)
    spread: Float64 = middle + part[:, None] * (edge - middle)
    return spread


def _around(rim: Float64, spacing_mm: float) -> tuple[Float64, Float64]:
    """The curve's points with others in between, and its middle by length."""
    pieces, lengths = divided(rim, spacing_mm, is_closed=True)
    middle: Float64 = (pieces * lengths[:, None]).sum(axis=0) / lengths.sum()
    steps = np.roll(rim, -1, axis=0) - rim
    counts = np.maximum(np.ceil(np.linalg.norm(steps, axis=1) / spacing_mm).astype(int), 1)
    of = np.repeat(np.arange(len(rim)), counts)
    number = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    around: Float64 = rim[of] + (number / counts[of])[:, None] * steps[of]
    return around, middle
