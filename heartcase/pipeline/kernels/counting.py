"""How often each value occurs."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = ["count_values"]


@kernel
def count_values(values):
    """How many of each value there are, int64, shape (256,)."""
    count = np.zeros(256, np.int64)
    for value in values:
        count[value] += 1
    return count
