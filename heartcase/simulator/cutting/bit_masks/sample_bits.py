"""Sets of the 512 samples of a cell as eight whole numbers of 64 bits, one for each layer along z: kernels.

Sample (i, j, k) is bit i + 8 j of number k. So a step along x is a shift by one bit, along y by eight, and along z from
one number to the next; a few dozen operations find all that hangs together.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = [
    "FIRST_COLUMN",
    "NOT_LAST_COLUMN",
    "NOT_LAST_ROW",
    "components",
    "count",
    "first_sample",
    "is_any",
    "is_on_last",
    "lowest",
    "meets_across",
    "ones",
]

FIRST_COLUMN = 0x0101010101010101
"""Samples of a layer with i = 0."""
NOT_LAST_COLUMN = 0x7F7F7F7F7F7F7F7F
"""Those with i < 7."""
NOT_LAST_ROW = 0x00FFFFFFFFFFFFFF
"""Those with j < 7."""
_PAIRS, _FOURS, _EIGHTS = 0x5555555555555555, 0x3333333333333333, 0x0F0F0F0F0F0F0F0F


@kernel(cached=False)
def ones(layer):
    """Bits of a number that are one."""
    layer = layer - ((layer >> 1) & _PAIRS)
    layer = (layer & _FOURS) + ((layer >> 2) & _FOURS)
    return (((layer + (layer >> 4)) & _EIGHTS) * FIRST_COLUMN) >> 56


@kernel(cached=False)
def lowest(layer):
    """Number of the lowest bit of a number that is not zero."""
    return ones((layer & -layer) - 1)


@kernel(cached=False)
def count(samples):
    """How many samples there are."""
    total = 0
    for k in range(8):
        total += ones(samples[k])
    return total


@kernel(cached=False)
def is_any(samples):
    """Whether there is one."""
    found = 0
    for k in range(8):
        found |= samples[k]
    return found != 0


@kernel(cached=False)
def first_sample(samples):
    """The lowest of some samples; -1 where there is none."""
    for k in range(8):
        if samples[k] != 0:
            return 64 * k + lowest(samples[k])
    return -1


@kernel(cached=False)
def _grow(layer, start, open_x, open_y, open_z, found):
    """Write what hangs together with one sample of a layer."""
    found[:] = 0
    found[layer] = start
    is_growing = True
    while is_growing:
        is_growing = False
        for turn in range(16):
            k = turn if turn < 8 else 15 - turn
            was = found[k]
            now = was
            if k > 0:
                now |= found[k - 1] & open_z[k - 1]
            if k < 7:
                now |= found[k + 1] & open_z[k]
            if now == 0:
                continue
            while True:
                more = now | ((now & open_x[k]) << 1) | ((now >> 1) & open_x[k])
                more |= ((more & open_y[k]) << 8) | ((more >> 8) & open_y[k])
                if more == now:
                    break
                now = more
            if now != was:
                found[k] = now
                is_growing = True


@kernel(cached=False)
def components(samples, links, closed, uses_closed, found):
    """Write the sets of samples that hang together, by their lowest, and count them.

    Parameters
    ----------
    samples
        Of which they are, shape (8,).
    links
        Room for links, shape (3, 8).
    closed
        Links from each sample along each axis that do not hold, shape (3, 8), where ``uses_closed``.
    found
        Room for 512 sets, shape (512, 8); written.
    """
    left = np.empty(8, np.int64)
    for k in range(8):
        left[k] = samples[k]
        links[0, k] = samples[k] & (samples[k] >> 1) & NOT_LAST_COLUMN
        links[1, k] = samples[k] & (samples[k] >> 8) & NOT_LAST_ROW
        links[2, k] = samples[k] & samples[k + 1] if k < 7 else 0
        if uses_closed:
            for axis in range(3):
                links[axis, k] &= ~closed[axis, k]
    number = 0
    for k in range(8):
        while left[k] != 0:
            _grow(k, left[k] & -left[k], links[0], links[1], links[2], found[number])
            for layer in range(8):
                left[layer] &= ~found[number, layer]
            number += 1
    return number


@kernel(cached=False)
def is_on_last(links, axis):
    """Whether one of some links from samples goes on into the next cell along an axis."""
    if axis == 2:
        return links[7] != 0
    across = ~NOT_LAST_COLUMN if axis == 0 else ~NOT_LAST_ROW
    found = 0
    for k in range(8):
        found |= links[k] & across
    return found != 0


@kernel(cached=False)
def meets_across(one, other, closed, axis):
    """Whether samples of two cells, of which the other is the next along an axis, meet across links that hold."""
    if axis == 2:
        return (one[7] & other[0] & ~closed[7]) != 0
    shift, first = (7, FIRST_COLUMN) if axis == 0 else (56, 0xFF)
    found = 0
    for k in range(8):
        found |= ((one[k] & ~closed[k]) >> shift) & first & other[k]
    return found != 0
