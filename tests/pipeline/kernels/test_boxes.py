"""The box around what is set in a volume."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from heartcase.pipeline.kernels.boxes import box_of


@given(arrays.arrays(np.bool_, arrays.array_shapes(min_dims=3, max_dims=3, max_side=6)).filter(np.any))
def test_it_is_the_smallest_that_holds_all(mask):
    box = box_of(mask)
    index = np.argwhere(mask)
    assert box == tuple(slice(low, high + 1) for low, high in zip(index.min(axis=0), index.max(axis=0), strict=True))


@given(st.tuples(*[st.integers(0, 3)] * 3))
def test_nothing_has_no_box(shape):
    with pytest.raises(IndexError):
        box_of(np.zeros(shape, np.bool_))
