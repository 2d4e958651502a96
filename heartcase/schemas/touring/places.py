"""Places and directions as a tour names them, so that it still holds when its case is built anew."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import Field

from heartcase.schemas.base import Direction, Model, Name, OneOf, PointMm, PositiveMm
from heartcase.schemas.terms import normalised, term_by_name

__all__ = [
    "DIRECTIONS",
    "Beside",
    "Place",
    "Towards",
    "Way",
    "direction_of_words",
    "known_name",
    "names_in",
    "numbered",
]

_DIRECTIONS_OF = ("direction", "closing", "side")

DIRECTIONS: dict[str, tuple[int, int, int]] = {
    "left": (1, 0, 0),
    "right": (-1, 0, 0),
    "back": (0, 1, 0),
    "front": (0, -1, 0),
    "above": (0, 0, 1),
    "below": (0, 0, -1),
}
"""Words for directions, of the patient -> LPS axes. Several may stand together: ``front left``."""

_Words = Annotated[str, Field(min_length=1, max_length=64)]
Towards = Annotated[
    _Words | Direction, OneOf('a direction in words, such as "front left", a name, or three finite numbers')
]
"""Words such as ``front left``, the name of a place, or a vector (LPS)."""


class Beside(Model):
    """A place that is so far from a named one."""

    near: Name
    """Name of a landmark or a structure."""
    towards: Towards
    """Which way. From a ring towards a place: along the ring's axis, on the side of that place."""
    by_mm: Annotated[float, Field(ge=-1000.0, le=1000.0)]
    """How far, mm."""


class Way(Model):
    """How far an instrument is led from where it closed."""

    near: Name | None = None
    """Where it closed; needed where ``towards`` names a place."""
    towards: Towards
    """Which way."""
    by_mm: PositiveMm
    """How far, mm."""


Place = Annotated[Name | PointMm | Beside, OneOf("a name, three finite numbers, or { near = ... }")]
"""A named place, a point (LPS, mm), or beside a named place."""


def direction_of_words(words: str) -> tuple[int, int, int] | None:
    """The direction that some words stand for, LPS; None where they are no such words, or cancel out."""
    parts = words.lower().split()
    if not parts or any(part not in DIRECTIONS for part in parts):
        return None
    x, y, z = (sum(DIRECTIONS[part][axis] for part in parts) for axis in range(3))
    return (x, y, z) if x or y or z else None


def known_name(name: str, known: Iterable[str]) -> str | None:
    """Which of the known names is meant: the same but for case, or another name of the same structure; None if none."""
    names = tuple(known)
    for one in names:
        if normalised(one) == normalised(name):
            return one
    term = term_by_name(name)
    return None if term is None else next((one for one in names if term_by_name(one) is term), None)


def names_in(value: Any) -> Iterable[tuple[tuple[str | int, ...], str]]:
    """The names of places in the data of a command, and where in it they stand; words for directions are none."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if isinstance(inner, str):
                takes_names = key.endswith("_mm") or key in ("near", "towards", *_DIRECTIONS_OF)
                if takes_names and direction_of_words(inner) is None:
                    yield (key,), inner
            else:
                yield from (((key, *place), name) for place, name in names_in(inner))
    elif isinstance(value, list | tuple):
        for number, inner in enumerate(value):
            if isinstance(inner, str):
                yield (number,), inner
            else:
                yield from (((number, *place), name) for place, name in names_in(inner))


def numbered(value: Any, point: Any, vector: Any, key: str = "") -> Any:
    """A command's data with numbers for places and directions.

    Parameters
    ----------
    value
        The data.
    point, vector
        Give the numbers (x, y, z) of a place and of a direction or a way, as they are written.
    key
        Under which key the value stands.
    """
    if key in _DIRECTIONS_OF and isinstance(value, str):
        return vector(value)
    if key == "offset_mm" and isinstance(value, dict):
        return vector(value)
    if key.endswith("_mm"):
        if isinstance(value, str | dict):
            return point(value)
        if isinstance(value, list | tuple):
            return [numbered(inner, point, vector, key) for inner in value]
        return value
    if isinstance(value, dict):
        return {inner_key: numbered(inner, point, vector, inner_key) for inner_key, inner in value.items()}
    return value
