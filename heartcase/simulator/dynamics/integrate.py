"""Verlet in displacement-and-velocity form, with mass-proportional damping.

The equation of motion m a = f(u) - c m v + m g (thesis 8.1), with a and v as central differences about the time of u::

    v(t + s/2) = keep v(t - s/2) + kick (f(u(t)) / m + g)      keep = (1 - c s/2) / (1 + c s/2)
    u(t + s)   = u(t) + s v(t + s/2)                           kick = s / (1 + c s/2)

is of second order, and stable up to s = 2/omega with any damping. A node of no inverse mass keeps its velocity: at zero
it is fixed, otherwise it is led by a hand.

A free node moves at most half a cell along each axis in a step. That is about the speed of sound in the tissue, which
nothing in surgery comes near; beyond it no step resolves what happens, and energy would come from nowhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float, Float64
from heartcase.simulator.dynamics.measures import elastic_energy_of
from heartcase.simulator.forces.reference import elastic_forces
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State

__all__ = ["Energy", "Verlet", "energy", "runge_kutta_step", "staggered", "verlet_step"]


WAY_LIMIT = 0.5
"""Most that a free node moves along an axis in one step [cells]."""


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

    @property
    def keep(self) -> float:
        """Fraction of the velocity that a step keeps."""
        return (1.0 - self.damping * self.step / 2) / (1.0 + self.damping * self.step / 2)

    @property
    def kick(self) -> float:
        """Velocity per acceleration that a step adds."""
        return self.step / (1.0 + self.damping * self.step / 2)

    @property
    def speed_limit(self) -> float:
        """Largest component of a free node's velocity [cells / unit of time]."""
        return WAY_LIMIT / self.step if self.step else 0.0

    @property
    def numbers(self) -> tuple[float, ...]:
        """Step, keep, kick, the three components of gravity and the speed limit, as the kernels want them."""
        return (self.step, self.keep, self.kick, *self.gravity, self.speed_limit)


def next_velocity(verlet: Verlet, velocity: Float64, force: Float64, inverse_mass: Float64) -> Float64:
    """Velocity half a step after the forces, from that half a step before; (node_count, 3) and (node_count,)."""
    mass_inverse = inverse_mass[:, None]
    acceleration = force * mass_inverse + np.array(verlet.gravity)
    limit = verlet.speed_limit
    free = np.clip(verlet.keep * velocity + verlet.kick * acceleration, -limit, limit)
    return np.where(mass_inverse > 0, free, velocity)


def verlet_step(
    model: LatticeModel,
    verlet: Verlet,
    displacement: Float64,
    velocity: Float64,
    inverse_mass: Float64,
    *,
    more: Float64 | None = None,
) -> tuple[Float64, Float64]:
    """One step of the reference; arrays of shape (node_count, 3) and (node_count,), all in grid units.

    ``more``: forces besides those of the lattice, where there are any.

    Returns
    -------
    displacement, velocity
        A step later, float64.
    """
    force = elastic_forces(model, displacement)
    velocity = next_velocity(verlet, velocity, force if more is None else force + more, inverse_mass)
    return displacement + verlet.step * velocity, velocity


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
    after = next_velocity(verlet, before, force.astype(float), inverse_mass.astype(float))
    speed_squared = ((0.5 * (before + after)) ** 2).sum(axis=1)
    unit = model.units.energy_j
    return Energy(
        kinetic_j=float(0.5 * (model.node_mass * speed_squared).sum() * unit),
        elastic_j=float(elastic_energy_of(model, state.displacement) * unit),
    )
