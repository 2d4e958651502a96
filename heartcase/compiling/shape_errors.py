"""A short error where a kernel assigns an array to one of another shape, instead of one that quotes both shapes.

numba compiles the text of its error, which takes longer than most kernels do, and anew in every process. No kernel of
ours shows it to anybody.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.extending import overload
from numba.np import arrayobj

__all__ = ["short_shape_errors"]


def _refuse_shape(values: Any, place: Any) -> None:
    raise NotImplementedError


@overload(_refuse_shape)  # type: ignore[untyped-decorator]
def _refusing(values: Any, place: Any) -> Callable[[Any, Any], None]:
    def refuse(values: Any, place: Any) -> None:
        raise ValueError("an array was assigned to one of another shape")

    return refuse


@contextmanager
def short_shape_errors() -> Iterator[None]:
    """What is compiled in the body has short errors; the caller holds numba's lock, so other code keeps numba's."""
    kept = arrayobj.raise_with_shape_context
    arrayobj.raise_with_shape_context = _refuse_shape
    try:
        yield
    finally:
        arrayobj.raise_with_shape_context = kept
