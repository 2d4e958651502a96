"""How long a time step may be.

Central differences are stable while step < 2 / omega, omega the highest angular frequency. Stiffness and mass of the
lattice are sums over cells, so omega^2 is at most the highest of any single cell alone (Irons and Treharne's element
bound); a lone cell has omega^2 = 20 k/m, whatever its coverage, because coverage scales its stiffness and its mass
alike. Held nodes and removed springs only lower it. That holds at rest; stretched springs stiffen up to 24 k/m.
"""

from __future__ import annotations

from math import sqrt

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.model import LatticeModel

__all__ = ["checked_step", "default_step", "step_limit"]

REST_BOUND = 20.0
"""omega^2 m/k of a lone cell at rest, the highest of any shape."""
STRETCHED_BOUND = 24.0
"""omega^2 m/k that stretched springs reach."""
SAFETY = 0.8
"""Default step over the limit of the stretched lattice."""


def _cell_rate(model: LatticeModel) -> float:
    """sqrt(k/m) of the quickest cell, 1/s."""
    return sqrt(float((model.cell_stiffness / model.cell_density).max())) / model.units.time_s


def step_limit(model: LatticeModel) -> float:
    """Largest time step that is stable at rest for every shape, 2 / sqrt(20 k/m), in s."""
    return 2.0 / (sqrt(REST_BOUND) * _cell_rate(model))


def default_step(model: LatticeModel) -> float:
    """Time step that also suits stretched tissue, 0.8 x 2 / sqrt(24 k/m), in s."""
    return SAFETY * 2.0 / (sqrt(STRETCHED_BOUND) * _cell_rate(model))


def checked_step(model: LatticeModel, step_s: float | None) -> float:
    """The step asked for, or the default.

    Raises
    ------
    SimulationError
        The step is not above zero, or beyond the case's limit.
    """
    if step_s is None:
        return default_step(model)
    limit = step_limit(model)
    if not 0.0 < step_s <= limit:
        raise SimulationError(
            f"a step of {step_s:.6g} s is not stable: this case's bound is {limit:.6g} s; give at most that, "
            f"or leave it out for {default_step(model):.6g} s",
            place="step_s",
        )
    return step_s
