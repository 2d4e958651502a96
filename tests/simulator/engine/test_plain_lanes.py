"""Layouts that kernels build are those of plain NumPy, to the bit."""

from __future__ import annotations

from dataclasses import fields
from unittest.mock import patch

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.engine.cpu.chunks import _windows_behind as windows_behind
from heartcase.simulator.engine.shared import node_copies
from heartcase.simulator.engine.shared.lanes import cell_layout, lane_layout
from heartcase.simulator.lattice.force_law import ForceLaw
from tests.simulator.engine.plain_lanes import (
    plain_cell_layout,
    plain_corner_guard_scale,
    plain_lane_layout,
    plain_spring_weight,
    plain_windows_behind,
)
from tests.simulator.lattices import cut_models, random_models


def assert_same_bytes(one, other):
    for each in fields(one):
        a, b = getattr(one, each.name), getattr(other, each.name)
        if isinstance(a, np.ndarray):
            assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()), each.name


@settings(max_examples=15, deadline=None)
@given(cut_models(size_max=(20, 5, 4)))
def test_windows_vote_alike_however_many_at_once(model):
    wanted = lane_layout(model)
    with patch.object(node_copies, "_WINDOWS_AT_ONCE", 3):
        assert_same_bytes(lane_layout(model), wanted)


@settings(max_examples=60, deadline=None)
@given(st.one_of(cut_models(size_max=(20, 5, 4), law=ForceLaw("element")), random_models()), st.booleans())
def test_layouts_are_those_of_plain_numpy(model, in_banks):
    layout, plain = lane_layout(model, in_banks=in_banks), plain_lane_layout(model, in_banks=in_banks)
    assert_same_bytes(layout, plain)
    assert layout.spring_weight(model).tobytes() == plain_spring_weight(model, plain).tobytes()
    assert_same_bytes(cell_layout(model, layout), plain_cell_layout(model, plain))
    np.testing.assert_array_equal(windows_behind(layout), plain_windows_behind(plain), strict=True)
    np.testing.assert_array_equal(model.corner_guard_scale, plain_corner_guard_scale(model), strict=True)
