"""Overlaps of blood compartments before and after, against plain counting."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.fields.compartments import _overlaps


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), factor=st.integers(1, 3), most=st.integers(1, 5))
def test_overlaps_are_counted_voxel_by_voxel(seed, factor, most):
    random = np.random.default_rng(seed)
    before = random.integers(0, most + 1, random.integers(1, 6, 3)).astype(np.uint32)
    after = random.integers(0, most + 1, np.array(before.shape) * factor).astype(np.uint32)
    fine = before.repeat(factor, 0).repeat(factor, 1).repeat(factor, 2)
    wanted = np.zeros((int(before.max()) + 1, int(after.max()) + 1), np.int64)
    np.add.at(wanted, (fine.ravel(), after.ravel()), 1)
    wanted[0] = wanted[:, 0] = 0
    np.testing.assert_array_equal(_overlaps(before, after, factor).toarray(), wanted)
