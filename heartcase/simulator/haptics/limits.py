"""Limits of what is put out: size, change, and the fade of a force whose tissue stands still."""

from __future__ import annotations

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.settings import ServoSettings

__all__ = ["followed", "limited", "part_at_age"]


def limited(load: Float64, settings: ServoSettings) -> Float64:
    """The load, force and torque each made shorter where it is beyond its limit, in its own direction; (2, 3)."""
    size = np.sqrt(np.einsum("ij,ij->i", load, load))[:, None]
    limits = settings.limits
    shorter: Float64 = load * (limits / np.maximum(size, limits))
    return shorter


def followed(before: Float64, wanted: Float64, seconds: float, settings: ServoSettings) -> Float64:
    """What is put out on the way from one load to another: no faster than the slew, force and torque each; (2, 3)."""
    change = wanted - before
    size = np.sqrt(np.einsum("ij,ij->i", change, change))[:, None]
    most = settings.slew * seconds
    # Where no time has passed and nothing is to change both are zero.
    reached: Float64 = before + change * (most / np.maximum(np.maximum(size, most), np.finfo(float).tiny))
    return reached


def part_at_age(part: float, age_s: float | None, seconds: float, settings: ServoSettings) -> float:
    """Part of the force that is put out.

    Parameters
    ----------
    part
        The part one update before [1].
    age_s
        Age of the tissue's state, s; None while there is none.
    seconds
        Time since the last update, s.
    settings
        When the force fades and how fast it comes back.

    Returns
    -------
    float
        From 1 to 0 between the two ages, at once; back to 1 only as slowly as it may rise.
    """
    if age_s is None:
        return 0.0
    fading = (settings.none_from_s - age_s) / (settings.none_from_s - settings.full_for_s)
    return min(max(fading, 0.0), part + seconds / settings.rise_s, 1.0)
