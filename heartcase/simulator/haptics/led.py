"""Instruments in the tissue that a device leads: what the loop needs of a grab and of a probe."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from heartcase.schemas.arrays import Float64, Intp
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.probe import Probe
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["LedGrab", "LedInstrument", "LedProbe", "Tissue"]


class Tissue(Protocol):
    """What is asked of a simulation."""

    model: LatticeModel

    def lead(self, grab: Grab, offset_mm: Float64, turn: Float64 | None = None) -> None:
        """Lead a grab to a pose; it arrives with the end of the next steps."""

    def move(self, probe: Probe, center_mm: Float64) -> None:
        """Move a probe; it arrives with the end of the next steps."""

    def force_on(self, hand: Grab | Probe) -> Float64:
        """Force of the tissue on an instrument now, N, LPS axes, shape (3,)."""

    def forces_at(self, nodes: Intp) -> Float64:
        """Forces of the tissue on some nodes now, N, LPS axes, shape (len(nodes), 3)."""


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
        """Forces on what it holds, and their moment about the tool."""
        model, grab = self.tissue.model, self.grab
        forces = self.tissue.forces_at(grab.nodes)
        center = self.center_mm + model.to_mm(grab.pose.offset)
        arms = center - pose.position_mm + model.to_mm(grab.arms @ grab.pose.turn.T)
        return np.stack([forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)])


class LedProbe:
    """A probe that the tool carries at its tip. Its torque about its own centre is not known yet, and taken as none.

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
        """Force on the probe."""
        return np.stack([self.tissue.force_on(self.probe), np.zeros(3)])
