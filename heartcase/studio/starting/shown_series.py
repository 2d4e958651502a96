"""The series of a DICOM folder, and other scans, as the start page shows them: a picture, figures, a judgement.

Nothing in it tells who was scanned: no text of a header is shown, and no name of a file.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.dicom.choice import SeriesInfo, describe_volume, listed
from heartcase.pipeline.formats.dicom.headers import OTHER_MODALITIES
from heartcase.pipeline.formats.dicom.phases import StackGroup
from heartcase.pipeline.formats.dicom.pixels import fill_padding, read_pixels
from heartcase.pipeline.formats.dicom.read import groups_of
from heartcase.pipeline.formats.dicom.stack import find_stack
from heartcase.pipeline.formats.read_scan import is_dicom_source, read_scan
from heartcase.schemas.arrays import Float32
from heartcase.schemas.errors import ScanError

__all__ = ["shown_series"]

PICTURE_SIZE = 96
"""Longer side of a picture, pixels."""
SERIES_COUNT_MAX = 200
"""Series that are shown at most."""
_LARGEST_IMAGE = 2**24
_DARK, _BRIGHT = 1.0, 99.0
"""Percentiles of intensity that are black and white."""
_CT_WINDOW = (-150.0, 450.0)
_FINE_MM = 1.5
"""Voxels up to this length along every side show thin walls."""
_THICK_MM = 3.0
"""Slices further apart than this hide what lies between them."""
_FEW_SLICES = 10


def shown_series(path: Path) -> list[dict[str, Any]]:
    """What a folder or file holds, as plain data, in the order in which ``heartcase info`` lists it.

    Parameters
    ----------
    path
        Folder of DICOM files, or a scan's file.

    Raises
    ------
    ScanError
        Nothing there can be read as a scan.
    """
    if not is_dicom_source(path):
        return [_of_file(read_scan(path))]
    groups = groups_of(path)
    return [_of_group(info, group) for info, group in zip(listed(groups), groups, strict=True)][:SERIES_COUNT_MAX]


def _of_file(scan: Scan) -> dict[str, Any]:
    spacing = scan.geometry.spacing_mm
    middle = scan.values[scan.values.shape[0] // 2]
    return {
        "series": None,
        "number": 1,
        "modality": scan.modality,
        "description": describe_volume(scan.geometry, scan.modality),
        "slice_count": scan.geometry.size[2],
        "spacing_mm": list(spacing),
        "trigger_times_ms": [],
        "echo_times_ms": [],
        "good_for": _good_for(scan.modality, spacing, scan.geometry.size[2], is_localizer=False, phase_count=1),
        "can_be_read": True,
        "picture": _picture(middle, spacing[:2], scan.modality),
    }


def _of_group(info: SeriesInfo, group: StackGroup) -> dict[str, Any]:
    spacing = info.spacing_mm
    count = max(len(info.trigger_times_ms), len(info.echo_times_ms), 1)
    slices = info.slice_count // max(len(group.stacks), 1)
    return {
        "series": info.uid_code,
        "number": info.number,
        "modality": info.modality,
        "description": info.description,
        "slice_count": info.slice_count,
        "spacing_mm": None if spacing is None else list(spacing),
        "trigger_times_ms": list(info.trigger_times_ms),
        "echo_times_ms": list(info.echo_times_ms) if len(info.echo_times_ms) > 1 else [],
        "good_for": _good_for(info.modality, spacing, slices, is_localizer=group.is_localizer, phase_count=count),
        "can_be_read": spacing is not None,
        "picture": _picture_of_group(group),
    }


def _good_for(
    modality: str,
    spacing_mm: Sequence[float] | None,
    slice_count: int,
    *,
    is_localizer: bool,
    phase_count: int,
) -> list[str]:
    """Keys of the page's words for what a series is good for, and what it is not."""
    if modality in OTHER_MODALITIES:
        return ["not_read"]
    if spacing_mm is None:
        return ["uneven"]
    if is_localizer or slice_count < _FEW_SLICES:
        return ["localizer"]
    found = []
    if max(spacing_mm) <= _FINE_MM:
        found.append("fine")
    else:
        found.append("thick" if max(spacing_mm) > _THICK_MM else "medium")
    if phase_count > 1:
        found.append("phases")
    return found


def _picture_of_group(group: StackGroup) -> str | None:
    """The middle slice of its first stack; None where it cannot be shown."""
    if group.modality in OTHER_MODALITIES:
        return None
    slices = group.stacks[0].slices
    try:
        ordered = find_stack(slices).slices
    except ScanError:
        ordered = slices
    one = ordered[len(ordered) // 2]
    rows, columns = one.shape
    if rows * columns > _LARGEST_IMAGE:
        return None
    try:
        spacing = one.spacing or (1.0, 1.0)
        return _picture(fill_padding(read_pixels((one,)))[0], spacing[::-1], group.modality)
    except ScanError:
        return None


def _picture(values: Float32, spacing_mm: Sequence[float], modality: str) -> str | None:
    """A slice (rows, columns) as a PNG in a data URL; voxels of these lengths along columns and rows, mm."""
    if not np.isfinite(values).all():
        return None
    low, high = _CT_WINDOW if modality == "CT" else (float(x) for x in np.percentile(values, (_DARK, _BRIGHT)))
    grey = np.clip((values - low) / max(high - low, 1e-6) * 255.0, 0.0, 255.0).astype(np.uint8)
    width, height = values.shape[1] * spacing_mm[0], values.shape[0] * spacing_mm[1]
    scale = PICTURE_SIZE / max(width, height)
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    stream = io.BytesIO()
    Image.fromarray(grey).resize(size, Image.Resampling.BILINEAR, reducing_gap=2.0).save(stream, "png")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
