"""The layout in lanes: every node in one window, every neighbour where the kernels look for it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from heartcase.simulator.lanes import LANE_COUNT, ROWS, lane_layout
from heartcase.simulator.model import make_model
from tests.simulator.lattices import block_cells, random_models


@settings(max_examples=60, deadline=None)
@given(random_models(size_max=(40, 4, 4)))
def test_kernels_find_every_neighbour(model):
    layout = lane_layout(model)
    window, place = np.divmod(layout.node_slot, LANE_COUNT)
    np.testing.assert_array_equal(layout.window_rows[window, 4] + place, layout.node_lane)
    assert len(np.unique(layout.node_lane)) == model.node_count
    row_of = {(int(j), int(k)): number for number, (j, k) in enumerate(ROWS)}
    for start, end, sign in ((0, 1, 1), (1, 0, -1)):
        here, there = model.spring_nodes[:, start], model.spring_nodes[:, end]
        i, j, k = (sign * model.spring_offset).T
        row = np.array([row_of[pair] for pair in zip(j.tolist(), k.tolist(), strict=True)], int)
        np.testing.assert_array_equal(layout.window_rows[window[here], row] + place[here] + i, layout.node_lane[there])


@settings(max_examples=60, deadline=None)
@given(random_models(size_max=(40, 4, 4)))
def test_windows_share_no_lane_and_stay_in_memory(model):
    layout = lane_layout(model)
    lanes = layout.window_rows[:, 4, None] + np.arange(LANE_COUNT)
    assert len(np.unique(lanes)) == lanes.size
    assert layout.window_rows.min() >= 1
    assert layout.window_rows.max() + LANE_COUNT + 1 <= layout.lane_count


@settings(max_examples=30, deadline=None)
@given(random_models(size_max=(40, 4, 4)))
def test_no_lane_without_a_node_has_a_spring(model):
    layout = lane_layout(model)
    weight = layout.spring_weight(model)
    weight[:, layout.node_lane] = 0
    assert not weight.any()


@pytest.mark.parametrize("start", range(8))
def test_windows_of_a_bar_are_full(start):
    """Four rows of 16 nodes are eight windows wherever they begin; aligned blocks would be twelve but for one start."""
    model = make_model(block_cells(15, 1, 1) + np.array([start, 0, 0], np.int32))
    assert lane_layout(model).window_count == 8
