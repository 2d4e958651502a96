"""Ends of vessels, for the report: a table, and the scan along and across each vessel at the disc that cuts it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import map_coordinates

from heartcase.pipeline.data import Scan, Structures, VesselEnd
from heartcase.pipeline.fields.reader import ownership_at_points
from heartcase.pipeline.report.montage import INK, font_of_size
from heartcase.pipeline.report.outlines import draw_lines, draw_outlines
from heartcase.pipeline.report.pictures import direction_letters
from heartcase.pipeline.report.plain_words import placed
from heartcase.pipeline.report.report_pictures import Picture, embedded_picture
from heartcase.pipeline.report.slices import MARKS, display_window, grey_panel
from heartcase.schemas.arrays import Float64, UInt8
from heartcase.schemas.labels import BACKGROUND, LabelTable

__all__ = ["EndRow", "EndsPart", "ends_part"]


_WORDS = {
    "stated": "cut where the recipe says",
    "moved": "cut near where the recipe says: its disc did not cut the vessel and was moved",
    "found": "cut where the program found the end",
}
_OPEN_WORDS = "open at the face of the scan or region: nothing is cut"
_PANEL_PIXELS, _FILLED = 200, 0.98
_CAPTION, _WRITING = 30, 16
_OUTSIDE = "#d9dee4"
"""Colour of what is beyond the scan."""
_PER_ROW = 8
_MARGIN = 1.8
"""Half the edge of a panel, in radii of the disc."""
_SAMPLE_PIXELS = 2
"""The scan and the model are read at every second pixel each way."""
_MARK_PIXELS = 3.1
_BEFORE_MM = 1.0
"""How far before the disc the scan is shown across the vessel: at the disc itself the model ends."""


@dataclass(frozen=True)
class EndRow:
    """One end."""

    number: int
    """As in the pictures, from 1."""
    vessel: str
    """Name of the label."""
    colour: str
    """``#rrggbb``."""
    place: str
    """Where it is."""
    direction: str
    """Where it leads, in letters and numbers."""
    diameter_mm: float | None
    """Diameter of the disc; None where nothing is cut."""
    lumen_diameter_mm: float
    """Diameter of a circle of the lumen's area."""
    words: str
    """How it came about."""
    is_doubtful: bool
    """Whether it is to be looked at before others."""


@dataclass(frozen=True)
class EndsPart:
    """What the page shows of the vessels' ends."""

    rows: Sequence[EndRow]
    """Ends by label."""
    pictures: Sequence[Picture]
    """Rows of panels, two for each end that is cut."""


def ends_part(scan: Scan, structures: Structures) -> EndsPart | None:
    """Tell and draw the ends of the vessels.

    Parameters
    ----------
    scan
        The scan, cropped to the region of interest.
    structures
        The fields after edits, with the ends.

    Returns
    -------
    EndsPart or None
        None where there are no ends.
    """
    ends = structures.vessel_ends
    if not ends:
        return None
    table = structures.table
    rows = [
        EndRow(
            number,
            end.label,
            table[end.label].colour,
            placed(end.position_mm),
            f"{direction_letters(end.axis)} ({', '.join(f'{v:.2f}' for v in end.axis)})",
            None if end.is_open else 2.0 * end.radius_mm,
            2.0 * end.lumen_radius_mm,
            _OPEN_WORDS if end.is_open else _WORDS[end.found],
            end.found != "stated" and not end.is_open,
        )
        for number, end in enumerate(ends, start=1)
    ]
    cut = [(number, end) for number, end in enumerate(ends, start=1) if not end.is_open]
    per_picture = _PER_ROW // 2
    groups = [cut[start : start + per_picture] for start in range(0, len(cut), per_picture)]
    window = display_window(scan.values, modality=scan.modality)
    return EndsPart(rows, [_picture(scan, structures, group, window) for group in groups])


def _picture(
    scan: Scan, structures: Structures, ends: Sequence[tuple[int, VesselEnd]], window: tuple[float, float]
) -> Picture:
    side_pixels = round(_FILLED * _PANEL_PIXELS)
    gap = (_PANEL_PIXELS - side_pixels) // 2
    sheet = np.full((_CAPTION + side_pixels, 2 * len(ends) * _PANEL_PIXELS, 3), 255, np.uint8)
    for column, (_, end) in enumerate(ends):
        for part, panel in enumerate(_panels(scan, structures, end, window, side_pixels)):
            left = (2 * column + part) * _PANEL_PIXELS + gap
            sheet[_CAPTION:, left : left + side_pixels] = panel
    image = Image.fromarray(sheet)
    draw = ImageDraw.Draw(image)
    for column, (number, end) in enumerate(ends):
        words = f"{number}: {_short(end.label)}, {2.0 * _MARGIN * end.radius_mm:.0f} mm wide"
        place = (2 * column + 1) * _PANEL_PIXELS, _CAPTION - 9
        draw.text(place, words, fill=INK, font=font_of_size(_WRITING), anchor="ms")
    pixels = np.array(image)
    numbers = ", ".join(str(number) for number, _ in ends)
    return embedded_picture(
        f"Ends {numbers}: the scan along each vessel, and across it right before the cut",
        "For each end two pictures of the scan with the outlines of the model: along the vessel, which leaves the "
        "heart to the right and ends at the line, and across it, with the disc as a circle.",
        pixels,
        lossy=True,
    )


def _panels(
    scan: Scan, structures: Structures, end: VesselEnd, window: tuple[float, float], pixels: int
) -> Iterator[UInt8]:
    """The scan with outlines along the vessel at its disc, and across it."""
    axis = np.array(end.axis) / np.linalg.norm(end.axis)
    side, up = _sides(axis)
    middle, half = np.array(end.position_mm), _MARGIN * end.radius_mm
    samples = pixels // _SAMPLE_PIXELS
    flat = half * ((2.0 * np.arange(samples) + 1.0) / samples - 1.0)
    at = ((np.arange(samples) + 0.5) * (pixels / samples) - 0.5).astype(float)
    centre, radius = 0.5 * (pixels - 1), 0.5 * pixels / _MARGIN
    turn = np.radians(np.arange(0.0, 361.0, 4.0))
    circle = centre + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for origin, right, line in (
        (middle, axis, np.array([[centre, centre - radius], [centre, centre + radius]])),
        (middle - _BEFORE_MM * axis, side, circle),
    ):
        points = origin + flat[None, :, None] * right - flat[:, None, None] * up
        panel = grey_panel(_sampled(scan, points), window, (pixels, pixels), outside=_OUTSIDE)
        _outline(panel, structures, points, at)
        draw_lines(panel, np.concatenate([line[:-1], line[1:]], axis=1), MARKS, width=_MARK_PIXELS)
        yield panel


def _short(name: str) -> str:
    return name.removeprefix("morphologically ")


def _sides(axis: Float64) -> tuple[Float64, Float64]:
    """Two directions across an axis: to the right and up in a picture that is seen against the axis."""
    away = np.array((0.0, 0.0, 1.0)) if abs(axis[2]) < 0.9 else np.array((0.0, -1.0, 0.0))
    up = away - (away @ axis) * axis
    up /= np.linalg.norm(up)
    return np.cross(up, axis), up


def _sampled(scan: Scan, points: Float64) -> Float64:
    """Intensities at points, shape (..., 3); NaN beyond the volume."""
    index = np.moveaxis(scan.geometry.world_to_index(points)[..., ::-1], -1, 0)
    value = map_coordinates(scan.values, index, order=1, mode="nearest").astype(float)
    last = np.array(scan.values.shape).reshape(3, 1, 1) - 0.5
    value[((index < -0.5) | (index > last)).any(axis=0)] = np.nan
    return np.asarray(value, dtype=float)


def _outline(panel: UInt8, structures: Structures, points: Float64, at: Float64) -> None:
    """Draw the border of each structure, blood on top."""
    owner = ownership_at_points(structures, points.reshape(-1, 3))
    label = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label).reshape(points.shape[:2])
    table: LabelTable = structures.table
    colours = {one.value: one.colour for one in sorted(table, key=lambda one: one.role.is_blood)}
    colours.pop(BACKGROUND, None)
    draw_outlines(panel, label, colours, x=at, y=at)
