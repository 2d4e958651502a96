"""How far nodes may move in a step so that no corner of a cell is turned inside out, whichever of its nodes move.

The volume of a corner, det(a, b, c) of the vectors to its three neighbours, is linear in the place of each of its four
nodes by itself. With movements m_0 (apex) and m_1, m_2, m_3 of which parts s_i in 0 to 1 are taken, it changes by

    sum of s_i L_i  +  sum of s_i s_j Q_ij  +  sum of s_i s_j s_k C_ijk

exactly. As s_i s_j <= (s_i + s_j) / 2, and likewise for three, the loss is at most the sum of s_i c_i, where c_i is
what of the negative L_i, of half the negative Q_ij and of a third of the negative C_ijk has to do with node i. Each of
the n free nodes with a c_i takes at most 1 / n of SHARE of what the corner has above FLOOR, whatever the others do;
each node takes the least that its corners allow. So no corner loses more than SHARE of its volume in a step, and none
of a volume above zero is turned.

That also holds back what would not turn a corner if all went together: the more, the flatter it is. So nothing is held
back in a step in which all movements in full would do none of the corners harm that are looked after (:func:`_harms`);
then, too, none is turned. Looked after are corners of cells near a probe, and elsewhere those below LOOK_BELOW, and
others that would come to harm: in quick tissue they may be turned in one step. All this only while there is a probe.

Nodes that are led move as they are led: what they take is counted first. Where they turn a corner by themselves, and
where one is inside out already, nothing is held back.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from heartcase.schemas.arrays import Bool, Float64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS

__all__ = [
    "CORNER_NODES",
    "FLOOR",
    "SHARE",
    "TINY",
    "TurnMath",
    "allowed_parts",
    "comes_to_harm",
    "least_volumes",
    "make_turn_math",
]

SHARE = 0.5
"""Part of a corner's volume above the floor that may be lost in one step."""
FLOOR = 0.01
"""Volume of a corner from which on no movement takes any more [cells]."""
FLAT, SAFE = 0.02, 0.3
"""Volume below which it is harm to a corner to lose any more, and above which none comes to harm [cells]."""
TINY = 1e-5
"""Loss up to which a node is not charged: four of them are far below the floor [cells]."""

CORNER_NODES = tuple(
    # Of an octant of odd sign two neighbours change places, so that the volume at rest is one.
    (corner, *(corner ^ (1 << axis) for axis in ((0, 1, 2) if bin(corner).count("1") % 2 == 0 else (1, 0, 2))))
    for corner in range(8)
)
"""Apex and neighbours of each corner of a cell, by the corner's number, so that the volume at rest is one."""


class TurnMath(NamedTuple):
    """The functions of one corner, for one target: :func:`make_turn_math`."""

    charges: Any
    limit: Any
    budget: Any
    harms: Any
    volume: Any


def make_turn_math(compiled: Callable[[Any], Any]) -> TurnMath:
    """The functions of one corner, for one target of numba; vectors are tuples (x, y, z).

    Parameters
    ----------
    compiled
        Makes a function that kernels of the target can call.

    Returns
    -------
    charges
        ``(a, b, c, m0, m1, m2, m3)`` to the volume and c_0 to c_3.
    budget
        ``(volume, c0 to c3, is_free0 to is_free3)`` to what each free node with a charge may take, below zero where
        nothing is held back.
    limit
        ``(budget, charge, is_free)`` to the part of its movement that a node may take.
    harms
        ``(volume, a, b, c, m0, m1, m2, m3)``: whether all movements in full would do the corner harm.
    volume
        ``(a, b, c)``: the volume of a corner.
    """
    zero, one, half, third = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(1.0 / 3.0)
    part, floor, tiny = np.float32(SHARE), np.float32(FLOOR), np.float32(TINY)
    flat, kept, safe = np.float32(FLAT), np.float32(1.0 - SHARE), np.float32(SAFE)

    @compiled
    def dot(a, b):
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

    @compiled
    def cross(a, b):
        return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])

    @compiled
    def less(a, b):
        return (a[0] - b[0], a[1] - b[1], a[2] - b[2])

    @compiled
    def lost(value):
        return -value if value < zero else zero

    @compiled
    def charges(a, b, c, m0, m1, m2, m3):
        n1, n2, n3 = cross(b, c), cross(c, a), cross(a, b)
        m23, m31, m12 = cross(m2, m3), cross(m3, m1), cross(m1, m2)
        q12, q23, q31 = half * lost(dot(c, m12)), half * lost(dot(a, m23)), half * lost(dot(b, m31))
        q01 = half * lost(dot(less(b, c), cross(m1, m0)))
        q02 = half * lost(dot(less(c, a), cross(m2, m0)))
        q03 = half * lost(dot(less(a, b), cross(m3, m0)))
        c123 = third * lost(dot(m1, m23))
        c012, c023, c031 = third * lost(-dot(m0, m12)), third * lost(-dot(m0, m23)), third * lost(-dot(m0, m31))
        l0 = lost(-(dot(m0, n1) + dot(m0, n2) + dot(m0, n3)))
        return (
            dot(a, n1),
            l0 + q01 + q02 + q03 + c012 + c023 + c031,
            lost(dot(m1, n1)) + q12 + q31 + q01 + c123 + c012 + c031,
            lost(dot(m2, n2)) + q12 + q23 + q02 + c123 + c012 + c023,
            lost(dot(m3, n3)) + q23 + q31 + q03 + c123 + c023 + c031,
        )

    @compiled
    def budget(volume, c0, c1, c2, c3, is_free0, is_free1, is_free2, is_free3):
        led, count = zero, zero
        if not is_free0:
            led += c0
        elif c0 > tiny:
            count += one
        if not is_free1:
            led += c1
        elif c1 > tiny:
            count += one
        if not is_free2:
            led += c2
        elif c2 > tiny:
            count += one
        if not is_free3:
            led += c3
        elif c3 > tiny:
            count += one
        left = volume - led
        if count == zero or left <= zero:
            return -one
        return part * max(left - floor, zero) / count

    @compiled
    def limit(budget, charge, is_free):
        if budget < zero or not is_free or charge <= budget or charge <= tiny:
            return one
        return budget / charge

    @compiled
    def harms(volume, a, b, c, m0, m1, m2, m3):
        later_a = (a[0] + (m1[0] - m0[0]), a[1] + (m1[1] - m0[1]), a[2] + (m1[2] - m0[2]))
        later_b = (b[0] + (m2[0] - m0[0]), b[1] + (m2[1] - m0[1]), b[2] + (m2[2] - m0[2]))
        later_c = (c[0] + (m3[0] - m0[0]), c[1] + (m3[1] - m0[1]), c[2] + (m3[2] - m0[2]))
        after = dot(later_a, cross(later_b, later_c))
        if volume <= zero or after >= volume:
            return False
        return after < flat or (after < kept * volume and after < safe)

    @compiled
    def volume_of(a, b, c):
        return dot(a, cross(b, c))

    return TurnMath(charges, limit, budget, harms, volume_of)


def allowed_parts(u: Float64, moved: Float64, is_free: Bool, is_near: Bool, volume_most: float) -> tuple[Float64, bool]:
    """The reference: parts of their movements that some cells allow their corners' nodes.

    What each choice of nodes adds to a corner's change of volume follows from its volumes with all smaller choices
    moved (inclusion and exclusion), not from the formulas of the kernels.

    Parameters
    ----------
    u
        Displacements of the cells' corners before the step [cells], shape (count, 8, 3).
    moved
        Their movements in the step [cells], shape (count, 8, 3).
    is_free
        Whether nodes are neither led nor fixed, shape (count, 8).
    is_near
        Whether a cell's corners are looked after whatever their volume, shape (count,).
    volume_most
        Volume below which those of the other cells are, as are those that would come to harm [cells]; 0 for none.

    Returns
    -------
    parts
        From 0 to 1, shape (count, 8).
    harm
        Whether a corner that is looked after would come to harm; else what they allow does not count.
    """
    position = u + CORNER_OFFSETS
    harm = False
    part = np.ones(u.shape[:2])
    for nodes in CORNER_NODES:
        at, way, free = position[:, nodes], moved[:, nodes], is_free[:, nodes].T
        volume = {which: _volume(at + way * np.array(which)[:, None]) for which in product((0, 1), repeat=4)}
        charge = np.zeros((4, len(u)))
        for which in volume:
            members = np.flatnonzero(which)
            if len(members):
                below = [smaller for smaller in volume if np.less_equal(smaller, which).all()]
                change = sum((-1.0) ** (len(members) - sum(smaller)) * volume[smaller] for smaller in below)
                charge[members] += np.maximum(-change, 0.0) / len(members)
        start = volume[0, 0, 0, 0]
        counts = ((charge > TINY) & free).sum(axis=0)
        left = start - (charge * ~free).sum(axis=0)
        harmed = _harms(start, volume[1, 1, 1, 1])
        is_due = is_near | (start < volume_most) | (harmed & (volume_most > 0.0))
        harm |= bool((harmed & is_due).any())
        is_limited = is_due & (left > 0.0)
        each = SHARE * np.maximum(left - FLOOR, 0.0) / np.maximum(counts, 1)
        for node, own, own_free in zip(nodes, charge, free, strict=True):
            acts = is_limited & own_free & (own > TINY) & (own > each)
            part[acts, node] = np.minimum(part[acts, node], each[acts] / own[acts])
    return part, harm


def least_volumes(u: Float64) -> Float64:
    """Volume of each cell's flattest corner, from displacements of shape (count, 8, 3); shape (count,)."""
    position = u + CORNER_OFFSETS
    least: Float64 = np.stack([_volume(position[:, nodes]) for nodes in CORNER_NODES]).min(axis=0)
    return least


def comes_to_harm(u: Float64, moved: Float64) -> Bool:
    """Whether a corner of each cell would come to harm, shape (count,); displacements and movements as above."""
    position, harmed = u + CORNER_OFFSETS, np.zeros(len(u), np.bool_)
    for nodes in CORNER_NODES:
        harmed |= _harms(_volume(position[:, nodes]), _volume((position + moved)[:, nodes]))
    return harmed


def _harms(before: Float64, after: Float64) -> Bool:
    """Whether corners come to harm that have one volume before a step and another after it, shape (count,)."""
    is_near_turning = (after < FLAT) | ((after < (1.0 - SHARE) * before) & (after < SAFE))
    harmed: Bool = (before > 0.0) & (after < before) & is_near_turning
    return harmed


def _volume(nodes: Float64) -> Float64:
    """Volumes of corners from their apexes and neighbours, shape (count, 4, 3)."""
    a, b, c = np.moveaxis(nodes[:, 1:] - nodes[:, :1], 1, 0)
    volume: Float64 = np.einsum("nx,nx->n", a, np.cross(b, c))
    return volume
