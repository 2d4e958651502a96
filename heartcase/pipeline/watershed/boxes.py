"""Boxes of voxels, and the tiles that they lie in."""

from __future__ import annotations

import numpy as np

from heartcase.pipeline.kernels.boxes import Box
from heartcase.pipeline.watershed.painting import TILE
from heartcase.schemas.arrays import Int64

__all__ = ["Box", "around_both", "as_box", "in_parts", "tiles_around", "voxels_at", "voxels_in", "within"]


def around_both(one: Box | None, other: Box | None) -> Box | None:
    """The box around two, of which each may be none."""
    if one is None or other is None:
        return one or other
    k, j, i = (slice(min(a.start, b.start), max(a.stop, b.stop)) for a, b in zip(one, other, strict=True))
    return k, j, i


def within(box: Box, shape: tuple[int, ...]) -> Box:
    """The voxels that NumPy takes of it, in whole numbers and without steps; an empty one has no tiles."""
    found = [range(*one.indices(n)) for one, n in zip(box, shape, strict=True)]
    if not all(found):
        return slice(0, 0), slice(0, 0), slice(0, 0)
    k, j, i = (slice(min(one), max(one) + 1) for one in found)
    return k, j, i


def tiles_around(box: Box) -> Box:
    """The tiles that a box meets."""
    k, j, i = (slice(one.start // TILE, -(-one.stop // TILE)) for one in box)
    return k, j, i


def voxels_in(low: Int64, high: Int64, shape: tuple[int, ...]) -> Int64:
    """Flat indices of the voxels of boxes in a volume of this shape [z, y, x], int64: box by box, i fastest.

    Parameters
    ----------
    low, high
        First (z, y, x) of each box, and that behind the last, shape (n, 3).
    shape
        The volume's.
    """
    boxes = (tuple(slice(a, b) for a, b in zip(*ends, strict=True)) for ends in zip(low, high, strict=True))
    return np.concatenate([voxels_at((k, j, i), shape) for k, j, i in boxes])


def voxels_at(box: Box, shape: tuple[int, ...]) -> Int64:
    """Flat indices of the voxels in slices [z, y, x], with steps or without, int64: i fastest."""
    k, j, i = (np.arange(n, dtype=np.int64)[one] for one, n in zip(box, shape, strict=True))
    found: Int64 = ((k[:, None, None] * shape[1] + j[:, None]) * shape[2] + i).ravel()
    return found


def in_parts(low: Int64, high: Int64) -> tuple[Int64, Int64]:
    """Boxes cut across their longest way through slices or rows, so that threads have about as much to do."""
    lows, highs = [], []
    for first, last in zip(low, high, strict=True):
        axis = int((last - first)[:2].argmax())
        for start in range(int(first[axis]), int(last[axis]), TILE):
            part_first, part_last = first.copy(), last.copy()
            part_first[axis], part_last[axis] = start, min(start + TILE, int(last[axis]))
            lows.append(part_first)
            highs.append(part_last)
    return np.array(lows), np.array(highs)


def as_box(low: Int64, high: Int64) -> Box | None:
    """The box from a lowest to a highest (z, y, x), both in it; None where the lowest lies beyond."""
    if low[0] > high[0]:
        return None
    (k0, j0, i0), (k1, j1, i1) = low.tolist(), high.tolist()
    return slice(k0, k1 + 1), slice(j0, j1 + 1), slice(i0, i1 + 1)
