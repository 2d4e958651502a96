"""What numba does for each function that it compiles, and no kernel needs: left out, which makes no other code.

It takes a twelfth of all compiling.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.codegen import CPUCodeLibrary
from numba.core.lowering import Lower

__all__ = ["without_unneeded_work"]

_wrap_for_c = Lower.create_cfunc_wrapper


@contextmanager
def without_unneeded_work() -> Iterator[None]:
    """Compile in the body with less; the caller holds numba's lock, so other code is compiled as ever."""
    kept = CPUCodeLibrary._optimize_functions, Lower.create_cfunc_wrapper
    CPUCodeLibrary._optimize_functions = _optimize_bodies
    Lower.create_cfunc_wrapper = _wrap_others_for_c
    try:
        yield
    finally:
        CPUCodeLibrary._optimize_functions, Lower.create_cfunc_wrapper = kept


def _optimize_bodies(library: Any, module: Any) -> None:
    """LLVM's passes for single functions of a module; most are only declared there, and cost as much by themselves."""
    module.data_layout = library._codegen._data_layout
    for function in module.functions:
        if not function.is_declaration:
            passes, builder = library._codegen._function_pass_manager()
            with library._recorded_timings.record(f"Function passes on {function.name!r}", builder):
                passes.run(function, builder)


def _wrap_others_for_c(lowering: Any) -> None:
    """No wrapper for calls from C of what numba itself wrote in Python, such as ``max``: nobody has its address."""
    if not lowering.fndesc.modname.startswith("numba."):
        _wrap_for_c(lowering)
