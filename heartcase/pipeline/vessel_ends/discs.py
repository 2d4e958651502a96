"""The disc of an end marker on the lattice: the parts of its vessel on both sides, and whether it cuts it through."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cc3d
import numpy as np
from scipy.ndimage import binary_dilation

from heartcase.pipeline.data import Segmentation, VesselEnd
from heartcase.pipeline.kernels.boxes import Box
from heartcase.schemas.arrays import Bool, Float64, Int64, UInt8, UInt32
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable
from heartcase.schemas.recipe.resolved import ResolvedWalls
from heartcase.schemas.recipe.settings import EndMarker

__all__ = [
    "Disc",
    "Sides",
    "Stumps",
    "disc_of",
    "end_marker",
    "is_beside_blood",
    "is_clean",
    "meets",
    "radii_for",
    "sides_of",
]


STUMP_TAPER = 0.1
"""How much narrower the room for a stump gets per mm behind the disc: a lumen is known to a part of a voxel only."""


FEW_VOXELS = 2
"""Other blood beside a stump that does not count."""


@dataclass(frozen=True)
class Stumps:
    """What is left of vessels behind their discs."""

    clearance_mm: float
    """Length of a stump: more than the thickest wall and the reach of the smoothing."""
    thickness_mm: Mapping[int, float]
    """Label value -> greatest thickness of its wall, where it is not the table's."""

    @classmethod
    def of(cls, settings: ResolvedWalls, table: LabelTable, spacing_mm: tuple[float, float, float]) -> Stumps:
        """Stumps for the walls of some settings on a lattice."""
        clearance_mm = settings.thickest_mm(table) + 3.0 * settings.smoothing_mm + 2.0 * max(spacing_mm)
        return cls(clearance_mm, {table[one.label].value: max(one.thickness_mm) for one in settings.thickness})

    def wall_mm(self, label: Label) -> float:
        """Greatest thickness of a vessel's wall."""
        return self.thickness_mm.get(label.value, label.wall_thickness_mm)

    @property
    def reach_mm(self) -> float:
        """How far behind a disc vessel and wall are taken away."""
        return 2.0 * self.clearance_mm


@dataclass(frozen=True)
class Disc:
    """An end marker, its vessel's value, and the part of the lattice around it."""

    value: int
    """Label value of the vessel."""
    position: Float64
    """Centre, world mm."""
    axis: Float64
    """Unit vector out of the heart."""
    radius_mm: float
    """Radius."""
    wall_mm: float
    """Thickness of the vessel's wall; no lumen is left beyond the disc whose wall would stick out of the cylinder."""
    clearance_mm: float
    """Length of the stump."""
    geometry: Geometry
    """The lattice."""
    box: Box
    """Part of the lattice from three radii before the disc to the stump's end."""
    along: Float64
    """Distance beyond the disc's plane of each voxel of the box, mm, shape [z, y, x]."""
    across: Float64
    """Distance from the disc's axis, mm."""

    @property
    def cylinder(self) -> Bool:
        """Voxels of the box in front of the disc and behind it."""
        return (self.across <= self.radius_mm) & (self.along <= self.clearance_mm)

    @property
    def stump(self) -> Bool:
        """Voxels of the box behind the disc whose wall, were they lumen, would lie in the cylinder that is cut off."""
        room = self.radius_mm - self.wall_mm - STUMP_TAPER * self.along
        return self.cylinder & (self.along >= 0.0) & (self.across <= room)


def disc_of(segmentation: Segmentation, end: EndMarker, value: int, wall_mm: float, clearance_mm: float) -> Disc | None:
    """Look at the lattice around an end marker; None outside the volume."""
    geometry = segmentation.geometry
    position = np.array(end.position_mm)
    axis = np.array(end.axis) / np.linalg.norm(end.axis)
    middles = geometry.world_to_index(position + np.outer([-3.0 * end.radius_mm, clearance_mm], axis))
    reach = end.radius_mm / np.array(geometry.spacing_mm) + 1.0
    low = np.maximum(np.floor(middles.min(axis=0) - reach), 0).astype(int)
    high = np.minimum(np.ceil(middles.max(axis=0) + reach) + 1, geometry.size).astype(int)
    index = geometry.world_to_index(position)
    size = np.array(geometry.size)
    if np.any(high <= low) or np.any(index < -reach) or np.any(index > size - 1 + reach):
        return None
    box = (slice(low[2], high[2]), slice(low[1], high[1]), slice(low[0], high[0]))
    k, j, i = np.meshgrid(*(np.arange(part.start, part.stop) for part in box), indexing="ij")
    offset = geometry.index_to_world(np.stack([i, j, k], axis=-1)) - position
    along = offset @ axis
    across = np.sqrt(np.maximum(np.einsum("...x,...x->...", offset, offset) - along * along, 0.0))
    return Disc(value, position, axis, end.radius_mm, wall_mm, clearance_mm, geometry, box, along, across)


@dataclass(frozen=True)
class Sides:
    """A vessel without the layer at the disc, in pieces."""

    before: set[int]
    """Pieces that lie right before the disc."""
    after: set[int]
    """Pieces that lie right beyond it."""
    pieces: UInt32
    """Piece of each voxel of a box around the vessel and the disc; 0 off the vessel."""
    box: Box
    """That box."""
    disc_box: Box
    """The disc's box within that box."""

    @property
    def is_divided(self) -> bool:
        """Whether no piece lies on both sides."""
        return not self.before & self.after


def sides_of(labels: UInt8, disc: Disc) -> Sides | None:
    """The vessel's pieces; None where there is no such vessel."""
    vessel = labels == disc.value
    there = [np.flatnonzero(vessel.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
    if len(there[0]) == 0:
        return None
    z, y, x = (
        slice(min(int(one[0]), part.start), max(int(one[-1]) + 1, part.stop))
        for one, part in zip(there, disc.box, strict=True)
    )
    box = (z, y, x)
    c, b, a = (slice(part.start - of.start, part.stop - of.start) for part, of in zip(disc.box, box, strict=True))
    disc_box = (c, b, a)
    voxel = float(max(disc.geometry.spacing_mm))
    on_disc = disc.across <= disc.radius_mm
    divided = vessel[box]
    divided[disc_box] &= ~(on_disc & (disc.along >= 0.0) & (disc.along <= 1.8 * voxel))
    pieces = cc3d.connected_components(np.ascontiguousarray(divided), connectivity=6)
    near = pieces[disc_box]
    before = {int(n) for n in np.unique(near[on_disc & (disc.along < 0.0) & (disc.along >= -1.8 * voxel)])} - {0}
    after = {int(n) for n in np.unique(near[on_disc & (disc.along > 1.8 * voxel) & (disc.along <= 3.6 * voxel)])} - {0}
    return Sides(before, after, pieces, box, disc_box)


def meets(labels: UInt8, disc: Disc) -> bool:
    """Whether the vessel comes within a radius of the disc from the heart's side."""
    vessel = labels[disc.box] == disc.value
    close = (disc.across <= disc.radius_mm) & (disc.along < 0.0) & (disc.along >= -disc.radius_mm)
    return bool(np.any(vessel & close))


def end_marker(end: VesselEnd) -> EndMarker:
    """What a recipe says for an end that is cut."""
    return EndMarker(label=end.label, position_mm=end.position_mm, axis=end.axis, radius_mm=end.radius_mm)


def radii_for(extent_mm: float, wall_mm: float, stumps: Stumps, voxel_mm: float) -> tuple[float, ...]:
    """Radii that a disc may have around a lumen: with room for a whole stump, and with less where others are near."""
    room = (STUMP_TAPER * stumps.clearance_mm + 0.5 * voxel_mm, 0.5 * voxel_mm, 0.25 * voxel_mm)
    return tuple(extent_mm + wall_mm + one for one in room)


def is_clean(
    segmentation: Segmentation, end: EndMarker, label: Label, stumps: Stumps, *, within: Int64 | None = None
) -> bool:
    """Whether a disc cuts its vessel through, and takes nothing else of the label away.

    Parameters
    ----------
    segmentation
        Labels.
    end
        The disc.
    label
        Its label.
    stumps
        What the cut leaves.
    within
        Voxels (z, y, x) that all that is cut off must be among. Where left out it must be less than what stays: a disc
        that points into the heart cuts the heart off.
    """
    disc = disc_of(segmentation, end, label.value, stumps.wall_mm(label), stumps.clearance_mm)
    sides = sides_of(segmentation.labels, disc) if disc is not None else None
    if disc is None or sides is None or not sides.is_divided or not meets(segmentation.labels, disc):
        return False
    return _takes_only(segmentation, disc, sides, stumps, within)


def is_beside_blood(segmentation: Segmentation, end: EndMarker, label: Label, stumps: Stumps, blood: Bool) -> bool:
    """Whether the lumen behind a disc touches other blood: there that one's wall would be taken away with it."""
    disc = disc_of(segmentation, end, label.value, stumps.wall_mm(label), stumps.clearance_mm)
    if disc is None:
        return False
    own = (segmentation.labels[disc.box] == label.value) & disc.cylinder & (disc.along >= 0.0)
    others = blood[disc.box] & (segmentation.labels[disc.box] != label.value)
    return bool(np.count_nonzero(binary_dilation(own) & others) > FEW_VOXELS)


def _takes_only(segmentation: Segmentation, disc: Disc, sides: Sides, stumps: Stumps, within: Int64 | None) -> bool:
    gone = np.isin(sides.pieces, sorted(sides.after))
    if within is not None:
        may_go = np.zeros(segmentation.labels.shape, np.bool_)
        may_go[tuple(within.T)] = True
        if (gone & ~may_go[sides.box]).any():
            return False
    elif 2 * np.count_nonzero(gone) > np.count_nonzero(sides.pieces):
        return False
    rest = np.argwhere((sides.pieces > 0) & ~gone) + [part.start for part in sides.box]
    offset = disc.geometry.index_to_world(rest[:, ::-1]) - disc.position
    along = offset @ disc.axis
    far = np.linalg.norm(offset - along[:, None] * disc.axis, axis=1)
    reach = disc.radius_mm + disc.wall_mm
    return not bool(((along > 1.8 * max(disc.geometry.spacing_mm)) & (along <= stumps.reach_mm) & (far <= reach)).any())
