"""Colours carried on from the charts of a texture into the texels around them.

So none at a chart's rim is mixed with what lies outside.
"""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Bool, Int32, UInt8

__all__ = ["dilate"]


def dilate(picture: UInt8, filled: Bool, rounds: int) -> None:
    """Continue the filled texels of a picture outward, each round by the mean of the filled neighbours.

    Parameters
    ----------
    picture
        Shape (rows, columns, 3); written.
    filled
        Which texels hold a colour, shape (rows, columns); those that get one are marked.
    rounds
        How many texels far.
    """
    _dilate(picture, filled, _first_edge(filled), rounds)


def _first_edge(filled: Bool) -> Int32:
    """Unfilled texels beside filled ones, row by row: (row, column), shape (n, 2)."""
    counts = np.empty(len(filled), np.int64)
    _count_edge(filled, counts)
    begin = np.concatenate([[0], np.cumsum(counts)])
    edge = np.empty((int(begin[-1]), 2), np.int32)
    _list_edge(filled, begin, edge)
    return edge


@loop_kernel
def _count_edge(filled, counts):
    """Count the unfilled texels beside filled ones of each row."""
    rows, columns = filled.shape
    for j in numba.prange(rows):
        count = 0
        for i in range(columns):
            if not filled[j, i] and _is_beside(filled, j, i):
                count += 1
        counts[j] = count


@loop_kernel
def _list_edge(filled, begin, edge):
    """List them; those of each row begin at ``begin``."""
    rows, columns = filled.shape
    for j in numba.prange(rows):
        at = begin[j]
        for i in range(columns):
            if not filled[j, i] and _is_beside(filled, j, i):
                edge[at, 0], edge[at, 1] = j, i
                at += 1


@copied
def _is_beside(filled, j, i):
    """Whether one of a texel's eight neighbours is filled."""
    rows, columns = filled.shape
    for dj in range(max(j - 1, 0), min(j + 2, rows)):
        for di in range(max(i - 1, 0), min(i + 2, columns)):
            if filled[dj, di]:
                return True
    return False


@kernel
def _dilate(picture, filled, first_edge, rounds):
    """Continue the filled texels outward, each round by the mean of the filled neighbours."""
    rows, columns = filled.shape
    seen = filled.copy()
    edge = np.empty((rows * columns, 2), np.int32)
    first, last = 0, len(first_edge)
    for n in range(last):
        edge[n] = first_edge[n]
        seen[edge[n, 0], edge[n, 1]] = True
    for _ in range(rounds):
        for n in range(first, last):
            j, i = edge[n]
            neighbours, red, green, blue = 0, 0, 0, 0
            for dj in range(max(j - 1, 0), min(j + 2, rows)):
                for di in range(max(i - 1, 0), min(i + 2, columns)):
                    if filled[dj, di]:
                        neighbours += 1
                        red += picture[dj, di, 0]
                        green += picture[dj, di, 1]
                        blue += picture[dj, di, 2]
            picture[j, i, 0] = (2 * red + neighbours) // (2 * neighbours)
            picture[j, i, 1] = (2 * green + neighbours) // (2 * neighbours)
            picture[j, i, 2] = (2 * blue + neighbours) // (2 * neighbours)
        for n in range(first, last):
            filled[edge[n, 0], edge[n, 1]] = True
        begin, first = first, last
        for n in range(begin, first):
            last = _unfilled_around(filled, seen, edge[n, 0], edge[n, 1], edge, last)


@copied
def _unfilled_around(filled, seen, j, i, edge, count):
    """List the unfilled neighbours of a texel that are not listed yet."""
    rows, columns = filled.shape
    for dj in range(max(j - 1, 0), min(j + 2, rows)):
        for di in range(max(i - 1, 0), min(i + 2, columns)):
            if not seen[dj, di]:
                seen[dj, di] = True
                edge[count, 0] = dj
                edge[count, 1] = di
                count += 1
    return count
