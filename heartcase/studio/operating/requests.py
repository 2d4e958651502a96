"""What a page that operates asks for: one JSON object a message."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, TypeAdapter, model_validator

from heartcase.schemas.base import Direction, Model, PointMm
from heartcase.schemas.recording.commands import Command as SessionCommand
from heartcase.studio.asking import RequestId, parsed

__all__ = [
    "Act",
    "Along",
    "Begin",
    "Coarser",
    "Compare",
    "CutOpen",
    "Device",
    "Figures",
    "Hide",
    "HoldOpen",
    "Keep",
    "LeavePage",
    "LetGo",
    "Look",
    "Plane",
    "Planned",
    "Play",
    "Point",
    "Recordings",
    "Rename",
    "Replay",
    "Request",
    "Resize",
    "Run",
    "SavePage",
    "Seen",
    "Slice",
    "Strain",
    "Take",
    "TakeUp",
    "TourTo",
    "Tours",
    "Wheel",
    "parse_request",
]

_FAR_MM = 1e6
"""No eye is further away, and no number that says where it looks is larger."""
_PERPENDICULAR_MAX = 1e-3
"""How far rows of the eye's axes may be from perpendicular and of unit length."""


_RecordingName = Annotated[str, Field(min_length=1, max_length=200)]
_Speed = Annotated[float, Field(ge=0.1, le=10.0)]
"""Simulated time for each time that goes by, where what came before is played."""


class _Asked(Model):
    """What all requests have."""

    id: RequestId
    """Number that the answer names."""


class Look(Model):
    """Where the pointer points to: the ray from the eye, and the eye's axes."""

    start_mm: PointMm
    """Where the ray begins, LPS mm."""
    direction: Direction
    """Where it goes."""
    axes: tuple[Direction, Direction, Direction]
    """Right and up on the screen, and from what is seen to the eye; unit length, LPS."""

    @model_validator(mode="after")
    def _is_an_eye(self) -> Look:
        if np.abs([self.start_mm, self.direction, *self.axes]).max() > _FAR_MM:
            raise ValueError(f"an eye is at most {_FAR_MM:g} mm away")
        if np.linalg.norm(self.direction) < 1.0 / _FAR_MM:
            raise ValueError("a direction this short says nothing")
        axes = np.array(self.axes)
        if np.abs(axes @ axes.T - np.eye(3)).max() > _PERPENDICULAR_MAX:
            raise ValueError("the axes of an eye are perpendicular and of unit length")
        return self


class Act(_Asked):
    """Do a command of the session."""

    do: Literal["command"]
    """Which request."""
    command: SessionCommand
    """The command, as recordings have it."""


class Take(_Asked):
    """Take a tool in hand."""

    do: Literal["take"]
    """Which request."""
    tool: Annotated[str, Field(max_length=1)]
    """Its key; empty for none."""


class Resize(_Asked):
    """Change what can be set of the tool in hand, such as its radius."""

    do: Literal["resize"]
    """Which request."""
    steps: Annotated[int, Field(ge=-100, le=100)]
    """By how many steps."""


class Point(_Asked):
    """Use the tool in hand where the pointer points to: begin, go on, end."""

    do: Literal["press", "drag", "release"]
    """Which request."""
    pointer: Look
    """Where it points to."""


class Wheel(_Asked):
    """Lead what is held away from the eye."""

    do: Literal["wheel"]
    """Which request."""
    notches: Annotated[int, Field(ge=-100, le=100)]
    """How far, 1 mm each; nearer where negative."""


class LetGo(_Asked):
    """Let go, or take out, what is pointed at; else what holds since last; or let all instruments go."""

    do: Literal["let_go"]
    """Which request."""
    everything: bool = False
    """Whether every instrument lets go, wherever it is."""
    pointer: Look | None = None
    """Where the pointer points to, where it is over the heart."""


class Along(_Asked):
    """Take the last act back, do it again, go back by a second, put down what was begun, tie all stitches.

    ``abandon`` puts down as a page that is lost does: what is led stays, and lets go softly.
    """

    do: Literal["undo", "redo", "back", "put_down", "abandon", "tie"]
    """Which request."""


class Run(_Asked):
    """Let time stand, or go on from here."""

    do: Literal["pause"]
    """Which request."""
    paused: bool
    """Whether it stands."""


class TakeUp(_Asked):
    """Go back to where a branch begins, with what it holds known ahead."""

    do: Literal["take_up"]
    """Which request."""
    branch: Annotated[int, Field(ge=1, le=10**9)]
    """Its number."""


class Play(_Asked):
    """Do again what is known from here on."""

    do: Literal["play"]
    """Which request."""
    speed: _Speed = 1.0
    """How fast."""
    skips: bool = False
    """Whether pauses are passed over."""


class Keep(_Asked):
    """Begin to record, end the recording; leave a processor to what draws."""

    do: Literal["record", "stop_recording", "spare"]
    """Which request."""


class Recordings(_Asked):
    """Name the recordings of this case that can be replayed."""

    do: Literal["recordings"]
    """Which request."""


class Replay(_Asked):
    """Leave this session, and play a recording from its start; an act takes over."""

    do: Literal["replay"]
    """Which request."""
    name: Annotated[str, Field(min_length=1, max_length=200)]
    """One of the names that were given for it."""
    speed: _Speed = 1.0
    """How fast."""
    skips: bool = False
    """Whether pauses are passed over."""


class Begin(_Asked):
    """Leave this session, and begin anew with the case as it was built."""

    do: Literal["begin"]
    """Which request."""


class Hide(_Asked):
    """Structures that this page does not show, and that cannot be pointed at from it."""

    do: Literal["hide"]
    """Which request."""
    structures: Annotated[tuple[Annotated[int, Field(ge=0, le=256)], ...], Field(max_length=257)]
    """Their numbers."""


class Plane(Model):
    """A plane that opens the heart."""

    normal: Direction
    """To what is taken away, LPS."""
    point_mm: PointMm
    """A point of it, LPS mm."""

    @model_validator(mode="after")
    def _is_a_plane(self) -> Plane:
        if np.abs([self.point_mm, self.normal]).max() > _FAR_MM:
            raise ValueError(f"a plane is at most {_FAR_MM:g} mm away")
        if np.linalg.norm(self.normal) < 1.0 / _FAR_MM:
            raise ValueError("a direction this short says nothing")
        return self


class CutOpen(_Asked):
    """Where this page cuts the heart open: what is taken away cannot be pointed at from it."""

    do: Literal["cut_open"]
    """Which request."""
    plane: Plane | None
    """Where; null where it does not."""


class Slice(_Asked):
    """Show a slice of the scan."""

    do: Literal["slice"]
    """Which request."""
    name: Literal["cut", "axial", "coronal", "sagittal"]
    """Which of the page's slices; it comes with the picture."""
    point_mm: PointMm
    """A point of its plane, LPS mm."""
    right: Direction
    """To the picture's right, LPS, unit length."""
    down: Direction
    """Down the picture, LPS, unit length."""
    window: tuple[float, float] | None = None
    """Intensities that are black and white; those that the scan is shown with at first when left out."""

    @model_validator(mode="after")
    def _is_a_plane(self) -> Slice:
        if self.window is not None and not self.window[0] < self.window[1]:
            raise ValueError("black is below white")
        if np.abs([self.point_mm, self.right, self.down]).max() > _FAR_MM:
            raise ValueError(f"a slice is at most {_FAR_MM:g} mm away")
        axes = np.array([self.right, self.down])
        if np.abs(axes @ axes.T - np.eye(2)).max() > _PERPENDICULAR_MAX:
            raise ValueError("the axes of a picture are perpendicular and of unit length")
        return self


class Strain(_Asked):
    """Send how far the tissue is stretched, too."""

    do: Literal["strain"]
    """Which request."""
    shown: bool
    """Whether it is wanted."""


class Tours(_Asked):
    """Name the guided tours of this case, with all that they say and show."""

    do: Literal["tours"]
    """Which request."""


class TourTo(_Asked):
    """Bring the session to where a step of a tour leaves it; nowhere, where the tour is left."""

    do: Literal["tour"]
    """Which request."""
    tour: Annotated[int, Field(ge=0, le=100)]
    """Number of the tour, from 0, as they were named."""
    step: Annotated[int, Field(ge=0, le=100)] | None = None
    """Number of the step, from 0; None leaves the tour."""


class Coarser(_Asked):
    """Send coarser levels of detail of the surface, too: for a page that cannot draw the finest while it moves."""

    do: Literal["coarser"]
    """Which request."""


class Figures(_Asked):
    """Send figures of an incision as it is held open now, again and again."""

    do: Literal["figures"]
    """Which request."""
    shown: bool
    """Whether they are wanted."""
    incision: Annotated[int, Field(ge=0, le=10_000)] = 0
    """Which of the cuts, from 0; the last one where there are fewer."""
    reach: bool = False
    """Whether the reach of an instrument's tip is to be worked out, once: time is stopped for it."""


class Planned(_Asked):
    """Cut along a planned incision of the case."""

    do: Literal["cut_planned"]
    """Which request."""
    incision: Annotated[str, Field(min_length=1, max_length=200)]
    """Its name."""


class HoldOpen(_Asked):
    """Close hands on both lips of a cut, and lead them apart."""

    do: Literal["hold_open"]
    """Which request."""
    incision: Annotated[int, Field(ge=0, le=10_000)]
    """Which of the cuts, from 0."""


class Compare(_Asked):
    """Work out the figures of recordings, side by side."""

    do: Literal["compare"]
    """Which request."""
    names: Annotated[tuple[_RecordingName, ...], Field(min_length=1, max_length=6)]
    """Names that were given for them."""


class SavePage(_Asked):
    """Save the case as one HTML file that needs no server, with some of its recordings."""

    do: Literal["save_page"]
    """Which request."""
    names: Annotated[tuple[_RecordingName, ...], Field(max_length=6)] = ()
    """Names that were given for them."""


class LeavePage(_Asked):
    """Leave the page that is being saved."""

    do: Literal["leave_page"]
    """Which request."""


class Rename(_Asked):
    """Give a recording another name."""

    do: Literal["rename"]
    """Which request."""
    name: _RecordingName
    """One of the names that were given."""
    to: _RecordingName
    """Its new name, without an ending."""


class Device(_Asked):
    """Let a haptic device lead a hand in the session, or take it away."""

    do: Literal["device"]
    """Which request."""
    name: Annotated[str, Field(max_length=100)] | None
    """One of the devices that there are; None to take it away."""
    pointer: Look | None = None
    """What is looked at: where it meets the heart, the middle of the device's way lies."""


class Seen(Model):
    """A frame was taken: another may follow. It has no answer."""

    do: Literal["seen"]
    """Which request."""
    frame: RequestId
    """Its number."""


Request = (
    Act
    | Take
    | Resize
    | Point
    | Wheel
    | LetGo
    | Along
    | Run
    | TakeUp
    | Play
    | Keep
    | Recordings
    | Replay
    | Begin
    | Hide
    | CutOpen
    | Slice
    | Strain
    | Tours
    | TourTo
    | Coarser
    | Figures
    | Planned
    | HoldOpen
    | Compare
    | SavePage
    | LeavePage
    | Rename
    | Device
    | Seen
)
_REQUEST: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])


def parse_request(text: str) -> Request:
    """What a message of a page that operates asks for.

    Raises
    ------
    UsageError
        As :func:`heartcase.studio.asking.parsed` says.
    """
    return parsed(text, _REQUEST)
