"""Cutting vessels open at end markers: the lumen runs on through the disc, and the vessel is cut there.

A lumen that rounds off at the disc, or stops short of it, would get a wall over its mouth. So its label is continued
along the disc's axis, by the last cross-section that is not yet its rounded tip, as far as the wall and the smoothing
reach; what lies further out loses its label; the exact plane is a reshaping of the structures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cc3d
import numba
import numpy as np
from scipy.ndimage import binary_dilation, map_coordinates

from heartcase.compiling.kernel import loop_kernel
from heartcase.pipeline.data import Reshaping, Segmentation, VesselEnd
from heartcase.pipeline.vessel_ends.discs import Disc, Sides, Stumps, disc_of, end_marker, meets, sides_of
from heartcase.pipeline.vessel_ends.find_ends import FoundEnds, find_ends
from heartcase.pipeline.vessel_ends.snap_ends import advice_for, moved_words, snapped_end
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, anatomy
from heartcase.schemas.arrays import Bool, Float64, UInt8
from heartcase.schemas.errors import Problem, StageError
from heartcase.schemas.labels import BACKGROUND, Label, LabelTable, Role
from heartcase.schemas.recipe.settings import EndMarker

__all__ = ["EndCuts", "closed_vessels", "cut_ends"]


FULL_SHARE = 0.9
"""Least part of its area that a cross-section keeps over half a radius, where the lumen is not yet its tip."""
SPECK_SHARE = 0.2
"""Cross-sections of less than this part of the usual area are a spike of the tip."""
BODY_SHARE = 0.5
"""Cross-sections that reach more than this part of the disc's rim belong to the chamber that the vessel leaves."""
OPEN_SHARE = 0.5
"""Part of its area that the lumen must keep to count as open."""
GAP_VOXELS = 2.0
"""Gap between lumen and disc that is closed without a word."""
HALF = 0.5 - 1e-6
"""Where points lie halfway between voxels, whatever the rounding."""
SECTION_SAMPLES = 4
"""Sections that are averaged, over up to 1.5 voxels, into the one that is continued."""


@dataclass(frozen=True)
class EndCuts:
    """What the end markers make of a segmentation."""

    labels: UInt8
    """Labels with the vessels continued through their discs and cleared beyond the stumps."""
    reshapings: tuple[Reshaping, ...]
    """The cut at each marker that meets its vessel, in order."""
    ends: tuple[EndMarker, ...]
    """The markers that cut, as stated, moved or found."""
    vessel_ends: tuple[VesselEnd, ...]
    """The same with what is known of them; where ends were sought, also those that are open at a face of the volume."""
    warnings: tuple[CaseWarning, ...]
    """Markers that do not meet their vessel or were moved, lumens that were continued over a gap, and branches without
    an end."""


def cut_ends(
    segmentation: Segmentation,
    table: LabelTable,
    ends: Sequence[EndMarker],
    stumps: Stumps,
    *,
    find: bool = False,
) -> EndCuts:
    """Make each vessel run straight on through its end marker, and take its label from the voxels beyond.

    A stump stays so that the fields are undisturbed at the plane; a reshaping takes it away. Where the lumen rounds off
    before the stump's end, or stops up to the disc's radius short of the disc, its last full cross-section is continued
    along the axis: into background only, and nowhere beside other blood. No part of a stump comes so near the rim that
    its wall would stick out of the cylinder behind the disc, which is all that is cut off.
    A marker that does not cut its vessel is moved onto it where it is clear which one is meant
    (:mod:`heartcase.pipeline.vessel_ends.snap_ends`).

    Parameters
    ----------
    segmentation
        Labels; not changed.
    table
        Label table with the grown walls.
    ends
        End markers.
    stumps
        What is left behind the discs.
    find
        Cut also what :func:`heartcase.pipeline.vessel_ends.find_ends.find_ends` finds beside the ends of the markers.

    Returns
    -------
    EndCuts
        Labels, cuts, and what the user must know.

    Raises
    ------
    StageError
        For every marker that lies outside the volume, whose label is not in the segmentation, or that does not cut
        through its vessel: with the numbers that would.
    """
    work = _Work(segmentation, table, stumps)
    problems: list[Problem] = []
    for number, end in enumerate(ends, start=1):
        problem = work.cut_stated(f"ends[{number}]", end)
        if problem is not None:
            problems.append(problem)
    if problems:
        raise StageError(problems)
    if find:
        work.cut_found(find_ends(segmentation, table, stumps, known=work.met))
    return EndCuts(work.labels, tuple(work.cuts), tuple(work.met), tuple(work.vessel_ends), tuple(work.warnings))


class _Work:
    """Cuts one end after the other."""

    def __init__(self, segmentation: Segmentation, table: LabelTable, stumps: Stumps) -> None:
        self.segmentation, self.table, self.stumps = segmentation, table, stumps
        self.labels = segmentation.labels.copy()
        self.cuts: list[Reshaping] = []
        self.met: list[EndMarker] = []
        self.vessel_ends: list[VesselEnd] = []
        self.warnings: list[CaseWarning] = []
        self._found: dict[int, tuple[VesselEnd, ...]] = {}

    def cut_stated(self, place: str, end: EndMarker) -> Problem | None:
        """Cut at a marker of the recipe; why that cannot be."""
        label = self.table.find(end.label)
        if label is None:
            return Problem(place, f"there is no label {end.label!r}: check the name")
        if not (self.segmentation.labels == label.value).any():
            message = f"there is no '{label.name}' in the segmentation: check the markers, or remove this end marker"
            return Problem(place, message)
        disc = self._disc(end, label)
        sides = sides_of(self.segmentation.labels, disc) if disc is not None else None
        is_met = disc is not None and meets(self.segmentation.labels, disc)
        if disc is not None and sides is not None and sides.is_divided and is_met:
            self._cut(f"{place} ({label.name})", end, label, disc, sides, "stated")
            if _cuts_heart_off(self.segmentation, self.table, sides):
                self.warnings.append(anatomy(f"{place} ({label.name}): {sentence('end-cuts-heart')}"))
            return None
        moved = snapped_end(self.segmentation, label, end, self.stumps, self._ends_of(label))
        disc_there = self._disc(moved, label) if moved is not None else None
        sides_there = sides_of(self.segmentation.labels, disc_there) if disc_there is not None else None
        if moved is not None and disc_there is not None and sides_there is not None:
            self.warnings.append(CaseWarning(f"{place} ({label.name}): {moved_words(end, moved)}"))
            self._cut(f"{place} ({label.name})", moved, label, disc_there, sides_there, "moved")
            return None
        advice = advice_for(self.segmentation, label, end, self._ends_of(label))
        if disc is None:
            return Problem(place, f"the disc lies outside the volume; of '{label.name}', {advice}")
        if sides is not None and not sides.is_divided:
            return Problem(place, f"the disc does not cut through '{label.name}'; {advice}")
        away = _way_to_vessel(self.segmentation, disc)
        self.warnings.append(anatomy(f"{place} ({label.name}): {away}; {advice}"))
        return None

    def cut_found(self, found: FoundEnds) -> None:
        """Cut at the ends that the search found."""
        for end in found.ends:
            label = self.table[end.label]
            if end.is_open:
                self.vessel_ends.append(end)
                continue
            marker = end_marker(end)
            disc = self._disc(marker, label)
            sides = sides_of(self.segmentation.labels, disc) if disc is not None else None
            if disc is not None and sides is not None:
                place = ", ".join(f"{v:.1f}" for v in end.position_mm)
                self._cut(f"the end of the {label.name} at ({place}) mm", marker, label, disc, sides, "found", end)
        self.warnings += [anatomy(words) for words in found.dropped]

    def _disc(self, end: EndMarker, label: Label) -> Disc | None:
        return disc_of(self.segmentation, end, label.value, self.stumps.wall_mm(label), self.stumps.clearance_mm)

    def _ends_of(self, label: Label) -> tuple[VesselEnd, ...]:
        """Ends of one label, looked for once."""
        if label.value not in self._found:
            found = find_ends(self.segmentation, self.table, self.stumps, only=(label.value,))
            self._found[label.value] = found.ends
        return self._found[label.value]

    def _cut(
        self,
        place: str,
        marker: EndMarker,
        label: Label,
        disc: Disc,
        sides: Sides,
        how: str,
        known: VesselEnd | None = None,
    ) -> None:
        _clear_beyond(self.labels, sides, disc)
        found, radius_mm = _continue_lumen(self.labels, disc, self.table.blood_values)
        self.warnings += [replace(one, text=f"{place}: {one.text}") for one in found]
        self.met.append(marker)
        self.cuts.append(_reshaping(disc, marker, self.table))
        axis = tuple(round(float(v), 6) for v in disc.axis)
        stated = VesselEnd(label.name, marker.position_mm, axis, marker.radius_mm, round(radius_mm, 1), found=how)  # type: ignore[arg-type]
        self.vessel_ends.append(known or stated)


def _reshaping(disc: Disc, end: EndMarker, table: LabelTable) -> Reshaping:
    wall = table.wall_value(disc.value)
    sources = (table[disc.value].name,) if wall is None else (table[disc.value].name, table[wall].name)
    far = disc.position + 2.0 * disc.clearance_mm * disc.axis
    points = (end.position_mm, (float(far[0]), float(far[1]), float(far[2])))
    return Reshaping("cylinder", points, end.radius_mm, sources, (table[BACKGROUND].name,))


def _way_to_vessel(segmentation: Segmentation, disc: Disc) -> str:
    """What is wrong where the vessel does not come near the disc from the heart's side."""
    where = np.argwhere(segmentation.labels == disc.value)
    offset = disc.geometry.index_to_world(where[:, ::-1]) - disc.position
    along = offset @ disc.axis
    across = np.sqrt(np.maximum(np.einsum("nx,nx->n", offset, offset) - along * along, 0.0))
    distance = np.hypot(along, np.maximum(across - disc.radius_mm, 0.0))
    nearest = int(distance.argmin())
    remedy = "move its position_mm onto the vessel's end, or add a stroke to the vessel there"
    if along[nearest] > 0.0 and across[nearest] <= disc.radius_mm:
        remedy = "turn its axis round so that it points out of the heart, or move its position_mm"
    return f"the segmented vessel ends {distance[nearest]:.1f} mm away from this end marker and stays closed: {remedy}"


def _cuts_heart_off(segmentation: Segmentation, table: LabelTable, sides: Sides) -> bool:
    """Whether what is cut off is more than what stays, and touches a chamber, as where the axis is the wrong way."""
    gone = np.isin(sides.pieces, sorted(sides.after))
    if 2 * np.count_nonzero(gone) <= np.count_nonzero(sides.pieces):
        return False
    chambers = [label.value for label in table if label.role is Role.BLOOD]
    value = segmentation.labels[sides.box]
    own = value[gone][0]
    others = np.isin(value, [one for one in chambers if one != own])
    return bool((binary_dilation(gone) & others).any())


def _clear_beyond(labels: UInt8, sides: Sides, disc: Disc) -> None:
    """Take the label from what is connected to the vessel beyond its stump, in place."""
    beyond = np.isin(sides.pieces, sorted(sides.after))
    beyond[sides.disc_box] &= ~disc.stump
    labels[sides.box][beyond] = BACKGROUND


def _continue_lumen(labels: UInt8, disc: Disc, blood_values: Sequence[int]) -> tuple[list[CaseWarning], float]:
    """Continue a lumen through its disc in place; what the user must know, and the radius of the section, mm."""
    near = labels[disc.box]
    lumen = _lumen_before(near, disc)
    steps, areas, rims = _areas(lumen, disc)
    first, last = _full_sections(steps, areas, rims > BODY_SHARE, disc)
    is_outside = (disc.along >= 0.0) & ~disc.stump
    near[lumen & is_outside] = BACKGROUND
    at_disc = int(np.searchsorted(steps, min(last, 0.0)))
    radius_mm = float(np.sqrt(areas[at_disc] / np.pi))
    if last >= disc.clearance_mm:
        return [], radius_mm
    section = _continued(lumen, disc, first, last)
    blood = np.isin(near, list(blood_values)) & ~lumen
    beyond = disc.cylinder & (disc.along > last)
    grown = section & beyond & ~is_outside & (near == BACKGROUND) & ~binary_dilation(blood)
    tail = lumen & beyond & (disc.along > 0.0) & ~section
    near[tail] = BACKGROUND
    near[grown] = disc.value
    messages = []
    voxel = float(max(disc.geometry.spacing_mm))
    gap = -float(disc.along[lumen].max()) - 0.5 * voxel
    if gap > GAP_VOXELS * voxel:
        messages.append(CaseWarning(sentence("end-continued", mm=f"{gap:.1f}")))
    _, opened, _ = _areas((near == disc.value) & disc.cylinder, disc)
    if opened[steps <= 0.0][-1] < OPEN_SHARE * areas[np.searchsorted(steps, last)]:
        messages.append(anatomy(sentence("end-shut")))
    return messages, radius_mm


def _lumen_before(near: UInt8, disc: Disc) -> Bool:
    """Find the vessel's largest piece in the disc's cylinder that comes near the disc from the heart's side."""
    pieces = cc3d.connected_components((near == disc.value) & disc.cylinder, connectivity=6)
    close = (disc.along < 0.0) & (disc.along >= -disc.radius_mm)
    counts = np.bincount(pieces[close & (pieces > 0)].ravel(), minlength=2)
    lumen: Bool = pieces == int(counts.argmax())
    return lumen


def _areas(lumen: Bool, disc: Disc) -> tuple[Float64, Float64, Float64]:
    """Cross-sections along the axis: places, mm beyond the disc, areas, mm2, and parts of the rim in the lumen."""
    step = 0.5 * float(min(disc.geometry.spacing_mm))
    side = np.cross(disc.axis, np.eye(3)[np.argmin(np.abs(disc.axis))])
    side /= np.linalg.norm(side)
    count = int(np.ceil(disc.radius_mm / step))
    u, v = np.meshgrid(*(2 * [np.arange(-count, count + 1) * step]))
    within = np.hypot(u, v) <= disc.radius_mm
    is_rim = np.hypot(u[within], v[within]) > disc.radius_mm - step
    flat = disc.position + u[within][:, None] * side + v[within][:, None] * np.cross(disc.axis, side)
    places = np.arange(-np.floor(3.0 * disc.radius_mm / step), np.floor(disc.clearance_mm / step) + 1) * step
    corner = np.array([part.start for part in disc.box[::-1]])
    ends = disc.geometry.world_to_index(np.stack([disc.position, disc.position + disc.axis]))
    index = (disc.geometry.world_to_index(flat) - corner)[:, ::-1]
    way = (ends[1] - ends[0])[::-1]
    inside, inside_rim = np.empty(len(places), np.int64), np.empty(len(places), np.int64)
    _count_inside(np.ascontiguousarray(lumen), np.ascontiguousarray(index), way, places, is_rim, inside, inside_rim)
    return places, step * step * inside.astype(np.float64), inside_rim / np.count_nonzero(is_rim)


@loop_kernel
def _count_inside(mask, points, way, places, is_rim, inside, inside_rim):
    """Count the points of a section, and of its rim, in a mask (half of it or more, linearly) at each place."""
    nz, ny, nx = mask.shape
    for n in numba.prange(len(places)):
        count, rim_count = 0, 0
        for p in range(len(points)):
            z = min(max(points[p, 0] + places[n] * way[0], 0.0), nz - 1.0)
            y = min(max(points[p, 1] + places[n] * way[1], 0.0), ny - 1.0)
            x = min(max(points[p, 2] + places[n] * way[2], 0.0), nx - 1.0)
            k, j, i = int(z), int(y), int(x)
            c, b, a = z - k, y - j, x - i
            kk, jj, ii = min(k + 1, nz - 1), min(j + 1, ny - 1), min(i + 1, nx - 1)
            low = (1.0 - b) * ((1.0 - a) * mask[k, j, i] + a * mask[k, j, ii]) + b * (
                (1.0 - a) * mask[k, jj, i] + a * mask[k, jj, ii]
            )
            high = (1.0 - b) * ((1.0 - a) * mask[kk, j, i] + a * mask[kk, j, ii]) + b * (
                (1.0 - a) * mask[kk, jj, i] + a * mask[kk, jj, ii]
            )
            if (1.0 - c) * low + c * high >= HALF:
                count += 1
                if is_rim[p]:
                    rim_count += 1
        inside[n], inside_rim[n] = count, rim_count


def _full_sections(places: Float64, areas: Float64, is_body: Bool, disc: Disc) -> tuple[float, float]:
    """First and last place, mm beyond the disc, of the stretch that is continued: it ends where the rounded tip begins.

    Both are the clearance where the lumen runs on by itself. The stretch belongs to the vessel alone: where it leaves a
    chamber, or another vessel, just before the disc, what is left of it may be hardly longer than a thick slice.
    """
    there = areas > 0.0
    if areas[-1] >= OPEN_SHARE * max(areas[places <= 0.0][-1], areas[there].min(initial=np.inf)):
        return disc.clearance_mm, disc.clearance_mm
    step = places[1] - places[0]
    voxel = float(max(disc.geometry.spacing_mm))
    end = int(np.flatnonzero(there)[-1])
    tip = float(places[end])
    start = int(np.flatnonzero(is_body)[-1]) + 1 if is_body.any() else 0
    # A lumen wider than its disc looks like a body up to its very tip.
    start = 0 if (end + 1 - start) * step <= voxel else start
    vessel = there & (places >= max(places[start], tip - disc.radius_mm))
    usual = float(np.median(areas[vessel]))
    radius = np.sqrt(usual / np.pi)
    lag = max(1, round(max(0.5 * radius, voxel) / step))
    first = start + lag
    share = np.zeros(len(areas))
    np.divide(areas[first:], areas[start:-lag], out=share[first:], where=areas[start:-lag] > 0.0)
    is_spike = areas < SPECK_SHARE * usual
    share[is_spike | (places < tip - 1.5 * disc.radius_mm)] = 0.0
    is_full = share >= FULL_SHARE
    stays_full = is_full.copy()
    half = max(1, lag // 2)
    stays_full[half:] &= is_full[:-half]
    if stays_full.any():
        is_full = stays_full
    # Nothing keeps its area where the vessel is shorter than that: then half a radius is taken for the tip.
    back = half if is_full.any() else round(0.5 * radius / step)
    last = max(int(np.flatnonzero(is_full if is_full.any() else ~is_spike)[-1]) - back, start)
    other = np.flatnonzero(areas[: last + 1] * FULL_SHARE > areas[last])
    return float(places[int(other[-1]) + 1 if len(other) else 0]), float(places[last])


def _continued(lumen: Bool, disc: Disc, first: float, last: float) -> Bool:
    """Voxels whose projection along the axis onto the sections from ``first`` to ``last`` mostly lies in the lumen."""
    voxel = float(max(disc.geometry.spacing_mm))
    ends = disc.geometry.world_to_index(np.stack([disc.position, disc.position + disc.axis]))
    direction = (ends[1] - ends[0])[::-1]
    where = np.argwhere(disc.cylinder & (disc.along > last))
    way = disc.along[tuple(where.T)] - last
    mask = lumen.astype(np.float32)
    share = np.zeros(len(where))
    for back in np.linspace(0.0, min(1.5 * voxel, last - first), SECTION_SAMPLES):
        source = where - (way + back)[:, None] * direction
        share += map_coordinates(mask, source.T, order=1, mode="nearest")
    section = np.zeros(lumen.shape, np.bool_)
    section[tuple(where[share >= 0.5 * SECTION_SAMPLES].T)] = True
    return section


def closed_vessels(segmentation: Segmentation, ends: Sequence[EndMarker | VesselEnd]) -> tuple[CaseWarning, ...]:
    """Warn of vessels that nothing cuts open: no end is theirs, and they end inside the volume.

    A wall closes such a vessel like a sac, which no vessel of a heart is.
    """
    cut = {segmentation.table[end.label].value for end in ends}
    labels = segmentation.labels
    sides = [np.unique(labels.take(index, axis)) for axis in range(3) for index in (0, -1)]
    at_border = set(np.concatenate(sides).tolist())
    present = set(np.unique(labels).tolist())
    return tuple(
        anatomy(sentence("closed-sac", label=label.name))
        for label in segmentation.table
        if label.role is Role.VESSEL_LUMEN
        and label.value in present
        and label.value not in at_border
        and label.wall_thickness_mm > 0.0
        and label.value not in cut
    )
