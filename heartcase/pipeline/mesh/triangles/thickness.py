"""Local thickness of the tissue at each vertex of its surface.

The thickness at a surface point is the diameter of the largest ball inside the tissue that touches the surface there:
the shrinking ball of Ma, Bae and Choi (3D medial axis point approximation using nearest neighbors and the normal
field, The Visual Computer 28, 2012). Three changes make it a wall thickness. A ball may only be stopped by surface
that faces the other way, so a rough side does not stop its own ball. It is stopped by the plane of the triangle it
meets, not by a sample point, so coarse triangles do not make a wall thicker. And faces where the tissue was cut off
do not count as the other side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from heartcase.schemas.arrays import Float32, Float64, Integer
from heartcase.schemas.labels import LabelTable

__all__ = ["ThicknessFigures", "thickness_figures", "triangle_normals", "vertex_normals", "wall_thickness_mm"]


_ROUNDS_MAX = 40
_DOUBLINGS = 4
_OPPOSITE_COSINE = -0.2
_DIRECTIONS = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)


@dataclass(frozen=True)
class ThicknessFigures:
    """How thick one tissue is, over the area of its surface."""

    label: int
    """Tissue label value."""
    name: str
    """Its name."""
    area_cm2: float
    """Area of its surface that was measured, cm2."""
    mean_mm: float
    """Mean over the area, mm."""
    p5_mm: float
    """5% of the area is thinner, mm."""
    p50_mm: float
    """Median over the area, mm."""
    p95_mm: float
    """5% of the area is thicker, mm."""


def triangle_normals(vertices_mm: npt.ArrayLike, triangles: npt.ArrayLike) -> tuple[Float64, Float64]:
    """Unit normals, shape (n, 3), and areas in mm2, shape (n,), of triangles; the normal of an empty one is zero."""
    corners = np.asarray(vertices_mm, dtype=float)[np.asarray(triangles)]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return cross / np.where(length > 0.0, length, 1.0)[:, None], 0.5 * length


def vertex_normals(vertices_mm: npt.ArrayLike, triangles: npt.ArrayLike) -> Float64:
    """Unit vertex normals, area-weighted over the triangles around, shape (vertex_count, 3)."""
    normals, areas = triangle_normals(vertices_mm, triangles)
    weighted = np.repeat(normals * areas[:, None], 3, axis=0)
    corner = np.asarray(triangles).ravel()
    count = len(np.asarray(vertices_mm))
    total = np.stack([np.bincount(corner, weighted[:, axis], count) for axis in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1)
    unit: Float64 = total / np.where(length > 0.0, length, 1.0)[:, None]
    return unit


def wall_thickness_mm(
    vertices_mm: npt.ArrayLike,
    triangles: npt.ArrayLike,
    *,
    normals: npt.ArrayLike | None = None,
    triangle_is_cut: npt.ArrayLike | None = None,
    largest_mm: float = 40.0,
) -> Float32:
    """Thickness of the tissue under each vertex.

    Parameters
    ----------
    vertices_mm
        Vertices of the closed tissue surface, shape (vertex_count, 3), mm.
    triangles
        Vertex numbers, counter-clockwise from outside the tissue, shape (triangle_count, 3).
    normals
        Unit vertex normals out of the tissue, shape (vertex_count, 3); from the triangles when left out.
    triangle_is_cut
        Nonzero on faces where the tissue was cut off, shape (triangle_count,): not a side of a wall.
    largest_mm
        Thicker than this is not measured.

    Returns
    -------
    Float32
        Thickness in mm, shape (vertex_count,); NaN where there is no other side within ``largest_mm``, and at
        vertices that lie on cut faces only.
    """
    vertices = np.asarray(vertices_mm, dtype=float)
    triangles = np.asarray(triangles)
    cut = np.zeros(len(triangles), bool) if triangle_is_cut is None else np.asarray(triangle_is_cut).astype(bool)
    sides = triangles[~cut]
    thickness = np.full(len(vertices), np.nan, np.float32)
    if len(sides) == 0:
        return thickness
    point_normals = vertex_normals(vertices, sides) if normals is None else np.asarray(normals, dtype=float)
    sample, sample_normal, reach = _samples(vertices, sides)

    used = np.unique(sides)
    unit_directions = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1)[:, None]
    group = np.argmax(point_normals[used] @ unit_directions.T, axis=1)
    for number, direction in enumerate(unit_directions):
        members = used[group == number]
        opposite = sample_normal @ direction < _OPPOSITE_COSINE
        if len(members) == 0 or not opposite.any():
            continue
        radius = _shrink(
            vertices[members],
            point_normals[members],
            sample[opposite],
            sample_normal[opposite],
            reach[opposite],
            0.5 * largest_mm,
        )
        thickness[members] = 2.0 * radius
    return thickness


def thickness_figures(
    thickness_mm: npt.ArrayLike,
    vertices_mm: npt.ArrayLike,
    triangles: npt.ArrayLike,
    triangle_tissue: npt.ArrayLike,
    table: LabelTable,
    *,
    triangle_is_cut: npt.ArrayLike | None = None,
) -> tuple[ThicknessFigures, ...]:
    """Mean and percentiles of the thickness per tissue label, weighted by area; labels without surface are left out."""
    triangles = np.asarray(triangles)
    tissue = np.asarray(triangle_tissue)
    _, area = triangle_normals(vertices_mm, triangles)
    value = np.asarray(thickness_mm, dtype=float)[triangles].mean(axis=1)
    valid = np.isfinite(value) & (area > 0.0)
    if triangle_is_cut is not None:
        valid &= ~np.asarray(triangle_is_cut).astype(bool)
    figures = []
    for label in table:
        member = valid & (tissue == label.value)
        if not label.role.is_tissue or not member.any():
            continue
        p5, p50, p95 = _weighted_percentiles(value[member], area[member], (0.05, 0.5, 0.95))
        figures.append(
            ThicknessFigures(
                label=label.value,
                name=label.name,
                area_cm2=float(area[member].sum() / 100.0),
                mean_mm=float(np.average(value[member], weights=area[member])),
                p5_mm=p5,
                p50_mm=p50,
                p95_mm=p95,
            )
        )
    return tuple(figures)


def _weighted_percentiles(values: Float64, weights: Float64, fractions: Sequence[float]) -> list[float]:
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[order])
    at = np.searchsorted(cumulative, np.asarray(fractions) * cumulative[-1])
    return [float(v) for v in values[order][np.minimum(at, len(values) - 1)]]


def _samples(vertices: Float64, triangles: Integer) -> tuple[Float64, Float64, Float64]:
    """Centroid, normal and half-size in mm of each triangle; triangles that are large for the mesh count as four."""
    corners = vertices[triangles]
    normal, _ = triangle_normals(vertices, triangles)
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    large = edge > 1.5 * np.median(edge)
    a, b, c = corners[large].transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0
    quarters = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    pieces = np.concatenate([corners[~large], quarters])
    centre = pieces.mean(axis=1)
    reach = np.linalg.norm(pieces - centre[:, None, :], axis=2).mean(axis=1)
    return centre, np.concatenate([normal[~large], np.tile(normal[large], (4, 1))]), reach


def _shrink(
    point: Float64, normal: Float64, sample: Float64, sample_normal: Float64, reach: Float64, largest: float
) -> Float64:
    """Radius of the largest ball that touches each point from inside and that no sample's plane enters; NaN if none.

    Balls that touch the same point are nested, so growing from a small one finds the first that is stopped.
    """
    # Built in half the time that a balanced tree takes; queries find the same.
    tree = KDTree(sample, balanced_tree=False, compact_nodes=False)
    found = np.full(len(point), np.nan)
    free = np.arange(len(point))
    start = largest / 2**_DOUBLINGS
    for level in start * 2.0 ** np.arange(_DOUBLINGS + 1):
        active = free
        radius = np.full(len(point), level)
        for _ in range(_ROUNDS_MAX):
            p, n, r = point[active], normal[active], radius[active]
            # By this thread alone: starting others takes longer than what they would find.
            distance, nearest = map(np.asarray, tree.query(p - r[:, None] * n, distance_upper_bound=level))
            touched = distance < r * (1.0 - 1e-6)
            active, nearest = active[touched], nearest[touched]
            smaller = _radius_to_facet(p[touched], n[touched], sample[nearest], sample_normal[nearest], reach[nearest])
            better = smaller < r[touched] * (1.0 - 1e-6)
            active = active[better]
            radius[active] = smaller[better]
            if len(active) == 0:
                break
        stopped = radius[free] < level
        found[free[stopped]] = radius[free[stopped]]
        free = free[~stopped]
        if len(free) == 0:
            break
    return found


def _radius_to_facet(p: Float64, n: Float64, q: Float64, facet_normal: Float64, reach: Float64) -> Float64:
    """Radius of the ball that touches ``p`` from inside and the small flat disc around ``q``."""
    facing = 1.0 - (n * facet_normal).sum(axis=1)
    to_plane = ((q - p) * facet_normal).sum(axis=1) / facing
    touch = p - to_plane[:, None] * (n - facet_normal)
    sideways = touch - q
    away = np.linalg.norm(sideways, axis=1)
    inside = np.minimum(1.0, reach / np.where(away > 0.0, away, 1.0))
    target = np.where((to_plane > 0.0)[:, None], q + inside[:, None] * sideways, q)
    gap = p - target
    depth = (gap * n).sum(axis=1)
    squared = (gap * gap).sum(axis=1)
    return np.where(depth > 0.0, squared / np.where(depth > 0.0, 2.0 * depth, 1.0), np.inf)
