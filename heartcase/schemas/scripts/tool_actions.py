"""What forceps, retractors and scissors do in a simulation script."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from heartcase.schemas.base import (
    Direction,
    JawAngle,
    JawOpening,
    LipLine,
    Model,
    Name,
    PadLimit,
    PadStiffness,
    PointMm,
    PositiveMm,
)
from heartcase.schemas.scripts.waypoint import Waypoint, raise_problems, time_problems

__all__ = ["ForcepsAction", "RetractorAction", "ScissorsAction", "SnipAction"]


class ForcepsAction(Model):
    """Take hold of the tissue between two jaws, close them, lead them, let go."""

    name: Name = "forceps"
    """Name in the summary."""
    tip_mm: PointMm
    """Middle between the tips of the jaws when they take hold."""
    direction: Direction
    """Along the jaws towards the tips."""
    closing: Direction
    """From one jaw to the other."""
    length_mm: PositiveMm = 10.0
    """Length of the jaws."""
    width_mm: PositiveMm = 4.0
    """Width of the jaws."""
    opening_mm: PositiveMm = 8.0
    """Gap between the open jaws."""
    gap_mm: PositiveMm | None = None
    """Gap to which they close; they only touch the tissue when left out."""
    start_s: Annotated[float, Field(ge=0.0)] = 0.0
    """When they take hold, s."""
    close_s: Annotated[float, Field(gt=0.0)] = 0.1
    """How long they take to close from there, s."""
    release_s: Annotated[float, Field(gt=0.0)] | None = None
    """When they let go, s; they hold to the end when left out."""
    path: tuple[Waypoint, ...] = ()
    """Waypoints by ascending time, as a grab's; they stay where they closed when left out."""

    @model_validator(mode="after")
    def _check(self) -> ForcepsAction:
        raise_problems(time_problems(self.start_s, self.release_s, self.path))
        return self


class RetractorAction(Model):
    """Take hold of one lip of an incision along a line, lead it, let go."""

    name: Name = "retractor"
    """Name in the summary."""
    line_mm: LipLine
    """The line along the lip when it takes hold."""
    side: Direction
    """From the line into the tissue that it shall hold."""
    depth_mm: PositiveMm = 6.0
    """How far from the line it holds; less than a cell counts as a cell."""
    stiffness_n_mm2: PadStiffness = 0.2
    """Stiffness of its pads: N for each mm along the line and each mm that they give."""
    limit_n_mm: PadLimit = 0.5
    """Pull along the line at which the pads give way without end, N/mm."""
    start_s: Annotated[float, Field(ge=0.0)] = 0.0
    """When it takes hold, s."""
    release_s: Annotated[float, Field(gt=0.0)] | None = None
    """When it lets go, s; it holds to the end when left out."""
    path: tuple[Waypoint, ...] = ()
    """Waypoints by ascending time, as a grab's; it stays where it took hold when left out."""

    @model_validator(mode="after")
    def _check(self) -> RetractorAction:
        raise_problems(time_problems(self.start_s, self.release_s, self.path))
        return self


class SnipAction(Model):
    """Close scissors once."""

    time_s: Annotated[float, Field(ge=0.0)]
    """When they begin to close, s."""
    seconds: Annotated[float, Field(gt=0.0)] = 0.1
    """How long they take to close, s."""
    angle_deg: JawAngle = 0.0
    """Angle between the jaws at the end, degrees."""
    hinge_mm: PointMm | None = None
    """Where they are opened fully and put before, in one moment; they stay and close on when left out."""
    direction: Direction | None = None
    """Along the jaws towards the tips, from then on; as before when left out."""
    closing: Direction | None = None
    """From one jaw to the other, from then on; as before when left out."""


class ScissorsAction(Model):
    """Bring in scissors and cut with them, snip by snip."""

    name: Name = "scissors"
    """Name in messages."""
    hinge_mm: PointMm
    """Where the jaws are joined."""
    direction: Direction
    """From the hinge towards the tips of the closed jaws."""
    closing: Direction
    """From one jaw to the other."""
    length_mm: PositiveMm = 20.0
    """Length of the jaws from the hinge."""
    opening_deg: JawOpening = 40.0
    """Angle between the fully open jaws, degrees."""
    snips: Annotated[tuple[SnipAction, ...], Field(min_length=1)]
    """Snips by ascending time, each after the end of the one before."""

    @model_validator(mode="after")
    def _check(self) -> ScissorsAction:
        problems = []
        ends = [snip.time_s + snip.seconds for snip in self.snips]
        if any(snip.time_s < end for snip, end in zip(self.snips[1:], ends, strict=False)):
            problems.append("a snip begins before the one before it has ended")
        if any(snip.angle_deg >= self.opening_deg for snip in self.snips):
            problems.append("a snip closes to less than opening_deg")
        if any(snip.hinge_mm is None and (snip.direction or snip.closing) for snip in self.snips):
            problems.append("where a snip turns the scissors, give its hinge_mm too")
        raise_problems(problems)
        return self
