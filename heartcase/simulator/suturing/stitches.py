"""Stitches: a thread from one place in tissue to another, drawn, tied and taken out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Float64, Int32
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.tethers import END_NODES, NO_LIMIT, Tethers
from heartcase.simulator.suturing.places import Place, cell_of, nodes_and_weights

__all__ = [
    "Stitch",
    "StitchState",
    "bind",
    "checked_length",
    "ends_of",
    "fitting_stiffness",
    "softened",
    "tethers_of",
]


@dataclass(eq=False)
class Stitch:
    """A thread between two places, in grid units."""

    places: tuple[Place, Place]
    """Where it goes through the tissue."""
    nodes: Int32
    """Nodes that the first place follows, then those of the second, shape (16,)."""
    shares: Float32
    """Minus the weights of the first, then those of the second, shape (16,)."""
    stiffness: float
    """Stiffness of the thread [k]."""
    length: float
    """Length of the thread between the places, up to which it is slack [cells]."""
    length_target: float
    """Length at the end of the next steps [cells]."""
    tension_most: float = NO_LIMIT
    """Tension that it is drawn with [grid units of force]; NO_LIMIT where its length is held."""
    tension_target: float = NO_LIMIT
    """That tension at the end of the next steps."""
    is_tied: bool = False
    """Whether its length is fixed by a knot."""
    name: str = "stitch"
    """Name in messages."""
    row: str = ""
    """Row that it belongs to; empty for none."""
    is_running: bool = False
    """Whether one thread runs through all stitches of its row."""


@dataclass(frozen=True)
class StitchState:
    """A stitch at a moment."""

    name: str
    """Its name."""
    is_tied: bool
    """Whether it is tied."""
    places_mm: Float64
    """Where it goes through the tissue now, LPS mm, shape (2, 3)."""
    force_n: float
    """Tension of the thread: the force on the tissue at both places, N."""
    length_mm: float
    """Length of the thread between them, mm; while it is drawn with a tension, its length without that."""
    distance_mm: float
    """How far the places are apart, mm: more than the length by what the thread is stretched."""
    row: str = ""
    """Row that it belongs to; empty for none."""
    is_running: bool = False
    """Whether one thread with one tension runs through all stitches of its row."""
    drawn_n: float | None = None
    """Tension that it is drawn with, N; None where its length is held, as when it is tied."""


def bind(model: LatticeModel, cuts: Cuts | None, places: tuple[Place, Place]) -> tuple[Int32, Float32]:
    """Nodes and shares of a stitch between two places, in the lattice that some cuts leave, shape (16,) each."""
    ends = [nodes_and_weights(model, cell_of(place, cuts), place.local) for place in places]
    (first, minus), (second, plus) = ends
    return np.concatenate([first, second]), np.concatenate([-minus, plus]).astype(np.float32)


def tethers_of(model: LatticeModel, stitches: Sequence[Stitch], step_count: int = 0) -> Tethers:
    """Stitches as the engines take them; in so many steps each comes to its target."""
    if not stitches:
        return Tethers.none()
    shares = np.stack([stitch.shares for stitch in stitches])
    nodes = np.stack([stitch.nodes for stitch in stitches])
    now = np.array([(stitch.length, stitch.tension_most) for stitch in stitches])
    target = np.array([(stitch.length_target, stitch.tension_target) for stitch in stitches])
    return Tethers(
        nodes.astype(np.int32),
        shares,
        np.einsum("tn,tnx->tx", shares.astype(np.float64), model.node_index[nodes].astype(np.float64)),
        np.array([stitch.stiffness for stitch in stitches], np.float32),
        now[:, 0],
        now[:, 1],
        (target - now) / step_count if step_count else np.zeros_like(now),
    )


def fitting_stiffness(
    model: LatticeModel, present: Tethers, new: Tethers, limit: float, wanted: float | None, *, name: str
) -> float:
    """Stiffness of new threads [k], all alike: that which is wanted, or as much as the time step leaves.

    Parameters
    ----------
    model
        The lattice.
    present
        Threads that are there.
    new
        Those that come, of any stiffness, at least one.
    limit
        What all may add to the largest omega^2 [1 / unit of time^2].
    wanted
        Stiffness [k]; when left out, half of what the step and the others leave.
    name
        Name in messages.

    Raises
    ------
    SimulationError
        The step leaves nothing, or not as much as is wanted.
    """
    without, one = (_together(present, new, stiffness).rate_bounds(model.inverse_mass) for stiffness in (0.0, 1.0))
    slope = one - without
    if not slope.any():
        raise SimulationError("both places are in tissue that is held for good: nothing would move", place=name)
    # The bounds are linear in the stiffness.
    room = float(((limit - without)[slope > 0] / slope[slope > 0]).min())
    if room <= 0.0:
        raise SimulationError("other springs and threads leave this one nothing: give a smaller step", place=name)
    if wanted is None:
        return float(np.float32(0.5 * room))
    if wanted > room:
        unit = model.units.force_n / model.units.length_m
        raise SimulationError(
            f"a thread of {wanted * unit:.3g} N/m is stiffer than the time step allows here: give "
            f"{room * unit:.3g} N/m or less, or a smaller step",
            place=name,
        )
    return wanted


def _together(present: Tethers, new: Tethers, stiffness: float) -> Tethers:
    """Threads that are there, and new ones of a stiffness."""
    return present.with_more(replace(new, stiffness=np.full(new.count, stiffness, np.float32)))


def softened(tethers: Tethers, inverse_mass: Float32, limit: float) -> Float64:
    """Stiffness of each [k], less where it is more than a time step allows, shape (count,).

    Each is lowered by what the highest bound of those that share a node with it is above the limit: so all are within.
    """
    bounds = tethers.rate_bounds(inverse_mass)
    part = np.minimum(1.0, np.divide(limit, bounds, out=np.ones_like(bounds), where=bounds > 0))
    used = np.where(tethers.shares != 0, part[:, None], 1.0)
    at_node = np.ones(len(inverse_mass))
    np.minimum.at(at_node, tethers.nodes.ravel(), used.ravel())
    least = np.where(tethers.shares != 0, at_node[tethers.nodes], 1.0).min(axis=1, initial=1.0)
    lowered: Float64 = tethers.stiffness.astype(np.float64) * least
    return lowered


def checked_length(value: float | None, cell_mm: float, name: str) -> float | None:
    """A length given in mm, in cells.

    Raises
    ------
    SimulationError
        It is not a finite number, or below zero.
    """
    if value is None:
        return None
    if not (np.isfinite(value) and value >= 0.0):
        raise SimulationError(f"a thread of {value} mm cannot be: give 0 mm or more", place=name)
    return float(value) / cell_mm


def ends_of(stitch: Stitch, model: LatticeModel, displacement: npt.ArrayLike) -> Float64:
    """Where the places of a stitch are [cells, frame of the nodes], shape (2, 3)."""
    at = model.node_index[stitch.nodes] + np.asarray(displacement)[stitch.nodes].astype(np.float64)
    weights = np.abs(stitch.shares.astype(np.float64)).reshape(2, END_NODES)
    ends: Float64 = np.einsum("en,enx->ex", weights, at.reshape(2, END_NODES, 3))
    return ends
