"""Verlet in displacement-and-velocity form, with mass-proportional damping.

The equation of motion m a = f(u) - c m v + m g (thesis 8.1), with a and v as central differences about the time of u::

    v(t + s/2) = keep v(t - s/2) + kick (f(u(t)) / m + g)      keep = (1 - c s/2) / (1 + c s/2)
    u(t + s)   = u(t) + s v(t + s/2)                           kick = s / (1 + c s/2)

is of second order, and stable up to s = 2/omega with any damping. A node of no inverse mass keeps its velocity: at zero
it is fixed, otherwise it is led by a hand.

A row of steps may be taken in fewer, longer ones (:meth:`Verlet.row`). Its first step then goes from the velocity half
a step of the old length before to that half a new one after, and at its end the velocity is brought to where it would
be after old ones, by the force there: what follows from a state never depends on how the row before was taken.

A free node moves at most half a cell along each axis in a step. That is about the speed of sound in the tissue, which
nothing in surgery comes near; beyond it no step resolves what happens, and energy would come from nowhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from heartcase.schemas.arrays import Float, Float64
from heartcase.simulator.dynamics.measures import elastic_energy_of
from heartcase.simulator.forces.reference import elastic_forces
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State

__all__ = ["Energy", "Numbers", "Row", "Verlet", "energy", "runge_kutta_step", "staggered", "verlet_step"]


WAY_LIMIT = 0.5
"""Most that a free node moves along an axis in one step [cells]."""


PACED_STEPS_LEAST = 24
"""Steps of a row from which on it is taken in longer ones: where short rows of several lengths take turns, so do the
lengths of their steps, and each turn may swing up what is quickest."""
Numbers = tuple[float, ...]
"""Step, keep, kick, the three components of gravity and the speed limit, as the kernels want them."""


@dataclass(frozen=True)
class Row:
    """How a row of steps is taken."""

    step_count: int
    """Steps to take."""
    first: Numbers
    """Of the first of them."""
    others: Numbers
    """Of the others."""
    last: Numbers | None
    """Of what brings the velocity to half a step of the scheme behind, and moves nothing, where steps are longer."""
    still: tuple[float, float]
    """As of Verlet, for steps of this length."""

    def numbers_of(self, step_number: int) -> Numbers:
        """Numbers of a step, from 0 on."""
        return self.others if step_number else self.first


@dataclass(frozen=True)
class Verlet:
    """The scheme's constants, in grid units."""

    step: float
    """Time step [units of time]."""
    damping: float = 0.0
    """c in a = f/m - c v [1 / unit of time]."""
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Acceleration on every free node, grid axes [cells / unit of time squared]."""

    still: tuple[float, float] = (0.0, 0.0)
    """Speed below which a node is still, and change of its velocity in a step [cells / unit of time]. The CPU's engine
    leaves out tissue around which all is still; at zero none."""

    pace: float = 1.0
    """How many times as long the steps of a row may be, at most."""

    def row(self, step_count: int) -> Row:
        """How so many steps are taken: as they are, or as few longer ones of one length as the pace allows."""
        count = ceil(step_count / self.pace) if step_count >= PACED_STEPS_LEAST else step_count
        if count == step_count:
            return Row(count, self.numbers, self.numbers, None, self.still)
        length = self.step * step_count / count
        first = self._numbers(0.5 * (self.step + length), length, length)
        last = self._numbers(0.5 * (length - self.step), length, 0.0)
        speed, change = self.still
        return Row(count, first, self._numbers(length, length, length), last, (speed, change * length / self.step))

    def _numbers(self, between: float, length: float, way: float) -> Numbers:
        """Of a step from one velocity to that a time after, in a row of steps of a length, that moves on for a time."""
        keep = (1.0 - self.damping * between / 2) / (1.0 + self.damping * between / 2)
        kick = between / (1.0 + self.damping * between / 2)
        return (way, keep, kick, *self.gravity, WAY_LIMIT / length if length else 0.0)

    @property
    def keep(self) -> float:
        """Fraction of the velocity that a step keeps."""
        return self.numbers[1]

    @property
    def kick(self) -> float:
        """Velocity per acceleration that a step adds."""
        return self.numbers[2]

    @property
    def speed_limit(self) -> float:
        """Largest component of a free node's velocity [cells / unit of time], in steps as long as the pace allows."""
        return self.numbers[6] / self.pace

    @property
    def numbers(self) -> Numbers:
        """Of a step among others of its length."""
        return self._numbers(self.step, self.step, self.step)


def next_velocity(numbers: Numbers, velocity: Float64, force: Float64, inverse_mass: Float64) -> Float64:
    """Velocity after the forces, from that before; (node_count, 3) and (node_count,)."""
    _, keep, kick, *gravity, limit = numbers
    mass_inverse = inverse_mass[:, None]
    free = np.clip(keep * velocity + kick * (force * mass_inverse + np.array(gravity)), -limit, limit)
    return np.where(mass_inverse > 0, free, velocity)


def verlet_step(
    model: LatticeModel,
    verlet: Verlet,
    displacement: Float64,
    velocity: Float64,
    inverse_mass: Float64,
    *,
    more: Float64 | None = None,
    numbers: Numbers | None = None,
) -> tuple[Float64, Float64]:
    """One step of the reference; arrays of shape (node_count, 3) and (node_count,), all in grid units.

    ``more``: forces besides those of the lattice, where there are any. ``numbers``: those of the step, where it is not
    one among others of the scheme's length.

    Returns
    -------
    displacement, velocity
        A step later, float64.
    """
    force = elastic_forces(model, displacement)
    numbers = numbers or verlet.numbers
    velocity = next_velocity(numbers, velocity, force if more is None else force + more, inverse_mass)
    return displacement + numbers[0] * velocity, velocity


def runge_kutta_step(
    model: LatticeModel, verlet: Verlet, displacement: Float64, velocity: Float64, inverse_mass: Float64
) -> tuple[Float64, Float64]:
    """One step of the classical Runge-Kutta method of fourth order: the truth that other schemes are measured by.

    Four evaluations of the forces a step, and stable up to 2.8/omega without damping (Hairer, Norsett and Wanner,
    Solving Ordinary Differential Equations I, II.1), hence no way to simulate.

    Parameters
    ----------
    model
        The lattice.
    verlet
        Step, damping and gravity.
    displacement, velocity
        At the SAME time, float64, shape (node_count, 3), grid units.
    inverse_mass
        Nodes at zero keep their velocity, shape (node_count,).

    Returns
    -------
    displacement, velocity
        A step later, at the same time.
    """
    mass_inverse = inverse_mass[:, None]
    is_free = mass_inverse > 0
    gravity = np.array(verlet.gravity)

    def acceleration(u: Float64, v: Float64) -> Float64:
        return np.where(is_free, elastic_forces(model, u) * mass_inverse + gravity - verlet.damping * v, 0.0)

    h = verlet.step
    v1, a1 = velocity, acceleration(displacement, velocity)
    v2 = velocity + 0.5 * h * a1
    a2 = acceleration(displacement + 0.5 * h * v1, v2)
    v3 = velocity + 0.5 * h * a2
    a3 = acceleration(displacement + 0.5 * h * v2, v3)
    v4 = velocity + h * a3
    a4 = acceleration(displacement + h * v3, v4)
    return displacement + h / 6 * (v1 + 2 * v2 + 2 * v3 + v4), velocity + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def staggered(model: LatticeModel, verlet: Verlet, displacement: Float64, velocity: Float64) -> Float64:
    """Velocity half a step earlier, from that at the time of the displacement: how to start from a moving state."""
    mass = model.node_mass[:, None].astype(float)
    acceleration = elastic_forces(model, displacement) / mass + np.array(verlet.gravity) - verlet.damping * velocity
    earlier: Float64 = velocity - 0.5 * verlet.step * acceleration
    return earlier


@dataclass(frozen=True)
class Energy:
    """Energies at one time, J."""

    kinetic_j: float
    """Of the moving masses."""
    elastic_j: float
    """In springs and cells."""

    @property
    def total_j(self) -> float:
        """Kinetic and elastic."""
        return self.kinetic_j + self.elastic_j


def energy(
    model: LatticeModel,
    verlet: Verlet,
    state: State,
    *,
    force: Float,
    inverse_mass: Float,
) -> Energy:
    """Energies at the time of the displacement; the velocity is the mean of those half a step before and after.

    ``force`` are the spring forces at the displacement, shape (node_count, 3), ``inverse_mass`` is zero where a node
    is fixed or led, shape (node_count,); grid units.
    """
    before = state.velocity.astype(float)
    after = next_velocity(verlet.numbers, before, force.astype(float), inverse_mass.astype(float))
    speed_squared = ((0.5 * (before + after)) ** 2).sum(axis=1)
    unit = model.units.energy_j
    return Energy(
        kinetic_j=float(0.5 * (model.node_mass * speed_squared).sum() * unit),
        elastic_j=float(elastic_energy_of(model, state.displacement) * unit),
    )
