"""Nearest of many samples of a surface, for queries that follow one another closely.

A tree of boxes over the samples in Morton order: eight samples a leaf, eight boxes a parent. A query starts from the
nearest sample of the query before it, which for neighbouring points of a lattice rules out nearly all boxes at once;
a k-d tree starts each query from nothing. Pruning compares values that rounding keeps in order, so the result is that
of comparing all samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Float64, Int64

__all__ = ["SampleTree"]

_FAN = 8
"""Samples of a leaf and boxes of a parent."""
_PART = 1024
"""Queries that one task takes; no result depends on it."""
_LEVEL_MAX = 12


@dataclass(frozen=True)
class SampleTree:
    """Boxes over samples, the leaves first and the root last."""

    samples: Float64
    """Samples in Morton order, shape (n, 3)."""
    order: Int64
    """Place of each of them in what was given, shape (n,)."""
    boxes: Float64
    """Lower and upper corner of each box, shape (box_count, 2, 3)."""
    level_start: Int64
    """First box of each level, and the number of boxes, shape (level_count + 1,)."""

    @classmethod
    def of(cls, samples: Float64) -> SampleTree:
        """Build the tree of samples, shape (n, 3), n at least 1.

        Raises
        ------
        ValueError
            There are no samples, or not all are finite.
        """
        if len(samples) == 0 or not np.isfinite(samples).all():
            raise ValueError("a tree needs samples, all of them finite")
        order = np.argsort(_morton(samples), kind="stable")
        placed = np.ascontiguousarray(samples[order], dtype=float)
        lower = upper = placed
        levels: list[Float64] = []
        while not levels or len(lower) > 1:
            starts = np.arange(0, len(lower), _FAN)
            lower, upper = np.minimum.reduceat(lower, starts), np.maximum.reduceat(upper, starts)
            levels.append(np.stack([lower, upper], axis=1))
        level_start = np.cumsum([0, *map(len, levels)]).astype(np.int64)
        return cls(placed, order.astype(np.int64), np.concatenate(levels), level_start)

    def query(self, points: Float64) -> tuple[Float64, Int64]:
        """Distance to the nearest sample and its place in what was given: (m, 3) -> (m,), (m,).

        Of samples at the same distance it is the first in Morton order.
        """
        points = np.ascontiguousarray(points, dtype=float)
        distance, index = np.empty(len(points)), np.empty(len(points), np.int64)
        _query(self.samples, self.boxes, self.level_start, points, distance, index)
        return distance, self.order[index]


def _morton(samples: Float64) -> Int64:
    """Bits of the place along x, y and z in turn, 20 of each."""
    lower = samples.min(axis=0)
    extent = max(float((samples.max(axis=0) - lower).max()), np.finfo(float).tiny)
    code = np.zeros(len(samples), np.int64)
    for axis in range(3):
        cell = np.minimum((samples[:, axis] - lower[axis]) / extent * 2.0**20, 2.0**20 - 1.0).astype(np.int64)
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            cell = (cell | (cell << shift)) & mask
        code |= cell << axis
    return code


@kernel(inline="always")
def _square_gap(lower, upper, x, y, z):
    """Squared distance of a point to a box."""
    dx = max(lower[0] - x, x - upper[0], 0.0)
    dy = max(lower[1] - y, y - upper[1], 0.0)
    dz = max(lower[2] - z, z - upper[2], 0.0)
    return dx * dx + dy * dy + dz * dz


@kernel
def _descend(samples, boxes, level_start, x, y, z):
    """A sample that is near: of each level the nearest box below the one before."""
    at = 0
    for level in range(level_start.shape[0] - 3, -1, -1):
        first = level_start[level]
        best = np.inf
        stop = min((at + 1) * _FAN, level_start[level + 1] - first)
        for child in range(at * _FAN, stop):
            gap = _square_gap(boxes[first + child, 0], boxes[first + child, 1], x, y, z)
            if gap < best:
                best = gap
                at = child
    return min(at * _FAN, samples.shape[0] - 1)


@kernel
def _query_part(samples, boxes, level_start, points, distance, index, start, stop):
    root = level_start.shape[0] - 2
    waiting = np.empty((_LEVEL_MAX * _FAN, 2), np.int64)
    near = -1
    for n in range(start, stop):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if near < 0:
            near = _descend(samples, boxes, level_start, x, y, z)
        leaf = near // _FAN * _FAN
        best = np.inf
        for sample in range(leaf, min(leaf + _FAN, samples.shape[0])):
            dx, dy, dz = samples[sample, 0] - x, samples[sample, 1] - y, samples[sample, 2] - z
            square = dx * dx + dy * dy + dz * dz
            if square < best:
                best = square
                near = sample
        waiting[0, 0] = root
        waiting[0, 1] = 0
        count = 1
        while count:
            count -= 1
            level, at = waiting[count, 0], waiting[count, 1]
            box = level_start[level] + at
            # It may have come nearer since this box was put here.
            if _square_gap(boxes[box, 0], boxes[box, 1], x, y, z) > best:
                continue
            if level:
                first = level_start[level - 1]
                least = np.inf
                for child in range(at * _FAN, min((at + 1) * _FAN, level_start[level] - first)):
                    gap = _square_gap(boxes[first + child, 0], boxes[first + child, 1], x, y, z)
                    if gap <= best:
                        waiting[count, 0] = level - 1
                        waiting[count, 1] = child
                        # The nearest is looked at next.
                        if gap < least:
                            least = gap
                        else:
                            waiting[count, 1] = waiting[count - 1, 1]
                            waiting[count - 1, 1] = child
                        count += 1
                continue
            for sample in range(at * _FAN, min((at + 1) * _FAN, samples.shape[0])):
                dx, dy, dz = samples[sample, 0] - x, samples[sample, 1] - y, samples[sample, 2] - z
                square = dx * dx + dy * dy + dz * dz
                if square < best or (square == best and sample < near):
                    best = square
                    near = sample
        distance[n] = np.sqrt(best)
        index[n] = near


@loop_kernel
def _query(samples, boxes, level_start, points, distance, index):
    """Find the distance to the nearest sample and its place in Morton order."""
    count = points.shape[0]
    for part in numba.prange((count + _PART - 1) // _PART):
        stop = min(count, (part + 1) * _PART)
        _query_part(samples, boxes, level_start, points, distance, index, part * _PART, stop)
