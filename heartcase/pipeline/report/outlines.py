"""Borders of labels on a picture's axes.

matplotlib's own contours take twenty times as long, as each makes a colour map and looks for levels, where one curve at
a known level is wanted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["draw_outlines"]

_WIDTH = 1.1
"""Points."""


def draw_outlines(
    axes: Any,
    labels: npt.NDArray[np.generic],
    colours: Mapping[int, str],
    *,
    x: npt.NDArray[np.float64],
    y: npt.NDArray[np.float64],
) -> None:
    """Draw the border of each label half way between the points; the last colour is on top.

    Parameters
    ----------
    axes
        matplotlib's, with its limits set or to be set: they are left as they are.
    labels
        Label of each point, shape (row_count, column_count).
    colours
        Label -> ``#rrggbb``, in the order of drawing; others have no border.
    x, y
        Where columns and rows lie on the axes.
    """
    from contourpy import contour_generator
    from matplotlib.collections import LineCollection

    lines: list[Any] = []
    lines_colours: list[str] = []
    for value, colour in colours.items():
        inside = labels == value
        if inside.any() and not inside.all():
            found = contour_generator(x, y, inside.astype(float)).lines(0.5)
            lines += found
            lines_colours += [colour] * len(found)
    drawn = LineCollection(lines, colors=lines_colours, linewidths=_WIDTH, capstyle="butt")
    axes.add_collection(drawn, autolim=False)
