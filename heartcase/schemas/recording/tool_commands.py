"""Commands for forceps, retractors and scissors."""

from __future__ import annotations

from typing import Literal

from heartcase.schemas.base import (
    Direction,
    JawAngle,
    JawOpening,
    LipLine,
    Name,
    PadLimit,
    PadStiffness,
    PointMm,
    PositiveMm,
    RestPoses,
)
from heartcase.schemas.recording.command_model import CommandModel

__all__ = [
    "BringScissors",
    "CloseForceps",
    "CloseRetractor",
    "PlaceScissors",
    "Snip",
    "SqueezeForceps",
    "WithdrawScissors",
]


class CloseForceps(CommandModel):
    """Take hold of the tissue between two jaws; they close with the end of the next steps.

    ``lead_grab`` and ``open_grab`` lead them and let them go.
    """

    kind: Literal["close_forceps"] = "close_forceps"
    """Which command."""
    name: Name
    """Name of the forceps; no other instrument in the tissue may have it."""
    tip_mm: PointMm
    """Middle between the tips of the jaws."""
    direction: Direction
    """Along the jaws towards the tips."""
    closing: Direction
    """From one jaw to the other."""
    length_mm: PositiveMm = 10.0
    """Length of the jaws, mm."""
    width_mm: PositiveMm = 4.0
    """Width of the jaws, mm."""
    opening_mm: PositiveMm = 8.0
    """Gap between the open jaws, mm."""
    gap_mm: PositiveMm | None = None
    """Gap to which they close, mm; they only touch the tissue when left out."""


class SqueezeForceps(CommandModel):
    """Close or open the jaws of forceps further; they arrive with the end of the next steps."""

    kind: Literal["squeeze_forceps"] = "squeeze_forceps"
    """Which command."""
    name: Name
    """The forceps."""
    gap_mm: PositiveMm
    """Gap between the jaws, mm."""


class CloseRetractor(CommandModel):
    """Take hold of one lip of an incision along a line, on pads. ``lead_grab`` and ``open_grab`` lead and let go."""

    kind: Literal["close_retractor"] = "close_retractor"
    """Which command."""
    name: Name
    """Name of the retractor; no other instrument in the tissue may have it."""
    line_mm: LipLine
    """The line along the lip."""
    side: Direction
    """From the line into the tissue that it shall hold."""
    depth_mm: PositiveMm = 6.0
    """How far from the line it holds, mm; less than a cell counts as a cell."""
    stiffness_n_mm2: PadStiffness = 0.2
    """Stiffness of the pads: N for each mm along the line and each mm that they give."""
    limit_n_mm: PadLimit | None = 0.5
    """Pull along the line at which the pads give way without end, N/mm; null for none."""


class BringScissors(CommandModel):
    """Bring in fully open scissors; they touch nothing."""

    kind: Literal["bring_scissors"] = "bring_scissors"
    """Which command."""
    name: Name
    """Name of the scissors; no other instrument in the tissue may have it."""
    hinge_mm: PointMm
    """Where the jaws are joined."""
    direction: Direction
    """From the hinge towards the tips of the closed jaws."""
    closing: Direction
    """From one jaw to the other."""
    length_mm: PositiveMm = 20.0
    """Length of the jaws from the hinge, mm."""
    opening_deg: JawOpening = 40.0
    """Angle between the fully open jaws, degrees."""


class PlaceScissors(CommandModel):
    """Put scissors elsewhere, at once; they keep their angle and touch nothing on the way."""

    kind: Literal["place_scissors"] = "place_scissors"
    """Which command."""
    name: Name
    """The scissors."""
    hinge_mm: PointMm
    """Where the jaws are joined."""
    direction: Direction
    """From the hinge towards the tips of the closed jaws."""
    closing: Direction
    """From one jaw to the other."""


class Snip(CommandModel):
    """Close scissors to an angle, and cut what lies between their jaws so far; to a larger angle they only open."""

    kind: Literal["snip"] = "snip"
    """Which command."""
    name: Name
    """The scissors."""
    angle_deg: JawAngle = 0.0
    """Angle between the jaws after it, degrees; 0 is closed."""
    rest_poses_mm: RestPoses | None = None
    """What is cut, as poses of a blade in the tissue at rest; worked out when left out. What is recorded states it."""


class WithdrawScissors(CommandModel):
    """Take scissors away."""

    kind: Literal["withdraw_scissors"] = "withdraw_scissors"
    """Which command."""
    name: Name
    """The scissors."""
