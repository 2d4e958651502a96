"""Instruments of a script as commands of a session: how each comes in, how jaws close, when blades and scissors cut."""

from __future__ import annotations

import numpy as np

from heartcase.schemas.base import Vector3
from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import (
    Act,
    BringProbe,
    BringScissors,
    CloseForceps,
    CloseGrab,
    CloseRetractor,
    Cut,
    Excise,
    PlaceScissors,
    Snip,
)
from heartcase.schemas.scripts.script import CutAction, ExciseAction, GrabAction, ProbeAction
from heartcase.schemas.scripts.tool_actions import ForcepsAction, RetractorAction, ScissorsAction
from heartcase.simulator.incisions.cut_tissue import area_mm2, cut_triangles
from heartcase.simulator.instruments.forceps import Forceps
from heartcase.simulator.session.operating_session import OperatingSession

__all__ = ["Action", "Blades", "Snips", "bringing_in", "jaw_gap_mm"]

Action = GrabAction | ProbeAction | ForcepsAction | RetractorAction
"""What has a path of its own in a script."""

_FORCEPS = {"tip_mm", "direction", "closing", "length_mm", "width_mm", "opening_mm"}
_RETRACTOR = {"line_mm", "side", "depth_mm", "stiffness_n_mm2", "limit_n_mm"}
_SCISSORS = {"hinge_mm", "direction", "closing", "length_mm", "opening_deg"}


def bringing_in(action: Action, name: str) -> Act:
    """The command with which an instrument of a script takes hold or comes in, under a name.

    Raises
    ------
    SimulationError
        A landmark has no position yet.
    """
    if isinstance(action, ForcepsAction):
        # They are still open: how they close is told step by step.
        return CloseForceps(name=name, gap_mm=action.opening_mm, **action.model_dump(include=_FORCEPS))
    if isinstance(action, RetractorAction):
        return CloseRetractor(name=name, **action.model_dump(include=_RETRACTOR))
    if action.position_mm is None:
        raise SimulationError(f"the landmark {action.landmark!r} has no position yet", place=action.name)
    if isinstance(action, GrabAction):
        return CloseGrab(name=name, center_mm=action.position_mm, radius_mm=action.radius_mm)
    return BringProbe(name=name, center_mm=action.position_mm, semi_axes_mm=action.semi_axes_mm, axis_mm=action.axis_mm)


def jaw_gap_mm(action: Action, forceps: Forceps, cell_mm: float) -> tuple[float, float]:
    """Gap between the jaws before and after they close, mm."""
    closed = action.gap_mm if isinstance(action, ForcepsAction) else None
    return forceps.gap * cell_mm, forceps.thickness * cell_mm if closed is None else closed


class Snips:
    """Scissors of a script, in steps instead of seconds.

    ``stops`` are steps at which something begins or ends.

    Parameters
    ----------
    action
        What the scissors do.
    step_s
        Time step, s.
    step_total
        Steps of the script.
    """

    def __init__(self, action: ScissorsAction, step_s: float, step_total: int) -> None:
        self.action = action
        self._spans: list[tuple[int, int]] = []
        before = -1
        for snip in action.snips:
            start = max(before, min(round(snip.time_s / step_s), step_total - 2), 0)
            before = max(start + 1, min(round((snip.time_s + snip.seconds) / step_s), step_total - 1))
            self._spans.append((start, before))
        self.stops = {stop for span in self._spans for stop in span if 0 < stop < step_total}
        self._angle_deg = self._from_deg = action.opening_deg
        self._direction, self._closing = action.direction, action.closing
        self._has_come = False

    def go_on(self, session: OperatingSession, now: int) -> None:
        """Do what is due at a step; while they close they cut as far as they have come."""
        for snip, (start, end) in zip(self.action.snips, self._spans, strict=True):
            if now == end:
                self._close(session, snip.angle_deg)
            if now == start:
                self._begin(session, snip.hinge_mm, snip.direction, snip.closing)
                self._from_deg = self._angle_deg
            elif start < now < end:
                self._close(session, float(np.interp(now, (start, end), (self._from_deg, snip.angle_deg))))

    def _begin(
        self,
        session: OperatingSession,
        hinge_mm: Vector3 | None,
        direction: Vector3 | None,
        closing: Vector3 | None,
    ) -> None:
        action = self.action
        if not self._has_come:
            session.do(BringScissors(name=action.name, **action.model_dump(include=_SCISSORS)))
            self._has_come = True
        if hinge_mm is not None:
            self._close(session, action.opening_deg)
            self._direction, self._closing = direction or self._direction, closing or self._closing
            session.do(
                PlaceScissors(name=action.name, hinge_mm=hinge_mm, direction=self._direction, closing=self._closing)
            )

    def _close(self, session: OperatingSession, angle_deg: float) -> None:
        if angle_deg != self._angle_deg:
            session.do(Snip(name=self.action.name, angle_deg=angle_deg))
            self._angle_deg = angle_deg


class Blades:
    """What the blades of a script cut, and what is taken out."""

    def __init__(self, session: OperatingSession) -> None:
        self.session = session
        self.cut_mm2: dict[str, float] = {}
        self.excised_ml: dict[str, float] = {}

    def cut(self, action: CutAction) -> None:
        """Cut, and keep how much of it went through tissue."""
        before = self._area_mm2()
        self.session.do(Cut(name=action.name, poses_mm=action.poses_mm, at_rest=action.at_rest))
        if self.session.simulation.surface is not None:
            cut = max(self._area_mm2() - before, 0.0)
            self.cut_mm2[action.name] = self.cut_mm2.get(action.name, 0.0) + cut

    def excise(self, action: ExciseAction) -> None:
        """Take a piece out, and keep how much it was."""
        before = self._excised_ml()
        self.session.do(Excise(name=action.name, place_mm=action.place_mm, at_rest=action.at_rest))
        self.excised_ml[action.name] = self._excised_ml() - before

    def _area_mm2(self) -> float:
        split = self.session.simulation.split
        if split is None:
            return 0.0
        return area_mm2(cut_triangles(split.surface.rest_mm, split.surface.triangles, split.triangle_is_cut_face))

    def _excised_ml(self) -> float:
        simulation = self.session.simulation
        return 0.0 if simulation.cuts is None else simulation.cuts.excised_ml
