"""The edits of a recipe: septal defects made and closed, structures sculpted, smoothed, filled and cleaned."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from heartcase.schemas.base import Model, Name, PointMm, PositiveMm, Vector3
from heartcase.schemas.errors import ModelProblems, Problem

__all__ = [
    "CloseDefect",
    "DefectShape",
    "Edit",
    "Fill",
    "KeepLargest",
    "RemoveIslands",
    "Sculpt",
    "SeptalDefect",
    "Smooth",
    "edit_place",
]

LEAST_SINE = 0.02
"""Sine of the angle below which two directions count as parallel: about one degree."""


class _EditLine(Model):
    """What every edit has."""

    name: Name | None = None
    """What the edit is for, in a few words: for people and for the report."""
    enabled: bool = True
    """false leaves the edit in the recipe and does not carry it out."""


DefectShape = Literal["circular", "elliptic", "slit"]
"""Cross-section of a septal defect or a patch: a circle, an ellipse, or a straight slit with round ends."""


class _Round(_EditLine):
    """A cross-section at a place, at right angles to an axis."""

    position_mm: PointMm
    """Centre, LPS mm: for a hole in the middle of the septum."""
    diameter_mm: PositiveMm
    """Diameter; the long one of an ellipse, the length of a slit with its round ends."""
    axis: Vector3
    """Direction through the septum; any length."""
    shape: DefectShape = "circular"
    """Cross-section: a circle, an ellipse, or a straight slit with round ends."""
    width_mm: PositiveMm | None = None
    """Elliptic and slit: the short diameter, at most ``diameter_mm``."""
    long_axis: Vector3 | None = None
    """Elliptic and slit: direction of the long diameter; any length; only its part at right angles to ``axis``
    counts."""

    @property
    def area_mm2(self) -> float:
        """Area of the cross-section, mm2."""
        if self.width_mm is None:
            return 0.25 * math.pi * self.diameter_mm**2
        if self.shape == "elliptic":
            return 0.25 * math.pi * self.diameter_mm * self.width_mm
        return 0.25 * math.pi * self.width_mm**2 + (self.diameter_mm - self.width_mm) * self.width_mm

    @model_validator(mode="after")
    def _shape_has_its_sizes(self) -> Self:
        problems: list[Problem] = []
        is_long = self.shape != "circular"
        for key in ("width_mm", "long_axis"):
            stated = getattr(self, key) is not None
            if stated and not is_long:
                problems.append(Problem(key, "a circular one has none: leave it out, or set shape"))
            elif is_long and not stated:
                problems.append(Problem(key, f"is missing: a shape that is {self.shape!r} needs it"))
        if is_long and self.width_mm is not None and self.width_mm > self.diameter_mm:
            problems.append(Problem("width_mm", "must not be above diameter_mm, which is the long one: exchange them"))
        if is_long and self.long_axis is not None:
            if not any(self.long_axis):
                problems.append(Problem("long_axis", "must not be zero"))
            elif any(self.axis) and _sine_between(self.axis, self.long_axis) < LEAST_SINE:
                problems.append(Problem("long_axis", "is parallel to axis: it must point along the septum"))
        if problems:
            raise ModelProblems(problems)
        return self


class SeptalDefect(_Round):
    """Make a hole in a septum (atrial or ventricular septal defect): a canal along an axis."""

    kind: Literal["septal_defect"]
    """Which edit."""
    length_mm: PositiveMm = 20.0
    """Length of the canal, centred on the position: more than the septum's thickness."""


class CloseDefect(_Round):
    """Close a septal defect with a patch: a flat sheet of a device label, somewhat larger than the defect."""

    kind: Literal["close_defect"]
    """Which edit."""
    thickness_mm: PositiveMm = 2.0
    """Thickness of the patch."""
    label: Name = "patch"
    """Name of the patch's label; made with the role ``device`` where the table has none of this name."""


class _Brush(_EditLine):
    """A round brush along a polyline (a single point is a sphere), at one structure."""

    label: Name
    """Structure that is shaped."""
    radius_mm: PositiveMm
    """Radius of the brush."""
    points_mm: Annotated[tuple[PointMm, ...], Field(min_length=1)]
    """The polyline, LPS mm."""


class Sculpt(_Brush):
    """Add to or remove from a structure with a brush."""

    kind: Literal["add", "remove"]
    """Add to the structure from whatever is there, or remove from it."""
    into: Name | None = None
    """Remove: structure that the removed part becomes; the nearest other one when left out."""
    only_from: tuple[Name, ...] | None = None
    """Add: structures that the brush takes from, the others stay as they are; all of them when left out."""

    @model_validator(mode="after")
    def _adding_takes_and_removing_gives(self) -> Self:
        problems: list[Problem] = []
        if self.kind == "add" and self.into is not None:
            problems.append(Problem("into", "an edit of kind 'add' gives to its label: leave it out"))
        if self.kind == "remove" and self.only_from is not None:
            problems.append(Problem("only_from", "an edit of kind 'remove' takes from its label: leave it out"))
        if self.only_from is not None and not self.only_from:
            problems.append(Problem("only_from", "names no structure: name one, or leave it out to take from all"))
        if problems:
            raise ModelProblems(problems)
        return self


class Smooth(_Brush):
    """Smooth the border of a structure within a brush; its grown wall follows."""

    kind: Literal["smooth"]
    """Which edit."""
    sigma_mm: PositiveMm | None = None
    """Standard deviation of the blur: bumps up to about twice as wide go; a third of ``radius_mm`` when left out."""


class Fill(_Brush):
    """Fill holes and notches of a structure within a brush; its grown wall follows."""

    kind: Literal["fill"]
    """Which edit."""
    gap_mm: PositiveMm | None = None
    """What a ball of this diameter cannot reach from outside the structure is filled, to about a voxel; the brush's
    own diameter when left out."""


class KeepLargest(_EditLine):
    """Keep the largest piece of a structure and give the others away."""

    kind: Literal["keep_largest"]
    """Which edit."""
    label: Name
    """Structure of which one piece is kept."""
    into: Name | None = None
    """Structure that the other pieces become; the nearest other one when left out."""


class RemoveIslands(_EditLine):
    """Give small pieces of a structure away; its largest piece always stays."""

    kind: Literal["remove_islands"]
    """Which edit."""
    label: Name | None = None
    """Structure whose small pieces go; every one but the background when left out."""
    smallest_ml: Annotated[float, Field(gt=0.0, le=1000.0)] = 0.1
    """Volume below which a piece goes, ml."""
    into: Name | None = None
    """Structure that the pieces become; the nearest other one when left out."""


Edit = Annotated[
    SeptalDefect | CloseDefect | Sculpt | Smooth | Fill | KeepLargest | RemoveIslands, Field(discriminator="kind")
]
"""One line of the recipe's ``edits``."""


def edit_place(number: int, edit: Edit) -> str:
    """What messages call the edit with this number, counted from 1: ``edits[2]``, or ``edits[2] "residual VSD"``."""
    return f'edits[{number}] "{edit.name}"' if edit.name else f"edits[{number}]"


def _sine_between(first: Vector3, second: Vector3) -> float:
    """Sine of the angle between two directions."""
    dot = sum(a * b for a, b in zip(first, second, strict=True))
    lengths = math.hypot(*first) * math.hypot(*second)
    return math.sqrt(max(1.0 - (dot / lengths) ** 2, 0.0))
