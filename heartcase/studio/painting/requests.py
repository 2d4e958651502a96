"""What a page asks for: one JSON object a message."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, TypeAdapter, model_validator

from heartcase.schemas.base import Model, Name, PointMm
from heartcase.schemas.recipe.settings import Stroke
from heartcase.studio.asking import RequestId, parsed
from heartcase.studio.shaping.requests import ShapingRequest

__all__ = [
    "Confirm",
    "End",
    "Extend",
    "History",
    "Lock",
    "Look",
    "Paint",
    "Picture",
    "Planes",
    "Request",
    "Rest",
    "SeenPlane",
    "Suggest",
    "parse_request",
]


class Paint(Stroke):
    """Begin a stroke."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["paint"]
    """Which request."""

    @property
    def stroke(self) -> Stroke:
        """The stroke alone."""
        return Stroke.model_validate(self.model_dump(exclude={"id", "do"}))


class Extend(Model):
    """Go on with the stroke that this page began, from its last point."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["extend"]
    """Which request."""
    points_mm: Annotated[tuple[PointMm, ...], Field(min_length=1, max_length=10_000)]
    """Where to, LPS mm."""


class End(Model):
    """The stroke is over."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["end"]
    """Which request."""


class History(Model):
    """Take the last act back, of whatever kind, or do again what was taken back."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["undo", "redo"]
    """Which request."""


class Suggest(Model):
    """Name the places where one more stroke would change most."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["suggest"]
    """Which request."""
    count: Annotated[int, Field(ge=1, le=100)] = 5
    """How many, at most."""


class Confirm(Model):
    """A place that was named is right as it is: it is not named again while it has this label."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["confirm"]
    """Which request."""
    position_mm: PointMm
    """The place, as it was named, LPS mm."""
    label: Name
    """Name of the label that it has."""
    rival: Name
    """Name of the one that it might have had."""


class Planes(Model):
    """Name the heart's own planes, as far as labels and landmarks tell them."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["planes"]
    """Which request."""


class Picture(Model):
    """Draw a small picture of a place."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["picture"]
    """Which request."""
    position_mm: PointMm
    """Where, LPS mm."""


class Lock(Model):
    """Lock a structure, or unlock it; all others stay as they are."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["lock"]
    """Which request."""
    label: Name
    """Its name."""
    locked: bool
    """Whether it is locked then."""


class SeenPlane(Model):
    """A plane that a page shows."""

    point_mm: PointMm
    """A point of it, LPS mm."""
    normal: PointMm
    """Its unit normal, in the patient."""

    @model_validator(mode="after")
    def _has_direction(self) -> Self:
        if not 0.9 < math.hypot(*self.normal) < 1.1:
            raise ValueError("normal must have length 1")
        return self


class Look(Model):
    """Say which planes are shown: from now on their labels come first, and those off them when asked for."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["look"]
    """Which request."""
    planes: Annotated[tuple[SeenPlane, ...], Field(min_length=1, max_length=4)]
    """The planes."""


class Rest(Model):
    """Send some of the labels that have not come yet."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["rest"]
    """Which request."""


Request = Paint | Extend | End | History | Suggest | ShapingRequest | Planes | Lock | Picture | Confirm | Look | Rest
_REQUEST: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])


def parse_request(text: str) -> Request:
    """What a message of a painting page asks for.

    Raises
    ------
    UsageError
        As :func:`heartcase.studio.asking.parsed` says.
    """
    return parsed(text, _REQUEST)
