"""The images of a DICOM series that a segmentation is of: their identifiers, and where they lie.

Read only when the user asks for a segmentation that opens on the original scan. No name, number or date is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pydicom

from heartcase.pipeline.formats.dicom_headers import ImageSeries, find_series, quiet_pydicom
from heartcase.pipeline.formats.raw_volume import placed
from heartcase.pipeline.formats.stack import Slice
from heartcase.schemas.errors import HeartcaseError, ScanError, UsageError
from heartcase.schemas.geometry import Geometry

__all__ = ["SourceImage", "SourceSeries", "find_source"]

PLACE = "--scan"
TOLERANCE = 0.02
"""How far a slice of the scan may lie from a plane of the labels, in voxels."""
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
    """The part of a series that a label volume covers."""

    study_uid: str
    """Identity of the study."""
    series_uid: str
    """Identity of the series."""
    frame_of_reference_uid: str
    """Identity of the scanner's coordinate system, which all its positions refer to."""
    images: tuple[SourceImage, ...]
    """By slice, then by identity."""
    offset: tuple[int, int, int]
    """Index of the scan's voxel that is the labels' first."""


def find_source(folder: Path, geometry: Geometry, *, series: str | None) -> SourceSeries:
    """Find the series whose slices a label volume lies on.

    Parameters
    ----------
    folder
        Folder of DICOM files, searched with its subfolders.
    geometry
        Lattice of the labels.
    series
        Number of the series among those that fit, or end of its UID; None where only one fits.

    Raises
    ------
    UsageError
        No series fits, or several and none is chosen.
    ScanError
        There is no DICOM image, a file is damaged, or the images do not share a coordinate system.
    """
    try:
        every = find_series(folder)
    except HeartcaseError as error:
        raise placed(error, PLACE, ScanError) from None
    fitting = []
    for one in every:
        places = [(image, place) for image in one.slices if (place := _place(image, geometry)) is not None]
        if len({place[2] for _, place in places if 0 <= place[2] < geometry.size[2]}) == geometry.size[2]:
            fitting.append((one, places))
    if series is not None:
        by_number = int(series) if series.strip().isdecimal() else 0
        fitting = [f for n, f in enumerate(fitting, 1) if n == by_number or f[0].uid.endswith(series.strip())]
    if not fitting:
        raise UsageError(
            "no series there has slices where the labels of the case lie: give the DICOM folder that the case was made "
            "from (a scan that was straightened or filled in has other slices: export without --scan)",
            place=PLACE,
        )
    if len(fitting) > 1:
        raise UsageError(
            f"{len(fitting)} series there have slices where the labels of the case lie: choose one with --series, by "
            f"its number from 1 to {len(fitting)} or the end of its UID",
            place=PLACE,
        )
    return _described(*fitting[0], geometry)


def _place(image: Slice, geometry: Geometry) -> tuple[int, int, int] | None:
    """Index of the image's first pixel on the lattice, when it is a slice of it; may lie outside."""
    if image.position is None or image.orientation is None or image.spacing is None:
        return None
    index = geometry.world_to_index(np.array(image.position))
    whole = np.rint(index)
    step = np.array(image.spacing)[::-1, np.newaxis] * np.array(image.orientation).reshape(2, 3)
    along = geometry.world_to_index(np.array(image.position) + step * (np.array(image.shape)[::-1, np.newaxis] - 1))
    expected = whole + np.array([[1, 0, 0], [0, 1, 0]]) * (np.array(image.shape)[::-1, np.newaxis] - 1)
    off = max(np.abs(index - whole).max(), np.abs(along - expected).max())
    return (int(whole[0]), int(whole[1]), int(whole[2])) if off <= TOLERANCE else None


def _described(
    series: ImageSeries, places: list[tuple[Slice, tuple[int, int, int]]], geometry: Geometry
) -> SourceSeries:
    headers: dict[Path, Any] = {}
    with quiet_pydicom():
        for image, _ in places:
            if image.path not in headers:
                try:
                    header = pydicom.dcmread(image.path, stop_before_pixels=True, specific_tags=list(_TAGS), force=True)
                    headers[image.path] = {tag: str(header.get(tag, "") or "") for tag in _TAGS}
                except Exception:  # pydicom raises errors of every kind on damaged files
                    raise ScanError("a file is cut short or damaged: copy the series again", place=PLACE) from None
    shared = {(one["StudyInstanceUID"], one["FrameOfReferenceUID"]) for one in headers.values()}
    study, frame_of_reference = shared.pop()
    if shared or not study or not frame_of_reference:
        raise ScanError(
            "the images do not share one study and one frame of reference: export without --scan", place=PLACE
        )
    images = [
        SourceImage(
            headers[image.path]["SOPClassUID"],
            headers[image.path]["SOPInstanceUID"],
            None if image.frame is None else image.frame + 1,
            place[2],
        )
        for image, place in places
        if 0 <= place[2] < geometry.size[2]
    ]
    first = min((place for _, place in places), key=lambda place: place[2])
    return SourceSeries(
        study_uid=study,
        series_uid=series.uid,
        frame_of_reference_uid=frame_of_reference,
        images=tuple(sorted(images, key=lambda one: (one.slice, one.sop_instance_uid, one.frame or 0))),
        offset=(-first[0], -first[1], -first[2]),
    )
