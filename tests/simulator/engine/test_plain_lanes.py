"""Layouts that kernels build are those of plain NumPy, to the bit."""

from __future__ import annotations

from dataclasses import fields, replace
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.engine.cpu import sleep
from heartcase.simulator.engine.cpu.chunks import behind_windows
from heartcase.simulator.engine.cpu.engine import CpuEngine
from heartcase.simulator.engine.shared import rows
from heartcase.simulator.engine.shared.cell_lanes import cell_layout, cell_numbers, inverse_shared, share_numbers
from heartcase.simulator.engine.shared.lanes import lane_layout
from heartcase.simulator.lattice.loose_nodes import with_loose_nodes
from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from tests.simulator.engine.plain_lanes import (
    plain_by_node_window,
    plain_by_window,
    plain_cell_layout,
    plain_corner_guard_scale,
    plain_explicit_arrays,
    plain_ghost_arrays,
    plain_irregular_springs,
    plain_lane_layout,
    plain_spring_weight,
    plain_springs_apart,
    plain_window_numbers,
    plain_windows_behind,
)
from tests.simulator.lattices import block, cut_models, random_field, random_models, tied

LAWS = st.sampled_from([ForceLaw(), ForceLaw("springs", 0.4), ForceLaw("element")])


@st.composite
def models(draw):
    """Lattices that were cut or not, some with loose nodes, explicit springs, or without some of their springs."""
    law = draw(LAWS)
    model = draw(
        st.one_of(cut_models(size_max=(20, 5, 4), law=law), random_models().map(lambda one: one.with_law(law)))
    )
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    if draw(st.integers(0, 3)) == 0:
        model = with_loose_nodes(model, rng.uniform(0.1, 1.0, 70).astype(np.float32))
    if draw(st.booleans()):
        model = tied(model, 3)
    if draw(st.integers(0, 3)) == 0:
        model = model.without_springs(rng.random(model.spring_count) < 0.1)
    return model


def assert_same_bytes(ours, plain):
    for each in fields(plain):
        assert_same_array(getattr(ours, each.name), getattr(plain, each.name), each.name)


def assert_same_array(one, other, name):
    one, other = np.asarray(one), np.asarray(other)
    assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes()), name


@settings(max_examples=80, deadline=None)
@given(models(), st.booleans())
def test_layouts_are_those_of_plain_numpy(model, in_banks):
    layout, plain = lane_layout(model, in_banks=in_banks), plain_lane_layout(model, in_banks=in_banks)
    assert_same_bytes(layout, plain)
    irregular = np.flatnonzero(plain_irregular_springs(model, plain))
    np.testing.assert_array_equal(layout.irregular_springs(model), irregular, strict=True)
    assert layout.spring_weight(model).tobytes() == plain_spring_weight(model, plain, model.spring_weight).tobytes()
    assert_same_bytes(cell_layout(model, layout), plain_cell_layout(model, plain))
    np.testing.assert_array_equal(behind_windows(layout), plain_windows_behind(plain), strict=True)
    np.testing.assert_array_equal(model.corner_guard_scale, plain_corner_guard_scale(model), strict=True)


@settings(max_examples=60, deadline=None)
@given(models())
def test_an_engine_has_the_arrays_of_plain_numpy(model):
    engine, layout = CpuEngine(model), plain_lane_layout(model, in_banks=True)
    cells = plain_cell_layout(model, layout)
    assert_same_array(engine.window_numbers, plain_window_numbers(model, layout), "window numbers")
    assert_same_array(engine.weight, plain_spring_weight(model, layout, model.acting_weight), "weight")
    assert_same_array(engine._cell_arrays.numbers, plain_by_window(cells, cell_numbers(model)), "cells")
    for name, one, other in zip(
        engine._ghosts._fields[1:], engine._ghosts[1:], plain_ghost_arrays(model, cells, layout), strict=True
    ):
        assert_same_array(one, other, name)
    apart = plain_springs_apart(model, layout)
    for name, one, other in zip(
        engine._explicit._fields, engine._explicit, plain_explicit_arrays(layout, apart), strict=True
    ):
        assert_same_array(one, other, name)
    if model.shares_strain:
        shares, own = share_numbers(model), np.zeros((len(layout.window_rows), 1, 8), np.float32)
        own[layout.node_slot // 8, 0, layout.node_slot % 8] = inverse_shared(model)
        around = np.concatenate([plain_by_node_window(cells, layout, shares[:-1]), own], axis=1)
        assert_same_array(engine._sharing.node_shares, around, "shares of nodes")
        assert_same_array(engine._sharing.shares, plain_by_window(cells, shares), "shares of cells")


@settings(max_examples=30, deadline=None)
@given(models())
def test_what_is_looked_up_in_a_table_is_as_what_is_searched(model):
    """Rows and blocks of a lattice are numbered by a table, or by their keys where they lie far apart."""
    quick, quick_blocks = lane_layout(model, in_banks=True), CpuEngine(model)._sleep[:2]
    with patch.object(rows, "_PLACES_PER_NODE", 0), patch.object(sleep, "_PLACES_PER_WINDOW", 0):
        searched, blocks = lane_layout(model, in_banks=True), CpuEngine(model)._sleep[:2]
    for name in ("node_lane", "node_slot", "window_rows", "is_near_copies", "irregular_cells", "ghost_start"):
        assert_same_array(getattr(quick, name), getattr(searched, name), name)
    for one, other in zip(quick_blocks, blocks, strict=True):
        assert_same_array(one, other, "blocks")


@settings(max_examples=25, deadline=None)
@given(cut_models(size_max=(20, 5, 4)), st.integers(0, 2**32 - 1))
def test_an_engine_that_goes_on_with_a_layout_steps_as_one_made_anew(model, seed):
    """Another lattice of the same nodes and cells has the layout of the one before, whatever its cells weigh."""
    before = CpuEngine(model)
    coverage = np.random.default_rng(seed).uniform(0.1, 1.0, model.cell_count).astype(np.float32)
    further = replace(model, node_index=model.node_index.copy(), cell_coverage=coverage, node_mass=2 * model.node_mass)
    engine, anew = CpuEngine(further, before), CpuEngine(further)
    assert engine.layout is before.layout
    assert_same_array(engine.window_numbers, anew.window_numbers, "window numbers")
    assert_same_array(engine._cell_arrays.numbers, anew._cell_arrays.numbers, "cells")
    start = State(random_field(model, seed, 0.1), random_field(model, seed + 1, 0.01))
    ends = []
    for each in (engine, anew):
        each.load(start)
        before.advance(2, Verlet(0.1, 0.05))
        each.advance(10, Verlet(0.1, 0.05))
        ends.append(each.read().displacement.tobytes() + each.read().velocity.tobytes())
    assert ends[0] == ends[1]


def test_a_layout_is_not_gone_on_with_where_nodes_or_springs_differ():
    model = block(9, 3, 3)
    before = CpuEngine(model)
    cut = model.without_springs(np.arange(model.spring_count) % 7 == 0)
    moved = replace(model, node_index=model.node_index + 1, cells=model.cells + 1)
    for other in (cut, moved, block(9, 3, 4)):
        engine = CpuEngine(other, before)
        assert engine.layout is not before.layout
        assert_same_array(engine.layout.window_rows, CpuEngine(other).layout.window_rows, "rows")
    assert CpuEngine(cut, CpuEngine(cut)).layout.lane_count == CpuEngine(cut).layout.lane_count


@pytest.mark.parametrize("far", [100_000, 1_000_000])
def test_parts_that_lie_far_apart_take_no_room_between_them(far):
    near = block(2, 2, 2)
    cells = np.concatenate([near.cells, near.cells + np.array([0, far, -far], np.int32)])
    model = make_model(cells)
    assert_same_bytes(lane_layout(model), plain_lane_layout(model))
