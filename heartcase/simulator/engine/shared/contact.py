"""Contact with probes: nodes are pushed out of them, only so far that no cell turns inside out.

After a step, a free node inside a probe's ellipsoid is moved to its surface, away from its centre (thesis 8.7.1). Near
a probe, a node's movement of the step is then shortened so that it takes at most a tenth of what each corner that it
spans with its neighbours along the axes has above a tenth of a cell. The neighbours are held by corners of their own,
which is why some cells still turn inside out where a probe presses tissue against what is fixed, but few. The velocity
becomes what was really moved.

A corner has the volume s (a . b x c), with a, b, c the vectors to the three neighbours and s the sign of its octant; a
movement m of the node takes s m . (a x b + b x c + c x a) from it, exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Float64, Intp
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel

__all__ = ["NO_PROBES", "PROBE_SIZE", "keep_outside", "make_contact", "moved_on", "probe_row"]


SHARE = 0.1
"""Part of a corner's volume above the floor that one node may take in one step."""
FLOOR = 0.1
"""Volume of a corner from which on no movement near a probe takes any more [cells]."""
REACH = 2.0
"""Distance from a probe's surface, on the way to its centre, within which movements are shortened [cells]."""

PROBE_SIZE = 17
"""Numbers of a probe: centre, its movement in a step, shape (row by row), reach, square of the radius around it all."""
NO_PROBES: Float32 = np.zeros((0, PROBE_SIZE), np.float32)
"""No probes, as an engine wants them."""

_AXES = tuple(int(np.flatnonzero((axis == DIRECTIONS).all(axis=1))[0]) for axis in np.eye(3, dtype=int))
"""Numbers of the directions along i, j and k."""


def probe_row(centre: npt.ArrayLike, movement: npt.ArrayLike, semi_axes: npt.ArrayLike, turn: npt.ArrayLike) -> Float32:
    """A probe as the kernels read it, float32, shape (PROBE_SIZE,).

    Parameters
    ----------
    centre
        Centre before the first step [cells, grid axes], shape (3,).
    movement
        Way of the centre in one step [cells], shape (3,).
    semi_axes
        Semi-axes of the ellipsoid [cells], above zero, shape (3,).
    turn
        Directions of the semi-axes in its columns, a rotation, shape (3, 3).
    """
    axes, rotation = np.asarray(semi_axes, dtype=float), np.asarray(turn, dtype=float)
    shape = rotation @ np.diag(1.0 / axes) @ rotation.T
    around = (axes.max() + REACH) ** 2
    return np.concatenate([np.ravel(centre), np.ravel(movement), shape.ravel(), [REACH, around]]).astype(np.float32)


def keep_outside(
    model: LatticeModel,
    probes: Float32,
    step_number: int,
    step: float,
    inverse_mass: Float64,
    displacement: Float64,
    later: Float64,
    velocity: Float64,
) -> tuple[Float64, Float64]:
    """The reference: displacements and velocities after a step, with the probes where they are by then.

    Parameters
    ----------
    model
        The lattice.
    probes
        Probes, shape (probe_count, PROBE_SIZE).
    step_number
        Steps that this row of steps has taken before.
    step
        Time step [units of time].
    inverse_mass
        Nodes at zero are led or fixed and go where they will, shape (node_count,).
    displacement, later
        Displacements before and after the step [cells], shape (node_count, 3).
    velocity
        Velocity of the step [cells / unit of time], shape (node_count, 3).

    Returns
    -------
    later, velocity
        The same where no probe is near.
    """
    position = model.node_index + later
    is_near = np.zeros(model.node_count, dtype=bool)
    is_free = inverse_mass > 0
    for row in probes.astype(np.float64):
        centre, shape, reach = row[:3] + (step_number + 1) * row[3:6], row[6:15].reshape(3, 3), row[15]
        way = np.linalg.norm(position - centre, axis=1)
        distance = np.linalg.norm((position - centre) @ shape.T, axis=1)
        is_near |= is_free & (way * (distance - 1.0) < reach * distance)
        is_near |= is_free & (distance < 1.0)
        inside = is_free & (distance < 1.0) & (distance > 0.0)
        position[inside] = centre + (position[inside] - centre) / distance[inside, None]
    near = np.flatnonzero(is_near)
    moved = position[near] - model.node_index[near] - displacement[near]
    moved *= _shares(model, displacement, near, moved)[:, None]
    later, velocity = later.copy(), velocity.copy()
    changed = np.abs(displacement[near] + moved - later[near]).max(axis=1, initial=0.0) > 0
    later[near[changed]] = displacement[near[changed]] + moved[changed]
    velocity[near[changed]] = moved[changed] / step
    return later, velocity


def _shares(model: LatticeModel, displacement: Float64, nodes: Intp, moved: Float64) -> Float64:
    """Part of some nodes' movements that their corners allow, shape (len(nodes),)."""
    to = np.full((2, 3, model.node_count), -1)
    for axis, direction in enumerate(_AXES):
        lower, higher = model.spring_nodes[model.spring_direction == direction].T
        to[0, axis, lower], to[1, axis, higher] = higher, lower
    share = np.ones(len(nodes))
    for octant in range(8):
        sides = [octant >> axis & 1 for axis in range(3)]
        others = np.stack([to[side, axis, nodes] for axis, side in enumerate(sides)], axis=1)
        whole = np.flatnonzero((others >= 0).all(axis=1))
        there = (model.node_index + displacement)[others[whole]]
        a, b, c = np.moveaxis(there - (model.node_index + displacement)[nodes[whole]][:, None], 1, 0)
        sign = (-1.0) ** sum(sides)
        volume = sign * np.einsum("nx,nx->n", a, np.cross(b, c))
        loss = sign * np.einsum("nx,nx->n", moved[whole], np.cross(a, b) + np.cross(b, c) + np.cross(c, a))
        allowed = SHARE * np.maximum(volume - FLOOR, 0.0)
        limits = np.divide(allowed, loss, out=np.ones(len(whole)), where=loss > allowed)
        share[whole] = np.minimum(share[whole], limits)
    return share


def make_contact(compiled: Callable[[Any], Any]) -> tuple[Any, Any]:
    """The scalar functions of the kernels, for one target of numba.

    Parameters
    ----------
    compiled
        Makes a function that kernels of the target can call.

    Returns
    -------
    pushed_out
        ``(rest, u, probe, step_number)`` to displacement and whether the probe is near.
    allowed_share
        ``(m, ahead, behind, has_ahead, has_behind)``: part of a movement m that the corners allow, with the vectors to
        the neighbours along and against i, j, k, and whether there are any.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    part, floor = np.float32(SHARE), np.float32(FLOOR)

    @compiled
    def pushed_out(rest, u, probe, step_number):
        steps = np.float32(step_number + 1)
        dx = rest[0] - (probe[0] + steps * probe[3]) + u[0]
        dy = rest[1] - (probe[1] + steps * probe[4]) + u[1]
        dz = rest[2] - (probe[2] + steps * probe[5]) + u[2]
        way_squared = dx * dx + dy * dy + dz * dz
        if way_squared > probe[16]:
            return u, False
        x = probe[6] * dx + probe[7] * dy + probe[8] * dz
        y = probe[9] * dx + probe[10] * dy + probe[11] * dz
        z = probe[12] * dx + probe[13] * dy + probe[14] * dz
        distance = np.float32(sqrt(x * x + y * y + z * z))
        if distance >= one or distance == zero:
            return u, np.float32(sqrt(way_squared)) * (distance - one) < probe[15] * distance or distance == zero
        outward = one / distance - one
        return (u[0] + outward * dx, u[1] + outward * dy, u[2] + outward * dz), True

    @compiled
    def corner_share(share, m, a, b, c, sign):
        bx, by, bz = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
        volume = sign * (a[0] * bx + a[1] * by + a[2] * bz)
        # The three products are b x c + a x (b - c).
        ex, ey, ez = b[0] - c[0], b[1] - c[1], b[2] - c[2]
        nx, ny, nz = bx + a[1] * ez - a[2] * ey, by + a[2] * ex - a[0] * ez, bz + a[0] * ey - a[1] * ex
        loss = sign * (m[0] * nx + m[1] * ny + m[2] * nz)
        allowed = part * max(volume - floor, zero)
        return min(share, allowed / loss) if loss > allowed else share

    @compiled
    def allowed_share(m, ahead, behind, has_ahead, has_behind):
        share = one
        if has_ahead[2]:
            if has_ahead[1] and has_ahead[0]:
                share = corner_share(share, m, ahead[0], ahead[1], ahead[2], one)
            if has_ahead[1] and has_behind[0]:
                share = corner_share(share, m, behind[0], ahead[1], ahead[2], -one)
            if has_behind[1] and has_ahead[0]:
                share = corner_share(share, m, ahead[0], behind[1], ahead[2], -one)
            if has_behind[1] and has_behind[0]:
                share = corner_share(share, m, behind[0], behind[1], ahead[2], one)
        if has_behind[2]:
            if has_ahead[1] and has_ahead[0]:
                share = corner_share(share, m, ahead[0], ahead[1], behind[2], -one)
            if has_ahead[1] and has_behind[0]:
                share = corner_share(share, m, behind[0], ahead[1], behind[2], one)
            if has_behind[1] and has_ahead[0]:
                share = corner_share(share, m, ahead[0], behind[1], behind[2], one)
            if has_behind[1] and has_behind[0]:
                share = corner_share(share, m, behind[0], behind[1], behind[2], -one)
        return share

    return pushed_out, allowed_share


def moved_on(probes: Float32, step_count: int) -> Float32:
    """The probes after some steps."""
    moved = probes.copy()
    moved[:, :3] += np.float32(step_count) * moved[:, 3:6]
    return moved
