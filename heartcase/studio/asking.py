"""What pages ask for, of whatever kind: one JSON object a message."""

from __future__ import annotations

import json
from typing import Annotated, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from heartcase.schemas.errors import UsageError, problems_from_validation
from heartcase.schemas.strict_json import parse_json

__all__ = ["REQUEST_SIZE_MAX", "RequestId", "parsed", "request_id"]

REQUEST_SIZE_MAX = 1 << 20
"""A message that is longer, in bytes, ends the connection."""

RequestId = Annotated[int, Field(ge=0, le=1 << 53)]
"""A number that a page chooses for a request, and that the answer names."""

T = TypeVar("T")


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
