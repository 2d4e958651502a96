"""Vector code for numba: windows of lanes as values with the operators of arithmetic.

A kernel's window is written as vector code (an intrinsic that emits it): left to itself the compiler does not prove
that the arrays are apart, and comes out at half the speed. LLVM cuts the vectors to the width of the machine.
"""

from __future__ import annotations

import platform
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from heartcase.compiling.emitting import named_function, nothing, room
from heartcase.simulator.engine.shared.lanes import (
    BANK_LANES,
    CELL_LANES,
    CELL_PARTS,
    CORNER_ROWS,
    LANE_COUNT,
    PART_LANES,
    ROWS,
)

__all__ = [
    "CellWindow",
    "Lanes",
    "Vector",
    "Window",
    "flush_subnormals",
    "has_many_registers",
    "has_wide_registers",
    "restore_subnormals",
]

_FLOAT = ir.FloatType()
_INDEX = ir.IntType(64)
_PLACE = ir.IntType(32)


def _vector(count: int) -> ir.VectorType:
    return ir.VectorType(_FLOAT, count)


class Lanes:
    """The value of some lanes, such as a window's, in the code being emitted, with the operators of arithmetic.

    A sum with a product is one fused operation where the processor has it: more exact, and faster. That is settled
    here: left to LLVM (``contract``), which sums are fused depends on the code around them, and two compiled copies of
    the same sum may differ in the last bit.
    """

    __array_ufunc__ = None
    """Numbers of NumPy leave the operators to this class."""

    def __init__(self, builder: Any, value: Any, factors: tuple[Any, Any] | None = None) -> None:
        self.builder = builder
        self.value = value
        self.factors = factors
        """What the value is a product of, if it is one: a sum takes these, and LLVM drops a product that none reads."""

    @property
    def count(self) -> int:
        """How many lanes there are."""
        count: int = self.value.type.count
        return count

    @classmethod
    def filled(cls, builder: Any, number: Any, count: int = LANE_COUNT) -> Lanes:
        """The same number in every lane: a constant, or a float32 of the program."""
        if isinstance(number, int | float | np.floating):
            return cls(builder, ir.Constant(_vector(count), [float(np.float32(number))] * count))
        one = builder.insert_element(ir.Constant(_vector(count), ir.Undefined), number, ir.Constant(_PLACE, 0))
        return cls(builder, one).at([0] * count)

    @classmethod
    def loaded(cls, builder: Any, pointer: Any, count: int = LANE_COUNT) -> Lanes:
        """The lanes that start at a pointer to float32."""
        return cls(builder, builder.load(builder.bitcast(pointer, _vector(count).as_pointer()), align=4))

    @classmethod
    def of_window(cls, builder: Any, numbers: Any, window: Any, which: int, count: int) -> Lanes:
        """One of the ``count`` numbers of a window's lanes that lie side by side in memory."""
        first = builder.mul(window, ir.Constant(_INDEX, count * LANE_COUNT))
        place = builder.add(first, ir.Constant(_INDEX, which * LANE_COUNT))
        return cls.loaded(builder, builder.gep(numbers, [place]))

    @classmethod
    def gathered(cls, builder: Any, pointers: list[Any]) -> Lanes:
        """Float32 that lie anywhere, one for each lane."""
        value = ir.Constant(_vector(len(pointers)), ir.Undefined)
        for place, pointer in enumerate(pointers):
            value = builder.insert_element(value, builder.load(pointer), ir.Constant(_PLACE, place))
        return cls(builder, value)

    @classmethod
    def joined(cls, parts: list[Lanes]) -> Lanes:
        """As many lanes each of two, four or more parts, one after the other."""
        while len(parts) > 1:
            parts = [one.at([*range(2 * one.count)], other) for one, other in zip(parts[::2], parts[1::2], strict=True)]
        return parts[0]

    def at(self, places: list[int], more: Lanes | None = None) -> Lanes:
        """The lanes at some places; those of ``more`` follow behind these."""
        mask = ir.Constant(ir.VectorType(_PLACE, len(places)), places)
        return Lanes(self.builder, self.builder.shuffle_vector(self.value, (more or self).value, mask))

    def store(self, pointer: Any) -> None:
        """Write the lanes from a pointer to float32 on."""
        self.builder.store(self.value, self.builder.bitcast(pointer, self.value.type.as_pointer()), align=4)

    def _other(self, other: Lanes | float) -> Lanes:
        return other if isinstance(other, Lanes) else Lanes.filled(self.builder, other, self.count)

    def __add__(self, other: Lanes | float) -> Lanes:
        if _is_zero(other):
            return self
        right = self._other(other)
        if right.factors:
            return self._fused(right.factors, self)
        if self.factors:
            return self._fused(self.factors, right)
        return Lanes(self.builder, self.builder.fadd(self.value, right.value))

    __radd__ = __add__

    def __neg__(self) -> Lanes:
        factors = (self.builder.fneg(self.factors[0]), self.factors[1]) if self.factors else None
        return Lanes(self.builder, self.builder.fneg(self.value), factors)

    def __sub__(self, other: Lanes | float) -> Lanes:
        if _is_zero(other):
            return self
        right = self._other(other)
        if self.factors or right.factors:
            return self + -right
        return Lanes(self.builder, self.builder.fsub(self.value, right.value))

    def __rsub__(self, other: float) -> Lanes:
        return self._other(other) - self

    def __mul__(self, other: Lanes | float) -> Lanes:
        factors = (self.value, self._other(other).value)
        return Lanes(self.builder, self.builder.fmul(*factors), factors)

    __rmul__ = __mul__

    def __rtruediv__(self, other: float) -> Lanes:
        return self._other(other) / self

    def __truediv__(self, other: Lanes | float) -> Lanes:
        return Lanes(self.builder, self.builder.fdiv(self.value, self._other(other).value))

    def _fused(self, factors: tuple[Any, Any], summand: Lanes) -> Lanes:
        """``llvm.fmuladd``: one operation or two, as is quicker on the processor, but the same in all its code."""
        kind = ir.FunctionType(self.value.type, [self.value.type] * 3)
        function = named_function(self.builder, kind, f"llvm.fmuladd.v{self.count}f32")
        return Lanes(self.builder, self.builder.call(function, [*factors, summand.value]))

    def after(self, first: Any) -> Lanes:
        """These lanes one place on, after a float32 of the program; the last is left out."""
        return self.at([self.count, *range(self.count - 1)], Lanes.filled(self.builder, first, self.count))

    def lane(self, place: int) -> Any:
        """One lane: a float32 of the program."""
        return self.builder.extract_element(self.value, ir.Constant(_PLACE, place))

    def worked_out_here(self) -> Lanes:
        """The same lanes; what they follow from is not moved behind this, nor what follows from them before it.

        For processors with AVX-512 only.
        """
        kind = ir.FunctionType(self.value.type, [self.value.type])
        nothing = ir.InlineAsm(kind, "", "=v,0", side_effect=True)
        return Lanes(self.builder, self.builder.call(nothing, [self.value]))

    def root(self) -> Lanes:
        """Square root."""
        kind = ir.FunctionType(self.value.type, [self.value.type])
        function = named_function(self.builder, kind, f"llvm.sqrt.v{self.count}f32")
        return Lanes(self.builder, self.builder.call(function, [self.value]))

    def positive_part(self) -> Lanes:
        """These lanes where they are above zero, else zero."""
        return self.where_positive(self, self._other(0.0))

    def lesser(self, other: Lanes) -> Lanes:
        """These lanes or the other's, whichever are less."""
        is_less = self.builder.fcmp_ordered("<", self.value, other.value)
        return Lanes(self.builder, self.builder.select(is_less, self.value, other.value))

    def greater(self, other: Lanes) -> Lanes:
        """These lanes or the other's, whichever are greater."""
        is_greater = self.builder.fcmp_ordered(">", self.value, other.value)
        return Lanes(self.builder, self.builder.select(is_greater, self.value, other.value))

    def clamped(self, limit: Lanes) -> Lanes:
        """These lanes, within plus and minus a limit; what is not a number stays."""
        low = -limit
        is_above = self.builder.fcmp_ordered(">", self.value, limit.value)
        below = Lanes(self.builder, self.builder.select(is_above, limit.value, self.value))
        is_below = self.builder.fcmp_ordered("<", below.value, low.value)
        return Lanes(self.builder, self.builder.select(is_below, low.value, below.value))

    def is_any_positive(self) -> Any:
        """Whether any lane is above zero: one bit of the program."""
        positive = self.builder.fcmp_ordered(">", self.value, self._other(0.0).value)
        bits = ir.IntType(self.count)
        return self.builder.icmp_unsigned("!=", self.builder.bitcast(positive, bits), ir.Constant(bits, 0))

    def where_positive(self, mask: Lanes, other: Lanes) -> Lanes:
        """These lanes where the mask is above zero, the other's elsewhere."""
        positive = self.builder.fcmp_ordered(">", mask.value, self._other(0.0).value)
        return Lanes(self.builder, self.builder.select(positive, self.value, other.value))


def _is_zero(other: Lanes | float) -> bool:
    return isinstance(other, int | float | np.floating) and other == 0


Vector = tuple[Lanes, Lanes, Lanes]


class Window:
    """Where the lanes of one window and of its neighbours are, in the code being emitted."""

    count = LANE_COUNT

    def __init__(self, builder: Any, rows: Any, window: Any) -> None:
        self.builder = builder
        first = builder.mul(window, ir.Constant(_INDEX, len(ROWS)))
        self.starts = {
            (int(j), int(k)): builder.load(builder.gep(rows, [builder.add(first, ir.Constant(_INDEX, number))]))
            for number, (j, k) in enumerate(ROWS)
        }

    def pointer(self, data: Any, component: int, offset: tuple[int, int, int] = (0, 0, 0)) -> Any:
        """Pointer to a component's lanes at an offset (i, j, k) from the window's own."""
        place = ir.Constant(_INDEX, component * BANK_LANES + offset[0])
        return self.builder.gep(data, [self.builder.add(self.starts[offset[1], offset[2]], place)])

    def load(self, data: Any, component: int, offset: tuple[int, int, int] = (0, 0, 0)) -> Lanes:
        """A component's lanes at an offset from the window's own."""
        return Lanes.loaded(self.builder, self.pointer(data, component, offset))

    def load_vector(self, data: Any, offset: tuple[int, int, int] = (0, 0, 0)) -> Vector:
        """The lanes of the three components at an offset from the window's own."""
        x, y, z = (self.load(data, axis, offset) for axis in range(3))
        return x, y, z


class CellWindow:
    """Where the lanes of some parts of a window of cells are, and of the cells' corners, in the code being emitted.

    A window of cells is CELL_PARTS times PART_LANES lanes that may lie apart: a lane's neighbours along j and k are at
    a distance of its part's. Where parts follow each other two by two, each pair is loaded and stored at once.
    """

    def __init__(self, builder: Any, rows: Any, window: Any, parts: range, in_pairs: bool) -> None:
        self.builder = builder
        self.count = PART_LANES * len(parts)
        self.pieces = [range(place, place + PART_LANES * (1 + in_pairs)) for place in range(0, self.count, PART_LANES)]
        if in_pairs:
            self.pieces = self.pieces[::2]
        self._first_lane = PART_LANES * parts.start
        row_count = len(CORNER_ROWS)
        first = builder.mul(window, ir.Constant(_INDEX, CELL_PARTS * row_count))
        self._starts = []
        for part in parts[:: 1 + in_pairs]:
            places = [builder.add(first, ir.Constant(_INDEX, row_count * part + row)) for row in range(row_count)]
            self._starts.append([builder.load(builder.gep(rows, [place])) for place in places])

    def pointer(self, piece: int, data: Any, component: int, offset: tuple[int, int, int] = (0, 0, 0)) -> Any:
        """Pointer to a component's lanes of a piece, by its number, at an offset (i, j, k)."""
        i, j, k = offset
        place = ir.Constant(_INDEX, component * BANK_LANES + i)
        return self.builder.gep(data, [self.builder.add(self._starts[piece][j + 2 * k], place)])

    def load(self, data: Any, component: int, offset: tuple[int, int, int] = (0, 0, 0)) -> Lanes:
        """A component's lanes at an offset."""
        pointers = [self.pointer(piece, data, component, offset) for piece in range(len(self.pieces))]
        return Lanes.joined([Lanes.loaded(self.builder, pointer, len(self.pieces[0])) for pointer in pointers])

    def load_vector(self, data: Any, offset: tuple[int, int, int] = (0, 0, 0)) -> Vector:
        """The lanes of the three components at an offset."""
        x, y, z = (self.load(data, axis, offset) for axis in range(3))
        return x, y, z

    def store(self, value: Lanes, data: Any, component: int) -> None:
        """Write a component's lanes."""
        for piece, places in enumerate(self.pieces):
            value.at([*places]).store(self.pointer(piece, data, component))

    def number(self, numbers: Any, window: Any, which: int, count: int) -> Lanes:
        """One of the ``count`` numbers of the window's lanes that lie side by side in memory."""
        first = self.builder.mul(window, ir.Constant(_INDEX, count * CELL_LANES))
        place = self.builder.add(first, ir.Constant(_INDEX, which * CELL_LANES + self._first_lane))
        return Lanes.loaded(self.builder, self.builder.gep(numbers, [place]), self.count)


def has_many_registers(context: Any) -> bool:
    """Whether the code being emitted is for a processor with 32 registers of 8 lanes: AVX-512, not AVX2 or NEON."""
    return "+avx512vl" in context.codegen().magic_tuple()[2]


def has_wide_registers(context: Any) -> bool:
    """Whether it is for one with 32 registers of 16 lanes."""
    return "+avx512f" in context.codegen().magic_tuple()[2]


_FLUSH = 0x8040
"""The bits of x86's MXCSR that take numbers below 1e-38 for zero, in results and in operands."""


@intrinsic
def flush_subnormals(typing_context):
    """Take numbers below 1e-38 for zero in this thread from now on; returns what to restore.

    A wave in tissue at rest is of such numbers for a long time, and with them x86 takes three times as long. Other
    processors have no such handicap: there nothing is done.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        control = room(builder, ir.IntType(32))
        if not _IS_X86:
            return ir.Constant(ir.IntType(32), 0)
        _control_word(builder, "stmxcsr", control)
        before = builder.load(control)
        builder.store(builder.or_(before, ir.Constant(ir.IntType(32), _FLUSH)), control)
        _control_word(builder, "ldmxcsr", control)
        return before

    return types.int32(), codegen


@intrinsic
def restore_subnormals(typing_context, before):
    """Undo :func:`flush_subnormals`."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if _IS_X86:
            control = room(builder, ir.IntType(32))
            builder.store(arguments[0], control)
            _control_word(builder, "ldmxcsr", control)
        return nothing(context)

    return types.void(types.int32), codegen


_IS_X86 = platform.machine().lower() in ("x86_64", "amd64")


def _control_word(builder: Any, action: str, control: Any) -> None:
    """Load or store the control word of floating-point arithmetic."""
    byte = ir.IntType(8).as_pointer()
    kind = ir.FunctionType(ir.VoidType(), [byte])
    function = named_function(builder, kind, f"llvm.x86.sse.{action}")
    builder.call(function, [builder.bitcast(control, byte)])
