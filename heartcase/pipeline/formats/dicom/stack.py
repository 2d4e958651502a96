"""Whether images form one straight stack of even spacing, and if not, what is wrong with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from heartcase.pipeline.formats.dicom.archive import SourceFile
from heartcase.pipeline.formats.volumes.agreement import AGREEMENT_MM, EXACT_MM, even_line
from heartcase.schemas.arrays import Bool, Float64, Int64
from heartcase.schemas.errors import ScanError

__all__ = ["COSINE_TOLERANCE", "SPACING_TOLERANCE", "Slice", "Stack", "find_stack", "places_of", "stack_problem"]

COSINE_TOLERANCE = 1e-3
"""Largest difference in a direction cosine within a stack: rounded digits in headers."""
SPACING_TOLERANCE = 1e-3
"""Largest relative difference in pixel spacing within a stack."""
SAME_PLACE_MM = 0.02
"""Slices that lie nearer to each other than this, and than a tenth of the widest gap, lie at one place."""
PLACE_PART = 0.25
"""Part of the distance between slices by which one may be off its place at most, however roundly it is written: more
could as well be a missing slice."""
MISSING_GAP = 1.5
"""A gap of this many median gaps or more has lost a slice."""
MISSING_IN_A_ROW = 2
"""Slices next to each other that may be interpolated."""
MISSING_PART = 1.0 / 3.0
"""Part of the stack's slices that may be interpolated."""
ECHO_TOLERANCE = 0.02
"""Largest relative difference in echo time within a stack: rounded digits."""
NOT_AT_RIGHT_ANGLES = "the directions in the headers are not at right angles: export the series again"
NAMED_GAPS = 5
"""How many gaps an error names."""

Rescale = Literal["stated", "unstated", "unreadable", "table"]


@dataclass(frozen=True)
class Slice:
    """One image of a series, as its header describes it."""

    path: SourceFile
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
    traits: Mapping[str, float | str] = field(default_factory=dict)
    """What may tell images at one position apart: see :mod:`heartcase.pipeline.formats.dicom.phases`."""
    physics: Mapping[str, float] = field(default_factory=dict)
    """Physics of the acquisition: see :mod:`heartcase.pipeline.formats.dicom.headers`."""
    is_localizer: bool = False
    """Whether the header calls it a localiser."""
    uid: str = ""
    """Identity of the image, to recognise copies by; goes into no message."""
    copies: tuple[SourceFile, ...] = ()
    """Other files that claim to be this image."""
    rescale: Rescale = "unstated"
    """What the header says of slope and intercept; ``table`` for a modality LUT."""
    position_decimals: tuple[int, ...] = ()
    """Decimals in which each coordinate of the position is written; empty where that is not known."""
    orientation_decimals: int | None = None
    """Decimals in which the direction is written, the most of its six numbers; None where that is not known."""
    acquired_s: float | None = None
    """Time of day at which it was acquired, s: to tell which of two images came first, and for nothing else."""
    coordinates: str = ""
    """Identity of the study and of the coordinate system that the position refers to; goes into no message."""


@dataclass(frozen=True)
class Stack:
    """Slices in order along the normal, and the map from index to space."""

    slices: tuple[Slice, ...]
    """Those that are there, in ascending order along the cross product of row and column direction."""
    affine: Float64
    """Map from index (i, j, k, 1) to LPS mm, shape (4, 4); (0, 0, 0) is the first pixel of the first slice."""
    places: tuple[int, ...]
    """Index k of each slice: 0, 1, 2 ... but where slices are missing."""
    lean_mm: Float64
    """How far each slice lies from where the affine has it, along rows and along columns, mm; shape (n, 2). All zero
    unless the gantry was tilted."""
    tilt_degrees: float = 0.0
    """Angle between the stack and the normal of its slices; 0 where there was nothing to straighten."""

    @property
    def missing(self) -> tuple[int, ...]:
        """Indices k of the slices that are not there, ascending."""
        return tuple(sorted(set(range(self.places[-1] + 1)) - set(self.places)))


def stack_problem(slices: Sequence[Slice]) -> str | None:
    """What keeps these images from being one stack, in a line; None where nothing does."""
    try:
        find_stack(slices)
    except ScanError as error:
        return error.problems[0].message
    return None


def places_of(slices: Sequence[Slice]) -> Int64:
    """Number of the slice position of each image, from 0 up along the normal, shape (n,).

    All images must have a position and one orientation.
    """
    along = np.array([image.position for image in slices]) @ _axes(slices)[2]
    order = np.argsort(along, kind="stable")
    places = np.empty(len(slices), dtype=np.int64)
    places[order] = np.concatenate(([0], np.cumsum(~_same_place(np.diff(along[order])))))
    return places


def find_stack(slices: Sequence[Slice], *, interpolate_missing: bool = False, straighten_tilt: bool = False) -> Stack:
    """Order the images of a series along their normal and check that they form a stack.

    Parameters
    ----------
    slices
        The images in any order.
    interpolate_missing
        Accept a stack from which at most two neighbouring slices at a time, and at most a third of all, are missing.
    straighten_tilt
        Accept a stack that leans: its slices lie straight above each other only after they are resampled.

    Returns
    -------
    Stack
        Two slices or more, on the even line that lies nearest to all of them.

    Raises
    ------
    ScanError
        Colour, no position, mixed sizes, spacings, orientations, kinds of image, echoes or b-values, fewer than two
        slices, several images at one position, a tilted gantry, missing slices, or uneven spacing.
    """
    _check_alike(slices)
    row, column, normal = _axes(slices)
    positions = np.array([image.position for image in slices])
    along = positions @ normal
    order = np.argsort(along, kind="stable")
    along, positions = along[order], positions[order]
    gaps = np.diff(along)
    _check_duplicates(gaps)
    _check_kinds(slices)
    spacing = np.median([image.spacing for image in slices], axis=0)
    rounding = _rounding_mm(slices)
    across = np.stack([row, column], axis=1)
    drift = (positions - positions[0]) @ across
    angle = _tilt_degrees(drift, along, max(AGREEMENT_MM, float(rounding @ np.abs(across).max(axis=1))))
    if angle > 0.0 and not straighten_tilt:
        raise ScanError(
            f"the stack leans by {angle:.1f} degrees (tilted gantry): have it straightened with --straighten-tilt, or "
            "straighten_tilt = true in the recipe's [scan]"
        )
    places, start, step = _places(along, max(AGREEMENT_MM, float(rounding @ np.abs(normal))), interpolate_missing)
    affine = np.eye(4)
    affine[:3, 0] = row * spacing[1]
    affine[:3, 1] = column * spacing[0]
    affine[:3, 2] = normal * step
    affine[:3, 3] = positions[0] + normal * (start - along[0])
    if angle == 0.0 and np.abs(drift).max() > EXACT_MM:
        affine[:3, 3] += across @ (drift.min(axis=0) + drift.max(axis=0)) / 2.0
    lean = drift if angle > 0.0 else np.zeros((len(slices), 2))
    return Stack(tuple(slices[index] for index in order), affine, places, lean, angle)


def _rounding_mm(slices: Sequence[Slice]) -> Float64:
    """Half a unit of the last decimal that is written of each coordinate in any of the slices, mm, shape (3,)."""
    written = [image.position_decimals for image in slices]
    if not all(len(one) == 3 for one in written):
        return np.zeros(3)
    return np.asarray(0.5 * 10.0 ** -np.max(written, axis=0).astype(float))


def _check_alike(slices: Sequence[Slice]) -> None:
    if not all(image.is_grey for image in slices):
        raise ScanError("the images are in colour: choose the series with the original grey values")
    missing = sum(None in (image.position, image.orientation, image.spacing) for image in slices)
    if missing:
        raise ScanError(
            "the images do not say where they lie in the patient, or how large their pixels are: export the original "
            "series, not screenshots or derived images"
        )
    if len(slices) < 2:
        raise ScanError("the series has a single image: a stack of several slices is needed, give the whole folder")
    first = slices[0]
    differing = []
    if any(image.shape != first.shape for image in slices):
        differing.append("size")
    orientations = np.array([image.orientation for image in slices])
    if np.abs(orientations - np.median(orientations, axis=0)).max() > COSINE_TOLERANCE:
        differing.append("orientation")
    spacings = np.array([image.spacing for image in slices])
    if spacings.min() <= 0.0:
        raise ScanError("the headers give a pixel spacing of zero or less: export the series again")
    if np.abs(spacings / np.median(spacings, axis=0) - 1.0).max() > SPACING_TOLERANCE:
        differing.append("pixel spacing")
    _refuse_differing(differing)


def _check_kinds(slices: Sequence[Slice]) -> None:
    differing = []
    if len({image.traits.get("image_kind") for image in slices}) > 1:
        differing.append("kind (such as magnitude and phase)")
    for trait, words, tolerance in (("echo_time_ms", "echo time", ECHO_TOLERANCE), ("b_value", "b-value", 0.0)):
        values = [value for image in slices if isinstance(value := image.traits.get(trait), float)]
        if values and max(values) - min(values) > tolerance * max(values):
            differing.append(words)
    _refuse_differing(differing)


def _refuse_differing(differing: Sequence[str]) -> None:
    if differing:
        raise ScanError(
            f"the images of the series differ in {' and '.join(differing)}, so they are several stacks: export the "
            "stack that is wanted as a series of its own"
        )


def _axes(slices: Sequence[Slice]) -> tuple[Float64, Float64, Float64]:
    """Orthonormal directions of rows, columns and stack; rounded digits of the headers are evened out.

    Medians, since they are the same in any order of the images.
    """
    cosines = np.median([image.orientation for image in slices], axis=0)
    row, column = cosines[:3], cosines[3:]
    lengths = np.linalg.norm(row), np.linalg.norm(column)
    if min(lengths) < 0.5 or np.linalg.norm(np.cross(row, column)) < 0.5:
        raise ScanError(NOT_AT_RIGHT_ANGLES)
    straight_row = row / lengths[0]
    straight_column = column - (column @ straight_row) * straight_row
    straight_column /= np.linalg.norm(straight_column)
    # rows may have several sizes and spacings here, in which case they are no stack anyway
    extent = np.max([np.multiply(image.shape, image.spacing or (0.0, 0.0)) for image in slices], axis=0)
    moved = [sign * extent[1] * (row - straight_row) + extent[0] * (column - straight_column) for sign in (-1.0, 1.0)]
    decimals = [image.orientation_decimals for image in slices]
    rounding = 0.0 if None in decimals else min(10.0 ** -max(d for d in decimals if d is not None), COSINE_TOLERANCE)
    if np.linalg.norm(moved, axis=1).max() > max(AGREEMENT_MM, rounding * extent.sum()):
        raise ScanError(NOT_AT_RIGHT_ANGLES)
    return straight_row, straight_column, np.cross(straight_row, straight_column)


def _same_place(gaps: Float64) -> Bool:
    """Which gaps between sorted positions are none."""
    same: Bool = gaps <= max(min(SAME_PLACE_MM, 0.1 * gaps.max(initial=0.0)), 1e-6)
    return same


def _check_duplicates(gaps: Float64) -> None:
    same = _same_place(gaps)
    if not same.any():
        return
    counts = np.diff(np.concatenate(([0], np.flatnonzero(~same) + 1, [gaps.size + 1])))
    if counts.size == 1:
        raise ScanError(
            f"all {counts[0]} images show one slice (times or echoes of a single position): a stack of several slices "
            "is needed, give the whole study or another series"
        )
    if counts.min() == counts.max():
        raise ScanError(
            f"the series holds {counts[0]} images at every slice position and nothing in the headers tells them apart "
            "by time or echo: export the stack that is wanted as a series of its own"
        )
    first = int(np.flatnonzero(same)[0]) + 1
    number = int(same.sum())
    raise ScanError(
        f"{number} slice{'s are' if number > 1 else ' is'} there twice, first slices {first} and {first + 1} lie at "
        "one position: remove the copies, or take one of two acquisitions that meet there with --overlap"
    )


def _tilt_degrees(drift: Float64, along: Float64, tolerance: float) -> float:
    """Angle by which the stack leans, 0 within the tolerance, mm; ``drift`` along rows and columns, shape (n, 2)."""
    if np.linalg.norm(np.ptp(drift, axis=0)) / 2.0 <= tolerance:
        return 0.0
    total = along[-1] - along[0]
    straight = np.abs(drift - np.outer((along - along[0]) / total, drift[-1])).max() <= tolerance
    length = float(np.linalg.norm(drift[-1]))
    if straight and length > 0.0:
        return float(np.degrees(np.arctan2(length, total)))
    raise ScanError(
        "the slices are shifted sideways against each other, so they do not form one stack: export the series again"
    )


def _usual_gap(gaps: Float64, tolerance: float) -> float:
    """The smallest gap where all are whole multiples of it, else the median (the lower of two)."""
    single = float(np.median(gaps[gaps < MISSING_GAP * gaps.min()]))
    allowed = min(2.0 * tolerance, PLACE_PART * single)
    if (np.abs(gaps - np.round(gaps / single) * single) <= allowed).all():
        return single
    return float(np.sort(gaps)[(gaps.size - 1) // 2])


def _places(along: Float64, tolerance: float, may_interpolate: bool) -> tuple[tuple[int, ...], float, float]:
    """Index of each slice, from 0; position of the first place, and the distance between places, mm.

    ``tolerance`` is how far a slice may lie from its place, mm.
    """
    gaps = np.diff(along)
    usual = _usual_gap(gaps, tolerance)
    missing = np.where(gaps >= MISSING_GAP * usual, np.maximum(1, np.round(gaps / usual) - 1), 0).astype(np.int64)
    places = np.concatenate(([0], np.cumsum(missing + 1)))
    start, spacing, distance = even_line(along, places)
    is_even = distance <= min(tolerance, PLACE_PART * spacing)
    allowed = min(2.0 * tolerance, PLACE_PART * usual)
    problems = []
    for index, (gap, count) in enumerate(zip(gaps.tolist(), missing.tolist(), strict=True)):
        between = f"between slice {index + 1} and the next one that is there"
        is_off = not is_even and abs(gap - (count + 1) * usual) > allowed
        if count and (not may_interpolate or is_off or count > MISSING_IN_A_ROW):
            problems.append(
                f"{count} slice{'s are' if count > 1 else ' is'} missing {between} (gap {gap:.2f} mm, elsewhere "
                f"{usual:.2f} mm)"
            )
        elif is_off:
            problems.append(f"uneven spacing {between} ({gap:.2f} mm, elsewhere {usual:.2f} mm)")
    lost, whole = int(missing.sum()), int(places[-1]) + 1
    if not is_even and not problems:
        problems.append(f"uneven spacing (slices lie up to {distance:.2f} mm from places {spacing:.2f} mm apart)")
    if not problems and lost > MISSING_PART * whole:
        problems.append(f"{lost} of {whole} slices are missing, more than a third")
    if problems:
        rest = f", and {len(problems) - NAMED_GAPS} more" if len(problems) > NAMED_GAPS else ""
        remedy = "export the whole series again"
        if may_interpolate:
            remedy += " (at most two slices in a row and a third of all are interpolated, at even spacing)"
        elif lost:
            remedy += (
                ", or have it filled from its neighbours with --interpolate-missing, or interpolate_missing = true in "
                "the recipe's [scan]"
            )
        raise ScanError(f"{'; '.join(problems[:NAMED_GAPS])}{rest}: {remedy}")
    return tuple(places.tolist()), start, spacing
