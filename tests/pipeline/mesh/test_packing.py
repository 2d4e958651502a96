"""The packing of charts against its plain form, texel by texel."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.pipeline.mesh.texture.packing import _skyline
from heartcase.schemas.arrays import Float64, Int64


def _packed_by_texels(boxes: Int64, size: int) -> tuple[bool, Float64]:
    """Put each box where its upper side comes lowest of all places, leftmost on a tie."""
    top, corners = np.zeros(size, np.int64), np.zeros((len(boxes), 2))
    for n, (width, height) in enumerate(boxes):
        if width > size:
            return False, corners
        upper = np.lib.stride_tricks.sliding_window_view(top, width).max(axis=1) + height
        begin = int(upper.argmin())
        if upper[begin] > size:
            return False, corners
        corners[n] = begin, upper[begin] - height
        top[begin : begin + width] = upper[begin]
    return True, corners


@pytest.mark.parametrize("seed", range(40))
def test_boxes_lie_where_the_search_of_all_texels_puts_them(seed: int) -> None:
    random = np.random.default_rng(seed)
    size, most = int(random.integers(1, 90)), int(random.integers(2, 30))
    boxes = random.integers(1, most, (int(random.integers(1, 120)), 2))
    if seed % 2:
        boxes = boxes[np.lexsort((-boxes[:, 0], -boxes[:, 1]))]
    expected_fits, expected = _packed_by_texels(boxes, size)
    fits, corners = _skyline(boxes, size)
    assert fits == expected_fits
    np.testing.assert_array_equal(corners, expected)
