"""Steps that come late and unevenly, and a hand that moves evenly: the re-alignment in time of thesis 10.3.

A segment is what the simulation does between two looks at the hand: some steps, and the showing of a surface. In it the
hand moves on, but no step can take it in; a step that took the pose of its own moment would see the hand leap. So poses
are kept with their times, and the steps of a segment take those at even intervals of the time that has gone by, one
segment before: what the thesis's figure 10.5 draws. The average length of a segment is followed, and what is left over
by uneven ones is made up little by little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.poses import ToolPose

__all__ = ["Alignment", "pose_at", "segment_times"]

_MEMORY = 0.1
"""Part of a new length in the average."""
_CATCHING_UP = 0.2
"""Part of what waits too long that a segment makes up."""
_WAITING = 1.25
"""Lengths of a segment for which poses wait: above one, so that a long segment finds some left."""
_LOST_S = 0.25
"""Waiting from which on the hand's way is left out, s: the simulation stood still."""


@dataclass(frozen=True)
class Alignment:
    """How far the simulation has come in the hand's time."""

    started_s: float
    """When the last segment began, s."""
    length_s: float
    """Average length of a segment, s."""
    until_s: float
    """Time of the hand that the last step took, s."""


def segment_times(before: Alignment, now_s: float, part_count: int) -> tuple[Alignment, Float64]:
    """Times of the hand that the parts of a segment take, which begins now.

    Parameters
    ----------
    before
        How far the simulation had come.
    now_s
        The time now, s.
    part_count
        Parts of the segment, each some steps; at least 1.

    Returns
    -------
    alignment
        How far it will have come.
    times_s
        Even times, none after now, shape (part_count,), s.
    """
    length_s = before.length_s + _MEMORY * (now_s - before.started_s - before.length_s)
    start_s = before.until_s
    waiting_s = now_s - start_s
    if waiting_s > max(_LOST_S, 4.0 * length_s):
        start_s = now_s - _WAITING * length_s
        waiting_s = now_s - start_s
    way_s = min(max(length_s + _CATCHING_UP * (waiting_s - _WAITING * length_s), 0.0), waiting_s)
    times_s = start_s + way_s * np.arange(1, part_count + 1) / part_count
    return Alignment(now_s, length_s, start_s + way_s), times_s


def pose_at(times_s: Float64, positions_mm: Float64, turns: Float64, time_s: float) -> ToolPose:
    """The pose at a time, in a straight line between those before and after; the first or the last outside.

    Parameters
    ----------
    times_s
        Ascending times, s, shape (count,), at least one.
    positions_mm, turns
        Poses at these times, shape (count, 3) and (count, 3, 3).
    time_s
        When, s.
    """
    after = int(np.searchsorted(times_s, time_s))
    if after == 0 or after == len(times_s):
        place = min(after, len(times_s) - 1)
        return ToolPose(positions_mm[place], turns[place])
    before = after - 1
    start = ToolPose(positions_mm[before], turns[before])
    part = (time_s - times_s[before]) / (times_s[after] - times_s[before])
    return start.moved_by(part * start.gap_to(ToolPose(positions_mm[after], turns[after])))
