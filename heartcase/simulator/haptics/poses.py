"""Where a tool is and how it is turned, and small rotations."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, sin, sqrt

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import UsageError

__all__ = ["NEARLY_HALF_RAD", "SMALL_RAD", "ToolPose", "rotation_between", "turn_by", "vector_of"]

SMALL_RAD = 1e-8
"""Angle below which the first term of a series is exact in float64, rad."""
NEARLY_HALF_RAD = 1e-4
"""Distance from half a turn within which the axis is taken from the symmetric part, rad."""


@dataclass(frozen=True)
class ToolPose:
    """A rigid pose."""

    position_mm: Float64
    """Position, LPS mm, shape (3,)."""
    turn: Float64
    """Rotation from the tool's own axes to LPS axes, shape (3, 3)."""

    @classmethod
    def at(cls, position_mm: npt.ArrayLike) -> ToolPose:
        """A pose that is not turned.

        Raises
        ------
        UsageError
            The position is not three finite numbers.
        """
        try:
            position = np.asarray(position_mm, dtype=float)
        except (TypeError, ValueError):
            position = np.empty(0)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise UsageError(f"must be three finite numbers (found {position_mm!r})", place="position_mm")
        return cls(position, np.eye(3))

    def gap_to(self, other: ToolPose) -> Float64:
        """What leads from this pose to another: way, mm, and rotation vector, rad, LPS axes, shape (2, 3)."""
        gap = np.empty((2, 3))
        gap[0] = other.position_mm - self.position_mm
        gap[1] = rotation_between(self.turn, other.turn)
        return gap

    def moved_by(self, gap: Float64) -> ToolPose:
        """The pose at the end of a way, mm, and a rotation vector, rad, LPS axes, shape (2, 3)."""
        return ToolPose(self.position_mm + gap[0], turn_by(gap[1]) @ self.turn)


def rotation_between(start: Float64, end: Float64) -> Float64:
    """Rotation vector, rad, LPS axes, that turns one orientation into another, shape (3,)."""
    return vector_of(end @ start.T)


def turn_by(vector: Float64) -> Float64:
    """The rotation matrix of a rotation vector, rad (Rodrigues), shape (3, 3)."""
    x, y, z = vector.tolist()
    angle = sqrt(x * x + y * y + z * z)
    if angle < SMALL_RAD:
        return np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
    s, c = sin(angle) / angle, (1.0 - cos(angle)) / (angle * angle)
    square = angle * angle
    return np.array(
        [
            [1.0 + c * (x * x - square), c * x * y - s * z, c * x * z + s * y],
            [c * x * y + s * z, 1.0 + c * (y * y - square), c * y * z - s * x],
            [c * x * z - s * y, c * y * z + s * x, 1.0 + c * (z * z - square)],
        ]
    )


def vector_of(turn: Float64) -> Float64:
    """The rotation vector of a rotation matrix, rad, at most half a turn long, shape (3,)."""
    (a, b, c), (d, e, f), (g, h, i) = turn.tolist()
    twice_sine = np.array([h - f, c - g, d - b])
    angle = atan2(sqrt(float(twice_sine @ twice_sine)), a + e + i - 1.0)
    if angle < SMALL_RAD:
        return twice_sine / 2.0
    if angle < np.pi - NEARLY_HALF_RAD:
        return twice_sine * (angle / (2.0 * sin(angle)))
    # Near half a turn the sine says little: the axis is the largest column of the symmetric part.
    symmetric = (turn + turn.T) / 2.0 - cos(angle) * np.eye(3)
    axis = symmetric[:, int(np.argmax(np.diag(symmetric)))]
    axis = axis / np.linalg.norm(axis)
    return axis * (angle if axis @ twice_sine >= 0.0 else -angle)
