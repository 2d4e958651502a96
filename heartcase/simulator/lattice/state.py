"""The state of a moving lattice: displacement and velocity; with the lattice of the moment, a snapshot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float32
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["Snapshot", "State"]


@dataclass(frozen=True)
class State:
    """Displacement and velocity of every node, in grid units and axes.

    Displacements instead of positions keep the rounding error of float32 in proportion to the movement: the centre
    of mass drifts by 0.006 cells in a million steps where positions drift by hundreds.
    """

    displacement: Float32
    """Way from the rest position [cells], shape (node_count, 3)."""
    velocity: Float32
    """Velocity HALF A STEP BEFORE the displacement's time [cells per unit of time], shape (node_count, 3)."""
    step_count: int = 0
    """Steps taken since the start."""

    @classmethod
    def at_rest(cls, node_count: int) -> State:
        """Nothing displaced, nothing moving."""
        return cls(np.zeros((node_count, 3), np.float32), np.zeros((node_count, 3), np.float32))


@dataclass(frozen=True)
class Snapshot:
    """A moment: what :meth:`heartcase.simulator.simulation.Simulation.restore` needs to go back to it."""

    model: LatticeModel
    """The lattice with its springs of that moment."""
    state: State
    """Where its nodes were and how they moved."""
