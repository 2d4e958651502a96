"""Where instruments of a script go, and when."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from heartcase.schemas.base import Model

__all__ = ["Waypoint", "raise_problems", "time_problems"]

_Offset = Annotated[float, Field(ge=-10_000.0, le=10_000.0)]


class Waypoint(Model):
    """Where an instrument's centre is at a time; between waypoints it moves in a straight line."""

    time_s: Annotated[float, Field(ge=0.0)]
    """Time since the script's start, s."""
    offset_mm: tuple[_Offset, _Offset, _Offset]
    """Displacement from where it closed, or came in, LPS mm."""


def time_problems(start_s: float, release_s: float | None, path: Sequence[Waypoint]) -> list[str]:
    """What is wrong with when an instrument comes, goes and is led."""
    problems = []
    if release_s is not None and release_s <= start_s:
        problems.append("release_s must come after start_s")
    times = [waypoint.time_s for waypoint in path]
    if times != sorted(times) or len(set(times)) != len(times):
        problems.append("the waypoints' times must ascend")
    if times and times[0] < start_s:
        problems.append("the first waypoint comes before start_s")
    return problems


def raise_problems(problems: Sequence[str]) -> None:
    """ValueError with all problems, where there are some."""
    if problems:
        raise ValueError("; ".join(problems))
