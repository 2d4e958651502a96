"""Strokes on a lattice, clipped where they leave the scan or its region of interest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.markers.marker_help import ERASED
from heartcase.pipeline.markers.naming import listed, value_of
from heartcase.pipeline.markers.paint import paint_capsule, paint_passed_voxels
from heartcase.pipeline.warnings import CaseWarning, counted, note
from heartcase.schemas.arrays import Float64, Int64, UInt8
from heartcase.schemas.errors import MarkerError, Problem
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.settings import Stroke

__all__ = ["Clipping", "paint_strokes", "polyline_voxels", "rasterise_strokes", "stroke_voxels", "without_erased"]

MARKS_NAMED = 6
"""How many marks outside the scan a message calls by their place; the rest is counted."""


@dataclass
class Clipping:
    """Marks that do not lie wholly on a lattice: told together, not one by one.

    What lies outside the region of interest but in the scan is cut off: the region was made smaller, or was not meant
    for it. What lies outside the scan itself is an error.
    """

    geometry: Geometry
    """The lattice that is marked."""
    whole: Geometry | None = None
    """The whole scan's, of which it is a part; None where it is the whole scan."""
    thing: str = "stroke"
    """What the marks are called."""
    count: int = 0
    """Marks so far."""
    cut: int = 0
    """Those of which the region leaves out a part."""
    left_out: int = 0
    """Those that lie wholly outside the region."""
    outside: list[tuple[str, str, Float64]] = field(default_factory=list)
    """Places, names for messages and points of those outside the scan."""

    def take(self, place: str, called: str, points_mm: Float64, radius_mm: float) -> Int64:
        """The voxels that a mark paints: see :func:`polyline_voxels`; none where it lies outside."""
        self.count += 1
        voxels = polyline_voxels(points_mm, radius_mm, self.geometry)
        in_scan = voxels
        if self.whole is not None and not self.whole.matches(self.geometry):
            in_scan = polyline_voxels(points_mm, radius_mm, self.whole)
        if not len(in_scan):
            self.outside.append((place, called, points_mm))
        elif not len(voxels):
            self.left_out += 1
        elif len(voxels) < len(in_scan):
            self.cut += 1
        return voxels

    def problems(self, place: str) -> list[Problem]:
        """One problem for all marks outside the scan that call for the same remedy; ``place`` may be empty."""
        scan = self.whole or self.geometry
        found = []
        for remedy, is_flipped in (
            ("they seem to be RAS: change the sign of x and y", True),
            ("check positions (LPS mm)", False),
        ):
            marks = [mark for mark in self.outside if _is_inside_when_flipped(mark[2], scan) is is_flipped]
            if not marks:
                continue
            message = f"outside the scan, which reaches over {_bounds(scan)} mm: {remedy}"
            if len(marks) > 1:
                rest = f" and {len(marks) - MARKS_NAMED} more" if len(marks) > MARKS_NAMED else ""
                message = f"{', '.join(where for where, *_ in marks[:MARKS_NAMED])}{rest} lie {message}"
                found.append(Problem(place, message))
            else:
                (where, called, _), *_ = marks
                found.append(Problem(where if place else "", f"{called} lies {message}"))
        return found

    def warnings(self, place: str = "") -> tuple[CaseWarning, ...]:
        """One line about what the region of interest cuts off."""
        if not self.left_out and not self.cut:
            return ()
        parts = []
        if self.left_out:
            lie = "lies" if self.left_out == 1 else "lie"
            parts.append(
                f"{self.left_out} {lie} wholly outside the region of interest and {_is(self.left_out)} left out"
            )
        if self.cut:
            reach = "reaches" if self.cut == 1 else "reach"
            parts.append(f"{self.cut} {reach} out of the region of interest and {_is(self.cut)} cut there")
        words = f"{f'{place}: ' if place else ''}of {counted(self.count, self.thing)} {', '.join(parts)}"
        return (CaseWarning(words, has_stated_grade=True),) if self.left_out else (note(words),)


def _is(count: int) -> str:
    return "is" if count == 1 else "are"


def _bounds(geometry: Geometry) -> str:
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    reach = geometry.index_to_world(corners * np.array(geometry.size) - 0.5)
    return ", ".join(
        f"{axis} {low:.1f} to {high:.1f}"
        for axis, low, high in zip("xyz", reach.min(axis=0), reach.max(axis=0), strict=True)
    )


def _is_inside_when_flipped(points_mm: Float64, geometry: Geometry) -> bool:
    flipped = geometry.world_to_index(points_mm * (-1.0, -1.0, 1.0))
    return bool(((flipped > -0.5) & (flipped < np.array(geometry.size) - 0.5)).all())


def without_erased(stated: UInt8) -> UInt8:
    """Markers with what an eraser passed last left unmarked."""
    return np.where(stated == ERASED, np.uint8(UNMARKED), stated)


def rasterise_strokes(strokes: Sequence[Stroke], table: LabelTable, geometry: Geometry) -> UInt8:
    """Paint strokes: a ball of the brush's radius swept along a polyline, in true mm.

    Parameters
    ----------
    strokes
        Painted in order, later ones over earlier ones.
    table
        Label table.
    geometry
        Lattice to paint on; oblique, anisotropic and left-handed ones are fine.

    Returns
    -------
    ndarray
        uint8, shape ``geometry.shape``: label value (255 for an eraser) of each voxel whose centre is within the radius
        of the line, and of each voxel that the line itself passes (so that a thin brush leaves no gap, and radius 0 a
        line); 255 elsewhere. What reaches out of the lattice is cut off.

    Raises
    ------
    MarkerError
        With every stroke whose label is not in the table or that lies wholly outside the scan.
    """
    labels = np.full(geometry.shape, UNMARKED, dtype=np.uint8)
    paint_strokes(labels, strokes, table, Clipping(geometry))
    return without_erased(labels)


def stroke_voxels(stroke: Stroke, geometry: Geometry) -> Int64:
    """Voxels that a stroke marks or erases, see :func:`rasterise_strokes`.

    Returns
    -------
    ndarray
        Flat indices into a C-order array of ``geometry.shape``, ascending, int64; none where it lies outside.
    """
    return polyline_voxels(np.array(stroke.points_mm), stroke.radius_mm, geometry)


def polyline_voxels(points_mm: Float64, radius_mm: float, geometry: Geometry) -> Int64:
    """Voxels of a lattice that a round brush along a polyline marks: flat indices, ascending, as for strokes."""
    index = geometry.world_to_index(points_mm)
    spacing = np.array(geometry.spacing_mm)
    reach = radius_mm / spacing + 1.0
    # a box around the line, so that a short stroke costs the same in a large scan
    low = np.clip(np.floor(index.min(axis=0) - reach), 0, np.array(geometry.size)).astype(np.int64)
    high = np.clip(np.ceil(index.max(axis=0) + reach) + 1, low, np.array(geometry.size)).astype(np.int64)
    box = np.zeros((high - low)[::-1], np.uint8)
    if not box.size:
        return np.empty(0, np.int64)
    index = index - low
    for start, end in zip(index[: max(1, len(index) - 1)], index[1:] if len(index) > 1 else index, strict=True):
        if radius_mm > 0.0:
            paint_capsule(box, start, end, spacing, radius_mm, 1)
        paint_passed_voxels(box, start, end, 1)
    k, j, i = np.nonzero(box)
    found: Int64 = ((k + low[2]) * geometry.size[1] + j + low[1]) * geometry.size[0] + i + low[0]
    return found


def paint_strokes(
    labels: UInt8, strokes: Sequence[Stroke], table: LabelTable, clipping: Clipping
) -> tuple[CaseWarning, ...]:
    """Paint strokes over what is there, in place; where an eraser passes is ERASED then.

    Returns
    -------
    tuple of CaseWarning
        What the region of interest cuts off.

    Raises
    ------
    MarkerError
        Strokes whose label is not in the table, and all that lie outside the scan.
    """
    problems = []
    for number, stroke in enumerate(strokes, start=1):
        place = f"strokes[{number}]"
        value = ERASED if stroke.label is None else value_of(stroke.label, {}, table)
        if value is None:
            problems.append(Problem(place, f"there is no label {stroke.label!r} ({listed(table)})"))
        else:
            called = "the eraser's stroke" if stroke.label is None else f"the stroke {stroke.label!r}"
            voxels = clipping.take(place, called, np.array(stroke.points_mm), stroke.radius_mm)
            labels.reshape(-1)[voxels] = value
    problems = [*clipping.problems("strokes"), *problems]
    if problems:
        raise MarkerError(problems)
    return clipping.warnings()
