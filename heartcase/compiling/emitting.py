"""What intrinsics need of numba's code generator: the data of arrays, rooms for values, loops, functions by name.

An intrinsic emits LLVM code with ``llvmlite.ir``, which is public; the rest of it is numba's inside, and is here.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

from llvmlite import ir
from numba.core import cgutils

__all__ = [
    "align_stack",
    "array_data",
    "counted",
    "length",
    "named_function",
    "nothing",
    "room",
    "room_with",
    "tuple_parts",
]


def array_data(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Pointer to an array's data."""
    return context.make_array(kind)(context, builder, value).data


def length(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Length of an array along its first axis."""
    array = context.make_array(kind)(context, builder, value)
    return cgutils.unpack_tuple(builder, array.shape)[0]


def tuple_parts(builder: Any, value: Any, count: int) -> list[Any]:
    """The first values of a tuple."""
    parts: list[Any] = cgutils.unpack_tuple(builder, value, count)
    return parts


def room(builder: Any, kind: ir.Type) -> Any:
    """Pointer to room for a value, made once a call."""
    return cgutils.alloca_once(builder, kind)


def room_with(builder: Any, value: Any) -> Any:
    """Pointer to room for a value, made once a call, with the value in it."""
    return cgutils.alloca_once_value(builder, value)


def align_stack(builder: Any) -> None:
    """Have the stack begin on a cache line in the function being emitted.

    Vectors for which there is no register are kept there. LLVM aligns them only where something else asks for it;
    elsewhere most of them lie across two lines, and each load and store of one takes twice as long.
    """
    line = ir.ArrayType(ir.IntType(8), 64)
    place = cgutils.alloca_once(builder, line)
    place.align = 64
    kind = ir.FunctionType(ir.VoidType(), [place.type])
    builder.call(ir.InlineAsm(kind, "", "r", side_effect=True), [place])


def counted(builder: Any, first: Any, end: Any) -> AbstractContextManager[tuple[Any, Any]]:
    """A loop over whole numbers of 64 bits from ``first`` to before ``end``: in it, the number and its step."""
    loop: AbstractContextManager[tuple[Any, Any]] = cgutils.for_range_slice(
        builder, first, end, ir.Constant(ir.IntType(64), 1)
    )
    return loop


def named_function(builder: Any, kind: ir.FunctionType, name: str) -> Any:
    """A function of LLVM's or of the system, by its name."""
    return cgutils.get_or_insert_function(builder.module, kind, name)


def nothing(context: Any) -> Any:
    """What an intrinsic without a result returns."""
    return context.get_dummy_value()
