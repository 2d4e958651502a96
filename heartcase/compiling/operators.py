"""Types of operators that numba worked out before are remembered while a kernel of ours is compiled.

For each ``a + b`` numba asks all that defines a sum, of lists, texts, sets and dates too, before it comes to numbers,
and that anew for each place in a kernel: a fifth of all compiling.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import types
from numba.core.types.functions import BaseFunction
from numba.core.typing.templates import Signature

__all__ = ["remembered_operators"]

_PLAIN = (
    types.Number,
    types.Boolean,
    types.IntegerLiteral,
    types.BooleanLiteral,
    types.SliceType,  # type: ignore[attr-defined]
    types.Array,
    types.BaseTuple,  # type: ignore[attr-defined]
)
"""Kinds of arguments that say all there is to know of themselves: a list that is empty yet, for one, does not."""
_known: dict[tuple[BaseFunction, Any, tuple[types.Type, ...]], Signature] = {}
"""Signatures by operator, numba's context of types and arguments; found while numba's lock is held."""
_work_out = BaseFunction.get_call_type


@contextmanager
def remembered_operators() -> Iterator[None]:
    """What is compiled in the body takes the signatures that are known; the caller holds numba's lock."""
    kept = BaseFunction.get_call_type
    BaseFunction.get_call_type = _call_type  # type: ignore[method-assign,assignment]
    try:
        yield
    finally:
        BaseFunction.get_call_type = kept  # type: ignore[method-assign]


def _call_type(function: BaseFunction, context: Any, given: Any, named: Any) -> Signature | None:
    operator = function.typing_key
    is_operator = getattr(operator, "__module__", "") in ("_operator", "builtins")
    if named or not is_operator or not all(isinstance(one, _PLAIN) for one in given):
        return _work_out(function, context, given, named)
    key = function, context, tuple(given)
    signature = _known.get(key)
    if signature is None:
        signature = _work_out(function, context, given, named)
        # An operator that is written in Python is compiled for the flags of its caller, and has to be asked again.
        if signature is not None and function.get_impl_key(signature) is operator:
            _known[key] = signature
    return signature
