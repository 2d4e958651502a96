"""Tools that hold or push tissue: hand, probe, forceps, retractor. What they hold is led in a plane across the view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.recording.commands import (
    BringProbe,
    CloseForceps,
    CloseGrab,
    CloseRetractor,
    Done,
    LeadGrab,
    MoveProbe,
    OpenGrab,
    WithdrawProbe,
)
from heartcase.simulator.live.lines import DrawnLine
from heartcase.simulator.live.rays import Pointer, on_plane
from heartcase.simulator.live.tool import Held, Tool, Turn, nearest_held, row_of, rows_of

__all__ = ["ForcepsTool", "GrabTool", "ProbeTool", "RetractorTool"]

PULL_MIN_MM = 2.0
"""How far a lip is pulled before it is known which lip is meant, mm."""


@dataclass
class _Drag:
    """An instrument that is led in a plane across the view, and deeper or nearer by the wheel."""

    name: str
    from_mm: Float64
    """The place that the mouse took hold of, LPS mm."""
    axes: Float64
    """Those of the eye when it did."""
    offset_mm: Float64 = field(default_factory=lambda: np.zeros(3))
    """Offset of the instrument then, LPS mm."""
    turn: Turn | None = None
    deeper_mm: float = 0.0
    last_mm: Float64 = field(default_factory=lambda: np.zeros(3))
    """Way in the plane so far, LPS mm."""

    def way_mm(self, pointer: Pointer | None) -> Float64:
        """From where it was taken hold of to where the mouse points, LPS mm, shape (3,)."""
        if pointer is not None:
            place = on_plane(pointer.ray, self.from_mm, self.axes[2])
            if place is not None:
                self.last_mm = place - self.from_mm
        way: Float64 = self.last_mm - self.deeper_mm * self.axes[2]
        return way

    def lead(self, pointer: Pointer | None) -> Done:
        """The command that leads it there."""
        return LeadGrab(name=self.name, offset_mm=row_of(self.offset_mm + self.way_mm(pointer)), turn=self.turn)


class _ProbeDrag(_Drag):
    """A probe, which is moved: its offset is where its centre was."""

    def lead(self, pointer: Pointer | None) -> Done:
        """The command that moves it there."""
        return MoveProbe(name=self.name, center_mm=row_of(self.offset_mm + self.way_mm(pointer)))


@dataclass
class _LeadingTool(Tool):
    """A tool that leads what holds tissue, while the mouse is pressed."""

    _drag: _Drag | None = None

    @property
    def led(self) -> str | None:
        """Name of the instrument that the mouse leads now."""
        return None if self._drag is None else self._drag.name

    def drag(self, pointer: Pointer) -> list[Done]:
        """Lead it across the view."""
        return [] if self._drag is None else [self._drag.lead(pointer)]

    def wheel(self, notches: int) -> list[Done] | None:
        """Lead it away from the eye, 1 mm a notch."""
        if self._drag is None:
            return None
        self._drag.deeper_mm += notches
        return [self._drag.lead(None)]

    def forget(self) -> None:
        """Put down what was begun."""
        self._drag = None


@dataclass
class GrabTool(_LeadingTool):
    """A hand that closes where the mouse is pressed, goes with it, and lets go with it."""

    size: float = 6.0
    key: ClassVar[str] = "g"
    lets_go: ClassVar[bool] = True
    title: ClassVar[str] = "grab"
    size_words: ClassVar[str] = "radius {:g} mm"
    sizes: ClassVar[tuple[float, float, float]] = (2.0, 20.0, 1.0)

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """Close on the tissue in a ball around what is pointed at."""
        if pointer.hit is None:
            return []
        self._drag = _Drag(self.new_name("hand"), pointer.hit.point_mm, pointer.axes)
        return [CloseGrab(name=self._drag.name, center_mm=row_of(pointer.hit.point_mm), radius_mm=self.size)]

    def release(self, pointer: Pointer) -> list[Done]:
        """Let go."""
        drag, self._drag = self._drag, None
        return [] if drag is None else [OpenGrab(name=drag.name)]


@dataclass
class ProbeTool(_LeadingTool):
    """A ball that is there while the mouse is pressed, goes with it across the view, and deeper by the wheel."""

    size: float = 5.0
    key: ClassVar[str] = "p"
    lets_go: ClassVar[bool] = True
    title: ClassVar[str] = "probe"
    size_words: ClassVar[str] = "radius {:g} mm"
    sizes: ClassVar[tuple[float, float, float]] = (2.0, 20.0, 1.0)

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """Bring it in where it just touches the tissue that is pointed at."""
        if pointer.hit is None:
            return []
        centre = pointer.hit.point_mm + self.size * pointer.hit.normal
        self._drag = _ProbeDrag(self.new_name("probe"), pointer.hit.point_mm, pointer.axes, offset_mm=centre)
        return [BringProbe(name=self._drag.name, center_mm=row_of(centre), semi_axes_mm=(self.size,) * 3)]

    def release(self, pointer: Pointer) -> list[Done]:
        """Take it away."""
        drag, self._drag = self._drag, None
        return [] if drag is None else [WithdrawProbe(name=drag.name)]


@dataclass
class ForcepsTool(_LeadingTool):
    """Forceps that close where the mouse is pressed, go with it and stay; pressed on again, they are led on."""

    size: float = 8.0
    key: ClassVar[str] = "f"
    title: ClassVar[str] = "forceps"
    size_words: ClassVar[str] = "jaws {:g} mm apart"
    sizes: ClassVar[tuple[float, float, float]] = (2.0, 20.0, 1.0)
    length_mm: float = 10.0

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """Take hold along the view, with one jaw to the left and one to the right; or take up what holds already."""
        self._drag = _taken_up(pointer, held)
        if self._drag is not None or pointer.hit is None:
            return []
        tip = pointer.hit.point_mm + 0.6 * self.length_mm * pointer.ray.direction
        self._drag = _Drag(self.new_name("forceps"), pointer.hit.point_mm, pointer.axes)
        return [
            CloseForceps(
                name=self._drag.name,
                tip_mm=row_of(tip),
                direction=row_of(pointer.ray.direction),
                closing=row_of(pointer.axes[0]),
                length_mm=self.length_mm,
                opening_mm=self.size,
            )
        ]

    def release(self, pointer: Pointer) -> list[Done]:
        """Leave them where they are: they hold on."""
        self._drag = None
        return []


@dataclass
class RetractorTool(_LeadingTool):
    """A retractor along a line that is drawn at a lip; then the lip is pulled, and stays. It can be led on later."""

    size: float = 6.0
    key: ClassVar[str] = "r"
    title: ClassVar[str] = "retractor"
    size_words: ClassVar[str] = "depth {:g} mm"
    sizes: ClassVar[tuple[float, float, float]] = (2.0, 20.0, 1.0)
    _line: DrawnLine | None = None
    _is_drawn: bool = False
    _holds: bool = False

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """Begin a line; where one is drawn, begin to pull; or take up what holds already."""
        if self._is_drawn and self._line is not None:
            middle = self._line.line_mm.mean(axis=0)
            start = on_plane(pointer.ray, middle, pointer.axes[2])
            if start is not None:
                self._drag, self._holds = _Drag(self.new_name("retractor"), start, pointer.axes), False
            return []
        self._drag = _taken_up(pointer, held)
        self._holds = self._drag is not None
        if self._drag is None:
            self._line = DrawnLine()
            self._line.add(pointer.ray, pointer.hit)
        return []

    def drag(self, pointer: Pointer) -> list[Done]:
        """Draw the line, or pull: the way of the pull, across the line, says which lip is held."""
        if self._drag is None:
            if self._line is not None:
                self._line.add(pointer.ray, pointer.hit)
            return []
        if self._holds:
            return [self._drag.lead(pointer)]
        return self._take_hold(pointer)

    def release(self, pointer: Pointer) -> list[Done]:
        """The line is drawn, or the lip stays where it was pulled to."""
        if self._drag is None:
            if self._line is not None:
                self._line.add(pointer.ray, pointer.hit)
                self._is_drawn = self._line.is_long_enough
                self._line = self._line if self._is_drawn else None
            return []
        self._drag = None
        return []

    def wheel(self, notches: int) -> list[Done] | None:
        """Lead it away from the eye, 1 mm a notch."""
        return super().wheel(notches) if self._holds else None

    def forget(self) -> None:
        """Put down what was begun, a drawn line too."""
        super().forget()
        self._line = None
        self._is_drawn = self._holds = False

    @property
    def is_waiting(self) -> bool:
        """Whether a line is drawn and waits for a pull."""
        return self._is_drawn

    @property
    def line_mm(self) -> Float64:
        """The line so far, or the one that waits for a pull."""
        return np.zeros((0, 3)) if self._line is None else self._line.line_mm

    def _take_hold(self, pointer: Pointer) -> list[Done]:
        assert self._drag is not None
        assert self._line is not None
        line, way = self._line.line_mm, self._drag.way_mm(pointer)
        along = line[-1] - line[0]
        size = float(np.linalg.norm(along))
        side = way - (way @ along) / size**2 * along if size > 0.0 else way
        if np.linalg.norm(side) < PULL_MIN_MM:
            return []
        self._holds, self._is_drawn, self._line = True, False, None
        name = self._drag.name
        held = CloseRetractor(name=name, line_mm=rows_of(line), side=row_of(side), depth_mm=self.size)
        return [held, self._drag.lead(pointer)]


def _taken_up(pointer: Pointer, held: Sequence[Held]) -> _Drag | None:
    one = nearest_held(pointer, held)
    if one is None:
        return None
    start = on_plane(pointer.ray, one.center_mm, pointer.axes[2])
    if start is None:
        return None
    return _Drag(one.name, start, pointer.axes, offset_mm=one.offset_mm, turn=one.turn)
