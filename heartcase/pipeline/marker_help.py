"""Markers that nobody has to paint: the safe cores of a draft's labels, and what is surely not heart.

A draft is any label map of the heart: a network's output, another tool's, last month's case. Its borders are not to be
trusted, its cores are; the watershed then finds the borders in the scan.
"""

from __future__ import annotations

from collections.abc import Collection

import cc3d
import edt
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Markers, Scan
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND

__all__ = ["automatic_background", "label_cores", "with_automatic"]

Bool = npt.NDArray[np.bool_]
UInt8 = npt.NDArray[np.uint8]

UNMARKED = Markers.UNMARKED
DEEP_PART = 0.75
"""Of a label without core: the part of a piece's greatest depth from which on its voxels are kept."""
SMALL_PIECE = 0.1
"""Pieces of less than this part of their label's largest piece are taken for noise where there is no core."""

LUNG_CT_HU = -500.0
DARK_PART = 0.5
"""Part of the marked heart's darkness below which a voxel counts as air, where the scan is not a CT."""
DARK_PERCENTILE = 5.0
REGION_CORE_MM = 3.0
REGION_LEAST_ML = 5.0
HEART_MARGIN_MM = 5.0
HEART_REACH_MM = 40.0


def label_cores(labels: UInt8, geometry: Geometry, core_mm: float) -> UInt8:
    """Shrink each label of a draft to its core.

    Parameters
    ----------
    labels
        Label of each voxel of the draft, uint8, shape ``geometry.shape``; 255 where it says nothing.
    geometry
        Its lattice.
    core_mm
        Least distance of a core's voxel to the centre of the nearest voxel that is not of its label, mm. What lies
        beyond the volume's border counts as the same label.

    Returns
    -------
    ndarray
        uint8, same shape; 255 outside the cores. No label is lost: of one that is nowhere ``core_mm`` deep, every
        piece (over faces) of a tenth of the largest one's volume or more keeps the voxels that are at least three
        quarters as deep as its deepest.
    """
    numbers = np.where(labels == UNMARKED, 0, labels.astype(np.uint16) + 1).astype(np.uint16)
    depth = edt.edt(np.ascontiguousarray(numbers), anisotropy=geometry.spacing_mm[::-1], black_border=False)
    # a label that fills the whole volume is infinitely deep
    cores = np.where((numbers > 0) & (depth >= core_mm), labels, np.uint8(UNMARKED))
    lost = set(np.unique(labels).tolist()) - set(np.unique(cores).tolist()) - {UNMARKED}
    for value in sorted(lost):
        pieces = cc3d.connected_components(labels == value, connectivity=6)
        counts = np.bincount(pieces.ravel())
        deepest = np.zeros(len(counts), depth.dtype)
        np.maximum.at(deepest, pieces.ravel(), depth.ravel())
        large = counts >= SMALL_PIECE * counts[1:].max()
        large[0] = False
        cores[large[pieces] & (depth >= DEEP_PART * deepest[pieces])] = value
    return cores


def with_automatic(markers: Markers, scan: Scan, kinds: Collection[str]) -> Markers:
    """Markers with the automatic ones under them: nothing that is marked is changed.

    Parameters
    ----------
    markers
        What was painted, from files and strokes.
    scan
        The scan, not smoothed or smoothed, on the markers' lattice.
    kinds
        ``background``, ``lung``, both or none; see :func:`automatic_background`.
    """
    if not kinds:
        return markers
    found = automatic_background(markers, scan, kinds)
    labels = np.where(found & (markers.labels == UNMARKED), np.uint8(BACKGROUND), markers.labels)
    return Markers(labels=labels, geometry=markers.geometry)


def automatic_background(markers: Markers, scan: Scan, kinds: Collection[str]) -> Bool:
    """Voxels that are surely not heart, bool, the scan's shape.

    *Dark* is, in a CT, what lies below -500 HU; in other scans what is darker than half of the 5th percentile of the
    voxels that are marked as heart. A dark region is marked where it is at least 3 mm inside the dark (the volume's
    border is none of its), and a connected part of that has more than 5 ml. Nothing is marked within 5 mm of a voxel
    that is marked as heart; nothing at all where no heart is marked.

    ``lung``
        all dark regions: lungs, and air.
    ``background``
        the dark regions that reach the volume's border: air around the patient, lungs that the region of interest
        cuts; and whatever is more than 40 mm outside the box, along the scan's axes, around all that is marked as heart.
    """
    heart = (markers.labels != UNMARKED) & (markers.labels != BACKGROUND)
    found = np.zeros(heart.shape, np.bool_)
    if not heart.any() or not kinds:
        return found
    spacing = scan.geometry.spacing_mm[::-1]
    dark = np.ascontiguousarray(scan.values < _dark_below(scan, heart))
    core = edt.edt(dark, anisotropy=spacing, black_border=False) >= REGION_CORE_MM
    regions = cc3d.connected_components(np.ascontiguousarray(core), connectivity=6)
    wanted = np.bincount(regions.ravel()) * (scan.geometry.voxel_volume_mm3 / 1000.0) > REGION_LEAST_ML
    wanted[0] = False
    if "lung" not in kinds:
        at_border = np.zeros(len(wanted), np.bool_)
        for axis in range(3):
            for end in (0, -1):
                at_border[np.unique(np.take(regions, end, axis=axis))] = True
        wanted &= at_border
    found |= wanted[regions]
    if "background" in kinds:
        found |= _far_outside(heart, scan.geometry)
    away = edt.edt(np.ascontiguousarray(~heart), anisotropy=spacing, black_border=False)
    found &= away >= HEART_MARGIN_MM
    return found


def _dark_below(scan: Scan, heart: Bool) -> float:
    if scan.modality == "CT":
        return LUNG_CT_HU
    return DARK_PART * float(np.percentile(scan.values[heart], DARK_PERCENTILE))


def _far_outside(heart: Bool, geometry: Geometry) -> Bool:
    """Voxels more than the reach outside the box around the marked heart, along any axis of the scan."""
    far = np.ones(heart.shape, np.bool_)
    box = []
    for axis, step in enumerate(geometry.spacing_mm[::-1]):
        used = np.flatnonzero(heart.any(axis=tuple(n for n in range(3) if n != axis)))
        reach = HEART_REACH_MM / step
        low = max(0, int(np.ceil(used[0] - reach)))
        box.append(slice(low, int(np.floor(used[-1] + reach)) + 1))
    far[tuple(box)] = False
    return far
