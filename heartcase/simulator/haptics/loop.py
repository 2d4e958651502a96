"""One update of the servo loop: from the device's pose and the newest state of the tissue to a force. No clock here.

Plain NumPy, the oracle of :mod:`heartcase.simulator.haptics.loop_kernels`, which the loop itself runs.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.coupling import TissueSample, Tool, advance_tool
from heartcase.simulator.haptics.device import DeviceReading
from heartcase.simulator.haptics.energy import Account, within_credit
from heartcase.simulator.haptics.limits import followed, limited, part_at_age
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.haptics.settings import ServoSettings

__all__ = ["SECONDS_MOST", "ServoState", "first_state", "servo_update"]

SECONDS_MOST = 0.005
"""Longest time that one update of the tool reckons with, s: a loop that was held up does not leap."""


@dataclass(frozen=True)
class ServoState:
    """What the loop keeps from one update to the next."""

    time_s: float
    """When it was, by the clock of the loop, s."""
    hand: ToolPose
    """Where the device was."""
    tool: Tool
    """The tool behind the coupling."""
    within: Float64
    """Load before the fade: N, N mm, shape (2, 3)."""
    load: Float64
    """What is put out: force on the hand, N, and torque, N mm, LPS axes, shape (2, 3)."""
    part: float = 0.0
    """Part of the force that is put out: less than one where the tissue's state is old [1]."""
    account: Account = field(default_factory=Account)
    """What the hand has put in and got back."""
    earlier: Float64 = field(default_factory=lambda: np.zeros((2, 3)))
    """What was put out before ``load``, until that was due: N, N mm, shape (2, 3)."""


def first_state(time_s: float, reading: DeviceReading) -> ServoState:
    """The loop before its first update: nothing is put out."""
    hand = reading.pose
    return ServoState(time_s, hand, Tool.resting(hand), np.zeros((2, 3)), np.zeros((2, 3)))


def servo_update(
    state: ServoState, time_s: float, reading: DeviceReading, tissue: TissueSample | None, settings: ServoSettings
) -> ServoState:
    """The state of the loop one update later; its ``load`` is what the device shall put out now.

    Parameters
    ----------
    state
        The state before.
    time_s
        The time now, s.
    reading
        What the device says now.
    tissue
        The newest state of the tissue, or None.
    settings
        Coupling, limits, fade.
    """
    seconds = max(time_s - state.time_s, 0.0)
    hand = reading.pose
    moved = state.hand.gap_to(hand)
    waited = min(settings.ahead_s, seconds) / seconds if seconds > 0.0 else 0.0
    account = state.account.after(state.load + waited * (state.earlier - state.load), moved)
    age_s = None if tissue is None else time_s - tissue.finished_s
    part = part_at_age(state.part, age_s, seconds, settings)
    dt = min(max(seconds, 0.1 * settings.period_s), SECONDS_MOST)
    # A state that is too old to be felt does not hold the tool either: it comes back to the hand.
    felt = tissue if part > 0.0 else None
    tool, pull = advance_tool(state.tool, hand, reading.motion, felt, settings, seconds=dt)
    wanted = limited(within_credit(pull, moved / dt, account.credit_mj, settings), settings)
    within = followed(state.within, wanted, seconds, settings)
    return ServoState(time_s, hand, tool, within, part * within, part, account, state.load)
