"""The stitches of a script: placed, drawn evenly, tied and taken out at their times; the force in each."""

from __future__ import annotations

from collections.abc import Iterator

from heartcase.schemas.recording.commands import DrawStitch, PlaceStitch, TakeOutStitch, TieStitch
from heartcase.schemas.script import SimulationScript
from heartcase.schemas.suture_actions import StitchAction
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.perform_sutures import stitch_named
from heartcase.simulator.suturing.stitches import StitchState

__all__ = ["Threads"]


class _Timed:
    """A stitch in steps instead of seconds."""

    def __init__(self, action: StitchAction, step_s: float, step_total: int) -> None:
        self.action = action
        self.placed = min(round(action.time_s / step_s), step_total - 1)
        self.tied = max(self.placed + 1, round(action.tied_s / step_s))
        self.out = step_total + 1 if action.out_s is None else max(self.tied + 1, round(action.out_s / step_s))
        self.started_at = 0.0
        """Length of the thread when it was placed, mm."""


class Threads:
    """What the stitches of a script are told, and what they pulled with."""

    def __init__(self, session: OperatingSession, script: SimulationScript, step_total: int) -> None:
        self.session = session
        step_s = session.simulation.step_s
        self._timed = [_Timed(action, step_s, step_total) for action in script.stitches]
        self._total = step_total
        self.peak_force_n: dict[str, float] = {}
        """Stitch -> highest force in it in any frame, N."""
        self.end_force_n: dict[str, float] = {}
        """Stitch -> force in it at the last frame in which it was there, N."""

    def stops(self) -> Iterator[int]:
        """Steps at which something is done."""
        for one in self._timed:
            yield from (stop for stop in (one.placed, one.tied, one.out) if 0 < stop < self._total)

    def change(self, now: int) -> None:
        """Do what is due at this step."""
        for one in self._timed:
            name = one.action.name
            if now == one.placed:
                where = {"places_mm": one.action.places_mm, "at_rest": one.action.at_rest}
                self.session.do(PlaceStitch(name=name, **where, stiffness_n_m=one.action.stiffness_n_m))
                one.started_at = self._state(name).length_mm
            if now == one.tied:
                self.session.do(TieStitch(name=name))
            if now == one.out:
                self.session.do(TakeOutStitch(name=name))

    def draw(self, stop: int) -> None:
        """Draw each thread on its way to where it shall be at a step."""
        for one in self._timed:
            if not one.placed < stop <= one.tied:
                continue
            part = (stop - one.placed) / (one.tied - one.placed)
            if one.action.tension_n is not None:
                self.session.do(DrawStitch(name=one.action.name, tension_n=part * one.action.tension_n))
            elif one.action.length_mm is not None:
                length = one.started_at + part * (one.action.length_mm - one.started_at)
                self.session.do(DrawStitch(name=one.action.name, length_mm=max(length, 0.0)))

    def feel(self) -> None:
        """Keep the force in each, and the highest."""
        present = {stitch.name for stitch in self.session.simulation.stitches}
        for one in self._timed:
            name = one.action.name
            if name in present:
                force = self._state(name).force_n
                self.peak_force_n[name] = max(self.peak_force_n.get(name, 0.0), force)
                self.end_force_n[name] = force

    def _state(self, name: str) -> StitchState:
        return self.session.simulation.stitch_state(stitch_named(self.session.simulation, name))
