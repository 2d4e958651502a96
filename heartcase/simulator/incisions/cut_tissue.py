"""What was cut, at rest: its area, the tissues that it went through, and how near it comes to vessels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float64, Int32, Int64, UInt8
from heartcase.schemas.geometry import Geometry

__all__ = ["CellTissues", "area_by_tissue_mm2", "area_mm2", "cut_triangles"]

_PIECES_MAX = 64
"""Pieces of a triangle's edge at most: a triangle of the blade's whole way in the smallest cells has no more."""


@dataclass(frozen=True)
class CellTissues:
    """Which tissue fills the cells of an uncut lattice."""

    geometry: Geometry
    """The lattice: its origin is the centre of cell (0, 0, 0)."""
    cells: Int32
    """Index (i, j, k) of each cell, shape (cell_count, 3)."""
    labels: UInt8
    """Label that fills most of it, shape (cell_count,)."""
    names: dict[int, str]
    """Name of each label."""


def cut_triangles(rest_mm: npt.ArrayLike, triangles: npt.ArrayLike, is_cut_face: Bool) -> Float64:
    """Corners of the walls of all cuts at rest, both sides of each, mm, shape (count, 3, 3).

    Parameters
    ----------
    rest_mm
        Vertices of the split surface at rest, mm, shape (vertex_count, 3).
    triangles
        Vertex numbers, shape (triangle_count, 3).
    is_cut_face
        Which of them are walls of cuts, shape (triangle_count,).
    """
    corners: Float64 = np.asarray(rest_mm, dtype=float)[np.asarray(triangles)[is_cut_face]]
    return corners


def area_mm2(corners_mm: Float64) -> float:
    """Area of what was cut, mm2: half of that of both walls.

    Parameters
    ----------
    corners_mm
        Walls, mm, shape (count, 3, 3): :func:`cut_triangles`.
    """
    return float(0.5 * _areas(corners_mm).sum())


def area_by_tissue_mm2(corners_mm: Float64, tissues: CellTissues) -> dict[str, float]:
    """Area of what was cut in each tissue, mm2, the largest first: that of the cell which each piece lies in.

    Parameters
    ----------
    corners_mm
        Walls at rest, mm, shape (count, 3, 3): :func:`cut_triangles`.
    tissues
        The tissues. What lies in no cell of theirs counts with the nearest beside it along a grid axis, or not at all.
    """
    centres, areas = _pieces(corners_mm, 0.5 * min(tissues.geometry.spacing_mm))
    if not len(areas):
        return {}
    low = tissues.cells.min(axis=0) - 2
    box = np.zeros(tissues.cells.max(axis=0) - low + 3, np.uint8)
    box[tuple((tissues.cells - low).T)] = tissues.labels
    inside = np.clip(tissues.geometry.world_to_index(centres) - low, 1.0, np.array(box.shape) - 2.0)
    place = np.rint(inside).astype(np.int64)
    found = box[tuple(place.T)]
    for number in np.flatnonzero(found == 0):
        found[number] = _beside(box, place[number], inside[number] - place[number])
    area = np.bincount(found, areas, minlength=256)
    order = sorted(np.flatnonzero(area[1:]) + 1, key=lambda label: (-area[label], label))
    return {tissues.names.get(int(label), f"label {label}"): float(0.5 * area[label]) for label in order}


def _beside(box: UInt8, place: Int64, off: Float64) -> int:
    """Label of the cell beside one, on the nearest side that has one; 0 where none has."""
    sides = [(axis, step) for axis in range(3) for step in (-1, 1)]
    for axis, step in sorted(sides, key=lambda side: -side[1] * off[side[0]]):
        there = place.copy()
        there[axis] += step
        if box[tuple(there)]:
            return int(box[tuple(there)])
    return 0


def _areas(corners: Float64) -> Float64:
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas: Float64 = 0.5 * np.linalg.norm(normals, axis=1)
    return areas


def _pieces(corners: Float64, edge_mm: float) -> tuple[Float64, Float64]:
    """Centres and areas of triangles that are divided until no edge is longer than so much."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    parts = np.clip(np.ceil(longest / edge_mm), 1, _PIECES_MAX).astype(np.int64)
    centres, areas = [np.zeros((0, 3))], [np.zeros(0)]
    for count in np.unique(parts):
        own = corners[parts == count]
        weights = _centre_weights(int(count))
        centres.append((weights @ own).reshape(-1, 3))
        areas.append(np.repeat(_areas(own) / count**2, len(weights)))
    return np.concatenate(centres), np.concatenate(areas)


def _centre_weights(count: int) -> Float64:
    """Barycentric places of the centres of the count^2 equal pieces of a triangle, shape (count^2, 3)."""
    a, b = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
    upright, flat = (a + b < count), (a + b < count - 1)
    first = np.concatenate([a[upright] + 1 / 3, a[flat] + 2 / 3]) / count
    second = np.concatenate([b[upright] + 1 / 3, b[flat] + 2 / 3]) / count
    return np.stack([first, second, 1.0 - first - second], axis=1)
