"""Tuples of arrays that kernels hand on by address, and functions that they call and do not hold copies of.

numba hands a tuple over as all parts of all its arrays, and counts the references to each of them, at every call; and
all that a kernel calls is copied into it, and compiled again. With the twenty arrays of a field layout, and a function
that every kernel of the fields needs, that was most of what a first start compiled.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Sequence
from functools import partial, update_wrapper
from importlib import import_module
from typing import Any

import llvmlite.binding
import numba
from llvmlite import ir
from numba.core import types
from numba.core.caching import CompileResultCacheImpl
from numba.core.cgutils import alloca_once_value, get_null_value, get_or_insert_function
from numba.core.dispatcher import Dispatcher
from numba.core.types import unliteral  # type: ignore[attr-defined]
from numba.core.typing.templates import AttributeTemplate, Signature
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model

__all__ = ["called", "copied", "lend"]


_FOR_KERNELS = {"cache": True, "nogil": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


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
    if not isinstance(member, types.Array):
        return value
    array = context.make_array(member)(context, builder, value)
    # of an array that belongs to nobody, as numba sees it, references are not counted
    array.meminfo = get_null_value(array.meminfo.type)
    return array._getvalue()


def copied(function: Callable[..., Any]) -> Any:
    """Make a function for kernels that numba's compiler may copy into them; Python cannot call it, which saves code."""
    return numba.njit(**_FOR_KERNELS)(function)


def called(function: Callable[..., Any]) -> Any:
    """Make a function for kernels that is compiled once for its types, and called by all of them.

    What is compiled refers to it by a name, which is bound before the code is made, or loaded from numba's cache. Whole
    numbers of any size are handed over as int64. The call is by place, and costs some nanoseconds more than one that
    numba's compiler may copy into its callers: for what is long, not for what is called in an innermost loop.
    """
    place = function.__module__, function.__qualname__
    _CALLED[place] = numba.njit(**_FOR_KERNELS)(function)

    def definition(typing_context: Any, *given: types.Type) -> Any:
        arguments = tuple(_plain(unliteral(one)) for one in given)
        symbol, result = _compiled(*place, arguments)
        binding = partial(_bind, *place, arguments, result)

        def call(context: Any, builder: ir.IRBuilder, signature: Signature, values: Sequence[ir.Value]) -> ir.Value:
            kind = context.call_conv.get_function_type(signature.return_type, signature.args)
            callee = get_or_insert_function(builder.module, kind, symbol)
            context.active_code_library._reload_init.add(binding)
            status, value = context.call_conv.call_function(
                builder, callee, signature.return_type, signature.args, values
            )
            with builder.if_then(status.is_error, likely=False):
                context.call_conv.return_status_propagate(builder, status)
            return value

        return result(*arguments), call

    parameters = [inspect.Parameter("typing_context", inspect.Parameter.POSITIONAL_OR_KEYWORD)]
    parameters += inspect.signature(function).parameters.values()
    definition.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return intrinsic(update_wrapper(definition, function))


def _rebuild(cache: Any, target_context: Any, payload: Any) -> Any:
    """Load a function from numba's cache, so that what is compiled with it knows what has to be bound for it.

    numba binds that when it loads the function, and does not keep it: a kernel that was compiled with code from the
    cache, in the process after, was loaded without what this code calls, and brought the whole process down.
    """
    found = _LOAD(cache, target_context, payload)
    found.library._reload_init.update(found.reload_init)
    return found


_LOAD = CompileResultCacheImpl.rebuild
CompileResultCacheImpl.rebuild = _rebuild

_CALLED: dict[tuple[str, str], Dispatcher] = {}
"""Functions made by :func:`called`, by their module and name."""


def _plain(kind: types.Type) -> types.Type:
    return types.int64 if kind in (types.int32, types.uint32, types.uint64) else kind


def _compiled(module: str, name: str, arguments: tuple[types.Type, ...]) -> tuple[str, types.Type]:
    """Symbol and result of a function, which is compiled or loaded where that is yet to be."""
    symbol = "heartcase_" + hashlib.sha1(repr((module, name, arguments)).encode()).hexdigest()
    function = _CALLED[module, name]
    function.compile(arguments)
    found = function.overloads[arguments]
    llvmlite.binding.add_symbol(symbol, found.library.get_pointer_to_function(found.fndesc.llvm_func_name))
    return symbol, found.signature.return_type


def _bind(module: str, name: str, arguments: tuple[types.Type, ...], result: types.Type) -> None:
    """Let code from numba's cache find a function that it calls."""
    import_module(module)
    if _compiled(module, name, arguments)[1] != result:
        raise RuntimeError(f"{module}.{name} was another function when numba's cache was written: delete __pycache__")
