"""Figures of a loop's times."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.haptics_jitter import jitter


def test_figures_of_times_that_are_known():
    times = np.concatenate([1e-3 * np.arange(1, 9), [0.010, 0.011]])
    numbers = np.array([0, 0, 1, 1, 2, 2, 2, 3, 3, 3.0])
    finished = np.array([0, 0, 2.5, 2.5, 4.0, 4.0, 4.0, 7.8, 7.8, 7.8]) * 1e-3
    found = jitter(times, numbers, finished)
    assert found.update_count == 10
    assert found.in_time == pytest.approx(8 / 9)
    assert found.interval_ms[0] == pytest.approx(1.0)
    assert found.interval_ms[2] == pytest.approx(2.0)
    assert found.latency_ms[0] == pytest.approx(0.5)
    assert found.latency_ms[2] == pytest.approx(1.0)


def test_without_a_state_there_is_no_latency():
    times = 1e-3 * np.arange(1, 5)
    found = jitter(times, np.zeros(4), np.zeros(4))
    assert np.isnan(found.latency_ms).all()
    assert found.in_time == 1.0
