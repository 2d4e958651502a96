"""Markers that nobody has to paint: the safe cores of a draft's labels, and voxels that are surely not heart.

A draft is any label map of the heart: a network's output, another tool's, last month's case. Its borders are not to be
trusted, its cores are; the watershed then finds the borders in the scan.

Automatic markers follow what is marked as heart, so they are worked out again as it grows. In a session that costs a
box around the brush: only where a stroke changes what counts as dark, or how far the heart reaches, is all of the scan
looked at again.
"""

from __future__ import annotations

from collections.abc import Collection

import cc3d
import edt
import numpy as np

from heartcase.pipeline.data import UNMARKED, Markers, Scan
from heartcase.schemas.arrays import Bool, Int64, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND

__all__ = ["ERASED", "AutomaticMarkers", "label_cores"]


ERASED = 254
"""Of a voxel that an eraser passed last: nothing is marked there, by the program neither. No label has this value."""
DEEP_PART = 0.75
"""Of a label without core: the part of a piece's greatest depth from which on its voxels are kept."""
SMALL_PIECE = 0.1
"""Pieces of less than this part of their label's largest piece are taken for noise where there is no core."""

LUNG_CT_HU = -500.0
DARK_PART = 0.5
"""Part of the way from the scan's darkest voxel to the marked heart below which a voxel is dark, where it is no CT."""
DARK_PERCENTILE = 5.0
DARK_STEPS = 4
"""Steps of this darkness for each doubling: else every stroke would change it by a little."""
REGION_CORE_MM = 3.0
REGION_LEAST_ML = 5.0
HEART_MARGIN_MM = 5.0
HEART_REACH_MM = 40.0
ROUNDING_MM = 1e-3
"""Less than any distance between voxels that matters, more than the rounding of one."""


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


class AutomaticMarkers:
    """What files and strokes mark, and the background that the program marks under it: nothing that is marked changes.

    *Dark* is, in a CT, what lies below -500 HU; in other scans what is darker than about half way (42 to 50%) from the
    darkest voxel of the scan to the 5th percentile of the voxels that are marked as heart. A dark region is marked
    where it is at least 3 mm inside the dark (the volume's border is none of its), and a connected part of that has
    more than 5 ml. Nothing is marked within 5 mm of a voxel that is marked as heart, nor where an eraser passed last;
    nothing at all where no heart is marked.

    ``lung``
        all dark regions: lungs, and air.
    ``background``
        the dark regions that reach the volume's border: air around the patient, lungs that the region of interest
        cuts; and whatever is more than 40 mm outside the box, along the scan's axes, around all that is marked as
        heart.

    Parameters
    ----------
    scan
        The scan, not smoothed or smoothed.
    kinds
        ``background``, ``lung``, both or none.
    stated
        What files and strokes mark, uint8, the scan's shape: a label, 255 where nothing, or :data:`ERASED`. Copied.
    """

    def __init__(self, scan: Scan, kinds: Collection[str], stated: UInt8) -> None:
        self.stated: UInt8 = stated.copy()
        """What files and strokes mark now."""
        self._scan = scan
        self._kinds = frozenset(kinds)
        self._heart = _is_heart(stated)
        self._near = self._near_heart(tuple(slice(0, n) for n in stated.shape))
        self._rules: tuple[float, tuple[slice, ...]] | None = None
        self._dark: Bool = np.zeros(stated.shape, np.bool_)
        self._candidates = self._dark
        self._apply_rules()
        self.found: Bool = self._candidates & ~self._near
        """Where the program would mark background if nothing were stated, bool, the scan's shape."""

    @property
    def markers(self) -> Markers:
        """All markers as they are now: a copy."""
        return Markers(labels=self._shown(self.stated, self.found), geometry=self._scan.geometry)

    def paint(self, voxels: Int64, values: UInt8 | int) -> tuple[Int64, UInt8]:
        """State something else of some voxels.

        Parameters
        ----------
        voxels
            Flat indices, int64.
        values
            A label, 255 or :data:`ERASED` for each or for all.

        Returns
        -------
        voxels
            All voxels whose marker may have changed, flat, ascending.
        values
            What marks each of them now, uint8; 255 for nothing.
        """
        flat = self.stated.reshape(-1)
        flat[voxels] = values
        voxels = np.union1d(voxels, self._follow(voxels))
        return voxels, self._shown(flat[voxels], self.found.reshape(-1)[voxels])

    def _shown(self, stated: UInt8, found: Bool) -> UInt8:
        labels = np.where(found & (stated == UNMARKED), np.uint8(BACKGROUND), stated)
        return np.where(stated == ERASED, np.uint8(UNMARKED), labels)

    def _follow(self, voxels: Int64) -> Int64:
        """Bring what is found up to date where voxels were painted; the voxels at which that changed it."""
        heart = self._heart.reshape(-1)
        is_heart = _is_heart(self.stated.reshape(-1)[voxels])
        voxels = voxels[heart[voxels] != is_heart]
        if not len(voxels):
            return voxels
        heart[voxels] = ~heart[voxels]
        index = np.unravel_index(voxels, self.stated.shape)
        box = tuple(
            slice(max(0, int(axis.min()) - margin), int(axis.max()) + margin + 1)
            for axis, margin in zip(index, self._margin, strict=True)
        )
        self._near[box] = self._near_heart(box)
        if self._apply_rules():
            box = tuple(slice(0, n) for n in self.stated.shape)
        now = self._candidates[box] & ~self._near[box]
        changed = np.stack(np.nonzero(now != self.found[box])) + np.array([[side.start] for side in box])
        self.found[box] = now
        flat: Int64 = np.ravel_multi_index(tuple(changed), self.stated.shape).astype(np.int64)
        return flat

    @property
    def _margin(self) -> tuple[int, ...]:
        """Voxels [z, y, x] that the margin around the heart reaches over, at most."""
        return tuple(int(HEART_MARGIN_MM / step) + 1 for step in self._scan.geometry.spacing_mm[::-1])

    def _near_heart(self, box: tuple[slice, ...]) -> Bool:
        """Which voxels of a box are too near to the marked heart, inside the box or outside."""
        wide = tuple(
            slice(max(0, side.start - margin), side.stop + margin)
            for side, margin in zip(box, self._margin, strict=True)
        )
        away = edt.edt(
            np.ascontiguousarray(~self._heart[wide]),
            anisotropy=self._scan.geometry.spacing_mm[::-1],
            black_border=False,
        )
        inner = tuple(slice(a.start - b.start, a.stop - b.start) for a, b in zip(box, wide, strict=True))
        near: Bool = away[inner] < HEART_MARGIN_MM - ROUNDING_MM
        return near

    def _apply_rules(self) -> bool:
        """Find dark and far regions again where another darkness or reach follows from the heart; whether it does."""
        rules = (self._dark_below(), self._reach()) if self._heart.any() and self._kinds else None
        if rules == self._rules:
            return False
        if rules is None:
            self._candidates = np.zeros(self._heart.shape, np.bool_)
        else:
            if self._rules is None or rules[0] != self._rules[0]:
                self._dark = self._dark_regions(rules[0])
            self._candidates = self._dark.copy()
            if "background" in self._kinds:
                far = np.ones(self._heart.shape, np.bool_)
                far[rules[1]] = False
                self._candidates |= far
        self._rules = rules
        return True

    def _dark_below(self) -> float:
        if self._scan.modality == "CT":
            return LUNG_CT_HU
        low = float(self._scan.values.min())
        part = DARK_PART * (float(np.percentile(self._scan.values[self._heart], DARK_PERCENTILE)) - low)
        if part <= 0.0:
            return low
        return low + float(2.0 ** (np.floor(DARK_STEPS * np.log2(part)) / DARK_STEPS))

    def _reach(self) -> tuple[slice, ...]:
        """Voxels [z, y, x] that are at most the reach outside the box around the marked heart, along every axis."""
        box = []
        for axis, step in enumerate(self._scan.geometry.spacing_mm[::-1]):
            used = np.flatnonzero(self._heart.any(axis=tuple(n for n in range(3) if n != axis)))
            reach = HEART_REACH_MM / step
            box.append(slice(max(0, int(np.ceil(used[0] - reach))), int(np.floor(used[-1] + reach)) + 1))
        return tuple(box)

    def _dark_regions(self, below: float) -> Bool:
        geometry = self._scan.geometry
        dark = np.ascontiguousarray(self._scan.values < below)
        core = edt.edt(dark, anisotropy=geometry.spacing_mm[::-1], black_border=False) >= REGION_CORE_MM
        regions = cc3d.connected_components(np.ascontiguousarray(core), connectivity=6)
        wanted = np.bincount(regions.ravel()) * (geometry.voxel_volume_mm3 / 1000.0) > REGION_LEAST_ML
        wanted[0] = False
        if "lung" not in self._kinds:
            at_border = np.zeros(len(wanted), np.bool_)
            for axis in range(3):
                for end in (0, -1):
                    at_border[np.unique(np.take(regions, end, axis=axis))] = True
            wanted &= at_border
        found: Bool = wanted[regions]
        return found


def _is_heart(stated: UInt8) -> Bool:
    heart: Bool = (stated != UNMARKED) & (stated != BACKGROUND) & (stated != ERASED)
    return heart
