"""What callers give functions: checks that several of them share."""

from __future__ import annotations

from math import isfinite
from numbers import Real
from operator import index
from typing import Any

from heartcase.schemas.errors import HeartcaseError, UsageError

__all__ = ["finite_number", "whole_number"]


def whole_number(
    value: Any,
    place: str,
    *,
    least: int | None = None,
    most: int | None = None,
    error: type[HeartcaseError] = UsageError,
) -> int:
    """The value as an int.

    Parameters
    ----------
    value
        What was given.
    place
        The argument, in the message.
    least, most
        Its limits; none where left out.
    error
        What is raised.

    Raises
    ------
    HeartcaseError
        It is no whole number, or beyond a limit.
    """
    try:
        number = int(value) if isinstance(value, float) and value.is_integer() else index(value)
    except TypeError:
        number = None
    if number is not None and (least is None or number >= least) and (most is None or number <= most):
        return number
    bounds = [f"at least {least:,}" if least is not None else "", f"at most {most:,}" if most is not None else ""]
    limits = " and ".join(bound for bound in bounds if bound)
    raise error(f"must be a whole number{', ' if limits else ''}{limits} (found {value!r})", place=place)


def finite_number(value: Any, place: str, *, least: float, error: type[HeartcaseError] = UsageError) -> float:
    """The value as a float.

    Parameters
    ----------
    value
        What was given.
    place
        The argument, in the message.
    least
        Its lower limit.
    error
        What is raised.

    Raises
    ------
    HeartcaseError
        It is no finite number, or below the limit.
    """
    if isinstance(value, Real) and isfinite(value) and float(value) >= least:
        return float(value)
    raise error(f"must be a finite number, at least {least:g} (found {value!r})", place=place)
