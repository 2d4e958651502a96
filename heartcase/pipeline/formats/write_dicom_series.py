"""Write a synthetic scan as a DICOM series, one file a slice, as an archive would hand it over."""

from __future__ import annotations

import hashlib
import io
import uuid
from pathlib import Path

import numpy as np
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, MRImageStorage
from pydicom.valuerep import format_number_as_ds

from heartcase.pipeline.data import Scan
from heartcase.schemas.arrays import Int16
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write

__all__ = ["check_series_folder", "write_dicom_series"]


def check_series_folder(folder: Path) -> None:
    """See that a series can be written into a folder: where it holds something, that would be read as part of it.

    Raises
    ------
    UsageError
        The folder is there and is not empty.
    """
    if folder.is_dir() and any(folder.iterdir()):
        raise UsageError("is there and is not empty: choose another folder, or empty it", place=folder.name)


def write_dicom_series(scan: Scan, folder: Path, *, name: str) -> list[Path]:
    """Write a scan that is nobody's as a series: intensities as whole numbers, the same bytes for the same scan.

    Parameters
    ----------
    scan
        Values and geometry; CT is written as CT, all else as MR.
    folder
        New folder, or one that holds nothing.
    name
        Stands for the patient's name and number.

    Returns
    -------
    list[Path]
        The files, by slice.

    Raises
    ------
    UsageError
        The folder is there and is not empty.
    """
    check_series_folder(folder)
    folder.mkdir(exist_ok=True)
    stored = np.clip(np.rint(scan.values), -(2**15), 2**15 - 1).astype("<i2")
    digest = hashlib.sha256(
        name.encode() + b"\0" + scan.geometry.model_dump_json().encode() + stored.tobytes()
    ).digest()
    paths = []
    for k, values in enumerate(stored):
        buffer = io.BytesIO()
        _image(scan, values, k, name, digest).save_as(buffer, enforce_file_format=True)
        paths.append(folder / f"IM{k + 1:04d}.dcm")
        atomic_write(paths[-1], buffer.getvalue())
    return paths


def _image(scan: Scan, values: Int16, k: int, name: str, digest: bytes) -> FileDataset:
    """Slice k (PS3.3 A.3 and A.4)."""
    is_ct = scan.modality == "CT"
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = CTImageStorage if is_ct else MRImageStorage
    meta.MediaStorageSOPInstanceUID = _uid(digest, f"image {k}")
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    image = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    image.SOPClassUID, image.SOPInstanceUID = meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID
    image.PatientName = image.PatientID = name
    for empty in ("PatientBirthDate", "PatientSex", "StudyDate", "StudyTime", "StudyID", "AccessionNumber"):
        setattr(image, empty, "")
    for what in ("Study", "Series"):
        setattr(image, f"{what}InstanceUID", _uid(digest, what))
    image.FrameOfReferenceUID = _uid(digest, "frame of reference")
    image.Modality, image.SeriesNumber, image.InstanceNumber = "CT" if is_ct else "MR", 1, k + 1
    image.Manufacturer, image.ImageType = "heartcase", ["ORIGINAL", "PRIMARY", "AXIAL" if is_ct else "OTHER"]
    geometry = scan.geometry
    image.ImageOrientationPatient = [_number(value) for value in geometry.direction_matrix[:, :2].T.ravel()]
    image.ImagePositionPatient = [_number(value) for value in geometry.index_to_world((0, 0, k))]
    image.PixelSpacing = [_number(value) for value in geometry.spacing_mm[1::-1]]
    image.SliceThickness = _number(geometry.spacing_mm[2])
    if is_ct:
        image.RescaleSlope, image.RescaleIntercept, image.RescaleType = "1", "0", "HU"
    image.SamplesPerPixel, image.PhotometricInterpretation = 1, "MONOCHROME2"
    image.Rows, image.Columns = values.shape
    image.BitsAllocated, image.BitsStored, image.HighBit, image.PixelRepresentation = 16, 16, 15, 1
    image.PixelData = values.tobytes()
    return image


def _uid(digest: bytes, what: str) -> str:
    """Identifier made from a hash (PS3.5 B.2: a UUID as one number under 2.25)."""
    found = hashlib.sha256(digest + what.encode()).digest()
    return f"2.25.{uuid.UUID(bytes=found[:16], version=5).int}"


def _number(value: float) -> str:
    return str(format_number_as_ds(float(value) + 0.0))
