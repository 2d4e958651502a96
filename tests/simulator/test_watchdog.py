"""What the watchdog sees, and what it lets pass."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.simulator.state import State
from heartcase.simulator.watchdog import find_trouble


def quiet(node_count):
    return State(np.zeros((node_count, 3), np.float32), np.zeros((node_count, 3), np.float32))


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("part", ["displacement", "velocity"])
def test_what_is_no_number_is_seen_anywhere(number, part):
    state = quiet(7)
    getattr(state, part)[6, 2] = number
    assert "not a number" in find_trouble(state)


def test_rest_is_no_trouble():
    assert find_trouble(quiet(5)) is None
    assert find_trouble(quiet(0)) is None
