"""A device that plays a hand that was recorded or made up: for tests, benchmarks and replays without a hand."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import Problem, UsageError
from heartcase.simulator.haptics.device import DeviceReading
from heartcase.simulator.haptics.poses import ToolPose, rotation_between, turn_by

__all__ = ["TrajectoryDevice"]


class TrajectoryDevice:
    """Poses over time, in straight lines between them; it stays at the last.

    Parameters
    ----------
    times_s
        Times of the poses since the loop began, ascending, s, shape (count,).
    positions_mm
        Positions, LPS mm, shape (count, 3).
    rotations_rad
        Rotation vectors, LPS axes, rad, shape (count, 3); no rotation when left out.
    closed
        Whether the first button is down from each time on, shape (count,); never when left out.
    keeps_written
        Whether what is written is kept in ``written``.

    Raises
    ------
    UsageError
        Shapes do not fit, times do not ascend, or a number is not finite: all of it.
    """

    def __init__(
        self,
        times_s: npt.ArrayLike,
        positions_mm: npt.ArrayLike,
        rotations_rad: npt.ArrayLike | None = None,
        closed: npt.ArrayLike | None = None,
        *,
        keeps_written: bool = False,
    ) -> None:
        self.times_s = np.asarray(times_s, dtype=float)
        self.positions_mm = np.asarray(positions_mm, dtype=float)
        count = self.times_s.size
        rotations = np.zeros((count, 3)) if rotations_rad is None else np.asarray(rotations_rad, dtype=float)
        self.closed = np.zeros(count, bool) if closed is None else np.asarray(closed, dtype=bool)
        problems = []
        if self.times_s.shape != (count,) or not count or (np.diff(self.times_s) <= 0).any():
            problems.append(Problem("times_s", "give at least one time, each later than the one before"))
        for name, values in (("positions_mm", self.positions_mm), ("rotations_rad", rotations)):
            if values.shape != (count, 3):
                problems.append(Problem(name, f"give three numbers for each of the {count} times"))
            elif not np.isfinite(values).all():
                problems.append(Problem(name, "every number must be finite"))
        if self.closed.shape != (count,):
            problems.append(Problem("closed", f"give one value for each of the {count} times"))
        if problems:
            raise UsageError(problems)
        self.turns = np.stack([turn_by(vector) for vector in rotations])
        pairs = zip(self.turns[:-1], self.turns[1:], strict=True)
        turned = np.array([rotation_between(one, other) for one, other in pairs]).reshape(-1, 3)
        self._ways = np.stack([np.diff(self.positions_mm, axis=0), turned], axis=1)
        self._motions = self._ways / np.diff(self.times_s)[:, None, None]
        self.written: list[tuple[Float64, Float64]] | None = [] if keeps_written else None

    def read(self, time_s: float) -> DeviceReading:
        """The pose at a time since the loop began, s."""
        number = int(self.times_s.searchsorted(time_s, side="right")) - 1
        before = max(number, 0)
        buttons = (bool(self.closed[before]),)
        start = ToolPose(self.positions_mm[before], self.turns[before])
        if number < 0 or before == len(self.times_s) - 1:
            return DeviceReading(start, buttons=buttons)
        way, motion = self._ways[before], self._motions[before]
        length = self.times_s[before + 1] - self.times_s[before]
        return DeviceReading(start.moved_by((time_s - self.times_s[before]) / length * way), motion, buttons)

    def write(self, force_n: Float64, torque_n_mm: Float64) -> None:
        """Keep what was written, where that is wanted: there is no hand."""
        if self.written is not None:
            self.written.append((force_n, torque_n_mm))

    def close(self) -> None:
        """Nothing is to be given back."""
