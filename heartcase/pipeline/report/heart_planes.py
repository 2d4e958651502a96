"""The heart's own planes through a scan: short axis, four-, two- and three-chamber, from labels or landmarks.

The long axis runs from the middle of the mitral valve to the apex. Valves are where the labels on both sides of them
touch; the apex is the part of the left ventricle that lies farthest from the valve. The four-chamber plane holds the
long axis and the tricuspid valve, the three-chamber plane the long axis and the aortic valve, the two-chamber plane
the long axis at right angles to the four-chamber plane. The short axis lies across the long one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.report.views import Place, towards_viewer, upward
from heartcase.schemas.arrays import Float64, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable

__all__ = ["HeartPlane", "HeartPlanes", "heart_planes"]

_LEFT_VENTRICLE, _LEFT_ATRIUM = "87878005", "82471001"
_RIGHT_VENTRICLE, _RIGHT_ATRIUM, _AORTA = "53085002", "73829009", "15825003"
_STRUCTURES = {
    _LEFT_VENTRICLE: "left ventricle",
    _LEFT_ATRIUM: "left atrium",
    _RIGHT_VENTRICLE: "right ventricle",
    _RIGHT_ATRIUM: "right atrium",
    _AORTA: "aorta",
}
_VALVES = {
    "mitral valve": (_LEFT_VENTRICLE, _LEFT_ATRIUM),
    "aortic valve": (_LEFT_VENTRICLE, _AORTA),
    "tricuspid valve": (_RIGHT_VENTRICLE, _RIGHT_ATRIUM),
}
_LEAST_FACES = 6
"""Voxel faces in which two labels must touch to be a valve."""
_APEX_SHARE = 0.005
"""Share of the ventricle that counts as its farthest part."""
_LEAST_SINE = 0.1
"""A valve that lies on the long axis tells no plane."""
_HEAD_FIRST, _LEFT = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class HeartPlane:
    """How a plane is looked at: unit vectors, LPS."""

    right: Float64
    """To the picture's right, shape (3,)."""
    down: Float64
    """Down the picture, shape (3,)."""
    normal: Float64
    """Across the plane, to the next slice, shape (3,)."""


@dataclass(frozen=True)
class HeartPlanes:
    """The planes that there are, and what the others lack."""

    planes: dict[str, HeartPlane]
    """``short_axis``, ``four_chamber``, ``two_chamber``, ``three_chamber`` -> the plane."""
    missing: dict[str, tuple[str, ...]]
    """Those that are not there -> structures that must be labelled for them, and touch."""
    centre_mm: Float64 | None
    """The middle of the long axis, LPS mm, shape (3,); None where there is none."""


def heart_planes(
    labels: UInt8, geometry: Geometry, table: LabelTable, *, places: Mapping[str, Place] | None = None
) -> HeartPlanes:
    """The heart's own planes.

    Parameters
    ----------
    labels
        Label of every voxel, shape [z, y, x].
    geometry
        Their lattice.
    table
        What the values stand for.
    places
        Landmarks that go before the labels, from :func:`heartcase.pipeline.report.views.places_of`.

    Returns
    -------
    HeartPlanes
        Without the planes that labels and landmarks do not tell.
    """
    found = {name: place.position_mm for name, place in (places or {}).items()}
    values = {code: label.value for code in _STRUCTURES if (label := table.find_code(code)) is not None}
    # while nothing is marked around the heart, its labels reach to the rim of the scan
    if (labels == BACKGROUND).any():
        for valve, pair in _VALVES.items():
            if valve not in found and all(code in values for code in pair):
                middle = _contact(labels, geometry, *(values[code] for code in pair))
                found |= {} if middle is None else {valve: middle}
        base = found.get("mitral valve", found.get("aortic valve"))
        if base is not None and "apex" not in found and _LEFT_VENTRICLE in values:
            apex = _farthest(labels, geometry, values[_LEFT_VENTRICLE], base)
            found |= {} if apex is None else {"apex": apex}
        surroundings: tuple[str, ...] = ()
    else:
        surroundings = (table[BACKGROUND].name,)
    base, apex = found.get("mitral valve", found.get("aortic valve")), found.get("apex")
    axis_needs = (*surroundings, *_names(table, _VALVES["mitral valve"]))
    planes: dict[str, HeartPlane] = {}
    missing: dict[str, tuple[str, ...]] = {}
    if base is None or apex is None or not (apex - base).any():
        right_side = _names(table, _VALVES["tricuspid valve"])
        missing = {"short_axis": axis_needs, "four_chamber": (*axis_needs, *right_side)}
        missing |= {"two_chamber": missing["four_chamber"]}
        missing |= {"three_chamber": (*axis_needs, *_names(table, (_AORTA,)))}
        return HeartPlanes({}, missing, None)
    axis = _unit(apex - base)
    planes["short_axis"] = _seen_from(axis)
    four = _across(axis, found.get("tricuspid valve"), base)
    if four is None:
        needs = (*surroundings, *_names(table, _VALVES["tricuspid valve"]))
        missing |= {"four_chamber": needs, "two_chamber": needs}
    else:
        planes["four_chamber"] = _seen_from(towards_viewer(four))
        planes["two_chamber"] = _from_the_left(_unit(np.cross(axis, four)))
    # the base is the aortic valve itself where the mitral one is not known
    three = None if "mitral valve" not in found else _across(axis, found.get("aortic valve"), base)
    if three is None:
        missing["three_chamber"] = (*axis_needs, *_names(table, (_AORTA,)))
    else:
        planes["three_chamber"] = _from_the_left(three)
    return HeartPlanes(planes, missing, (base + apex) / 2.0)


def _names(table: LabelTable, codes: tuple[str, ...]) -> tuple[str, ...]:
    labels = [(table.find_code(code), code) for code in codes]
    return tuple(_STRUCTURES[code] if label is None else label.name for label, code in labels)


def _contact(labels: UInt8, geometry: Geometry, one: int, other: int) -> Float64 | None:
    """The mean of the voxel faces where two labels touch, LPS mm; None where they hardly do."""
    box = _box_around(labels, one)
    if box is None:
        return None
    part = labels[box]
    first = np.array([side.start for side in box], float)
    middles = []
    for axis in range(3):
        turned = np.moveaxis(part, axis, 0)
        low, high = (np.moveaxis(half, 0, axis) for half in (turned[:-1], turned[1:]))
        touching = ((low == one) & (high == other)) | ((low == other) & (high == one))
        at = np.argwhere(touching).astype(float)
        at[:, axis] += 0.5
        middles.append(at)
    faces = np.concatenate(middles)
    if len(faces) < _LEAST_FACES:
        return None
    return _world(geometry, first + faces.mean(axis=0))


def _farthest(labels: UInt8, geometry: Geometry, value: int, base: Float64) -> Float64 | None:
    """The middle of the part of a label that lies farthest from a point, LPS mm; None where there is no such label."""
    box = _box_around(labels, value)
    if box is None:
        return None
    at = np.argwhere(labels[box] == value) + np.array([side.start for side in box])
    points = _world(geometry, at.astype(float))
    distances = np.linalg.norm(points - base, axis=1)
    chosen: Float64 = points[distances >= np.quantile(distances, 1.0 - _APEX_SHARE)].mean(axis=0)
    return chosen


def _box_around(labels: UInt8, value: int) -> tuple[slice, slice, slice] | None:
    """The box of a label with a rim of one voxel; None where there is no such label."""
    mask = labels == value
    sides = []
    for axis in range(3):
        there = np.flatnonzero(mask.any(axis=tuple(other for other in range(3) if other != axis)))
        if not len(there):
            return None
        sides.append(slice(max(int(there[0]) - 1, 0), min(int(there[-1]) + 2, labels.shape[axis])))
    k, j, i = sides
    return k, j, i


def _world(geometry: Geometry, at_kji: Float64) -> Float64:
    """Positions of array indices [k, j, i], LPS mm."""
    positions: Float64 = at_kji[..., ::-1] @ geometry.affine[:3, :3].T + geometry.affine[:3, 3]
    return positions


def _unit(vector: Float64) -> Float64:
    unit: Float64 = vector / np.linalg.norm(vector)
    return unit


def _across(axis: Float64, place: Float64 | None, base: Float64) -> Float64 | None:
    """The normal of the plane through the long axis and a place; None where the place lies on the axis."""
    if place is None or not (place - base).any():
        return None
    normal = np.cross(axis, _unit(place - base))
    return _unit(normal) if np.linalg.norm(normal) > _LEAST_SINE else None


def _seen_from(towards: Float64) -> HeartPlane:
    """A plane as somebody on its side ``towards`` sees it, with the patient's left as far to the right as can be."""
    up = upward(towards)
    return HeartPlane(np.cross(up, towards), -up, towards)


def _from_the_left(normal: Float64) -> HeartPlane:
    """A plane as somebody at the patient's left sees it, with the head as near to the top as can be."""
    towards = normal if normal @ _LEFT >= 0.0 else -normal
    flat = -_HEAD_FIRST + (_HEAD_FIRST @ towards) * towards
    # where one looks along the body, the front is up
    down = _unit(flat) if np.linalg.norm(flat) > _LEAST_SINE else np.array([0.0, 1.0, 0.0])
    return HeartPlane(np.cross(down, -towards), down, towards)
