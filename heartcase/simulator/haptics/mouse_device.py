"""A mouse as a device: a pointer on a plane through the tissue. It has no motor: the force is there to be shown.

No window here: whoever has one says where the pointer is (:class:`MouseFeed`), from any process.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import UsageError
from heartcase.simulator.haptics.device import DeviceReading
from heartcase.simulator.haptics.hand_over import Ring, shared_memory
from heartcase.simulator.haptics.poses import ToolPose

__all__ = ["MouseDevice", "MouseFeed", "PointerPlane"]

_ROWS, _WIDTH = 4, 4


@dataclass(frozen=True)
class PointerPlane:
    """A plane on which a pointer moves, mostly that of the screen through the point that was clicked on.

    Raises
    ------
    UsageError
        The two directions are not of unit length and square to each other, or the scale is not above 0.
    """

    origin_mm: tuple[float, float, float]
    """Where the pointer is at (0, 0), LPS mm."""
    across: tuple[float, float, float]
    """Direction in which the pointer's x grows, LPS axes, of unit length."""
    down: tuple[float, float, float]
    """Direction in which its y grows, LPS axes, of unit length."""
    mm_per_pixel: float
    """Way of a pixel, mm."""

    def __post_init__(self) -> None:
        axes = np.array([self.across, self.down], dtype=float)
        if not np.allclose(axes @ axes.T, np.eye(2), atol=1e-6) or not 0.0 < self.mm_per_pixel < np.inf:
            raise UsageError("give two directions of unit length at right angles, and a scale above 0", place="plane")

    def turn(self) -> Float64:
        """The plane's axes, the last away from who looks at it, in columns, shape (3, 3)."""
        return np.stack([self.across, self.down, np.cross(self.across, self.down)], axis=1).astype(float)

    def point_mm(self, x: float, y: float, depth_mm: float) -> Float64:
        """The place of a pointer, LPS mm, shape (3,).

        Parameters
        ----------
        x, y
            Place on the window, pixels.
        depth_mm
            How far behind the plane, mm.
        """
        pixels = np.array([x * self.mm_per_pixel, y * self.mm_per_pixel, depth_mm])
        place: Float64 = np.asarray(self.origin_mm, dtype=float) + self.turn() @ pixels
        return place


class MouseFeed:
    """Where the pointer is, as the window says it; handed to :class:`MouseDevice` in whatever process that is."""

    def __init__(self, memory: Any | None = None) -> None:
        self.memory = shared_memory(_ROWS, _WIDTH) if memory is None else memory
        self._ring = Ring(self.memory, _ROWS, _WIDTH)

    def pointer(self, x: float, y: float, *, depth_mm: float = 0.0, is_down: bool = False) -> None:
        """Say where the pointer is now.

        Parameters
        ----------
        x, y
            Place on the window, pixels.
        depth_mm
            How far the wheel has moved the tip behind the plane, mm.
        is_down
            Whether the button is down.
        """
        self._ring.write(np.array([x, y, depth_mm, float(is_down)]))

    def latest(self) -> tuple[float, float, float, bool]:
        """Pointer, depth and button as they were said last; (0, 0), 0, up before."""
        found = self._ring.latest()
        x, y, depth_mm, is_down = (0.0, 0.0, 0.0, 0.0) if found is None else found[1].tolist()
        return x, y, depth_mm, bool(is_down)


class MouseDevice:
    """A tip that follows the pointer without leaps: a window says 60 times a second where it is, a loop asks 1,000.

    Parameters
    ----------
    memory
        Memory of the :class:`MouseFeed` that says where the pointer is.
    plane
        Where the pointer moves.
    follow_s
        Time constant with which the tip follows, critically damped, s.
    """

    def __init__(self, memory: Any, plane: PointerPlane, *, follow_s: float = 0.02) -> None:
        if not 0.0 < follow_s < np.inf:
            raise UsageError("the tip must follow in a time above 0 s", place="follow_s")
        self.plane = plane
        self.follow_s = follow_s
        self.force_n: Float64 = np.zeros(3)
        self._feed = MouseFeed(memory)
        self._turn = plane.turn()
        self._before: tuple[float, Float64, Float64] | None = None

    def read(self, time_s: float) -> DeviceReading:
        """The tip now, turned as the plane is."""
        x, y, depth_mm, is_down = self._feed.latest()
        target = self.plane.point_mm(x, y, depth_mm)
        if self._before is None:
            self._before = time_s, target, np.zeros(3)
        before_s, place, velocity = self._before
        dt, rate = max(time_s - before_s, 0.0), 1.0 / self.follow_s
        # The exact motion of a critically damped spring towards the pointer.
        away, decay = place - target, np.exp(-rate * dt)
        slope = velocity + rate * away
        place = target + (away + slope * dt) * decay
        velocity = (velocity - rate * slope * dt) * decay
        self._before = time_s, place, velocity
        return DeviceReading(ToolPose(place, self._turn), np.stack([velocity, np.zeros(3)]), (is_down,))

    def write(self, force_n: Float64, torque_n_mm: Float64) -> None:
        """Keep the force, so that it can be shown."""
        self.force_n = force_n

    def close(self) -> None:
        """Nothing is to be given back."""
