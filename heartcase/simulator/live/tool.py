"""What the mouse holds: it sees pointers, and answers with commands of an operating session. No window.

A tool sees the mouse pressed, dragged and let go. Leading and moving are where a hand shall be:
:mod:`heartcase.simulator.live.goals` takes it there no faster than tissue stands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.recording.commands import Done
from heartcase.simulator.live.rays import Pointer

__all__ = ["TAKE_UP_MM", "Held", "Row", "Tool", "Turn", "nearest_held", "row_of", "rows_of"]

Row = tuple[float, float, float]
Turn = tuple[Row, Row, Row]

TAKE_UP_MM = 5.0
"""A held instrument is taken up again where the mouse points at most so far beside its centre, mm."""


@dataclass(frozen=True)
class Held:
    """An instrument that holds tissue at a moment, as a tool must know it to lead it further."""

    name: str
    """Its name."""
    center_mm: Float64
    """Where its centre is, LPS mm, shape (3,)."""
    offset_mm: Float64
    """Way of its centre since it closed, LPS mm, shape (3,)."""
    turn: Turn | None = None
    """Its rotation since it closed, LPS axes; None for none."""


@dataclass
class Tool:
    """What the mouse holds. This one does nothing; the others answer with commands."""

    new_name: Callable[[str], str]
    """Gives a name that no instrument and no stitch has yet, for a kind of them."""
    size: float = 0.0
    """What can be set of it, such as a radius, mm or N."""

    key: ClassVar[str] = ""
    """Key that takes it."""
    title: ClassVar[str] = ""
    """What it is called."""
    size_words: ClassVar[str] = ""
    """What ``size`` is, with its unit behind."""
    sizes: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 0.0)
    """Smallest and largest ``size``, and its step."""
    lets_go: ClassVar[bool] = False
    """Whether what it leads is let go when the mouse is."""

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """The mouse is pressed; ``held`` are the instruments that hold tissue now."""
        return []

    def drag(self, pointer: Pointer) -> list[Done]:
        """The mouse is moved while it is pressed."""
        return []

    def release(self, pointer: Pointer) -> list[Done]:
        """The mouse is let go."""
        return []

    def wheel(self, notches: int) -> list[Done] | None:
        """The wheel is turned away from the user by notches; None where the tool has no use for it now."""
        return None

    def forget(self) -> None:
        """Put down all that was begun: the mouse is taken away, or time goes back."""

    def resize(self, steps: int) -> None:
        """Change ``size`` by steps."""
        low, high, step = self.sizes
        self.size = float(np.clip(self.size + steps * step, low, high))

    @property
    def led(self) -> str | None:
        """Name of the instrument that the mouse leads now."""
        return None

    @property
    def is_waiting(self) -> bool:
        """Whether the next press counts wherever it is, and not on tissue alone."""
        return False

    @property
    def line_mm(self) -> Float64:
        """What is drawn so far, LPS mm, shape (count, 3)."""
        return np.zeros((0, 3))


def nearest_held(pointer: Pointer, held: Sequence[Held]) -> Held | None:
    """The instrument that is pointed at: the one whose centre is nearest to the ray, not further than TAKE_UP_MM."""
    best, least = None, TAKE_UP_MM
    for one in held:
        arm = one.center_mm - pointer.ray.start_mm
        apart = float(np.linalg.norm(arm - (arm @ pointer.ray.direction) * pointer.ray.direction))
        if apart < least:
            best, least = one, apart
    return best


def row_of(place: Float64) -> Row:
    """A place as commands have it."""
    x, y, z = (float(value) for value in place)
    return (x, y, z)


def rows_of(places: Float64) -> tuple[Row, ...]:
    """Places as commands have them."""
    return tuple(row_of(place) for place in places)
