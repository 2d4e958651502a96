"""Ends of one label: on each branch, from outside in, the first place where a disc cuts it clean."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cc3d
import edt
import numpy as np

from heartcase.pipeline.data import Segmentation, VesselEnd
from heartcase.pipeline.vessel_ends.appendage import Surroundings
from heartcase.pipeline.vessel_ends.discs import (
    Disc,
    Stumps,
    disc_of,
    end_marker,
    is_beside_blood,
    is_clean,
    radii_for,
    sides_of,
)
from heartcase.pipeline.vessel_ends.inflow import LEAST_VOXELS, kind_of, sources_of
from heartcase.pipeline.vessel_ends.lumen_branches import Branch, find_branches
from heartcase.pipeline.vessel_ends.lumen_sections import Lumen, Section, across, angle_between
from heartcase.schemas.arrays import Bool, Float32, Float64, UInt32
from heartcase.schemas.labels import Label, LabelTable
from heartcase.schemas.recipe.settings import EndMarker

__all__ = ["LabelSearch"]


TUBE_SHARES = (1.15, 1.6, 2.2)
"""A lumen is a tube where its section becomes no more than so many times larger or smaller towards the heart. A branch
is searched once with each, so that a tapering tip is cut where it has become a tube. The last one is for vessels
alone: what widens so fast on an atrium is a bulge of it."""
TUBE_PLACES = (0.4, 0.8)
"""How far before the disc that is looked at, in radii of the section."""
SECTION_RADII = 4.0
"""How far around a point its section is looked at, in radii of the largest ball there."""
ROUNDNESS = 0.3
"""Least part of the circle around it that a section fills."""
REACH_RADII, REACH_MM = 3.0, 25.0
"""How far before a tip a place for the disc is looked for: the greater of the two."""
BRANCH_SHARE = 0.75
"""A vein of an atrium's label is narrower than this part of the atrium."""
TWIG_VOXELS = 1.5
TWIG_SHARE, VEIN_SHARE = 0.2, 0.15
"""Least radius of an arm, in longest sides of a voxel, and as a part of the radius of the largest ball in the label.
The last one is for veins of an atrium: they are no wider where it is dilated."""
JOINT_RADII = 4.0
"""Where one of several arms cannot be cut, all are cut behind their joint, if that is no farther than so many radii."""
MOST_BESIDE = 6
"""So many places whose stump would touch other blood are tried before the first of them is taken."""
CAP_SHARE = 0.35
"""A lumen whose tip touches other blood over more than this part of its section goes on there."""
AHEAD_RADII = 5.0
"""How far ahead of a vein there is no other chamber, in radii of its section."""
TURN_DEGREES = 50.0
"""A plane that turns by more than this from the way of the lumen is none across it."""

_FAULTS = ("a disc across it would cut other parts of the same label", "it widens or narrows too fast")


@dataclass(frozen=True)
class _Arm:
    """A branch without its twigs: from the tip that is left to where it joins another arm."""

    parts: tuple[Branch, ...]
    """From outside in; the way goes on from each to the next."""
    arms: tuple[_Arm, ...]
    """Arms that join it: none, or two and more."""


@dataclass(frozen=True)
class _Candidate:
    """A section that a disc may take."""

    branch: Branch
    section: Section
    change: float
    """How many times larger or smaller the lumen becomes towards the heart, 1 and more."""


@dataclass(frozen=True)
class _Outcome:
    """What became of an arm."""

    ends: tuple[VesselEnd, ...]
    reasons: tuple[str, ...]
    """Why there is no disc, in plain words."""
    is_settled: bool
    """Whether nothing of it stays closed."""


@dataclass(frozen=True)
class LabelSearch:
    """One label, ready to be searched."""

    label: Label
    segmentation: Segmentation
    stumps: Stumps
    blood: tuple[int, ...]
    """Values of blood."""
    around: Surroundings
    """What tells an appendage from a vein."""
    mask: Bool
    """The label's voxels that no known disc cuts off."""
    sources: Bool
    known: tuple[Disc, ...]
    lumen: Lumen
    at_face: UInt32
    """Number of the place at the volume's faces where the lumen leaves it; 0 elsewhere."""
    depth_mm: Float32
    """Distance from the border, 0 outside."""
    widest_mm: float
    """Radius of the largest ball in it."""
    middle: Float64
    """Centre of that ball, world mm."""
    valve: Float64
    """Middle of the sources, world mm."""

    @classmethod
    def of(
        cls,
        segmentation: Segmentation,
        table: LabelTable,
        label: Label,
        stumps: Stumps,
        known: Sequence[EndMarker],
    ) -> LabelSearch | None:
        """Prepare the search for one label; None where there is hardly any of it."""
        geometry = segmentation.geometry
        mask = segmentation.labels == label.value
        if np.count_nonzero(mask) < LEAST_VOXELS:
            return None
        discs = []
        for end in known:
            if table.find(end.label) != label:
                continue
            disc = disc_of(segmentation, end, label.value, stumps.wall_mm(label), stumps.clearance_mm)
            sides = sides_of(segmentation.labels, disc) if disc is not None else None
            if disc is None or sides is None or not sides.is_divided:
                continue
            discs.append(disc)
            mask[sides.box] &= ~np.isin(sides.pieces, sorted(sides.after))
        sources = sources_of(segmentation, table, label, mask)
        depth = edt.edt(mask, anisotropy=geometry.spacing_mm[::-1], black_border=False)
        deepest = np.array(np.unravel_index(int(depth.argmax()), mask.shape))
        return cls(
            label,
            segmentation,
            stumps,
            table.blood_values,
            Surroundings.of(segmentation, table, label),
            mask,
            sources,
            tuple(discs),
            Lumen.of(segmentation.labels == label.value, geometry),
            cc3d.connected_components(np.ascontiguousarray(mask & _border_of(mask.shape)), connectivity=26),
            depth,
            float(depth.max()),
            geometry.index_to_world(deepest[::-1]),
            geometry.index_to_world(np.argwhere(sources)[:, ::-1].mean(axis=0)),
        )

    @property
    def _is_atrium(self) -> bool:
        return kind_of(self.label) == "atrium"

    @property
    def _step_mm(self) -> float:
        return max(self.segmentation.geometry.spacing_mm)

    @property
    def _least_radius_mm(self) -> float:
        """Arms that are narrower are twigs: the vessel is cut before them."""
        share = VEIN_SHARE if self._is_atrium else TWIG_SHARE
        return max(TWIG_VOXELS * self._step_mm, share * self.widest_mm)

    def ends(self) -> tuple[list[VesselEnd], list[str]]:
        """Ends and branches without one."""
        ends: dict[tuple[float, float, float], VesselEnd] = {}
        reasons: list[str] = []
        for trunk in find_branches(self.mask, self.segmentation.geometry.spacing_mm, self.sources):
            if len(trunk.index) < LEAST_VOXELS:
                continue
            # an atrium's trunk is the atrium itself
            outcomes = [self._of_arm(one) for one in (self._arms_of(trunk) if self._is_atrium else [self._arm(trunk)])]
            # two branches may leave through one place of a face
            ends |= {end.position_mm: end for outcome in outcomes for end in outcome.ends}
            reasons += [reason for outcome in outcomes for reason in outcome.reasons]
        return list(ends.values()), reasons

    def _arm(self, branch: Branch) -> _Arm:
        """A branch without its twigs."""
        arms = self._arms_of(branch)
        if len(arms) == 1:
            return _Arm((*arms[0].parts, branch), arms[0].arms)
        return _Arm((branch,), tuple(arms))

    def _arms_of(self, branch: Branch) -> list[_Arm]:
        """The arms that join a branch, without twigs."""
        return [self._arm(one) for one in branch.arms if self._radius_of(one) >= self._least_radius_mm]

    def _radius_of(self, branch: Branch) -> float:
        """Median radius of a circle of the lumen's area, over the way from a branch's foot to its top."""
        back = branch.top_mm - branch.way_mm[branch.way_mm <= branch.top_mm]
        counts = np.bincount((back / self._step_mm).astype(np.int64))
        area = counts * self.segmentation.geometry.voxel_volume_mm3 / self._step_mm
        own = float(np.median(np.sqrt(area / np.pi))) if len(area) else 0.0
        return max([own, *(self._radius_of(one) for one in branch.arms)])

    def _of_arm(self, arm: _Arm) -> _Outcome:
        """Ends of an arm: of those that join it, or else its own."""
        if not arm.arms:
            settled = self._settled(arm)
            if settled is not None and all(end.radius_mm >= self._least_radius_mm for end in settled.ends):
                return settled
            # a vessel that is narrow where it leaves the volume is better cut before that
            found = self._disc_on(arm)
            return found if found.is_settled or settled is None else settled
        outcomes = [self._of_arm(one) for one in arm.arms]
        ends = tuple(end for outcome in outcomes for end in outcome.ends)
        reasons = tuple(reason for outcome in outcomes for reason in outcome.reasons)
        if all(outcome.is_settled for outcome in outcomes):
            return _Outcome(ends, (), is_settled=True)
        behind = self._disc_on(arm)
        if behind.is_settled and self._loses_little(behind.ends[0], ends) and self._takes_all(behind.ends[0], arm):
            return behind
        return _Outcome(ends, reasons, is_settled=False)

    def _loses_little(self, behind: VesselEnd, ends: Sequence[VesselEnd]) -> bool:
        """Whether a disc behind a joint lies near those beyond it, which it makes needless."""
        away = [float(np.linalg.norm(np.subtract(end.position_mm, behind.position_mm))) for end in ends]
        return max(away, default=0.0) <= JOINT_RADII * behind.lumen_radius_mm

    def _takes_all(self, behind: VesselEnd, arm: _Arm) -> bool:
        """Whether a disc behind a joint cuts off each of the arms that meet there."""
        wall_mm, clearance_mm = self.stumps.wall_mm(self.label), self.stumps.clearance_mm
        disc = disc_of(self.segmentation, end_marker(behind), self.label.value, wall_mm, clearance_mm)
        sides = sides_of(self.segmentation.labels, disc) if disc is not None else None
        if sides is None:
            return False
        tips = np.array([one.parts[0].index[0] for one in arm.arms]) - [part.start for part in sides.box]
        # none has a tip in the disc's own layer
        return bool(np.isin(sides.pieces[tuple(tips.T)], [0, *sides.after]).all())

    def _settled(self, arm: _Arm) -> _Outcome | None:
        """What there is at an arm's tip already: a face, a known disc, or other blood; None where there is nothing."""
        branch = arm.parts[0]
        near = branch.index[branch.way_mm >= branch.way_mm[0] - 1.5 * self._step_mm]
        points = self.segmentation.geometry.index_to_world(near[:, ::-1])
        for disc in self.known:
            offset = points - disc.position
            along = offset @ disc.axis
            far = np.linalg.norm(offset - along[:, None] * disc.axis, axis=1)
            if ((np.abs(along) <= disc.radius_mm) & (far <= disc.radius_mm)).any():
                return _Outcome((), (), is_settled=True)
        reach = max(2.0 * self._radius_of(branch), 3.0 * self._step_mm)
        outer = branch.index[branch.way_mm >= branch.way_mm[0] - reach]
        numbers = self.at_face[tuple(outer.T)]
        if numbers.any():
            ends = [self._at_face(int(number)) for number in np.unique(numbers[numbers > 0])]
            return _Outcome(tuple(ends), (), is_settled=True)
        return _Outcome((), (), is_settled=True) if self._goes_on(branch) else None

    def _goes_on(self, branch: Branch) -> bool:
        """Whether other blood lies at the tip of a branch."""
        spacing, labels = self.segmentation.geometry.spacing_mm, self.segmentation.labels
        radius = self._radius_of(branch)
        cap = branch.index[branch.way_mm >= branch.way_mm[0] - max(0.5 * radius, 1.5 * self._step_mm)]
        area = 0.0
        for axis in range(3):
            face_mm2 = float(np.prod(spacing)) / spacing[2 - axis]
            for sign in (-1, 1):
                beside = cap.copy()
                beside[:, axis] += sign
                inside = (beside[:, axis] >= 0) & (beside[:, axis] < labels.shape[axis])
                value = labels[tuple(beside[inside].T)]
                area += face_mm2 * np.count_nonzero(np.isin(value, self.blood) & (value != self.label.value))
        return area >= CAP_SHARE * np.pi * radius**2

    def _at_face(self, number: int) -> VesselEnd:
        """Where the lumen leaves the volume."""
        geometry = self.segmentation.geometry
        index = np.argwhere(self.at_face == number)
        last = np.array(self.mask.shape) - 1
        sides = [(axis, sign) for axis in range(3) for sign in (-1, 1)]
        counts = [np.count_nonzero(index[:, a] == (0 if s < 0 else last[a])) for a, s in sides]
        axis, sign = sides[int(np.argmax(counts))]
        area = max(counts) * geometry.voxel_volume_mm3 / geometry.spacing_mm[2 - axis]
        radius = float(np.sqrt(area / np.pi))
        middle = index[index[:, axis] == (0 if sign < 0 else last[axis])].mean(axis=0)
        middle[axis] += 0.5 * sign
        out = sign * geometry.direction_matrix[:, 2 - axis]
        position = geometry.index_to_world(middle[::-1])
        return _end(self.label, position, out, radius, radius, is_open=True)

    def _disc_on(self, arm: _Arm) -> _Outcome:
        """A disc on an arm, or why there is none; no reason where it is no vessel."""
        if self._is_atrium and self._is_appendage(arm):
            return _Outcome((), (), is_settled=False)
        shares = TUBE_SHARES[:-1] if self._is_atrium else TUBE_SHARES
        reasons: list[str] = []
        for places, cut in ((self._places(arm), across), (self._places_straight(arm), Lumen.section)):
            looked_at: list[_Candidate] = []
            beside: list[VesselEnd] = []
            for least, most in itertools.pairwise((0.0, *shares)):
                # the first round looks at the places, the others go over what it found
                for one in looked_at or self._candidates(places, cut, looked_at, reasons):
                    end = self._end_at(one.section, one.branch) if least < one.change <= most else None
                    if end is None:
                        continue
                    if self._is_free(end) or len(beside) == MOST_BESIDE:
                        return _Outcome((beside[0] if len(beside) == MOST_BESIDE else end,), (), is_settled=True)
                    beside.append(end)
            if beside:
                return _Outcome((beside[0],), (), is_settled=True)
            reasons += [_FAULTS[0 if one.change <= shares[-1] else 1] for one in looked_at]
        if self._is_atrium and _FAULTS[0] not in reasons:
            return _Outcome((), (), is_settled=False)
        tip = self.segmentation.geometry.index_to_world(arm.parts[0].index[0][::-1])
        place = ", ".join(f"{v:.1f}" for v in tip)
        why = max(sorted({*reasons}), key=reasons.count) if reasons else "it is too short"
        why = _FAULTS[0] if _FAULTS[0] in reasons else why
        return _Outcome((), (f"the {self.label.name} ends near ({place}) mm and was not cut there: {why}",), False)

    def _candidates(
        self,
        places: Iterator[tuple[Branch, Float64, Float64]],
        cut: Callable[[Lumen, Float64, Float64, float], Section | None],
        kept: list[_Candidate],
        reasons: list[str],
    ) -> Iterator[_Candidate]:
        """Sections that may take a disc; they are also put into ``kept``, and why others may not into ``reasons``."""
        for branch, point, axis in places:
            ball = self._ball_at(point)
            if self._is_atrium and ball > BRANCH_SHARE * self.widest_mm:
                continue
            section = cut(self.lumen, point, axis, SECTION_RADII * max(ball, self._step_mm))
            why, change = self._judged(section, point, axis)
            if why or section is None:
                reasons.append(why)
                continue
            kept.append(_Candidate(branch, section, change))
            yield kept[-1]

    def _is_free(self, end: VesselEnd) -> bool:
        blood = np.isin(self.segmentation.labels, self.blood)
        return not is_beside_blood(self.segmentation, end_marker(end), self.label, self.stumps, blood)

    def _end_at(self, section: Section, branch: Branch) -> VesselEnd | None:
        """The end with the widest disc at a section that takes nothing but the branch away; None where none does."""
        wall = self.stumps.wall_mm(self.label)
        for one in (self._outermost(section), section):
            for radius in radii_for(self._extent(one), wall, self.stumps, self._step_mm):
                end = _end(self.label, one.middle, one.axis, radius, one.radius_mm)
                if is_clean(self.segmentation, end_marker(end), self.label, self.stumps, within=branch.index):
                    return end
        return None

    def _ball_at(self, point: Float64) -> float:
        """Radius of the largest ball in the lumen near a point."""
        index = np.rint(self.segmentation.geometry.world_to_index(point)).astype(int)[::-1]
        low, high = np.maximum(index - 2, 0), np.minimum(index + 3, self.mask.shape)
        part = self.depth_mm[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
        return float(part.max(initial=0.0))

    def _places(self, arm: _Arm) -> Iterator[tuple[Branch, Float64, Float64]]:
        """Middles of the lumen along an arm, and its way out there, from outside in, no farther than makes sense."""
        points, step, gone_mm = np.empty((0, 3)), self._step_mm, 0.0
        last: Branch | None = None
        for branch, level, band, radius in self._bands(arm):
            gone_mm += 0.5 * step
            if gone_mm > max(REACH_RADII * radius, REACH_MM):
                return
            if branch is not last:
                points, last = self.segmentation.geometry.index_to_world(branch.index[:, ::-1]), branch
            way, lowest = branch.way_mm, max(branch.foot_mm, 0.0)
            behind = (way <= max(level - max(radius, step), lowest) + 0.5 * step) & (way < level - 0.5 * step)
            if not band.any():
                continue
            middle = points[band].mean(axis=0)
            out = middle - (points[behind][: np.count_nonzero(band)].mean(axis=0) if behind.any() else self.valve)
            if np.linalg.norm(out) > 0.0:
                yield branch, middle, out / np.linalg.norm(out)

    def _bands(self, arm: _Arm) -> Iterator[tuple[Branch, float, Bool, float]]:
        """Slices across the way of an arm, from where it is no longer as narrow as a twig to its foot.

        With each its branch, the way to its middle, the voxels of the branch that are in it, and their radius.
        """
        step, is_begun = self._step_mm, False
        for branch in arm.parts:
            for level in np.arange(branch.top_mm, max(branch.foot_mm, 0.0) - 1e-9, -0.5 * step):
                band = (branch.way_mm <= level + 0.5 * step) & (branch.way_mm > level - 0.5 * step)
                volume_mm3 = np.count_nonzero(band) * self.segmentation.geometry.voxel_volume_mm3
                radius = float(np.sqrt(volume_mm3 / step / np.pi))
                is_begun = is_begun or radius >= 0.75 * self._least_radius_mm
                if is_begun:
                    yield branch, float(level), band, radius

    def _places_straight(self, arm: _Arm) -> Iterator[tuple[Branch, Float64, Float64]]:
        """Middles of slabs across the straight way from an arm's foot to its tip: for what is wider than long."""
        branch, step = arm.parts[-1], self._step_mm
        points, way = self.segmentation.geometry.index_to_world(branch.index[:, ::-1]), branch.way_mm
        foot = self.valve if branch.foot_mm < 0.0 else points[way <= branch.foot_mm + step].mean(axis=0)
        out = points[: max(1, len(points) // 3)].mean(axis=0) - foot
        if not np.linalg.norm(out) > 0.0:
            return
        axis = out / np.linalg.norm(out)
        along = (points - foot) @ axis
        for level in np.arange(float(along.max()), 0.0, -0.5 * step):
            slab = np.abs(along - level) <= 0.5 * step
            if slab.any():
                yield branch, points[slab].mean(axis=0), axis

    def _judged(self, section: Section | None, point: Float64, axis: Float64) -> tuple[str, float]:
        """Why a section is no place for a disc, or an empty string; and how much it changes towards the heart."""
        if section is None or not section.is_whole or angle_between(section.axis, axis) > TURN_DEGREES:
            return "its cross-section is no tube's", np.inf
        if float(np.linalg.norm(section.middle - point)) > 1.5 * section.radius_mm:
            return "its cross-section is no tube's", np.inf
        if section.roundness < ROUNDNESS:
            return "its cross-section is too flat", np.inf
        if section.radius_mm < self._least_radius_mm:
            return "it is too narrow", np.inf
        if self._is_atrium and (why := self._no_vein(section)):
            return why, np.inf
        change = 1.0
        for back in TUBE_PLACES:
            at = section.middle - back * section.radius_mm * section.axis
            before = self.lumen.section(at, section.axis, SECTION_RADII * section.radius_mm)
            if before is None or not before.is_whole:
                return "it is no tube there", np.inf
            ratio = before.area_mm2 / section.area_mm2
            change = max(change, ratio, 1.0 / ratio)
        return "", change

    def _is_appendage(self, arm: _Arm) -> bool:
        """Whether an arm of an atrium is its appendage, by where it leads without its twigs."""
        branch, _, band, _ = next(self._bands(arm), (arm.parts[0], 0.0, arm.parts[0].way_mm > 0.0, 0.0))
        tip = self.segmentation.geometry.index_to_world(branch.index[band][:, ::-1]).mean(axis=0)
        return self.around.is_appendage(tip, self.middle, self.valve, self.widest_mm)

    def _no_vein(self, section: Section) -> str:
        """Why a branch of an atrium is no vein, or an empty string."""
        if section.radius_mm > BRANCH_SHARE * self.widest_mm:
            return "it is as wide as the atrium"
        ahead = np.arange(1.0, AHEAD_RADII * section.radius_mm, 0.5 * self._step_mm)
        points = section.middle + ahead[:, None] * section.axis
        index = np.rint(self.segmentation.geometry.world_to_index(points)).astype(int)[:, ::-1]
        inside = ((index >= 0) & (index < self.mask.shape)).all(axis=1)
        if np.isin(self.segmentation.labels[tuple(index[inside].T)], self.around.chambers).any():
            return "it leads towards another chamber, as an appendage does"
        return ""

    def _outermost(self, section: Section) -> Section:
        """The section moved out along its axis as long as the lumen keeps its width."""
        step = 0.5 * self._step_mm
        best = section
        for number in range(1, 1 + int(section.radius_mm / step)):
            point = section.middle + number * step * section.axis
            further = self.lumen.section(point, section.axis, SECTION_RADII * section.radius_mm)
            if further is None or not further.is_whole or not 0.92 <= further.area_mm2 / section.area_mm2 <= 1.25:
                break
            best = further
        return best

    def _extent(self, section: Section) -> float:
        """Radius of the circle around the disc's middle that holds the lumen as far as it is continued."""
        extent = section.extent_mm
        for back in TUBE_PLACES:
            at = section.middle - back * section.radius_mm * section.axis
            before = self.lumen.section(at, section.axis, SECTION_RADII * section.radius_mm)
            if before is not None and before.is_whole:
                extent = max(extent, before.extent_mm)
        return extent


def _border_of(shape: tuple[int, ...]) -> Bool:
    """The outermost voxels of a volume."""
    border = np.ones(shape, np.bool_)
    border[1:-1, 1:-1, 1:-1] = False
    return border


def _end(
    label: Label, position: Float64, axis: Float64, radius: float, lumen_radius: float, *, is_open: bool = False
) -> VesselEnd:
    x, y, z = (round(float(v), 1) + 0.0 for v in position)
    a, b, c = (round(float(v), 3) + 0.0 for v in axis)
    return VesselEnd(label.name, (x, y, z), (a, b, c), round(radius, 1), round(lumen_radius, 1), is_open=is_open)
