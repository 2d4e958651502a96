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

from heartcase.pipeline.report.outlines import draw_outlines
from heartcase.pipeline.report.pictures import direction_letters
from heartcase.schemas.arrays import UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable

__all__ = ["STACKS", "SliceView", "Stack", "display_window", "slice_pictures", "slice_position", "slice_view"]

Stack = Literal["axial", "coronal", "sagittal"]

_STACKS: dict[Stack, tuple[int, tuple[float, float, float], tuple[float, float, float]]] = {
    "axial": (2, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "coronal": (1, (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
    "sagittal": (0, (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
}
"""Name -> world axis across the slices, direction that shows to the right, direction that shows downwards (LPS)."""

STACKS: tuple[Stack, ...] = ("axial", "coronal", "sagittal")
"""All stacks, in the order of a report."""

_INCH_PIXELS = 140
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
        plane = np.take(values.transpose(2, 1, 0), number, axis=self.through)
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


def slice_position(geometry: Geometry, stack: Stack, number: int) -> str:
    """Where a slice lies, as scanners write it: the distance of its plane from the scanner's zero, and to which side.

    ``S 34.5 mm`` is 34.5 mm towards the head. In an oblique stack the letters name the slices' normal, strongest
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
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    view = slice_view(geometry, stack)
    crop = tuple(slice(low, high) for low, high in reversed(box))
    sizes = [high - low for low, high in box]
    span_mm = [n * spacing for n, spacing in zip(sizes, geometry.spacing_mm, strict=True)]
    wide, tall = span_mm[view.across], span_mm[view.down]
    cell = width / count / _INCH_PIXELS
    caption, below = 0.28, 0.22 if footnote else 0.0
    height = min(cell * tall / wide, 1.6 * cell)
    whole = height + caption + below
    figure = Figure(figsize=(width / _INCH_PIXELS, whole), dpi=_INCH_PIXELS, facecolor="white")
    figure.text(0.005, 0.04 / whole, footnote, fontsize=9, color="#282c34", va="bottom")
    canvas = FigureCanvasAgg(figure)
    numbers = [int((n + 0.5) * sizes[view.through] / count) for n in range(count)]
    extent = (0.0, wide, tall, 0.0)
    for place, number in enumerate(numbers):
        axes = figure.add_axes(((place + 0.01) / count, below / whole, 0.98 / count, height / whole), facecolor="black")
        shown = box[view.through][0] + number
        grey = view.take(scan[crop], number)
        axes.imshow(grey, cmap="gray", vmin=window[0], vmax=window[1], extent=extent, interpolation="bilinear")
        if overlay is not None:
            _lay_over(axes, view.take(overlay.numbers[crop], number), overlay.colours, extent)
        if labels is not None:
            _outline(axes, view.take(labels[crop], number), wide, tall, colours)
        axes.set_xlim(0.0, wide)
        axes.set_ylim(tall, 0.0)
        axes.set_axis_off()
        _write_directions(axes, view)
        _draw_scale(axes, wide, tall)
        # A title of the axes would have all ticks made and measured first, which nobody sees.
        figure.text(
            (place + 0.5) / count,
            (below + height + 3.0 / 72.0) / whole,
            f"{stack} {shown + 1} of {geometry.size[view.through]}, at {slice_position(geometry, stack, shown)}",
            fontsize=9,
            ha="center",
            va="baseline",
            color="#282c34",
        )
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.array(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


def _lay_over(axes, numbers, colours: Sequence[str], extent) -> None:  # type: ignore[no-untyped-def]
    from matplotlib.colors import ListedColormap

    shown = np.ma.masked_equal(numbers, 0)
    cmap = ListedColormap(list(colours))
    axes.imshow(
        shown,
        cmap=cmap,
        vmin=0.5,
        vmax=len(colours) + 0.5,
        extent=extent,
        alpha=_OVERLAY_ALPHA,
        interpolation="nearest",
    )


def _outline(axes, labels, wide: float, tall: float, colours: dict[int, str]) -> None:  # type: ignore[no-untyped-def]
    """Draw the border of each label half way between the voxels' centres; the last colour is on top."""
    padded = np.pad(labels, 1)
    rows, columns = labels.shape
    x = (np.arange(columns + 2) - 0.5) * wide / columns
    y = (np.arange(rows + 2) - 0.5) * tall / rows
    draw_outlines(axes, padded, colours, x=x, y=y)


def _write_directions(axes, view: SliceView) -> None:  # type: ignore[no-untyped-def]
    for side, x, y, across, along in (
        ("left", 0.012, 0.5, "left", "center"),
        ("right", 0.988, 0.5, "right", "center"),
        ("top", 0.5, 0.985, "center", "top"),
        ("bottom", 0.5, 0.015, "center", "bottom"),
    ):
        axes.text(
            x,
            y,
            view.letters[side],
            transform=axes.transAxes,
            ha=across,
            va=along,
            fontsize=9,
            color="#ffe9a8",
            fontweight="bold",
            path_effects=_dark_rim(),
        )


def _draw_scale(axes, wide: float, tall: float) -> None:  # type: ignore[no-untyped-def]
    length = max((mm for mm in (1, 2, 5, 10, 20, 50, 100, 200) if mm <= 0.25 * wide), default=1)
    left, bottom = 0.03 * wide, tall - 0.03 * wide
    axes.plot([left, left + length], [bottom, bottom], color="#ffe9a8", linewidth=2, solid_capstyle="butt")
    axes.text(
        left,
        bottom - 0.015 * wide,
        f"{length} mm",
        color="#ffe9a8",
        fontsize=8,
        ha="left",
        va="bottom",
        path_effects=_dark_rim(),
    )


def _dark_rim() -> list[Any]:
    """Keep light writing readable over bright tissue."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=2, foreground="black")]
