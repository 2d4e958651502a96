"""Write scans and segmentations as image files: the same bytes for the same input, whole or not at all."""

from __future__ import annotations

import gzip
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy.typing as npt

from heartcase.pipeline.data import Scan, Segmentation
from heartcase.pipeline.formats.labels.segments import segment_table
from heartcase.pipeline.formats.volumes.nifti_intent import INTENT_AT, LABEL_INTENT
from heartcase.pipeline.formats.volumes.quiet_itk import quiet_itk
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.geometry import Geometry

__all__ = ["WRITE_SUFFIXES", "label_values_bytes", "segmentation_nrrd_bytes", "write_scan", "write_segmentation"]

WRITE_SUFFIXES = (".nii.gz", ".nii", ".nrrd", ".mha")
"""File name endings that can be written; .seg.nrrd is a .nrrd with a segment table."""

GZIP_LEVEL = 2


def write_scan(scan: Scan, path: Path | str) -> None:
    """Write a scan: its values and geometry and nothing else.

    Parameters
    ----------
    scan
        The scan.
    path
        .nii, .nii.gz, .nrrd or .mha file. NIfTI keeps the geometry in float32, the others in full.

    Raises
    ------
    UsageError
        Another ending, or the file cannot be written.
    """
    path = Path(path)
    _write(path, _image_bytes(scan.values, scan.geometry, _suffix(path), {}))


def write_segmentation(segmentation: Segmentation, path: Path | str) -> None:
    """Write a segmentation.

    Parameters
    ----------
    segmentation
        Labels, geometry and label table.
    path
        .seg.nrrd with the names, colours and codes of the labels as 3D Slicer reads them; or .nii, .nii.gz, .nrrd or
        .mha with the values alone, which NIfTI says to be labels.

    Raises
    ------
    UsageError
        Another ending, or the file cannot be written.
    """
    path = Path(path)
    pairs = segment_table(segmentation) if path.name.lower().endswith(".seg.nrrd") else {}
    _write(path, _image_bytes(segmentation.labels, segmentation.geometry, _suffix(path), pairs, intent=LABEL_INTENT))


def segmentation_nrrd_bytes(
    segmentation: Segmentation, *, case_id: str | None = None, offset: tuple[int, int, int] = (0, 0, 0)
) -> bytes:
    """Content of a .seg.nrrd file: the labels, compressed, with the segment table that 3D Slicer reads.

    A ``case_id``, the made-up identifier of the case, is written under the key ``heartcase_case_id``; ``offset`` is
    the index of the scan's voxel that is the labels' first.
    """
    pairs = segment_table(segmentation, offset=offset) | ({"heartcase_case_id": case_id} if case_id else {})
    return _image_bytes(segmentation.labels, segmentation.geometry, ".nrrd", pairs)


def label_values_bytes(segmentation: Segmentation, suffix: str) -> bytes:
    """Content of a file of the label values alone; ``suffix`` is one of :data:`WRITE_SUFFIXES`."""
    return _image_bytes(segmentation.labels, segmentation.geometry, suffix, {}, intent=LABEL_INTENT)


def _suffix(path: Path) -> str:
    for suffix in WRITE_SUFFIXES:
        if path.name.lower().endswith(suffix):
            return suffix
    raise UsageError(f"the file name must end in one of: {', '.join(WRITE_SUFFIXES)}, .seg.nrrd", place="output")


def _image_bytes(
    values: npt.NDArray[Any], geometry: Geometry, suffix: str, pairs: Mapping[str, str], *, intent: int = 0
) -> bytes:
    import SimpleITK

    image = SimpleITK.GetImageFromArray(values)
    image.SetOrigin(geometry.origin_mm)
    image.SetSpacing(geometry.spacing_mm)
    image.SetDirection([component for row in geometry.direction for component in row])
    for key, text in pairs.items():
        image.SetMetaData(key, text)
    with tempfile.TemporaryDirectory(prefix="heartcase-") as directory, quiet_itk():
        is_nifti = suffix in (".nii", ".nii.gz")
        file = Path(directory) / ("volume.nii" if is_nifti else f"volume{suffix}")
        try:
            SimpleITK.WriteImage(image, str(file), useCompression=not is_nifti)
            content = file.read_bytes()
            if is_nifti:
                # ITK writes none
                content = content[:INTENT_AT] + intent.to_bytes(2, sys.byteorder) + content[INTENT_AT + 2 :]
        except (RuntimeError, OSError):
            raise UsageError("the volume cannot be written: is the disk full?", place="output") from None
    # ITK compresses NIfTI at a level of its own, several times as slow for little
    return gzip.compress(content, compresslevel=GZIP_LEVEL, mtime=0) if suffix == ".nii.gz" else content


def _write(path: Path, data: bytes) -> None:
    try:
        atomic_write(path, data)
    except OSError:
        raise UsageError(
            "the file cannot be written: is its folder there, may it be written to, and is the disk full?",
            place="output",
        ) from None
