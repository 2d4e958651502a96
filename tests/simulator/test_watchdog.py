"""What the watchdog sees, and what it lets pass."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.state import State
from heartcase.simulator.watchdog import RUNAWAY_CELLS_PER_STEP, find_trouble


def quiet(node_count):
    return State(np.zeros((node_count, 3), np.float32), np.zeros((node_count, 3), np.float32))


@settings(deadline=None)
@given(st.integers(1, 50), st.integers(0, 2**32 - 1), st.floats(0.01, 2.0), st.floats(1.0, 60.0))
def test_runaway_nodes_are_those_that_no_hand_leads(node_count, seed, step, scale):
    """Against the same in NumPy."""
    rng = np.random.default_rng(seed)
    led = rng.random(node_count) < 0.3
    velocity = rng.normal(0, scale / step / 4, (node_count, 3)).astype(np.float32)
    trouble = find_trouble(State(quiet(node_count).displacement, velocity), step, led)
    runs_away = float(np.abs(velocity[~led]).max(initial=0.0)) * step > RUNAWAY_CELLS_PER_STEP
    assert (trouble is not None) == runs_away


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("part", ["displacement", "velocity"])
@pytest.mark.parametrize("is_led", [False, True])
def test_what_is_no_number_is_seen_anywhere(number, part, is_led):
    state = quiet(7)
    getattr(state, part)[6, 2] = number
    assert "not a number" in find_trouble(state, 0.3, np.full(7, is_led))


def test_rest_is_no_trouble():
    assert find_trouble(quiet(5), 0.3, np.zeros(5, bool)) is None
    assert find_trouble(quiet(0), 0.3, np.zeros(0, bool)) is None
