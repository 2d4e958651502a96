"""Commands of an operating session: what scripts, windows, pages and recordings ask of it. Plain data that JSON holds.

A new command is a model here and its place in ``Act`` or ``Motion``, and a function in
:mod:`heartcase.simulator.session.perform`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from heartcase.schemas.base import Name, PointMm, PositiveMm, RestPoses
from heartcase.schemas.errors import RecordingError, problems_from_validation
from heartcase.schemas.recording.command_model import CommandModel
from heartcase.schemas.recording.suture_commands import (
    BoundPlace,
    DrawStitch,
    Excise,
    PlacePatch,
    PlaceRow,
    PlaceStitch,
    TakeOutPatch,
    TakeOutStitch,
    TieStitch,
)
from heartcase.schemas.recording.tool_commands import (
    BringScissors,
    CloseForceps,
    CloseRetractor,
    PlaceScissors,
    Snip,
    SqueezeForceps,
    WithdrawScissors,
)

__all__ = [
    "COMMANDS_VERSION",
    "AddSprings",
    "Advance",
    "BoundPlace",
    "BringProbe",
    "BringScissors",
    "CloseForceps",
    "CloseGrab",
    "CloseRetractor",
    "Command",
    "Cut",
    "DrawStitch",
    "Entry",
    "Excise",
    "GoTo",
    "Halt",
    "LeadGrab",
    "Mark",
    "MoveProbe",
    "OpenGrab",
    "PlacePatch",
    "PlaceRow",
    "PlaceScissors",
    "PlaceStitch",
    "Redo",
    "RemoveSprings",
    "Rewind",
    "Snip",
    "SqueezeForceps",
    "TakeOutPatch",
    "TakeOutStitch",
    "TieStitch",
    "Undo",
    "WithdrawProbe",
    "WithdrawScissors",
    "parse_command",
]

COMMANDS_VERSION = 4
"""Raised when a command is added or changes: who reads commands refuses those of a newer version."""
STEPS_MAX = 100_000_000
SPRINGS_MAX = 100_000

_Row = tuple[float, float, float]
Turn = Annotated[tuple[_Row, _Row, _Row], Field(description="Rows of a rotation matrix, LPS axes.")]
Steps = Annotated[int, Field(ge=1, le=STEPS_MAX)]
_Node = Annotated[int, Field(ge=0)]


class CloseGrab(CommandModel):
    """Close a hand on the tissue in a ball; it holds what can be reached along springs inside."""

    kind: Literal["close_grab"] = "close_grab"
    """Which command."""
    name: Name
    """Name of the hand; no other instrument in the tissue may have it."""
    center_mm: PointMm
    """Centre of the ball."""
    radius_mm: PositiveMm = 6.0
    """Its radius, mm."""


class LeadGrab(CommandModel):
    """Lead a hand; it arrives with the end of the next steps."""

    kind: Literal["lead_grab"] = "lead_grab"
    """Which command."""
    name: Name
    """The hand."""
    offset_mm: PointMm
    """Way of its centre from where it closed, LPS mm."""
    turn: Turn | None = None
    """Rotation about its centre since it closed; none when left out."""


class OpenGrab(CommandModel):
    """Let go: the tissue moves on with the hand's velocity."""

    kind: Literal["open_grab"] = "open_grab"
    """Which command."""
    name: Name
    """The hand."""


class BringProbe(CommandModel):
    """Bring in a probe, which pushes tissue out of itself."""

    kind: Literal["bring_probe"] = "bring_probe"
    """Which command."""
    name: Name
    """Name of the probe; no other instrument in the tissue may have it."""
    center_mm: PointMm
    """Its centre."""
    semi_axes_mm: tuple[PositiveMm, PositiveMm, PositiveMm]
    """Semi-axes of the ellipsoid, mm."""
    turn: Turn | None = None
    """Directions of the semi-axes in its columns; those of LPS when left out."""
    axis_mm: PointMm | None = None
    """Vector from end to end of the line that a ball is swept along, LPS mm: a capsule."""


class MoveProbe(CommandModel):
    """Move a probe; it arrives with the end of the next steps."""

    kind: Literal["move_probe"] = "move_probe"
    """Which command."""
    name: Name
    """The probe."""
    center_mm: PointMm
    """Where its centre goes."""


class WithdrawProbe(CommandModel):
    """Take a probe away."""

    kind: Literal["withdraw_probe"] = "withdraw_probe"
    """Which command."""
    name: Name
    """The probe."""


class AddSprings(CommandModel):
    """Join nodes by explicit springs."""

    kind: Literal["add_springs"] = "add_springs"
    """Which command."""
    nodes: Annotated[tuple[tuple[_Node, _Node], ...], Field(min_length=1, max_length=SPRINGS_MAX)]
    """Two different nodes each."""
    stiffness_n_m: Annotated[float, Field(gt=0.0)]
    """Stiffness of each, N/m."""
    rest_length_mm: tuple[Annotated[float, Field(ge=0.0)], ...] | None = None
    """Length at rest of each, mm; the distance now when left out. What is recorded states it."""


class RemoveSprings(CommandModel):
    """Take explicit springs away."""

    kind: Literal["remove_springs"] = "remove_springs"
    """Which command."""
    numbers: Annotated[tuple[_Node, ...], Field(min_length=1, max_length=SPRINGS_MAX)]
    """Their places among the explicit springs that there are, from 0."""


class Cut(CommandModel):
    """Cut along what a blade sweeps from pose to pose."""

    kind: Literal["cut"] = "cut"
    """Which command."""
    name: Name = "blade"
    """Name of the blade, in messages."""
    poses_mm: RestPoses
    """Points of the blade's edge at each pose; as many in each. At rest, null where it met no tissue."""
    at_rest: bool = False
    """Whether they are places of the tissue at rest; else they are places now. What is recorded is at rest."""

    @model_validator(mode="after")
    def _is_even(self) -> Cut:
        if len({len(pose) for pose in self.poses_mm}) > 1:
            raise ValueError("every pose of a blade needs as many points as the others")
        if not self.at_rest and any(None in pose for pose in self.poses_mm):
            raise ValueError("every point of a blade must be three numbers where it is not at rest")
        return self


class Halt(CommandModel):
    """All instruments stay where they are, wherever they were led. What a session does by itself when it broke down."""

    kind: Literal["halt"] = "halt"
    """Which command."""


class Mark(CommandModel):
    """Name this moment."""

    kind: Literal["mark"] = "mark"
    """Which command."""
    name: Name
    """What it is called."""


class Advance(CommandModel):
    """Take steps; instruments arrive with the last, in a straight line."""

    kind: Literal["advance"] = "advance"
    """Which command."""
    steps: Steps
    """How many."""
    of: Steps | None = None
    """Steps that the whole way would take, where the session was left on the way; ``steps`` when left out."""

    @model_validator(mode="after")
    def _is_a_part(self) -> Advance:
        if self.of is not None and self.of < self.steps:
            raise ValueError("the whole way takes no fewer steps than a part of it")
        return self


class Undo(CommandModel):
    """Take back the last act, such as a grab, and all that came after it. Leading and moving are no acts."""

    kind: Literal["undo"] = "undo"
    """Which command."""


class Redo(CommandModel):
    """Do again what was taken back last, up to the next act."""

    kind: Literal["redo"] = "redo"
    """Which command."""


class Rewind(CommandModel):
    """Go back in time; not beyond the session's start."""

    kind: Literal["rewind"] = "rewind"
    """Which command."""
    seconds: Annotated[float, Field(gt=0.0, le=1e6)]
    """How far, simulated s."""


class GoTo(CommandModel):
    """Go to a step, back or on, of what is known."""

    kind: Literal["go_to"] = "go_to"
    """Which command."""
    step: Annotated[int, Field(ge=0)]
    """The step, as frames count it."""


ToolAct = CloseForceps | CloseRetractor | BringScissors | Snip | WithdrawScissors
ToolMotion = SqueezeForceps | PlaceScissors
SutureAct = PlaceStitch | PlaceRow | TieStitch | TakeOutStitch | PlacePatch | TakeOutPatch
InstrumentAct = CloseGrab | OpenGrab | BringProbe | WithdrawProbe | ToolAct
Act = InstrumentAct | AddSprings | RemoveSprings | Cut | Excise | SutureAct
"""What :class:`Undo` takes back."""
Motion = LeadGrab | MoveProbe | DrawStitch | Halt | Mark | Advance | ToolMotion
Done = Act | Motion
"""What stands in the history of a session."""
Navigation = Undo | Redo | Rewind | GoTo
"""What moves along that history."""
Command = Annotated[Done | Navigation, Field(discriminator="kind")]
"""Any command."""


class Entry(CommandModel):
    """One line of a session's history."""

    step: Annotated[int, Field(ge=0)]
    """Step at which the command was given."""
    command: Annotated[Done, Field(discriminator="kind")]
    """What was done."""

    @property
    def end_step(self) -> int:
        """Step after it."""
        return self.step + (self.command.steps if isinstance(self.command, Advance) else 0)


_COMMAND: TypeAdapter[Done | Navigation] = TypeAdapter(Command)


def parse_command(data: Any) -> Done | Navigation:
    """A command from what JSON holds, of :data:`COMMANDS_VERSION`.

    Raises
    ------
    RecordingError
        It is no command, or with everything that is wrong in it.
    """
    try:
        return _COMMAND.validate_python(data)
    except ValidationError as error:
        raise RecordingError(problems_from_validation(error, place="command")) from None
