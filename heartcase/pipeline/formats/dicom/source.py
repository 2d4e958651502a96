"""The images of a DICOM series that a case was made from: their identifiers, and where they lie.

They are known by the hash of their values, never by place alone: scans of other patients may lie at the same place.
Read only when the user asks for a segmentation that opens on the original scan. No name, number or date is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pydicom

from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.dicom.archive import SourceFile
from heartcase.pipeline.formats.dicom.choice import Choice, named, stack_geometry
from heartcase.pipeline.formats.dicom.headers import quiet_pydicom
from heartcase.pipeline.formats.dicom.overlap import Overlap, one_at_each_place
from heartcase.pipeline.formats.dicom.phases import PhaseStack, StackGroup
from heartcase.pipeline.formats.dicom.read import groups_of, scan_of_stack
from heartcase.pipeline.formats.dicom.stack import Stack, find_stack
from heartcase.pipeline.formats.volumes.raw_volume import placed
from heartcase.schemas.bundle.format import CaseManifest
from heartcase.schemas.errors import HeartcaseError, ScanError, UsageError
from heartcase.schemas.geometry import Geometry

__all__ = ["SourceImage", "SourceSeries", "find_source"]

PLACE = "--scan"
TIME_TOLERANCE_MS = 1e-3
"""By how much the time of a phase or an echo may differ from that in the manifest: rounded digits."""
_TAGS = ["SOPClassUID", "SOPInstanceUID", "SeriesInstanceUID", "StudyInstanceUID", "FrameOfReferenceUID"]


@dataclass(frozen=True)
class SourceImage:
    """One image, or one frame of a multi-frame file."""

    sop_class_uid: str
    """Kind of the object."""
    sop_instance_uid: str
    """Identity of the object."""
    frame: int | None
    """Number of the frame, from 1; None for a plain image."""
    slice: int
    """Slice of the labels' lattice that it shows."""


@dataclass(frozen=True)
class SourceSeries:
    """The part of a series that the labels of a case cover."""

    study_uid: str
    """Identity of the study."""
    series_uid: str
    """Identity of the series."""
    frame_of_reference_uid: str
    """Identity of the scanner's coordinate system, which all its positions refer to."""
    images: tuple[SourceImage, ...]
    """By slice, then by identity; only those of the cardiac phase and echo that the case was made from."""
    offset: tuple[int, int, int]
    """Index of the scan's voxel that is the labels' first."""


@dataclass(frozen=True)
class _Fitting:
    """A stack that lies where the labels lie."""

    number: int
    """Number of its group in ``heartcase info``."""
    choice: Choice
    """What it was found as."""
    stack: Stack
    """Its slices in order."""
    offset: tuple[int, int, int]
    """Index of its voxel that is the labels' first."""


def find_source(folder: Path, manifest: CaseManifest, *, series: str | None = None) -> SourceSeries:
    """Find the images that a case was made from, by the values of their pixels.

    A stack is the case's scan when its cropped region has the hash of the manifest. Where the case tells the times of
    the cardiac phase and the echo, only stacks of these times are looked at.

    Parameters
    ----------
    folder
        Folder of DICOM files, searched with its subfolders, or one file.
    manifest
        The case: lattice, hash and times of its scan, and what was done to missing slices as it was read.
    series
        Number or code in ``heartcase info``, or UID, where the scan is there more than once; None where it is not.

    Returns
    -------
    SourceSeries
        The images of the one stack. A slice that was interpolated has none.

    Raises
    ------
    UsageError
        The scan is not there, is there more than once and none is chosen, or was straightened, so that its voxels lie
        on no image.
    ScanError
        There is no DICOM image, a file is damaged, or the images do not share a coordinate system.
    """
    try:
        groups = groups_of(folder)
        wanted = groups if series is None else named(groups, series)
        fitting, has_leaning = _fitting(groups, wanted, manifest)
        same = [one for one in fitting if _has_agreeing_times(one.choice.stack, manifest) and _is_scan(one, manifest)]
    except HeartcaseError as error:
        raise placed(error, PLACE, ScanError) from None
    if len(same) == 1:
        return _described(same[0], manifest.scan_geometry)
    if same:
        numbers = ", ".join(str(one.number) for one in same)
        raise UsageError(
            f"this scan is there {len(same)} times, as series {numbers} of 'heartcase info': choose one of these with "
            "--series",
            place=PLACE,
        )
    if fitting:
        raise UsageError(
            "this is not the scan that the case was made from: images lie where its labels lie but hold other values "
            "(another patient, cardiac phase or reconstruction). Give the DICOM folder that the case was made from, or "
            "export without --scan",
            place=PLACE,
        )
    if has_leaning:
        raise UsageError(
            "the case was made from a straightened scan (tilted gantry), whose voxels lie on no image: export without "
            "--scan",
            place=PLACE,
        )
    raise UsageError(
        "no series there has slices where the labels of the case lie: give the DICOM folder that the case was made "
        "from, or export without --scan",
        place=PLACE,
    )


def _fitting(
    groups: Sequence[StackGroup], wanted: Sequence[StackGroup], manifest: CaseManifest
) -> tuple[list[_Fitting], bool]:
    """The stacks whose lattice holds the case's; whether a leaning one was among those that were passed over."""
    reading = next((record.settings for record in manifest.stages if record.stage == "read"), {})
    may_interpolate = reading.get("interpolate_missing") is True
    overlap: Overlap | None = reading.get("overlap")
    may_straighten = reading.get("straighten_tilt") is True
    fitting, has_leaning = [], False
    for number, group in enumerate(groups, start=1):
        for phase in group.stacks if any(group is one for one in wanted) else ():
            try:
                slices, _ = one_at_each_place(phase.slices, overlap)
                stack = find_stack(slices, interpolate_missing=may_interpolate, straighten_tilt=may_straighten)
            except ScanError:
                continue
            if stack.tilt_degrees:
                has_leaning = True
                continue
            offset = _offset(stack_geometry(stack), manifest.scan_geometry)
            if offset is not None:
                fitting.append(_Fitting(number, Choice(group, phase), stack, offset))
    return fitting, has_leaning


def _offset(whole: Geometry, part: Geometry) -> tuple[int, int, int] | None:
    """Index in ``whole`` of the first point of ``part``; None unless all of ``part`` are points of ``whole``."""
    i, j, k = (int(index) for index in np.rint(whole.world_to_index(part.origin_mm)))
    start = (i, j, k)
    is_inside = all(0 <= s <= n - m for s, n, m in zip(start, whole.size, part.size, strict=True))
    return start if is_inside and whole.cropped(start, part.size).matches(part) else None


def _has_agreeing_times(stack: PhaseStack, manifest: CaseManifest) -> bool:
    for name, stated in (("trigger_time_ms", stack.trigger_time_ms), ("echo_time_ms", stack.echo_time_ms)):
        known = manifest.acquisition.get(name)
        if isinstance(known, int | float) and (stated is None or abs(stated - known) > TIME_TOLERANCE_MS):
            return False
    return True


def _is_scan(one: _Fitting, manifest: CaseManifest) -> bool:
    """Whether the stack's values, cropped as the case was, are those that it was made from."""
    values = scan_of_stack(one.stack, one.choice).values
    box = tuple(slice(s, s + n) for s, n in zip(one.offset[::-1], manifest.scan_geometry.shape, strict=True))
    region = Scan(values=values[box], geometry=manifest.scan_geometry)
    return region.values_sha256 == manifest.scan_sha256


def _described(found: _Fitting, geometry: Geometry) -> SourceSeries:
    first, count = found.offset[2], geometry.size[2]
    places = [(image, k - first) for image, k in zip(found.stack.slices, found.stack.places, strict=True)]
    headers: dict[SourceFile, dict[str, str]] = {}
    with quiet_pydicom():
        for image, _ in places:
            if image.path not in headers:
                try:
                    with image.path.open("rb") as stream:
                        header: Any = pydicom.dcmread(
                            stream, stop_before_pixels=True, specific_tags=list(_TAGS), force=True
                        )
                    headers[image.path] = {tag: str(header.get(tag, "") or "") for tag in _TAGS}
                except Exception:  # pydicom raises errors of every kind on damaged files
                    raise ScanError("a file is cut short or damaged: copy the series again", place=PLACE) from None
    shared = {(one["StudyInstanceUID"], one["FrameOfReferenceUID"]) for one in headers.values()}
    study, frame_of_reference = shared.pop()
    if shared or not study or not frame_of_reference:
        raise ScanError(
            "the images do not state one study and one frame of reference: export without --scan", place=PLACE
        )
    images = [
        SourceImage(
            headers[image.path]["SOPClassUID"],
            headers[image.path]["SOPInstanceUID"],
            None if image.frame is None else image.frame + 1,
            k,
        )
        for image, k in places
        if 0 <= k < count
    ]
    return SourceSeries(
        study_uid=study,
        series_uid=found.choice.group.series_uid,
        frame_of_reference_uid=frame_of_reference,
        images=tuple(sorted(images, key=lambda one: (one.slice, one.sop_instance_uid, one.frame or 0))),
        offset=found.offset,
    )
