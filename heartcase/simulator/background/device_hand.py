"""A haptic device that leads a hand in a live session: what it does are commands, and it feels what they come to."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import CloseGrab, Done, LeadGrab, MoveProbe, OpenGrab
from heartcase.simulator.haptics.channel import Felt
from heartcase.simulator.haptics.led import LedGrab
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.haptics.servo import HapticServo
from heartcase.simulator.haptics.tissue_side import FeltInstrument, TissueSide
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.probe import Probe
from heartcase.simulator.instruments.wrench import Wrench
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.live.live import Live
from heartcase.simulator.session.frame import Frame, Refusal
from heartcase.simulator.session.operating_session import OperatingSession

__all__ = ["DeviceHand", "ShownDevice"]

PART_S = 0.004
"""Simulated time between two states that the device feels, s."""
PARTS_MOST = 12
_CLOSING = 1
"""Bit of the button that closes the hand."""
_DETACH_S = 10.0


@dataclass(frozen=True)
class ShownDevice:
    """What is shown of a device."""

    position_mm: Float64
    """Where its tip is, LPS mm, shape (3,)."""
    force_n: Float64
    """Force on the user's hand, N, LPS axes, shape (3,)."""
    part: float
    """Part of the force that is put out [1]: below one where the steps come too slowly."""
    holds: str | None
    """Name of the hand that it leads in the tissue; None while it holds nothing."""


class _Commands:
    """A session as what a device leads: what is led there become commands, so that they are in its history."""

    def __init__(self, session: OperatingSession) -> None:
        self._session = session
        self.waiting: list[Done] = []

    @property
    def model(self) -> LatticeModel:
        """The lattice now."""
        return self._session.simulation.model

    def lead(self, grab: Grab, offset_mm: Float64, turn: Float64 | None = None) -> None:
        """Lead a grab with the next steps."""
        x, y, z = np.asarray(offset_mm, dtype=float).tolist()
        rows = None if turn is None else tuple((float(a), float(b), float(c)) for a, b, c in turn)
        self.waiting.append(LeadGrab.model_validate({"name": grab.name, "offset_mm": (x, y, z), "turn": rows}))

    def move(self, probe: Probe, center_mm: Float64) -> None:
        """Move a probe with the next steps."""
        x, y, z = np.asarray(center_mm, dtype=float).tolist()
        self.waiting.append(MoveProbe(name=probe.name, center_mm=(x, y, z)))

    def wrench_on(self, hand: Grab | Probe) -> Wrench:
        """Force of the tissue on an instrument now."""
        return self._session.simulation.wrench_on(hand)


class DeviceHand:
    """Leads a hand of a live session by a device: its first button closes the hand where the tip is, and opens it.

    While it is attached, the steps of a frame are taken in parts, and the device feels the tissue after each. Where its
    loop ends, or :meth:`detach` is called, the hand stays where it is, is brought back slowly, and lets go.

    Parameters
    ----------
    live
        The session that runs.
    servo
        The device's loop, which was entered; it is this one's from here on.
    name
        Name of the hand that it closes.
    radius_mm
        Radius of the ball of tissue that the hand closes on, mm.
    """

    def __init__(self, live: Live, servo: HapticServo, *, name: str = "device", radius_mm: float = 6.0) -> None:
        self._live, self._servo = live, servo
        self._name, self._radius_mm = name, radius_mm
        self._channel = servo.channels[0]
        self._side = TissueSide()
        self._grab: Grab | None = None
        self._is_pressed = False
        self._commands: _Commands | None = None
        self.error: SimulationError | None = None
        self._is_detached = threading.Event()
        self._has_servo_ended = False
        live.take_by(self._take)

    @property
    def is_attached(self) -> bool:
        """Whether it leads a hand: it was not taken away, and its loop has not ended."""
        return not self._is_detached.is_set()

    @property
    def shown(self) -> ShownDevice | None:
        """What is to be shown of it now; None before its first reading, and when it is gone."""
        felt = None if self._is_detached.is_set() else self._channel.felt()
        if felt is None:
            return None
        holds = None if self._grab is None else self._name
        return ShownDevice(felt.pose.position_mm.copy(), felt.force_n.copy(), felt.part, holds)

    def detach(self) -> None:
        """Take the device away: what it led lets go softly, and its loop ends, also where it was lost."""
        if not self._is_detached.is_set():
            self._is_detached.set()
            self._live.take_by(None)
            self._live.let_go_softly(self._name)
            # a session that broke does nothing any more
            if self._live.error is None:
                self._live.settle(_DETACH_S)
        if not self._has_servo_ended:
            self._has_servo_ended = True
            self._servo.__exit__()

    def _take(self, session: OperatingSession, steps: int, motions: Callable[[float], list[Done]]) -> Frame:
        """Take the steps of a frame, in parts; called by the session's thread."""
        step_s = session.simulation.step_s
        try:
            self._servo.check()
        except SimulationError as error:
            self._lose(error)
            return session.take(motions(steps * step_s), steps)
        refused = self._open_or_close(session)
        count = min(max(round(steps * step_s / PART_S), 1), steps, PARTS_MOST)
        rows = np.diff(np.linspace(0, steps, count + 1).round().astype(int)).tolist()
        commands = self._commands
        frames: list[Frame] = []

        def take_part() -> None:
            own = [] if commands is None else commands.waiting[:]
            if commands is not None:
                commands.waiting.clear()
            row = rows[len(frames)]
            frames.append(session.take([*motions(row * step_s), *own], row))

        self._side.segment(count, take_part)
        return replace(
            frames[-1],
            topology=tuple(one for frame in frames for one in frame.topology),
            refused=(*refused, *(one for frame in frames for one in frame.refused)),
            breakdown=next((frame.breakdown for frame in frames if frame.breakdown is not None), None),
        )

    def _lose(self, error: SimulationError) -> None:
        """Its loop has ended: the hand stays, and lets go softly."""
        self.error = error
        self._is_detached.set()
        self._side.felt.clear()
        self._live.take_by(None)
        self._live.let_go_softly(self._name)
        for one in error.problems:
            self._live.tell(replace(one, message=f"{one.message}; its hand lets go softly"))

    def _open_or_close(self, session: OperatingSession) -> tuple[Refusal, ...]:
        """Follow the device's button."""
        felt = self._channel.felt()
        if felt is None:
            return ()
        grabs = session.simulation.grabs
        if self._grab is not None and self._grab not in grabs:
            # let go by another hand, or taken back
            self._drop()
        is_pressed = bool(felt.buttons & _CLOSING)
        was_pressed, self._is_pressed = self._is_pressed, is_pressed
        if is_pressed and not was_pressed and self._grab is None:
            return self._close(session, felt)
        if not is_pressed and self._grab is not None:
            self._drop()
            return session.take([OpenGrab(name=self._name)]).refused
        return ()

    def _close(self, session: OperatingSession, felt: Felt) -> tuple[Refusal, ...]:
        x, y, z = felt.pose.position_mm.tolist()
        frame = session.take([CloseGrab(name=self._name, center_mm=(x, y, z), radius_mm=self._radius_mm)])
        self._grab = next((one for one in session.simulation.grabs if one.name == self._name), None)
        if self._grab is not None and not frame.refused:
            self._commands = _Commands(session)
            pose = ToolPose(felt.pose.position_mm.copy(), felt.pose.turn.copy())
            led = LedGrab(self._commands, self._grab, closed_at=pose)
            self._side.felt.append(FeltInstrument(led, self._channel, self._servo.settings))
        return frame.refused

    def _drop(self) -> None:
        self._grab, self._commands = None, None
        self._side.felt.clear()
