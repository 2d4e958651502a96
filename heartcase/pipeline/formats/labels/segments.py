"""What a file says of its segments, and the table in the header of a .seg.nrrd file, as 3D Slicer writes and reads it.

The name of a segment may be a patient's: it is compared with label names and goes into no message, which say
"segment 3 of the file".
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.arrays import UInt8, UInt16
from heartcase.schemas.errors import MarkerError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, Label
from heartcase.schemas.terms import term_by_code

__all__ = [
    "LabelVolume",
    "Overlap",
    "SegmentInfo",
    "Stacking",
    "count_overlaps",
    "in_file_order",
    "keep_all",
    "segment_table",
    "segments_of",
    "stacking_of",
]


@dataclass(frozen=True)
class SegmentInfo:
    """What a file says of one of its segments."""

    number: int
    """Its place in the file's list, from 1: how messages call it."""
    name: str
    """Its name; empty where it has none. Goes into no message."""
    snomed: str | None = None
    """SNOMED CT code of what it is, where the file gives one."""


@dataclass(frozen=True)
class Overlap:
    """Voxels that two segments of a file both mark."""

    under: int
    """Value of the segment that lost them."""
    over: int
    """Value of the segment that lies over it."""
    voxel_count: int
    """Voxels of the volume that lie in both; where a third lies over both, it has them."""


@dataclass(frozen=True)
class LabelVolume:
    """A label volume as its file holds it; overlapping segments are resolved."""

    values: UInt8 | UInt16
    """Values, uint8 or uint16, shape ``geometry.shape``; 0 where nothing is labelled."""
    geometry: Geometry
    """Where the voxel centres lie: the file's own grid."""
    segments: dict[int, SegmentInfo] = field(default_factory=dict)
    """Value -> its segment, where the file lists segments."""
    vanished: tuple[int, ...] = ()
    """Values of segments that mark something, but no voxel here: others cover it, or it lies off the lattice."""
    warnings: tuple[CaseWarning, ...] = ()
    """What was assumed in reading it, in plain words."""
    overlaps: tuple[Overlap, ...] = ()
    """Which segments overlap, by ascending values; none of those that are left out."""

    @property
    def marks_anything(self) -> bool:
        """Whether anything is labelled, be it on the lattice or not."""
        return bool(self.vanished) or bool(self.values.any())


@dataclass(frozen=True)
class _Segment:
    """One entry of the table."""

    name: str
    layer: int
    value: int
    snomed: str | None


def keep_all(segment: SegmentInfo) -> bool:
    """Leave no segment out."""
    return False


def in_file_order(segment: SegmentInfo) -> int:
    """Raise no segment over others: the later one of the file lies on top."""
    return 0


@dataclass(frozen=True)
class Stacking:
    """How the segments of a file lie over each other."""

    numbers: tuple[int, ...]
    """Numbers of the segments that are taken, from the lowest to the topmost."""
    place: UInt16
    """Number of a segment -> its place from the bottom, from 1; 0 for what is left out. Shape (segment count + 1,)."""

    @property
    def number(self) -> UInt16:
        """Place from the bottom -> number of the segment; 0 for 0."""
        return np.array((0, *self.numbers), np.uint16)

    def overlaps(self, found: Counter[tuple[int, int]]) -> tuple[Overlap, ...]:
        """Pairs of places with their counts of voxels, as overlaps of segments."""
        pairs = [(self.numbers[low - 1], self.numbers[high - 1], count) for (low, high), count in found.items()]
        return tuple(Overlap(*pair) for pair in sorted(pairs))


def stacking_of(
    segments: Iterable[SegmentInfo], left_out: Callable[[SegmentInfo], bool], rank: Callable[[SegmentInfo], int]
) -> Stacking:
    """Put segments in order: by their rank, those of one rank as the file lists them."""
    listed = list(segments)
    taken = sorted((one for one in listed if not left_out(one)), key=lambda one: (rank(one), one.number))
    place = np.zeros(max((one.number for one in listed), default=0) + 1, np.uint16)
    for at, one in enumerate(taken, start=1):
        place[one.number] = at
    return Stacking(tuple(one.number for one in taken), place)


def count_overlaps(layers: Sequence[UInt16]) -> Counter[tuple[int, int]]:
    """How many voxels lie in two segments each.

    Parameters
    ----------
    layers
        Places of segments in their stacking, uint16, all of one shape; 0 where a layer holds none.

    Returns
    -------
    Counter
        (lower place, higher place) -> voxels that lie in both. A voxel in three segments counts for three pairs.
    """
    found: Counter[tuple[int, int]] = Counter()
    depth = np.zeros(layers[0].shape, np.uint8) if layers else np.zeros(0, np.uint8)
    for layer in layers:
        np.add(depth, 1, out=depth, where=(layer != 0) & (depth < 2))
    where = np.flatnonzero(depth.ravel() > 1)
    if not len(where):
        return found
    columns = [layer.reshape(-1)[where].astype(np.int64) for layer in layers]
    for one, other in combinations(columns, 2):
        both = (one != 0) & (other != 0) & (one != other)
        if both.any():
            pair = np.minimum(one, other)[both] << 16 | np.maximum(one, other)[both]
            for code, count in zip(*np.unique(pair, return_counts=True), strict=True):
                found[int(code) >> 16, int(code) & 0xFFFF] += int(count)
    return found


def segments_of(
    values: UInt16,
    header: Mapping[str, str],
    left_out: Callable[[SegmentInfo], bool] = keep_all,
    rank: Callable[[SegmentInfo], int] = in_file_order,
) -> tuple[UInt16, dict[int, SegmentInfo], tuple[int, ...], tuple[Overlap, ...]]:
    """Resolve the layers of a segmentation to one value per voxel.

    Parameters
    ----------
    values
        Shape (z, y, x), or (z, y, x, layer) for several layers.
    header
        Key-value pairs of the NRRD header; empty for other formats.
    left_out
        Which segments nobody wants: they take no voxel from others, and count as vanished.
    rank
        How high each segment lies; of one rank the later one of the table lies on top.

    Returns
    -------
    values
        Shape (z, y, x). A single layer keeps its values; of several, segment n of the table (from 1) gets value n,
        and where segments overlap the one on top wins.
    segments
        Value -> segment; empty where the file has no table.
    vanished
        Values of segments that others cover wholly, or that are left out.
    overlaps
        Which segments overlap.

    Raises
    ------
    MarkerError
        There are several layers but no table that explains them, or the table is damaged.
    """
    segments = _segments(header, layer_count=values.shape[3] if values.ndim == 4 else 1)
    infos = {n: SegmentInfo(n, s.name, s.snomed) for n, s in enumerate(segments, start=1)}
    if values.ndim == 3:
        return values, {s.value: info for s, info in zip(segments, infos.values(), strict=True)}, (), ()
    if not segments:
        raise MarkerError("every voxel holds several values but no table names segments: export a plain label volume")
    stacking = stacking_of(infos.values(), left_out, rank)
    layers: list[UInt16] = []
    painted = set()
    for layer in range(values.shape[3]):
        # numbers of the segments, where values of the layer are theirs
        number = np.zeros(max(int(values[..., layer].max(initial=0)), *(s.value for s in segments)) + 1, np.uint16)
        for n, segment in enumerate(segments, start=1):
            if segment.layer == layer:
                number[segment.value] = n
        shown = number[values[..., layer]]
        if ((shown == 0) & (values[..., layer] != 0)).any():
            raise MarkerError(
                "the volume holds values that its segment table does not name: save it again in 3D Slicer"
            )
        painted |= set(np.unique(shown).tolist()) - {0}
        layers.append(stacking.place[shown])
    top = layers[0].copy()
    for one in layers[1:]:
        np.maximum(top, one, out=top)
    merged = stacking.number[top]
    vanished = tuple(sorted(painted - set(np.unique(merged).tolist())))
    return merged, infos, vanished, stacking.overlaps(count_overlaps(layers))


def _segments(header: Mapping[str, str], *, layer_count: int) -> list[_Segment]:
    entries: dict[int, dict[str, str]] = {}
    for key, text in header.items():
        match = re.fullmatch(r"Segment(\d{1,5})_(\w+)", key)
        if match:
            entries.setdefault(int(match.group(1)), {})[match.group(2)] = text
    segments = []
    for index, entry in sorted(entries.items()):
        name = " ".join(entry.get("Name", entry.get("ID", f"segment {index}")).split())[:64]
        try:
            # before 3D Slicer 4.11 every segment had a layer of its own, and value 1
            layer = int(entry.get("Layer", index if layer_count > 1 else 0))
            value = int(entry.get("LabelValue", 1))
        except ValueError:
            raise MarkerError("the segment table in the header is damaged: save the file again") from None
        if not 0 <= layer < layer_count or not 0 < value <= 65535:
            raise MarkerError("the segment table in the header does not fit the volume: save the file again")
        segments.append(_Segment(name, layer, value, _snomed(entry.get("Tags", ""))))
    if len({(segment.layer, segment.value) for segment in segments}) < len(segments):
        raise MarkerError("two segments of the table share a value: save the file again in 3D Slicer")
    return segments


def _snomed(tags: str) -> str | None:
    """SNOMED CT code of the segment's type, out of ``context~category~type~...``."""
    entry = re.search(r"TerminologyEntry:[^~|]*~[^~|]*~SCT\^([0-9]{6,18})\^", tags)
    return entry.group(1) if entry else None


def segment_table(segmentation: Segmentation, *, offset: tuple[int, int, int] = (0, 0, 0)) -> dict[str, str]:
    """Key-value pairs that make an NRRD file a segmentation for 3D Slicer.

    Parameters
    ----------
    segmentation
        Labels and their table; every label but the background becomes a segment, also an empty one.
    offset
        Index of the scan's voxel that is the first of the labels, where they are cropped.

    Returns
    -------
    dict
        In the order in which they are to be written.
    """
    pairs = {
        "Segmentation_MasterRepresentation": "Binary labelmap",
        "Segmentation_ContainedRepresentationNames": "Binary labelmap|",
        "Segmentation_ReferenceImageExtentOffset": " ".join(map(str, offset)),
    }
    labels = [label for label in segmentation.table if label.value != BACKGROUND]
    for index, label in enumerate(labels):
        colour = " ".join(f"{int(label.colour[at : at + 2], 16) / 255:.6g}" for at in (1, 3, 5))
        entry = {
            "ID": f"Segment_{label.value}",
            "Name": label.name,
            "NameAutoGenerated": "0",
            "Color": colour,
            "ColorAutoGenerated": "0",
            "LabelValue": str(label.value),
            "Layer": "0",
            "Extent": _extent(segmentation.labels, label.value),
            "Tags": _tags(label),
        }
        pairs |= {f"Segment{index}_{key}": text for key, text in entry.items()}
    return pairs


def _extent(labels: UInt8, value: int) -> str:
    inside = labels == value
    if not inside.any():
        return "0 -1 0 -1 0 -1"
    bounds = []
    for axis in (2, 1, 0):
        others = tuple(other for other in range(3) if other != axis)
        where = np.flatnonzero(inside.any(axis=others))
        bounds += [str(where[0]), str(where[-1])]
    return " ".join(bounds)


def _tags(label: Label) -> str:
    if label.snomed is None:
        return "|"
    context = "Segmentation category and type - 3D Slicer General Anatomy list"
    term = term_by_code(label.snomed)
    kind = f"SCT^{label.snomed}^{term.meaning if term else label.name}"
    anatomy = "Anatomic codes - DICOM master list~^^~^^"
    return f"TerminologyEntry:{context}~SCT^123037004^Anatomical Structure~{kind}~^^~{anatomy}|"
