"""Read a DICOM segmentation object (SEG): binary, fractional and label map (PS3.3 A.51, A.90 and C.8.20).

Frames may come in any order, and those in which nothing is marked may be missing; where each lies is taken from its
own plane position. Segments are told apart by their place in the file's list: their labels may name a patient.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pydicom
from pydicom.pixels import iter_pixels
from pydicom.sr.coding import Code

from heartcase.pipeline.formats.dicom_headers import is_dicom, quiet_pydicom
from heartcase.pipeline.formats.raw_volume import check_size, geometry_from_affine
from heartcase.pipeline.formats.segments import LabelVolume, SegmentInfo
from heartcase.schemas.errors import HeartcaseError, MarkerError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.terms import TERMS

__all__ = ["read_dicom_seg"]

SEG_CLASSES = ("1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7")
"""Segmentation Storage (binary and fractional) and Label Map Segmentation Storage."""
DAMAGED = "the segmentation is cut short or damaged: export it again"
COSINE_TOLERANCE = 1e-4
PLACE_TOLERANCE = 0.01
"""How far a frame may lie from its place, in slice spacings along the normal and in pixels across it."""
FRAME_LIMIT = 100_000

Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Frame:
    """Where a frame lies and what it shows."""

    position: Float64
    orientation: Float64
    spacing: Float64
    between: float | None
    """Distance between slices, or their thickness where that is not given."""
    segment: int | None
    """Segment number; None in a label map."""


def read_dicom_seg(path: Path) -> LabelVolume:
    """Read a DICOM SEG.

    Parameters
    ----------
    path
        The file, or a folder with this one DICOM file in it.

    Returns
    -------
    LabelVolume
        From the first to the last plane that the file holds, axes along rows, columns and their normal. Segment n of
        the file's list has the value n, from 1; where segments overlap the later one of the list wins. A fractional
        voxel belongs to its segment from one half up.

    Raises
    ------
    MarkerError
        It is not one segmentation, says not where it lies, is unevenly spaced, or is damaged.
    """
    with quiet_pydicom():
        try:
            return _read(_one_file(path))
        except HeartcaseError:
            raise
        except Exception:  # pydicom raises errors of every kind on damaged files
            raise MarkerError(DAMAGED) from None


def _one_file(path: Path) -> Path:
    if not path.is_dir():
        return path
    files = [file for file in sorted(path.iterdir()) if is_dicom(file)]
    if len(files) != 1:
        raise MarkerError(
            f"the folder holds {len(files) or 'no'} DICOM file{'s' * (len(files) > 1)}: give the one file of the "
            "segmentation, or a folder of .stl parts"
        )
    return files[0]


def _read(file: Path) -> LabelVolume:
    dataset = pydicom.dcmread(file, force=True)
    if str(dataset.get("SOPClassUID", "")) not in SEG_CLASSES:
        raise MarkerError("the DICOM file is no segmentation (SEG): is it a slice of the scan? Export a DICOM SEG")
    is_map = str(dataset.SegmentationType).upper() == "LABELMAP"
    frames = _frames(dataset, is_map)
    check_size((int(dataset.Columns), int(dataset.Rows), len(frames)))
    geometry, places = _lattice(frames, rows=int(dataset.Rows), columns=int(dataset.Columns))
    check_size(geometry.size)
    listed = [item for item in dataset.SegmentSequence if int(item.SegmentNumber) != 0]
    place_in_list = np.zeros(65536, np.uint16)
    for place, item in enumerate(listed, start=1):
        place_in_list[int(item.SegmentNumber)] = place
    merged = np.zeros(geometry.shape, np.uint16)
    for frame, k, stored in zip(frames, places, _stored(dataset, len(frames)), strict=True):
        if frame.segment is None:
            shown = place_in_list[stored]
            unlisted = (shown == 0) & (stored != 0) & (stored != dataset.get("PixelPaddingValue", 0))
            if unlisted.any():
                raise MarkerError("the label map holds values that its list of segments does not name: export it again")
        else:
            if place_in_list[frame.segment] == 0:
                raise MarkerError("a frame shows a segment that the file does not list: export it again")
            shown = stored * place_in_list[frame.segment]
        np.maximum(merged[k], shown, out=merged[k])
    segments = {
        place: SegmentInfo(place, " ".join(str(item.get("SegmentLabel", "")).split())[:64], _snomed(item))
        for place, item in enumerate(listed, start=1)
    }
    return LabelVolume(merged.astype(np.uint8) if len(listed) < 256 else merged, geometry, segments)


def _frames(dataset: Any, is_map: bool) -> list[_Frame]:
    shared = (dataset.get("SharedFunctionalGroupsSequence") or [None])[0]
    own = dataset.get("PerFrameFunctionalGroupsSequence") or ()
    if len(own) > FRAME_LIMIT or len(own) != int(dataset.get("NumberOfFrames", 0) or 0) or not own:
        raise MarkerError(DAMAGED)

    def find(frame: Any, group: str, keyword: str) -> Any:
        for holder in (frame, shared):
            inner = holder.get(group) if holder is not None else None
            if inner and inner[0].get(keyword) is not None:
                return inner[0].get(keyword)
        return None

    frames = []
    for frame in own:
        position = find(frame, "PlanePositionSequence", "ImagePositionPatient")
        orientation = find(frame, "PlaneOrientationSequence", "ImageOrientationPatient")
        spacing = find(frame, "PixelMeasuresSequence", "PixelSpacing")
        if position is None or orientation is None or spacing is None:
            raise MarkerError("the segmentation does not say where it lies in the patient: export it with its scan")
        between = find(frame, "PixelMeasuresSequence", "SpacingBetweenSlices")
        thickness = find(frame, "PixelMeasuresSequence", "SliceThickness")
        frames.append(
            _Frame(
                position=np.array(position, float),
                orientation=np.array(orientation, float),
                spacing=np.array(spacing, float),
                between=float(between or thickness or 0.0) or None,
                segment=None
                if is_map
                else int(find(frame, "SegmentIdentificationSequence", "ReferencedSegmentNumber")),
            )
        )
    return frames


def _lattice(frames: list[_Frame], *, rows: int, columns: int) -> tuple[Geometry, npt.NDArray[np.int64]]:
    """The lattice that all frames lie on, and the slice of each."""
    first = frames[0]
    alike = all(
        np.abs(frame.orientation - first.orientation).max() <= COSINE_TOLERANCE
        and np.allclose(frame.spacing, first.spacing, rtol=1e-4)
        for frame in frames
    )
    if not alike:
        raise MarkerError("the frames differ in orientation or pixel spacing, so they are no one volume: export again")
    row, column = first.orientation[:3], first.orientation[3:]
    normal = np.cross(row, column)
    positions = np.array([frame.position for frame in frames])
    numbers = (positions, first.orientation, first.spacing)
    if not all(np.isfinite(one).all() for one in numbers) or np.linalg.norm(normal) < 0.5 or first.spacing.min() <= 0.0:
        raise MarkerError("the position, direction or spacing in the headers is zero or not a number: export again")
    along = positions @ (normal / np.linalg.norm(normal))
    order = np.sort(along)
    gaps = np.diff(order)
    gaps = gaps[gaps > PLACE_TOLERANCE * (first.between or gaps.max(initial=0.0))]
    extent = order[-1] - order[0]
    stated = first.between
    if not gaps.size:
        spacing, count = stated or 1.0, 1
    else:
        # a stated thickness may be that of overlapping slices: it counts only where the planes lie on its multiples
        fits = stated is not None and _is_even(gaps, stated)
        spacing = stated if fits and stated is not None else float(gaps.min())
        count = round(extent / spacing) + 1
        if not _is_even(gaps, spacing):
            raise MarkerError("the planes are unevenly spaced: resample the segmentation onto the scan, and export it")
        spacing = extent / (count - 1)
    places = np.rint((along - order[0]) / spacing).astype(np.int64)
    affine = np.eye(4)
    affine[:3, 0], affine[:3, 1] = row * first.spacing[1], column * first.spacing[0]
    affine[:3, 2] = normal / np.linalg.norm(normal) * spacing
    affine[:3, 3] = positions[np.argmin(along)]
    expected = affine[:3, 3] + places[:, np.newaxis] * affine[:3, 2]
    off = np.abs((positions - expected) @ np.stack([row, column], axis=1)).max()
    if off > PLACE_TOLERANCE * first.spacing.min():
        raise MarkerError("the planes are shifted sideways against each other: resample the segmentation onto the scan")
    return geometry_from_affine(affine, (count, rows, columns)), places


def _is_even(gaps: Float64, spacing: float) -> bool:
    """Whether every gap is a multiple of the spacing, one at least."""
    steps = np.rint(gaps / spacing)
    return bool((steps >= 1).all() and (np.abs(gaps - steps * spacing) <= PLACE_TOLERANCE * spacing).all())


def _stored(dataset: Any, count: int) -> Iterator[npt.NDArray[np.uint16]]:
    """Each frame: 0 and 1 for binary and fractional ones, segment numbers in a label map."""
    kind = str(dataset.SegmentationType).upper()
    full = int(dataset.get("MaximumFractionalValue", 1) or 1)
    is_packed = int(dataset.BitsAllocated) == 1 and not dataset.file_meta.TransferSyntaxUID.is_encapsulated
    found = 0
    for stored in _unpacked(dataset, count) if is_packed else iter_pixels(dataset, raw=True):
        found += 1
        frame = stored.astype(np.uint16)
        yield (2 * frame >= full).astype(np.uint16) if kind == "FRACTIONAL" else frame
    if found != count:
        raise MarkerError(DAMAGED)


def _unpacked(dataset: Any, count: int) -> Iterator[npt.NDArray[np.uint8]]:
    """Frames of one bit per pixel, the lowest bit first, one frame right after the other (PS3.5 8.1.1)."""
    rows, columns = int(dataset.Rows), int(dataset.Columns)
    packed = np.frombuffer(dataset.PixelData, np.uint8)
    for frame in range(count):
        start = frame * rows * columns
        bits = np.unpackbits(packed[start // 8 : -(-(start + rows * columns) // 8)], bitorder="little")
        yield bits[start % 8 :][: rows * columns].reshape(rows, columns)


def _snomed(item: Any) -> str | None:
    """SNOMED CT code of a segment's type, also from the older SRT codes."""
    kinds = item.get("SegmentedPropertyTypeCodeSequence")
    if not kinds:
        return None
    value, scheme = str(kinds[0].get("CodeValue", "")), str(kinds[0].get("CodingSchemeDesignator", ""))
    code = Code(value, scheme, "")
    for term in TERMS:
        if term.code is not None and code == Code(term.code, "SCT", ""):
            return term.code
    return value if scheme == "SCT" and value.isdecimal() and 6 <= len(value) <= 18 else None
