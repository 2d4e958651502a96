"""Pictures of a scan's slices with the outlines of its labels, as radiologists look at them.

Slices are taken along the volume's own axes, never resampled, and drawn with true lengths. Each stack is turned and
flipped so that the patient's right is on the left of axial and coronal pictures, the front is up in axial ones and on
the left in sagittal ones. In an oblique scan the letters at the edges name the nearest directions.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from heartcase.pipeline.report.montage import INK, font_of_size
from heartcase.pipeline.report.outlines import draw_outlines, rgb
from heartcase.pipeline.report.pictures import direction_letters
from heartcase.schemas.arrays import UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable

__all__ = [
    "MARKS",
    "STACKS",
    "SliceView",
    "Stack",
    "display_window",
    "grey_panel",
    "slice_number",
    "slice_pictures",
    "slice_position",
    "slice_view",
]

Stack = Literal["axial", "coronal", "sagittal"]

_STACKS: dict[Stack, tuple[int, tuple[float, float, float], tuple[float, float, float]]] = {
    "axial": (2, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "coronal": (1, (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
    "sagittal": (0, (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
}
"""Name -> world axis across the slices, direction that shows to the right, direction that shows downwards (LPS)."""

STACKS: tuple[Stack, ...] = ("axial", "coronal", "sagittal")
"""All stacks, in the order of a report."""

MARKS = "#ffe9a8"
"""Colour of marks and letters over a scan."""

_CAPTION, _BELOW = 39, 31
"""Heights above and below a row, pixels."""
_WRITING = 17
"""Size of the letters, pixels."""
_FILLED, _TALLEST = 0.98, 1.6
"""Part of its cell that a slice fills across, and its largest height as a multiple of the cell's width."""
_CT_LOWEST_HU = -250.0
_MARGIN_MM = 12.0
_OVERLAY_ALPHA = 0.65


@dataclass(frozen=True)
class _Overlay:
    """Colours over a scan."""

    numbers: npt.NDArray[np.generic]
    colours: tuple[str, ...]


@dataclass(frozen=True)
class SliceView:
    """How the slices of a stack are laid on the picture: which array axes, turned which way."""

    through: int
    """Index axis (0 i, 1 j, 2 k) that the slices are counted along."""
    across: int
    """Index axis that runs along the picture's rows."""
    down: int
    """Index axis that runs down the picture's columns."""
    flip_across: bool
    """Whether ``across`` runs to the left."""
    flip_down: bool
    """Whether ``down`` runs upwards."""
    letters: dict[str, str]
    """``left``, ``right``, ``top``, ``bottom`` -> direction in the patient: ``A``, ``PL`` and so on."""

    def take(self, values: npt.NDArray[np.generic], number: int) -> npt.NDArray[np.generic]:
        """One slice of an array ``[z, y, x]``, turned for display: rows go down, columns go right."""
        plane = np.moveaxis(values.transpose(2, 1, 0), self.through, 0)[number]
        rest = [axis for axis in range(3) if axis != self.through]
        if rest.index(self.down) == 1:
            plane = plane.T
        turned: npt.NDArray[np.generic] = plane[:: -1 if self.flip_down else 1, :: -1 if self.flip_across else 1]
        return turned


def slice_view(geometry: Geometry, stack: Stack) -> SliceView:
    """How to show the stack of slices that is nearest to axial, coronal or sagittal."""
    direction = geometry.direction_matrix
    axis_of = max(
        itertools.permutations(range(3)), key=lambda p: sum(abs(direction[world, p[world]]) for world in range(3))
    )
    world, right, downwards = _STACKS[stack]
    through = axis_of[world]
    ahead = np.cross(right, downwards)
    best = -np.inf
    # Of the eight ways to lay the slice, four show it from behind, mirrored: the best of the others is taken.
    for across, flip_across, flip_down in itertools.product(
        sorted({0, 1, 2} - {through}), (False, True), (False, True)
    ):
        down = 3 - through - across
        to_right, to_bottom = direction[:, across] * (-1) ** flip_across, direction[:, down] * (-1) ** flip_down
        fit = to_right @ right + to_bottom @ downwards
        if np.cross(to_right, to_bottom) @ ahead > 0.0 and fit > best + 1e-9:
            best, chosen = fit, (across, down, flip_across, flip_down, to_right, to_bottom)
    across, down, flip_across, flip_down, to_right, to_bottom = chosen
    letters = {
        "left": direction_letters(-to_right),
        "right": direction_letters(to_right),
        "top": direction_letters(-to_bottom),
        "bottom": direction_letters(to_bottom),
    }
    return SliceView(through, across, down, flip_across, flip_down, letters)


def slice_number(geometry: Geometry, stack: Stack, number: int) -> int:
    """Number of a slice, given by its index, as the studio counts: from 1, to the head, the front and the left."""
    axis = slice_view(geometry, stack).through
    world, forward = {"axial": (2, 1.0), "coronal": (1, -1.0), "sagittal": (0, 1.0)}[stack]
    is_forward = forward * geometry.direction_matrix[world, axis] > 0.0
    return number + 1 if is_forward else geometry.size[axis] - number


def slice_position(geometry: Geometry, stack: Stack, number: int) -> str:
    """Where a slice lies, as scanners write it: the distance of its plane from the scanner's zero, and to which side.

    ``H 34.5 mm`` is 34.5 mm towards the head. In an oblique stack the letters name the slices' normal, strongest
    first, and the distance is along that normal.
    """
    axis = slice_view(geometry, stack).through
    normal = geometry.direction_matrix[:, axis]
    index = np.zeros(3)
    index[axis] = number
    distance = float(geometry.index_to_world(index) @ normal)
    outward = normal if distance >= 0.0 else -normal
    return f"{direction_letters(outward)} {abs(distance):.1f} mm"


def display_window(values: npt.ArrayLike, *, modality: str = "unknown") -> tuple[float, float]:
    """Intensities that show black and white: the 1st and 99.5th percentile; for CT not below -250 HU."""
    sample = np.asarray(values)
    step = max(1, int(np.cbrt(sample.size / 2e6)))
    low, high = np.percentile(sample[::step, ::step, ::step], (1.0, 99.5))
    if modality == "CT":
        low = max(low, _CT_LOWEST_HU)
    return float(low), float(high) if high > low else float(low) + 1.0


def slice_pictures(
    values: npt.ArrayLike,
    geometry: Geometry,
    labels: npt.ArrayLike | None,
    table: LabelTable | None,
    *,
    count: int = 4,
    modality: str = "unknown",
    window: tuple[float, float] | None = None,
    stacks: Sequence[Stack] = STACKS,
    width: int = 1600,
    footnote: str = "",
    overlay: npt.ArrayLike | None = None,
    overlay_colours: Sequence[str] = (),
) -> dict[Stack, UInt8]:
    """Rows of slices from three sides, with the outline of each label in its colour.

    Parameters
    ----------
    values
        Intensities, shape ``geometry.shape``.
    geometry
        Where the voxels lie.
    labels
        Label values on the same lattice, or None. With labels, the pictures are cropped to what is labelled.
    table
        Label table; needed with ``labels``.
    count
        Slices per stack, evenly spread.
    modality
        ``CT``, ``MR`` or ``unknown``: chooses the grey scale.
    window
        Intensities that show black and white; chosen from the values when left out.
    stacks
        Which sides to show.
    width
        Width of each row of slices, pixels.
    footnote
        Written below each row, such as the cardiac phase.
    overlay
        Number of a colour that is laid over each voxel, 0 for none, shape ``geometry.shape``; nothing when left out.
    overlay_colours
        Colour 1 and so on, ``#rrggbb``.

    Returns
    -------
    dict
        Stack -> RGB picture, in the order of ``stacks``.
    """
    scan = np.asarray(values)
    tags = None if labels is None else np.asarray(labels)
    box = _box(tags, geometry)
    crop = tuple(slice(low, high) for low, high in reversed(box))
    low, high = display_window(scan[crop], modality=modality) if window is None else window
    drawn = () if table is None else sorted(table, key=lambda label: label.role.is_blood)
    colours = {label.value: label.colour for label in drawn if label.value != BACKGROUND}
    laid_over = None if overlay is None else _Overlay(np.asarray(overlay), tuple(overlay_colours))
    return {
        stack: _row(scan, tags, geometry, stack, box, count, (low, high), colours, width, footnote, laid_over)
        for stack in stacks
    }


def _box(labels: npt.NDArray[np.generic] | None, geometry: Geometry) -> tuple[tuple[int, int], ...]:
    """First and last-plus-one index along i, j, k of what is labelled with a margin; of everything without labels."""
    whole = tuple((0, n) for n in geometry.size)
    if labels is None or not labels.any():
        return whole
    box = []
    for axis in range(3):
        others = tuple(n for n in range(3) if n != 2 - axis)
        used = np.flatnonzero(labels.any(axis=others))
        margin = round(_MARGIN_MM / geometry.spacing_mm[axis])
        box.append((max(0, int(used[0]) - margin), min(geometry.size[axis], int(used[-1]) + 1 + margin)))
    return tuple(box)


def _row(
    scan: npt.NDArray[np.generic],
    labels: npt.NDArray[np.generic] | None,
    geometry: Geometry,
    stack: Stack,
    box: tuple[tuple[int, int], ...],
    count: int,
    window: tuple[float, float],
    colours: dict[int, str],
    width: int,
    footnote: str,
    overlay: _Overlay | None,
) -> UInt8:
    view = slice_view(geometry, stack)
    crop = tuple(slice(low, high) for low, high in reversed(box))
    sizes = [high - low for low, high in box]
    span_mm = [n * spacing for n, spacing in zip(sizes, geometry.spacing_mm, strict=True)]
    wide, tall = span_mm[view.across], span_mm[view.down]
    cell = width / count
    height = round(cell * min(tall / wide, _TALLEST))
    across = max(1, round(min(_FILLED * cell, height * wide / tall)))
    size = across, max(1, min(height, round(across * tall / wide)))
    numbers = [int((n + 0.5) * sizes[view.through] / count) for n in range(count)]
    sheet = np.full((_CAPTION + height + (_BELOW if footnote else 0), width, 3), 255, np.uint8)
    corners = []
    for place, number in enumerate(numbers):
        panel = grey_panel(view.take(scan[crop], number), window, size)
        if overlay is not None:
            _lay_over(panel, view.take(overlay.numbers[crop], number), overlay.colours)
        if labels is not None:
            _outline(panel, view.take(labels[crop], number), colours)
        left = min(round((place + 0.5) * cell - 0.5 * size[0]), width - size[0])
        top = _CAPTION + (height - size[1]) // 2
        sheet[top : top + size[1], left : left + size[0]] = panel
        corners.append((left, top))
    image = Image.fromarray(sheet)
    draw = ImageDraw.Draw(image)
    font = font_of_size(_WRITING)
    for place, number in enumerate(numbers):
        shown = box[view.through][0] + number
        _write_directions(draw, corners[place], size, view)
        _draw_scale(draw, corners[place], size, wide)
        count = geometry.size[view.through]
        place = slice_number(geometry, stack, shown)
        words = f"{stack} {place} of {count}, at {slice_position(geometry, stack, shown)}"
        draw.text(((place + 0.5) * cell, _CAPTION - 6), words, fill=INK, font=font, anchor="ms")
    if footnote:
        draw.text((0.005 * width, sheet.shape[0] - 4), footnote, fill=INK, font=font, anchor="ld")
    return np.array(image)


def grey_panel(
    values: npt.NDArray[np.generic], window: tuple[float, float], size: tuple[int, int], *, outside: str = ""
) -> UInt8:
    """Values as greys, between them linearly, shape (height, width, 3).

    Parameters
    ----------
    values
        Shape (row_count, column_count).
    window
        Values that show black and white.
    size
        Width and height, pixels.
    outside
        Colour of values that are NaN, ``#rrggbb``; there must be none when left out.
    """
    plane = np.ascontiguousarray(values, dtype=np.float32)
    absent = np.isnan(plane) if outside else None
    if absent is not None:
        plane = np.where(absent, np.float32(window[0]), plane)
    shown = np.asarray(Image.fromarray(plane).resize(size, Image.Resampling.BILINEAR))
    grey = np.rint(np.clip((shown - window[0]) * (255.0 / (window[1] - window[0])), 0.0, 255.0)).astype(np.uint8)
    panel: UInt8 = np.repeat(grey[..., None], 3, axis=2)
    if absent is not None:
        panel[_enlarged(absent, size)] = rgb(outside)
    return panel


def _enlarged(plane: npt.NDArray[Any], size: tuple[int, int]) -> npt.NDArray[Any]:
    """The nearest value at each pixel."""
    row, column = (
        ((np.arange(n) + 0.5) * (m / n)).astype(np.int64) for n, m in zip(reversed(size), plane.shape, strict=True)
    )
    nearest: npt.NDArray[Any] = plane[row[:, None], column]
    return nearest


def _lay_over(panel: UInt8, numbers: npt.NDArray[np.generic], colours: Sequence[str]) -> None:
    shown = _enlarged(numbers, (panel.shape[1], panel.shape[0]))
    coloured = shown != 0
    over = np.array([rgb(colour) for colour in colours], float)[shown[coloured] - 1]
    panel[coloured] = np.rint(panel[coloured] * (1.0 - _OVERLAY_ALPHA) + over * _OVERLAY_ALPHA)


def _outline(panel: UInt8, labels: npt.NDArray[Any], colours: dict[int, str]) -> None:
    """Draw the border of each label half way between the voxels' centres; the last colour is on top."""
    y, x = ((np.arange(m + 2) - 0.5) * (n / m) - 0.5 for n, m in zip(panel.shape, labels.shape, strict=False))
    draw_outlines(panel, np.pad(labels, 1), colours, x=x, y=y)


def _write_directions(
    draw: ImageDraw.ImageDraw, corner: tuple[int, int], size: tuple[int, int], view: SliceView
) -> None:
    font = font_of_size(_WRITING, bold=True)
    for side, x, y, anchor in (
        ("left", 0.012, 0.5, "lm"),
        ("right", 0.988, 0.5, "rm"),
        ("top", 0.5, 0.015, "mt"),
        ("bottom", 0.5, 0.985, "mb"),
    ):
        place = corner[0] + x * size[0], corner[1] + y * size[1]
        draw.text(place, view.letters[side], fill=MARKS, font=font, anchor=anchor, stroke_width=2, stroke_fill="black")


def _draw_scale(draw: ImageDraw.ImageDraw, corner: tuple[int, int], size: tuple[int, int], wide: float) -> None:
    length = max((mm for mm in (1, 2, 5, 10, 20, 50, 100, 200) if mm <= 0.25 * wide), default=1)
    inset = round(0.03 * size[0])
    left, bottom = corner[0] + inset, corner[1] + size[1] - inset
    draw.rectangle((left, bottom - 2, left + round(length * size[0] / wide) - 1, bottom + 1), fill=MARKS)
    font = font_of_size(_WRITING - 2)
    place = left, bottom - 2 - 0.015 * size[0]
    draw.text(place, f"{length} mm", fill=MARKS, font=font, anchor="ld", stroke_width=2, stroke_fill="black")
