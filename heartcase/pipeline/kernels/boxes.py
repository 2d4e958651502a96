"""Boxes of voxels."""

from __future__ import annotations

import numpy as np

from heartcase.schemas.arrays import Bool

__all__ = ["Box", "box_of"]

Box = tuple[slice, slice, slice]
"""Slices [z, y, x] of a volume."""


def box_of(mask: Bool) -> Box:
    """The smallest box around all that is set.

    Parameters
    ----------
    mask
        Shape [z, y, x].

    Raises
    ------
    IndexError
        Nothing is set.
    """
    there = [np.flatnonzero(mask.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
    z, y, x = (slice(int(one[0]), int(one[-1]) + 1) for one in there)
    return z, y, x
