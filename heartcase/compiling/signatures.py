"""Types of a kernel's arguments as plain JSON, and back: for lists of what is to be compiled before it is called."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from numba.core import types as numba_types
from numba.core.types import Type

__all__ = ["as_json", "from_json"]

types: Any = numba_types
"""numba's stubs leave out most of it."""


def as_json(kind: Type) -> Any:
    """A type as JSON.

    Raises
    ------
    ValueError
        It is of a kind that no kernel is called with.
    """
    if isinstance(kind, types.Array):
        return ["array", as_json(kind.dtype), kind.ndim, kind.layout, not kind.mutable, kind.aligned]
    if isinstance(kind, (types.NamedTuple, types.NamedUniTuple)):
        owner = kind.instance_class
        return ["named", owner.__module__, owner.__qualname__, [as_json(one) for one in kind.types]]
    if isinstance(kind, types.BaseTuple):
        return ["tuple", [as_json(one) for one in kind.types]]
    if isinstance(kind, types.Omitted):
        return ["default", kind.value]
    if isinstance(kind, types.Dispatcher):
        function = kind.dispatcher.py_func
        return ["kernel", function.__module__, function.__qualname__]
    if isinstance(kind, (types.Number, types.Boolean, types.NoneType)) and getattr(types, str(kind), None) == kind:
        return str(kind)
    raise ValueError(f"{kind!r} cannot be listed")


def from_json(data: Any) -> Type:
    """The type that :func:`as_json` wrote.

    Raises
    ------
    ValueError, AttributeError, ImportError, TypeError
        It is none, or names what is not there any more.
    """
    if isinstance(data, str):
        plain: Type = getattr(types, data)
        return plain
    made: Type
    match data:
        case ["array", dtype, ndim, layout, readonly, aligned]:
            made = types.Array(from_json(dtype), ndim, layout, readonly=readonly, aligned=aligned)
        case ["named", module, name, members]:
            kinds, owner = [from_json(one) for one in members], getattr(import_module(module), name)
            alike = len(set(kinds)) == 1
            made = types.NamedUniTuple(kinds[0], len(kinds), owner) if alike else types.NamedTuple(kinds, owner)
        case ["tuple", members]:
            made = types.Tuple([from_json(one) for one in members])
        case ["default", value]:
            made = types.Omitted(value)
        case ["kernel", module, name]:
            made = types.Dispatcher(getattr(import_module(module), name))
        case _:
            raise ValueError(f"{data!r} is no type")
    return made
