"""The still pictures of a case: from the front, cut open, and a small one for the index."""

from __future__ import annotations

import io
import re

import numpy as np
from PIL import Image

from heartcase.pipeline.report.pictures import cutaway_picture, surface_picture
from heartcase.pipeline.report.views import CutView, four_chamber_view, places_of
from heartcase.schemas.arrays import Float64, UInt8
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.landmarks import Landmark
from heartcase.studio.offline.surfaces import SurfaceArrays

__all__ = ["PICTURE_SIZE", "SMALL_SIZE", "case_pictures", "lesion_view", "small_picture"]

PICTURE_SIZE = (800, 600)
SMALL_SIZE = (320, 240)
_QUALITY = 84
_HOLE = re.compile(r"\b(defect|vsd|asd)\b", re.IGNORECASE)
_LEAST_SINE, _UPRIGHT = 0.05, 0.35


def case_pictures(
    surface: SurfaceArrays, table: LabelTable, landmarks: tuple[Landmark, ...]
) -> tuple[dict[str, bytes], str]:
    """Draw a case.

    Returns
    -------
    dict, str
        ``small``, ``front`` and ``cut`` -> a WebP file; and how the plane of the cut was found, one sentence.
    """
    points, faces = surface.vertices_mm.astype(np.float64), surface.triangles
    front = _front(surface, table)
    places = places_of(landmarks)
    view = lesion_view(landmarks) or four_chamber_view(places, points, faces, surface.void, table)
    marks = {place.name: place.position_mm for place in places.values()}
    cut = cutaway_picture(
        points, faces, surface.void, surface.tissue, table,
        plane=view.plane, up=view.up, marks=marks, size=PICTURE_SIZE, normals=surface.normals,
    )  # fmt: skip
    return {"small": _small(front), "front": _webp(front), "cut": _webp(cut)}, view.source


def small_picture(surface: SurfaceArrays, table: LabelTable) -> bytes:
    """The case from the front, as a small WebP file."""
    return _small(_front(surface, table))


def _front(surface: SurfaceArrays, table: LabelTable) -> UInt8:
    return surface_picture(
        surface.vertices_mm.astype(np.float64), surface.triangles, surface.void, table,
        view="anterior", size=PICTURE_SIZE, triangle_tissue=surface.tissue, normals=surface.normals,
    )  # fmt: skip


def _small(pixels: UInt8) -> bytes:
    return _webp(np.asarray(Image.fromarray(pixels).resize(SMALL_SIZE, Image.Resampling.LANCZOS)))


def lesion_view(landmarks: tuple[Landmark, ...]) -> CutView | None:
    """The cut that shows what a case is about: through its first hole and the apex, or along a narrow aorta.

    None where no landmark says that there is either: a ring with an axis whose name says defect, VSD or ASD, or an
    incision that is planned over the aortic isthmus.
    """
    places = places_of(landmarks)
    hole = next((one for one in landmarks if one.axis is not None and _HOLE.search(one.name)), None)
    if hole is not None and hole.axis is not None and "apex" in places:
        middle, axis = np.mean(hole.points_mm, axis=0), np.array(hole.axis)
        return _through(middle, axis, places["apex"].position_mm - middle, f"through {hole.name} and apex")
    isthmus = next((one for one in landmarks if one.name == "aortic isthmus"), None)
    if isthmus is not None and "aortic valve" in places:
        line = np.array(isthmus.points_mm)
        middle = line.mean(axis=0)
        away = middle - places["aortic valve"].position_mm
        return _through(middle, line[-1] - line[0], away, "along the aortic isthmus and through the aortic valve")
    return None


def _through(middle: Float64, first: Float64, second: Float64, words: str) -> CutView | None:
    """A plane that holds a point and two directions, seen from the feet, or from the left where it stands upright."""
    normal = np.cross(first, second)
    length = float(np.linalg.norm(normal))
    if length < _LEAST_SINE * float(np.linalg.norm(first) * np.linalg.norm(second)):
        return None
    normal /= length
    towards = -normal[2] if abs(normal[2]) > _UPRIGHT else normal[0]
    normal = normal if towards > 0.0 else -normal
    up = second - (second @ normal) * normal
    return CutView((middle, normal), up / np.linalg.norm(up), f"The cut is {words}.")


def _webp(pixels: UInt8) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="WEBP", quality=_QUALITY, method=4)
    return stream.getvalue()
