"""Read a DICOM series: a folder of slices, or the frames of a multi-frame file.

Errors name a slice by its place in the stack (slice 1 is the first along the stack's axis, which is the cross product
of the rows' and the columns' direction) and a series by its number in the list: a tag's value, a path or a file name
may identify a patient and goes nowhere.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.dicom.archive import SourceFile
from heartcase.pipeline.formats.dicom.choice import Choice, SeriesInfo, choose, describe_volume, lack_problem, listed
from heartcase.pipeline.formats.dicom.headers import find_series, is_dicom
from heartcase.pipeline.formats.dicom.overlap import Overlap, one_at_each_place
from heartcase.pipeline.formats.dicom.phases import TIME_TOLERANCE_MS, PhaseStack, StackGroup, stack_groups
from heartcase.pipeline.formats.dicom.pixels import fill_padding, read_pixels
from heartcase.pipeline.formats.dicom.stack import Stack, find_stack
from heartcase.pipeline.formats.dicom.straighten import straight_shape, straightened, with_missing
from heartcase.pipeline.formats.volumes.raw_volume import check_size, geometry_from_affine
from heartcase.pipeline.warnings import CaseWarning, anatomy, note
from heartcase.schemas.errors import ScanError

__all__ = [
    "SeriesInfo",
    "chosen_file",
    "describe_volume",
    "groups_of",
    "is_dicom",
    "read_dicom",
    "scan_of_stack",
    "series_of",
]

ONE_VALUE = {"tube_voltage_kv": ("tube voltage", "kV"), "inversion_time_ms": ("inversion time", "ms")}
"""Traits that a stack should state alike -> name and unit."""


def series_of(path: Path) -> tuple[SeriesInfo, ...]:
    """List the series of a folder, or of one file; a series that holds several stacks has an entry for each.

    Cardiac phases and echoes of one stack share an entry, which lists their times.

    Raises
    ------
    ScanError
        There is no DICOM image, or a file is damaged.
    """
    return listed(groups_of(path))


def read_dicom(
    path: Path,
    *,
    series: str | None = None,
    trigger_time_ms: float | None = None,
    echo_time_ms: float | None = None,
    interpolate_missing: bool = False,
    straighten_tilt: bool = False,
    overlap: Overlap | None = None,
) -> Scan:
    """Read one stack.

    Parameters
    ----------
    path
        Folder, searched with its subfolders; a zip archive of one; or one file.
    series
        Number or code in :func:`series_of`, or the UID; may be left out where there is one stack beside localisers.
    trigger_time_ms
        The cardiac phase nearest to this time after the R wave, ms; see
        :func:`~heartcase.pipeline.formats.dicom.choice.choose` for how near it must be.
    echo_time_ms
        The echo nearest to this echo time, ms.
    interpolate_missing
        Fill missing slices linearly from their neighbours, at most two in a row and a third of all.
    straighten_tilt
        Resample a leaning stack within its slices, linearly, so that they lie straight above each other.
    overlap
        Where two acquisitions meet in one slice position: take the image that was acquired ``"earlier"`` or
        ``"later"``. Left out, such a series is refused.

    Returns
    -------
    Scan
        Values after the modality LUT or rescale slope and intercept; padding at the edge of an image has the lowest
        value. The axes are the rows', the columns' and their normal: right-handed. ``warnings`` says what was filled,
        straightened or left out.

    Raises
    ------
    ScanError
        The choice is not clear, or the images do not form one evenly spaced straight stack.
    """
    choice = choose(groups_of(path), series=series, trigger_time_ms=trigger_time_ms, echo_time_ms=echo_time_ms)
    try:
        if choice.stack.lacks and (choice.stack.lacks_an_end or not interpolate_missing):
            raise ScanError(lack_problem(choice))
        slices, notes = one_at_each_place(choice.stack.slices, overlap)
        choice = choice._replace(notes=(*choice.notes, *notes))
        stack = find_stack(slices, interpolate_missing=interpolate_missing, straighten_tilt=straighten_tilt)
    except ScanError as error:
        left_out = f" ({choice.group.left_out})" if choice.group.left_out else ""
        raise ScanError(error.problems[0].message + left_out) from None
    return scan_of_stack(stack, choice)


def scan_of_stack(stack: Stack, choice: Choice) -> Scan:
    """Read the pixels of a stack; ``choice`` says what it was found as.

    Raises
    ------
    ScanError
        A file is damaged or holds values that are not finite.
    """
    check_size(straight_shape(stack)[::-1])
    values = fill_padding(read_pixels(stack.slices))
    values, affine = straightened(values, stack)
    values = with_missing(values, stack)
    if not np.isfinite(values).all():
        raise ScanError("the rescaled values are not finite numbers: export the series again")
    return Scan(
        values=values,
        geometry=geometry_from_affine(affine, values.shape),
        modality=choice.group.modality,
        acquisition=_acquisition(choice.stack),
        warnings=tuple(_warnings(stack, choice)),
    )


def chosen_file(
    path: Path, *, series: str | None = None, trigger_time_ms: float | None = None, echo_time_ms: float | None = None
) -> SourceFile:
    """One file of the stack that :func:`read_dicom` would read: for those who may know whose scan it is.

    Raises
    ------
    ScanError
        The choice is not clear.
    """
    choice = choose(groups_of(path), series=series, trigger_time_ms=trigger_time_ms, echo_time_ms=echo_time_ms)
    return choice.stack.slices[0].path


def groups_of(path: Path) -> tuple[StackGroup, ...]:
    """The groups of stacks of a folder, or of one file, in the order of their numbers.

    Raises
    ------
    ScanError
        There is no DICOM image, or a file is damaged.
    """
    return tuple(group for series in find_series(path) for group in stack_groups(series))


def _acquisition(chosen: PhaseStack) -> dict[str, float]:
    """Physics on which all slices agree, and the time of the phase."""
    physics = dict(chosen.slices[0].physics)
    for image in chosen.slices[1:]:
        physics = {name: value for name, value in physics.items() if image.physics.get(name) == value}
    stated = {
        "trigger_time_ms": chosen.trigger_time_ms,
        "cardiac_phase_percent": chosen.cardiac_phase_percent,
        "echo_time_ms": chosen.echo_time_ms,
    }
    return physics | {name: value for name, value in stated.items() if value is not None}


def _warnings(stack: Stack, choice: Choice) -> list[CaseWarning]:
    group, chosen, notes = choice
    warnings: list[CaseWarning] = list(notes)
    if stack.missing:
        numbers = ", ".join(str(place + 1) for place in stack.missing)
        spacing = float(np.linalg.norm(stack.affine[:3, 2]))
        several = len(stack.missing) > 1
        text = (
            f"slice{'s' if several else ''} {numbers} {'were' if several else 'was'} missing and "
            f"{'are' if several else 'is'} interpolated from the nearest slices that are there ({spacing:.2f} mm per "
            "slice)"
        )
        warnings.append(anatomy(text))
    if stack.tilt_degrees:
        text = f"the stack leaned by {stack.tilt_degrees:.1f} degrees (tilted gantry)"
        warnings.append(note(f"{text}: its slices were resampled to lie straight above each other"))
    others = [
        other.trigger_time_ms
        for other in group.stacks
        if other is not chosen and other.echo_time_ms == chosen.echo_time_ms
    ]
    steps = [abs(time - (chosen.trigger_time_ms or 0.0)) for time in others if time is not None]
    if chosen.trigger_spread_ms > min([TIME_TOLERANCE_MS, *(0.5 * step for step in steps)]):
        warnings.append(
            CaseWarning(
                f"the trigger times of the slices differ by up to {chosen.trigger_spread_ms:.0f} ms: the heartbeat "
                "changed during the scan, or they show several phases of it, so the slices may not fit together"
            )
        )
    for trait, (words, unit) in ONE_VALUE.items():
        values = [value for image in chosen.slices if isinstance(value := image.traits.get(trait), float)]
        if len(set(values)) > 1:
            warnings.append(
                CaseWarning(
                    f"the {words} of the slices is not one: {min(values):g} to {max(values):g} {unit}, so that their "
                    "grey values may not mean the same"
                )
            )
    return [*warnings, note(group.left_out)] if group.left_out else warnings
