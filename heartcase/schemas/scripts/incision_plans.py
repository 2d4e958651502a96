"""Plans of incisions that are compared: where is cut, how it is held open, from where is looked. A TOML file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from heartcase.schemas.base import BladePoses, Model, Name, PadStiffness, PointMm, PositiveMm, Vector3
from heartcase.schemas.migrate import PLANS
from heartcase.schemas.scripts.script import GrabAction

__all__ = ["IncisionPlans", "LipHands", "LookingSettings", "PlannedCut", "PlannedIncision", "ShaftSettings"]

_Angle = Annotated[float, Field(gt=0.0, le=180.0)]


class PlannedCut(Model):
    """One cut: a planned incision of the case, a line drawn on its surface, or a blade's way."""

    name: Name = "blade"
    """Name in messages."""
    landmark: Name | None = None
    """Name of a planned incision among the case's landmarks: a polyline with a depth."""
    curve_mm: Annotated[tuple[PointMm, ...], Field(min_length=2, max_length=4096)] | None = None
    """A line along the surface at rest, LPS mm, instead of a landmark."""
    poses_mm: BladePoses | None = None
    """Points of the blade's edge at each pose, at rest, instead of a line; hands at the lips need a line."""
    depth_mm: PositiveMm | None = None
    """How deep a line is cut, mm; needed with ``curve_mm``, a landmark has its own."""
    deeper_mm: Annotated[float, Field(ge=0.0, le=1000.0)] | None = None
    """How much deeper besides, mm; two cells when left out. What a blade has not passed by so much stays joined in
    cells that lie in part below the wall."""
    outside_mm: PositiveMm | None = None
    """How far the blade stands out of the surface along a line, mm; 3 mm, and at least two cells, when left out."""

    @model_validator(mode="after")
    def _check(self) -> PlannedCut:
        problems = []
        if sum(one is not None for one in (self.landmark, self.curve_mm, self.poses_mm)) != 1:
            problems.append("give one of landmark, curve_mm and poses_mm")
        if self.curve_mm is not None and self.depth_mm is None:
            problems.append("a curve_mm needs a depth_mm")
        if self.poses_mm is not None and len({len(pose) for pose in self.poses_mm}) > 1:
            problems.append("every pose of a blade needs as many points as the others")
        _raise(problems)
        return self


class LipHands(Model):
    """What holds both lips of the first cut, and leads them apart across it."""

    kind: Literal["grabs", "retractors"] = "grabs"
    """Hands that close on a ball of tissue beside the lip, or retractors, which lie along the lip on pads."""
    hands_per_lip: Annotated[int, Field(ge=1, le=8)] = 1
    """Of these on each lip: hands are spread evenly along it, retractors lie end to end along its middle."""
    spread_mm: PositiveMm | None = None
    """How far each lip is led, mm; 0.25 of the cut's length when left out."""
    lift_mm: Annotated[float, Field(ge=-1000.0, le=1000.0)] | None = None
    """How far each is lifted out of the surface besides, mm; 0.2 of the cut's length when left out."""
    part: Annotated[float, Field(gt=0.0, le=1.0)] = 0.6
    """Part of a lip's length along which retractors lie, in its middle [1]."""
    depth_mm: PositiveMm | None = None
    """How far from the lip retractors hold, mm; 1.5 cells when left out."""
    stiffness_n_mm2: PadStiffness | None = None
    """Stiffness of retractors' pads, N for each mm along the line and each mm that they give; a script's when left
    out."""
    distance_mm: PositiveMm | None = None
    """From the cut to the middle of a hand's ball, mm; as much as its radius when left out."""
    radius_mm: PositiveMm | None = None
    """Radius of a hand's ball, mm; 0.2 of the cut's length, and at least 1.5 cells, when left out."""

    @model_validator(mode="after")
    def _check(self) -> LipHands:
        of_others = {"retractors": ("distance_mm", "radius_mm"), "grabs": ("part", "depth_mm", "stiffness_n_mm2")}[
            self.kind
        ]
        given = [name for name in of_others if name in self.model_fields_set]
        _raise([f"{self.kind} have no {name}: leave it out" for name in given])
        return self


class PlannedIncision(Model):
    """One way to a defect."""

    name: Name
    """Name of the plan; no other has it."""
    only_with_landmarks: bool = False
    """Whether a case that lacks a landmark of this plan leaves it out; else that is an error."""
    cuts: Annotated[tuple[PlannedCut, ...], Field(min_length=1)]
    """What blades cut, in this order; the first is the incision that is looked through."""
    retraction: LipHands | None = None
    """What holds both lips; nothing when left out."""
    actions: tuple[GrabAction, ...] = ()
    """Other hands, as in a script; their times begin when the cuts were made and the tissue has come to rest."""
    settle_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 0.1
    """Time after the cuts before hands close, s."""
    open_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 0.4
    """Time in which the lips are led apart, s."""
    hold_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 0.3
    """Time that the incision is held open before it is measured, s."""
    looks_from: Vector3 | None = None
    """From the defect to the surgeon, LPS axes: the middle of the directions; out through the opening's middle when
    left out."""

    @property
    def seconds(self) -> float:
        """Simulated time of all of it, s."""
        return self.settle_s + self.open_s + self.hold_s

    @model_validator(mode="after")
    def _check(self) -> PlannedIncision:
        problems = []
        if self.retraction is not None and self.cuts[0].poses_mm is not None:
            problems.append("a retraction needs a first cut along a landmark or a curve_mm; give actions instead")
        if self.looks_from is not None and not any(self.looks_from):
            problems.append("looks_from must not be zero")
        late = [one.name for one in self.actions if one.start_s >= self.open_s + self.hold_s]
        if late:
            problems.append(f"hands close after the end: {', '.join(late)}")
        _raise(problems)
        return self


class LookingSettings(Model):
    """Directions from which the surgeon looks: a cone around the middle that each plan has."""

    half_angle_deg: _Angle = 30.0
    """Half of the cone's opening, degrees."""
    distance_mm: Annotated[float, Field(gt=0.0, le=10_000.0)] = 400.0
    """From the defect to the eye, mm."""
    eye_count: Annotated[int, Field(ge=1, le=10_000)] = 200
    """Places of the eye."""


class ShaftSettings(Model):
    """The straight instrument whose freedom is measured."""

    half_angle_deg: _Angle = 60.0
    """How far it may lean from the middle of the surgeon's directions, degrees."""
    length_mm: PositiveMm = 100.0
    """From the tip to the hand, mm."""
    radius_mm: Annotated[float, Field(ge=0.0, le=100.0)] = 1.5
    """Radius, mm."""
    depth_mm: PositiveMm = 60.0
    """How far behind the opening places are counted that the tip comes to, mm."""
    spacing_mm: PositiveMm = 2.0
    """Edge of the cubes in which they are counted, mm."""


class IncisionPlans(Model):
    """Plans of incisions for one case, or for several that have the same landmarks."""

    heartcase_plans: Annotated[int, Field(ge=1, json_schema_extra={"maximum": PLANS.newest})]
    """Version of the format: 1."""
    defects: tuple[Name, ...] = ()
    """Defects that are looked at: names of rings among the case's landmarks. Of several names those that the case has
    are; all its rings when left out."""
    damping_per_s: Annotated[float, Field(ge=0.0)] = 30.0
    """Mass-proportional damping coefficient c in a = f/m - c v, 1/s."""
    step_s: Annotated[float, Field(gt=0.0)] | None = None
    """Time step, s; the case's default when left out."""
    nearest_least_mm: Annotated[float, Field(ge=0.0, le=1000.0)] = 2.0
    """Nearest that a plan may come to a vessel, mm; one that comes nearer is put behind all others."""
    inverted_cells_most: Annotated[int, Field(ge=0)] = 2
    """Most cells that a plan may leave inside out; one that leaves more is put behind all others."""
    view: LookingSettings = LookingSettings()
    """From where is looked."""
    shaft: ShaftSettings = ShaftSettings()
    """What is moved through the opening."""
    plans: Annotated[tuple[PlannedIncision, ...], Field(min_length=1)]
    """The plans."""

    @model_validator(mode="after")
    def _check(self) -> IncisionPlans:
        names = [plan.name.lower() for plan in self.plans]
        twice = sorted({plan.name for plan in self.plans if names.count(plan.name.lower()) > 1})
        _raise([f"more than one plan is called {name}: name each differently" for name in twice])
        return self


def _raise(problems: list[str]) -> None:
    if problems:
        raise ValueError("; ".join(problems))
