"""The springs of a window of 8 lanes in the CPU kernel: their forces, and the parts of which a step is put together.

A spring's force is worked out from the difference of the displacements D = u_j - u_i, with o the spring's vector at
rest, |o| = L and d = o + D::

    w (|d| - L) d / |d|  =  w e d / (|d|^2 + L |d|),     e = |d|^2 - L^2 = (o + d) . D

so nothing cancels: at rest the force is exactly zero, and a small strain keeps all its digits. In the code all vectors
are turned round: what is loaded is the second operand of a difference, and needs no register.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from heartcase.compiling.emitting import array_data, counted, nothing, room_with
from heartcase.simulator.engine.cpu.vector_ir import Lanes, Vector, Window
from heartcase.simulator.engine.shared.lanes import BANK_LANES, LANE_COUNT
from heartcase.simulator.lattice.model import DIRECTIONS

__all__ = [
    "AHEAD",
    "EXPLICIT_NUMBERS",
    "WINDOW_NUMBERS",
    "SpringsAhead",
    "force_of_window",
    "force_of_window_with_cells",
    "pull_of_group",
    "spring_force",
    "spring_force_from_both_ends",
    "tension_of_window",
    "window_number",
    "with_springs_behind",
]

AHEAD: list[tuple[int, int, int]] = [(i, j, k) for i, j, k in DIRECTIONS.tolist()]
"""The nine springs ahead of a lane: where they end, (i, j, k) from it."""
WINDOW_NUMBERS = len(AHEAD) + 1
"""Numbers of each of a window's lanes that lie side by side in memory: stiffness of the springs ahead, inverse mass."""
EXPLICIT_NUMBERS = 6
"""Numbers of an explicit spring: offset along x, y, z, rest length, excess, stiffness."""
_INDEX = ir.IntType(64)
_TINY = 1e-30
"""Keeps the division defined where two nodes lie on one spot."""

Offset = tuple[int, int, int]


def window_number(builder: Any, window_numbers: Any, window: Any, which: int) -> Lanes:
    """One of the WINDOW_NUMBERS of a window."""
    return Lanes.of_window(builder, window_numbers, window, which, WINDOW_NUMBERS)


@dataclass(frozen=True)
class SpringsAhead:
    """The springs from a window's lanes along one direction, on the way to their tensions over their lengths."""

    direction: int
    d: Vector
    """d, turned round."""
    weighted: Lanes
    """w e."""
    square: Lanes
    """|d|^2."""

    @classmethod
    def of(cls, here: Window, displacement: Any, own: Vector, direction: int, weight: Lanes) -> SpringsAhead:
        """From the displacements at both ends."""
        offset = AHEAD[direction]
        apart = _apart(here, displacement, own, offset)
        e, square = _stretch(apart, offset)
        return cls(direction, _less(apart, offset), weight * e, square)

    def divisor(self) -> Lanes:
        """What the tension is divided by: |d|^2 + L |d|."""
        return _divisor(self.square, AHEAD[self.direction])


def _apart(here: Window, displacement: Any, own: Vector, offset: Offset) -> Vector:
    """-D of the neighbour at an offset."""
    x, y, z = here.load_vector(displacement, offset)
    return own[0] - x, own[1] - y, own[2] - z


def _stretch(apart: Vector, offset: Offset) -> tuple[Lanes, Lanes]:
    """Of a spring: e and |d|^2."""
    d = _less(apart, offset)
    # Along axes that the spring has no part of at rest, d is D: what both sums have of these is added up once.
    across = [apart[axis] * apart[axis] for axis in range(3) if not offset[axis]]
    e = square = sum(across[1:], across[0])
    for axis in np.flatnonzero(offset):
        e = e + (d[axis] - offset[axis]) * apart[axis]
        square = square + d[axis] * d[axis]
    return e, square + _TINY


def _divisor(square: Lanes, offset: Offset) -> Lanes:
    return square + square.root() * float(np.linalg.norm(offset))


def _tension(apart: Vector, offset: Offset, weight: Lanes) -> Lanes:
    """Tension of a spring over its length."""
    e, square = _stretch(apart, offset)
    return weight * e / _divisor(square, offset)


def _less(apart: Vector, offset: Offset) -> Vector:
    return apart[0] - offset[0], apart[1] - offset[1], apart[2] - offset[2]


def _with_pull(total: Vector | None, tension: Lanes, d: Vector) -> Vector:
    """A sum of forces with one spring's."""
    pull = (tension * d[0], tension * d[1], tension * d[2])
    return (total[0] + pull[0], total[1] + pull[1], total[2] + pull[2]) if total else pull


def spring_force_from_both_ends(here: Window, displacement: Any, weight: Any) -> Vector:
    """Sum of the pulls of the 18 springs on each lane.

    A spring's weight is stored at its lower node: for the springs behind a lane, the neighbour.
    """
    own = here.load_vector(displacement)
    total: Vector | None = None
    for direction, ahead in enumerate(AHEAD):
        behind = _behind(ahead)
        for offset, stored in ((ahead, (0, 0, 0)), (behind, behind)):
            apart = _apart(here, displacement, own, offset)
            tension = _tension(apart, offset, here.load(weight, direction, stored))
            total = _with_pull(total, tension, _less(apart, offset))
    assert total is not None
    return total


def spring_force(here: Window, displacement: Any, window_numbers: Any, tension: Any, window: Any) -> Vector:
    """Sum of the pulls of the 18 springs on each lane; the tensions of those ahead are kept for other windows."""
    own = here.load_vector(displacement)
    total: Vector | None = None
    for direction in range(len(AHEAD)):
        weight = window_number(here.builder, window_numbers, window, direction)
        springs = SpringsAhead.of(here, displacement, own, direction, weight)
        made = springs.weighted / springs.divisor()
        total = with_springs_behind(here, displacement, tension, own, springs, made, total)
    assert total is not None
    return total


def with_springs_behind(
    here: Window,
    displacement: Any,
    tension: Any,
    own: Vector,
    springs: SpringsAhead,
    made: Lanes,
    total: Vector | None,
) -> Vector:
    """A sum of forces with those of the springs ahead and behind along one direction.

    The tensions of those ahead are kept; those of the springs behind are fetched from where earlier windows kept them.
    """
    builder, direction = here.builder, springs.direction
    behind = _behind(AHEAD[direction])
    apart_behind = _apart(here, displacement, own, behind)
    if behind[1:] == (0, 0):
        # These are the ones just worked out, one lane on: a load would have to wait for the store.
        tension_behind = made.after(builder.load(here.pointer(tension, direction, behind)))
    else:
        tension_behind = here.load(tension, direction, behind)
    made.store(here.pointer(tension, direction))
    total = _with_pull(total, made, springs.d)
    return _with_pull(total, tension_behind, _less(apart_behind, behind))


def _behind(offset: Offset) -> Offset:
    return -offset[0], -offset[1], -offset[2]


@intrinsic
def tension_of_window(typing_context, now, window_numbers, tension, rows, window):
    """Keep the tensions over the lengths of the springs ahead of a window's lanes."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:4], arguments, strict=False)
        u, n, t, starts = (array_data(context, builder, *pair) for pair in arrays)
        here = Window(builder, starts, arguments[4])
        own = here.load_vector(u)
        for direction in range(len(AHEAD)):
            weight = window_number(builder, n, arguments[4], direction)
            springs = SpringsAhead.of(here, u, own, direction, weight)
            (springs.weighted / springs.divisor()).store(here.pointer(t, direction))
        return nothing(context)

    return types.void(now, window_numbers, tension, rows, types.int64), codegen


def _make_force(has_cells: bool) -> Any:
    """The intrinsic that writes the forces on one window, with those of the cells where they are given."""

    @intrinsic
    def force_of(typing_context, displacement, weight, cell_force, force, rows, window):
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            arrays = zip(signature.args[:5], arguments, strict=False)
            u, w, c, f, starts = (array_data(context, builder, *pair) for pair in arrays)
            here = Window(builder, starts, arguments[5])
            for axis, against in enumerate(spring_force_from_both_ends(here, u, w)):
                total = against - here.load(c, axis) if has_cells else against
                (-total).store(here.pointer(f, axis))
            return nothing(context)

        return types.void(displacement, weight, cell_force, force, rows, types.int64), codegen

    return force_of


force_of_window = _make_force(has_cells=False)
force_of_window_with_cells = _make_force(has_cells=True)


@intrinsic
def pull_of_group(typing_context, now, lane, other, numbers, pull, group, first, end):
    """Write the pull of the springs from ``first`` to before ``end`` on the nodes of a group, shape (3, 8)."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:5], arguments, strict=False)
        u, own_lanes, lanes, n, result = (array_data(context, builder, *pair) for pair in arrays)
        own = _vectors_at(builder, u, own_lanes, arguments[5])
        total = [room_with(builder, Lanes.filled(builder, 0.0).value) for _ in range(3)]
        with counted(builder, arguments[6], arguments[7]) as (spring, _):
            there = _vectors_at(builder, u, lanes, spring)
            offset = [Lanes.of_window(builder, n, spring, axis, EXPLICIT_NUMBERS) for axis in range(3)]
            length, excess, stiffness = (
                Lanes.of_window(builder, n, spring, which, EXPLICIT_NUMBERS) for which in (3, 4, 5)
            )
            moved = [there[axis] - own[axis] for axis in range(3)]
            d = [offset[axis] + moved[axis] for axis in range(3)]
            square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + _TINY
            e = excess
            for axis in range(3):
                e = e + (offset[axis] + d[axis]) * moved[axis]
            tension = stiffness * e / (square + length * square.root())
            for axis in range(3):
                before = Lanes(builder, builder.load(total[axis]))
                builder.store((before + tension * d[axis]).value, total[axis])
        for axis in range(3):
            place = builder.gep(result, [ir.Constant(_INDEX, axis * LANE_COUNT)])
            Lanes(builder, builder.load(total[axis])).store(place)
        return nothing(context)

    return types.void(now, lane, other, numbers, pull, types.int64, types.int64, types.int64), codegen


def _vectors_at(builder: Any, displacement: Any, lanes: Any, row: Any) -> list[Lanes]:
    """The displacements at a row of lanes that lie anywhere."""
    start = builder.mul(row, ir.Constant(_INDEX, LANE_COUNT))
    places = [
        builder.load(builder.gep(lanes, [builder.add(start, ir.Constant(_INDEX, place))]))
        for place in range(LANE_COUNT)
    ]
    return [
        Lanes.gathered(
            builder,
            [
                builder.gep(displacement, [builder.add(place, ir.Constant(_INDEX, axis * BANK_LANES))])
                for place in places
            ],
        )
        for axis in range(3)
    ]
