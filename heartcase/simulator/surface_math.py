"""The formulas of the surface, one node or vertex at a time, for any target of numba; float32 and grid units."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np

__all__ = ["make_surface_math"]

SUM_MIN = np.float32(0.1)
"""Shortest sum of unit vectors that gives a normal; on a flat side it is 3.8."""

_ZERO = np.float32(0)
_ONE = np.float32(1)


def make_surface_math(compiled: Callable[[Any], Any]) -> tuple[Any, Any]:
    """The functions that the kernels call.

    Parameters
    ----------
    compiled
        Makes a function that kernels of a target can call.

    Returns
    -------
    node_normal
        ``(number, nodes, first, neighbours, offset, displacement)`` to the unit sum of the unit vectors from the
        neighbours to a node (eq. 9.3); zero where the vectors cancel: as much tissue on one side as on the other.
    deform_vertex
        Eq. 9.9 of one vertex: writes what its reference point has moved plus its turned offset, its normal and, where
        wanted, its basis. Arguments as of :func:`heartcase.simulator.surface_kernel.deform_vertices`, after the number
        of the vertex.
    """

    @compiled
    def cross(a, b):  # type: ignore[no-untyped-def]
        return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]

    @compiled
    def unit(a):  # type: ignore[no-untyped-def]
        """Of length one; zero stays zero."""
        squared = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
        scale = _ONE / np.float32(sqrt(squared)) if squared > _ZERO else _ZERO
        return a[0] * scale, a[1] * scale, a[2] * scale

    @compiled
    def edge(edges, displacement, vertex, number, start, end):  # type: ignore[no-untyped-def]
        return (
            edges[vertex, number, 0] + (displacement[end, 0] - displacement[start, 0]),
            edges[vertex, number, 1] + (displacement[end, 1] - displacement[start, 1]),
            edges[vertex, number, 2] + (displacement[end, 2] - displacement[start, 2]),
        )

    @compiled
    def node_normal(number, nodes, first, neighbours, offset, displacement):  # type: ignore[no-untyped-def]
        node = nodes[number]
        x, y, z = _ZERO, _ZERO, _ZERO
        for spring in range(first[number], first[number + 1]):
            other = neighbours[spring]
            d = unit(
                (
                    offset[spring, 0] + (displacement[node, 0] - displacement[other, 0]),
                    offset[spring, 1] + (displacement[node, 1] - displacement[other, 1]),
                    offset[spring, 2] + (displacement[node, 2] - displacement[other, 2]),
                )
            )
            x, y, z = x + d[0], y + d[1], z + d[2]
        if x * x + y * y + z * z < SUM_MIN * SUM_MIN:
            x, y, z = _ZERO, _ZERO, _ZERO
        return unit((x, y, z))

    @compiled
    def deform_vertex(  # type: ignore[no-untyped-def]
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
    ):
        p1, p2, p3 = triangle_nodes[v, 0], triangle_nodes[v, 1], triangle_nodes[v, 2]
        w1, w2, w3 = weights[v, 0], weights[v, 1], weights[v, 2]
        T = unit(edge(edges, displacement, v, 0, p1, p2))
        N = unit(cross(T, edge(edges, displacement, v, 1, p1, p3)))
        B = cross(N, T)
        if curvature[v]:
            n1, n2, n3 = normal_number[v, 0], normal_number[v, 1], normal_number[v, 2]
            N = unit(
                (
                    w1 * node_normal[n1, 0] + w2 * node_normal[n2, 0] + w3 * node_normal[n3, 0],
                    w1 * node_normal[n1, 1] + w2 * node_normal[n2, 1] + w3 * node_normal[n3, 1],
                    w1 * node_normal[n1, 2] + w2 * node_normal[n2, 2] + w3 * node_normal[n3, 2],
                )
            )
            B = unit(cross(N, T))
            T = cross(B, N)
        for axis in range(3):
            r = w1 * displacement[p1, axis] + w2 * displacement[p2, axis] + w3 * displacement[p3, axis]
            o = offset[v, 0] * T[axis] + offset[v, 1] * N[axis] + offset[v, 2] * B[axis]
            moved[v, axis] = r + o
            normals[v, axis] = normal[v, 0] * T[axis] + normal[v, 1] * N[axis] + normal[v, 2] * B[axis]
            if len(bases):
                bases[v, 0, axis], bases[v, 1, axis], bases[v, 2, axis] = T[axis], N[axis], B[axis]

    return node_normal, deform_vertex
