"""The virtual coupling: a tool in the tissue that hangs on the hand's pose by a spring and a damper.

The tissue's force is known at the pose that the tool had when the state was worked out. At another pose it is taken to
differ by a stiffness that the last states show. A step is implicit: it is stable whatever the stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.haptics.settings import ServoSettings

__all__ = ["TissueSample", "Tool", "advance_tool", "stiffness_seen"]

_STILL_MM = 0.02
"""Way between two states, lever arms for rotations included, from which on they say something of stiffness, mm."""


@dataclass(frozen=True)
class Tool:
    """The tool behind the coupling."""

    pose: ToolPose
    """Where it is."""
    motion: Float64
    """How it moves: mm/s, rad/s, LPS axes, shape (2, 3)."""

    @classmethod
    def resting(cls, pose: ToolPose) -> Tool:
        """A tool that does not move."""
        return cls(pose, np.zeros((2, 3)))


@dataclass(frozen=True)
class TissueSample:
    """What one state of the tissue does to an instrument."""

    finished_s: float
    """When the state was there, by the clock of the loop, s."""
    pose: ToolPose
    """Where the instrument was in it."""
    load: Float64
    """Force of the tissue on the instrument, N, and torque about its position, N mm, LPS axes, shape (2, 3)."""
    stiffness: Float64
    """How much the load falls as the instrument goes further: N/mm, N mm/rad, not negative, shape (2,)."""

    def row(self) -> Float64:
        """The sample as numbers, shape (21,)."""
        parts = ([self.finished_s], self.pose.position_mm, self.pose.turn.ravel(), self.load.ravel(), self.stiffness)
        return np.concatenate(parts)

    @classmethod
    def of_row(cls, row: Float64) -> TissueSample:
        """The sample of numbers that :meth:`row` gave."""
        pose = ToolPose(row[1:4], row[4:13].reshape(3, 3))
        return cls(float(row[0]), pose, row[13:19].reshape(2, 3), row[19:21])


def advance_tool(
    tool: Tool,
    hand: ToolPose,
    hand_motion: Float64,
    tissue: TissueSample | None,
    settings: ServoSettings,
    *,
    seconds: float | None = None,
) -> tuple[Tool, Float64]:
    """The tool one update later, and what the coupling does to the hand.

    Parameters
    ----------
    tool
        The tool before.
    hand
        Pose of the device now.
    hand_motion
        Its motion: mm/s, rad/s, shape (2, 3).
    tissue
        The newest state of the tissue; None while there is none: the tool then follows the hand.
    settings
        The coupling.
    seconds
        Time since the last update, s; the settings' period when left out.

    Returns
    -------
    tool
        The tool now.
    load
        Force, N, and torque, N mm, on the hand, LPS axes, shape (2, 3).
    """
    dt = settings.period_s if seconds is None else seconds
    stiffness, damping, mass = settings.stiffness, settings.damping, settings.mass
    gap = tool.pose.gap_to(hand)
    pull = stiffness * gap + damping * hand_motion
    yields: Float64 = np.zeros((2, 1))
    if tissue is not None:
        yields = np.clip(tissue.stiffness[:, None], 0.0, settings.tissue_stiffness)
        pull = pull + tissue.load - yields * tissue.pose.gap_to(tool.pose)
    held = mass + dt * damping + dt * dt * (stiffness + yields)
    motion = (mass * tool.motion + dt * pull) / held
    load = -(stiffness * (gap - dt * motion) + damping * (hand_motion - motion))
    return Tool(tool.pose.moved_by(dt * motion), motion), load


def stiffness_seen(gaps: Float64, loads: Float64, lever_mm: float) -> Float64 | None:
    """Stiffness of the tissue that its last states show, by least squares.

    Parameters
    ----------
    gaps
        What the instrument moved from each state to the next: mm, rad, shape (count, 2, 3).
    loads
        By what its load changed: N, N mm, shape (count, 2, 3).
    lever_mm
        Length that makes rotations comparable with ways, mm.

    Returns
    -------
    ndarray or None
        Stiffness, N/mm, N mm/rad, not negative, shape (2,); zero for a rotation that there was not. None where the
        instrument hardly moved, so that nothing is known.
    """
    squares = np.einsum("nij,nij->i", gaps, gaps)
    if squares[0] + squares[1] * lever_mm**2 < _STILL_MM**2:
        return None
    falls = -np.einsum("nij,nij->i", gaps, loads)
    is_known = squares * np.array([1.0, lever_mm**2]) >= _STILL_MM**2
    return np.where(is_known, np.maximum(falls / np.where(is_known, squares, 1.0), 0.0), 0.0)
