"""The still pictures of a case: from the front, cut open, and a small one for the index."""

from __future__ import annotations

import io

import numpy as np
import numpy.typing as npt
from PIL import Image

from heartcase.library.catalogue.mesh_data import SurfaceArrays
from heartcase.pipeline.report.pictures import cutaway_picture, surface_picture
from heartcase.pipeline.report.views import four_chamber_view, places_of
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.landmarks import Landmark

__all__ = ["PICTURE_SIZE", "SMALL_SIZE", "case_pictures"]

PICTURE_SIZE = (800, 600)
SMALL_SIZE = (320, 240)
_QUALITY = 84


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
    front = surface_picture(
        points, faces, surface.void, table,
        view="anterior", size=PICTURE_SIZE, triangle_tissue=surface.tissue, normals=surface.normals,
    )  # fmt: skip
    places = places_of(landmarks)
    view = four_chamber_view(places, points, faces, surface.void, table)
    marks = {place.name: place.position_mm for place in places.values()}
    cut = cutaway_picture(
        points, faces, surface.void, surface.tissue, table,
        plane=view.plane, up=view.up, marks=marks, size=PICTURE_SIZE, normals=surface.normals,
    )  # fmt: skip
    small = np.asarray(Image.fromarray(front).resize(SMALL_SIZE, Image.Resampling.LANCZOS))
    return {"small": _webp(small), "front": _webp(front), "cut": _webp(cut)}, view.source


def _webp(pixels: npt.NDArray[np.uint8]) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="WEBP", quality=_QUALITY, method=4)
    return stream.getvalue()
