"""The simulation's side of the servo loop: leads instruments by re-aligned poses, hands over their forces."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import numpy as np

from heartcase.schemas.arguments import whole_number
from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.alignment import Alignment, pose_at, segment_times
from heartcase.simulator.haptics.channel import Channel
from heartcase.simulator.haptics.coupling import TissueSample, stiffness_seen
from heartcase.simulator.haptics.led import LedInstrument
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.haptics.settings import ServoSettings

__all__ = ["FeltInstrument", "TissueSide"]

_KEPT_STATES = 16
"""Last changes of state from which the tissue's stiffness is taken."""


class FeltInstrument:
    """An instrument, the device that leads it, and what its last states say of the tissue.

    Parameters
    ----------
    instrument
        The instrument.
    channel
        The device's channel.
    settings
        Those of the loop.
    """

    def __init__(self, instrument: LedInstrument, channel: Channel, settings: ServoSettings) -> None:
        self.instrument, self.channel, self._settings = instrument, channel, settings
        self._before: tuple[ToolPose, Float64] | None = None
        self._changes: deque[tuple[Float64, Float64]] = deque(maxlen=_KEPT_STATES)
        self._stiffness: Float64 = np.zeros(2)

    def hand_over(self, pose: ToolPose, finished_s: float) -> None:
        """Hand the tissue's load at the present state to the loop, and then see what it says of stiffness.

        Parameters
        ----------
        pose
            Where the tool was led to in it.
        finished_s
            When the state was there, by the clock of the loop, s.
        """
        load = self.instrument.load(pose)
        self.channel.publish_tissue(TissueSample(finished_s, pose, load, self._stiffness))
        if self._before is not None:
            before, load_before = self._before
            self._changes.append((before.gap_to(pose), load - load_before))
            gaps, loads = (np.stack(column) for column in zip(*self._changes, strict=True))
            seen = stiffness_seen(gaps, loads, self._settings.lever_mm)
            self._stiffness = self._stiffness if seen is None else seen
        self._before = pose, load


class TissueSide:
    """Takes the simulation's steps in segments, each in parts; what is felt is handed over after each part.

    Parameters
    ----------
    clock
        The clock of the loop, s.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.felt: list[FeltInstrument] = []
        self._clock = clock
        self._alignment: Alignment | None = None

    def segment(self, part_count: int, take_part: Callable[[], None]) -> None:
        """Take a segment: what lies between two looks at the hands. The surface is shown before or after it.

        Parameters
        ----------
        part_count
            Parts of the segment, at least 1.
        take_part
            Takes the steps of one part; instruments arrive with its end. Parts of a few milliseconds keep forces fresh.

        Raises
        ------
        UsageError
            ``part_count`` is no whole number, or less than 1.
        """
        part_count = whole_number(part_count, "part_count", least=1)
        now_s = self._clock()
        alignment = self._alignment or Alignment(now_s, 0.0, now_s)
        self._alignment, times_s = segment_times(alignment, now_s, part_count)
        histories = [one.channel.tools() for one in self.felt]
        for time_s in times_s.tolist():
            poses = [
                pose_at(history.times_s, history.positions_mm, history.turns, time_s) if len(history.times_s) else None
                for history in histories
            ]
            for one, pose in zip(self.felt, poses, strict=True):
                if pose is not None:
                    one.instrument.follow(pose)
            take_part()
            finished_s = self._clock()
            for one, pose in zip(self.felt, poses, strict=True):
                if pose is not None:
                    one.hand_over(pose, finished_s)
