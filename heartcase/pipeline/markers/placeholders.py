"""The example strokes of a starter recipe, and how they are recognised.

They are told by where they lie, not by a mark in the file: a comment is easily kept beside a stroke that was moved, or
lost beside one that was not. Whoever moves an example makes it a stroke; whoever leaves one as it was is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heartcase.schemas.errors import Problem
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.settings import Stroke

__all__ = ["EXAMPLE_RADIUS_MM", "StarterPlaces", "example_strokes", "placeholder_problems"]

EXAMPLE_RADIUS_MM = 2.0
"""Radius of the starter recipe's strokes."""
BACKGROUND_SHARE = 0.45
"""How far from the middle the example of background lies, as a part of the scan's extent along its first axis."""
SAME_PLACE_MM = 0.051
"""Starter recipes are written with one decimal."""

Point = tuple[float, float, float]


@dataclass(frozen=True)
class StarterPlaces:
    """Where a starter recipe puts its examples: LPS mm, rounded to a tenth."""

    center_mm: Point
    """The middle of the whole scan."""
    extent_mm: Point
    """Its extent along i, j, k."""
    background_mm: Point
    """Where the example of background lies."""

    @classmethod
    def of(cls, geometry: Geometry) -> StarterPlaces:
        """The places in a scan."""
        x, y, z = (float(v) for v in geometry.index_to_world([(n - 1) / 2 for n in geometry.size]))
        center = round(x, 1), round(y, 1), round(z, 1)
        a, b, c = (n * s for n, s in zip(geometry.size, geometry.spacing_mm, strict=True))
        extent = round(a, 1), round(b, 1), round(c, 1)
        return cls(center, extent, (round(center[0] - BACKGROUND_SHARE * extent[0], 1), center[1], center[2]))


def example_strokes(strokes: Sequence[Stroke], scan: Geometry | None = None) -> tuple[int, ...]:
    """Which strokes are still the examples of a starter recipe.

    A stroke is one where it is a single dab at a place where the starter recipe of this scan has one, whatever its
    label and its radius were made. Whatever the scan, so are two dabs of the starter's brush of which one marks
    background exactly to the right of the other, as no hand paints.

    Parameters
    ----------
    strokes
        Strokes of a recipe.
    scan
        Lattice of the whole scan, where it is at hand.

    Returns
    -------
    tuple of int
        Their numbers, from 1.
    """
    dabs = {n: (stroke, stroke.points_mm[0]) for n, stroke in enumerate(strokes, 1) if len(stroke.points_mm) == 1}
    found: set[int] = set()
    if scan is not None:
        places = StarterPlaces.of(scan)
        for number, (_, point) in dabs.items():
            if _is_at(point, places.center_mm) or _is_at(point, places.background_mm):
                found.add(number)
    brushes = {n: dab for n, dab in dabs.items() if dab[0].radius_mm == EXAMPLE_RADIUS_MM}
    for number, (stroke, point) in brushes.items():
        if stroke.label is None or stroke.label.strip().lower() == "background":
            continue
        for other, (beside, place) in brushes.items():
            is_background = beside.label is not None and beside.label.strip().lower() == "background"
            if is_background and place[1:] == point[1:] and place[0] < point[0]:
                found |= {number, other}
    return tuple(sorted(found))


def placeholder_problems(recipe: Recipe, scan: Geometry | None = None) -> tuple[Problem, ...]:
    """What of a recipe is still the example that a starter recipe came with: it stands for nothing in the scan.

    Parameters
    ----------
    recipe
        Any recipe.
    scan
        Lattice of the whole scan; without it only pairs of strokes are known again.
    """
    problems = []
    if recipe.segment.method != "labels":
        problems += [
            Problem(
                f"strokes[{number}]",
                "this is still the example that the starter recipe came with: it marks a place that nobody looked at; "
                "put points of your own in its place, or take the stroke out",
            )
            for number in example_strokes(recipe.strokes, scan)
        ]
    if scan is None:
        return tuple(problems)
    center = StarterPlaces.of(scan).center_mm
    others = [(f"ends[{n}]", end.position_mm, end.radius_mm == 20.0) for n, end in enumerate(recipe.ends, 1)]
    others += [(f"pins[{n}]", pin.position_mm, pin.radius_mm == 10.0) for n, pin in enumerate(recipe.pins, 1)]
    others += [
        (f"edits[{n}]", edit.position_mm, edit.diameter_mm == 8.0)
        for n, edit in enumerate(recipe.edits, 1)
        if edit.kind in ("septal_defect", "close_defect") and edit.enabled
    ]
    problems += [
        Problem(
            place,
            "this is still the example that the starter recipe came with, at the very middle of the scan: put the true "
            "place and size there, or take it out",
        )
        for place, position, has_example_size in others
        if has_example_size and _is_at(position, center)
    ]
    return tuple(problems)


def _is_at(point: Point, place: Point) -> bool:
    return bool(np.abs(np.subtract(point, place)).max() <= SAME_PLACE_MM)
