"""How far a decimated surface is from the full one, and the fewest triangles that keep within an asked distance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from heartcase.pipeline.mesh.decimation.decimate import Decimated
from heartcase.pipeline.mesh.triangles.mesh_distance import mesh_distance_mm
from heartcase.pipeline.mesh.triangles.triangle_grid import TriangleGrid, triangle_grid
from heartcase.schemas.arrays import Float64, Int32

__all__ = ["ERROR_QUANTILE", "fewest_triangles", "two_sided_distances_mm"]


ERROR_QUANTILE = 0.99
"""Part of both surfaces that must be within the asked distance of the other one."""
DISTANCE_SAMPLE = 100_000
LEAST_TRIANGLES = 500
SEARCH_ROUNDS = 6
CLOSE_ENOUGH = 1.05
"""The search ends where a count that is good is at most this many times one that is not."""


def two_sided_distances_mm(
    full_vertices: Float64, full_mesh: TriangleGrid, vertices: Float64, triangles: Int32
) -> Float64:
    """Distances between two meshes, both ways: from vertices of the full one, and vertices and centres of the other.

    Parameters
    ----------
    full_vertices, full_mesh
        The full mesh, mm; about a hundred thousand of its vertices are taken.
    vertices, triangles
        The decimated mesh, mm.

    Returns
    -------
    Float64
        Millimetres, shape (sample_count,).
    """
    every = -(-len(full_vertices) // DISTANCE_SAMPLE)
    there = mesh_distance_mm(full_vertices[::every], triangle_grid(vertices, triangles))
    centre = vertices[triangles].mean(axis=1)
    back = mesh_distance_mm(np.concatenate([vertices, centre]), full_mesh)
    return np.concatenate([there, back])


def fewest_triangles(
    full_vertices: Float64,
    full_mesh: TriangleGrid,
    decimated: Callable[[int], Decimated],
    *,
    error_mm: float,
    most: int,
) -> Decimated:
    """Find the coarsest mesh that keeps within a distance, by halving the range of counts.

    Parameters
    ----------
    full_vertices, full_mesh
        The full mesh, mm.
    decimated
        Makes a mesh of a count of triangles.
    error_mm
        Distance within which 99% of both surfaces must be of the other.
    most
        Most triangles; with so many it is not asked how far off they are.
    """
    low, high = min(LEAST_TRIANGLES, most), min(most, len(full_mesh.corner))
    best = decimated(high)
    for _ in range(SEARCH_ROUNDS):
        if high <= CLOSE_ENOUGH * low:
            break
        middle = round(float(np.sqrt(low * high)))
        found = decimated(middle)
        distances = two_sided_distances_mm(full_vertices, full_mesh, found.vertices_mm, found.triangles)
        if np.quantile(distances, ERROR_QUANTILE) <= error_mm:
            best, high = found, middle
        else:
            low = middle
    return best
