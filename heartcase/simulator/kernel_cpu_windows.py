"""What the CPU kernel does to one window of 8 lanes: forces of springs and of cells, and the step.

A spring's force is worked out from the difference of the displacements D = u_j - u_i, with o the spring's vector at
rest, |o| = L and d = o + D::

    w (|d| - L) d / |d|  =  w e d / (|d|^2 + L |d|),     e = |d|^2 - L^2 = (o + d) . D

so nothing cancels: at rest the force is exactly zero, and a small strain keeps all its digits.

A cell is kept in the lane of its lowest corner. A window of cells adds its forces to those on the nodes, row by row: of
two cells side by side, the forces on the nodes between them are added first.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from heartcase.schemas.lattice import CORNER_OFFSETS
from heartcase.simulator.cell_forces import LOOK_BELOW
from heartcase.simulator.cell_math import make_cell_math
from heartcase.simulator.lanes import CELL_NUMBERS, LANE_COUNT
from heartcase.simulator.model import DIRECTIONS
from heartcase.simulator.vector_ir import Lanes, Vector, Window, array_data, array_lane_count

__all__ = [
    "clear_window",
    "element_of_window",
    "force_of_window",
    "force_of_window_with_cells",
    "guard_of_window",
    "is_flat_window",
    "step_of_window",
    "step_of_window_from_both_ends",
    "step_of_window_with_cells",
    "step_of_window_with_cells_alone",
    "step_of_window_with_cells_from_both_ends",
    "tension_of_window",
    "volume_of_window",
]

_TINY = 1e-30
"""Keeps the division defined where two nodes lie on one spot."""
_CORNERS = [(int(i), int(j), int(k)) for i, j, k in CORNER_OFFSETS]

_element, _volume_term, _corner_guard, _corner_lack = make_cell_math(lambda function: function, Lanes.positive_part)


def _apart(here: Window, displacement: Any, own: Vector, offset: tuple[int, int, int]) -> Vector:
    """-D of the neighbour at an offset: what is loaded is the second operand, and needs no register."""
    x, y, z = here.load_vector(displacement, offset)
    return own[0] - x, own[1] - y, own[2] - z


def _tension(apart: Vector, offset: tuple[int, int, int], weight: Lanes) -> Lanes:
    """Tension of a spring over its length; see the formula at the top, of which all vectors are turned round."""
    d = _less(apart, offset)
    length = float(np.linalg.norm(offset))
    # Along axes that the spring has no part of at rest, d is D: what both sums have of these is added up once.
    across = [apart[axis] * apart[axis] for axis in range(3) if not offset[axis]]
    e = d_squared = sum(across[1:], across[0])
    for axis in np.flatnonzero(offset):
        e = e + (d[axis] - offset[axis]) * apart[axis]
        d_squared = d_squared + d[axis] * d[axis]
    d_squared = d_squared + _TINY
    return weight * e / (d_squared + d_squared.root() * length)


def _less(apart: Vector, offset: tuple[int, int, int]) -> Vector:
    return apart[0] - offset[0], apart[1] - offset[1], apart[2] - offset[2]


def _with_pull(total: Vector | None, tension: Lanes, apart: Vector, offset: tuple[int, int, int]) -> Vector:
    """A sum of forces, all turned round, with one spring's."""
    d = _less(apart, offset)
    pull = (tension * d[0], tension * d[1], tension * d[2])
    return _plus(total, pull) if total else pull


def _spring_force(here: Window, displacement: Any, weight: Any, tension: Any | None) -> Vector:
    """Sum of the pulls of the 18 springs on each lane, turned round.

    Where there is room for tensions, those of the springs ahead are left in it, and those of the springs behind taken
    from it.
    """
    own = here.load_vector(displacement)
    total: Vector | None = None
    for direction, (i, j, k) in enumerate(DIRECTIONS.tolist()):
        ahead, behind = (i, j, k), (-i, -j, -k)
        apart_ahead = _apart(here, displacement, own, ahead)
        apart_behind = _apart(here, displacement, own, behind)
        tension_ahead = _tension(apart_ahead, ahead, here.load(weight, direction))
        if tension is None:
            # A spring's weight is stored at its lower node: for the springs behind a lane, the neighbour.
            tension_behind = _tension(apart_behind, behind, here.load(weight, direction, behind))
        elif (j, k) == (0, 0):
            # These are the ones just stored, one lane on: a load would have to wait for the store.
            first = here.builder.load(here.pointer(tension, direction, behind))
            tension_behind = tension_ahead.after(first)
        else:
            tension_behind = here.load(tension, direction, behind)
        if tension is not None:
            tension_ahead.store(here.pointer(tension, direction))
        total = _with_pull(total, tension_ahead, apart_ahead, ahead)
        total = _with_pull(total, tension_behind, apart_behind, behind)
    assert total is not None
    return total


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _force(here: Window, displacement: Any, weight: Any | None, tension: Any | None, cell_force: Any | None) -> Vector:
    """Sum of the forces on each lane, turned round."""
    springs = _spring_force(here, displacement, weight, tension) if weight is not None else None
    if cell_force is None:
        assert springs is not None
        return springs
    cells = here.load_vector(cell_force)
    if springs is None:
        return -cells[0], -cells[1], -cells[2]
    return springs[0] - cells[0], springs[1] - cells[1], springs[2] - cells[2]


def _make_force(has_cells: bool) -> Any:
    """The intrinsic that writes the forces on one window."""

    @intrinsic
    def force_of(typing_context, displacement, weight, cell_force, force, rows, window):  # type: ignore[no-untyped-def]
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            arrays = zip(signature.args[:5], arguments, strict=False)
            u, w, c, f, starts = (array_data(context, builder, *pair) for pair in arrays)
            lane_count = array_lane_count(context, builder, signature.args[0], arguments[0])
            here = Window(builder, starts, arguments[5], lane_count)
            for axis, component in enumerate(_force(here, u, w, None, c if has_cells else None)):
                (-component).store(here.pointer(f, axis))
            return context.get_dummy_value()

        return types.void(displacement, weight, cell_force, force, rows, types.int64), codegen

    return force_of


force_of_window = _make_force(has_cells=False)
force_of_window_with_cells = _make_force(has_cells=True)


def _emit_step(
    context: Any,
    builder: Any,
    kinds: Any,
    arguments: Any,
    weight: Any | None,
    tension: Any | None,
    cell_force: Any | None,
) -> Any:
    """Move a window by one step; see :mod:`heartcase.simulator.integrate`.

    ``kinds`` and ``arguments`` are those of now, later, velocity, inverse_mass, rows, window and constants.
    """
    u, u_later, v, m, starts = (array_data(context, builder, *pair) for pair in zip(kinds[:5], arguments, strict=False))
    here = Window(builder, starts, arguments[5], array_lane_count(context, builder, kinds[0], arguments[0]))
    numbers = [Lanes.filled(builder, number) for number in cgutils.unpack_tuple(builder, arguments[6], 7)]
    time_step, keep, kick, gravity, speed_limit = *numbers[:3], numbers[3:6], numbers[6]
    mass_inverse = here.load(m, 0)
    # Chosen before it is clamped: a choice that is stored becomes a masked store, which is slow on some processors.
    limit = speed_limit.where_positive(mass_inverse, Lanes.filled(builder, np.finfo(np.float32).max))
    for axis, against in enumerate(_force(here, u, weight, tension, cell_force)):
        held = here.load(v, axis)
        free = keep * held + kick * (gravity[axis] - against * mass_inverse)
        new = free.where_positive(mass_inverse, held).clamped(limit)
        new.store(here.pointer(v, axis))
        (here.load(u, axis) + time_step * new).store(here.pointer(u_later, axis))
    return context.get_dummy_value()


def _make_step(keeps_tensions: bool) -> Any:
    @intrinsic
    def step(  # type: ignore[no-untyped-def]
        typing_context, now, later, velocity, weight, tension, inverse_mass, rows, window, constants
    ):
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            rest = (*range(3), *range(5, 9))
            w, t = (array_data(context, builder, signature.args[n], arguments[n]) for n in (3, 4))
            kinds, values = [signature.args[n] for n in rest], [arguments[n] for n in rest]
            return _emit_step(context, builder, kinds, values, w, t if keeps_tensions else None, None)

        return types.void(now, later, velocity, weight, tension, inverse_mass, rows, types.int64, constants), codegen

    return step


step_of_window = _make_step(keeps_tensions=True)
step_of_window_from_both_ends = _make_step(keeps_tensions=False)


@intrinsic
def tension_of_window(typing_context, now, weight, tension, rows, window):  # type: ignore[no-untyped-def]
    """Write the tensions over the lengths of the springs ahead of a window's lanes."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:4], arguments, strict=False)
        u, w, t, starts = (array_data(context, builder, *pair) for pair in arrays)
        here = Window(
            builder, starts, arguments[4], array_lane_count(context, builder, signature.args[0], arguments[0])
        )
        own = here.load_vector(u)
        for direction, (i, j, k) in enumerate(DIRECTIONS.tolist()):
            apart = _apart(here, u, own, (i, j, k))
            _tension(apart, (i, j, k), here.load(w, direction)).store(here.pointer(t, direction))
        return context.get_dummy_value()

    return types.void(now, weight, tension, rows, types.int64), codegen


def _make_step_with_cells(has_springs: bool, keeps_tensions: bool) -> Any:
    @intrinsic
    def step(  # type: ignore[no-untyped-def]
        typing_context, now, later, velocity, weight, tension, cell_force, inverse_mass, rows, window, constants
    ):
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            rest = (*range(3), *range(6, 10))
            w, t, c = (array_data(context, builder, signature.args[n], arguments[n]) for n in (3, 4, 5))
            kinds, values = [signature.args[n] for n in rest], [arguments[n] for n in rest]
            return _emit_step(
                context, builder, kinds, values, w if has_springs else None, t if keeps_tensions else None, c
            )

        kinds = (now, later, velocity, weight, tension, cell_force, inverse_mass, rows, types.int64, constants)
        return types.void(*kinds), codegen

    return step


step_of_window_with_cells = _make_step_with_cells(has_springs=True, keeps_tensions=True)
step_of_window_with_cells_from_both_ends = _make_step_with_cells(has_springs=True, keeps_tensions=False)
step_of_window_with_cells_alone = _make_step_with_cells(has_springs=False, keeps_tensions=False)


def _make_cell_window(kind: str) -> Any:
    """The intrinsic that adds the forces of one window of cells: ``element``, ``volume`` or ``guard``.

    It takes displacement, numbers of the cells, forces on the nodes (3, lane_count), law, rows and window.
    """

    @intrinsic
    def window_forces(typing_context, displacement, numbers, cell_force, law, rows, window):  # type: ignore[no-untyped-def]
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            arrays = zip(signature.args[:5], arguments, strict=False)
            u, n, f, constants, starts = (array_data(context, builder, *pair) for pair in arrays)
            lane_count = array_lane_count(context, builder, signature.args[0], arguments[0])
            here = Window(builder, starts, arguments[5], lane_count)
            corners = tuple(here.load_vector(u, offset) for offset in _CORNERS)
            scale = here.load(n, 0)
            if kind == "element":
                moments = tuple(here.load(n, number) for number in range(1, CELL_NUMBERS))
                forces = _element(corners, scale, moments, tuple(_constant(builder, constants, k) for k in range(5)))
            elif kind == "volume":
                forces = _volume_term(corners, scale, _constant(builder, constants, 0))
            else:
                forces = _corner_guard(corners, here.load(n, 1))
            for axis, at_corners in enumerate(forces):
                _add_to_nodes(here, f, axis, dict(zip(_CORNERS, at_corners, strict=True)))
            return context.get_dummy_value()

        return types.void(displacement, numbers, cell_force, law, rows, types.int64), codegen

    return window_forces


def _add_to_nodes(here: Window, node_force: Any, axis: int, at_corners: dict[tuple[int, int, int], Lanes]) -> None:
    """Add one component of the forces of a window of cells on their corners to those on the nodes."""
    builder = here.builder
    for j, k in ((0, 0), (1, 0), (0, 1), (1, 1)):
        at_left, at_right = at_corners[0, j, k], at_corners[1, j, k]
        place = here.pointer(node_force, axis, (0, j, k))
        (Lanes.loaded(builder, place) + (at_left + at_right.after(0.0))).store(place)
        beyond = here.pointer(node_force, axis, (LANE_COUNT, j, k))
        builder.store(builder.fadd(builder.load(beyond), at_right.last()), beyond)


def _constant(builder: Any, array: Any, number: int) -> Lanes:
    return Lanes.filled(builder, builder.load(builder.gep(array, [ir.Constant(ir.IntType(64), number)])))


element_of_window = _make_cell_window("element")
volume_of_window = _make_cell_window("volume")
guard_of_window = _make_cell_window("guard")


@intrinsic
def clear_window(typing_context, force, rows, window):  # type: ignore[no-untyped-def]
    """Set the forces (3, lane_count) on a window of nodes to zero."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        f, starts = (array_data(context, builder, *pair) for pair in zip(signature.args[:2], arguments, strict=False))
        here = Window(
            builder, starts, arguments[2], array_lane_count(context, builder, signature.args[0], arguments[0])
        )
        for axis in range(3):
            Lanes.filled(builder, 0.0).store(here.pointer(f, axis))
        return context.get_dummy_value()

    return types.void(force, rows, types.int64), codegen


@intrinsic
def is_flat_window(typing_context, displacement, numbers, rows, window):  # type: ignore[no-untyped-def]
    """Whether a corner of one of a window's cells has a volume below LOOK_BELOW."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:3], arguments, strict=False)
        u, n, starts = (array_data(context, builder, *pair) for pair in arrays)
        lane_count = array_lane_count(context, builder, signature.args[0], arguments[0])
        here = Window(builder, starts, arguments[3], lane_count)
        corners = tuple(here.load_vector(u, offset) for offset in _CORNERS)
        # Lanes without a cell have no stiffness, wherever the nodes around them are.
        lack = _corner_lack(corners, np.float32(LOOK_BELOW)) * here.load(n, 0)
        return lack.is_any_positive()

    return types.boolean(displacement, numbers, rows, types.int64), codegen
