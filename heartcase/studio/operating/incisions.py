"""Planned incisions of a case, cut and held open by a click, as a plan of incisions does it."""

from __future__ import annotations

import re
from functools import cached_property

import numpy as np

from heartcase.schemas.errors import UsageError
from heartcase.schemas.recording.commands import CloseGrab, Cut, LeadGrab
from heartcase.schemas.scripts.incision_plans import LipHands, PlannedCut, PlannedIncision
from heartcase.simulator.incisions.blade_line import incision_of_blade
from heartcase.simulator.incisions.held_open import ShownHeart
from heartcase.simulator.incisions.planned import blade_poses, drawn_line, lip_hands, problems_of_cut
from heartcase.simulator.live.live_frame import LiveFrame
from heartcase.simulator.load import Case
from heartcase.simulator.surface.deform import deform

__all__ = ["HANDS", "OPEN_S", "Incisions", "is_held_open"]

HANDS = LipHands(hands_per_lip=2)
"""What holds the lips: as in the plans of the sample cases."""
OPEN_S = float(PlannedIncision.model_fields["open_s"].default)
"""Simulated time in which the lips are led apart, s."""
_NAME_LENGTH_MAX = 64
"""Characters of an instrument's name at most."""
_HAND = re.compile(r"(?:one|other) lip(?: \d+)?")
"""What :func:`heartcase.simulator.incisions.planned.lip_hands` calls a hand."""


class Incisions:
    """Incisions of a case.

    Parameters
    ----------
    case
        The case, with its surface.
    """

    def __init__(self, case: Case) -> None:
        self._case = case

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the planned incisions that can be cut."""
        landmarks = self._case.manifest.landmarks
        return tuple(one.name for one in landmarks if not problems_of_cut(_planned(one.name), landmarks, ""))

    @cached_property
    def whole(self) -> ShownHeart:
        """The surface before anything is cut."""
        case = self._case
        assert case.surface is not None
        still = np.zeros((case.model.node_count, 3), np.float32)
        return ShownHeart.of(case.surface, deform(case.model, case.surface, still))

    def cut(self, name: str) -> Cut:
        """The blade's way along a planned incision.

        Raises
        ------
        UsageError
            The case has no such incision.
        """
        landmarks, cut = self._case.manifest.landmarks, _planned(name)
        if problems := problems_of_cut(cut, landmarks, "incision"):
            raise UsageError(problems)
        line = drawn_line(cut, landmarks, self.whole.tree, self.whole.rest_mm, self.whole.normals)
        poses = blade_poses(cut, line, landmarks, cell_mm=self._case.model.cell_mm)
        return Cut(name=name, poses_mm=poses, at_rest=True)

    def hands(self, cut: Cut, number: int) -> list[tuple[CloseGrab, LeadGrab, float]]:
        """Hands at both lips of a cut: how each closes, where it is led, and how fast, mm/s.

        Parameters
        ----------
        cut
            The cut.
        number
            Its place among those that are done, from 0: cuts may share a name, and hands may not.

        Raises
        ------
        UsageError
            The cut has no line on the tissue.
        """
        incision, _ = incision_of_blade(cut.name, np.array(cut.poses_mm), self.whole, self._case.manifest.landmarks)
        if incision.line is None:
            raise UsageError("this cut has no line on the tissue: hold it open by hand", place="incision")
        cell_mm = self._case.model.cell_mm
        made = []
        for hand in lip_hands(HANDS, incision.line, self.whole.rest_mm, cell_mm=cell_mm, open_s=OPEN_S):
            assert hand.position_mm is not None
            offset = hand.path[-1].offset_mm
            name = _hand_name(cut.name, number, hand.name)
            close = CloseGrab(name=name, center_mm=hand.position_mm, radius_mm=hand.radius_mm)
            speed = float(np.linalg.norm(offset)) / OPEN_S
            made.append((close, LeadGrab(name=name, offset_mm=offset), speed))
        return made


def is_held_open(live: LiveFrame, number: int = -1) -> bool:
    """Whether hands of :meth:`Incisions.hands` hold a cut open; by its place among those that are done."""
    if not live.cuts:
        return False
    number %= len(live.cuts)
    begin = _hand_name(live.cuts[number].name, number, "")
    return any(name.startswith(begin) and _HAND.fullmatch(name, len(begin)) for name in live.frame.instruments)


def _hand_name(cut: str, number: int, hand: str) -> str:
    own = f" {number + 1} {hand}"
    return f"{cut[: _NAME_LENGTH_MAX - len(own)]}{own}"


def _planned(name: str) -> PlannedCut:
    return PlannedCut(name=name, landmark=name)
