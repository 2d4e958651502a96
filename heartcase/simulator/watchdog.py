"""The watchdog: stops a simulation whose numbers no longer describe tissue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Bool, Float32, Int32
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.dynamics.measures import elastic_energy_of, inverted_cells
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State
from heartcase.simulator.lattice.tethers import Tethers

__all__ = ["Watch", "find_runaway", "find_trouble", "watch"]

RUNAWAY = 2.0
"""Growth of energy that nothing accounts for from which on it is called a runaway."""


@dataclass(frozen=True)
class Watch:
    """What a frame shows of tissue that is treated beyond physics. None of it ends the simulation."""

    inverted_cell_count: int
    """Cells that are turned inside out at a corner."""
    hurried_node_count: int
    """Free nodes that would move more than half a cell in a step, and are held back: energy is lost there."""


def watch(model: LatticeModel, state: State, speed_limit: float, led: Bool) -> Watch:
    """Count what is beyond physics.

    Parameters
    ----------
    model
        The lattice.
    state
        State to look at.
    speed_limit
        Largest component of a free node's velocity [cells / unit of time].
    led
        Nodes that a hand leads: they may be as quick as the hand, shape (node_count,).
    """
    is_hurried = (np.abs(state.velocity) >= np.float32(speed_limit)).any(axis=1) & ~led
    return Watch(
        inverted_cell_count=int(inverted_cells(model, state.displacement).sum()),
        hurried_node_count=int(is_hurried.sum()),
    )


def find_trouble(state: State) -> str | None:
    """What is wrong with a state, in words; None when nothing is."""
    is_whole = np.isfinite(_largest(state.velocity) + _largest(state.displacement))
    return None if is_whole else "a position is not a number any more"


def find_runaway(
    model: LatticeModel, verlet: Verlet, before: State, after: State, tethers: Tethers | None = None
) -> str | None:
    """Whether energy came from nowhere, in words, in steps in which no hand moved and no probe was there.

    ``tethers`` are threads that are there; none was drawn in these steps.

    It is looked for only where a node moves at the speed limit, as it will before there is much of it. Gravity may have
    given what it gave.
    """
    # What swings up turns around in every step: of longer ones, the end of a row takes off as much again.
    if _largest(after.velocity) < np.float32(verlet.speed_limit / verlet.pace):
        return None
    mass = model.node_mass[:, None].astype(float)

    def energy_of(state: State) -> float:
        threads = 0.0 if tethers is None else tethers.energy(state.displacement)
        kinetic = 0.5 * float((mass * state.velocity.astype(float) ** 2).sum())
        return elastic_energy_of(model, state.displacement) + threads + kinetic

    way = after.displacement.astype(float) - before.displacement
    had = energy_of(before) + max(float((mass * way * np.array(verlet.gravity)).sum()), 0.0)
    has = energy_of(after)
    if has <= RUNAWAY * had:
        return None
    unit = model.units.energy_j
    return f"its energy grew from {had * unit:.2g} J to {has * unit:.2g} J by itself"


def _largest(values: Float32) -> float:
    """Largest absolute value, or what is not finite, if there is any."""
    bits = _largest_bits(np.ascontiguousarray(values).view(np.int32).ravel())
    return float(np.int32(bits).view(np.float32))


@kernel
def _largest_bits(bits: Int32) -> int:
    """Largest of the bits but the sign: they sort as the numbers do, and a maximum of integers is a vector's work."""
    largest = np.int32(0)
    for bit in bits:
        largest = max(largest, np.int32(bit & 0x7FFFFFFF))
    return int(largest)
