"""Smooth lines in a picture, and the borders of labels drawn with them.

A pixel is covered by a line in proportion to how far its centre lies inside the line's width, so that edges are smooth.
Where pieces of one line meet, the pixel takes the larger share, and joints are round.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float64, UInt8

__all__ = ["draw_lines", "draw_outlines", "rgb"]

_WIDTH = 2.1
"""Of a border, pixels."""


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def draw_lines(picture: UInt8, segments: Float64, colour: str, *, width: float) -> None:
    """Draw straight pieces of one line.

    Parameters
    ----------
    picture
        RGB, C-contiguous, shape (height, width, 3); changed.
    segments
        Column and row of one end, then of the other, in pixels with whole numbers in the centres: shape
        (segment_count, 4).
    colour
        ``#rrggbb``.
    width
        Pixels.
    """
    if len(segments):
        _draw(picture, np.ascontiguousarray(segments, dtype=float), np.array(rgb(colour), float), float(width))


def draw_outlines(
    picture: UInt8, labels: npt.NDArray[np.integer], colours: Mapping[int, str], *, x: Float64, y: Float64
) -> None:
    """Draw the border of each label half way between the points; the last colour is on top.

    Parameters
    ----------
    picture
        RGB, C-contiguous, shape (height, width, 3); changed.
    labels
        Label of each point, 0 to 255, shape (row_count, column_count).
    colours
        Label -> ``#rrggbb``, in the order of drawing; others have no border.
    x, y
        Where columns and rows lie in the picture, pixels.
    """
    points = np.ascontiguousarray(labels, dtype=np.uint8)
    there = np.bincount(points.ravel(), minlength=256)
    for value, colour in colours.items():
        if there[value]:
            draw_lines(picture, _borders(points, value, x, y), colour, width=_WIDTH)


@kernel
def _borders(labels, value, x, y):
    """Pieces of the border of one label: the sides of the points' cells are cut half way, as in marching squares."""
    rows, columns = labels.shape
    found = np.empty((2 * (rows - 1) * (columns - 1), 4))
    count = 0
    for row in range(rows - 1):
        for column in range(columns - 1):
            a, b = labels[row, column] == value, labels[row, column + 1] == value
            d, c = labels[row + 1, column] == value, labels[row + 1, column + 1] == value
            if a == b and b == c and c == d:
                continue
            left, right, middle_x = x[column], x[column + 1], 0.5 * (x[column] + x[column + 1])
            top, bottom, middle_y = y[row], y[row + 1], 0.5 * (y[row] + y[row + 1])
            if a == c and b == d:
                # Two opposite corners belong to the label: each is cut off by itself.
                ends = ((middle_x, top, left, middle_y), (middle_x, bottom, right, middle_y))
                if b:
                    ends = ((middle_x, top, right, middle_y), (middle_x, bottom, left, middle_y))
                for piece in range(2):
                    for part in range(4):
                        found[count, part] = ends[piece][part]
                    count += 1
                continue
            part = 0
            if a != b:
                found[count, 0], found[count, 1] = middle_x, top
                part = 2
            if b != c:
                found[count, part], found[count, part + 1] = right, middle_y
                part = 2
            if c != d:
                found[count, part], found[count, part + 1] = middle_x, bottom
                part = 2
            if d != a:
                found[count, part], found[count, part + 1] = left, middle_y
            count += 1
    return found[:count].copy()


@kernel
def _draw(picture, segments, colour, width):
    """Cover pixels of ``picture`` by the nearest of the segments."""
    high, wide = picture.shape[:2]
    cover = np.zeros((high, wide), np.float32)
    reach = 0.5 * width + 0.5
    for n in range(len(segments)):
        ax, ay, bx, by = segments[n]
        ux, uy = bx - ax, by - ay
        square = ux * ux + uy * uy
        first_row, last_row = max(0, int(np.ceil(min(ay, by) - reach))), min(high - 1, int(max(ay, by) + reach))
        first_column, last_column = max(0, int(np.ceil(min(ax, bx) - reach))), min(wide - 1, int(max(ax, bx) + reach))
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                part = 0.0
                if square > 0.0:
                    part = min(1.0, max(0.0, ((column - ax) * ux + (row - ay) * uy) / square))
                distance = np.hypot(ax + part * ux - column, ay + part * uy - row)
                share = min(1.0, reach - distance)
                if share > cover[row, column]:
                    cover[row, column] = share
    for row in range(high):
        for column in range(wide):
            share = cover[row, column]
            if share > 0.0:
                for channel in range(3):
                    value = picture[row, column, channel] * (1.0 - share) + colour[channel] * share
                    picture[row, column, channel] = np.uint8(np.rint(value))
