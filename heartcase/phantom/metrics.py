"""How far a result is from the truth: Dice, surface distances, wall thickness.

What the tests hold to a bound and the benchmarks print beside the time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.phantom.anatomy.truth import Truth
from heartcase.schemas.arrays import Float64, Int64, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable

__all__ = [
    "SurfaceError",
    "closest_distance_mm",
    "dice",
    "label_surface",
    "surface_error",
    "wall_thickness_error",
    "wall_thickness_errors",
]


@dataclass(frozen=True)
class SurfaceError:
    """Absolute distances, mm."""

    mean_mm: float
    """Mean."""
    percentile_95_mm: float
    """95th percentile: for two surfaces, of the distances both ways together (95% Hausdorff distance)."""
    sample_count: int
    """Points measured."""

    @classmethod
    def of(cls, distances_mm: npt.ArrayLike) -> SurfaceError:
        """Summarise distances of any sign."""
        absolute = np.abs(np.asarray(distances_mm, dtype=float))
        if absolute.size == 0:
            return cls(float("inf"), float("inf"), 0)
        return cls(float(absolute.mean()), float(np.percentile(absolute, 95)), absolute.size)


def dice(labels: UInt8, truth_labels: UInt8, values: int | tuple[int, ...]) -> float:
    """Dice coefficient of a label, or of several together, in two label volumes of the same shape."""
    a, b = np.isin(labels, values), np.isin(truth_labels, values)
    total = int(a.sum()) + int(b.sum())
    return 2.0 * int((a & b).sum()) / total if total else 1.0


def label_surface(labels: UInt8, geometry: Geometry, value: int) -> tuple[Float64, Int64]:
    """Border of a label by marching cubes on its mask: world mm vertices and triangles, open at the volume edge."""
    from skimage.measure import marching_cubes

    mask = np.pad((labels == value).astype(np.float32), 1, mode="edge")
    if mask.min() == mask.max():
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    vertices, triangles, _, _ = marching_cubes(mask, 0.5)
    return geometry.index_to_world(vertices[:, ::-1] - 1.0), triangles.astype(np.int64)


def closest_distance_mm(points_mm: Float64, vertices_mm: npt.ArrayLike, triangles: npt.ArrayLike) -> Float64:
    """Distance of each point, shape (n, 3), to the nearest point of a triangle mesh, by VTK's cell locator."""
    import pyvista

    faces = np.hstack([np.full((len(np.asarray(triangles)), 1), 3), np.asarray(triangles)]).ravel()
    mesh = pyvista.PolyData(np.asarray(vertices_mm, dtype=float), faces)
    _, closest = mesh.find_closest_cell(np.asarray(points_mm, dtype=float), return_closest_point=True)
    distances: Float64 = np.linalg.norm(np.asarray(points_mm) - closest, axis=1)
    return distances


def surface_error(labels: UInt8, geometry: Geometry, truth: Truth, value: int) -> SurfaceError:
    """Distances between the border of a label and its true surface, both ways.

    The way out is exact to 0.03 mm (the truth at the vertices of the border); the way back is from samples of the true
    surface inside the volume to the border's triangles.
    """
    vertices, triangles = label_surface(labels, geometry, value)
    if not len(vertices):
        return SurfaceError.of([])
    samples = truth.surface_points(value)
    index = geometry.world_to_index(samples)
    samples = samples[((index >= 0) & (index <= np.array(geometry.size) - 1)).all(axis=1)]
    outward = truth.distance(vertices, value, tolerance_mm=0.03)
    return SurfaceError.of(np.concatenate([np.abs(outward), closest_distance_mm(samples, vertices, triangles)]))


def wall_thickness_error(
    vertices_mm: npt.ArrayLike,
    triangles: npt.ArrayLike,
    triangle_label: UInt8,
    triangle_tissue: UInt8,
    *,
    cavity: int,
    wall: int,
    thickness_mm: float,
    margin_mm: float,
    away_from_mm: npt.ArrayLike = (),
) -> SurfaceError:
    """Error of a grown wall's thickness, between the wall's outer surface and the cavity's own surface.

    Every vertex of the outer surface (triangles with label 0 and this wall behind them) has its nearest point on the
    inner surface (triangles with the cavity's label); their distance must be the wall's thickness.

    Parameters
    ----------
    vertices_mm, triangles, triangle_label, triangle_tissue
        A closed, tagged surface.
    cavity, wall
        Label values.
    thickness_mm
        True thickness.
    margin_mm
        Vertices nearer than this to an edge where the outer surface ends are not measured: there the wall ends or
        meets another, and its thickness is not that of a free wall.
    away_from_mm
        Further points, shape (n, 3), such as vessel ends, to keep ``margin_mm`` from.
    """
    from scipy.spatial import cKDTree

    vertices, faces = np.asarray(vertices_mm, dtype=float), np.asarray(triangles)
    inner = faces[triangle_label == cavity]
    outer = faces[(triangle_label == 0) & (triangle_tissue == wall)]
    if not len(inner) or not len(outer):
        return SurfaceError.of([])
    edges = np.sort(np.concatenate([outer[:, [0, 1]], outer[:, [1, 2]], outer[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = vertices[np.unique(unique[count == 1])]
    rim = np.concatenate([rim, np.asarray(away_from_mm, dtype=float).reshape(-1, 3)])
    points = vertices[np.unique(outer)]
    if len(rim):
        points = points[cKDTree(rim).query(points)[0] > margin_mm]
    if not len(points):
        return SurfaceError.of([])
    return SurfaceError.of(closest_distance_mm(points, vertices, inner) - thickness_mm)


def wall_thickness_errors(
    vertices_mm: npt.ArrayLike,
    triangles: npt.ArrayLike,
    triangle_label: UInt8,
    triangle_tissue: UInt8,
    table: LabelTable,
    *,
    margin_mm: float = 2.0,
) -> dict[str, SurfaceError]:
    """:func:`wall_thickness_error` of every grown wall of a label table, by the wall's name."""
    found = {}
    for wall in table:
        if wall.wall_of is not None:
            cavity = table[wall.wall_of]
            found[wall.name] = wall_thickness_error(
                vertices_mm,
                triangles,
                triangle_label,
                triangle_tissue,
                cavity=cavity.value,
                wall=wall.value,
                thickness_mm=cavity.wall_thickness_mm,
                margin_mm=margin_mm,
            )
    return found
