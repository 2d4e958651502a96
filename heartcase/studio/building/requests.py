"""What the build tab asks for: one JSON object a message."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from heartcase.schemas.base import Model
from heartcase.studio.asking import RequestId

__all__ = ["Approve", "BuildRequest", "Order"]

_Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Order(Model):
    """Build, end the build that runs, or open the case that is there."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["build", "cancel", "operate"]
    """Which request."""


class Approve(Model):
    """Approve the case that was looked at, or take its approval back."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["approve", "withdraw"]
    """Which request."""
    role: Annotated[str, Field(min_length=1, max_length=100)]
    """What the reviewer is; not who."""
    note: Annotated[str, Field(max_length=1000)] = ""
    """What else should be known."""
    sha256: _Sha256
    """Bundle hash of what was looked at."""
    has_looked: bool = False
    """Whether the report was read, and every warning that is more than a note looked at."""


BuildRequest = Annotated[Order | Approve, Field(discriminator="do")]
