"""Read scans and label volumes: NIfTI, NRRD, MetaImage, and the DICOM series of a folder.

What leaves here is values, geometry, modality and the physics of the acquisition. No tag, path or file name does,
in a result or in an error: an error says "slice 12" or "the file".
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.dicom.archive import is_archive
from heartcase.pipeline.formats.labels.segments import LabelVolume, SegmentInfo, in_file_order, keep_all, segments_of
from heartcase.pipeline.formats.volumes.frames import FrameChoice
from heartcase.pipeline.formats.volumes.raw_volume import RawVolume, check_size, placed, require_file
from heartcase.pipeline.formats.volumes.read_metaimage import metaimage_data_file, read_metaimage
from heartcase.pipeline.formats.volumes.read_nifti import read_nifti
from heartcase.pipeline.formats.volumes.read_nrrd import nrrd_data_file, read_nrrd
from heartcase.schemas.arrays import Float32, UInt16
from heartcase.schemas.errors import MarkerError, Problem, ScanError
from heartcase.schemas.files import is_there
from heartcase.schemas.geometry import Geometry

if TYPE_CHECKING:
    from heartcase.pipeline.formats.dicom.overlap import Overlap
    from heartcase.pipeline.formats.dicom.read import SeriesInfo

# What reads DICOM is imported where it is needed: pydicom takes longer to load than most scans.

__all__ = [
    "READERS",
    "LabelVolume",
    "detached_data_file",
    "is_dicom_source",
    "list_series",
    "read_labels",
    "read_scan",
]

READERS: dict[str, Callable[[Path, FrameChoice | None], RawVolume]] = {
    ".nii.gz": read_nifti,
    ".nii": read_nifti,
    ".nrrd": read_nrrd,
    ".nhdr": read_nrrd,
    ".mha": read_metaimage,
    ".mhd": read_metaimage,
}
"""Reader of each file name ending."""

DATA_FILES: dict[str, Callable[[Path], Path | None]] = {
    ".nrrd": nrrd_data_file,
    ".nhdr": nrrd_data_file,
    ".mha": metaimage_data_file,
    ".mhd": metaimage_data_file,
}
"""What finds the values of files that may keep them in another file."""

HIGHEST_LABEL = 65535


def read_scan(
    path: Path | str,
    *,
    series: str | None = None,
    trigger_time_ms: float | None = None,
    echo_time_ms: float | None = None,
    frame: int | None = None,
    interpolate_missing: bool = False,
    straighten_tilt: bool = False,
    overlap: Overlap | None = None,
) -> Scan:
    """Read a scan.

    Parameters
    ----------
    path
        .nii, .nii.gz, .nrrd, .nhdr, .mha or .mhd file; folder of DICOM files, or a zip archive of one; or one
        multi-frame DICOM file.
    series
        DICOM: which series, by its number or code in :func:`list_series`, or its UID.
    trigger_time_ms
        DICOM: which cardiac phase, the nearest to this time after the R wave, ms. Files of several volumes that say
        when each is: the volume nearest to this time.
    echo_time_ms
        DICOM: which echo, the nearest to this echo time, ms.
    frame
        NIfTI, NRRD and MetaImage files of several volumes: which one, from 0.
    interpolate_missing
        DICOM: fill missing slices from their neighbours (at most two in a row and a third of all).
    straighten_tilt
        DICOM: resample a stack that leans (tilted gantry) onto a straight one.
    overlap
        DICOM: where two acquisitions meet in one slice position, take the image acquired ``"earlier"`` or ``"later"``.

    Returns
    -------
    Scan
        Values as float32, geometry as in the file (oblique, anisotropic or left-handed as it may be), modality,
        acquisition physics, and warnings that say what was filled, straightened or left out. Where a file does not say
        how its axes lie in the patient they are taken as left, posterior, superior, and
        ``acquisition["orientation"]`` says so.

    Raises
    ------
    ScanError
        With every problem, none of which names a path, a file or a tag's value.
    """
    path = Path(path)
    try:
        if is_dicom_source(path):
            if frame is not None:
                raise ScanError(
                    "a frame number chooses in NIfTI, NRRD and MetaImage files: among DICOM images choose with "
                    "--trigger-time or --series (trigger_time_ms or series in the recipe's [scan])"
                )
            from heartcase.pipeline.formats.dicom.read import read_dicom

            return read_dicom(
                path,
                series=series,
                trigger_time_ms=trigger_time_ms,
                echo_time_ms=echo_time_ms,
                interpolate_missing=interpolate_missing,
                straighten_tilt=straighten_tilt,
                overlap=overlap,
            )
        if echo_time_ms is not None:
            raise ScanError("an echo time chooses among DICOM images, but this is another file: leave it out")
        raw = _read_file(path, FrameChoice(frame, trigger_time_ms))
        if raw.frame is None and (trigger_time_ms is not None or frame):
            raise ScanError("a trigger time or a frame is given, but this file holds one volume: leave it out")
        if raw.values.ndim != 3:
            raise ScanError(
                f"every voxel holds {raw.values.shape[3]} values (colour, a vector or times): export the scan with one "
                "plain number per voxel"
            )
        if min(raw.values.shape) < 2:
            raise ScanError("the volume is a single slice: a stack of several slices is needed")
        acquisition: dict[str, Any] = {}
        if not raw.orientation_is_stated:
            acquisition["orientation"] = "not stated in the file, taken as left, posterior, superior"
        if raw.frame is not None:
            acquisition["frame"] = raw.frame.number
            acquisition |= {} if raw.frame.time_ms is None else {"frame_time_ms": raw.frame.time_ms}
        return Scan(
            values=_as_float32(raw.values),
            geometry=raw.geometry,
            acquisition=acquisition,
            warnings=raw.frame.notes if raw.frame is not None else (),
        )
    except ScanError as error:
        raise placed(error, "scan", ScanError) from None


def list_series(path: Path | str) -> tuple[SeriesInfo, ...]:
    """List the series that a folder or file holds.

    Parameters
    ----------
    path
        What :func:`read_scan` takes; a file that is not DICOM counts as one series.

    Returns
    -------
    tuple of SeriesInfo
        In the order of their numbers: by the scanner's series number, then by UID.

    Raises
    ------
    ScanError
        Nothing there can be read as a scan.
    """
    from heartcase.pipeline.formats.dicom.read import SeriesInfo, describe_volume, series_of

    path = Path(path)
    if not is_dicom_source(path):
        scan = read_scan(path)
        return (
            SeriesInfo(
                number=1,
                slice_count=scan.geometry.size[2],
                spacing_mm=scan.geometry.spacing_mm,
                modality=scan.modality,
                description=describe_volume(scan.geometry, scan.modality),
                uid_code="",
            ),
        )
    try:
        return series_of(path)
    except ScanError as error:
        raise placed(error, "scan", ScanError) from None


def read_labels(
    path: Path | str,
    scan: Geometry | None = None,
    left_out: Callable[[SegmentInfo], bool] = keep_all,
    rank: Callable[[SegmentInfo], int] = in_file_order,
) -> LabelVolume:
    """Read a label volume: painted markers or a finished segmentation.

    Parameters
    ----------
    path
        .nii, .nii.gz, .nrrd, .nhdr, .seg.nrrd, .mha or .mhd file; or a DICOM SEG, as a file or in a folder of its own.
    scan
        The scan's lattice: tells how far the planes of a DICOM SEG are apart where the file does not.
    left_out
        Which segments nobody wants: they take no voxel from those that overlap them.
    rank
        How high each segment lies where segments overlap; of one rank the later one of the file's list lies on top.

    Returns
    -------
    LabelVolume
        On the file's own grid, which may be cropped to what is painted. Where segments of a .seg.nrrd or a DICOM SEG
        overlap, the one on top wins, and ``overlaps`` says where; a DICOM SEG, and a .seg.nrrd with several layers,
        is renumbered, segment n of the list getting the value n.

    Raises
    ------
    MarkerError
        The file cannot be read, or does not hold whole numbers from 0 to 65535.
    """
    path = Path(path)
    try:
        if is_archive(path):
            raise ScanError("this is a zip archive: unpack it, and give the file of markers or labels")
        if is_dicom_source(path):
            from heartcase.pipeline.formats.labels.dicom_seg import read_dicom_seg

            return read_dicom_seg(path, scan, left_out, rank)
        raw = _read_file(path)
    except ScanError as error:
        raise placed(error, "", MarkerError) from None
    values = _as_whole_numbers(raw.values)
    values, segments, vanished, overlaps = segments_of(values, raw.header, left_out, rank)
    fits = values.max(initial=0) < 256
    values_kept = values.astype(np.uint8) if fits else values
    return LabelVolume(values_kept, raw.geometry, segments, vanished, overlaps=overlaps)


def is_dicom_source(path: Path) -> bool:
    """Whether this is read as DICOM: a folder, a zip archive of one, or a file that starts as DICOM does.

    A file with the ending of another format is that.
    """
    if not is_there(path):
        return False
    if path.is_dir() or _suffix(path) is not None:
        return path.is_dir()
    from heartcase.pipeline.formats.dicom.headers import is_dicom

    return is_dicom(path) or is_archive(path)


def detached_data_file(path: Path) -> Path | None:
    """The file that holds the values of a volume whose header is a file of its own; None where they are in one file.

    Raises
    ------
    ScanError
        The header is damaged, or the file that it names is not beside it.
    """
    find = DATA_FILES.get(_suffix(path) or "")
    return find(path) if find else None


def _suffix(path: Path) -> str | None:
    return next((suffix for suffix in READERS if path.name.lower().endswith(suffix)), None)


def _read_file(path: Path, choice: FrameChoice | None = None) -> RawVolume:
    if is_there(path) and path.is_dir():
        raise ScanError("this is a folder, but a file is needed here")
    require_file(path)
    suffix = _suffix(path)
    if suffix is None:
        listed = ", ".join(READERS)
        raise ScanError(f"this kind of file is not read: give {listed}, or a folder of DICOM files (or a zip of it)")
    raw = READERS[suffix](path, choice)
    check_size(raw.geometry.size)
    return raw


def _as_float32(values: npt.NDArray[Any]) -> Float32:
    with np.errstate(over="ignore", invalid="ignore"):
        result = np.ascontiguousarray(values, dtype=np.float32)
    bad = result.size - int(np.count_nonzero(np.isfinite(result)))
    if bad:
        raise ScanError(
            f"{bad} voxels hold no finite number (NaN or infinity): replace them, for instance by the lowest value of "
            "the scan, and export it again"
        )
    return result


def _as_whole_numbers(values: npt.NDArray[Any]) -> UInt16:
    if values.dtype.kind == "f":
        whole = bool(np.isfinite(values).all()) and bool((values == np.round(values)).all())
    else:
        whole = values.dtype.kind in "iub"
    if not whole or values.min(initial=0) < 0 or values.max(initial=0) > HIGHEST_LABEL:
        raise MarkerError(
            Problem(
                "",
                f"a label volume holds whole numbers from 0 to {HIGHEST_LABEL}, this one holds others: is it "
                "the scan itself?",
            )
        )
    return values.astype(np.uint16)
