"""Cells in the CPU kernel, in windows of 8: forces of elements, of the volume term and of the corner guard.

A cell is kept in the lane of its lowest corner. A window of cells adds its forces to those on the nodes, row by row: of
two cells side by side, the forces on the nodes between them are added first.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from heartcase.compiling.emitting import array_data, nothing, room
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.simulator.engine.cpu.vector_ir import Lanes, Vector, Window
from heartcase.simulator.engine.shared.lanes import CELL_NUMBERS, LANE_COUNT, SHARE_NUMBERS
from heartcase.simulator.forces.cell_math import NOTHING_SHARED, make_cell_math
from heartcase.simulator.lattice.force_law import LOOK_BELOW

__all__ = [
    "CALM",
    "clear_window",
    "element_of_window",
    "gradient_of_window",
    "guard_of_window",
    "is_flat_window",
    "mean_stress_of_window",
    "mean_stress_of_window_with_more",
    "sharing_element_of_window",
    "volume_of_window",
]

CALM = 0.12
"""Difference of corners' displacements, along any axis, up to which no corner of a cell is below LOOK_BELOW [edges].

With edges of a corner 1 + G, |G_ij| <= c, its volume is at least (1 - c)^3 - 3 (1 - c) c^2 - 2 c^3, here 0.64."""
_CORNERS = [(int(i), int(j), int(k)) for i, j, k in CORNER_OFFSETS]

_OWN_NUMBER = len(_CORNERS)
"""Place in the shares of a cell of the stiffness that is stretched as the cell is."""
_INVERSE_NUMBER = len(_CORNERS)
"""Place in a node's shares of the inverse of what shares strain around it."""

_FLOOR_NUMBER = 5
"""Place of the corners' floor in the law's constants."""

_math = make_cell_math(lambda function: function, Lanes.positive_part)


def _make_cell_window(kind: str) -> Any:
    """The intrinsic that adds the forces of one window of cells: ``element``, ``volume`` or ``guard``.

    It takes displacement, numbers of the cells, forces on the nodes, law, rows and window, and says whether a corner
    is below LOOK_BELOW.
    """

    @intrinsic
    def window_forces(typing_context, displacement, numbers, cell_force, law, rows, window):
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            arrays = zip(signature.args[:5], arguments, strict=False)
            u, n, f, constants, starts = (array_data(context, builder, *pair) for pair in arrays)
            here = Window(builder, starts, arguments[5])
            corners = tuple(here.load_vector(u, offset) for offset in _CORNERS)
            scale = _number(here, n, arguments[5], 0)
            if kind == "element":
                forces = _math.element(
                    corners, scale, scale, _moments(here, n, arguments[5]), _law(builder, constants), NOTHING_SHARED
                )
            elif kind == "volume":
                forces = _math.volume_term(corners, scale, _constant(builder, constants, 0))
            else:
                floor = _constant(builder, constants, _FLOOR_NUMBER)
                forces = _math.corner_guard(corners, _number(here, n, arguments[5], CELL_NUMBERS - 1), floor)
            _add_forces(here, f, forces)
            return nothing(context) if kind == "guard" else _has_flat_corner(here, corners, scale)

        result = types.void if kind == "guard" else types.boolean
        return result(displacement, numbers, cell_force, law, rows, types.int64), codegen

    return window_forces


@intrinsic
def sharing_element_of_window(typing_context, displacement, numbers, shares, stress, cell_force, law, rows, window):
    """Add the forces of one window of elements that share strain; takes the stress of the means around the nodes.

    Says whether a corner is below LOOK_BELOW.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:7], arguments, strict=False)
        u, n, w, p, f, constants, starts = (array_data(context, builder, *pair) for pair in arrays)
        here = Window(builder, starts, arguments[7])
        corners = tuple(here.load_vector(u, offset) for offset in _CORNERS)
        window_of = arguments[7]
        shared = _sum(here, w, window_of, p, _CORNERS)
        scale, own = _number(here, n, window_of, 0), _share(here, w, window_of, _OWN_NUMBER)
        moments = _moments(here, n, window_of)
        forces = _math.element(corners, scale, own, moments, _law(builder, constants), _columns(shared))
        _add_forces(here, f, forces)
        return _has_flat_corner(here, corners, scale)

    return types.boolean(displacement, numbers, shares, stress, cell_force, law, rows, types.int64), codegen


@intrinsic
def gradient_of_window(typing_context, displacement, numbers, gradient, rows, window):
    """Write the nine numbers of F - 1 of a window of cells."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:4], arguments, strict=False)
        u, n, g, starts = (array_data(context, builder, *pair) for pair in arrays)
        here = Window(builder, starts, arguments[4])
        corners = tuple(here.load_vector(u, offset) for offset in _CORNERS)
        _store(here, g, _math.gradient(corners, _moments(here, n, arguments[4])))
        return nothing(context)

    return types.void(displacement, numbers, gradient, rows, types.int64), codegen


def _make_mean_stress(has_more: bool) -> Any:
    """The intrinsic that writes the stress of the means around one window of nodes.

    It takes gradients, the nodes' shares, what is added to each of the sums, the stress, law, rows, the window, and
    the window's number among those to which something is added.
    """

    @intrinsic
    def stress_of(typing_context, gradient, node_shares, more, stress, law, rows, window, place):
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            arrays = zip(signature.args[:6], arguments, strict=False)
            g, w, m, p, constants, starts = (array_data(context, builder, *pair) for pair in arrays)
            here = Window(builder, starts, arguments[6])
            # A node is the corner of the cell behind it by that corner's offset.
            totals = _sum(here, w, arguments[6], g, [(-i, -j, -k) for i, j, k in _CORNERS])
            if has_more:
                totals = [total + _share(here, m, arguments[7], number) for number, total in enumerate(totals)]
            inverse = _share(here, w, arguments[6], _INVERSE_NUMBER)
            mean = [total * inverse for total in totals]
            _store(here, p, _math.stretching(_columns(mean), _law(builder, constants)))
            return nothing(context)

        return types.void(gradient, node_shares, more, stress, law, rows, types.int64, types.int64), codegen

    return stress_of


def _sum(here: Window, shares: Any, window: Any, values: Any, offsets: list[tuple[int, int, int]]) -> list[Lanes]:
    """Nine numbers each at eight offsets, times a share of the window's, added up."""
    totals: list[Lanes] = []
    for number, offset in enumerate(offsets):
        share = _share(here, shares, window, number)
        terms = [here.load(values, component, offset) * share for component in range(SHARE_NUMBERS)]
        totals = [total + term for total, term in zip(totals, terms, strict=True)] if totals else terms
    return totals


def _columns(nine: list[Lanes]) -> tuple[Vector, ...]:
    return tuple((nine[place], nine[place + 1], nine[place + 2]) for place in (0, 3, 6))


def _store(here: Window, array: Any, columns: tuple[Vector, ...]) -> None:
    """Write three columns as nine numbers."""
    for number, value in enumerate(component for column in columns for component in column):
        value.store(here.pointer(array, number))


def _number(here: Window, numbers: Any, window: Any, which: int) -> Lanes:
    return Lanes.of_window(here.builder, numbers, window, which, CELL_NUMBERS)


def _share(here: Window, shares: Any, window: Any, which: int) -> Lanes:
    return Lanes.of_window(here.builder, shares, window, which, SHARE_NUMBERS)


def _moments(here: Window, numbers: Any, window: Any) -> tuple[Lanes, ...]:
    return tuple(_number(here, numbers, window, number) for number in range(1, CELL_NUMBERS - 1))


def _law(builder: Any, constants: Any) -> tuple[Lanes, ...]:
    return tuple(_constant(builder, constants, number) for number in range(5))


def _add_forces(here: Window, node_force: Any, forces: Any) -> None:
    for axis, at_corners in enumerate(forces):
        _add_to_nodes(here, node_force, axis, dict(zip(_CORNERS, at_corners, strict=True)))


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
mean_stress_of_window = _make_mean_stress(has_more=False)
mean_stress_of_window_with_more = _make_mean_stress(has_more=True)


@intrinsic
def clear_window(typing_context, force, rows, window):
    """Set the forces on a window of nodes to zero."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        f, starts = (array_data(context, builder, *pair) for pair in zip(signature.args[:2], arguments, strict=False))
        here = Window(builder, starts, arguments[2])
        for axis in range(3):
            Lanes.filled(builder, 0.0).store(here.pointer(f, axis))
        return nothing(context)

    return types.void(force, rows, types.int64), codegen


def _spread(corners: tuple[Vector, ...]) -> Lanes:
    """Largest difference of two corners' displacements, along any axis."""
    spreads = []
    for axis in range(3):
        values = [corner[axis] for corner in corners]
        spreads.append(reduce(Lanes.greater, values) - reduce(Lanes.lesser, values))
    return reduce(Lanes.greater, spreads)


def _has_flat_corner(here: Window, corners: tuple[Vector, ...], scale: Lanes) -> Any:
    """Whether a corner of a window's cells has a volume below LOOK_BELOW."""
    builder = here.builder
    # Lanes without a cell have no stiffness, wherever the nodes around them are.
    spread = _spread(corners).where_positive(scale, Lanes.filled(builder, 0.0))
    result = room(builder, ir.IntType(1))
    builder.store(ir.Constant(ir.IntType(1), 0), result)
    with builder.if_then((spread - CALM).is_any_positive()):
        lack = _math.corner_lack(corners, np.float32(LOOK_BELOW)) * scale
        builder.store(lack.is_any_positive(), result)
    return builder.load(result)


@intrinsic
def is_flat_window(typing_context, displacement, numbers, rows, window):
    """Whether a corner of one of a window's cells has a volume below LOOK_BELOW."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:3], arguments, strict=False)
        u, n, starts = (array_data(context, builder, *pair) for pair in arrays)
        here = Window(builder, starts, arguments[3])
        corners = tuple(here.load_vector(u, offset) for offset in _CORNERS)
        return _has_flat_corner(here, corners, _number(here, n, arguments[3], 0))

    return types.boolean(displacement, numbers, rows, types.int64), codegen
