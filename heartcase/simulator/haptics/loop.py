"""One update of the servo loop: from the device's pose and the newest state of the tissue to a force. No clock here.

``servo_update`` is it in plain NumPy, the oracle; ``LoopNumbers`` the same by one kernel, which the loop itself runs.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.coupling import TissueSample, Tool, advance_tool
from heartcase.simulator.haptics.device import DeviceReading
from heartcase.simulator.haptics.energy import Account, within_credit
from heartcase.simulator.haptics.limits import followed, limited, part_at_age
from heartcase.simulator.haptics.loop_kernels import (
    ACCOUNT,
    EARLIER,
    HAND,
    LOAD,
    LOOP_WIDTH,
    MOTION,
    PART,
    TIME,
    TOOL,
    WITHIN,
    advance_loop,
)
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.haptics.settings import SECONDS_MOST, ServoSettings

__all__ = ["LoopNumbers", "ServoState", "first_state", "servo_update"]


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
    state: ServoState,
    time_s: float,
    reading: DeviceReading,
    tissue: TissueSample | None,
    settings: ServoSettings,
    *,
    waited_s: float | None = None,
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
    waited_s
        Time from the update before until what it gave was put out, s; the settings' when left out.
    """
    seconds = max(time_s - state.time_s, 0.0)
    hand = reading.pose
    moved = state.hand.gap_to(hand)
    waited_s = settings.ahead_s if waited_s is None else waited_s
    waited = min(waited_s, seconds) / seconds if seconds > 0.0 else 0.0
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


class LoopNumbers:
    """A loop, from its first reading on: nothing is put out at first.

    Parameters
    ----------
    time_s
        When it begins, by the clock of the loop, s.
    reading
        What the device says then.
    settings
        Coupling, limits, fade.
    """

    def __init__(self, time_s: float, reading: DeviceReading, settings: ServoSettings) -> None:
        self._settings = _setting_numbers(settings)
        self._hand = _pose_numbers(reading.pose)
        self._motion, self._tissue = np.zeros(6), np.zeros(21)
        self._ahead_s = settings.ahead_s
        self._numbers = np.zeros(LOOP_WIDTH)
        self._numbers[TIME] = time_s
        self._numbers[HAND:TOOL] = self._numbers[TOOL:MOTION] = self._hand
        self.pose: Float64 = self._numbers[TOOL:MOTION]
        """Where the tool behind the coupling is: position, LPS mm, and rotation row by row, shape (12,)."""
        self.load: Float64 = self._numbers[LOAD:PART].reshape(2, 3)
        """What is put out: force on the hand, N, and torque, N mm, LPS axes, shape (2, 3)."""

    @staticmethod
    def prepare() -> None:
        """Load the kernel, or compile it, before time counts."""
        loop = LoopNumbers(0.0, DeviceReading(ToolPose.at(np.zeros(3))), ServoSettings())
        loop.update(0.0, DeviceReading(ToolPose.at(np.zeros(3))), None)

    def update(
        self, time_s: float, reading: DeviceReading, tissue: Float64 | None, waited_s: float | None = None
    ) -> None:
        """Take the loop to its next update.

        Parameters
        ----------
        time_s
            The time now, s.
        reading
            What the device says now.
        tissue
            The newest state of the tissue as numbers (``TissueSample.row``), shape (21,), or None.
        waited_s
            Time from the update before until what it gave was put out, s; the settings' when left out.
        """
        self._hand[:3] = reading.pose.position_mm
        self._hand[3:] = reading.pose.turn.ravel()
        # Into arrays of its own: of others numba might compile the kernel anew, in the middle of a scene.
        self._motion.reshape(2, 3)[:] = reading.motion
        if tissue is not None:
            self._tissue[:] = tissue
        waited = self._ahead_s if waited_s is None else waited_s
        given = (self._hand, self._motion, tissue is not None, self._tissue)
        advance_loop(self._numbers, float(time_s), float(waited), *given, self._settings)

    @property
    def part(self) -> float:
        """Part of the force that is put out [1]."""
        return float(self._numbers[PART])

    @property
    def energy_mj(self) -> float:
        """What the hand has put in less what it got back, mJ."""
        return float(self._numbers[ACCOUNT] - self._numbers[ACCOUNT + 1])

    @property
    def state(self) -> ServoState:
        """The loop now, as the oracle has it."""
        numbers = self._numbers.copy()
        return ServoState(
            time_s=float(numbers[TIME]),
            hand=_pose_of(numbers[HAND:TOOL]),
            tool=Tool(_pose_of(numbers[TOOL:MOTION]), numbers[MOTION:WITHIN].reshape(2, 3)),
            within=numbers[WITHIN:LOAD].reshape(2, 3),
            load=numbers[LOAD:PART].reshape(2, 3),
            part=float(numbers[PART]),
            account=Account(*numbers[ACCOUNT:EARLIER].tolist()),
            earlier=numbers[EARLIER:].reshape(2, 3),
        )


def _pose_numbers(pose: ToolPose) -> Float64:
    return np.concatenate([pose.position_mm, pose.turn.ravel()])


def _pose_of(numbers: Float64) -> ToolPose:
    return ToolPose(numbers[:3], numbers[3:].reshape(3, 3))


def _setting_numbers(settings: ServoSettings) -> Float64:
    """What the kernel reads, in its order: times, the account's damping, then pairs for force and torque."""
    fade = (settings.full_for_s, settings.none_from_s, settings.rise_s)
    times = (settings.period_s, *fade, settings.spending_s)
    coupling = (settings.stiffness, settings.damping, settings.mass, settings.tissue_stiffness)
    pairs = (*coupling, settings.levers, settings.limits, settings.slew)
    return np.array([*times, settings.payback_n_s_m * 1e-3, *np.concatenate(pairs).ravel()])
