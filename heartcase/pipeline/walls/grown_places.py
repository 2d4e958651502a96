"""The places where septa were grown: what is left of them beside stated openings, and what a person said of them.

A septum is grown in the walls stage, from strokes and landmarks alone. Whether a septal defect is cut through it
afterwards, and whether somebody looked at it and took it for wall, is known where the case is put together:
:func:`judged_places`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from heartcase.pipeline.checks.openings import Opening, Verdict
from heartcase.pipeline.fields.contacts import Contact
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import LISTED_BETWEEN, CaseWarning, note
from heartcase.schemas.arrays import Float64
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.settings import ContactPlace

__all__ = ["LEAST_REST_MM2", "ContactPatch", "grown_warnings", "judged_places", "patches_of"]

LEAST_MM2 = 1.0
"""Smaller patches beside a larger one are no places of their own."""
LEAST_REST_MM2 = 3.0
"""What is no place of its own is still warned of, once the places are settled, where it is so much together: as much as
a circle of 2 mm."""
MOST_PLACES = 8
"""Patches of one septum that are places of their own."""
POINT_COUNT = 48
"""Points of a patch that tell how much of it is opened, at most."""


@dataclass(frozen=True)
class ContactPatch:
    """A piece of the contact of two cavities, on both sides of which a septum was grown."""

    center_mm: tuple[float, float, float]
    """Its point that is nearest to its mean, world mm."""
    area_mm2: float
    """Its area."""
    radius_mm: float
    """Distance from its centre to its farthest point."""
    points_mm: Float64
    """Points spread over it, world mm, shape (n, 3)."""

    def figures(self) -> dict[str, Any]:
        """Plain values, rounded to 0.1 mm and 0.1 mm2."""
        return {
            "center_mm": [round(value, 1) + 0.0 for value in self.center_mm],
            "area_mm2": round(self.area_mm2, 1),
            "radius_mm": round(self.radius_mm, 1),
            "points_mm": (self.points_mm.round(1) + 0.0).tolist(),
        }


def patches_of(contact: Contact) -> tuple[tuple[ContactPatch, ...], ContactPatch | None]:
    """The patches of a contact of one pair that are worth a look, the largest first; always the largest one.

    And all others together, with the centre of the largest of them; None where there are none.
    """
    found = []
    for patch in contact.patches():
        extent, points = patch.extent(), patch.points_mm
        found.append(ContactPatch(extent.center_mm, extent.area_mm2, extent.reach_mm, points))
    found.sort(key=lambda one: (-round(one.area_mm2, 1), one.center_mm))
    count = sum(n == 0 or one.area_mm2 >= LEAST_MM2 for n, one in enumerate(found[:MOST_PLACES]))
    places, rest = found[:count], found[count:]
    others = None
    if rest:
        points, center = np.concatenate([one.points_mm for one in rest]), rest[0].center_mm
        radius = float(np.linalg.norm(points - center, axis=1).max())
        others = ContactPatch(center, sum(one.area_mm2 for one in rest), radius, _some(points))
    return tuple(replace(one, points_mm=_some(one.points_mm)) for one in places), others


def _some(points_mm: Float64) -> Float64:
    """Points spread over all, in their order."""
    count = min(len(points_mm), POINT_COUNT)
    return points_mm[np.unique(np.linspace(0, len(points_mm) - 1, count).astype(np.int64))]


def judged_places(
    figures: Sequence[Mapping[str, Any]],
    openings: Sequence[Opening],
    said: Sequence[ContactPlace],
    table: LabelTable,
    voxel_mm: float,
) -> tuple[list[dict[str, Any]], tuple[CaseWarning, ...]]:
    """What is to be thought of each place of the septa, once the openings of the heart are known.

    Parameters
    ----------
    figures
        The septa: :func:`heartcase.pipeline.walls.septa.septum_figures`. A septum without places stays as it is.
    openings
        Where cavities are open to each other: :func:`heartcase.pipeline.checks.openings.find_openings`.
    said
        What the recipe says of places: ``walls.contact``.
    table
        Label table of the structures.
    voxel_mm
        Edge of a cube with the volume of a voxel, mm.

    Returns
    -------
    figures, warnings
        The figures with a ``state`` of each place and without its points: ``grown``, ``opened`` where stated openings
        hold each of its points or come within a voxel of it, or ``confirmed`` where what the recipe says is wall holds
        the other points; between the points, :data:`POINT_COUNT` at most, nothing is looked at. The area of a place is
        what is left of it, and so is that of ``others``, the patches of a septum that are no places. And the warnings
        of what is left.
    """
    judged = [_judged(one, openings, said, table, voxel_mm) for one in figures]
    return judged, (*grown_warnings(judged), *_confirmed_notes(judged))


def grown_warnings(figures: Sequence[Mapping[str, Any]]) -> tuple[CaseWarning, ...]:
    """What a person must look at: walls that nobody saw, the largest first.

    Parameters
    ----------
    figures
        The septa, judged or not.
    """
    left = [one for one in map(_left, figures) if one is not None]
    left.sort(key=lambda one: -one["area_mm2"])
    if not left:
        return ()
    listed = tuple(
        f"{one['between'][0]} and {one['between'][1]} over {_area(one)} mm² near {_place(one)} mm "
        f"({one['thickness_mm']:g} mm thick)"
        for one in left
    )
    return (
        CaseWarning(
            sentence("grown-septum", listed=LISTED_BETWEEN.join(listed)),
            code="grown-septum",
            places_mm=tuple(tuple(one["center_mm"]) for one in left),
            listed=listed,
        ),
    )


def _left(figure: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """A septum as far as it is neither opened nor confirmed; None where nothing is left to be looked at."""
    places = figure.get("places", [])
    settled = [one for one in places if one.get("state", "grown") != "grown"]
    open_yet = [one for one in places if one.get("state", "grown") == "grown"]
    if not settled:
        return figure
    if figure.get("others", {"area_mm2": 0.0})["area_mm2"] >= LEAST_REST_MM2:
        open_yet.append(figure["others"])
    if not open_yet:
        # small patches beside those that were looked at
        return None
    area = sum(one["area_mm2"] for one in open_yet)
    largest = max(open_yet, key=lambda one: one["area_mm2"])
    return {**figure, "area_mm2": area, "center_mm": largest["center_mm"]}


def _judged(
    figure: Mapping[str, Any],
    openings: Sequence[Opening],
    said: Sequence[ContactPlace],
    table: LabelTable,
    voxel_mm: float,
) -> dict[str, Any]:
    pair = tuple(sorted(table[name].value for name in figure["between"]))
    stated = [one for one in openings if one.verdict is Verdict.STATED and one.labels == pair]
    walls = [one for one in said if not one.is_open and tuple(sorted(table[n].value for n in one.between)) == pair]
    places = []
    for place in figure.get("places", ()):
        points = np.array(place["points_mm"])
        is_open, is_rim, is_wall = np.zeros((3, len(points)), np.bool_)
        for one in stated:
            is_open |= one.holds(points, 0.0)
            is_rim |= one.holds(points, voxel_mm)
        for wall in walls:
            is_wall |= np.linalg.norm(points - wall.position_mm, axis=1) <= wall.radius_mm + voxel_mm
        state = "opened" if is_rim.all() else "confirmed" if (is_wall | is_rim).all() else "grown"
        left = place["area_mm2"] if state == "opened" else place["area_mm2"] * float((~is_open).mean())
        rest = {key: value for key, value in place.items() if key != "points_mm"}
        places.append(rest | {"area_mm2": round(left, 1), "state": state})
    judged = {**figure, "places": places} if "places" in figure else dict(figure)
    if "others" in figure:
        points = np.array(figure["others"]["points_mm"])
        is_left = np.ones(len(points), np.bool_)
        for one in stated:
            is_left &= ~one.holds(points, voxel_mm)
        for wall in walls:
            is_left &= np.linalg.norm(points - wall.position_mm, axis=1) > wall.radius_mm + voxel_mm
        rest = {key: value for key, value in figure["others"].items() if key != "points_mm"}
        judged["others"] = rest | {"area_mm2": round(rest["area_mm2"] * float(is_left.mean()), 1)}
    return judged


def _confirmed_notes(figures: Sequence[Mapping[str, Any]]) -> tuple[CaseWarning, ...]:
    found = [(one, place) for one in figures for place in one.get("places", ()) if place["state"] == "confirmed"]
    return tuple(
        note(
            sentence(
                "grown-septum-confirmed",
                one=one["between"][0],
                other=one["between"][1],
                area=_area(place),
                place=_place(place),
            ),
            code="grown-septum-confirmed",
            places_mm=(tuple(place["center_mm"]),),
        )
        for one, place in found
    )


def _area(figure: Mapping[str, Any]) -> str:
    area_mm2 = figure["area_mm2"]
    return f"{area_mm2:,.0f}" if area_mm2 >= 10.0 else f"{area_mm2:.1f}"


def _place(figure: Mapping[str, Any]) -> str:
    return f"({', '.join(f'{value:.1f}' for value in figure['center_mm'])})"
