"""The headers of DICOM files: which series there are, and what their images say about themselves.

Only the tags listed here are read. Of what they hold, geometry, modality and acquisition physics go on as numbers;
the UID of a series serves to tell series apart and to choose one.
"""

from __future__ import annotations

import logging
import os
import warnings
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pydicom

from heartcase.pipeline.formats.raw_volume import require_file
from heartcase.pipeline.formats.stack import Slice
from heartcase.schemas.errors import ScanError

__all__ = ["ImageSeries", "find_series", "is_dicom", "quiet_pydicom"]

MODALITIES = ("CT", "MR")
NOT_SCANS = ("SEG", "RTDOSE", "RTSTRUCT", "RTPLAN", "PR", "SR", "KO", "REG", "RWV", "DOC")
IMAGE_CLASSES = (
    "1.2.840.10008.5.1.4.1.1.2",
    "1.2.840.10008.5.1.4.1.1.2.1",
    "1.2.840.10008.5.1.4.1.1.2.2",
    "1.2.840.10008.5.1.4.1.1.4",
    "1.2.840.10008.5.1.4.1.1.4.1",
    "1.2.840.10008.5.1.4.1.1.4.4",
)
"""CT and MR image storage, plain, enhanced and legacy converted: such an object must hold an image."""

PHYSICS: dict[str, tuple[str, float, float]] = {
    "MagneticFieldStrength": ("magnetic_field_strength_t", 0.0, 30.0),
    "EchoTime": ("echo_time_ms", 0.0, 1000.0),
    "RepetitionTime": ("repetition_time_ms", 0.0, 100_000.0),
    "InversionTime": ("inversion_time_ms", 0.0, 100_000.0),
    "FlipAngle": ("flip_angle_deg", 0.0, 360.0),
    "KVP": ("tube_voltage_kv", 0.0, 300.0),
    "SliceThickness": ("slice_thickness_mm", 0.0, 100.0),
}
"""Tag -> name of what is kept, and the range outside which the tag holds something else and is dropped."""

HEADER_TAGS = [
    *("SOPClassUID", "SeriesInstanceUID", "SeriesNumber", "Modality", "NumberOfFrames", "Rows", "Columns"),
    *("SamplesPerPixel", "PhotometricInterpretation", "ImagePositionPatient", "ImageOrientationPatient"),
    *("PixelSpacing", "RescaleSlope", "RescaleIntercept", "SharedFunctionalGroupsSequence"),
    *("PerFrameFunctionalGroupsSequence", *PHYSICS),
]
FILE_LIMIT = 100_000


@dataclass(frozen=True)
class ImageSeries:
    """The images of one series UID."""

    uid: str
    """Its UID: only the end of it may be shown."""
    modality: str
    """``CT``, ``MR`` or ``unknown``."""
    slices: tuple[Slice, ...]
    """Its images in any order."""
    acquisition: dict[str, float]
    """Physics of the acquisition, as far as all images agree; see :data:`PHYSICS`."""


def is_dicom(path: Path) -> bool:
    """Whether this is a file that starts as DICOM files do."""
    try:
        require_file(path)
        return _starts_as_dicom(path) is not None
    except (ScanError, OSError):
        return False


@contextmanager
def quiet_pydicom() -> Iterator[None]:
    """Keep pydicom's warnings, which quote the tags that they complain about, from being shown or logged."""
    logger = logging.getLogger("pydicom")
    was_disabled = logger.disabled
    logger.disabled = True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = was_disabled


def _starts_as_dicom(path: Path) -> bool | None:
    """True with the DICOM preamble, False for a bare data set, None for anything else."""
    with path.open("rb") as file:
        start = file.read(132)
    if start[128:] == b"DICM":
        return True
    return False if start[:2] in (b"\x08\x00", b"\x02\x00") and len(start) == 132 else None


def _files(path: Path) -> list[Path]:
    """Regular files of a folder and its subfolders in a fixed order; links to folders are not followed."""
    if not path.is_dir():
        require_file(path)
        return [path]
    found = []
    for directory, folders, names in os.walk(path):
        folders.sort()
        found += [Path(directory) / name for name in sorted(names)]
        if len(found) > FILE_LIMIT:
            raise ScanError(f"there are more than {FILE_LIMIT} files in this folder: give the folder of the scan alone")
    return [file for file in found if file.is_file()]


def find_series(path: Path) -> tuple[ImageSeries, ...]:
    """Read the headers of all files and sort the images into series.

    Parameters
    ----------
    path
        Folder, searched with its subfolders, or one file.

    Returns
    -------
    tuple of ImageSeries
        One or more, by series number, then UID. Objects that are not scans are left out: reports, segmentations,
        dose, screenshots without a position.

    Raises
    ------
    ScanError
        There is no image, or a file is damaged.
    """
    groups: dict[str, list[tuple[Any, Path]]] = defaultdict(list)
    damaged = 0
    with quiet_pydicom():
        for file in _files(path):
            try:
                preamble = _starts_as_dicom(file)
                if preamble is None:
                    looks_like_slice = file.suffix.lower() in (".dcm", ".dicom", ".ima")
                    damaged += looks_like_slice
                    continue
                header = pydicom.dcmread(
                    file, stop_before_pixels=True, specific_tags=list(HEADER_TAGS), force=not preamble
                )
            except Exception:  # pydicom raises errors of every kind on damaged files
                damaged += 1
                continue
            size = _numbers(header, "Rows", 1), _numbers(header, "Columns", 1)
            modality = _text(header, "Modality")
            if None in size or modality in NOT_SCANS:
                damaged += modality not in NOT_SCANS and _text(header, "SOPClassUID") in IMAGE_CLASSES
                continue
            groups[_text(header, "SeriesInstanceUID")].append((header, file))
        if damaged:
            raise ScanError(
                f"{damaged} DICOM file{'s are' if damaged > 1 else ' is'} cut short or damaged: copy the series from "
                "the scanner or archive again"
            )
        order = {uid: _numbers(members[0][0], "SeriesNumber", 1) or (np.inf,) for uid, members in groups.items()}
        every = [_series(uid, groups[uid]) for uid in sorted(groups, key=lambda uid: (*order[uid], uid))]
    found = [series for series in every if any(image.position is not None for image in series.slices)]
    if not found and every:
        found = every
    if not found:
        raise ScanError("there is no DICOM image here: give the folder that holds the slices, or the scan's image file")
    return tuple(found)


def _series(uid: str, members: list[tuple[Any, Path]]) -> ImageSeries:
    slices: list[Slice] = []
    for header, file in members:
        slices += _slices(header, file)
    modalities = {_text(header, "Modality") for header, _ in members}
    modality = modalities.pop() if len(modalities) == 1 else ""
    acquisition = {}
    for keyword, (name, low, high) in PHYSICS.items():
        found = {_numbers(header, keyword, 1) for header, _ in members}
        value = found.pop() if len(found) == 1 else None
        if value is not None and low < value[0] <= high:
            acquisition[name] = value[0]
    return ImageSeries(uid, modality if modality in MODALITIES else "unknown", tuple(slices), acquisition)


def _slices(header: Any, file: Path) -> list[Slice]:
    """One slice for a plain file, one for each frame of a multi-frame file."""
    frames = _sequence(header, "PerFrameFunctionalGroupsSequence")
    shared = (_sequence(header, "SharedFunctionalGroupsSequence") or [None])[0]
    frame_count = int((_numbers(header, "NumberOfFrames", 1) or (1.0,))[0])
    rows, columns = (int((_numbers(header, keyword, 1) or (0.0,))[0]) for keyword in ("Rows", "Columns"))
    samples = int((_numbers(header, "SamplesPerPixel", 1) or (1.0,))[0])
    is_grey = samples == 1 and _text(header, "PhotometricInterpretation") in ("MONOCHROME1", "MONOCHROME2")

    def find(group: str, keyword: str, count: int, frame: Any) -> tuple[float, ...] | None:
        for place in (frame, shared):
            inner = _sequence(place, group)
            if inner and (found := _numbers(inner[0], keyword, count)) is not None:
                return found
        return _numbers(header, keyword, count)

    per_frame: list[Any] = list(frames) if frames else [None]
    slices = []
    for index, frame in enumerate(per_frame):
        placed = frame is not None or frame_count == 1
        slices.append(
            Slice(
                path=file,
                frame=index if frame is not None else None,
                shape=(rows, columns),
                is_grey=is_grey,
                position=find("PlanePositionSequence", "ImagePositionPatient", 3, frame) if placed else None,
                orientation=find("PlaneOrientationSequence", "ImageOrientationPatient", 6, frame),
                spacing=find("PixelMeasuresSequence", "PixelSpacing", 2, frame),
                slope=(find("PixelValueTransformationSequence", "RescaleSlope", 1, frame) or (1.0,))[0],
                intercept=(find("PixelValueTransformationSequence", "RescaleIntercept", 1, frame) or (0.0,))[0],
            )
        )
    return slices


def _sequence(holder: Any, keyword: str) -> Any:
    if holder is None:
        return None
    try:
        return holder.get(keyword)
    except Exception:  # as above
        return None


def _text(header: Any, keyword: str) -> str:
    try:
        value = header.get(keyword)
        return value.strip() if isinstance(value, str) else ""
    except Exception:  # as above
        return ""


def _numbers(header: Any, keyword: str, count: int) -> tuple[float, ...] | None:
    """The numbers of a tag; None where it is missing, has another count, or holds anything else."""
    try:
        value = header.get(keyword)
        if value is None or isinstance(value, str):
            return None
        numbers = tuple(float(part) for part in (value if count > 1 else [value]))
    except Exception:  # as above
        return None
    return numbers if len(numbers) == count and bool(np.isfinite(numbers).all()) else None
