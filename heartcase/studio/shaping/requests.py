"""What a page asks for to shape a model: lines of the recipe added, changed and removed, and proposals for them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, JsonValue

from heartcase.schemas.base import Model, Name, PointMm
from heartcase.studio.asking import RequestId

__all__ = [
    "Act",
    "Add",
    "AddLabel",
    "Change",
    "FindEnds",
    "ListName",
    "Preview",
    "Propose",
    "Remove",
    "RemoveLabel",
    "Set",
    "ShapingRequest",
]


ListName = Literal["ends", "edits", "landmarks", "pins", "walls.thickness", "walls.septum", "walls.contact"]
"""Lists of the recipe that a page changes."""

_Entry = dict[Annotated[str, Field(max_length=64)], JsonValue]
_Number = Annotated[int, Field(ge=1, le=100_000)]


class Add(Model):
    """Add lines to a list of the recipe, as one act."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["add"]
    """Which request."""
    list: ListName
    """Which list."""
    entries: Annotated[tuple[_Entry, ...], Field(min_length=1, max_length=100)]
    """What the lines say, as in the recipe."""


class Change(Model):
    """Let a line of a list say something else."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["change"]
    """Which request."""
    list: ListName
    """Which list."""
    number: _Number
    """Which line, from 1."""
    was: _Entry
    """All that it said where it was shown: a line that says something else by now is another one."""
    entry: _Entry
    """All that it says then."""


class Remove(Model):
    """Take a line out of a list."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["remove"]
    """Which request."""
    list: ListName
    """Which list."""
    number: _Number
    """Which line, from 1."""
    was: _Entry
    """All that it said where it was shown: a line that says something else by now is another one."""


class Set(Model):
    """Give a setting another value."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["set"]
    """Which request."""
    place: Annotated[tuple[Annotated[str, Field(min_length=1, max_length=64)], ...], Field(min_length=1, max_length=4)]
    """Keys that lead to it; a label is called by its name. The case's own name is ``name`` alone."""
    value: JsonValue = None
    """What is set; null leaves the setting out, so that its default counts."""


class AddLabel(Model):
    """Add a label to the table: a structure that can be painted from then on."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["add_label"]
    """Which request."""
    entry: _Entry
    """Its name and role, and where they are not the usual ones colour and wall thickness, as in the recipe."""


class RemoveLabel(Model):
    """Take a label with which nothing is painted out of the table."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["remove_label"]
    """Which request."""
    label: Name
    """Its name."""


class FindEnds(Model):
    """Find where vessels end that the recipe does not cut yet."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["find_ends"]
    """Which request."""


class Propose(Model):
    """Propose how a disc lies at a place: across a vessel, or in a septum."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["propose"]
    """Which request."""
    about: Literal["vessel", "septum"]
    """Whether it is to cut a vessel, or to lie in the septum between two cavities."""
    position_mm: PointMm
    """Where, LPS mm."""
    label: Name | None = None
    """Which vessel; the one at the place when left out."""


class Preview(Model):
    """Show the surface as it is now, coarsely: with walls, ends and edits."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["preview"]
    """Which request."""
    coarse: bool = False
    """Whether it should come sooner rather than finely: while strokes follow on each other."""


Act = Add | Change | Remove | Set | AddLabel | RemoveLabel
"""What changes the recipe."""
ShapingRequest = Act | FindEnds | Propose | Preview
