"""The surface kernels: one vertex at a time, in float32 and grid units."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit, prange

__all__ = ["deform_vertices", "node_normals", "turn_vectors"]

Float32 = npt.NDArray[np.float32]
Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]
Vector = tuple[np.float32, np.float32, np.float32]

PARALLEL_VERTICES_MIN = 20_000
"""Vertices from which on more than one thread pays."""

SUM_MIN = np.float32(0.1)
"""Shortest sum of unit vectors that gives a normal; on a flat side it is 3.8."""

_ZERO = np.float32(0)
_ONE = np.float32(1)


@njit(inline="always")  # type: ignore[untyped-decorator]
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(inline="always")  # type: ignore[untyped-decorator]
def _unit(a: Vector) -> Vector:
    """Of length one; zero stays zero."""
    squared = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    scale = _ONE / np.sqrt(squared) if squared > _ZERO else _ZERO
    return a[0] * scale, a[1] * scale, a[2] * scale


@njit(inline="always")  # type: ignore[untyped-decorator]
def _edge(edges: Float32, displacement: Float32, vertex: int, number: int, start: int, end: int) -> Vector:
    return (
        edges[vertex, number, 0] + (displacement[end, 0] - displacement[start, 0]),
        edges[vertex, number, 1] + (displacement[end, 1] - displacement[start, 1]),
        edges[vertex, number, 2] + (displacement[end, 2] - displacement[start, 2]),
    )


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def node_normals(
    nodes: Int32, first: Int32, neighbours: Int32, offset: Float32, displacement: Float32, normals: Float32
) -> None:
    """Write the unit sums of the unit vectors from the neighbours to each node (eq. 9.3), shape (normal_count, 3).

    Zero where the vectors cancel: the node has as much tissue on one side as on the other.
    """
    for number in range(len(nodes)):
        node = nodes[number]
        x, y, z = _ZERO, _ZERO, _ZERO
        for spring in range(first[number], first[number + 1]):
            other = neighbours[spring]
            d = _unit(
                (
                    offset[spring, 0] + (displacement[node, 0] - displacement[other, 0]),
                    offset[spring, 1] + (displacement[node, 1] - displacement[other, 1]),
                    offset[spring, 2] + (displacement[node, 2] - displacement[other, 2]),
                )
            )
            x, y, z = x + d[0], y + d[1], z + d[2]
        if x * x + y * y + z * z < SUM_MIN * SUM_MIN:
            x, y, z = _ZERO, _ZERO, _ZERO
        normals[number, 0], normals[number, 1], normals[number, 2] = _unit((x, y, z))


@njit(inline="always")  # type: ignore[untyped-decorator]
def _deform_vertex(
    v: int,
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
    """Eq. 9.9 of one vertex: what its reference point has moved plus its turned offset, and its normal."""
    p1, p2, p3 = triangle_nodes[v, 0], triangle_nodes[v, 1], triangle_nodes[v, 2]
    w1, w2, w3 = weights[v, 0], weights[v, 1], weights[v, 2]
    T = _unit(_edge(edges, displacement, v, 0, p1, p2))
    N = _unit(_cross(T, _edge(edges, displacement, v, 1, p1, p3)))
    B = _cross(N, T)
    if curvature[v]:
        n1, n2, n3 = normal_number[v, 0], normal_number[v, 1], normal_number[v, 2]
        N = _unit(
            (
                w1 * node_normal[n1, 0] + w2 * node_normal[n2, 0] + w3 * node_normal[n3, 0],
                w1 * node_normal[n1, 1] + w2 * node_normal[n2, 1] + w3 * node_normal[n3, 1],
                w1 * node_normal[n1, 2] + w2 * node_normal[n2, 2] + w3 * node_normal[n3, 2],
            )
        )
        B = _unit(_cross(N, T))
        T = _cross(B, N)
    for axis in range(3):
        r = w1 * displacement[p1, axis] + w2 * displacement[p2, axis] + w3 * displacement[p3, axis]
        o = offset[v, 0] * T[axis] + offset[v, 1] * N[axis] + offset[v, 2] * B[axis]
        moved[v, axis] = r + o
        normals[v, axis] = normal[v, 0] * T[axis] + normal[v, 1] * N[axis] + normal[v, 2] * B[axis]
        if len(bases):
            bases[v, 0, axis], bases[v, 1, axis], bases[v, 2, axis] = T[axis], N[axis], B[axis]


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
