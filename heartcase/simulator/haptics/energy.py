"""The energy account: a hand never gets back more than it put in.

A force that comes late gives out energy on a closed path, as does one that is held between two updates. So the loop
keeps account at the hand itself, in what was really put out (passivity observer: Hannaford and Ryu, IEEE Transactions
on Robotics and Automation 18, 2002). It lets no more power out than the account has over a short time: the part of the
force along the motion is cut where it would. The motion of the next update is only guessed; what was given out by
mistake, a limited damping takes back, and as a hand may rest before it has, a thousandth of what it puts in is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.settings import ServoSettings

__all__ = ["KEPT", "STILL_MM_S", "Account", "within_credit"]

KEPT = 1e-3
"""Part of what a hand puts in that is not given back [1]."""
STILL_MM_S = 1e-9
"""Speed below which nothing is given out, levers for rotations included, mm/s."""


@dataclass(frozen=True)
class Account:
    """What a hand has put in and got back."""

    put_in_mj: float = 0.0
    """Work of the hand against what was put out, mJ."""
    got_back_mj: float = 0.0
    """Work that was done on the hand, mJ."""

    @property
    def energy_mj(self) -> float:
        """What the hand has put in less what it got back, mJ."""
        return self.put_in_mj - self.got_back_mj

    @property
    def credit_mj(self) -> float:
        """What may still be given back, mJ: a thousandth of what was put in is kept, for what is given by mistake."""
        return (1.0 - KEPT) * self.put_in_mj - self.got_back_mj

    def after(self, load: Float64, moved: Float64) -> Account:
        """The account after an update.

        Parameters
        ----------
        load
            What was put out since: force on the hand, N, and torque, N mm, shape (2, 3).
        moved
            What the hand did since: way, mm, and rotation vector, rad, shape (2, 3).
        """
        work = float(np.vdot(load, moved))
        return Account(self.put_in_mj + max(-work, 0.0), self.got_back_mj + max(work, 0.0))


def within_credit(load: Float64, motion: Float64, credit_mj: float, settings: ServoSettings) -> Float64:
    """The load that the account allows.

    Parameters
    ----------
    load
        Wanted: N, N mm, shape (2, 3).
    motion
        Motion of the hand: mm/s, rad/s, shape (2, 3).
    credit_mj
        What may be given back, mJ.
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
    if square < STILL_MM_S**2:
        return load
    power = float(np.vdot(load, motion))
    surplus = power - max(credit_mj, 0.0) / settings.spending_s
    taken = max(surplus, 0.0) / square
    if credit_mj < 0.0:
        owed = -credit_mj / (square * settings.period_s)
        taken += min(settings.payback_n_s_m * 1e-3, owed)
    return load - taken * speed * lever
