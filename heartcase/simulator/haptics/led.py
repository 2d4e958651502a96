"""Instruments in the tissue that a device leads: what the loop needs of a grab and of a probe."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.probe import Probe
from heartcase.simulator.instruments.wrench import Wrench
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["LedGrab", "LedInstrument", "LedProbe", "Tissue"]


class Tissue(Protocol):
    """What is asked of a simulation."""

    @property
    def model(self) -> LatticeModel:
        """The lattice now."""

    def lead(self, grab: Grab, offset_mm: Float64, turn: Float64 | None = None) -> None:
        """Lead a grab to a pose; it arrives with the end of the next steps."""

    def move(self, probe: Probe, center_mm: Float64) -> None:
        """Move a probe; it arrives with the end of the next steps."""

    def wrench_on(self, hand: Grab | Probe) -> Wrench:
        """Force of the tissue on an instrument, and its torque about the instrument's centre."""


class LedInstrument(Protocol):
    """An instrument that follows poses of a tool, and is pulled at by the tissue."""

    def follow(self, pose: ToolPose) -> None:
        """Go there with the end of the next steps."""

    def load(self, pose: ToolPose) -> Float64:
        """Force, N, and torque about the pose's position, N mm, of the tissue on it now, LPS axes, shape (2, 3)."""


class LedGrab:
    """A grab that moves with the tool as one body, from the pose at which it closed.

    Parameters
    ----------
    tissue
        The simulation.
    grab
        What it has closed on.
    closed_at
        Where the tool was then; the grab's own centre need not be there.
    """

    def __init__(self, tissue: Tissue, grab: Grab, closed_at: ToolPose) -> None:
        self.tissue, self.grab, self.closed_at = tissue, grab, closed_at
        model = tissue.model
        index = model.node_index[grab.nodes[:1]] + grab.closed_at[:1] - grab.arms[:1]
        self.center_mm: Float64 = model.geometry.index_to_world(index - 0.5)[0]

    def follow(self, pose: ToolPose) -> None:
        """Lead the grab as one body with the tool."""
        turn = pose.turn @ self.closed_at.turn.T
        center = pose.position_mm + turn @ (self.center_mm - self.closed_at.position_mm)
        self.tissue.lead(self.grab, center - self.center_mm, turn)

    def load(self, pose: ToolPose) -> Float64:
        """Force on what it holds, and its moment about the tool."""
        center = self.center_mm + self.tissue.model.to_mm(self.grab.pose.offset)
        return _about(pose, center, self.tissue.wrench_on(self.grab))


class LedProbe:
    """A probe that the tool carries at its tip.

    Parameters
    ----------
    tissue
        The simulation.
    probe
        The probe.
    """

    def __init__(self, tissue: Tissue, probe: Probe) -> None:
        self.tissue, self.probe = tissue, probe

    def follow(self, pose: ToolPose) -> None:
        """Move the probe's centre to the tool."""
        self.tissue.move(self.probe, pose.position_mm)

    def load(self, pose: ToolPose) -> Float64:
        """Force on the probe, and its moment about the tool."""
        center = self.tissue.model.geometry.index_to_world(self.probe.centre[None] - 0.5)[0]
        return _about(pose, center, self.tissue.wrench_on(self.probe))


def _about(pose: ToolPose, center_mm: Float64, wrench: Wrench) -> Float64:
    """A force, and its torque about a pose's position, where that about a centre is given, shape (2, 3)."""
    return np.stack([wrench.force_n, wrench.torque_n_mm + np.cross(center_mm - pose.position_mm, wrench.force_n)])
