"""Blades of a session whose cuts are on their way: one is worked out, the others wait, and those that go on are one.

A hand draws a blade on in every frame, and a cut takes some frames to work out. So what a blade did meanwhile becomes
one cut, in which each sample lies where it met the tissue: however long the stroke, the cut is never more than two
workings-out behind.
"""

from __future__ import annotations

from dataclasses import dataclass

from heartcase.schemas.base import Vector3
from heartcase.schemas.recording.commands import Cut
from heartcase.simulator.cutting.blade_sheet import blade_points
from heartcase.simulator.simulation import Simulation

__all__ = ["ComingBlades"]

_Pose = tuple[Vector3 | None, ...]

POSES_MOST = 256
"""Poses of a cut that others are joined to."""


@dataclass(frozen=True)
class _Blade:
    """A blade that cuts."""

    command: Cut
    """With poses at rest."""
    last_pose: _Pose
    """Where it is at its end, as it was given."""
    at_rest: bool
    """Whether that is a place at rest."""


class ComingBlades:
    """Cuts that were begun and not made."""

    def __init__(self) -> None:
        self._begun: Cut | None = None
        self._waiting: list[Cut] = []
        self._last: _Blade | None = None

    def __len__(self) -> int:
        return len(self._waiting) + (self._begun is not None)

    def add(self, simulation: Simulation, given: Cut, resolved: Cut) -> None:
        """One more cut.

        Where it has the name of the one before, and begins where that ended, both are one sheet, and one cut if that
        one waits: tissue that moved from sample to sample is cut between them, too.

        Parameters
        ----------
        simulation
            What is cut.
        given, resolved
            The command, and the same with poses at rest.

        Raises
        ------
        SimulationError
            It cannot be made.
        """
        blade_points(simulation.model, resolved.poses_mm, resolved.name, may_be_open=True)
        if self._last is not None and _goes_on(self._last, given, resolved):
            before, poses = self._last.command.poses_mm, resolved.poses_mm
            poses = poses if poses[0] == before[-1] else (before[-1], *poses)
            if self._waiting and len(before) + len(poses) <= POSES_MOST:
                self._waiting.pop()
                poses = (*before, *poses[1:])
            resolved = resolved.model_copy(update={"poses_mm": poses})
        self._waiting.append(resolved)
        self._last = _Blade(resolved, given.poses_mm[-1], given.at_rest)

    def start(self, simulation: Simulation) -> Cut | None:
        """The cut that is worked out; where there is none, that of the next is begun. None where none waits."""
        if self._begun is None and self._waiting:
            self._begun = self._waiting.pop(0)
            simulation.begin_cut(self._begun.poses_mm, at_rest=True, name=self._begun.name)
        return self._begun

    def done(self) -> None:
        """The cut that was worked out is made, or refused."""
        self._begun = None


def _goes_on(last: _Blade, given: Cut, resolved: Cut) -> bool:
    is_alike = (last.command.name, last.at_rest) == (given.name, given.at_rest)
    return (
        is_alike and last.last_pose == given.poses_mm[0] and len(last.command.poses_mm[0]) == len(resolved.poses_mm[0])
    )
