"""The headers of DICOM files: which series there are, and what their images say about themselves.

Only the tags listed here are read. Of what they hold, geometry, modality and acquisition physics go on as numbers;
UIDs and words serve to tell series and images apart, and go into no message.
"""

from __future__ import annotations

import dataclasses
import os
import stat
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence

from heartcase.pipeline.formats.dicom.archive import FILE_LIMIT, SourceFile, archived_files, is_archive
from heartcase.pipeline.formats.dicom.stack import Rescale, Slice
from heartcase.pipeline.formats.dicom.tags import (
    Header,
    decimals_of,
    has_preamble,
    numbers_of,
    quiet_pydicom,
    read_header,
    seconds_of,
    sequence_of,
    text_of,
    values_of,
    words_of,
)
from heartcase.pipeline.formats.dicom.whole import is_other_object
from heartcase.pipeline.formats.volumes.raw_volume import require_file
from heartcase.schemas.errors import ScanError

__all__ = ["ImageSeries", "find_series", "is_dicom", "quiet_pydicom"]

MODALITIES = ("CT", "MR")
OTHER_MODALITIES = ("PT", "NM", "US", "IVUS", "OCT", "XA", "RF", "CR", "DX", "MG", "ES", "OP")
"""Images that this reader does not take, by their defined terms (PS3.3 C.7.3.1.1.1)."""
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

TIMING = "MRTimingAndRelatedParametersSequence"
CARDIAC = "CardiacSynchronizationSequence"
CONTENT = "FrameContentSequence"

PHYSICS: dict[str, tuple[str, str, float, float]] = {
    "magnetic_field_strength_t": ("", "MagneticFieldStrength", 0.0, 30.0),
    "repetition_time_ms": (TIMING, "RepetitionTime", 0.0, 100_000.0),
    "inversion_time_ms": ("", "InversionTime", 0.0, 100_000.0),
    "flip_angle_deg": (TIMING, "FlipAngle", 0.0, 360.0),
    "tube_voltage_kv": ("CTXRayDetailsSequence", "KVP", 0.0, 300.0),
    "slice_thickness_mm": ("PixelMeasuresSequence", "SliceThickness", 0.0, 100.0),
}
"""Name of what is kept -> functional group, tag, and the range outside which the tag holds something else."""

TRAITS: dict[str, tuple[tuple[tuple[str, str], ...], float, float]] = {
    "echo_time_ms": ((("MREchoSequence", "EffectiveEchoTime"), ("", "EchoTime")), 1e-6, 1000.0),
    "b_value": ((("MRDiffusionSequence", "DiffusionBValue"), ("", "DiffusionBValue")), 0.0, 100_000.0),
    "inversion_time_ms": ((("", "InversionTime"),), 1e-6, 100_000.0),
    "tube_voltage_kv": ((("CTXRayDetailsSequence", "KVP"), ("", "KVP")), 1e-6, 300.0),
    "trigger_time_ms": (
        ((CARDIAC, "NominalCardiacTriggerDelayTime"), (CARDIAC, "ActualCardiacTriggerDelayTime"), ("", "TriggerTime")),
        0.0,
        100_000.0,
    ),
    "cardiac_phase_percent": (
        ((CARDIAC, "NominalPercentageOfCardiacPhase"), ("", "NominalPercentageOfCardiacPhase")),
        0.0,
        100.0,
    ),
    "temporal_position": (((CONTENT, "TemporalPositionIndex"), ("", "TemporalPositionIdentifier")), 0.0, 1e5),
    "acquisition_number": (((CONTENT, "FrameAcquisitionNumber"), ("", "AcquisitionNumber")), 0.0, 1e5),
}
"""Name of a number that may tell images at one position apart -> functional groups and tags to look in, and the range
outside which a tag holds something else."""

HEADER_TAGS = [
    *("SOPClassUID", "SOPInstanceUID", "SeriesInstanceUID", "SeriesNumber", "Modality", "NumberOfFrames", "Rows"),
    *("Columns", "SamplesPerPixel", "PhotometricInterpretation", "ImagePositionPatient", "ImageOrientationPatient"),
    *("PixelSpacing", "RescaleSlope", "RescaleIntercept", "SharedFunctionalGroupsSequence"),
    *("PerFrameFunctionalGroupsSequence", "ImageType", "SequenceName", "ConvolutionKernel", "ModalityLUTSequence"),
    *("StudyInstanceUID", "FrameOfReferenceUID", "AcquisitionTime"),
    *(keyword for group, keyword, _, _ in PHYSICS.values()),
    *(keyword for places, _, _ in TRAITS.values() for group, keyword in places if not group),
]
SERIES_NUMBER_MAX = 99_999
"""Largest number of a series that is shown; scanners count far below."""
VALUES = "PixelValueTransformationSequence"
FRAME_TYPES = ("MRImageFrameTypeSequence", "CTImageFrameTypeSequence")
GROUPS = frozenset(
    (
        *("PlanePositionSequence", "PlaneOrientationSequence", "PixelMeasuresSequence", VALUES, CONTENT, *FRAME_TYPES),
        *(group for group, *_ in PHYSICS.values() if group),
        *(group for places, _, _ in TRAITS.values() for group, _ in places if group),
    )
)
"""Functional groups that are read."""
Groups = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class ImageSeries:
    """The images of one series UID."""

    uid: str
    """Its UID: not to be shown."""
    modality: str
    """``CT``, ``MR``, another defined term of :data:`OTHER_MODALITIES`, or ``unknown``."""
    slices: tuple[Slice, ...]
    """Its images in any order, each once."""
    scanner_number: int | None = None
    """SeriesNumber, as the scanner's own list shows it; None where it is not stated or holds something else."""


def is_dicom(path: Path) -> bool:
    """Whether this is a file that starts as DICOM files do."""
    try:
        require_file(path)
        with path.open("rb") as stream:
            return has_preamble(stream) is not None
    except (ScanError, OSError):
        return False


def _files(path: Path) -> list[SourceFile]:
    """Regular files of a folder and its subfolders, or of an archive, in a fixed order; links are not followed."""
    if not path.is_dir():
        require_file(path)
        return archived_files(path) if is_archive(path) else [path]
    found: list[Path] = []
    try:
        for directory, folders, names in os.walk(path, onerror=_refuse_folder):
            folders.sort()
            found += [Path(directory) / name for name in sorted(names)]
            if len(found) > FILE_LIMIT:
                raise ScanError(
                    f"there are more than {FILE_LIMIT} files in this folder: give the folder of the scan alone"
                )
        return [file for file in found if stat.S_ISREG(file.stat().st_mode)]
    except OSError as error:
        _refuse_folder(error)


def _refuse_folder(error: OSError) -> NoReturn:
    raise ScanError(
        "a folder or file in it cannot be opened, so that images may be missing: check that it may be read, and that "
        "no link leads nowhere"
    ) from None


def find_series(path: Path) -> tuple[ImageSeries, ...]:
    """Read the headers of all files and sort the images into series.

    Parameters
    ----------
    path
        Folder, searched with its subfolders; a zip archive of one; or one file.

    Returns
    -------
    tuple of ImageSeries
        One or more, by series number, then UID. Objects that are not scans are left out: reports, segmentations,
        dose, screenshots without a position, a DICOMDIR.

    Raises
    ------
    ScanError
        There is no image, a file is damaged, a folder or file cannot be opened, or copies of an image disagree.
    """
    slices: dict[str, list[Slice]] = defaultdict(list)
    modalities: dict[str, set[str]] = defaultdict(set)
    numbers: dict[str, tuple[float, ...]] = {}
    damaged = 0
    with quiet_pydicom():
        for file in _files(path):
            try:
                head = read_header(file, HEADER_TAGS)
            except Exception:  # pydicom raises errors of every kind on damaged files
                damaged += 1
                continue
            if head is None:
                damaged += file.suffix.lower() in (".dcm", ".dicom", ".ima") and not _is_resource_fork(file)
                continue
            header = head.values
            size = numbers_of(header, "Rows", 1), numbers_of(header, "Columns", 1)
            modality = text_of(header, "Modality")
            if None in size or modality in NOT_SCANS:
                damaged += modality not in NOT_SCANS and not _is_other_object(file, head)
                continue
            found = _slices(header, file)
            damaged += not found
            uid = text_of(header, "SeriesInstanceUID")
            slices[uid] += found
            modalities[uid].add(modality)
            numbers.setdefault(uid, numbers_of(header, "SeriesNumber", 1) or (np.inf,))
    if damaged:
        raise ScanError(
            f"{damaged} DICOM file{'s are' if damaged > 1 else ' is'} cut short or damaged: copy the series from "
            "the scanner or archive again"
        )
    every = [
        ImageSeries(uid, _modality(modalities[uid]), _without_copies(slices[uid]), _shown_number(numbers[uid][0]))
        for uid in sorted(slices, key=lambda uid: (*numbers[uid], uid))
    ]
    placed = [series for series in every if any(image.position is not None for image in series.slices)]
    if not every:
        raise ScanError("there is no DICOM image here: give the folder that holds the slices, or the scan's image file")
    return tuple(placed or every)


def _shown_number(number: float) -> int | None:
    """A series number that may be shown: a longer one may be anything, such as a patient's number."""
    return int(number) if 0 <= number <= SERIES_NUMBER_MAX else None


def _is_resource_fork(file: SourceFile) -> bool:
    """Whether this is what macOS puts beside a file, under its name (RFC 1740, AppleDouble)."""
    try:
        with file.open("rb") as stream:
            return stream.read(4) == b"\x00\x05\x16\x07"
    except OSError:
        return False


def _is_other_object(file: SourceFile, head: Header) -> bool:
    """Whether a file without rows and columns may be passed over."""
    if not head.has_preamble:
        return text_of(head.values, "SOPClassUID") not in IMAGE_CLASSES
    try:
        with file.open("rb") as stream:
            return is_other_object(stream, head.values, media_class=head.media_class)
    except OSError:
        return False


def _modality(found: set[str]) -> str:
    modality = next(iter(found)) if len(found) == 1 else ""
    return modality if modality in (*MODALITIES, *OTHER_MODALITIES) else "unknown"


def _without_copies(slices: list[Slice]) -> tuple[Slice, ...]:
    """Each image once, in the order of the files; the other files that claim to be it go along."""
    first: dict[tuple[Any, ...], int] = {}
    kept: list[Slice] = []
    contradicted: set[int] = set()
    for image in slices:
        identity = (image.uid, image.frame, image.shape, image.position, image.orientation, image.spacing)
        number = first.setdefault(identity, len(kept)) if image.uid else len(kept)
        if number == len(kept):
            kept.append(image)
        else:
            contradicted |= {number} if _statements(kept[number]) != _statements(image) else set()
            kept[number] = dataclasses.replace(kept[number], copies=(*kept[number].copies, image.path))
    if contradicted:
        several = len(contradicted) > 1
        raise ScanError(
            f"{len(contradicted)} image{'s are' if several else ' is'} there more than once, and the copies state "
            "different rescales, kinds or times: remove the files that are wrong"
        )
    return tuple(kept)


def _statements(image: Slice) -> tuple[Any, ...]:
    return image.slope, image.intercept, image.rescale, image.coordinates, image.traits


def _slices(header: Any, file: SourceFile) -> list[Slice]:
    """One slice for a plain file, one for each frame of a multi-frame file; none where the frames do not add up."""
    frames = sequence_of(header, "PerFrameFunctionalGroupsSequence")
    shared = _functional_groups((sequence_of(header, "SharedFunctionalGroupsSequence") or [None])[0])
    frame_count = int((numbers_of(header, "NumberOfFrames", 1) or (1.0,))[0])
    if frames and len(frames) != frame_count:
        return []
    rows, columns = (int((numbers_of(header, keyword, 1) or (0.0,))[0]) for keyword in ("Rows", "Columns"))
    samples = int((numbers_of(header, "SamplesPerPixel", 1) or (1.0,))[0])
    is_grey = samples == 1 and text_of(header, "PhotometricInterpretation") in ("MONOCHROME1", "MONOCHROME2")
    uid = text_of(header, "SOPInstanceUID")
    image_type = words_of(header, "ImageType")
    sequence = "/".join((*words_of(header, "SequenceName"), *words_of(header, "ConvolutionKernel")))
    coordinates = "/".join(text_of(header, keyword) for keyword in ("StudyInstanceUID", "FrameOfReferenceUID"))

    acquired_s = seconds_of(header, "AcquisitionTime") if frames is None else None

    per_frame: list[Any] = list(frames) if frames else [None]
    slices = []
    for index, frame in enumerate(per_frame):
        groups = (_functional_groups(frame), shared, header)
        placed = frame is not None or frame_count == 1
        traits: dict[str, float | str] = {}
        for name, (places, low, high) in TRAITS.items():
            for group, keyword in places:
                found = _find(groups, group, keyword, 1)
                if found is not None and low <= found[0] <= high:
                    traits[name] = found[0]
                    break
        kind = _frame_type(groups) or image_type
        texts = {"image_kind": "/".join(kind), "sequence": sequence, "stack_id": _stack_id(groups)}
        traits |= {name: text for name, text in texts.items() if text}
        rescale, slope, intercept = _rescale(groups, is_plain=frame is None)
        physics = {}
        for name, (group, keyword, low, high) in PHYSICS.items():
            found = _find(groups, group, keyword, 1)
            if found is not None and low < found[0] <= high:
                physics[name] = found[0]
        slices.append(
            Slice(
                path=file,
                frame=index if frame is not None else None,
                shape=(rows, columns),
                is_grey=is_grey,
                position=_find(groups, "PlanePositionSequence", "ImagePositionPatient", 3) if placed else None,
                orientation=_find(groups, "PlaneOrientationSequence", "ImageOrientationPatient", 6),
                spacing=_find(groups, "PixelMeasuresSequence", "PixelSpacing", 2),
                slope=slope,
                intercept=intercept,
                traits=traits,
                physics=physics,
                is_localizer="LOCALIZER" in kind,
                uid=uid,
                rescale=rescale,
                position_decimals=_decimals(groups, "PlanePositionSequence", "ImagePositionPatient"),
                orientation_decimals=max(
                    _decimals(groups, "PlaneOrientationSequence", "ImageOrientationPatient"), default=None
                ),
                acquired_s=acquired_s,
                coordinates=coordinates,
            )
        )
    return slices


def _functional_groups(item: Any) -> Groups:
    """The functional groups of a frame, or those that all frames share: sequence -> its one item's values."""
    groups: Groups = {}
    for keyword, value in (values_of(item, GROUPS) if isinstance(item, Dataset) else {}).items():
        if isinstance(value, Sequence) and len(value) > 0:
            groups[keyword] = values_of(value[0])
    return groups


def _find(groups: tuple[Groups, Groups, Any], group: str, keyword: str, count: int) -> tuple[float, ...] | None:
    """A tag of a functional group: the frame's, the one that all frames share, or the plain tag of the header."""
    for place in groups[:2] if group else ():
        if group in place and (found := numbers_of(place[group], keyword, count)) is not None:
            return found
    return numbers_of(groups[2], keyword, count)


def _decimals(groups: tuple[Groups, Groups, Any], group: str, keyword: str) -> tuple[int, ...]:
    """In how many decimals the numbers are written that :func:`_find` finds."""
    for place in (groups[0].get(group, {}), groups[1].get(group, {}), groups[2]):
        if keyword in place:
            return decimals_of(place, keyword)
    return ()


def _rescale(groups: tuple[Groups, Groups, Any], *, is_plain: bool) -> tuple[Rescale, float, float]:
    """What is stated of the rescale, with slope and intercept; the first place that states any of it counts."""
    table = groups[2].get("ModalityLUTSequence", ()) if is_plain else ()
    if table is None or len(table) > 0:
        return "unreadable" if table is None else "table", 1.0, 0.0
    for place in (groups[0].get(VALUES, {}), groups[1].get(VALUES, {}), groups[2]):
        if "RescaleSlope" in place or "RescaleIntercept" in place:
            slope, intercept = (numbers_of(place, keyword, 1) for keyword in ("RescaleSlope", "RescaleIntercept"))
            if slope is None or intercept is None:
                return "unreadable", 1.0, 0.0
            return "stated", slope[0], intercept[0]
    return "unstated", 1.0, 0.0


def _frame_type(groups: tuple[Groups, Groups, Any]) -> tuple[str, ...]:
    for place in groups[:2]:
        for group in FRAME_TYPES:
            if group in place:
                return (*words_of(place[group], "FrameType"), *words_of(place[group], "ComplexImageComponent"))
    return ()


def _stack_id(groups: tuple[Groups, Groups, Any]) -> str:
    return next((text for place in groups[:2] if (text := text_of(place.get(CONTENT, {}), "StackID"))), "")
