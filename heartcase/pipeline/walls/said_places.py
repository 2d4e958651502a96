"""What the recipe says of places that the heart does not have any more: told, since nothing else would show it.

An entry of ``walls.contact`` is a ball. Strokes that move or part the outlines later leave it without effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from heartcase.pipeline.checks.openings import REACH_VOXELS, Opening, Verdict, verdict_of
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, anatomy
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.edit_settings import CloseDefect, Edit
from heartcase.schemas.recipe.settings import ContactPlace, WallsSettings

__all__ = ["said_warnings"]


def said_warnings(
    figures: Sequence[Mapping[str, Any]],
    openings: Sequence[Opening],
    walls: WallsSettings,
    table: LabelTable,
    voxel_mm: float,
    edits: Sequence[Edit] = (),
) -> tuple[CaseWarning, ...]:
    """One warning for each entry of ``walls.contact`` that has no effect, in their order.

    Parameters
    ----------
    figures
        The septa, not judged yet: :func:`heartcase.pipeline.walls.septa.septum_figures`.
    openings
        Where cavities are open to each other: :func:`heartcase.pipeline.checks.openings.find_openings`.
    walls
        What the recipe says of walls.
    table
        Label table of the structures.
    voxel_mm
        Edge of a cube with the volume of a voxel, mm.
    edits
        The recipe's edits: a place that is closed by a patch is meant to have no opening.

    Returns
    -------
    tuple of CaseWarning
        Of an opening that is stated and not there: the anatomy may be wrong. Of a wall that is stated where none was
        grown, and of a pair that every heart has open: worth a look.
    """
    found = []
    for number, one in enumerate(walls.contact, start=1):
        kind = _kind(one, figures, openings, walls, table, voxel_mm, edits)
        if kind:
            place = f"({', '.join(f'{value:.1f}' for value in one.position_mm)})"
            text = sentence(kind, one=one.between[0], other=one.between[1], place=place)
            make = anatomy if kind == "contact-not-open" else CaseWarning
            found.append(make(f"walls.contact[{number}]: {text}", code=kind, places_mm=(one.position_mm,)))
    return tuple(found)


def _kind(
    one: ContactPlace,
    figures: Sequence[Mapping[str, Any]],
    openings: Sequence[Opening],
    walls: WallsSettings,
    table: LabelTable,
    voxel_mm: float,
    edits: Sequence[Edit],
) -> str:
    """Kind of the warning about an entry; empty where it has its effect."""
    pair = _values(table, one.between)
    is_normal = verdict_of(table[pair[0]], table[pair[1]]) is Verdict.EXPECTED
    if is_normal and pair in {_values(table, septum.between) for septum in walls.septum}:
        is_normal = False
    if one.is_open:
        near = [
            opening
            for opening in openings
            if opening.labels == pair and _reaches(one, opening.points_mm, REACH_VOXELS * voxel_mm)
        ]
        if not near:
            return "" if any(_is_patch_of(edit, one, voxel_mm) for edit in edits) else "contact-not-open"
        return "contact-normal" if is_normal else ""
    for figure in figures:
        if _values(table, figure["between"]) == pair:
            places = (*figure.get("places", ()), *([figure["others"]] if "others" in figure else ()))
            if any(_reaches(one, [place["center_mm"], *place["points_mm"]], voxel_mm) for place in places):
                return ""
    return "contact-normal" if is_normal else "contact-no-wall"


def _reaches(one: ContactPlace, points_mm: Any, margin_mm: float) -> bool:
    away = np.linalg.norm(np.array(points_mm, np.float64).reshape(-1, 3) - one.position_mm, axis=1)
    return bool((away <= one.radius_mm + margin_mm).any())


def _is_patch_of(edit: Edit, one: ContactPlace, voxel_mm: float) -> bool:
    """Whether an edit closes the place."""
    if not isinstance(edit, CloseDefect) or not edit.enabled:
        return False
    away = np.linalg.norm(np.array(edit.position_mm) - one.position_mm)
    return bool(away <= one.radius_mm + 0.5 * edit.diameter_mm + REACH_VOXELS * voxel_mm)


def _values(table: LabelTable, names: Sequence[str]) -> tuple[int, int]:
    low, high = sorted(table[name].value for name in names)
    return low, high
