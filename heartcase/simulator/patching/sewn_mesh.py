"""What is sewn, as triangles to be drawn beside the tissue: patches from both sides, threads as thin prisms."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float64, Int64, UInt8
from heartcase.simulator.patching.patches import PatchState
from heartcase.simulator.suturing.stitches import StitchState

__all__ = ["PATCH_COLOUR", "THREAD_COLOUR", "SewnMesh", "sewn_mesh"]

PATCH_COLOUR = (238, 232, 214)
"""Red, green, blue of patches."""
THREAD_COLOUR = (40, 60, 150)
"""Red, green, blue of threads."""
_THREAD_MM = 0.3
"""Radius of a thread as it is drawn, mm."""
_SIDES = 5


@dataclass(frozen=True)
class SewnMesh:
    """Patches and threads as triangles."""

    vertices_mm: Float64
    """LPS mm, shape (vertex_count, 3)."""
    normals: Float64
    """Unit normals, shape (vertex_count, 3)."""
    triangles: Int64
    """Vertex numbers, shape (triangle_count, 3)."""
    colours: UInt8
    """Red, green, blue of each triangle, shape (triangle_count, 3)."""


def sewn_mesh(patches: Iterable[PatchState], stitches: Iterable[StitchState]) -> SewnMesh:
    """Patches and stitches of a moment, as triangles."""
    vertices, normals, triangles, colours = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros((0, 3), int)], []
    count = 0
    for state in patches:
        own = state.triangles.astype(np.int64)
        vertices += [state.vertices_mm, state.vertices_mm]
        normals += [state.normals, -state.normals]
        triangles += [own + count, own[:, ::-1] + count + len(state.vertices_mm)]
        colours.append(np.tile(np.array(PATCH_COLOUR, np.uint8), (2 * len(own), 1)))
        count += 2 * len(state.vertices_mm)
    for stitch in stitches:
        points, out, own = _prism(stitch.places_mm)
        vertices.append(points)
        normals.append(out)
        triangles.append(own + count)
        colours.append(np.tile(np.array(THREAD_COLOUR, np.uint8), (len(own), 1)))
        count += len(points)
    return SewnMesh(
        np.concatenate(vertices),
        np.concatenate(normals),
        np.concatenate(triangles).astype(np.int64),
        np.concatenate([np.zeros((0, 3), np.uint8), *colours]),
    )


def _prism(ends_mm: Float64) -> tuple[Float64, Float64, Int64]:
    """Vertices, normals and triangles of a thread between two places, shape (2, 3)."""
    way = ends_mm[1] - ends_mm[0]
    length = float(np.linalg.norm(way))
    along = way / length if length > 0 else np.array([1.0, 0.0, 0.0])
    first = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    first /= np.linalg.norm(first)
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    out = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(along, first)
    points = np.concatenate([end + _THREAD_MM * out for end in ends_mm])
    number = np.arange(_SIDES)
    after = (number + 1) % _SIDES
    one = np.stack([number, after, after + _SIDES], axis=1)
    other = np.stack([number, after + _SIDES, number + _SIDES], axis=1)
    return points, np.concatenate([out, out]), np.concatenate([one, other])
