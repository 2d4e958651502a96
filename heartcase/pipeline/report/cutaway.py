"""Cutting a triangle mesh by a plane: the part that stays, the line of the cut, and the area inside it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.pipeline.report.render import Mesh
from heartcase.schemas.arrays import Bool, Float64, Int64, Integer

__all__ = ["Plane", "clipped", "crossings", "filled"]

Plane = tuple[npt.ArrayLike, npt.ArrayLike]
"""A point in mm, and a normal towards the side that is taken away."""


def clipped(mesh: Mesh, plane: Plane) -> Mesh:
    """Take away the side that the plane's normal points to; triangles on the plane are cut."""
    point, normal = (np.asarray(part, dtype=float) for part in plane)
    height = (mesh.points_mm - point) @ (normal / np.linalg.norm(normal))
    above = height[mesh.triangles] > 0.0
    count = above.sum(axis=1)
    pieces = [mesh.triangles[count == 0]]
    sources = [np.flatnonzero(count == 0)]
    new_points, new_normals, new_colours = [mesh.points_mm], [mesh.normals], [mesh.colours]
    total = len(mesh.points_mm)
    for crossed in (1, 2):
        member = np.flatnonzero(count == crossed)
        odd = np.argmax(above[member] == (crossed == 1), axis=1)
        a, b, c = (mesh.triangles[member, (odd + n) % 3] for n in range(3))
        ab, ac = total + np.arange(len(member)), total + len(member) + np.arange(len(member))
        for end in (b, c):
            part = (height[a] / (height[a] - height[end]))[:, None]
            new_points.append(mesh.points_mm[a] * (1.0 - part) + mesh.points_mm[end] * part)
            new_normals.append(mesh.normals[a] * (1.0 - part) + mesh.normals[end] * part)
            if mesh.colours_of_points:
                new_colours.append(np.round(mesh.colours[a] * (1.0 - part) + mesh.colours[end] * part).astype(np.uint8))
        total += 2 * len(member)
        kept = [(ab, b, c), (ab, c, ac)] if crossed == 1 else [(a, ab, ac)]
        pieces += [np.stack(piece, axis=1) for piece in kept]
        sources += [member] * len(kept)
    triangles = np.concatenate(pieces)
    colours = np.concatenate(new_colours) if mesh.colours_of_points else mesh.colours[np.concatenate(sources)]
    return Mesh(np.concatenate(new_points), triangles, np.concatenate(new_normals), colours, mesh.colours_of_points)


def crossings(points: Float64, faces: Integer, plane: Plane) -> tuple[Float64, Float64, Int64]:
    """Where triangles cross a plane: starts and ends of the pieces, shape (n, 3), and their triangles."""
    point, normal = (np.asarray(part, dtype=float) for part in plane)
    height = ((points - point) @ (normal / np.linalg.norm(normal)))[faces]
    above = height > 0.0
    count = above.sum(axis=1)
    member = np.flatnonzero((count == 1) | (count == 2))
    odd = np.argmax(above[member] == (count[member] == 1)[:, None], axis=1)
    order = (odd[:, None] + np.arange(3)) % 3
    corner = points[np.take_along_axis(faces[member], order, axis=1)]
    level = np.take_along_axis(height[member], order, axis=1)
    ends = []
    for other in (1, 2):
        part = (level[:, 0] / (level[:, 0] - level[:, other]))[:, None]
        ends.append(corner[:, 0] * (1.0 - part) + corner[:, other] * part)
    turned = (count[member] == 2)[:, None]
    return np.where(turned, ends[1], ends[0]), np.where(turned, ends[0], ends[1]), member


def filled(start: Float64, end: Float64, width: int, height: int) -> Bool:
    """Pixels whose centre the closed, oriented outline winds around; rows where the outline is open stay empty."""
    low, high = np.minimum(start[:, 1], end[:, 1]), np.maximum(start[:, 1], end[:, 1])
    first = np.clip(np.ceil(low), 0, height).astype(np.int64)
    rows_crossed = np.maximum(np.clip(np.ceil(high), 0, height).astype(np.int64) - first, 0)
    piece = np.repeat(np.arange(len(start)), rows_crossed)
    row = first[piece] + np.arange(len(piece)) - np.repeat(np.cumsum(rows_crossed) - rows_crossed, rows_crossed)
    a, b = start[piece], end[piece]
    column = a[:, 0] + (row - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    at = np.clip(np.ceil(column), 0, width).astype(np.int64)
    turns = np.zeros((height, width + 1), np.int64)
    np.add.at(turns, (row, at), np.where(b[:, 1] > a[:, 1], 1, -1))
    winding = np.cumsum(turns, axis=1)
    closed = winding[:, -1] == 0
    result: Bool = (winding[:, :-1] != 0) & closed[:, None]
    return result
