"""A picture of several histograms in one frame, as stepped curves with axes and a key."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from heartcase.pipeline.report.montage import INK, font_of_size
from heartcase.pipeline.report.outlines import draw_lines
from heartcase.schemas.arrays import Float64, UInt8

__all__ = ["Curve", "histogram_picture"]

_SIZE = (800, 340)
_LEFT, _RIGHT, _TOP, _BOTTOM = 66, 784, 10, 288
"""Of the frame, pixels."""
_LINE = 2.4
_DASHES = ((), (9.0, 4.0), (2.5, 4.0))
"""Lengths of line and gap of one curve after the other, pixels; none is a whole line."""
_TICKS_MOST = 9
_TICK = 5
_HEADROOM = 1.05


@dataclass(frozen=True)
class Curve:
    """One histogram."""

    name: str
    """For the key."""
    colour: str
    """``#rrggbb``."""
    heights: Float64
    """Height between one edge and the next, shape (n,)."""


def histogram_picture(curves: Sequence[Curve], edges: Float64, *, across: str, up: str) -> UInt8:
    """Draw histograms of the same edges.

    Parameters
    ----------
    curves
        One or more; later ones on top.
    edges
        From low to high, shape (n + 1,). The frame shows all of them.
    across, up
        What the axes show, with units.

    Returns
    -------
    UInt8
        RGB picture, shape (340, 800, 3).
    """
    highest = _HEADROOM * max((float(curve.heights.max(initial=0.0)) for curve in curves), default=0.0) or 1.0
    low, high = float(edges[0]), float(edges[-1])
    column = _LEFT + (np.repeat(edges, 2) - low) * ((_RIGHT - _LEFT) / (high - low))
    sheet = np.full((_SIZE[1], _SIZE[0], 3), 255, np.uint8)
    for number, curve in enumerate(curves):
        row = _BOTTOM - np.pad(np.repeat(curve.heights, 2), 1) * ((_BOTTOM - _TOP) / highest)
        draw_lines(sheet, _pieces(np.stack([column, row], axis=1), number), curve.colour, width=_LINE)
    font, small = font_of_size(14), font_of_size(11)
    key = _RIGHT - max((small.getlength(curve.name) for curve in curves), default=0.0)
    for number, curve in enumerate(curves):
        sample = np.array([[key - 32.0, _key_row(number)], [key - 8.0, _key_row(number)]])
        draw_lines(sheet, _pieces(sample, number), curve.colour, width=_LINE)
    image = Image.fromarray(sheet)
    draw = ImageDraw.Draw(image)
    draw.line((_LEFT, _TOP, _LEFT, _BOTTOM, _RIGHT, _BOTTOM), fill=INK)
    for value in _ticks(low, high):
        x = _LEFT + (value - low) * ((_RIGHT - _LEFT) / (high - low))
        draw.line((x, _BOTTOM, x, _BOTTOM + _TICK), fill=INK)
        draw.text((x, _BOTTOM + _TICK + 3), f"{value:g}", fill=INK, font=font, anchor="ma")
    for value in _ticks(0.0, highest):
        y = _BOTTOM - value * ((_BOTTOM - _TOP) / highest)
        draw.line((_LEFT - _TICK, y, _LEFT, y), fill=INK)
        draw.text((_LEFT - _TICK - 3, y), f"{value:g}", fill=INK, font=font, anchor="rm")
    draw.text(((_LEFT + _RIGHT) / 2, _SIZE[1] - 8), across, fill=INK, font=font, anchor="md")
    for number, curve in enumerate(curves):
        draw.text((key, _key_row(number)), curve.name, fill=INK, font=small, anchor="lm")
    turned = Image.new("RGB", (_BOTTOM - _TOP, 20), "white")
    ImageDraw.Draw(turned).text((turned.width / 2, 10), up, fill=INK, font=font, anchor="mm")
    image.paste(turned.transpose(Image.Transpose.ROTATE_90), (4, _TOP))
    return np.array(image)


def _key_row(number: int) -> float:
    return _TOP + 8.0 + 17.0 * number


def _pieces(points: Float64, number: int) -> Float64:
    """A path's pieces, shape (n, 4), dashed as the curve's number says."""
    pieces = np.concatenate([points[:-1], points[1:]], axis=1)
    dashes = _DASHES[number % len(_DASHES)]
    if not dashes:
        return pieces
    line, gap = dashes
    lengths = np.hypot(pieces[:, 2] - pieces[:, 0], pieces[:, 3] - pieces[:, 1])
    ends = np.cumsum(lengths)
    found = []
    for start in np.arange(0.0, ends[-1], line + gap):
        for n in range(int(np.searchsorted(ends, start, side="right")), len(pieces)):
            before = ends[n] - lengths[n]
            if before >= start + line:
                break
            if lengths[n] > 0.0:
                parts = (np.array([max(start, before), min(start + line, ends[n])]) - before) / lengths[n]
                a, b = pieces[n, :2], pieces[n, 2:]
                found.append([*(a + parts[0] * (b - a)), *(a + parts[1] * (b - a))])
    return np.array(found)


def _ticks(low: float, high: float) -> Float64:
    """Round values from low to high, evenly spaced: 1, 2 or 5 times a power of ten apart."""
    rough = (high - low) / _TICKS_MOST
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(part * power for part in (1.0, 2.0, 5.0, 10.0) if part * power >= rough)
    return np.arange(math.ceil(low / step), math.floor(high / step) + 1).astype(float) * step
