"""The surface kernels: one vertex at a time, in float32 and grid units."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from heartcase.simulator.surface_math import make_surface_math

__all__ = ["deform_vertices", "node_normals", "turn_vectors"]

Float32 = npt.NDArray[np.float32]
Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]

PARALLEL_VERTICES_MIN = 20_000
"""Vertices from which on more than one thread pays."""


_node_normal, _deform_vertex = make_surface_math(njit(nogil=True))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def node_normals(
    nodes: Int32, first: Int32, neighbours: Int32, offset: Float32, displacement: Float32, normals: Float32
) -> None:
    """Write the approximate normals of some nodes (eq. 9.3), shape (normal_count, 3)."""
    for number in range(len(nodes)):
        x, y, z = _node_normal(number, nodes, first, neighbours, offset, displacement)
        normals[number, 0], normals[number, 1], normals[number, 2] = x, y, z


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _deform_alone(
    triangle_nodes: Int32,
    weights: Float32,
    edges: Float32,
    curvature: UInt8,
    offset: Float32,
    normal: Float32,
    normal_number: Int32,
    node_normal: Float32,
    displacement: Float32,
    moved: Float32,
    normals: Float32,
    bases: Float32,
) -> None:
    for v in range(len(weights)):
        _deform_vertex(
            v,
            triangle_nodes,
            weights,
            edges,
            curvature,
            offset,
            normal,
            normal_number,
            node_normal,
            displacement,
            moved,
            normals,
            bases,
        )


@njit(cache=True, nogil=True, parallel=True)  # type: ignore[untyped-decorator]
def _deform_together(
    triangle_nodes: Int32,
    weights: Float32,
    edges: Float32,
    curvature: UInt8,
    offset: Float32,
    normal: Float32,
    normal_number: Int32,
    node_normal: Float32,
    displacement: Float32,
    moved: Float32,
    normals: Float32,
    bases: Float32,
) -> None:
    for v in prange(len(weights)):
        _deform_vertex(
            v,
            triangle_nodes,
            weights,
            edges,
            curvature,
            offset,
            normal,
            normal_number,
            node_normal,
            displacement,
            moved,
            normals,
            bases,
        )


def deform_vertices(*arrays: Any) -> None:
    """Deform all vertices (eq. 9.9).

    Parameters
    ----------
    arrays
        ``triangle_nodes``, ``weights``, ``edges``, ``curvature``, ``offset``, ``normal`` and ``normal_number`` of
        :class:`heartcase.simulator.surface.SurfaceModel`; the nodes' approximate normals; their displacement [cells];
        and what is written: movement of the reference point plus turned offset [cells] and normal, shape
        (vertex_count, 3) each, and bases with rows T, N, B, shape (vertex_count, 3, 3), or empty where not wanted.
    """
    vertex_count = len(arrays[1])
    (_deform_together if vertex_count >= PARALLEL_VERTICES_MIN else _deform_alone)(*arrays)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def turn_vectors(bases: Float32, components: Float32) -> Float32:
    """Vectors from their components along bases with rows T, N, B; (count, 3, 3) and (count, 3) to (count, 3)."""
    turned = np.empty_like(components)
    for v in range(len(components)):
        for axis in range(3):
            turned[v, axis] = (
                components[v, 0] * bases[v, 0, axis]
                + components[v, 1] * bases[v, 1, axis]
                + components[v, 2] * bases[v, 2, axis]
            )
    return turned
