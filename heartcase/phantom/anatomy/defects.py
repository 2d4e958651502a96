"""Where the holes of septa are: each kind is a straight canal through the tissue between two places of the blood."""

from __future__ import annotations

import numpy as np

from heartcase.phantom.anatomy.axes import LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS
from heartcase.phantom.anatomy.build import Anatomy, mirrored
from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.edit_settings import SeptalDefect
from heartcase.schemas.recipe.heart_form import DefectKind, HeartDefect

__all__ = ["mirrored_defect", "place_defect", "straight_defect"]

LEFT_VENTRICLE, RIGHT_VENTRICLE, LEFT_ATRIUM, RIGHT_ATRIUM, SUPERIOR_CAVA = 0, 1, 2, 3, 6


def _at(along: float, right: float, up: float) -> Float64:
    point: Float64 = along * LONG_AXIS + right * SEPTUM_AXIS + up * UPWARD_AXIS
    return point


def _across(along: float, degrees: float) -> tuple[Float64, Float64]:
    """From the left ventricle's axis outwards, at an angle from the septum's middle towards its upper edge."""
    outward = np.cos(np.radians(degrees)) * SEPTUM_AXIS + np.sin(np.radians(degrees)) * UPWARD_AXIS
    return along * LONG_AXIS, along * LONG_AXIS + 46.0 * outward


_LINES: dict[DefectKind, tuple[int, int, tuple[Float64, Float64]]] = {
    "secundum": (LEFT_ATRIUM, RIGHT_ATRIUM, (np.array((-7.0, 24.0, 8.0)), np.array((-38.0, 1.0, 1.0)))),
    "primum": (LEFT_ATRIUM, RIGHT_ATRIUM, (np.array((-14.0, 10.0, -4.0)), np.array((-30.0, -4.0, -7.0)))),
    "sinus venosus": (LEFT_ATRIUM, SUPERIOR_CAVA, (np.array((-41.0, 16.0, 27.0)), np.array((-41.0, -2.0, 26.0)))),
    "atrioventricular": (
        LEFT_VENTRICLE,
        RIGHT_VENTRICLE,
        (np.array((0.8, 6.0, -4.0)), np.array((-21.0, -15.0, -13.0))),
    ),
    "perimembranous": (LEFT_VENTRICLE, RIGHT_VENTRICLE, (_at(8.0, 4.0, 6.0), _at(8.0, 44.0, -2.0))),
    "inlet muscular": (LEFT_VENTRICLE, RIGHT_VENTRICLE, _across(17.0, -32.0)),
    "mid muscular": (LEFT_VENTRICLE, RIGHT_VENTRICLE, _across(30.0, 0.0)),
    "apical muscular": (LEFT_VENTRICLE, RIGHT_VENTRICLE, _across(52.0, -4.0)),
    "anterior muscular": (LEFT_VENTRICLE, RIGHT_VENTRICLE, _across(32.0, 30.0)),
    "subpulmonary": (LEFT_VENTRICLE, RIGHT_VENTRICLE, (np.array((9.5, -13.0, 1.0)), np.array((8.8, -50.0, 3.6)))),
}
"""Kind -> cavities that it joins, and a line from one to the other, in the adult's positions."""


def place_defect(defect: HeartDefect, anatomy: Anatomy, scale: float) -> SeptalDefect:
    """The canal of a defect in a heart that is not mirrored.

    Parameters
    ----------
    defect
        Which one.
    anatomy
        The heart's distance fields.
    scale
        Size against the adult's positions.

    Raises
    ------
    UsageError
        This heart has no septum there.
    """
    first, second, (start, stop) = _LINES[defect.kind]
    line = scale * (start + np.linspace(0.0, 1.0, 801)[:, None] * (stop - start))
    fields = anatomy.tables.evaluate(line)
    before, after = np.flatnonzero(fields[:, first] <= 0.0), np.flatnonzero(fields[:, second] <= 0.0)
    if not len(before) or not len(after) or before[-1] + 1 >= after[after > before[-1]].min(initial=len(line)):
        raise UsageError(f"a heart of this form has no septum where a defect that is {defect.kind} would be")
    near, far = before[-1] + 1, after[after > before[-1]][0] - 1
    septum = line[near : far + 1]
    length = float(np.linalg.norm(septum[-1] - septum[0]))
    canal = straight_defect(0.5 * (septum[0] + septum[-1]), stop - start, defect.diameter_mm, length + 8.0 * scale)
    if defect.width_mm is None or defect.width_mm == defect.diameter_mm:
        return canal
    return SeptalDefect.model_validate(
        canal.model_dump()
        | {"shape": "elliptic", "width_mm": defect.width_mm, "long_axis": tuple(np.round(LONG_AXIS, 5).tolist())}
    )


def straight_defect(position: Float64, axis: Float64, diameter_mm: float, length_mm: float) -> SeptalDefect:
    """A round canal at a place, along an axis."""
    unit = axis / np.linalg.norm(axis)
    return SeptalDefect(
        kind="septal_defect",
        position_mm=tuple(round(float(v), 3) for v in position),
        diameter_mm=diameter_mm,
        axis=tuple(round(float(v), 5) for v in unit),
        length_mm=round(length_mm, 3),
    )


def mirrored_defect(defect: SeptalDefect) -> SeptalDefect:
    """A canal with left and right exchanged."""
    long = None if defect.long_axis is None else mirrored(defect.long_axis)
    update = {"position_mm": mirrored(defect.position_mm), "axis": mirrored(defect.axis), "long_axis": long}
    return defect.model_copy(update=update)
