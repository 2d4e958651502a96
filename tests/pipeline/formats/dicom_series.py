"""Writes DICOM series for the tests, with pydicom, from a volume and the position of each slice."""

from __future__ import annotations

from collections.abc import Sequence
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
    """Store int16 or uint16 grey values, one frame (rows, columns) or several (frames, rows, columns)."""
    dataset.Rows, dataset.Columns = stored.shape[-2:]
    if stored.ndim == 3:
        dataset.NumberOfFrames = stored.shape[0]
    dataset.SamplesPerPixel = 1
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.BitsAllocated = dataset.BitsStored = 16
    dataset.HighBit = 15
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
    **tags: Any,
) -> list[Path]:
    """Write one file per slice; file names are in ``order``, so that they tell nothing about the place."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, index in enumerate(order if order is not None else range(len(volume))):
        dataset = header(
            sop_class=CT if modality == "CT" else MR, modality=modality, series=series, instance=int(index) + 1
        )
        dataset.ImagePositionPatient = [repr_ds(v) for v in positions[index]]
        dataset.ImageOrientationPatient = [repr_ds(v) for v in orientation]
        dataset.PixelSpacing = [repr_ds(v) for v in pixel_spacing]
        dataset.RescaleSlope, dataset.RescaleIntercept = slope, intercept
        put_pixels(dataset, volume[index])
        for keyword, value in tags.items():
            setattr(dataset, keyword, value)
        path = folder / f"s{series}_{name:04d}"
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
    path: Path, volume: np.ndarray, positions: np.ndarray, *, orientation: Sequence[float], spacing: Sequence[float]
) -> None:
    """Write an enhanced multi-frame file with a plane position per frame and the rest shared."""
    dataset = header(sop_class=ENHANCED_MR, modality="MR")
    put_pixels(dataset, volume)
    shared, measures, plane, transformation = Dataset(), Dataset(), Dataset(), Dataset()
    measures.PixelSpacing = list(spacing)
    plane.ImageOrientationPatient = list(orientation)
    transformation.RescaleSlope, transformation.RescaleIntercept = 2.0, 3.0
    shared.PixelMeasuresSequence = DicomSequence([measures])
    shared.PlaneOrientationSequence = DicomSequence([plane])
    shared.PixelValueTransformationSequence = DicomSequence([transformation])
    dataset.SharedFunctionalGroupsSequence = DicomSequence([shared])
    frames = []
    for position in positions:
        frame, place = Dataset(), Dataset()
        place.ImagePositionPatient = [repr_ds(v) for v in position]
        frame.PlanePositionSequence = DicomSequence([place])
        frames.append(frame)
    dataset.PerFrameFunctionalGroupsSequence = DicomSequence(frames)
    dataset.save_as(path, enforce_file_format=True)
