"""Tools that draw on tissue or click on it: blade, scissors, patch, stitch, row of stitches, excision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.recording.commands import Cut, Done, DrawStitch, Excise, PlacePatch, PlaceRow, PlaceStitch
from heartcase.schemas.recording.tool_commands import BringScissors, Snip, WithdrawScissors
from heartcase.simulator.live.lines import DrawnLine
from heartcase.simulator.live.rays import Hit, Pointer, on_plane
from heartcase.simulator.live.tool import Held, Row, Tool, row_of, rows_of

__all__ = ["CutTool", "ExciseTool", "PatchTool", "RowTool", "ScissorsTool", "StitchTool"]

ABOVE_MM = 2.0
"""How far above a drawn line a blade begins, mm."""
JAWS_DEG = 60.0
"""Angle between the open jaws of scissors, degrees."""
HINGE_MM = 4.0
"""How far behind the place that is pressed on the jaws are joined, mm."""
WAY_MIN_MM = 2.0
"""How far the mouse goes before it is known where the jaws point, and between two snips, mm."""


@dataclass
class _DrawingTool(Tool):
    """A tool that draws a line on the tissue while the mouse is pressed."""

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

    def forget(self) -> None:
        """Put down what was begun."""
        self._line = None

    @property
    def line_mm(self) -> Float64:
        """The line so far."""
        return np.zeros((0, 3)) if self._line is None else self._line.line_mm


@dataclass
class CutTool(_DrawingTool):
    """A blade along a line that is drawn on the tissue, into it."""

    size: float = 6.0
    """Depth, mm: through a wall of 4 mm, as the right ventricle's, and little further."""
    key: ClassVar[str] = "c"
    title: ClassVar[str] = "cut"
    size_words: ClassVar[str] = "depth {:g} mm"
    sizes: ClassVar[tuple[float, float, float]] = (2.0, 60.0, 1.0)

    def release(self, pointer: Pointer) -> list[Done]:
        """Cut along it; a line that is too short is none."""
        self.drag(pointer)
        line, self._line = self._line, None
        if line is None or not line.is_long_enough:
            return []
        poses = line.blade_poses_mm(pointer.ray.direction, above_mm=ABOVE_MM, depth_mm=self.size)
        return [Cut(name="blade", poses_mm=tuple(rows_of(pose) for pose in poses))]


@dataclass
class ScissorsTool(Tool):
    """Scissors that come where the mouse is pressed, one jaw on either side of the wall, and close as it goes on."""

    size: float = 20.0
    key: ClassVar[str] = "j"
    title: ClassVar[str] = "scissors"
    size_words: ClassVar[str] = "jaws {:g} mm long"
    sizes: ClassVar[tuple[float, float, float]] = (8.0, 40.0, 1.0)
    _hit: Hit | None = None
    _scissors: BringScissors | None = None
    _cut_mm: float = 0.0
    """How far from the hinge their edges have met."""

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """Begin where the tissue is pointed at."""
        self.forget()
        self._hit = pointer.hit
        return []

    def drag(self, pointer: Pointer) -> list[Done]:
        """The first way says where the jaws point; then their edges meet as far as the mouse is."""
        if self._hit is None:
            return []
        place = on_plane(pointer.ray, self._hit.point_mm, self._hit.normal)
        if place is None:
            return []
        way = place - self._hit.point_mm
        made: list[Done] = []
        if self._scissors is None:
            length = float(np.linalg.norm(way))
            if length < WAY_MIN_MM:
                return []
            self._scissors = BringScissors(
                name=self.new_name("scissors"),
                hinge_mm=row_of(self._hit.point_mm - HINGE_MM / length * way),
                direction=row_of(way / length),
                closing=row_of(self._hit.normal),
                length_mm=self.size,
                opening_deg=JAWS_DEG,
            )
            made.append(self._scissors)
        met = min(float(way @ np.array(self._scissors.direction)) + HINGE_MM, self.size)
        if met >= self._cut_mm + WAY_MIN_MM or (met == self.size and met > self._cut_mm):
            self._cut_mm = met
            made.append(Snip(name=self._scissors.name, angle_deg=JAWS_DEG * (1.0 - met / self.size)))
        return made

    def release(self, pointer: Pointer) -> list[Done]:
        """Take them away."""
        made = self.drag(pointer)
        scissors = self._scissors
        self.forget()
        return made if scissors is None else [*made, WithdrawScissors(name=scissors.name)]

    def forget(self) -> None:
        """Put down what was begun."""
        self._hit = self._scissors = None
        self._cut_mm = 0.0

    @property
    def line_mm(self) -> Float64:
        """From the hinge to where their edges have met."""
        if self._scissors is None:
            return np.zeros((0, 3))
        hinge = np.array(self._scissors.hinge_mm)
        return np.stack([hinge, hinge + self._cut_mm * np.array(self._scissors.direction)])


@dataclass
class PatchTool(_DrawingTool):
    """A patch that is cut to an outline drawn around an opening, its rim stitched on along it."""

    size: float = 2.5
    key: ClassVar[str] = "e"
    title: ClassVar[str] = "patch"
    size_words: ClassVar[str] = "stitches {:g} mm apart"
    sizes: ClassVar[tuple[float, float, float]] = (1.0, 10.0, 0.5)

    def release(self, pointer: Pointer) -> list[Done]:
        """Close it and sew the patch on; an outline of fewer than three points is none."""
        self.drag(pointer)
        line, self._line = self._line, None
        if line is None or len(line.points) < 3:
            return []
        return [PlacePatch(name=self.new_name("patch"), outline_mm=rows_of(line.line_mm), spacing_mm=self.size)]


@dataclass
class _ClickingTool(Tool):
    """A tool that collects places that are clicked."""

    _clicked: list[Float64] = field(default_factory=list)

    def forget(self) -> None:
        """Put down what was begun."""
        self._clicked = []

    @property
    def line_mm(self) -> Float64:
        """The places so far."""
        return np.array(self._clicked, dtype=float).reshape(-1, 3)

    def _click(self, pointer: Pointer, count: int) -> list[Row] | None:
        """One more place; all of them, once there are so many."""
        if pointer.hit is not None:
            self._clicked.append(pointer.hit.point_mm)
        if len(self._clicked) < count:
            return None
        places, self._clicked = [row_of(place) for place in self._clicked], []
        return places


@dataclass
class StitchTool(_ClickingTool):
    """A stitch between two places that are clicked, drawn with a tension until it is tied."""

    size: float = 0.5
    key: ClassVar[str] = "s"
    title: ClassVar[str] = "stitch"
    size_words: ClassVar[str] = "tension {:.1f} N"
    sizes: ClassVar[tuple[float, float, float]] = (0.1, 5.0, 0.1)

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """The first place, or the second: then the thread goes through both, and is drawn."""
        places = self._click(pointer, 2)
        if places is None:
            return []
        name = self.new_name("stitch")
        return [PlaceStitch(name=name, places_mm=(places[0], places[1])), DrawStitch(name=name, tension_n=self.size)]


@dataclass
class RowTool(_ClickingTool):
    """A row of stitches: both places of the first and of the last are clicked, those between are filled in."""

    size: float = 0.5
    key: ClassVar[str] = "n"
    title: ClassVar[str] = "row of stitches"
    size_words: ClassVar[str] = "tension {:.1f} N"
    sizes: ClassVar[tuple[float, float, float]] = (0.1, 5.0, 0.1)

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """One more of the four places: of the first stitch, then of the last, on the same side first."""
        places = self._click(pointer, 4)
        if places is None:
            return []
        a, b, c, d = places
        name = self.new_name("row")
        return [PlaceRow(name=name, places_mm=((a, b), (c, d))), DrawStitch(name=name, tension_n=self.size)]


@dataclass
class ExciseTool(Tool):
    """Takes out the piece that is clicked, which was cut free of all else."""

    key: ClassVar[str] = "z"
    title: ClassVar[str] = "excise"

    def press(self, pointer: Pointer, held: Sequence[Held] = ()) -> list[Done]:
        """Take it out."""
        if pointer.hit is None:
            return []
        return [Excise(place_mm=row_of(pointer.hit.point_mm))]
