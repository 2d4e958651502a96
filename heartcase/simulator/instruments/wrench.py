"""What tissue does to an instrument: force, and torque about its centre."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float32, Float64, Intp
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.probe import Probe
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["Wrench", "wrench_on"]


@dataclass(frozen=True)
class Wrench:
    """Force and torque of the tissue on an instrument, LPS axes."""

    force_n: Float64
    """Force on the instrument, N, shape (3,)."""
    torque_n_mm: Float64
    """Torque about the instrument's centre, N mm, shape (3,)."""


def wrench_on(
    model: LatticeModel,
    displacement: Float32,
    instrument: Grab | Probe,
    grabs: Sequence[Grab],
    forces: Callable[[Intp], Float32],
) -> Wrench:
    """Force and torque of the springs on what an instrument holds or touches.

    Parameters
    ----------
    model
        The lattice.
    displacement
        Displacement of all nodes [cells], shape (node_count, 3).
    instrument
        The instrument.
    grabs
        All hands that hold: what they hold, no probe touches.
    forces
        Force on some nodes [grid units], shape (count, 3).
    """
    if isinstance(instrument, Grab):
        nodes, centre = instrument.nodes, instrument.centre_at(instrument.pose, model)
    else:
        nodes, centre = instrument.touched(model, displacement), instrument.centre
        for grab in grabs:
            nodes = np.setdiff1d(nodes, grab.nodes, assume_unique=True)
    force = forces(nodes).astype(float)
    arms = model.node_index[nodes] + displacement[nodes].astype(float) - centre
    to_world = model.geometry.direction_matrix.T * model.units.force_n
    return Wrench(force.sum(axis=0) @ to_world, np.cross(arms, force).sum(axis=0) @ to_world * model.cell_mm)
