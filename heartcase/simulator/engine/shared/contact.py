"""Contact with probes: nodes are pushed out of them, only so far that no cell turns inside out.

A probe is an ellipsoid, or a ball swept along a line: a capsule. After a step, a free node inside it is moved to its
surface, away from its axis (thesis 8.7.1). That is continuous in time: a node that was on another side of the probe
before the step, in the probe's own frame, has been run over in it, however far it has come; it is put where the probe
met it, and so goes ahead of it. Then movements in the cells near a probe are shortened so that no corner is turned
(:mod:`heartcase.simulator.engine.shared.turning`). The velocity becomes what was really moved.

What that changes of a node's momentum is what the probe gave it. The force on the probe is the opposite of all it gave
in a row of steps, over the time that they took; its torque is about the probe's centre in each step.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Float64, Intp
from heartcase.simulator.engine.shared.turning import allowed_parts, comes_to_harm, least_volumes
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import LOOK_BELOW

__all__ = ["FAR", "NEAR", "NO_PROBES", "PROBE_SIZE", "PUSHED", "keep_outside", "make_contact", "moved_on", "probe_row"]


REACH = 2.0
"""Distance from a probe's surface, on the way to its axis, within which cells are looked after [cells]."""
FAR, NEAR, PUSHED = 0, 1, 2
"""What a node has to do with a probe in a step."""
SAME_SIDE = 0.5
"""Cosine between a node's directions from the probe's axis before and after a step, from which on it has slid along the
surface and was not run over; in the frame in which an ellipsoid is a ball."""
_MARCHES, _MET = 24, 1e-4

PROBE_SIZE = 20
"""Numbers of a probe: centre, its movement in a step, shape (row by row), reach, square of the radius around it all,
half of the axis of a capsule."""
NO_PROBES: Float32 = np.zeros((0, PROBE_SIZE), np.float32)
"""No probes, as an engine wants them."""


def probe_row(
    centre: npt.ArrayLike,
    movement: npt.ArrayLike,
    semi_axes: npt.ArrayLike,
    turn: npt.ArrayLike,
    half_axis: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Float32:
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
    half_axis
        From the centre to an end of the line that the shape is swept along [cells, grid axes], shape (3,); only for a
        ball, which then is a capsule.
    """
    axes, rotation = np.asarray(semi_axes, dtype=float), np.asarray(turn, dtype=float)
    shape = rotation @ np.diag(1.0 / axes) @ rotation.T
    around = (axes.max() + float(np.linalg.norm(half_axis)) + REACH) ** 2
    row = [np.ravel(centre), np.ravel(movement), shape.ravel(), [REACH, around], np.ravel(half_axis)]
    return np.concatenate(row).astype(np.float32)


def keep_outside(
    model: LatticeModel,
    probes: Float32,
    step_number: int,
    step: float,
    inverse_mass: Float64,
    displacement: Float64,
    later: Float64,
    velocity: Float64,
) -> tuple[Float64, Float64, Float64]:
    """The reference: displacements and velocities after a step, with the probes where they are by then.

    Parameters
    ----------
    model
        The lattice.
    probes
        Probes, shape (probe_count, PROBE_SIZE); where there are none, nothing is done.
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
        The same where nothing was done.
    impulse
        What each probe gave to the nodes: momentum, and its moment about the probe's centre [grid units], shape
        (probe_count, 6).
    """
    later, velocity = later.copy(), velocity.copy()
    near = np.zeros(model.node_count, dtype=np.intp)
    impulse = np.zeros((len(probes), 6))
    free = np.flatnonzero(inverse_mass > 0)
    for number, row in enumerate(probes.astype(np.float64)):
        centre = row[:3] + (step_number + 1) * row[3:6]
        before = model.node_index[free] + displacement[free] - (centre - row[3:6])
        after = model.node_index[free] + later[free] - centre
        target, contact = _pushed(row, before, after)
        near[free[contact > FAR]] = number + 1
        pushed = contact == PUSHED
        nodes = free[pushed]
        later[nodes] += target[pushed] - after[pushed]
        new = (later[nodes] - displacement[nodes]) / step
        _give(impulse[number], (new - velocity[nodes]) / inverse_mass[nodes, None], before[pushed] - row[3:6])
        velocity[nodes] = new
    part, owner = _parts(model, near, len(probes) > 0, inverse_mass, displacement, later)
    held = np.flatnonzero(part < 1.0)
    lost = (part[held, None] - 1.0) * velocity[held] / inverse_mass[held, None]
    for number, row in enumerate(probes.astype(np.float64)):
        own = owner[held] == number + 1
        centre = row[:3] + (step_number + 1) * row[3:6]
        _give(impulse[number], lost[own], (model.node_index + displacement)[held[own]] - centre)
    later[held] = displacement[held] + part[held, None] * (later[held] - displacement[held])
    velocity[held] *= part[held, None]
    return later, velocity, impulse


def _give(total: Float64, impulse: Float64, arm: Float64) -> None:
    """Add impulses, shape (count, 3), and their moments."""
    total[:3] += impulse.sum(axis=0)
    total[3:] += np.cross(arm, impulse).sum(axis=0)


def _from_axis(row: Float64, p: Float64) -> Float64:
    """Vectors to places, from the nearest places of the axis; both from the centre, shape (count, 3)."""
    half = row[17:20]
    if not half.any():
        return p
    along: Float64 = p - np.clip(p @ half / (half @ half), -1.0, 1.0)[:, None] * half
    return along


def _pushed(row: Float64, before: Float64, after: Float64) -> tuple[Float64, Intp]:
    """Where nodes go, from the centre, and what they have to do with the probe, shape (count,)."""
    shape, reach, around = row[6:15].reshape(3, 3), row[15], row[16]
    target = after.copy()
    d0, d1 = _from_axis(row, before), _from_axis(row, after)
    a0, a1 = d0 @ shape.T, d1 @ shape.T
    r0, r1 = np.linalg.norm(a0, axis=1), np.linalg.norm(a1, axis=1)
    is_near = (np.linalg.norm(d1, axis=1) * (r1 - 1.0) < reach * r1) | (r1 == 0.0)
    is_seen = ((before**2).sum(axis=1) <= around) | ((after**2).sum(axis=1) <= around)
    is_same_side = ((a0 * a1).sum(axis=1) > SAME_SIDE * r0 * r1) | (r0 == 0.0)
    slid = is_seen & is_same_side & (r1 < 1.0) & (r1 > 0.0)
    target[slid] += (1.0 / r1[slid] - 1.0)[:, None] * d1[slid]
    held = is_seen & ~is_same_side & (r0 < 1.0)
    target[held] = before[held] + (1.0 / r0[held] - 1.0)[:, None] * d0[held]
    met = np.zeros(len(after), dtype=bool)
    for node in np.flatnonzero(is_seen & ~is_same_side & (r0 >= 1.0)):
        way = after[node] - before[node]
        length, part = float(np.linalg.norm(shape @ way)), 0.0
        for _ in range(_MARCHES):
            place = before[node] + part * way
            gap = float(np.linalg.norm(shape @ _from_axis(row, place[None])[0])) - 1.0
            if gap <= _MET or part >= 1.0:
                break
            part += gap / length
        if part < 1.0:
            met[node], target[node] = True, place
    contact = np.where(slid | held | met, PUSHED, np.where(is_seen & is_near, NEAR, FAR))
    return target, contact


def _parts(
    model: LatticeModel, near: Intp, has_probes: bool, inverse_mass: Float64, displacement: Float64, later: Float64
) -> tuple[Float64, Intp]:
    """Parts of their movements that nodes may take, and the probe to whose account that goes, from one on."""
    corners = model.cell_corners
    owner_of_cell = near[corners].max(axis=1)
    looks_after_flat = model.law.has_corner_guard and has_probes
    volume_most = LOOK_BELOW if looks_after_flat else 0.0
    part, owner = np.ones(model.node_count), np.zeros(model.node_count, dtype=np.intp)
    is_due = owner_of_cell > 0
    if volume_most:
        is_due |= least_volumes(displacement[corners]) < volume_most
        is_due |= comes_to_harm(displacement[corners], (later - displacement)[corners])
    cells = np.flatnonzero(model.cell_is_whole & is_due)
    if not len(cells):
        return part, owner
    at = corners[cells]
    is_free = (inverse_mass > 0)[at]
    is_near = owner_of_cell[cells] > 0
    allowed, harm = allowed_parts(displacement[at], (later - displacement)[at], is_free, is_near, volume_most)
    if not harm:
        return part, owner
    # The cell that allows least has the probe; of equal ones that around the lowest corner.
    for corner in range(8):
        less = allowed[:, corner] < part[at[:, corner]]
        part[at[less, corner]] = allowed[less, corner]
        owner[at[less, corner]] = owner_of_cell[cells[less]]
    return part, owner


def make_contact(compiled: Callable[[Any], Any]) -> Any:
    """The scalar function of the kernels, for one target of numba.

    Parameters
    ----------
    compiled
        Makes a function that kernels of the target can call.

    Returns
    -------
    pushed_out
        ``(rest, own, u, probe, step_number)`` to displacement and FAR, NEAR or PUSHED, with the displacements before
        and after the step.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    same_side, met = np.float32(SAME_SIDE), np.float32(_MET)

    @compiled
    def from_axis(p, probe):
        hx, hy, hz = probe[17], probe[18], probe[19]
        squared = hx * hx + hy * hy + hz * hz
        if squared == zero:
            return p
        t = min(max((p[0] * hx + p[1] * hy + p[2] * hz) / squared, -one), one)
        return (p[0] - t * hx, p[1] - t * hy, p[2] - t * hz)

    @compiled
    def shaped(d, probe):
        return (
            probe[6] * d[0] + probe[7] * d[1] + probe[8] * d[2],
            probe[9] * d[0] + probe[10] * d[1] + probe[11] * d[2],
            probe[12] * d[0] + probe[13] * d[1] + probe[14] * d[2],
        )

    @compiled
    def size(a):
        return np.float32(sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]))

    @compiled
    def part_until_met(p0, way, probe):
        """Part of a way from outside until the surface, one where it is not met."""
        length, part = size(shaped(way, probe)), zero
        for _ in range(_MARCHES):
            place = (p0[0] + part * way[0], p0[1] + part * way[1], p0[2] + part * way[2])
            gap = size(shaped(from_axis(place, probe), probe)) - one
            if gap <= met or part >= one:
                break
            part += gap / length
        return min(part, one)

    @compiled
    def pushed_out(rest, own, u, probe, step_number):
        steps = np.float32(step_number + 1)
        cx, cy, cz = probe[0] + steps * probe[3], probe[1] + steps * probe[4], probe[2] + steps * probe[5]
        p1 = (rest[0] - cx + u[0], rest[1] - cy + u[1], rest[2] - cz + u[2])
        p0 = (rest[0] - cx + probe[3] + own[0], rest[1] - cy + probe[4] + own[1], rest[2] - cz + probe[5] + own[2])
        squared0 = p0[0] * p0[0] + p0[1] * p0[1] + p0[2] * p0[2]
        squared1 = p1[0] * p1[0] + p1[1] * p1[1] + p1[2] * p1[2]
        if squared0 > probe[16] and squared1 > probe[16]:
            return u, 0
        d0, d1 = from_axis(p0, probe), from_axis(p1, probe)
        a0, a1 = shaped(d0, probe), shaped(d1, probe)
        r0, r1 = size(a0), size(a1)
        contact = 1 if size(d1) * (r1 - one) < probe[15] * r1 or r1 == zero else 0
        if r0 == zero or a0[0] * a1[0] + a0[1] * a1[1] + a0[2] * a1[2] > same_side * r0 * r1:
            if r1 >= one or r1 == zero:
                return u, contact
            outward = one / r1 - one
            return (u[0] + outward * d1[0], u[1] + outward * d1[1], u[2] + outward * d1[2]), 2
        way = (p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2])
        part, outward = zero, zero
        if r0 < one:
            outward = one / r0 - one
        else:
            part = part_until_met(p0, way, probe)
            if part >= one:
                return u, contact
        back = part - one
        return (
            u[0] + back * way[0] + outward * d0[0],
            u[1] + back * way[1] + outward * d0[1],
            u[2] + back * way[2] + outward * d0[2],
        ), 2

    return pushed_out


def moved_on(probes: Float32, step_count: int) -> Float32:
    """The probes after some steps."""
    moved = probes.copy()
    moved[:, :3] += np.float32(step_count) * moved[:, 3:6]
    return moved
