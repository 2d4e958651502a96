"""Settings of the servo loop, and what is known of its stability.

The tool in the tissue is a small mass behind a spring and a damper from the hand's pose: a virtual coupling (Colgate,
Stanley and Brown, IROS 1995). The mass is such that it is critically damped: m = K / w^2, B = 2 K / w with the
bandwidth w. Two limits follow.

*Between hand and coupling.* A spring K with a damper B, sampled with the period T and held, whose force comes a time t
after its sample, gives out no energy at the frequency w where the device's own damping b is at least
K T / 2 sin(w T / 2 + w t) / sin(w T / 2) - B cos(w T + w t) (Colgate and Schenkel, J. Robotic Systems 14, 1997, with
their H times exp(-i w t)). So at any frequency b > K (T / 2 + t) + B is enough
(:attr:`ServoSettings.device_damping_n_s_m`), and below :attr:`ServoSettings.passive_below_hz` nothing is asked of the
device.

*Between coupling and tissue*, whose forces come late. With the tissue's stiffness K_t, of which K_l is reckoned with at
once, the critically damped tool is stable at any delay where K_t < K + 2 K_l: the loop's gain
|K_t - K_l| / |K + K_l + m (i w)^2 + B i w| is then below one.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from math import cos, pi, sin

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import Problem, SimulationError

__all__ = ["SECONDS_MOST", "STALL_S", "ServoSettings"]

STALL_S = 0.020
"""Time after the last state of the tissue by which no force may be left, s."""
SECONDS_MOST = 0.005
"""Longest time that one update of the tool reckons with, s: a loop that was held up does not leap."""


@dataclass(frozen=True)
class ServoSettings:
    """What the servo loop does with the state of the tissue.

    Raises
    ------
    SimulationError
        Numbers are out of range: all of them.
    """

    rate_hz: float = 1000.0
    """Updates of the force, 1/s."""
    ahead_s: float = 0.0002
    """t: time before an update is due at which it is begun, s. A force that is ready waits: updates come evenly."""
    stiffness_n_m: float = 400.0
    """K: stiffness of the virtual coupling, N/m."""
    turning_stiffness_n_mm: float = 500.0
    """The same for rotation, N mm/rad."""
    bandwidth_hz: float = 100.0
    """Swing of the tool behind the coupling, which is critically damped, 1/s."""
    tissue_stiffness_n_m: float = 3000.0
    """Most of the tissue's stiffness that is reckoned with before its next state comes, N/m."""
    force_limit_n: float = 3.3
    """Largest force, N."""
    torque_limit_n_mm: float = 100.0
    """Largest torque, N mm."""
    slew_n_s: float = 500.0
    """Fastest change of the force while the tissue moves, N/s."""
    lever_mm: float = 30.0
    """Length of a hand's lever: what makes rotations and torques comparable with ways and forces, mm."""
    full_for_s: float = 0.012
    """Age of the tissue's state up to which the force is whole, s."""
    none_from_s: float = 0.018
    """Age of the tissue's state from which there is no force, s; with one more update at most 20 ms."""
    rise_s: float = 0.100
    """Time in which the force comes back after a stall, s."""
    spending_s: float = 0.020
    """Shortest time in which all the energy may be given back that a hand has put in, s."""
    payback_n_s_m: float = 10.0
    """Largest damping that takes back energy which was given out by mistake, N s/m."""

    def __post_init__(self) -> None:
        problems = [
            Problem(field.name, f"must be above 0 and finite (found {getattr(self, field.name)})")
            for field in fields(self)
            if not 0.0 < getattr(self, field.name) < np.inf
        ]
        if not problems:
            if self.ahead_s > 0.5 * self.period_s:
                problems.append(Problem("ahead_s", f"must be at most half of the period of {self.period_s:.4g} s"))
            latest_s = STALL_S - self.period_s - self.ahead_s
            if not self.full_for_s < self.none_from_s <= latest_s:
                limit = f"{latest_s:.4g}"
                problems.append(Problem("none_from_s", f"must be above full_for_s and at most {limit} s"))
            if self.bandwidth_hz > self.rate_hz / 4.0:
                problems.append(Problem("bandwidth_hz", f"must be at most a quarter of the rate of {self.rate_hz:g}/s"))
        if problems:
            raise SimulationError(problems)

    @property
    def period_s(self) -> float:
        """T: time between two updates, s."""
        return 1.0 / self.rate_hz

    @cached_property
    def stiffness(self) -> Float64:
        """Stiffness of the coupling: N/mm, N mm/rad, shape (2, 1)."""
        return np.array([[self.stiffness_n_m * 1e-3], [self.turning_stiffness_n_mm]])

    @cached_property
    def damping(self) -> Float64:
        """B, critical: N s/mm, N mm s/rad, shape (2, 1)."""
        return self.stiffness * (2.0 / (2.0 * pi * self.bandwidth_hz))

    @cached_property
    def mass(self) -> Float64:
        """Mass and inertia of the tool: N s2/mm, N mm s2/rad, shape (2, 1)."""
        return self.stiffness / (2.0 * pi * self.bandwidth_hz) ** 2

    @cached_property
    def tissue_stiffness(self) -> Float64:
        """Most of the tissue's stiffness that is reckoned with: N/mm, N mm/rad, shape (2, 1)."""
        most = self.tissue_stiffness_n_m * 1e-3
        return np.array([[most], [most * self.lever_mm**2]])

    @cached_property
    def limits(self) -> Float64:
        """Largest force and torque: N, N mm, shape (2, 1)."""
        return np.array([[self.force_limit_n], [self.torque_limit_n_mm]])

    @cached_property
    def slew(self) -> Float64:
        """Fastest change of force and torque: N/s, N mm/s, shape (2, 1)."""
        return self.slew_n_s * self.levers

    @cached_property
    def levers(self) -> Float64:
        """What a force of 1 N, and a torque that a hand feels as much, are: N, N mm, shape (2, 1)."""
        return np.array([[1.0], [self.lever_mm]])

    @property
    def device_damping_n_s_m(self) -> float:
        """Damping of its own, N s/m, with which a device is passive at any frequency: K (T / 2 + t) + B."""
        return self.stiffness_n_m * (0.5 * self.period_s + self.ahead_s) + float(self.damping[0, 0]) * 1e3

    @property
    def passive_below_hz(self) -> float:
        """Frequency up to which the coupling gives out no energy with a device that has no damping, 1/s; 0 if none."""
        lag, damping = 1.0 + 2.0 * self.ahead_s / self.period_s, float(self.damping[0, 0]) * 1e3
        spring = 0.5 * self.stiffness_n_m * self.period_s

        def needed(half: float) -> float:
            return spring * sin(lag * half) / sin(half) - damping * cos((1.0 + lag) * half)

        low, high = 1e-6, pi / 2.0
        if needed(low) >= 0.0:
            return 0.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if needed(middle) < 0.0 else (low, middle)
        return low / (pi * self.period_s)
