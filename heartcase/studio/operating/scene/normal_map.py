"""The normal map of a case: the picture, and where on it each corner of the surface's triangles lies."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Bool, Float32, Int32
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.simulator.load import load_case
from heartcase.simulator.surface.deform import SurfaceModel

__all__ = ["NormalMap", "load_normal_map"]

_HEAD_SIZE = 20
"""Bytes of a GLB before its JSON."""
_CHUNK_HEAD_SIZE = 8
_NUMBERS = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True)
class NormalMap:
    """The normal map of a surface that is not cut."""

    png: bytes
    """The picture, in tangent space as of glTF 2.0."""
    corners: Int32
    """Render vertex at each corner of the triangles, shape (triangle_count, 3)."""
    uv: Float32
    """Place of each render vertex on the picture, from its upper left corner, shape (render_vertex_count, 2)."""
    tangent: Float32
    """Tangent along each render vertex's basis, and handedness, shape (render_vertex_count, 4)."""
    uncut: SurfaceModel
    """The surface, as it is before it is cut."""

    def corners_now(self, surface: SurfaceModel, triangle_origin: Int32 | None) -> Int32:
        """Render vertex at each corner of a surface that may be cut; -1 at all corners of a triangle that changed.

        Parameters
        ----------
        surface
            The surface.
        triangle_origin
            Triangle of the uncut surface that each is a part of, -1 for cut faces; None where nothing is cut.
        """
        if triangle_origin is None:
            return self.corners
        before, count = self.uncut, self.uncut.vertex_count
        is_same: Bool = np.ones(count, np.bool_)
        for name in ("triangle_nodes", "weights", "curvature", "offset", "normal"):
            one, other = getattr(surface, name)[:count].reshape(count, -1), getattr(before, name).reshape(count, -1)
            is_same &= (one == other).all(axis=1)
        origin = np.maximum(triangle_origin, 0)
        is_whole = (triangle_origin >= 0) & (surface.triangles == before.triangles[origin]).all(axis=1)
        is_whole &= is_same[np.minimum(surface.triangles, count - 1)].all(axis=1)
        found: Int32 = np.where(is_whole[:, None], self.corners[origin], -1).astype(np.int32)
        return found


def load_normal_map(path: Path, uncut: SurfaceModel, level: int = 0) -> NormalMap | None:
    """The normal map of a case at a level of detail; None where it has none.

    Parameters
    ----------
    path
        The case's folder.
    uncut
        Its surface at that level.
    level
        The level; 0 is the finest.

    Raises
    ------
    BundleError
        The bundle is broken.
    """
    bundle = open_bundle(path)
    role = FileRole.RENDER.at(level)
    if not bundle.has(role):
        return None
    try:
        parts = _parts_of(bundle.path(role).read_bytes())
    except (KeyError, IndexError, ValueError, TypeError, AttributeError):
        # The model for other programs is not what is operated on: without it the surface is a little smoother.
        return None
    if parts is None:
        return None
    png, render_triangles, uv = parts
    loaded = load_case(path, needs=("surface", "tangents"), level=level).surface
    assert loaded is not None
    welded = loaded.render_to_welded
    if len(uv) != len(welded) or len(render_triangles) != len(uncut.triangles):
        return None
    if render_triangles.min() < 0 or render_triangles.max() >= len(welded):
        return None
    of_render = welded[render_triangles]
    mine, theirs = np.lexsort(uncut.triangles.T), np.lexsort(of_render.T)
    if not np.array_equal(uncut.triangles[mine], of_render[theirs]):
        return None
    corners = np.empty_like(render_triangles)
    corners[mine] = render_triangles[theirs]
    return NormalMap(png, corners, uv, loaded.tangent, uncut)


def _parts_of(data: bytes) -> tuple[bytes, Int32, Float32] | None:
    """Picture, triangles and places on the picture of a GLB; None where it has no picture."""
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[_HEAD_SIZE : _HEAD_SIZE + length])
    blob = data[_HEAD_SIZE + length + _CHUNK_HEAD_SIZE :]
    if not document.get("images"):
        return None
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    start = view.get("byteOffset", 0)
    primitives = document["meshes"][0]["primitives"]
    triangles = np.concatenate([_array(document, blob, one["indices"]).reshape(-1, 3) for one in primitives])
    uv = _array(document, blob, primitives[0]["attributes"]["TEXCOORD_0"])
    return blob[start : start + view["byteLength"]], triangles.astype(np.int32), uv.astype(np.float32)


def _array(document: dict[str, Any], blob: bytes, number: int) -> Any:
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    start, width = view.get("byteOffset", 0) + accessor.get("byteOffset", 0), _COUNTS[accessor["type"]]
    kind = np.dtype(_NUMBERS[accessor["componentType"]])
    return np.frombuffer(blob, kind, accessor["count"] * width, start).reshape(-1, width)
