"""Cells in the CPU kernel, in windows of 16: forces of elements, of the volume term and of the corner guard.

A cell is kept in the lane of its lowest corner. A window of cells adds its forces to those on the nodes, row by row: of
two cells side by side in a part, the forces on the nodes between them are added first. Where registers are short, a
window is worked out in halves, to the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from heartcase.compiling.emitting import align_stack, array_data, nothing, room_with
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.simulator.engine.cpu.vector_ir import CellWindow, Lanes, Vector, Window, has_wide_registers
from heartcase.simulator.engine.shared.lanes import CELL_NUMBERS, CELL_PARTS, LANE_COUNT, PART_LANES, SHARE_NUMBERS
from heartcase.simulator.forces.cell_math import NOTHING_SHARED, make_cell_math
from heartcase.simulator.lattice.moduli import LOOK_BELOW

__all__ = [
    "CALM",
    "FLAT",
    "PRESSED",
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
FLAT, PRESSED = np.int8(1), np.int8(2)
"""What a window of cells has: a corner below LOOK_BELOW; one below the floor, which pushes back."""
Offset = tuple[int, int, int]
_CORNERS: list[Offset] = [(int(i), int(j), int(k)) for i, j, k in CORNER_OFFSETS]

_OWN_NUMBER = len(_CORNERS)
"""Place in the shares of a cell of the stiffness that is stretched as the cell is."""
_INVERSE_NUMBER = len(_CORNERS)
"""Place in a node's shares of the inverse of what shares strain around it."""

_FLOOR_NUMBER = 5
"""Place of the corners' floor in the law's constants."""

_math = make_cell_math(lambda function: function, Lanes.positive_part)


def _at_once_or_in_halves(
    context: Any, builder: Any, rows: Any, window: Any, in_pairs: Any, emit: Callable[[list[CellWindow]], Any]
) -> None:
    """Emit code for a window of cells: for all of it where there are 32 registers of 16 lanes, else for its two halves.

    It is there twice, for windows whose parts follow each other in pairs and for others.
    """
    align_stack(builder)
    count = CELL_PARTS if has_wide_registers(context) else LANE_COUNT // PART_LANES
    with builder.if_else(builder.icmp_signed("!=", in_pairs, in_pairs.type(0))) as (pairs, others):
        for branch, has_pairs in ((pairs, True), (others, False)):
            with branch:
                parts = [range(first, first + count) for first in range(0, CELL_PARTS, count)]
                emit([CellWindow(builder, rows, window, these, has_pairs) for these in parts])


def _corners_of(here: CellWindow, displacement: Any) -> tuple[Vector, ...]:
    return tuple(here.load_vector(displacement, offset) for offset in _CORNERS)


def _make_cell_window(kind: str) -> Any:
    """The intrinsic that adds the forces of one window of cells: ``element``, ``volume`` or ``guard``.

    It takes displacement, numbers of the cells, forces on the nodes, law, rows, window and whether its parts are in
    pairs, and says what there is of FLAT and PRESSED.
    """

    @intrinsic
    def window_forces(typing_context, displacement, numbers, cell_force, law, rows, window, in_pairs):
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            arrays = zip(signature.args[:5], arguments, strict=False)
            u, n, f, constants, starts = (array_data(context, builder, *pair) for pair in arrays)
            window_of, flag = arguments[5], _Flag(builder)

            def emit(halves: list[CellWindow]) -> None:
                added = []
                for here in halves:
                    corners, scale = _corners_of(here, u), _number(here, n, window_of, 0)
                    if kind == "element":
                        moments, law_of = _moments(here, n, window_of), _law(here, constants)
                        forces = _math.element(corners, scale, scale, moments, law_of, NOTHING_SHARED)
                    elif kind == "volume":
                        forces = _math.volume_term(corners, scale, _constant(here, constants, 0))
                    else:
                        guard = _number(here, n, window_of, CELL_NUMBERS - 1)
                        forces = _math.corner_guard(corners, guard, _constant(here, constants, _FLOOR_NUMBER))
                    added.append((here, forces))
                    if kind != "guard":
                        flag.look(corners, scale, _constant(here, constants, _FLOOR_NUMBER))
                _add_forces(f, added)

            _at_once_or_in_halves(context, builder, starts, window_of, arguments[6], emit)
            return nothing(context) if kind == "guard" else flag.read()

        result = types.void if kind == "guard" else types.int8
        return result(displacement, numbers, cell_force, law, rows, types.int64, types.int8), codegen

    return window_forces


@intrinsic
def sharing_element_of_window(
    typing_context, displacement, numbers, shares, stress, cell_force, law, rows, window, in_pairs
):
    """Add the forces of one window of elements that share strain; takes the stress of the means around the nodes.

    Says what there is of FLAT and PRESSED.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:7], arguments, strict=False)
        u, n, w, p, f, constants, starts = (array_data(context, builder, *pair) for pair in arrays)
        window_of, flag = arguments[7], _Flag(builder)

        def emit(halves: list[CellWindow]) -> None:
            added = []
            for here in halves:
                corners = _corners_of(here, u)
                weights = [here.number(w, window_of, number, SHARE_NUMBERS) for number in range(SHARE_NUMBERS)]
                shared = _sum(here, weights, p, _CORNERS)
                scale, own = _number(here, n, window_of, 0), weights[_OWN_NUMBER]
                moments, law_of = _moments(here, n, window_of), _law(here, constants)
                added.append((here, _math.element(corners, scale, own, moments, law_of, _columns(shared))))
                flag.look(corners, scale, _constant(here, constants, _FLOOR_NUMBER))
            _add_forces(f, added)

        _at_once_or_in_halves(context, builder, starts, window_of, arguments[8], emit)
        return flag.read()

    arrays = (displacement, numbers, shares, stress, cell_force, law, rows)
    return types.int8(*arrays, types.int64, types.int8), codegen


@intrinsic
def gradient_of_window(typing_context, displacement, numbers, gradient, rows, window, in_pairs):
    """Write the nine numbers of F - 1 of a window of cells."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:4], arguments, strict=False)
        u, n, g, starts = (array_data(context, builder, *pair) for pair in arrays)

        def emit(halves: list[CellWindow]) -> None:
            for here in halves:
                columns = _math.gradient(_corners_of(here, u), _moments(here, n, arguments[4]))
                for number, value in enumerate(component for column in columns for component in column):
                    here.store(value, g, number)

        _at_once_or_in_halves(context, builder, starts, arguments[4], arguments[5], emit)
        return nothing(context)

    return types.void(displacement, numbers, gradient, rows, types.int64, types.int8), codegen


def _make_mean_stress(has_more: bool) -> Any:
    """The intrinsic that writes the stress of the means around one window of nodes.

    It takes gradients, the nodes' shares, what is added to each of the sums, the stress, law, rows, the window, and
    the window's number among those to which something is added.
    """

    @intrinsic
    def stress_of(typing_context, gradient, node_shares, more, stress, law, rows, window, place):
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            align_stack(builder)
            arrays = zip(signature.args[:6], arguments, strict=False)
            g, w, m, p, constants, starts = (array_data(context, builder, *pair) for pair in arrays)
            here = Window(builder, starts, arguments[6])
            weights = [_share(here, w, arguments[6], number) for number in range(SHARE_NUMBERS)]
            # A node is the corner of the cell behind it by that corner's offset.
            totals = _sum(here, weights, g, [(-i, -j, -k) for i, j, k in _CORNERS])
            if has_more:
                totals = [total + _share(here, m, arguments[7], number) for number, total in enumerate(totals)]
            mean = [total * weights[_INVERSE_NUMBER] for total in totals]
            columns = _math.stretching(_columns(mean), _law(here, constants))
            for number, value in enumerate(component for column in columns for component in column):
                value.store(here.pointer(p, number))
            return nothing(context)

        return types.void(gradient, node_shares, more, stress, law, rows, types.int64, types.int64), codegen

    return stress_of


def _sum(here: Window | CellWindow, weights: list[Lanes], values: Any, offsets: list[Offset]) -> list[Lanes]:
    """Nine numbers each at eight offsets, times a weight each, added up."""
    totals: list[Lanes] = []
    for weight, offset in zip(weights, offsets, strict=False):
        terms = [here.load(values, component, offset) * weight for component in range(SHARE_NUMBERS)]
        totals = [total + term for total, term in zip(totals, terms, strict=True)] if totals else terms
    return totals


def _columns(nine: list[Lanes]) -> tuple[Vector, ...]:
    return tuple((nine[place], nine[place + 1], nine[place + 2]) for place in (0, 3, 6))


def _number(here: CellWindow, numbers: Any, window: Any, which: int) -> Lanes:
    return here.number(numbers, window, which, CELL_NUMBERS)


def _share(here: Window, shares: Any, window: Any, which: int) -> Lanes:
    return Lanes.of_window(here.builder, shares, window, which, SHARE_NUMBERS)


def _moments(here: CellWindow, numbers: Any, window: Any) -> tuple[Lanes, ...]:
    return tuple(_number(here, numbers, window, number) for number in range(1, CELL_NUMBERS - 1))


def _law(here: Window | CellWindow, constants: Any) -> tuple[Lanes, ...]:
    return tuple(_constant(here, constants, number) for number in range(5))


def _constant(here: Window | CellWindow, array: Any, number: int) -> Lanes:
    builder = here.builder
    value = builder.load(builder.gep(array, [ir.Constant(ir.IntType(64), number)]))
    return Lanes.filled(builder, value, here.count)


def _add_forces(node_force: Any, added: list[tuple[CellWindow, Any]]) -> None:
    """Add the forces of a window of cells on their corners to those on the nodes.

    First the nodes in the lanes of the cells, then the one behind them, which may be in those of others: a number that
    was just stored by itself is not at hand for a load of several. Parts may have nodes in common: a corner's forces of
    all halves are added before the next corner's, as they would be of a whole window.
    """
    halves = [here for here, _ in added]
    for is_behind in (False, True):
        for axis in range(3):
            of_halves = [dict(zip(_CORNERS, forces[axis], strict=True)) for _, forces in added]
            for j, k in ((0, 0), (1, 0), (0, 1), (1, 1)):
                for here, corners in zip(halves, of_halves, strict=True):
                    at_left, at_right = corners[0, j, k], corners[1, j, k]
                    if is_behind:
                        _add_behind(here, node_force, axis, at_right, (1, j, k))
                    else:
                        _add_in_lanes(here, node_force, axis, at_left + _moved_on(here, at_right), (0, j, k))


def _moved_on(here: CellWindow, lanes: Lanes) -> Lanes:
    """Lanes that follow each other in memory one place on, after a zero; the last is left out."""
    firsts = {places[0] for places in here.pieces}
    places = [here.count if place in firsts else place - 1 for place in range(here.count)]
    return lanes.at(places, Lanes.filled(here.builder, 0.0, here.count))


def _add_in_lanes(here: CellWindow, node_force: Any, axis: int, force: Lanes, offset: Offset) -> None:
    for piece, places in enumerate(here.pieces):
        pointer = here.pointer(piece, node_force, axis, offset)
        (Lanes.loaded(here.builder, pointer, len(places)) + force.at([*places])).store(pointer)


def _add_behind(here: CellWindow, node_force: Any, axis: int, force: Lanes, offset: Offset) -> None:
    i, j, k = offset
    for piece, places in enumerate(here.pieces):
        pointer = here.pointer(piece, node_force, axis, (i * len(places), j, k))
        here.builder.store(here.builder.fadd(here.builder.load(pointer), force.lane(places[-1])), pointer)


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


class _Flag:
    """What some cells have of FLAT and PRESSED, in the code being emitted."""

    def __init__(self, builder: Any) -> None:
        self.builder = builder
        self._room = room_with(builder, ir.Constant(ir.IntType(8), 0))

    def look(self, corners: tuple[Vector, ...], scale: Lanes, floor: Lanes | None = None) -> None:
        """Look at more cells; without a floor for FLAT alone."""
        builder = self.builder
        # Lanes without a cell have no stiffness, wherever the nodes around them are.
        spread = _spread(corners).where_positive(scale, Lanes.filled(builder, 0.0, scale.count))
        with builder.if_then((spread - CALM).is_any_positive()):
            is_flat = (_math.corner_lack(corners, np.float32(LOOK_BELOW)) * scale).is_any_positive()
            with builder.if_then(is_flat):
                self._raise(FLAT)
                if floor is not None:
                    with builder.if_then((_math.corner_lack(corners, floor) * scale).is_any_positive()):
                        self._raise(PRESSED)

    def _raise(self, what: np.int8) -> None:
        self.builder.store(self.builder.or_(self.read(), ir.Constant(ir.IntType(8), int(what))), self._room)

    def read(self) -> Any:
        """What there was so far: an int8 of the program."""
        return self.builder.load(self._room)


@intrinsic
def is_flat_window(typing_context, displacement, numbers, rows, window, in_pairs):
    """FLAT where a corner of one of a window's cells has a volume below LOOK_BELOW, else zero."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = zip(signature.args[:3], arguments, strict=False)
        u, n, starts = (array_data(context, builder, *pair) for pair in arrays)
        flag = _Flag(builder)

        def emit(halves: list[CellWindow]) -> None:
            for here in halves:
                flag.look(_corners_of(here, u), _number(here, n, arguments[3], 0))

        _at_once_or_in_halves(context, builder, starts, arguments[3], arguments[4], emit)
        return flag.read()

    return types.int8(displacement, numbers, rows, types.int64, types.int8), codegen
