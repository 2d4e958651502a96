"""The longest stable time step.

Central differences are stable while step < 2 / omega, omega the highest angular frequency. Stiffness and mass of the
lattice are sums over cells, so omega^2 is at most the highest of any single cell alone (Irons and Treharne's element
bound); a lone cell has omega^2 = 20 k/m, whatever its coverage, because coverage scales its stiffness and its mass
alike. Held nodes and removed springs only lower it. That holds at rest. Springs stiffen when stretched, but none
resists a movement of its ends by more than its weight, whatever its length and direction; in a lone cell of springs
that resist all movements so, omega^2 = 24 k/m, which no deformation of any lattice exceeds.

With other force laws a lone cell has (12 lambda + 8 mu) h/m at rest, 20 k/m where lambda = mu = k/h. An element whose
tissue fills one end of its cell has more. There the lattice's own highest frequency counts, if it is higher
(:class:`heartcase.simulator.lattice.moduli.ForceLaw` on deformed cells).

A lattice's own limit follows from its own highest frequency (:mod:`heartcase.simulator.dynamics.spectrum`): 12 k/m in
the bulk.
"""

from __future__ import annotations

from math import hypot, inf, sqrt

from heartcase.schemas.bundle.lattice import FULL_MOMENTS, STEP_SAFETY
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["checked_step", "default_step", "explicit_rate_limit", "own_step_limit", "step_limit"]


def _cell_rate(model: LatticeModel) -> float:
    """sqrt(k/m) of the quickest cell, 1/s."""
    return sqrt(float((model.cell_stiffness / model.cell_density).max())) / model.units.time_s


def _rest_rate(model: LatticeModel) -> float:
    """An omega at rest that the lattice does not exceed, 1/s."""
    cells = sqrt(model.law.rest_bound) * _cell_rate(model)
    if not model.law.is_element or (model.cell_moments == FULL_MOMENTS).all():
        return cells
    return max(cells, sqrt(largest_eigenvalue(model).upper) / model.units.time_s)


def _stretched_rate(model: LatticeModel) -> float:
    """The omega that the default step is made for, 1/s."""
    return sqrt(model.law.stretched_bound / model.law.rest_bound) * _rest_rate(model)


def _explicit_rate(model: LatticeModel) -> float:
    """Square root of what explicit springs add to omega^2 at most, 1/s: eigenvalues of a sum add up at most (Weyl)."""
    return sqrt(model.explicit.rate_bound(model.inverse_mass)) / model.units.time_s


def step_limit(model: LatticeModel) -> float:
    """Largest time step that is known to be stable at rest, 2 / sqrt(20 k/m) for springs of any shape, in s.

    Less for explicit springs and other ratios than 1/4.
    """
    return 2.0 / hypot(_rest_rate(model), _explicit_rate(model))


def own_step_limit(model: LatticeModel, thread_rate: float = 0.0) -> float:
    """Largest time step that is stable at rest for this very lattice, s: at most 1% below it, and never above.

    Never below :func:`step_limit` where there are no threads; infinite where nothing can move. Ask again after springs
    were removed. ``thread_rate`` is what threads add to omega^2 at most [1 / unit of time^2].
    """
    upper = largest_eigenvalue(model).upper + model.explicit.rate_bound(model.inverse_mass) + thread_rate
    own = 2.0 * model.units.time_s / sqrt(upper) if upper > 0.0 else inf
    return own if thread_rate else max(own, step_limit(model))


def default_step(model: LatticeModel) -> float:
    """Time step that suits tissue however it is deformed, 0.8 x 2 / sqrt(24 k/m) for springs, in s."""
    return STEP_SAFETY * 2.0 / hypot(_stretched_rate(model), _explicit_rate(model))


def explicit_rate_limit(model: LatticeModel, step_s: float) -> float:
    """What explicit springs may add to omega^2 at a step, so that lattice and they stay stable [1 / unit of time^2].

    A tenth of the step is left over. Zero where the step leaves nothing for them.
    """
    lattice = (_stretched_rate(model) * model.units.time_s) ** 2
    return max((2.0 / (1.1 * step_s / model.units.time_s)) ** 2 - lattice, 0.0)


def checked_step(model: LatticeModel, step_s: float | None) -> float:
    """The step asked for, or the default.

    Raises
    ------
    SimulationError
        The step is not above zero, or beyond the lattice's own limit.
    """
    if step_s is None:
        return default_step(model)
    limit = step_limit(model)
    if not 0.0 < step_s <= limit:
        limit = own_step_limit(model)
    if not 0.0 < step_s <= limit or step_s == inf:
        raise SimulationError(
            f"a step of {step_s:.6g} s is not stable: this case's bound is {limit:.6g} s; give at most that, "
            f"or leave it out for {default_step(model):.6g} s",
            place="step_s",
        )
    return step_s
