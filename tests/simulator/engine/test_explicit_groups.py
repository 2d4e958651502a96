"""Groups of nodes with explicit springs: each spring is where its node is, and what fills a group up does nothing."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.engine.cpu.instruments import explicit_arrays
from heartcase.simulator.engine.shared.lanes import EMPTY_START, LANE_COUNT, lane_layout
from heartcase.simulator.lattice.explicit_springs import SpringsByNode
from tests.simulator.lattices import block

MODEL = block(6, 5, 5)
LAYOUT = lane_layout(MODEL, in_banks=True)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 300), st.integers(1, MODEL.node_count - 1), st.integers(0, 2**32 - 1))
def test_springs_of_groups_are_those_of_the_nodes(count, among, seed):
    rng = np.random.default_rng(seed)
    ends = rng.integers(0, among, (count, 1))
    ends = np.concatenate([ends, (ends + rng.integers(1, MODEL.node_count, (count, 1))) % MODEL.node_count], axis=1)
    more = (ends.astype(np.int32), rng.uniform(0.1, 2.0, count).astype(np.float32), rng.uniform(0.5, 2.0, count))
    springs = SpringsByNode.of(MODEL.explicit, MODEL.node_index, more)
    groups = explicit_arrays(LAYOUT, springs)

    node_at = LAYOUT.node_at
    used = groups.lane != EMPTY_START
    nodes = node_at[groups.lane[used]]
    assert sorted(nodes) == np.flatnonzero(np.diff(springs.first)).tolist()
    assert (groups.window[used] == LAYOUT.node_slot[nodes] // LANE_COUNT).all()
    for group, place in np.argwhere(used):
        node = node_at[groups.lane[group, place]]
        there = slice(springs.first[node], springs.first[node + 1])
        rows = slice(groups.first[group], groups.first[group + 1])
        pulls = groups.numbers[rows, 5, place] > 0
        number = np.count_nonzero(pulls)
        assert number == there.stop - there.start
        assert pulls[:number].all()
        assert (node_at[groups.other[rows, place][:number]] == springs.other[there]).all()
        assert (groups.numbers[rows, :4, place][:number] == springs.offset[there]).all()
        assert (groups.numbers[rows, 4, place][:number] == springs.excess[there]).all()
        assert (groups.numbers[rows, 5, place][:number] == springs.stiffness[there]).all()
    idle = groups.numbers[:, 5] == 0
    own = np.repeat(groups.lane, np.diff(groups.first), axis=0)
    assert (groups.other[idle] == own[idle]).all()
