"""Writes DICOM series for the tests, with pydicom, from a volume and the position of each slice."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.sequence import Sequence as DicomSequence
from pydicom.uid import ExplicitVRLittleEndian

CT = "1.2.840.10008.5.1.4.1.1.2"
MR = "1.2.840.10008.5.1.4.1.1.4"
ENHANCED_MR = "1.2.840.10008.5.1.4.1.1.4.1"
AXIAL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
ROOT = "1.2.826.0.1.3680043.8.498."


def header(*, sop_class: str = CT, modality: str = "CT", series: int = 1, instance: int = 1) -> FileDataset:
    """A data set with what every image object has."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = sop_class
    meta.MediaStorageSOPInstanceUID = f"{ROOT}{series}.{instance}"
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    dataset.SOPClassUID = sop_class
    dataset.SOPInstanceUID = meta.MediaStorageSOPInstanceUID
    dataset.SeriesInstanceUID = f"{ROOT}9000{series}"
    dataset.StudyInstanceUID = f"{ROOT}77"
    dataset.SeriesNumber = series
    dataset.InstanceNumber = instance
    dataset.Modality = modality
    return dataset


def put_pixels(dataset: Dataset, stored: np.ndarray) -> None:
    """Store whole grey values of 8, 16 or 32 bits, one frame (rows, columns) or several (frames, rows, columns)."""
    dataset.Rows, dataset.Columns = stored.shape[-2:]
    if stored.ndim == 3:
        dataset.NumberOfFrames = stored.shape[0]
    dataset.SamplesPerPixel = 1
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.BitsAllocated = dataset.BitsStored = 8 * stored.dtype.itemsize
    dataset.HighBit = dataset.BitsStored - 1
    dataset.PixelRepresentation = 1 if stored.dtype.kind == "i" else 0
    dataset.PixelData = stored.tobytes()


def write_series(
    folder: Path,
    volume: np.ndarray,
    positions: np.ndarray,
    *,
    orientation: Sequence[float] = AXIAL,
    pixel_spacing: Sequence[float] = (0.7, 0.7),
    slope: float = 1.0,
    intercept: float = 0.0,
    series: int = 1,
    modality: str = "CT",
    order: Sequence[int] | None = None,
    first_instance: int = 1,
    each: Callable[[FileDataset, int], None] | None = None,
    **tags: Any,
) -> list[Path]:
    """Write one file per slice; file names are in ``order``, so that they tell nothing about the place.

    ``each`` changes a data set, given the number of its slice, before it is saved.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, index in enumerate(order if order is not None else range(len(volume))):
        dataset = header(
            sop_class=CT if modality == "CT" else MR,
            modality=modality,
            series=series,
            instance=int(index) + first_instance,
        )
        dataset.ImagePositionPatient = [repr_ds(v) for v in positions[index]]
        dataset.ImageOrientationPatient = [repr_ds(v) for v in orientation]
        dataset.PixelSpacing = [repr_ds(v) for v in pixel_spacing]
        dataset.RescaleSlope, dataset.RescaleIntercept = slope, intercept
        put_pixels(dataset, volume[index])
        for keyword, value in tags.items():
            setattr(dataset, keyword, value)
        if each is not None:
            each(dataset, int(index))
        path = folder / f"s{series}_{name + first_instance - 1:04d}"
        dataset.save_as(path, enforce_file_format=True)
        paths.append(path)
    return paths


def repr_ds(value: float) -> str:
    """A decimal string of at most 16 characters, as the standard asks."""
    for digits in range(15, 0, -1):
        text = f"{value:.{digits}g}"
        if len(text) <= 16:
            return text
    raise ValueError(value)


def write_enhanced(
    path: Path,
    volume: np.ndarray,
    positions: np.ndarray,
    *,
    orientation: Sequence[float],
    spacing: Sequence[float],
    sop_class: str = ENHANCED_MR,
    modality: str = "MR",
    series: int = 1,
    instance: int = 1,
    frames: Callable[[Dataset, int], None] | None = None,
    whole: Callable[[FileDataset], None] | None = None,
) -> None:
    """Write an enhanced multi-frame file with a plane position per frame and the rest shared.

    ``frames`` adds functional groups to a frame, given its number; ``whole`` changes the data set before it is saved.
    """
    dataset = header(sop_class=sop_class, modality=modality, series=series, instance=instance)
    put_pixels(dataset, volume)
    shared = Dataset()
    shared.PixelMeasuresSequence = items(PixelSpacing=list(spacing))
    shared.PlaneOrientationSequence = items(ImageOrientationPatient=[repr_ds(v) for v in orientation])
    shared.PixelValueTransformationSequence = items(RescaleSlope=2.0, RescaleIntercept=3.0)
    dataset.SharedFunctionalGroupsSequence = DicomSequence([shared])
    per_frame = []
    for number, position in enumerate(positions):
        frame = Dataset()
        frame.PlanePositionSequence = items(ImagePositionPatient=[repr_ds(v) for v in position])
        if frames is not None:
            frames(frame, number)
        per_frame.append(frame)
    dataset.PerFrameFunctionalGroupsSequence = DicomSequence(per_frame)
    if whole is not None:
        whole(dataset)
    path.parent.mkdir(parents=True, exist_ok=True)
    dataset.save_as(path, enforce_file_format=True)


def items(**tags: Any) -> DicomSequence:
    """A sequence of one item with these tags."""
    item = Dataset()
    for keyword, value in tags.items():
        setattr(item, keyword, value)
    return DicomSequence([item])
