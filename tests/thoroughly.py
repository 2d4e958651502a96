"""Sizes, seeds and shapes that only ``make thorough`` tries."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def thoroughly(values: Iterable[Any], *always: int) -> list[Any]:
    """Values to try: those at the given places always, the first where none is given; the others thoroughly."""
    tried = always or (0,)
    return [
        value
        if place in tried
        else pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.thorough)
        for place, value in enumerate(values)
    ]
