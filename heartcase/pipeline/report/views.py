"""The standard views of a heart: four-chamber, short-axis and the surgeon's, from landmarks where given.

Each cut takes away the side of the viewer. In both cuts the picture's right is as near to the patient's left as the
plane allows, so that the patient's right is on the picture's left as in the slices, and a heart that lies the other
way round looks the other way round.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.pipeline.report.pictures import four_chamber_plane
from heartcase.schemas.arrays import Float64
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.landmarks import Landmark

__all__ = ["CutView", "Place", "four_chamber_view", "places_of", "short_axis_view", "towards_viewer", "upward"]


_LEFT_VENTRICLE, _LEFT_ATRIUM = "87878005", "82471001"
_FEET_FIRST = np.array([0.0, -0.3, -1.0])
"""Where the viewer of a four-chamber cut stands: at the feet; in front where the cut runs along the body."""
_FLAT = 0.05
"""Height over longest side below which three landmarks count as lying on one line."""

_WORDS: dict[str, tuple[str, ...]] = {
    "apex": (
        *("apex", "cardiac apex", "heart apex", "apex of heart", "apex of the heart", "lv apex"),
        *("left ventricular apex", "left ventricle apex", "apex of left ventricle", "apex of the left ventricle"),
    ),
    "mitral valve": ("mitral", "left atrioventricular", "left av"),
    "tricuspid valve": ("tricuspid", "right atrioventricular", "right av"),
    "aortic valve": ("aortic",),
    "pulmonary valve": ("pulmonary", "pulmonic", "pulmonary trunk"),
}
"""Place -> names of the apex, or of the valve without what says which part of it."""

_VALVE_PARTS = re.compile(r"^(?:cent(?:er|re) of (?:the )?)?(.+?) (?:valve|annulus|valve annulus|valve cent(?:er|re))$")


@dataclass(frozen=True)
class Place:
    """A landmark that a view needs."""

    name: str
    """Its name in the recipe."""
    position_mm: Float64
    """The point; of a ring or a line the mean of its points. LPS, mm."""


@dataclass(frozen=True)
class CutView:
    """A cut through the heart and how it is looked at."""

    plane: tuple[Float64, Float64]
    """A point, mm, and the unit normal towards the viewer: that side is taken away."""
    up: Float64
    """Unit vector that shows upwards, in the plane."""
    source: str
    """How the plane was found, one sentence."""


def places_of(landmarks: Sequence[Landmark]) -> dict[str, Place]:
    """The landmarks that views are made from.

    Parameters
    ----------
    landmarks
        Those of the recipe. Names are compared without case and punctuation: ``mitral valve``, ``Mitral annulus``
        and ``left atrioventricular valve`` are one place, the first of them counts.

    Returns
    -------
    dict
        ``apex``, ``mitral valve``, ``tricuspid valve``, ``aortic valve``, ``pulmonary valve`` -> the landmark, as far
        as they are there.
    """
    found: dict[str, Place] = {}
    for landmark in landmarks:
        name = " ".join(re.sub(r"[^a-z0-9]+", " ", landmark.name.lower()).split())
        valve = _VALVE_PARTS.match(name)
        for place, words in _WORDS.items():
            if place not in found and (name if place == "apex" else valve and valve[1]) in words:
                found[place] = Place(landmark.name, np.mean(landmark.points_mm, axis=0))
    return found


def four_chamber_view(
    places: Mapping[str, Place],
    vertices_mm: npt.ArrayLike,
    triangles: npt.ArrayLike,
    triangle_label: npt.ArrayLike,
    table: LabelTable,
) -> CutView:
    """The cut through apex, mitral and tricuspid valve, seen from the feet as cardiac MRI shows it.

    Parameters
    ----------
    places
        From :func:`places_of`.
    vertices_mm, triangles, triangle_label, table
        The surface, for :func:`~heartcase.pipeline.report.pictures.four_chamber_plane` where a landmark is missing or
        the three lie on a line.

    Returns
    -------
    CutView
        The plane contains the three landmarks exactly.
    """
    wanted = ("apex", "mitral valve", "tricuspid valve")
    missing = [name for name in wanted if name not in places]
    if missing:
        why = f"the recipe has no landmark for {_listed(missing)}"
    else:
        corners = np.array([places[name].position_mm for name in wanted])
        sides = corners - np.roll(corners, 1, axis=0)
        across = np.cross(sides[0], sides[1])
        longest = float(np.linalg.norm(sides, axis=1).max())
        if np.linalg.norm(across) > _FLAT * longest**2:
            normal = towards_viewer(across / np.linalg.norm(across))
            names = _listed([f'"{places[name].name}"' for name in wanted])
            return CutView((corners[0], normal), upward(normal), f"Plane through the landmarks {names}.")
        why = "its landmarks lie on one line"
    point, normal = four_chamber_plane(vertices_mm, triangles, triangle_label, table)
    normal = towards_viewer(normal)
    return CutView((point, normal), upward(normal), f"Plane estimated from the shape of the chambers, as {why}.")


def short_axis_view(
    places: Mapping[str, Place],
    vertices_mm: npt.ArrayLike,
    triangles: npt.ArrayLike,
    triangle_label: npt.ArrayLike,
    table: LabelTable,
) -> CutView | None:
    """The cut across the left ventricle half way between apex and mitral valve, seen from the apex.

    Parameters
    ----------
    places
        From :func:`places_of`.
    vertices_mm, triangles, triangle_label, table
        The surface. Where a landmark is missing the long axis runs from the middle of the left atrium through that
        of the left ventricle, and the cut is half way along the ventricle.

    Returns
    -------
    CutView or None
        None where neither landmarks nor labels tell the long axis.
    """
    wanted = ("apex", "mitral valve")
    missing = [name for name in wanted if name not in places]
    if not missing:
        apex, mitral = (places[name].position_mm for name in wanted)
        length = float(np.linalg.norm(apex - mitral))
        if length > 0.0:
            normal = (apex - mitral) / length
            names = _listed([f'"{places[name].name}"' for name in wanted])
            source = f"Plane half way between the landmarks {names}, across the line that joins them."
            return CutView(((apex + mitral) / 2.0, normal), upward(normal), source)
        missing = ["apex"]
    points, faces, labels = np.asarray(vertices_mm, dtype=float), np.asarray(triangles), np.asarray(triangle_label)
    chambers = []
    for code in (_LEFT_VENTRICLE, _LEFT_ATRIUM):
        label = table.find_code(code)
        chambers.append(points[np.unique(faces[labels == label.value])] if label is not None else points[:0])
    ventricle, atrium = chambers
    if len(ventricle) == 0 or len(atrium) == 0:
        return None
    middle = (ventricle.min(axis=0) + ventricle.max(axis=0)) / 2.0
    axis = middle - (atrium.min(axis=0) + atrium.max(axis=0)) / 2.0
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return None
    normal = axis / length
    along = (ventricle - middle) @ normal
    source = (
        "Plane estimated from the shape of the left ventricle and atrium, as the recipe has no landmark for "
        f"{_listed(missing)}."
    )
    return CutView((middle + normal * (along.min() + along.max()) / 2.0, normal), upward(normal), source)


def towards_viewer(normal: Float64) -> Float64:
    """The normal of a cut turned to who stands at the feet, or in front where the cut runs along the body."""
    return normal if normal @ _FEET_FIRST >= 0.0 else -normal


def upward(towards: Float64) -> Float64:
    """Across ``towards``, what shows upwards when the picture's right is as near as can be to the patient's left."""
    right = np.array([1.0, 0.0, 0.0])
    if abs(towards[0]) > 0.98:
        right = np.array([0.0, np.sign(towards[0]), 0.0])
    right = right - (right @ towards) * towards
    up: Float64 = np.cross(towards, right / np.linalg.norm(right))
    return up


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
