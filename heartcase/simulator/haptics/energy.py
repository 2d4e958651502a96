"""The energy account: a hand never gets back more than it put in.

A force that comes late gives out energy on a closed path, as does one that is held between two updates. So the loop
keeps account at the hand itself, in what was really put out (passivity observer: Hannaford and Ryu, IEEE Transactions
on Robotics and Automation 18, 2002). It lets no more power out than the account has over a short time: the part of the
force along the motion is cut where it would. The motion of the next update is only guessed; what was given out by
mistake, a limited damping takes back.
"""

from __future__ import annotations

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.settings import ServoSettings

__all__ = ["credit", "within_credit"]

_STILL = 1e-9
"""Speed below which nothing is given out [mm/s]."""


def credit(energy_mj: float, load: Float64, moved: Float64) -> float:
    """The account after an update: what the hand has put in less what it got back, mJ.

    Parameters
    ----------
    energy_mj
        The account before, mJ.
    load
        What was put out since: force on the hand, N, and torque, N mm, shape (2, 3).
    moved
        What the hand did since: way, mm, and rotation vector, rad, shape (2, 3).
    """
    return energy_mj - float(np.vdot(load, moved))


def within_credit(load: Float64, motion: Float64, energy_mj: float, settings: ServoSettings) -> Float64:
    """The load that the account allows.

    Parameters
    ----------
    load
        Wanted: N, N mm, shape (2, 3).
    motion
        Motion of the hand: mm/s, rad/s, shape (2, 3).
    energy_mj
        The account, mJ.
    settings
        How fast the account may be emptied, and what pays it back.

    Returns
    -------
    ndarray
        The load with less along the motion, where the hand's own motion would be driven by more than there is.
    """
    lever = settings.levers
    speed = motion * lever
    square = float(np.vdot(speed, speed))
    if square < _STILL**2:
        return load
    power = float(np.vdot(load, motion))
    surplus = power - max(energy_mj, 0.0) / settings.spending_s
    taken = max(surplus, 0.0) / square
    if energy_mj < 0.0:
        owed = -energy_mj / (square * settings.period_s)
        taken += min(settings.payback_n_s_m * 1e-3, owed)
    return load - taken * speed * lever
