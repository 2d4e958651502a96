"""What tissue does to an instrument: force, and torque about its centre."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from heartcase.schemas.arrays import Float32, Float64, Intp
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.probe import Probe
from heartcase.simulator.instruments.scissors import Scissors
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["Instrument", "Wrench", "wrench_on"]

Instrument = Grab | Probe | Scissors
"""What may be in the tissue; forceps and retractors are grabs."""


@dataclass(frozen=True)
class Wrench:
    """Force and torque of the tissue on an instrument, LPS axes."""

    force_n: Float64
    """Force on the instrument, N, shape (3,)."""
    torque_n_mm: Float64
    """Torque about the instrument's centre, N mm, shape (3,)."""


def wrench_on(model: LatticeModel, instrument: Instrument, forces: Callable[[Intp], Float32]) -> Wrench:
    """Force and torque of springs and cells on what a hand holds, or of what a probe gave in the last steps.

    Parameters
    ----------
    model
        The lattice.
    instrument
        The instrument.
    forces
        Force on some nodes [grid units], shape (count, 3).
    """
    in_grid = instrument.wrench(forces(instrument.nodes)) if isinstance(instrument, Grab) else instrument.wrench
    to_world = model.geometry.direction_matrix.T * model.units.force_n
    return Wrench(in_grid[:3] @ to_world, in_grid[3:] @ to_world * model.cell_mm)
