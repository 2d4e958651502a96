"""Tuples of arrays that kernels hand on by address, and arrays whose references are not counted.

numba hands a tuple over as all parts of all its arrays, and counts the references to each of them, at every call. With
the twenty arrays of a field layout that was much of what a first start compiled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.cgutils import alloca_once_value, get_null_value
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate, Signature
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model

__all__ = ["Lent", "lend", "uncounted"]


class Lent(types.Type):
    """Type of the address of a named tuple; its members, tuples again lent, are read by their names."""

    def __init__(self, owner: Any) -> None:
        self.owner = owner
        super().__init__(f"Lent({owner})")


@register_model(Lent)
class _LentModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: Lent) -> None:
        super().__init__(dmm, fe_type, dmm.lookup(fe_type.owner).get_value_type().as_pointer())


@intrinsic  # type: ignore[untyped-decorator]
def lend(typing_context: Any, owner: types.Type) -> Any:
    """Address of a named tuple, for functions called from where this is written; what is lent stays as it is.

    It is of no use after the function it was made in, nor after the arrays: they must be that function's arguments, or
    used in it later on.
    """
    if isinstance(owner, Lent):
        return owner(owner), lambda context, builder, signature, values: values[0]
    return Lent(owner)(owner), lambda context, builder, signature, values: alloca_once_value(builder, values[0])


@intrinsic  # type: ignore[untyped-decorator]
def uncounted(typing_context: Any, given: types.Type) -> Any:
    """What is given; an array as one that belongs to nobody, as numba sees it, so that no references are counted.

    For arguments of kernels, which the caller keeps. Counting costs more than reading a few numbers, and several times
    as much where threads count the references to one array.
    """

    def code(context: Any, builder: ir.IRBuilder, signature: Signature, values: Sequence[ir.Value]) -> ir.Value:
        if not isinstance(given, types.Array):
            return impl_ret_borrowed(context, builder, given, values[0])
        return _of_nobody(context, builder, given, values[0])

    return given(given), code


def _of_nobody(context: Any, builder: ir.IRBuilder, kind: types.Array, value: ir.Value) -> ir.Value:
    array = context.make_array(kind)(context, builder, value)
    array.meminfo = get_null_value(array.meminfo.type)
    return array._getvalue()


@infer_getattr
class _LentMembers(AttributeTemplate):  # type: ignore[misc]
    key = Lent

    def generic_resolve(self, lent: Lent, name: str) -> types.Type | None:
        if name not in lent.owner.fields:
            return None
        member = lent.owner.types[lent.owner.fields.index(name)]
        return Lent(member) if hasattr(member, "fields") else member


@lower_getattr_generic(Lent)  # type: ignore[untyped-decorator]
def _lent_member(context: Any, builder: ir.IRBuilder, lent: Lent, address: ir.Value, name: str) -> ir.Value:
    """Code that reads a member of a lent tuple, or makes its address where it is a tuple itself."""
    number = lent.owner.fields.index(name)
    place = builder.gep(address, [ir.Constant(ir.IntType(32), n) for n in (0, number)], inbounds=True)
    member = lent.owner.types[number]
    if hasattr(member, "fields"):
        return place
    value = builder.load(place)
    return _of_nobody(context, builder, member, value) if isinstance(member, types.Array) else value
