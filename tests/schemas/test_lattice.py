"""Numbering of cells and nodes against a plain loop."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from heartcase.schemas.bundle.lattice import (
    CELL_DIAGONALS,
    CELL_EDGES,
    CORNER_OFFSETS,
    cell_nodes,
    distinct_keys,
    lattice_keys,
)

indices = st.tuples(*[st.integers(-5, 5)] * 3)


@given(st.sets(indices, min_size=1, max_size=30))
def test_nodes_are_the_corners_in_order_without_repeats(cells):
    ordered = sorted(cells, key=lambda c: c[::-1])
    nodes, corners = cell_nodes(np.array(ordered))
    expected = {(i + a, j + b, k + c) for i, j, k in ordered for a in (0, 1) for b in (0, 1) for c in (0, 1)}
    assert [tuple(n) for n in nodes] == sorted(expected, key=lambda n: n[::-1])
    for cell, numbers in zip(ordered, corners, strict=True):
        for corner, number in enumerate(numbers):
            offset = (corner & 1, corner >> 1 & 1, corner >> 2 & 1)
            assert tuple(nodes[number]) == tuple(np.add(cell, offset))


def test_a_cell_has_twelve_edges_of_one_and_twelve_face_diagonals_of_root_two():
    for pairs, squared in ((CELL_EDGES, 1), (CELL_DIAGONALS, 2)):
        assert len({tuple(p) for p in pairs}) == 12
        steps = CORNER_OFFSETS[pairs[:, 1]] - CORNER_OFFSETS[pairs[:, 0]]
        assert (np.square(steps).sum(axis=1) == squared).all()


@given(indices, indices)
def test_keys_order_by_k_then_j_then_i(a, b):
    assert (lattice_keys(a) < lattice_keys(b)) == (a[::-1] < b[::-1])


@given(st.lists(st.integers(-(2**62), 2**62)), st.integers(1, 9))
def test_distinct_keys_are_those_of_numpy(keys, modulus):
    for some in (np.array(keys, np.int64), np.array(keys, np.int64) % modulus):
        np.testing.assert_array_equal(distinct_keys(some), np.unique(some))
