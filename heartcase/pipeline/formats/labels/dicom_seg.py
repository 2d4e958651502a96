"""Read a DICOM segmentation object (SEG): binary, fractional and label map (PS3.3 A.51, A.90 and C.8.20).

Frames may come in any order, and those in which nothing is marked may be missing; where each lies is taken from its
own plane position. How thick a plane is must be known and is not guessed: the stated distance between planes, the
slices of the scan, or a stated thickness at which all planes lie. Segments are told apart by their place in the file's
list: their labels may name a patient.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from pydicom.pixels import iter_pixels
from pydicom.sr.coding import Code

from heartcase.pipeline.formats.dicom.file_meta import check_deflated
from heartcase.pipeline.formats.dicom.headers import is_dicom, quiet_pydicom
from heartcase.pipeline.formats.labels.segments import (
    LabelVolume,
    SegmentInfo,
    count_overlaps,
    in_file_order,
    keep_all,
    stacking_of,
)
from heartcase.pipeline.formats.volumes.agreement import AGREEMENT_MM, even_line
from heartcase.pipeline.formats.volumes.raw_volume import VOXEL_LIMIT, check_size, geometry_from_affine
from heartcase.schemas.arrays import Float64, Int64, UInt8, UInt16
from heartcase.schemas.errors import HeartcaseError, MarkerError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.terms import TERMS

__all__ = ["read_dicom_seg"]

SEG_CLASSES = ("1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7")
"""Segmentation Storage (binary and fractional) and Label Map Segmentation Storage."""
DAMAGED = "the segmentation is cut short or damaged: export it again"
COSINE_TOLERANCE = 1e-4
PLACE_PART = 0.25
"""Part of the distance between planes by which a frame may lie off its place at most; see AGREEMENT_MM."""
SAME_PLACE_PART = 0.01
"""Frames nearer to each other than this part of the distance between planes lie in one plane."""
SLICE_TOLERANCE = 0.1
"""How far a plane may lie from a slice of the scan, in slice spacings: a scan's own slices are evened out when read."""
FRAME_LIMIT = 100_000
_HEADERS_MOST = 2**26
"""Bytes that all but the values may take in a file that is packed as a whole."""


@dataclass(frozen=True)
class _Frame:
    """Where a frame lies and what it shows."""

    position: Float64
    orientation: Float64
    spacing: Float64
    between: float | None
    """Distance between slices, where it is stated."""
    thickness: float | None
    """Thickness of a slice, where it is stated; slices may overlap or leave gaps."""
    segment: int | None
    """Segment number; None in a label map."""


@dataclass(frozen=True)
class _Packed:
    """A segment's part of a plane, one bit a pixel: frames come in any order, and all of a plane are needed at once."""

    place: int
    """Its place in the stacking."""
    bits: UInt8

    def unpacked(self, shape: tuple[int, ...]) -> UInt16:
        """Its place where it is, 0 elsewhere."""
        inside = np.unpackbits(self.bits, count=int(np.prod(shape))).reshape(shape)
        return inside.astype(np.uint16) * np.uint16(self.place)


def read_dicom_seg(
    path: Path,
    scan: Geometry | None = None,
    left_out: Callable[[SegmentInfo], bool] = keep_all,
    rank: Callable[[SegmentInfo], int] = in_file_order,
) -> LabelVolume:
    """Read a DICOM SEG.

    Parameters
    ----------
    path
        The file, or a folder with this one DICOM file in it.
    scan
        The scan's lattice, or a part of it: where the file does not state the distance between its planes, and they lie
        on slices of the scan, it is the scan's.
    left_out
        Which segments nobody wants: they take no voxel from others, and count as vanished.
    rank
        How high each segment lies; of one rank the later one of the file's list lies on top.

    Returns
    -------
    LabelVolume
        From the first to the last plane that the file holds, axes along rows, columns and their normal. Segment n of
        the file's list has the value n, from 1; where segments overlap the one on top wins. A fractional
        voxel belongs to its segment from one half up.

    Raises
    ------
    MarkerError
        It is not one segmentation, says not where it lies or how thick its planes are, is unevenly spaced, lists two
        segments under one number, or is damaged.
    """
    with quiet_pydicom():
        try:
            return _read(_one_file(path), scan, left_out, rank)
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


def _read(
    file: Path,
    scan: Geometry | None,
    left_out: Callable[[SegmentInfo], bool],
    rank: Callable[[SegmentInfo], int],
) -> LabelVolume:
    with file.open("rb") as stream:
        check_deflated(stream, _allow)
    dataset = pydicom.dcmread(file, force=True)
    if str(dataset.get("SOPClassUID", "")) not in SEG_CLASSES:
        raise MarkerError("the DICOM file is no segmentation (SEG): is it a slice of the scan? Export a DICOM SEG")
    is_map = str(dataset.SegmentationType).upper() == "LABELMAP"
    frames = _frames(dataset, is_map)
    # frames are read one by one, and those of many segments show one plane
    check_size((int(dataset.Columns), int(dataset.Rows), len(frames)), limit=VOXEL_LIMIT)
    geometry, places = _lattice(frames, scan, rows=int(dataset.Rows), columns=int(dataset.Columns))
    check_size(geometry.size)
    listed = [item for item in dataset.SegmentSequence if int(item.SegmentNumber) != 0]
    place_in_list = np.zeros(65536, np.uint16)
    for place, item in enumerate(listed, start=1):
        if place_in_list[int(item.SegmentNumber)]:
            raise MarkerError(
                "two segments of the file have the same number, so no one can tell them apart: correct it"
            )
        place_in_list[int(item.SegmentNumber)] = place
    segments = {
        place: SegmentInfo(place, " ".join(str(item.get("SegmentLabel", "")).split())[:64], _snomed(item))
        for place, item in enumerate(listed, start=1)
    }
    stacking = stacking_of(segments.values(), left_out, rank)
    of_slice: dict[int, list[_Packed]] = {}
    painted: set[int] = set()
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
        found = set(np.unique(shown).tolist()) - {0}
        painted |= found
        taken = [number for number in sorted(found) if stacking.place[number]]
        of_slice.setdefault(int(k), []).extend(_Packed(int(stacking.place[n]), np.packbits(shown == n)) for n in taken)
    merged = np.zeros(geometry.shape, np.uint16)
    overlaps: Counter[tuple[int, int]] = Counter()
    for k, parts in of_slice.items():
        layers = [part.unpacked(merged[k].shape) for part in parts]
        if layers:
            merged[k] = stacking.number[np.max(layers, axis=0)]
            overlaps += count_overlaps(layers)
    vanished = tuple(sorted(painted - set(np.unique(merged).tolist())))
    values = merged.astype(np.uint8) if len(listed) < 256 else merged
    return LabelVolume(values, geometry, segments, vanished, overlaps=stacking.overlaps(overlaps))


def _allow(size: int) -> None:
    """Refuse more bytes than the values that may be read could take."""
    check_size((max(size - _HEADERS_MOST, 1), 1, 1))


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
                between=None if between is None else float(between),
                thickness=None if thickness is None else float(thickness),
                segment=None
                if is_map
                else int(find(frame, "SegmentIdentificationSequence", "ReferencedSegmentNumber")),
            )
        )
    return frames


def _lattice(frames: list[_Frame], scan: Geometry | None, *, rows: int, columns: int) -> tuple[Geometry, Int64]:
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
    normal /= np.linalg.norm(normal)
    along = positions @ normal
    start, spacing, places = _planes(along, normal, first, scan)
    affine = np.eye(4)
    affine[:3, 0], affine[:3, 1] = row * first.spacing[1], column * first.spacing[0]
    affine[:3, 2] = normal * spacing
    affine[:3, 3] = positions[np.argmin(along)] + normal * (start - along.min())
    expected = affine[:3, 3] + places[:, np.newaxis] * affine[:3, 2]
    off = np.abs((positions - expected) @ np.stack([row, column], axis=1)).max()
    if off > AGREEMENT_MM:
        raise MarkerError("the planes are shifted sideways against each other: resample the segmentation onto the scan")
    return geometry_from_affine(affine, (int(places.max()) + 1, rows, columns)), places


def _planes(along: Float64, normal: Float64, frame: _Frame, scan: Geometry | None) -> tuple[float, float, Int64]:
    """Place of the first plane along the normal, distance between planes, and number of each frame's plane from 0."""
    stated = frame.between
    if stated is not None and not stated > 0.0:
        raise MarkerError("the stated distance between planes is zero, negative or not a number: export it again")
    low, extent = float(along.min()), float(np.ptp(along))
    planes = np.sort(along)
    gaps = np.diff(planes)
    is_new = gaps > SAME_PLACE_PART * (stated or gaps.max(initial=0.0))
    planes, gaps = np.concatenate((planes[:1], planes[1:][is_new])), gaps[is_new]
    if stated is None or not _is_even(planes, stated):
        slices = None if scan is None else _slices_of(scan, normal)
        if slices is not None:
            numbers = (along - slices[0]) / slices[1]
            places = np.rint(numbers)
            if (np.abs(numbers - places) <= SLICE_TOLERANCE).all():
                first = float(places.min())
                return slices[0] + first * slices[1], slices[1], (places - first).astype(np.int64)
        if gaps.size and not _is_even(planes, float(gaps.min())):
            raise MarkerError("the planes are unevenly spaced: resample the segmentation onto the scan, and export it")
        if stated is not None:
            raise MarkerError("the planes do not lie at the distance that the file states: export it with its scan")
        stated = frame.thickness
        if stated is None or not gaps.size or not _is_even(planes, stated, is_whole=True):
            raise MarkerError(
                "the file does not state the distance between its planes (SpacingBetweenSlices), and they are no "
                "slices of the scan at hand, so which planes are missing cannot be told: export it again with its scan"
            )
    count = round(extent / stated) + 1
    spacing = extent / (count - 1) if count > 1 else stated
    return low, spacing, np.rint((along - low) / spacing).astype(np.int64)


def _slices_of(scan: Geometry, normal: Float64) -> tuple[float, float] | None:
    """Place of one of the scan's slices along a normal, and their distance; None where none lie across it."""
    cosines = normal @ scan.direction_matrix
    axis = int(np.argmax(np.abs(cosines)))
    if 1.0 - abs(cosines[axis]) > COSINE_TOLERANCE:
        return None
    return float(normal @ np.array(scan.origin_mm)), scan.spacing_mm[axis]


def _is_even(planes: Float64, spacing: float, *, is_whole: bool = False) -> bool:
    """Whether planes, ascending, lie this far apart, or multiples of it; ``is_whole``: with no plane left out."""
    places = np.rint((planes - planes[0]) / spacing).astype(np.int64)
    steps = np.diff(places)
    if (steps < 1).any() or (is_whole and (steps > 1).any()):
        return False
    if not steps.size:
        return True
    _, fitted, distance = even_line(planes, places)
    tolerance = min(AGREEMENT_MM, PLACE_PART * spacing)
    return distance <= tolerance and abs(fitted - spacing) * places[-1] <= 2.0 * tolerance


def _stored(dataset: Any, count: int) -> Iterator[UInt16]:
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


def _unpacked(dataset: Any, count: int) -> Iterator[UInt8]:
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
