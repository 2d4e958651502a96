"""Laying pictures out on a sheet, with captions and a legend."""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

from heartcase.schemas.arrays import UInt8
from heartcase.schemas.labels import LabelTable

__all__ = ["INK", "font_of_size", "label_colours", "legend_picture", "montage", "png_bytes", "stacked"]


INK = (40, 44, 52)
"""Colour of writing on pictures."""


def montage(
    pictures: Mapping[str, UInt8], *, columns: int, gap: int = 12, background: tuple[int, int, int] = (255, 255, 255)
) -> UInt8:
    """Arrange pictures in rows, each with its name above it; smaller ones are centred in their cell."""
    font = font_of_size(20)
    strip = 30
    items = list(pictures.items())
    rows = [items[n : n + columns] for n in range(0, len(items), columns)]
    width = max(picture.shape[1] for picture in pictures.values())
    heights = [max(picture.shape[0] for _, picture in row) + strip for row in rows]
    sheet = Image.new(
        "RGB", (min(columns, len(items)) * (width + gap) + gap, sum(heights) + gap * (len(rows) + 1)), background
    )
    draw = ImageDraw.Draw(sheet)
    top = gap
    for row, height in zip(rows, heights, strict=True):
        for n, (name, picture) in enumerate(row):
            left = gap + n * (width + gap)
            sheet.paste(Image.fromarray(picture), (left + (width - picture.shape[1]) // 2, top + strip))
            draw.text((left + width / 2, top + strip / 2 - 2), name, fill=INK, font=font, anchor="mm")
        top += height + gap
    return np.asarray(sheet)


def stacked(sheets: Sequence[UInt8], *, background: tuple[int, int, int] = (255, 255, 255)) -> UInt8:
    """Put sheets below each other, each centred."""
    width = max(sheet.shape[1] for sheet in sheets)
    rows = []
    for sheet in sheets:
        row = np.full((sheet.shape[0], width, 3), background, np.uint8)
        left = (width - sheet.shape[1]) // 2
        row[:, left : left + sheet.shape[1]] = sheet
        rows.append(row)
    return np.concatenate(rows)


def legend_picture(names: Mapping[str, str], *, width: int) -> UInt8:
    """Names with a square of their colour (``#rrggbb``) beside them, in as many lines as they need."""
    font = font_of_size(18)
    side, height, gap = 16, 30, 28
    places: list[tuple[int, int, str, str]] = []
    x, y = gap, 0
    for name, colour in names.items():
        need = side + 8 + int(font.getlength(name)) + gap
        if x + need > width and x > gap:
            x, y = gap, y + height
        places.append((x, y, name, colour))
        x += need
    sheet = Image.new("RGB", (width, y + height), (255, 255, 255))
    draw = ImageDraw.Draw(sheet)
    for x, y, name, colour in places:
        draw.rectangle((x, y + 7, x + side, y + 7 + side), fill=colour, outline=INK)
        draw.text((x + side + 8, y + 15), name, fill=INK, font=font, anchor="lm")
    return np.asarray(sheet)


def label_colours(table: LabelTable, values: Collection[int]) -> dict[str, str]:
    """Name -> colour of these labels, in the table's order, for :func:`legend_picture`."""
    return {label.name: label.colour for label in table if label.value in set(values)}


def png_bytes(picture: UInt8, *, comment: str = "", level: int = 6) -> bytes:
    """A picture as a PNG file, with a comment in its text field if there is one; ``level`` of compression, 0 to 9."""
    stream = io.BytesIO()
    told = PngInfo()
    if comment:
        told.add_text("Comment", comment)
    Image.fromarray(picture).save(stream, format="PNG", pnginfo=told, compress_level=level)
    return stream.getvalue()


@cache
def font_of_size(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The sans-serif font that pictures are written in, at a height in pixels.

    It is matplotlib's, whose files are looked for without importing it, which takes longer than a page of pictures.
    """
    found = importlib.util.find_spec("matplotlib")
    if found is None or found.origin is None:
        raise ModuleNotFoundError("no module named 'matplotlib'", name="matplotlib")
    fonts = Path(found.origin).parent / "mpl-data" / "fonts" / "ttf"
    return ImageFont.truetype(str(fonts / f"DejaVuSans{'-Bold' if bold else ''}.ttf"), size)
