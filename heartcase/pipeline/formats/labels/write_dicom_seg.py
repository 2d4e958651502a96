"""Write a DICOM segmentation object (SEG), binary, as DICOM PS3.3 A.51 asks.

Nothing of the scan's header goes in but, when the source series is given, the identifiers by which a viewer lays the
segmentation over its images. Patient name and number are the made-up identifier of the case. All other identifiers
are hashes of the content, and the date is fixed: the same labels give the same bytes.
"""

from __future__ import annotations

import hashlib
import io
import uuid

import numpy as np
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.sequence import Sequence as Items
from pydicom.tag import Tag
from pydicom.uid import ExplicitVRLittleEndian, SegmentationStorage
from pydicom.valuerep import format_number_as_ds

from heartcase import __version__
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.formats.dicom.source import SourceImage, SourceSeries
from heartcase.schemas.arrays import UInt8
from heartcase.schemas.errors import UsageError
from heartcase.schemas.labels import BACKGROUND, Label

__all__ = ["dicom_seg_bytes"]

FIXED_DATE, FIXED_TIME = "20000101", "000000"
"""The standard demands a date; a true one would tell when the patient's case was made."""
PRIVATE_SCHEME = "99HEARTCASE"
"""Designator of the codes of structures for which SNOMED CT has none (PS3.16 section 8: private ones start with 99)."""


def dicom_seg_bytes(segmentation: Segmentation, *, case_id: str, source: SourceSeries | None = None) -> bytes:
    """Content of a DICOM SEG file.

    Parameters
    ----------
    segmentation
        Labels, geometry and table; each label that has a voxel becomes a segment, in the order of the values.
    case_id
        Made-up identifier of the case: takes the place of the patient's name and number.
    source
        The series that the labels lie on; None makes a study of its own.

    Raises
    ------
    UsageError
        There is no voxel with a label.
    """
    present = np.bincount(segmentation.labels.ravel(), minlength=256) > 0
    labels = [label for label in segmentation.table if label.value != BACKGROUND and present[label.value]]
    if not labels:
        raise UsageError("no voxel of the case has a label, so there is nothing to export", place="case")
    content = _content_hash(segmentation, case_id, source)
    shown = _frames_shown(segmentation.labels, labels)
    dataset = _header(case_id, content, source)
    dataset.SegmentSequence = Items(_segment(number, label) for number, label in enumerate(labels, start=1))
    _describe_frames(dataset, segmentation, shown, content, source)
    bits = np.stack([segmentation.labels[k] == labels[number - 1].value for number, k in shown])
    packed = np.packbits(bits.ravel(), bitorder="little").tobytes()
    dataset.PixelData = packed + b"\0" * (len(packed) % 2)
    dataset["PixelData"].VR = "OB"
    buffer = io.BytesIO()
    dataset.save_as(buffer, enforce_file_format=True)
    return buffer.getvalue()


def _content_hash(segmentation: Segmentation, case_id: str, source: SourceSeries | None) -> bytes:
    digest = hashlib.sha256()
    for part in (case_id, segmentation.geometry.model_dump_json(), segmentation.table.model_dump_json(), repr(source)):
        digest.update(part.encode() + b"\0")
    digest.update(np.ascontiguousarray(segmentation.labels).tobytes())
    return digest.digest()


def _uid(content: bytes, what: str) -> str:
    """Identifier made from a hash (PS3.5 B.2: a UUID as one number under 2.25)."""
    digest = hashlib.sha256(content + what.encode()).digest()
    return f"2.25.{uuid.UUID(bytes=digest[:16], version=5).int}"


def _frames_shown(labels: UInt8, wanted: list[Label]) -> list[tuple[int, int]]:
    """Segment number and slice of each frame.

    Slices without the label are left out, but for the first and the last slice of the volume, which come with the
    first segment in any case, so that a reader gets the whole lattice back.
    """
    shown = []
    for number, label in enumerate(wanted, start=1):
        has = (labels == label.value).any(axis=(1, 2))
        if number == 1:
            has[[0, -1]] = True
        shown += [(number, int(k)) for k in np.flatnonzero(has)]
    return shown


def _header(case_id: str, content: bytes, source: SourceSeries | None) -> FileDataset:
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = SegmentationStorage
    meta.MediaStorageSOPInstanceUID = _uid(content, "instance")
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    dataset.SOPClassUID, dataset.SOPInstanceUID = SegmentationStorage, meta.MediaStorageSOPInstanceUID
    dataset.PatientName = dataset.PatientID = case_id
    for empty in (
        *("PatientBirthDate", "PatientSex", "StudyDate", "StudyTime", "StudyID", "AccessionNumber"),
        *("ReferringPhysicianName", "PositionReferenceIndicator", "ContentDescription", "ContentCreatorName"),
    ):
        setattr(dataset, empty, "")
    dataset.StudyInstanceUID = source.study_uid if source else _uid(content, "study")
    dataset.FrameOfReferenceUID = source.frame_of_reference_uid if source else _uid(content, "frame of reference")
    dataset.SeriesInstanceUID = _uid(content, "series")
    dataset.Modality, dataset.SeriesNumber, dataset.InstanceNumber = "SEG", 1, 1
    dataset.SeriesDescription = "heartcase labels"
    dataset.Manufacturer = dataset.ManufacturerModelName = "heartcase"
    dataset.DeviceSerialNumber, dataset.SoftwareVersions = "0", __version__
    dataset.ContentDate, dataset.ContentTime, dataset.ContentLabel = FIXED_DATE, FIXED_TIME, "LABELS"
    dataset.ImageType = ["DERIVED", "PRIMARY"]
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
    dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 1, 1, 0, 0
    dataset.LossyImageCompression = "00"
    dataset.SegmentationType, dataset.SegmentsOverlap = "BINARY", "NO"
    if source:
        series = _item(SeriesInstanceUID=source.series_uid)
        unique = {(image.sop_class_uid, image.sop_instance_uid) for image in source.images}
        series.ReferencedInstanceSequence = Items(
            _item(ReferencedSOPClassUID=kind, ReferencedSOPInstanceUID=uid) for kind, uid in sorted(unique)
        )
        dataset.ReferencedSeriesSequence = Items([series])
    return dataset


def _segment(number: int, label: Label) -> Dataset:
    item = _item(SegmentNumber=number, SegmentLabel=label.name)
    item.SegmentAlgorithmType, item.SegmentAlgorithmName = "SEMIAUTOMATIC", "heartcase"
    item.SegmentedPropertyCategoryCodeSequence = Items([_code("91723000", "SCT", "Anatomical Structure")])
    term = label.term
    if label.snomed is None:
        kind = _code(f"label-{label.value}", PRIVATE_SCHEME, label.name)
    else:
        kind = _code(label.snomed, "SCT", term.meaning if term and term.code == label.snomed else label.name)
    item.SegmentedPropertyTypeCodeSequence = Items([kind])
    item.RecommendedDisplayCIELabValue = _cielab(label.colour)
    return item


def _describe_frames(
    dataset: Dataset,
    segmentation: Segmentation,
    shown: list[tuple[int, int]],
    content: bytes,
    source: SourceSeries | None,
) -> None:
    """Size, lattice, and what each frame shows."""
    geometry = segmentation.geometry
    dataset.Columns, dataset.Rows, _ = geometry.size
    dataset.NumberOfFrames = len(shown)
    organisation = _uid(content, "dimensions")
    dataset.DimensionOrganizationSequence = Items([_item(DimensionOrganizationUID=organisation)])
    dataset.DimensionIndexSequence = Items(
        _item(
            DimensionOrganizationUID=organisation,
            DimensionIndexPointer=Tag(pointer),
            FunctionalGroupPointer=Tag(group),
            DimensionDescriptionLabel=pointer,
        )
        for pointer, group in (
            ("ReferencedSegmentNumber", "SegmentIdentificationSequence"),
            ("ImagePositionPatient", "PlanePositionSequence"),
        )
    )
    across, down, between = geometry.spacing_mm
    measures = _item(PixelSpacing=_ds(down, across), SliceThickness=_ds(between)[0])
    measures.SpacingBetweenSlices = _ds(between)[0]
    plane = _item(ImageOrientationPatient=_ds(*geometry.direction_matrix[:, :2].T.ravel()))
    dataset.SharedFunctionalGroupsSequence = Items(
        [_item(PixelMeasuresSequence=Items([measures]), PlaneOrientationSequence=Items([plane]))]
    )
    by_slice: dict[int, list[SourceImage]] = {}
    for image in source.images if source else ():
        by_slice.setdefault(image.slice, []).append(image)
    frames = []
    for number, k in shown:
        frame = _item(
            FrameContentSequence=Items([_item(DimensionIndexValues=[number, k + 1])]),
            PlanePositionSequence=Items([_item(ImagePositionPatient=_ds(*geometry.index_to_world((0, 0, k))))]),
            SegmentIdentificationSequence=Items([_item(ReferencedSegmentNumber=number)]),
        )
        if k in by_slice:
            frame.DerivationImageSequence = Items([_derivation(by_slice[k])])
        frames.append(frame)
    dataset.PerFrameFunctionalGroupsSequence = Items(frames)


def _derivation(images: list[SourceImage]) -> Dataset:
    sources = []
    for image in images:
        item = _item(ReferencedSOPClassUID=image.sop_class_uid, ReferencedSOPInstanceUID=image.sop_instance_uid)
        if image.frame is not None:
            item.ReferencedFrameNumber = image.frame
        item.SpatialLocationsPreserved = "YES"
        item.PurposeOfReferenceCodeSequence = Items(
            [_code("121322", "DCM", "Source image for image processing operation")]
        )
        sources.append(item)
    return _item(
        SourceImageSequence=Items(sources), DerivationCodeSequence=Items([_code("113076", "DCM", "Segmentation")])
    )


def _item(**values: object) -> Dataset:
    item = Dataset()
    for keyword, value in values.items():
        setattr(item, keyword, value)
    return item


def _code(value: str, scheme: str, meaning: str) -> Dataset:
    return _item(CodeValue=value, CodingSchemeDesignator=scheme, CodeMeaning=meaning[:64])


def _ds(*numbers: float) -> list[str]:
    """Decimal strings of 16 characters at most, the longest that the standard has."""
    return [format_number_as_ds(float(number) + 0.0) for number in numbers]


def _cielab(colour: str) -> list[int]:
    """A colour as DICOM's CIELab (PS3.3 C.10.7.1.1): sRGB (IEC 61966-2-1), white point D50 by Bradford adaptation."""
    encoded = np.array([int(colour[at : at + 2], 16) / 255.0 for at in (1, 3, 5)])
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array(
        [[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169], [0.0139322, 0.0971045, 0.7141733]]
    )
    ratio = to_xyz @ linear / np.array([0.96422, 1.0, 0.82521])
    bent = np.where(ratio > 216.0 / 24389.0, np.cbrt(ratio), (24389.0 / 27.0 * ratio + 16.0) / 116.0)
    lightness = 116.0 * bent[1] - 16.0
    a, b = 500.0 * (bent[0] - bent[1]), 200.0 * (bent[1] - bent[2])
    scaled = np.array([lightness * 65535.0 / 100.0, (a + 128.0) * 65535.0 / 255.0, (b + 128.0) * 65535.0 / 255.0])
    return [round(float(value)) for value in np.clip(scaled, 0.0, 65535.0)]
