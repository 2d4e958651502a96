"""The layout in lanes: every node in one window, every neighbour where the kernels look for it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.engine.shared.lanes import BANK_LANES, CELL_NUMBERS, EMPTY_START, LANE_COUNT, ROWS, lane_layout
from heartcase.simulator.lattice.model import make_model
from tests.simulator.lattices import block_cells, random_models


@settings(max_examples=60, deadline=None)
@given(random_models(size_max=(40, 4, 4)), st.booleans())
def test_kernels_find_every_neighbour(model, in_banks):
    layout = lane_layout(model, in_banks=in_banks)
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
@given(random_models(size_max=(40, 4, 4)), st.booleans())
def test_windows_share_no_lane_and_stay_in_memory(model, in_banks):
    layout = lane_layout(model, in_banks=in_banks)
    lanes = layout.window_rows[:, 4, None] + np.arange(LANE_COUNT)
    assert len(np.unique(lanes)) == lanes.size
    assert layout.window_rows.min() >= 1
    assert layout.window_rows.max() + LANE_COUNT + 1 <= layout.lane_count


@settings(max_examples=30, deadline=None)
@given(random_models(size_max=(40, 4, 4)), st.booleans())
def test_no_lane_without_a_node_has_a_spring(model, in_banks):
    layout = lane_layout(model, in_banks=in_banks)
    weight = layout.spring_weight(model)
    weight[layout.places(layout.node_lane, 9)] = 0
    assert not weight.any()


@pytest.mark.parametrize("start", range(8))
def test_windows_of_a_bar_are_full(start):
    """Four rows of 16 nodes are eight windows wherever they begin; aligned blocks would be twelve but for one start."""
    model = make_model(block_cells(15, 1, 1) + np.array([start, 0, 0], np.int32))
    assert lane_layout(model).window_count == 8


def test_the_numbers_of_a_lane_share_no_place_with_those_of_others():
    """A lattice of several banks: each lane has room for as many numbers as any array has."""
    model = make_model(block_cells(60, 30, 30))
    layout = lane_layout(model, in_banks=True)
    bank = layout.node_lane // (CELL_NUMBERS * BANK_LANES)
    assert bank.max() >= 3
    # What windows of a bank read and write, from a lane before them to one behind, is in its first strip.
    lanes = (layout.window_rows[:, :, None] + np.arange(-1, LANE_COUNT + 1)).ravel()
    assert (lanes % (CELL_NUMBERS * BANK_LANES) < BANK_LANES).all()
    places = layout.places(np.unique(lanes), CELL_NUMBERS)
    assert len(np.unique(places)) == places.size
    assert places.max() < layout.length(CELL_NUMBERS)
    assert not np.isin(EMPTY_START + np.arange(LANE_COUNT), layout.node_lane).any()


def test_a_row_that_is_longer_than_a_bank_is_refused():
    longest = BANK_LANES - 4 * LANE_COUNT
    assert lane_layout(make_model(block_cells(longest - 1, 1, 1)), in_banks=True).window_count == 4 * longest // 8
    with pytest.raises(
        SimulationError, match=r"is 1035 blocks of 8 nodes long .* the CPU takes 1034: use larger cells"
    ):
        lane_layout(make_model(block_cells(longest, 1, 1)), in_banks=True)
    assert lane_layout(make_model(block_cells(longest, 1, 1))).window_count == 4 * (longest + 8) // 8
