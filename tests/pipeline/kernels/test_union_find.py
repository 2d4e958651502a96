"""Roots of disjoint sets against links that are followed one by one."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.kernels.union_find import root_of


@kernel(cached=False)
def root(parent, member):
    return root_of(parent, member)


@pytest.mark.parametrize("dtype", [np.int32, np.int64])
def test_roots_are_those_at_the_end_of_the_links_and_stay_so(dtype):
    generator = np.random.default_rng(5)
    for count in (1, 2, 300):
        # Links lead to lower numbers, so all end; some are their own.
        parent = np.array([generator.integers(0, n + 1) for n in range(count)], dtype)
        links = parent.copy()
        for member in generator.permutation(count):
            end = member
            while links[end] != end:
                end = links[end]
            assert root(parent, member) == end
            assert parent[member] <= links[member]


def test_a_long_way_is_halved():
    parent = np.maximum(np.arange(9) - 1, 0)
    assert root(parent, 8) == 0
    assert parent.tolist() == [0, 0, 0, 2, 2, 4, 4, 6, 6]
