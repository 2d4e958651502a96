"""Functions that kernels call without holding copies of them.

All that a kernel calls is copied into it by numba, and compiled again: with a function that every kernel of the fields
needs, that was most of what a first start compiled.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Sequence
from functools import partial, update_wrapper
from importlib import import_module
from typing import Any

import llvmlite.binding
from llvmlite import ir
from numba.core import types
from numba.core.cgutils import get_or_insert_function
from numba.core.dispatcher import Dispatcher
from numba.core.types import unliteral  # type: ignore[attr-defined]
from numba.core.typing.templates import Signature
from numba.extending import intrinsic

from heartcase.compiling.kernel import kernel

__all__ = ["called", "copied"]


_FOR_KERNELS = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def copied(function: Callable[..., Any]) -> Any:
    """Make a function for kernels that numba's compiler may copy into them; Python cannot call it, which saves code."""
    return kernel(function, **_FOR_KERNELS)


def called(function: Callable[..., Any]) -> Any:
    """Make a function for kernels that is compiled once for its types, and called by all of them.

    What is compiled refers to it by a name, which is bound before the code is made, or loaded from numba's cache. Whole
    numbers of any size are handed over as int64. The call is by place, and costs some nanoseconds more than one that
    numba's compiler may copy into its callers: for what is long, not for what is called in an innermost loop.
    """
    place = function.__module__, function.__qualname__
    _CALLED[place] = kernel(function, **_FOR_KERNELS)

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
        raise RuntimeError(
            f"{module}.{name} was another function when numba's cache was written, and the cache was kept"
        )
