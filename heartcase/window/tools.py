"""What the mouse does with a tool in hand, as commands of an operating session. Pointers in, commands out: no window.

A tool sees the mouse pressed, dragged and let go, and answers with commands. Leading and moving are where a hand shall
be: :mod:`heartcase.window.goals` takes it there no faster than tissue stands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.recording.commands import (
    BringProbe,
    CloseForceps,
    CloseGrab,
    CloseRetractor,
    Cut,
    Done,
    DrawStitch,
    LeadGrab,
    MoveProbe,
    OpenGrab,
    PlacePatch,
    PlaceRow,
    PlaceStitch,
    WithdrawProbe,
)
from heartcase.window.lines import DrawnLine
from heartcase.window.rays import Pointer, on_plane

__all__ = [
    "TOOLS",
    "CutTool",
    "ForcepsTool",
    "GrabTool",
    "Held",
    "PatchTool",
    "ProbeTool",
    "RetractorTool",
    "RowTool",
    "StitchTool",
    "Tool",
    "nearest_held",
]

Row = tuple[float, float, float]
Turn = tuple[Row, Row, Row]

TAKE_UP_MM = 5.0
"""A held instrument is taken up again where the mouse points at most so far beside its centre, mm."""
ABOVE_MM = 2.0
"""How far above a drawn line a blade begins, mm."""
PULL_MIN_MM = 2.0
"""How far a lip is pulled before it is known which lip is meant, mm."""


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

    def lead(self, pointer: Pointer | None) -> LeadGrab:
        return LeadGrab(name=self.name, offset_mm=_point(self.offset_mm + self.way_mm(pointer)), turn=self.turn)


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
    def is_waiting(self) -> bool:
        """Whether the next press counts wherever it is, and not on tissue alone."""
        return False

    @property
    def line_mm(self) -> Float64:
        """What is drawn so far, LPS mm, shape (count, 3)."""
        return np.zeros((0, 3))


@dataclass
class GrabTool(Tool):
    """A hand that closes where the mouse is pressed, goes with it, and lets go with it."""

    size: float = 6.0
    key: ClassVar[str] = "g"
    title: ClassVar[str] = "grab"
    size_words: ClassVar[str] = "radius {:g} mm"
    sizes: ClassVar[tuple[float, float, float]] = (2.0, 20.0, 1.0)
    _drag: _Drag | None = None

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """Close on the tissue in a ball around what is pointed at."""
        if pointer.hit is None:
            return []
        self._drag = _Drag(self.new_name("hand"), pointer.hit.point_mm, pointer.axes)
        return [CloseGrab(name=self._drag.name, center_mm=_point(pointer.hit.point_mm), radius_mm=self.size)]

    def drag(self, pointer: Pointer) -> list[Done]:
        """Lead it across the view."""
        return [] if self._drag is None else [self._drag.lead(pointer)]

    def release(self, pointer: Pointer) -> list[Done]:
        """Let go."""
        drag, self._drag = self._drag, None
        return [] if drag is None else [OpenGrab(name=drag.name)]

    def wheel(self, notches: int) -> list[Done] | None:
        """Lead it away from the eye, 1 mm a notch."""
        return _deeper(self._drag, notches)

    def forget(self) -> None:
        """Put down what was begun."""
        self._drag = None


@dataclass
class ProbeTool(Tool):
    """A ball that is there while the mouse is pressed, goes with it across the view, and deeper by the wheel."""

    size: float = 5.0
    key: ClassVar[str] = "p"
    title: ClassVar[str] = "probe"
    size_words: ClassVar[str] = "radius {:g} mm"
    sizes: ClassVar[tuple[float, float, float]] = (2.0, 20.0, 1.0)
    _drag: _Drag | None = None

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """Bring it in where it just touches the tissue that is pointed at."""
        if pointer.hit is None:
            return []
        centre = pointer.hit.point_mm + self.size * pointer.hit.normal
        self._drag = _Drag(self.new_name("probe"), pointer.hit.point_mm, pointer.axes, offset_mm=centre)
        return [BringProbe(name=self._drag.name, center_mm=_point(centre), semi_axes_mm=(self.size,) * 3)]

    def drag(self, pointer: Pointer) -> list[Done]:
        """Move it."""
        return self._moved(pointer)

    def release(self, pointer: Pointer) -> list[Done]:
        """Take it away."""
        drag, self._drag = self._drag, None
        return [] if drag is None else [WithdrawProbe(name=drag.name)]

    def wheel(self, notches: int) -> list[Done] | None:
        """Push it in, 1 mm a notch."""
        if self._drag is None:
            return None
        self._drag.deeper_mm += notches
        return self._moved(None)

    def forget(self) -> None:
        """Put down what was begun."""
        self._drag = None

    def _moved(self, pointer: Pointer | None) -> list[Done]:
        if self._drag is None:
            return []
        return [MoveProbe(name=self._drag.name, center_mm=_point(self._drag.offset_mm + self._drag.way_mm(pointer)))]


@dataclass
class CutTool(Tool):
    """A blade along a line that is drawn on the tissue, into it."""

    size: float = 12.0
    key: ClassVar[str] = "c"
    title: ClassVar[str] = "cut"
    size_words: ClassVar[str] = "depth {:g} mm"
    sizes: ClassVar[tuple[float, float, float]] = (2.0, 60.0, 1.0)
    _line: DrawnLine | None = None

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """Begin a line."""
        self._line = DrawnLine()
        return self.drag(pointer)

    def drag(self, pointer: Pointer) -> list[Done]:
        """Draw it."""
        if self._line is not None:
            self._line.add(pointer.ray, pointer.hit)
        return []

    def release(self, pointer: Pointer) -> list[Done]:
        """Cut along it; a line that is too short is none."""
        self.drag(pointer)
        line, self._line = self._line, None
        if line is None or not line.is_long_enough:
            return []
        poses = line.blade_poses_mm(pointer.ray.direction, above_mm=ABOVE_MM, depth_mm=self.size)
        return [Cut(name="blade", poses_mm=tuple(_points(pose) for pose in poses))]

    def forget(self) -> None:
        """Put down what was begun."""
        self._line = None

    @property
    def line_mm(self) -> Float64:
        """The line so far."""
        return np.zeros((0, 3)) if self._line is None else self._line.line_mm


@dataclass
class ForcepsTool(Tool):
    """Forceps that close where the mouse is pressed, go with it and stay; pressed on again, they are led on."""

    size: float = 8.0
    key: ClassVar[str] = "f"
    title: ClassVar[str] = "forceps"
    size_words: ClassVar[str] = "jaws {:g} mm apart"
    sizes: ClassVar[tuple[float, float, float]] = (2.0, 20.0, 1.0)
    length_mm: float = 10.0
    _drag: _Drag | None = None

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
                tip_mm=_point(tip),
                direction=_point(pointer.ray.direction),
                closing=_point(pointer.axes[0]),
                length_mm=self.length_mm,
                opening_mm=self.size,
            )
        ]

    def drag(self, pointer: Pointer) -> list[Done]:
        """Lead them across the view."""
        return [] if self._drag is None else [self._drag.lead(pointer)]

    def release(self, pointer: Pointer) -> list[Done]:
        """Leave them where they are: they hold on."""
        self._drag = None
        return []

    def wheel(self, notches: int) -> list[Done] | None:
        """Lead them away from the eye, 1 mm a notch."""
        return _deeper(self._drag, notches)

    def forget(self) -> None:
        """Put down what was begun."""
        self._drag = None


@dataclass
class RetractorTool(Tool):
    """A retractor along a line that is drawn at a lip; then the lip is pulled, and stays. It can be led on later."""

    size: float = 6.0
    key: ClassVar[str] = "r"
    title: ClassVar[str] = "retractor"
    size_words: ClassVar[str] = "depth {:g} mm"
    sizes: ClassVar[tuple[float, float, float]] = (2.0, 20.0, 1.0)
    _line: DrawnLine | None = None
    _is_drawn: bool = False
    _drag: _Drag | None = None
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
        return _deeper(self._drag, notches) if self._holds else None

    def forget(self) -> None:
        """Put down what was begun, a drawn line too."""
        self._line = self._drag = None
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
        held = CloseRetractor(name=name, line_mm=_points(line), side=_point(side), depth_mm=self.size)
        return [held, self._drag.lead(pointer)]


@dataclass
class StitchTool(Tool):
    """A stitch between two places that are clicked, drawn with a tension until it is tied."""

    size: float = 0.5
    key: ClassVar[str] = "s"
    title: ClassVar[str] = "stitch"
    size_words: ClassVar[str] = "tension {:.1f} N"
    sizes: ClassVar[tuple[float, float, float]] = (0.1, 5.0, 0.1)
    _first_mm: Float64 | None = None

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """The first place, or the second: then the thread goes through both, and is drawn."""
        if pointer.hit is None:
            return []
        if self._first_mm is None:
            self._first_mm = pointer.hit.point_mm
            return []
        places, self._first_mm = (_point(self._first_mm), _point(pointer.hit.point_mm)), None
        name = self.new_name("stitch")
        return [PlaceStitch(name=name, places_mm=places), DrawStitch(name=name, tension_n=self.size)]

    def forget(self) -> None:
        """Put down what was begun."""
        self._first_mm = None

    @property
    def line_mm(self) -> Float64:
        """The first place, where it waits for the second."""
        return np.zeros((0, 3)) if self._first_mm is None else self._first_mm[None]


@dataclass
class RowTool(Tool):
    """A row of stitches: both places of the first and of the last are clicked, those between are filled in."""

    size: float = 0.5
    key: ClassVar[str] = "n"
    title: ClassVar[str] = "row of stitches"
    size_words: ClassVar[str] = "tension {:.1f} N"
    sizes: ClassVar[tuple[float, float, float]] = (0.1, 5.0, 0.1)
    _clicked: list[Float64] = field(default_factory=list)

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """One more of the four places: of the first stitch, then of the last, on the same side first."""
        if pointer.hit is None:
            return []
        self._clicked.append(pointer.hit.point_mm)
        if len(self._clicked) < 4:
            return []
        a, b, c, d = (_point(place) for place in self._clicked)
        self._clicked = []
        name = self.new_name("row")
        return [PlaceRow(name=name, places_mm=((a, b), (c, d))), DrawStitch(name=name, tension_n=self.size)]

    def forget(self) -> None:
        """Put down what was begun."""
        self._clicked = []

    @property
    def line_mm(self) -> Float64:
        """The places so far."""
        return np.array(self._clicked, dtype=float).reshape(-1, 3)


@dataclass
class PatchTool(Tool):
    """A patch that is cut to an outline drawn around an opening, its rim stitched on along it."""

    size: float = 2.5
    key: ClassVar[str] = "e"
    title: ClassVar[str] = "patch"
    size_words: ClassVar[str] = "stitches {:g} mm apart"
    sizes: ClassVar[tuple[float, float, float]] = (1.0, 10.0, 0.5)
    _line: DrawnLine | None = None

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """Begin the outline."""
        self._line = DrawnLine()
        return self.drag(pointer)

    def drag(self, pointer: Pointer) -> list[Done]:
        """Draw it."""
        if self._line is not None:
            self._line.add(pointer.ray, pointer.hit)
        return []

    def release(self, pointer: Pointer) -> list[Done]:
        """Close it and sew the patch on; an outline of fewer than three points is none."""
        self.drag(pointer)
        line, self._line = self._line, None
        if line is None or len(line.points) < 3:
            return []
        return [PlacePatch(name=self.new_name("patch"), outline_mm=_points(line.line_mm), spacing_mm=self.size)]

    def forget(self) -> None:
        """Put down what was begun."""
        self._line = None

    @property
    def line_mm(self) -> Float64:
        """The outline so far."""
        return np.zeros((0, 3)) if self._line is None else self._line.line_mm


TOOLS: tuple[type[Tool], ...] = (
    GrabTool,
    ProbeTool,
    CutTool,
    ForcepsTool,
    RetractorTool,
    StitchTool,
    RowTool,
    PatchTool,
)
"""All of them, in the order in which they are listed."""


def nearest_held(pointer: Pointer, held: Sequence[Held]) -> Held | None:
    """The instrument that is pointed at: the one whose centre is nearest to the ray, not further than TAKE_UP_MM."""
    best, least = None, TAKE_UP_MM
    for one in held:
        arm = one.center_mm - pointer.ray.start_mm
        apart = float(np.linalg.norm(arm - (arm @ pointer.ray.direction) * pointer.ray.direction))
        if apart < least:
            best, least = one, apart
    return best


def _taken_up(pointer: Pointer, held: Sequence[Held]) -> _Drag | None:
    one = nearest_held(pointer, held)
    if one is None:
        return None
    start = on_plane(pointer.ray, one.center_mm, pointer.axes[2])
    if start is None:
        return None
    return _Drag(one.name, start, pointer.axes, offset_mm=one.offset_mm, turn=one.turn)


def _deeper(drag: _Drag | None, notches: int) -> list[Done] | None:
    if drag is None:
        return None
    drag.deeper_mm += notches
    return [drag.lead(None)]


def _point(place: Float64) -> Row:
    x, y, z = (float(value) for value in place)
    return (x, y, z)


def _points(places: Float64) -> tuple[Row, ...]:
    return tuple(_point(place) for place in places)
