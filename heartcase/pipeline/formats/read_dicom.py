"""Read a DICOM series: a folder of slices, or the frames of a multi-frame file.

Errors name a slice by its place in the stack (slice 1 is the first along the stack's axis, which is the cross product
of the rows' and the columns' direction) and a series by its number in the list: a tag's value, a path or a file name
may identify a patient and goes nowhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pydicom
import SimpleITK
from pydicom.pixels import get_decoder

from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.dicom_headers import ImageSeries, find_series, is_dicom, quiet_pydicom
from heartcase.pipeline.formats.raw_volume import check_size, geometry_from_affine
from heartcase.pipeline.formats.read_itk import quiet_itk
from heartcase.pipeline.formats.stack import Slice, Stack, find_stack, stack_problem
from heartcase.schemas.errors import Problem, ScanError
from heartcase.schemas.geometry import Geometry

__all__ = ["SeriesInfo", "describe_volume", "is_dicom", "read_dicom", "series_of"]

DAMAGED = "the file is cut short or damaged: copy it from the scanner or archive again"
SHORTEST_SUFFIX = 6


@dataclass(frozen=True)
class SeriesInfo:
    """A series as it may be shown: nothing in it tells who was scanned."""

    number: int
    """Number to choose it by, from 1."""
    slice_count: int
    """Number of images."""
    spacing_mm: tuple[float, float, float] | None
    """Spacing along i, j, k; None where the images do not form one stack."""
    modality: str
    """``CT``, ``MR`` or ``unknown``."""
    description: str
    """What it is, in words made from geometry, modality and physics."""
    uid_suffix: str
    """The end of its UID, long enough to tell it from the others; empty for other formats."""


def series_of(path: Path) -> tuple[SeriesInfo, ...]:
    """List the series of a folder, or of one file.

    Raises
    ------
    ScanError
        There is no DICOM image, or a file is damaged.
    """
    return _listed(find_series(path))


def read_dicom(path: Path, *, series: str | None) -> Scan:
    """Read one series.

    Parameters
    ----------
    path
        Folder, searched with its subfolders, or one file.
    series
        Number in :func:`series_of` or end of the UID; may be left out where there is one series of several images.

    Returns
    -------
    Scan
        Values after rescale slope and intercept. The axes are the rows', the columns' and their normal: right-handed.

    Raises
    ------
    ScanError
        The choice is not clear, or the images do not form one evenly spaced straight stack.
    """
    chosen = _choose(find_series(path), series)
    stack = find_stack(chosen.slices)
    rows, columns = stack.slices[0].shape
    check_size((columns, rows, len(stack.slices)))
    values = np.empty((len(stack.slices), rows, columns), dtype=np.float32)
    decoded: tuple[Path | None, Any] = (None, None)
    for number, image in enumerate(stack.slices):
        try:
            if decoded[0] != image.path:
                decoded = (image.path, _decode(image.path))
            values[number] = _values(decoded[1], image)
        except ScanError as error:
            raise ScanError(error.problems[0].message, place=f"slice {number + 1}") from None
    if not np.isfinite(values).all():
        raise ScanError("the rescaled values are not finite numbers: export the series again")
    geometry = _geometry(stack)
    return Scan(values=values, geometry=geometry, modality=chosen.modality, acquisition=dict(chosen.acquisition))


def describe_volume(geometry: Geometry, modality: str) -> str:
    """What a volume is, in words: modality, orientation, size and spacing."""
    normal = np.abs(geometry.direction_matrix[:, 2])
    plane = ("sagittal", "coronal", "axial")[int(np.argmax(normal))]
    if normal.max() < 0.999:
        plane = f"oblique {plane}"
    size = " x ".join(str(count) for count in geometry.size)
    spacing = " x ".join(f"{length:.4g}" for length in geometry.spacing_mm)
    return f"{modality if modality != 'unknown' else 'volume'}, {plane}, {size} voxels of {spacing} mm"


def _geometry(stack: Stack) -> Geometry:
    rows, columns = stack.slices[0].shape
    return geometry_from_affine(stack.affine, (len(stack.slices), rows, columns))


def _listed(every: tuple[ImageSeries, ...]) -> tuple[SeriesInfo, ...]:
    listed = []
    for number, series in enumerate(every, start=1):
        problem = stack_problem(series.slices)
        if problem is None:
            geometry = _geometry(find_stack(series.slices))
            spacing, description = geometry.spacing_mm, describe_volume(geometry, series.modality)
        else:
            spacing = None
            noun = series.modality if series.modality != "unknown" else "images"
            description = f"{noun}, not one even stack ({problem.partition(':')[0]})"
        if "echo_time_ms" in series.acquisition:
            description += f", echo time {series.acquisition['echo_time_ms']:g} ms"
        listed.append(
            SeriesInfo(
                number=number,
                slice_count=len(series.slices),
                spacing_mm=spacing,
                modality=series.modality,
                description=description,
                uid_suffix=_suffix(series.uid, [other.uid for other in every]),
            )
        )
    return tuple(listed)


def _suffix(uid: str, every: list[str]) -> str:
    length = SHORTEST_SUFFIX
    while length < len(uid) and sum(other.endswith(uid[-length:]) for other in every) > 1:
        length += 1
    return uid[-length:]


def _choose(every: tuple[ImageSeries, ...], wanted: str | None) -> ImageSeries:
    if wanted is None:
        stacks = [series for series in every if len(series.slices) > 1] or list(every)
        if len(stacks) == 1:
            return stacks[0]
        problem = "the folder holds several series: choose one with --series NUMBER, or series in the recipe's [scan]"
        raise ScanError(_with_list(problem, every))
    wanted = wanted.strip()
    if wanted.isdecimal() and 1 <= int(wanted) <= len(every):
        return every[int(wanted) - 1]
    matching = [series for series in every if wanted and series.uid.endswith(wanted)]
    if len(matching) == 1:
        return matching[0]
    fits = "several series end" if matching else "no series has this number or ends"
    raise ScanError(_with_list(f"{fits} like the given --series: choose a number from the list", every))


def _with_list(problem: str, every: tuple[ImageSeries, ...]) -> list[Problem]:
    lines = [
        Problem(f"series {info.number}", f"{info.slice_count} images, {info.description} (UID ...{info.uid_suffix})")
        for info in _listed(every)
    ]
    return [Problem("", problem), *lines]


def _decode(path: Path) -> Any:
    """Stored values of a file, shape (rows, columns) or (frames, rows, columns), and whether they are rescaled."""
    with quiet_pydicom():
        try:
            dataset = pydicom.dcmread(path, force=True)
            if not hasattr(dataset, "file_meta") or "TransferSyntaxUID" not in dataset.file_meta:
                dataset.ensure_file_meta()
                dataset.file_meta.TransferSyntaxUID = pydicom.uid.ImplicitVRLittleEndian
            syntax = dataset.file_meta.TransferSyntaxUID
            if not syntax.is_encapsulated or get_decoder(syntax).is_available:
                return dataset.pixel_array, False
        except NotImplementedError:
            pass
        except Exception:  # as above
            raise ScanError(DAMAGED) from None
    try:
        with quiet_itk():
            return SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(path), imageIO="GDCMImageIO")), True
    except (RuntimeError, MemoryError):
        raise ScanError("its compression is not read: export the series uncompressed") from None


def _values(decoded: tuple[npt.NDArray[Any], bool], image: Slice) -> npt.NDArray[np.float64]:
    stored, is_rescaled = decoded
    if is_rescaled and image.frame is not None:
        raise ScanError("its compression is not read in a multi-frame file: export the series uncompressed")
    if image.frame is not None or stored.ndim == 3:
        index = image.frame or 0
        if stored.ndim == 2:
            stored = stored[np.newaxis]
        if index >= stored.shape[0]:
            raise ScanError(DAMAGED)
        stored = stored[index]
    if stored.shape != image.shape:
        raise ScanError(DAMAGED)
    values = stored.astype(np.float64)
    if not is_rescaled:
        values = values * image.slope + image.intercept
    if not (np.abs(values) <= np.finfo(np.float32).max).all():
        raise ScanError("its rescaled values are not finite numbers: export the series again")
    return values
