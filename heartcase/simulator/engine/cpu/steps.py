"""A step of windows of 8 lanes in the CPU kernel, one after the other.

Between a spring's displacements and its pull lie a root and a division, some 60 cycles if what each operation takes is
added up; a processor that looks ahead over the springs of a window soon has no room for more that must wait. So each
spring is worked out in four stages, and between two stages of one come those of others: what a stage needs is ready
when its turn comes. The last springs of a window go on while the next window begins. That takes 32 registers; where
there are 16, each spring is finished at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from heartcase.compiling.emitting import align_stack, array_data, counted, length, nothing, room_with, tuple_parts
from heartcase.simulator.engine.cpu.springs import (
    AHEAD,
    SpringsAhead,
    spring_force,
    spring_force_from_both_ends,
    window_number,
    with_springs_behind,
)
from heartcase.simulator.engine.cpu.vector_ir import Lanes, Vector, Window, has_many_registers

__all__ = [
    "STEPS_BY_ORDER",
    "step_of_windows",
    "step_of_windows_from_both_ends",
    "step_of_windows_with_cells",
    "step_of_windows_with_cells_alone",
    "step_of_windows_with_cells_from_both_ends",
]

_INDEX = ir.IntType(64)
_ROOT, _DIVISION, _PULL = 2, 3, 4
"""How many springs are begun between a spring's own beginning and its root, its division and its pull."""


@dataclass(frozen=True)
class _Arrays:
    """Data of the kernel's arrays and its constants, in the code being emitted."""

    constants: list[Lanes]
    now: Any
    later: Any
    velocity: Any
    weight: Any
    window_numbers: Any
    tension: Any
    cell_force: Any
    inverse_mass: Any
    rows: Any


def _move(
    here: Window, arrays: _Arrays, own: Vector, total: Vector | None, mass_inverse: Lanes, has_cells: bool
) -> None:
    """Move a window by one step; see :mod:`heartcase.simulator.dynamics.integrate`.

    The total of the springs is turned round.
    """
    time_step, keep, kick, *gravity, speed_limit = arrays.constants
    # Chosen before it is clamped: a choice that is stored becomes a masked store, which is slow on some processors.
    limit = speed_limit.where_positive(mass_inverse, Lanes.filled(here.builder, np.finfo(np.float32).max))
    for axis in range(3):
        if total is None:
            against = -here.load(arrays.cell_force, axis)
        else:
            against = total[axis] - here.load(arrays.cell_force, axis) if has_cells else total[axis]
        held = here.load(arrays.velocity, axis)
        free = keep * held + kick * (gravity[axis] - against * mass_inverse)
        new = free.where_positive(mass_inverse, held).clamped(limit)
        new.store(here.pointer(arrays.velocity, axis))
        (own[axis] + time_step * new).store(here.pointer(arrays.later, axis))


def _emit_in_turn(
    builder: Any, arrays: _Arrays, windows: Any, first: Any, end: Any, springs: str, has_cells: bool
) -> None:
    """Step windows one by one, each spring at once."""
    with counted(builder, first, end) as (number, _):
        window = builder.load(builder.gep(windows, [number]))
        here = Window(builder, arrays.rows, window)
        total: Vector | None = None
        if springs == "kept":
            total = spring_force(here, arrays.now, arrays.window_numbers, arrays.tension, window)
            mass_inverse = window_number(builder, arrays.window_numbers, window, len(AHEAD))
        else:
            mass_inverse = here.load(arrays.inverse_mass, 0)
        if springs == "both ends":
            total = spring_force_from_both_ends(here, arrays.now, arrays.weight)
        _move(here, arrays, here.load_vector(arrays.now), total, mass_inverse, has_cells)


class _Carried:
    """Values that go from one round of a loop to the next, in the code being emitted."""

    def __init__(self, builder: Any, starts: list[Any]) -> None:
        self.builder = builder
        self.rooms = [room_with(builder, value) for value in starts]

    def load(self) -> list[Any]:
        return [self.builder.load(room) for room in self.rooms]

    def store(self, values: list[Any]) -> None:
        for room, value in zip(self.rooms, values, strict=True):
            self.builder.store(value, room)


def _begun(here: Window, arrays: _Arrays, own: Vector, direction: int, window: Any) -> SpringsAhead:
    """The first stage of the springs ahead along a direction."""
    weight = window_number(here.builder, arrays.window_numbers, window, direction)
    springs = SpringsAhead.of(here, arrays.now, own, direction, weight)
    x, y, z = springs.d
    return replace(
        springs,
        square=springs.square.worked_out_here(),
        weighted=springs.weighted.worked_out_here(),
        d=(x.worked_out_here(), y.worked_out_here(), z.worked_out_here()),
    )


def _emit_in_stages(
    builder: Any, arrays: _Arrays, windows: Any, first: Any, end: Any, nothing: Any, has_cells: bool
) -> None:
    """Step windows one by one, each spring in stages, the last of a window while the next begins.

    There is one more round than windows: before the first window and after the last there is nothing, the window that
    holds no node. What is written of it is zeros where zeros are, by all threads.
    """
    count = len(AHEAD)
    begun = range(count - _PULL, count)
    zero, one = Lanes.filled(builder, 0.0).value, Lanes.filled(builder, 1.0).value
    # The window, its displacements and forces; of each of its last springs d, w e, and the tension, divisor or |d|^2.
    at_first = [nothing, *[zero] * 6]
    for direction in begun:
        at_first += [zero, zero, zero, zero, zero if direction < count - _DIVISION else one]
    carried = _Carried(builder, at_first)
    rounds = builder.select(builder.icmp_signed("<", first, end), builder.add(end, ir.Constant(_INDEX, 1)), first)
    with counted(builder, first, rounds) as (number, _):
        is_there = builder.icmp_signed("<", number, end)
        place = builder.gep(windows, [builder.select(is_there, number, first)])
        window = builder.select(is_there, builder.load(place), nothing)
        here = Window(builder, arrays.rows, window)
        own = here.load_vector(arrays.now)

        window_before, *values = carried.load()
        before = Window(builder, arrays.rows, window_before)
        lanes = [Lanes(builder, value) for value in values]
        own_before: Vector = (lanes[0], lanes[1], lanes[2])
        total: Vector | None = (lanes[3], lanes[4], lanes[5])
        springs, results = {}, {}
        for place_of, direction in enumerate(begun):
            x, y, z, weighted, result = lanes[6 + 5 * place_of :][:5]
            springs[direction - count] = SpringsAhead(direction, (x, y, z), weighted, result)
            results[direction - count] = result

        for turn in range(count):
            pulled, divided, rooted = turn - _PULL, turn - _DIVISION, turn - _ROOT
            where, at = (before, own_before) if pulled < 0 else (here, own)
            total = with_springs_behind(where, arrays.now, arrays.tension, at, springs[pulled], results[pulled], total)
            total = (total[0].worked_out_here(), total[1].worked_out_here(), total[2].worked_out_here())
            if pulled == -1:
                mass_inverse = window_number(builder, arrays.window_numbers, window_before, count)
                _move(before, arrays, own_before, total, mass_inverse, has_cells)
                total = None
            results[divided] = (springs[divided].weighted / results[divided]).worked_out_here()
            results[rooted] = springs[rooted].divisor().worked_out_here()
            springs[turn] = _begun(here, arrays, own, turn, window)
            results[turn] = springs[turn].square

        assert total is not None
        ends = [window, *(lane.value for lane in (*own, *total))]
        for direction in begun:
            last = springs[direction]
            ends += [lane.value for lane in (*last.d, last.weighted, results[direction])]
        carried.store(ends)


def _make_steps(springs: str, has_cells: bool = False, in_stages: bool | None = None) -> Any:
    """The intrinsic that moves some windows of a list by one step.

    ``springs``: kept, both ends or none. ``in_stages``: whether in stages; where the registers are enough by default.
    """

    @intrinsic
    def steps(
        typing_context,
        now,
        later,
        velocity,
        weight,
        window_numbers,
        tension,
        cell_force,
        inverse_mass,
        rows,
        windows,
        first,
        end,
        constants,
    ):
        arrays = (now, later, velocity, weight, window_numbers, tension, cell_force, inverse_mass, rows)

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            align_stack(builder)
            given = zip(signature.args[:9], arguments, strict=False)
            data = [array_data(context, builder, *pair) for pair in given]
            fixed = [Lanes.filled(builder, number) for number in tuple_parts(builder, arguments[12], 7)]
            listed = array_data(context, builder, signature.args[9], arguments[9])
            what = (builder, _Arrays(fixed, *data), listed, arguments[10], arguments[11])
            if springs == "kept" and (has_many_registers(context) if in_stages is None else in_stages):
                none = length(context, builder, signature.args[8], arguments[8])
                _emit_in_stages(*what, none, has_cells)
            else:
                _emit_in_turn(*what, springs, has_cells)
            return nothing(context)

        return types.void(*arrays, windows, types.int64, types.int64, constants), codegen

    return steps


step_of_windows = _make_steps("kept")
step_of_windows_with_cells = _make_steps("kept", has_cells=True)
step_of_windows_from_both_ends = _make_steps("both ends")
step_of_windows_with_cells_from_both_ends = _make_steps("both ends", has_cells=True)
step_of_windows_with_cells_alone = _make_steps("none", has_cells=True)

STEPS_BY_ORDER = {in_stages: _make_steps("kept", in_stages=in_stages) for in_stages in (False, True)}
"""Both orders, whatever the registers: the second where there is AVX-512."""
