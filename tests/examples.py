"""A property on few examples in the usual run and on many in the slow one."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st


def few_and_many(few: int, many: int) -> pytest.MarkDecorator:
    """Parametrise a test by ``count``; the larger is slow."""
    return pytest.mark.parametrize("count", [few, pytest.param(many, marks=pytest.mark.slow)])


def hold_for(count: int, check: Callable[..., None], *strategies: st.SearchStrategy[object]) -> None:
    """Let ``check`` assert on so many draws of its arguments."""
    settings(max_examples=count, deadline=None)(given(*strategies)(check))()
