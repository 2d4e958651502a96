"""Do these images form one straight stack of even spacing? And if not, what is wrong with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from heartcase.schemas.errors import ScanError

__all__ = ["Slice", "Stack", "find_stack", "stack_problem"]

COSINE_TOLERANCE = 1e-3
"""Largest difference in a direction cosine within a stack, and from right angles: rounded digits in headers."""
SPACING_TOLERANCE = 1e-3
"""Largest relative difference in pixel spacing within a stack."""
GAP_TOLERANCE = 0.01
"""Largest difference of a gap between slices from the median gap, as a part of it; see GAP_FLOOR_MM."""
GAP_FLOOR_MM = 0.02
"""Positions are often written with two decimals, so that a gap is off by up to 0.01 mm: less than this is even, unless
it is a quarter of the gap."""
DRIFT_TOLERANCE = 0.1
"""Largest shift of the last slice against the first within the slice plane, in pixels: more is a tilted gantry."""
MISSING_GAP = 1.5
"""A gap of this many median gaps or more has lost a slice."""
NAMED_GAPS = 5
"""How many gaps an error names."""

Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Slice:
    """One image of a series, as its header describes it."""

    path: Path
    """Where its pixels are; goes into no message."""
    frame: int | None
    """Frame of a multi-frame file."""
    shape: tuple[int, int]
    """Rows and columns."""
    is_grey: bool
    """Whether there is one grey value per pixel."""
    position: tuple[float, ...] | None
    """Centre of the first pixel, LPS mm."""
    orientation: tuple[float, ...] | None
    """Direction of a row (column index rising), then of a column (row index rising)."""
    spacing: tuple[float, ...] | None
    """Distance between rows, then between columns, mm."""
    slope: float
    """Value = slope * stored + intercept."""
    intercept: float
    """See slope."""


@dataclass(frozen=True)
class Stack:
    """Slices in order along the normal, and the map from index to space."""

    slices: tuple[Slice, ...]
    """In ascending order along the cross product of row and column direction."""
    affine: Float64
    """Map from index (i, j, k, 1) to LPS mm, shape (4, 4)."""


def stack_problem(slices: Sequence[Slice]) -> str | None:
    """What keeps these images from being one stack, in a line; None where nothing does."""
    try:
        find_stack(slices)
    except ScanError as error:
        return error.problems[0].message
    return None


def find_stack(slices: Sequence[Slice]) -> Stack:
    """Order the images of a series along their normal and check that they form a stack.

    Parameters
    ----------
    slices
        The images in any order.

    Returns
    -------
    Stack
        Two slices or more. Spacing along the stack is that from first to last, shared evenly.

    Raises
    ------
    ScanError
        Colour, no position, mixed sizes, spacings or orientations, fewer than two slices, several images at one
        position, a tilted gantry, missing slices, or uneven spacing.
    """
    _check_alike(slices)
    row, column, normal = _axes(slices)
    positions = np.array([image.position for image in slices])
    along = positions @ normal
    order = np.argsort(along, kind="stable")
    along, positions = along[order], positions[order]
    gaps = np.diff(along)
    _check_duplicates(gaps)
    spacing = np.array(slices[0].spacing)
    drift = positions - positions[0] - (along - along[0])[:, np.newaxis] * normal
    _check_tilt(drift, along, spacing)
    _check_gaps(gaps)
    affine = np.eye(4)
    affine[:3, 0] = row * spacing[1]
    affine[:3, 1] = column * spacing[0]
    affine[:3, 2] = normal * (along[-1] - along[0]) / (len(slices) - 1)
    affine[:3, 3] = positions[0]
    return Stack(tuple(slices[index] for index in order), affine)


def _check_alike(slices: Sequence[Slice]) -> None:
    if not all(image.is_grey for image in slices):
        raise ScanError("the images are in colour: choose the series with the original grey values")
    missing = sum(None in (image.position, image.orientation, image.spacing) for image in slices)
    if missing:
        raise ScanError(
            f"{missing} of {len(slices)} images do not say where they lie in the patient: export the original series, "
            "not screenshots or derived images"
        )
    if len(slices) < 2:
        raise ScanError("the series has a single image: a stack of several slices is needed, give the whole folder")
    first = slices[0]
    differing = []
    if any(image.shape != first.shape for image in slices):
        differing.append("size")
    orientations = np.array([image.orientation for image in slices])
    if np.abs(orientations - orientations[0]).max() > COSINE_TOLERANCE:
        differing.append("orientation")
    spacings = np.array([image.spacing for image in slices])
    if spacings.min() <= 0.0 or np.abs(spacings / spacings[0] - 1.0).max() > SPACING_TOLERANCE:
        differing.append("pixel spacing")
    if differing:
        raise ScanError(
            f"the images of the series differ in {' and '.join(differing)}, so they are several stacks: export the "
            "stack that is wanted as a series of its own"
        )


def _axes(slices: Sequence[Slice]) -> tuple[Float64, Float64, Float64]:
    """Orthonormal directions of rows, columns and stack; rounded digits of the header are evened out."""
    cosines = np.array(slices[0].orientation)
    row, column = cosines[:3], cosines[3:]
    lengths = np.linalg.norm(row), np.linalg.norm(column)
    if max(abs(lengths[0] - 1.0), abs(lengths[1] - 1.0), abs(row @ column)) > COSINE_TOLERANCE:
        raise ScanError("the directions in the headers are not at right angles: export the series again")
    row = row / lengths[0]
    column = column - (column @ row) * row
    column /= np.linalg.norm(column)
    return row, column, np.cross(row, column)


def _check_duplicates(gaps: Float64) -> None:
    same = gaps <= min(GAP_FLOOR_MM, 0.1 * gaps.max())
    if not same.any():
        return
    counts = np.diff(np.concatenate(([0], np.flatnonzero(~same) + 1, [gaps.size + 1])))
    if counts.min() == counts.max():
        raise ScanError(
            f"the series holds {counts[0]} images at every slice position (times, phases or echoes): export the one "
            "that is wanted as a series of its own"
        )
    first = int(np.flatnonzero(same)[0]) + 1
    raise ScanError(
        f"{int(same.sum())} slices are there twice, first slices {first} and {first + 1} lie at one position: remove "
        "the copies"
    )


def _check_tilt(drift: Float64, along: Float64, spacing: Float64) -> None:
    length = np.linalg.norm(drift, axis=1)
    if length.max() <= DRIFT_TOLERANCE * spacing.min():
        return
    total = along[-1] - along[0]
    angle = np.degrees(np.arctan2(length[-1], total))
    straight = np.abs(drift - np.outer((along - along[0]) / total, drift[-1])).max() <= spacing.min()
    if straight and length[-1] > 0.0:
        raise ScanError(
            f"the stack leans by {angle:.1f} degrees (tilted gantry): straighten it, for instance by exporting it from "
            "3D Slicer after its acquisition geometry is regularised"
        )
    raise ScanError(
        "the slices are shifted sideways against each other, so they do not form one stack: export the series again"
    )


def _check_gaps(gaps: Float64) -> None:
    median = float(np.median(gaps))
    tolerance = min(max(GAP_FLOOR_MM, GAP_TOLERANCE * median), 0.25 * median)
    problems = []
    for index, gap in enumerate(gaps):
        between = f"between slice {index + 1} and the next one that is there"
        if gap >= MISSING_GAP * median:
            count = max(1, round(gap / median) - 1)
            problems.append(
                f"{count} slice{'s are' if count > 1 else ' is'} missing {between} (gap {gap:.2f} mm, elsewhere "
                f"{median:.2f} mm)"
            )
        elif abs(gap - median) > tolerance:
            problems.append(f"uneven spacing {between} ({gap:.2f} mm, elsewhere {median:.2f} mm)")
    if problems:
        rest = f", and {len(problems) - NAMED_GAPS} more" if len(problems) > NAMED_GAPS else ""
        raise ScanError(f"{'; '.join(problems[:NAMED_GAPS])}{rest}: export the whole series again, or resample it")
