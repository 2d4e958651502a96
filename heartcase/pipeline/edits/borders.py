"""Moving the border of a bare structure in a part of the volume; the stored fields still divide space after it.

The fields of :class:`~heartcase.pipeline.data.Structures` are one per structure. Where one of them gets a new border,
its neighbours get theirs: what it leaves goes to the nearest other structure, what it takes is theirs no more. With f
the new field of the structure, v the stored ones and K the lowest but one's own of the others, a neighbour M is where
``max((v_M - v_K) / 2, -f)`` is below zero. These zero levels meet without gap or overlap; each is then made a distance
again (:func:`heartcase.pipeline.fields.distance.signed_distance`). Nothing changes farther than the band from where the
border moved.
"""

from __future__ import annotations

from dataclasses import replace

import edt
import numpy as np

from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields.distance import signed_distance
from heartcase.pipeline.kernels.boxes import Box
from heartcase.schemas.arrays import Bool, Float32, Float64, UInt8

__all__ = ["Borders", "Box", "distance_beyond_band"]


STILL_MM = 1e-4
"""A border that moves by less has not moved."""
SAME_VOXELS = 0.02
"""Distances to the old and the new border that differ by less, in voxels, are the same."""
FACE_VOXELS = 2.0
"""How near its border a field's change is a move of the border."""
PADDING = 3
"""Voxels by which the faces are continued straight on beyond the volume's border."""


class Borders:
    """The stored fields of some structures, to be changed: arrays are copied when they are first written to."""

    def __init__(self, structures: Structures) -> None:
        self.structures = structures
        self.fields = dict(structures.distance_mm)
        self._copied: set[int] = set()

    @property
    def spacing_mm(self) -> Float64:
        """Voxel size along z, y, x."""
        return np.array(self.structures.geometry.spacing_mm)[::-1]

    @property
    def changed(self) -> Structures:
        """The structures with the fields as they are now; the same ones where nothing moved."""
        return replace(self.structures, distance_mm=dict(self.fields)) if self._copied else self.structures

    def box_around(self, low: Float64, high: Float64, margin_mm: float) -> Box | None:
        """Box of voxels from one index (i, j, k) to another and a margin, within the volume; None where it is empty."""
        size = np.array(self.structures.geometry.size)
        reach = margin_mm / np.array(self.structures.geometry.spacing_mm)
        first = np.clip(np.floor(low - reach), 0, size).astype(int)
        last = np.clip(np.ceil(high + reach) + 1, 0, size).astype(int)
        if np.any(last <= first):
            return None
        i, j, k = (slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
        return k, j, i

    def owner(self) -> UInt8:
        """Label whose field is lowest at each voxel (ties: the lower value), shape of the fields."""
        return self._owner_in((slice(None),) * 3)[0]

    def _owner_in(self, box: Box) -> tuple[UInt8, Float32]:
        """Label whose field is lowest at each voxel of a box (ties: the lower value), and that field."""
        values = sorted(self.fields)
        lowest = self.fields[values[0]][box].copy()
        owner = np.full(lowest.shape, values[0], np.uint8)
        for value in values[1:]:
            field = self.fields[value][box]
            lower = field < lowest
            owner[lower] = value
            np.copyto(lowest, field, where=lower)
        return owner, lowest

    def move(self, value: int, box: Box, field: Float32, into: int | None = None) -> bool:
        """Give a structure a new border.

        Parameters
        ----------
        value
            The structure's label value.
        box
            Part of the volume; at least twice the band beyond what changes, or up to the volume's border.
        field
            float32, shape of the box: about the distance to the new border in mm near its zero level, negative inside.
            Just the stored field where nothing changes.
        into
            The structure that gets what this one leaves; the nearest other one, point by point, when None.

        Returns
        -------
        bool
            Whether anything moved.
        """
        own = self.fields[value][box]
        near_face = np.minimum(np.abs(own), np.abs(field)) < FACE_VOXELS * self.spacing_mm.max()
        moved = ((field < 0.0) != (own < 0.0)) | (near_face & (np.abs(field - own) > STILL_MM))
        if not moved.any():
            return False
        band = self.structures.band_mm
        away = np.asarray(edt.edt(~moved, anisotropy=tuple(float(v) for v in self.spacing_mm), parallel=1))
        zone = away <= band
        leads = {value: (own, field)}
        others = sorted(set(self.fields) - {value})
        lowest, second, nearest = self._two_lowest(others, box)
        for number, other in enumerate(others):
            theirs = self.fields[other][box]
            lead = np.float32(0.5) * (theirs - np.where(nearest == number, second, lowest))
            before = np.maximum(lead, -own)
            if into == other:
                lead = np.minimum(lead, own)
            elif into is not None:
                lead = before
            leads[other] = (before, np.maximum(lead, -field))
        owner, _ = self._owner_in(box)
        for label, (before, after) in leads.items():
            if (before != after)[zone].any():
                self._write(label, box, zone, before, after)
        self._keep_owners(value, box, owner)
        return True

    def _keep_owners(self, value: int, box: Box, owner: UInt8) -> None:
        """Where a voxel went from one of the others to another, lower its owner's field to what is lowest there.

        Only what a structure takes or leaves changes hands. But where three fields are within rounding of each other,
        one that is made a distance again can come to lie above one that is not.
        """
        now, lowest = self._owner_in(box)
        lost = (owner != now) & (owner != value) & (now != value)
        for label in np.unique(owner[lost]):
            mine = lost & (owner == label)
            self._writable(int(label))[box][mine] = np.nextafter(lowest[mine], np.float32(-np.inf))

    def replace_beyond(self, value: int, distance: Float32) -> None:
        """Take another field where the stored one is farther outside than the band; at least the band."""
        field = self._writable(value)
        np.copyto(field, np.maximum(distance, self.structures.band_mm), where=field > self.structures.band_mm)

    def _writable(self, value: int) -> Float32:
        if value not in self._copied:
            self.fields[value] = self.fields[value].copy()
            self._copied.add(value)
        return self.fields[value]

    def _two_lowest(self, values: list[int], box: Box) -> tuple[Float32, Float32, UInt8]:
        """Lowest and second lowest field in the box, and the number of the lowest (ties: the first)."""
        shape = self.fields[values[0]][box].shape
        far = np.float32(2.0 * np.linalg.norm(np.array(self.structures.geometry.shape) * self.spacing_mm))
        lowest, second = np.full(shape, far, np.float32), np.full(shape, far, np.float32)
        nearest = np.full(shape, 255, np.uint8)
        for number, value in enumerate(values):
            field = self.fields[value][box]
            lower = field < lowest
            second = np.where(lower, lowest, np.minimum(second, field))
            lowest = np.where(lower, field, lowest)
            nearest[lower] = number
        return lowest, second, nearest

    def _write(self, value: int, box: Box, zone: Bool, before: Float32, after: Float32) -> None:
        """Take the distance to a new zero level where it is not that to the old one: elsewhere every bit stays."""
        band = np.float32(self.structures.band_mm)
        was, near = (self.distance_to(lead, box, float(band)) for lead in (before, after))
        known, was_known = np.isfinite(near), np.isfinite(was)
        other = (known != was_known) | ((before < 0.0) != (after < 0.0))
        both = known & was_known
        other[both] |= np.abs(near[both] - was[both]) > SAME_VOXELS * self.spacing_mm.min()
        field = self._writable(value)[box]
        kept = np.where((field < 0.0) == (after < 0.0), np.abs(field), np.float32(0.0))
        far = np.copysign(np.maximum(kept, band), after)
        np.copyto(field, np.where(known, near, far), where=zone & other)

    def distance_to(self, first_order: Float32, box: Box, band_mm: float) -> Float32:
        """Signed distance to a zero level in a box, infinite beyond the band; faces go on beyond the volume."""
        pads = [
            (PADDING if part.start == 0 else 0, PADDING if part.stop == size else 0)
            if part.stop - part.start > PADDING
            else (0, 0)
            for part, size in zip(box, self.structures.geometry.shape, strict=True)
        ]
        padded = np.pad(first_order, pads, mode="reflect", reflect_type="odd")
        near = signed_distance(padded, self.structures.geometry.spacing_mm, band_mm=band_mm)
        inner = tuple(slice(low, low + n) for (low, _), n in zip(pads, first_order.shape, strict=True))
        return near[inner]


def distance_beyond_band(inside: Bool, spacing_mm: Float64) -> Float32:
    """Distance to the voxels of a mask less half a voxel, mm, as the stored fields have it beyond their band.

    ``spacing_mm`` is along z, y, x. Where the mask is empty it is the volume's diagonal.
    """
    if not inside.any():
        return np.full(inside.shape, np.linalg.norm(np.array(inside.shape) * spacing_mm), np.float32)
    distance = np.asarray(edt.edt(~inside, anisotropy=tuple(float(v) for v in spacing_mm), parallel=1))
    nearer: Float32 = distance - np.float32(0.5 * spacing_mm.mean())
    return nearer
