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
the bulk. Elements may take steps up to a part of it (:func:`pace_part`), and pieces that cuts left of them, if they
are quicker, up to that part of theirs (:mod:`heartcase.simulator.cutting.cut_frequency`).
"""

from __future__ import annotations

from functools import cached_property
from math import hypot, inf, sqrt

from heartcase.schemas.bundle.lattice import FULL_MOMENTS, STEP_SAFETY
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import RATIO_MIN, ForceLaw

__all__ = [
    "StepSizes",
    "checked_pace",
    "checked_step",
    "default_step",
    "explicit_rate_limit",
    "own_step_limit",
    "pace_at",
    "step_limit",
]


class StepSizes:
    """Time steps of a lattice; its own highest frequency is worked out when it is first asked for, and once.

    Parameters
    ----------
    model
        The lattice, without the springs that were cut.
    """

    def __init__(self, model: LatticeModel) -> None:
        self.model = model

    @cached_property
    def _own_bound(self) -> float:
        """omega^2 that this very lattice does not exceed at rest, explicit springs left out [1 / unit of time^2]."""
        return largest_eigenvalue(self.model).upper

    @cached_property
    def _rest_rate(self) -> float:
        """An omega at rest that the lattice does not exceed, explicit springs left out, 1/s."""
        model = self.model
        quickest = sqrt(float((model.cell_stiffness / model.cell_density).max())) / model.units.time_s
        cells = sqrt(model.law.rest_bound) * quickest
        if not model.law.is_element or (model.cell_moments == FULL_MOMENTS).all():
            return cells
        return max(cells, sqrt(self._own_bound) / model.units.time_s)

    @property
    def stretched_rate(self) -> float:
        """The omega that the default step is made for, explicit springs left out, 1/s."""
        return sqrt(self.model.law.stretched_bound / self.model.law.rest_bound) * self._rest_rate

    @property
    def _explicit_rate(self) -> float:
        """Root of what explicit springs add to omega^2 at most, 1/s: eigenvalues of a sum add up at most (Weyl)."""
        return sqrt(self.model.explicit.rate_bound(self.model.inverse_mass)) / self.model.units.time_s

    @property
    def limit_s(self) -> float:
        """As of :func:`step_limit`."""
        return 2.0 / hypot(self._rest_rate, self._explicit_rate)

    @property
    def default_s(self) -> float:
        """As of :func:`default_step`."""
        return STEP_SAFETY * 2.0 / hypot(self.stretched_rate, self._explicit_rate)

    def own_limit_s(self, thread_rate: float = 0.0) -> float:
        """As of :func:`own_step_limit`."""
        model = self.model
        upper = self._own_bound + model.explicit.rate_bound(model.inverse_mass) + thread_rate
        own = 2.0 * model.units.time_s / sqrt(upper) if upper > 0.0 else inf
        return own if thread_rate else max(own, self.limit_s)

    def pace(self, step_s: float) -> float:
        """How many times as long as a step those of elements may be, 1 or more; 1 with springs.

        Up to :func:`pace_part` of the lattice's own limit: of 1,000 violent scripts none breaks down then
        (``python -m tests.stress.many_violent_scripts cpu``).
        """
        if not self.model.law.is_element or self.own_limit_s() == inf:
            return 1.0
        return pace_at((2.0 / self.own_limit_s()) ** 2, step_s, self.model.law)


def step_limit(model: LatticeModel) -> float:
    """Largest time step that is known to be stable at rest, 2 / sqrt(20 k/m) for springs of any shape, in s.

    Less for explicit springs and other ratios than 1/4.
    """
    return StepSizes(model).limit_s


def own_step_limit(model: LatticeModel, thread_rate: float = 0.0) -> float:
    """Largest time step that is stable at rest for this very lattice, s: at most 1% below it, and never above.

    Never below :func:`step_limit` where there are no threads; infinite where nothing can move. Ask again after springs
    were removed. ``thread_rate`` is what threads add to omega^2 at most [1 / unit of time^2].
    """
    return StepSizes(model).own_limit_s(thread_rate)


def default_step(model: LatticeModel) -> float:
    """Time step that suits tissue however it is deformed, 0.8 x 2 / sqrt(24 k/m) for springs, in s."""
    return StepSizes(model).default_s


def explicit_rate_limit(model: LatticeModel, step_s: float) -> float:
    """What explicit springs may add to omega^2 at a step, so that lattice and they stay stable [1 / unit of time^2].

    A tenth of the step is left over. Zero where the step leaves nothing for them.
    """
    lattice = (StepSizes(model).stretched_rate * model.units.time_s) ** 2
    return max((2.0 / (1.1 * step_s / model.units.time_s)) ** 2 - lattice, 0.0)


def checked_step(sizes: StepSizes, step_s: float | None) -> float:
    """The step asked for, or the default.

    Raises
    ------
    SimulationError
        The step is not above zero, or beyond the lattice's own limit.
    """
    if step_s is None:
        return sizes.default_s
    limit = sizes.limit_s
    if not 0.0 < step_s <= limit:
        limit = sizes.own_limit_s()
    if not 0.0 < step_s <= limit or step_s == inf:
        raise SimulationError(
            f"a step of {step_s:.6g} s is not stable: this case's bound is {limit:.6g} s; give at most that, "
            f"or leave it out for {sizes.default_s:.6g} s",
            place="step_s",
        )
    return step_s


def pace_part(law: ForceLaw) -> float:
    """Part of a lattice's own limit that the longer steps of elements may have: 0.8 at a ratio of 1/4, 0.65 at 0.45.

    Nearer to 1/2 an element is stiffer by more when it is squeezed or stretched: at 0.8, of 60 blocks of
    ratio 0.45 that were pulled and let go without damping, four broke down.
    """
    return STEP_SAFETY - 0.75 * max(law.poissons_ratio - RATIO_MIN, 0.0)


def pace_at(rate: float, step: float, law: ForceLaw) -> float:
    """How many times as long as a step those of tissue may be whose omega^2 at rest is no more than a rate, 1 or more.

    In units that go together; infinite where the rate is zero.
    """
    return max(1.0, pace_part(law) * 2.0 / (sqrt(rate) * step)) if rate > 0.0 else inf


def checked_pace(sizes: StepSizes, step_s: float, pace: float) -> float:
    """How many times as long as a step those of elements may be; 1 with springs.

    Raises
    ------
    SimulationError
        It is below 1, or its steps would be beyond the lattice's own limit.
    """
    if not pace >= 1.0:
        raise SimulationError(f"a pace of {pace}: give 1 for steps as they are, or more", place="pace")
    if pace == 1.0 or not sizes.model.law.is_element:
        return 1.0
    limit = sizes.own_limit_s()
    if pace * step_s > limit:
        raise SimulationError(
            f"at a pace of {pace:.6g} steps are {pace * step_s:.6g} s, and this case's bound is {limit:.6g} s: give "
            f"at most {max(1.0, limit / step_s):.6g}",
            place="pace",
        )
    return float(pace)
