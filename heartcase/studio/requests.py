"""What a page asks for: one JSON object a message."""

from __future__ import annotations

import json
from typing import Annotated, Literal, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from heartcase.schemas.base import Model, Name, PointMm
from heartcase.schemas.errors import UsageError, problems_from_validation
from heartcase.schemas.recipe.settings import Stroke
from heartcase.schemas.strict_json import parse_json
from heartcase.studio.shaping.requests import RequestId, ShapingRequest

__all__ = [
    "REQUEST_SIZE_MAX",
    "End",
    "Extend",
    "History",
    "Lock",
    "Paint",
    "Planes",
    "Request",
    "Suggest",
    "parse_request",
    "parsed",
    "request_id",
]

REQUEST_SIZE_MAX = 1 << 20
"""A message that is longer, in bytes, ends the connection."""

T = TypeVar("T")


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


class Planes(Model):
    """Name the heart's own planes, as far as labels and landmarks tell them."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["planes"]
    """Which request."""


class Lock(Model):
    """Lock these structures, and no others."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["lock"]
    """Which request."""
    labels: Annotated[tuple[Name, ...], Field(max_length=251)]
    """Their names."""


Request = Paint | Extend | End | History | Suggest | ShapingRequest | Planes | Lock
_REQUEST: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])


def parse_request(text: str) -> Request:
    """What a message of a painting page asks for.

    Raises
    ------
    UsageError
        As :func:`parsed` says.
    """
    return parsed(text, _REQUEST)


def parsed(text: str, requests: TypeAdapter[T]) -> T:
    """What a message asks for.

    Parameters
    ----------
    text
        The message.
    requests
        The requests that there are, told apart by ``do``.

    Raises
    ------
    UsageError
        It is no JSON object, or none of the requests; all problems at once.
    """
    try:
        data = parse_json(text.encode("utf-8", "surrogatepass"))
    except (ValueError, RecursionError):
        raise UsageError("is not valid JSON", place="request") from None
    if not isinstance(data, dict):
        raise UsageError("must be a JSON object", place="request")
    try:
        return requests.validate_python({"do": None} | data)
    except ValidationError as error:
        raise UsageError(problems_from_validation(error, place="request")) from None


def request_id(text: str) -> int | None:
    """The number of a message that may be anything else than a request; None where it has none."""
    try:
        found = json.loads(text).get("id")
    except (ValueError, AttributeError, RecursionError):
        return None
    return found if isinstance(found, int) and not isinstance(found, bool) and 0 <= found <= 1 << 53 else None
