"""Structures cut off by faces of the scan or of its region of interest, and voxels that are much longer than wide.

Looked for in the final labels, after end cuts and edits, so that a vessel that an end marker cuts inside is no finding.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cc3d
import numpy as np

from heartcase.pipeline.data import Segmentation, VesselEnd
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, anatomy, note
from heartcase.schemas.arrays import Bool, UInt8
from heartcase.schemas.bundle.coordinates import WAYS
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, Label, LabelTable, Role

__all__ = ["LENGTHWISE", "LONGEST_VOXEL", "cut_warnings", "face_name", "voxel_warnings"]

LONGEST_VOXEL = 3.0
"""Length of a voxel over its width from which on the shape between slices is not to be relied on."""
LENGTHWISE = 3.0
"""Length of a vessel's cut over its width from which on the face runs along the vessel: a round vessel that leaves at
an angle of 19 degrees to the face has a cut of this shape."""
STRAIGHT = 0.9
"""Cosine from which on an axis is called by the one direction that it runs towards."""


@dataclass(frozen=True)
class _Face:
    """A face of the lattice."""

    axis: int
    """0, 1, 2 for i, j, k."""
    is_last: bool
    """Whether it is the one of the highest index."""

    def layer(self, labels: UInt8) -> UInt8:
        """The voxels at the face, two-dimensional."""
        layer: UInt8 = np.take(labels, -1 if self.is_last else 0, axis=2 - self.axis)
        return layer

    def spacing_mm(self, geometry: Geometry) -> tuple[float, float]:
        """Distance of neighbours in the layer, along its rows and its columns."""
        first, second = (other for other in (2, 1, 0) if other != self.axis)
        return geometry.spacing_mm[first], geometry.spacing_mm[second]


_FACES = tuple(_Face(axis, is_last) for axis in (2, 1, 0) for is_last in (False, True))


def face_name(geometry: Geometry, axis: int, *, is_last: bool) -> str:
    """What to call a face of a lattice: by the side of the body that it looks to.

    Parameters
    ----------
    geometry
        The lattice; oblique as it may be.
    axis
        0, 1, 2 for i, j, k.
    is_last
        Whether it is the face of the highest index.

    Returns
    -------
    str
        Such as ``head face``; of the slice axis (k) of an oblique stack ``last slice (towards head and left)``.
    """
    outward = geometry.direction_matrix[:, axis] * (1.0 if is_last else -1.0)
    order = np.argsort(-np.abs(outward), kind="stable")
    words = [WAYS[n][int(outward[n] > 0.0)] for n in order if abs(outward[n]) > 1.0 - STRAIGHT]
    if abs(outward[order[0]]) >= STRAIGHT:
        return f"{words[0]} face"
    towards = " and ".join(words[:2])
    return f"{'last' if is_last else 'first'} slice (towards {towards})" if axis == 2 else f"face towards {towards}"


def voxel_warnings(geometry: Geometry) -> tuple[CaseWarning, ...]:
    """A warning where the scan's voxels are more than three times as long as wide."""
    shortest, longest = min(geometry.spacing_mm), max(geometry.spacing_mm)
    if longest <= LONGEST_VOXEL * shortest * (1.0 + 1e-6):
        return ()
    return (
        anatomy(
            sentence(
                "long-voxels",
                times=f"{longest / shortest:.1f}",
                shortest=f"{shortest:.3g}",
                longest=f"{longest:.3g}",
            ),
            code="long-voxels",
        ),
    )


def cut_warnings(
    labels: Segmentation, *, whole: Geometry | None = None, ends: Sequence[VesselEnd] = ()
) -> tuple[CaseWarning, ...]:
    """What the faces of the scan or of the region of interest cut off.

    Parameters
    ----------
    labels
        The final label of every voxel, grown walls included (:func:`heartcase.pipeline.bundle.assembly.labels_of`).
    whole
        Lattice of the whole scan, which the labels lie on a part of; None where it is not known. Then a face is told as
        one of the scan or its region.
    ends
        Where vessels end, as they were found: a vein that is a part of an atrium, and is open at a face, is told as a
        vessel.

    Returns
    -------
    tuple of CaseWarning
        For each face one line about chambers and heart muscle (the anatomy may be wrong), one about vessels that are
        cut along their length (to be looked at), and one about vessels that leave through it (for information), each
        with areas.
    """
    found: list[CaseWarning] = []
    for face in _FACES:
        found += _warnings_of(face, labels, whole, [end for end in ends if end.is_open])
    return tuple(found)


def _warnings_of(
    face: _Face, labels: Segmentation, whole: Geometry | None, open_ends: Sequence[VesselEnd]
) -> Iterator[CaseWarning]:
    layer, geometry = face.layer(labels.labels), labels.geometry
    spacing = face.spacing_mm(geometry)
    counts = np.bincount(layer.ravel(), minlength=256)
    areas = {label.value: float(counts[label.value]) * spacing[0] * spacing[1] for label in labels.table}
    cut: list[str] = []
    lengthwise: list[str] = []
    open_vessels: list[str] = []
    for label in labels.table:
        area = areas[label.value]
        if area == 0.0 or label.value == BACKGROUND:
            continue
        words = f"{label.name} ({_area(area)})"
        if label.wall_of is not None:
            if _is_of_whole_chamber(label, labels.table, areas):
                cut.append(words)
        elif label.role in (Role.BLOOD, Role.MYOCARDIUM):
            veins = _area_of_ends(face, labels, label, [end for end in open_ends if end.label == label.name])
            if veins < area:
                cut.append(f"{label.name} ({_area(area - veins)})")
            if veins > 0.0:
                open_vessels.append(f"veins of the {label.name} ({_area(veins)})")
        elif label.role is Role.VESSEL_LUMEN:
            is_along = _elongation(layer == label.value, spacing) > LENGTHWISE
            (lengthwise if is_along else open_vessels).append(words)
    name, is_of_region = _named(face, geometry, whole)
    if cut:
        kind = "heart-cut-off-by-region" if is_of_region else "heart-cut-off"
        yield anatomy(sentence(kind, face=name, listed=", ".join(cut)), code="heart-cut-off")
    if lengthwise:
        yield CaseWarning(
            sentence("vessel-cut-lengthwise", face=name, listed=", ".join(lengthwise)),
            code="vessel-cut-lengthwise",
        )
    if open_vessels:
        text = sentence("vessel-open-at-face", face=name, listed=", ".join(open_vessels))
        yield note(text, code="vessel-open-at-face")


def _area_of_ends(face: _Face, labels: Segmentation, label: Label, ends: Sequence[VesselEnd]) -> float:
    """Area of the pieces of a label's cut in which one of these ends lies, mm2."""
    if not ends:
        return 0.0
    geometry = labels.geometry
    spacing = face.spacing_mm(geometry)
    inside = face.layer(labels.labels) == label.value
    pieces = cc3d.connected_components(np.ascontiguousarray(inside.astype(np.uint8)), connectivity=4)
    where = np.argwhere(pieces)
    own = pieces[tuple(where.T)]
    last = geometry.size[face.axis] - 1
    across = [axis for axis in (2, 1, 0) if axis != face.axis]
    open_pieces: set[int] = set()
    for end in ends:
        index = geometry.world_to_index(end.position_mm)
        depth = last - index[face.axis] if face.is_last else index[face.axis]
        if abs(depth) > 1.0:
            continue
        way = np.hypot(*((where - index[across]) * spacing).T)
        if way.min() <= end.lumen_radius_mm + max(spacing):
            open_pieces.add(int(own[way.argmin()]))
    return float(np.isin(own, sorted(open_pieces)).sum()) * spacing[0] * spacing[1]


def _is_of_whole_chamber(wall: Label, table: LabelTable, areas: dict[int, float]) -> bool:
    """Whether this is the grown wall of a chamber that does not itself reach the face."""
    cavity = table[wall.wall_of] if wall.wall_of is not None and wall.wall_of in table else None
    return cavity is not None and cavity.role is Role.BLOOD and areas[cavity.value] == 0.0


def _named(face: _Face, geometry: Geometry, whole: Geometry | None) -> tuple[str, bool]:
    """What to call a face in a sentence, and whether it may be the region's rather than the scan's."""
    name = face_name(geometry, face.axis, is_last=face.is_last)
    if whole is None:
        return f"the {name} of the scan or its region of interest", True
    first = round(float(whole.world_to_index(geometry.origin_mm)[face.axis]))
    at = first + geometry.size[face.axis] if face.is_last else first
    is_scans = at == (whole.size[face.axis] if face.is_last else 0)
    return f"the {name} of the {'scan' if is_scans else 'region of interest'}", not is_scans


def _elongation(inside: Bool, spacing_mm: tuple[float, float]) -> float:
    """Length over width of the largest piece of a cut: of the ellipse with its second moments."""
    pieces = cc3d.connected_components(np.ascontiguousarray(inside.astype(np.uint8)), connectivity=8)
    counts = np.bincount(pieces.ravel())
    counts[0] = 0
    points = np.argwhere(pieces == int(counts.argmax())) * np.array(spacing_mm)
    # a pixel has a second moment of its own, which keeps a single one round
    moments = np.cov(points.T, bias=True) if len(points) > 1 else np.zeros((2, 2))
    low, high = np.linalg.eigvalsh(moments + np.diag(np.array(spacing_mm) ** 2) / 12.0)
    return float(np.sqrt(high / low))


def _area(area_mm2: float) -> str:
    return f"{area_mm2 / 100.0:.1f} cm²" if area_mm2 >= 100.0 else f"{area_mm2:.0f} mm²"
