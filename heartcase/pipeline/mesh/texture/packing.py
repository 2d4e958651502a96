"""Charts side by side in a square picture: each turned to lie in its smallest box, the boxes packed by a skyline."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float64, Int32
from heartcase.schemas.errors import StageError

__all__ = ["GUTTER_TEXELS", "pack", "turned"]


GUTTER_TEXELS = 2
"""Texels that are kept free on each side of a chart."""
TURN_COUNT = 12


def turned(flat: Float64, chart: Int32, count: int) -> tuple[Float64, Float64, Float64]:
    """Turn each chart so that its bounding box is smallest and lies on its long side; its box."""
    best = np.full(count, np.inf)
    angle = np.zeros(count)
    order = np.argsort(chart, kind="stable")
    first = np.searchsorted(chart[order], np.arange(count))
    ordered = flat[order]

    def box(points: Float64) -> tuple[Float64, Float64]:
        return np.minimum.reduceat(points, first, axis=0), np.maximum.reduceat(points, first, axis=0)

    for turn in range(2 * TURN_COUNT):
        theta = np.pi * turn / (2 * TURN_COUNT)
        matrix = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        low, high = box(ordered @ matrix.T)
        extent = high - low
        area = extent.prod(axis=1)
        better = (area < best * (1.0 - 1e-9)) & (extent[:, 0] >= extent[:, 1])
        best[better] = area[better]
        angle[better] = theta
    cosine, sine = np.cos(angle)[chart], np.sin(angle)[chart]
    flat_turned = np.column_stack([cosine * flat[:, 0] - sine * flat[:, 1], sine * flat[:, 0] + cosine * flat[:, 1]])
    low, high = box(flat_turned[order])
    return flat_turned, low, high


def pack(extent_mm: Float64, size: int) -> tuple[Float64, float]:
    """Lower corners in texels, gutter included, of the charts' boxes at the largest scale at which they fit."""
    order = np.lexsort((np.arange(len(extent_mm)), -extent_mm[:, 0], -extent_mm[:, 1]))
    low = 0.0
    high = float(size / np.sqrt(max(float(extent_mm.prod(axis=1).sum()), 1e-12)))
    place = np.zeros((len(extent_mm), 2))
    found = False
    for _ in range(40):
        scale = 0.5 * (low + high)
        boxes = np.ceil(extent_mm[order] * scale).astype(np.int64) + 2 * GUTTER_TEXELS
        fits, corners = _skyline(boxes, size)
        if fits:
            low, found = scale, True
            place[order] = corners
            if high - low < 2e-3 * high:
                break
        else:
            high = scale
    if not found:
        raise StageError(
            f"the surface's {len(extent_mm)} charts do not fit into {size} x {size} texels: ask for a larger map",
            place="surface.normal_map_size",
        )
    return place, low


@kernel
def _skyline(boxes, size):
    """Put boxes one by one where their upper side comes lowest, leftmost on a tie.

    The skyline is a list of steps. The leftmost of the lowest places is always at the left end of one: from anywhere
    else a box could be pushed to the left without coming higher.
    """
    # ends with where the picture does
    left, top = np.zeros(size + 1, np.int64), np.zeros(size + 1, np.int64)
    left[1] = size
    count = 1
    corners = np.zeros((len(boxes), 2))
    window = np.empty(size, np.int64)
    for n in range(len(boxes)):
        width, height = boxes[n]
        if width > size or height > size:
            return False, corners
        best, place = size + 1, -1
        first, last, beyond = 0, 0, 0
        for s in range(count):
            if left[s] + width > size:
                break
            # steps under the box that starts here, of those only each that is higher than all to its right
            while beyond < count and left[beyond] < left[s] + width:
                while last > first and top[window[last - 1]] <= top[beyond]:
                    last -= 1
                window[last] = beyond
                last += 1
                beyond += 1
            if window[first] < s:
                first += 1
            if top[window[first]] + height < best:
                best, place = top[window[first]] + height, s
        if place < 0:
            return False, corners
        begin = left[place]
        end = begin + width
        corners[n, 0] = begin
        corners[n, 1] = best - height
        # the box takes the place of the steps under it; what sticks out to its right stays
        after = place
        while left[after + 1] < end:
            after += 1
        stays, beside = left[after + 1] > end, top[after]
        shift = stays - (after - place)
        if shift < 0:
            for s in range(after + 1, count + 1):
                left[s + shift], top[s + shift] = left[s], top[s]
        elif shift > 0:
            for s in range(count, after, -1):
                left[s + shift], top[s + shift] = left[s], top[s]
        top[place] = best
        if stays:
            left[place + 1], top[place + 1] = end, beside
        count += shift
    return True, corners
