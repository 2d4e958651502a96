"""How evenly a loop ran: figures of the times of its updates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float64

__all__ = ["Jitter", "jitter"]


@dataclass(frozen=True)
class Jitter:
    """Figures of a loop that ran."""

    update_count: int
    """Updates."""
    in_time: float
    """Part of the updates that came within the allowed time after the one before [1]."""
    interval_ms: tuple[float, float, float]
    """Time between two updates: median, 99.9% and longest, ms."""
    latency_ms: tuple[float, float, float]
    """From a state of the tissue to the first force from it: median, 99.9% and longest, ms; nan where none came."""


def jitter(times_s: Float64, sample_numbers: Float64, finished_s: Float64, *, allowed_s: float = 1.2e-3) -> Jitter:
    """Figures of the updates of a loop.

    Parameters
    ----------
    times_s
        When each force was written, s, ascending, shape (count,), at least two.
    sample_numbers
        Number of the state of the tissue that it came from, 0 before the first, shape (count,).
    finished_s
        When that state was there, s, shape (count,).
    allowed_s
        Longest time between two updates that counts as in time, s.
    """
    intervals = np.diff(times_s)
    is_first = (np.diff(sample_numbers, prepend=0.0) > 0) & (sample_numbers > 0)
    latency = times_s[is_first] - finished_s[is_first]
    return Jitter(
        update_count=len(times_s),
        in_time=float((intervals <= allowed_s).mean()),
        interval_ms=_figures(intervals),
        latency_ms=_figures(latency),
    )


def _figures(seconds: Float64) -> tuple[float, float, float]:
    if not len(seconds):
        return (float("nan"),) * 3
    median, late, longest = np.percentile(seconds, [50.0, 99.9, 100.0]) * 1e3
    return float(median), float(late), float(longest)
