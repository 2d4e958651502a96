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

_Pose = tuple[Vector3, ...]

POSES_MOST = 256
"""Poses of a cut that others are joined to."""


@dataclass(frozen=True)
class _Waiting:
    """A cut that waits."""

    command: Cut
    """With poses at rest."""
    last_pose: _Pose
    """Where the blade is at its end, as it was given."""
    at_rest: bool
    """Whether that is a place at rest."""


class ComingBlades:
    """Cuts that were begun and not made."""

    def __init__(self) -> None:
        self._begun: Cut | None = None
        self._waiting: list[_Waiting] = []

    def __len__(self) -> int:
        return len(self._waiting) + (self._begun is not None)

    def add(self, simulation: Simulation, given: Cut, resolved: Cut) -> None:
        """One more cut; it goes on from the one before if that waits, has its name, and ends where this one begins.

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
        blade_points(simulation.model, resolved.poses_mm, resolved.name)
        last = self._waiting[-1] if self._waiting else None
        goes_on = (
            last is not None
            and (last.command.name, last.at_rest) == (given.name, given.at_rest)
            and last.last_pose == given.poses_mm[0]
            and len(last.command.poses_mm[0]) == len(resolved.poses_mm[0])
            and len(last.command.poses_mm) + len(resolved.poses_mm) <= POSES_MOST
        )
        if last is not None and goes_on:
            # Tissue that moved between the samples was met twice: the strip between both makes one sheet of them.
            again = resolved.poses_mm[0] == last.command.poses_mm[-1]
            poses = (*last.command.poses_mm, *resolved.poses_mm[again:])
            resolved = resolved.model_copy(update={"poses_mm": poses})
            self._waiting.pop()
        self._waiting.append(_Waiting(resolved, given.poses_mm[-1], given.at_rest))

    def start(self, simulation: Simulation) -> Cut | None:
        """The cut that is worked out; where there is none, that of the next is begun. None where none waits."""
        if self._begun is None and self._waiting:
            self._begun = self._waiting.pop(0).command
            simulation.begin_cut(self._begun.poses_mm, at_rest=True, name=self._begun.name)
        return self._begun

    def done(self) -> None:
        """The cut that was worked out is made, or refused."""
        self._begun = None
