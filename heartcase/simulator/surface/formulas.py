"""The formulas of the surface, one node or vertex at a time, for any target of numba; float32 and grid units."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np

__all__ = ["make_cell_math", "make_surface_math", "make_vertex_math"]

SUM_MIN = np.float32(0.1)
"""Shortest sum of unit vectors that gives a normal; on a flat side it is 3.8."""

SQUARED_MIN = np.float32(1e-12)
"""Square of the shortest vector that has a direction."""

_ZERO = np.float32(0)
_ONE = np.float32(1)


def make_vertex_math(compiled: Callable[[Any], Any]) -> tuple[Any, Any, Any, Any]:
    """The functions that kernels of every target are made of.

    Parameters
    ----------
    compiled
        Makes a function that kernels of a target can call.

    Returns
    -------
    spring_direction
        ``(spring, node, other, offset, displacement)`` to the unit vector from a neighbour to a node.
    normal_of_sum
        The sum ``(x, y, z)`` of these to a node's approximate normal (eq. 9.3); zero where they cancel: as much tissue
        on one side as on the other.
    vertex_frame
        ``(v, triangle_nodes, weights, edges, curvature, offset, normal_number, node_normal, displacement)`` to what
        the vertex's reference point has moved plus its turned offset, and its basis T, N, B (eq. 9.9).
    along
        ``(components, row, T, N, B)`` to the vector with the components of a row along a basis.
    """

    @compiled
    def cross(a, b):
        return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]

    @compiled
    def unit(a):
        """Of length one; zero stays zero."""
        squared = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
        scale = _ONE / np.float32(sqrt(squared)) if squared > _ZERO else _ZERO
        return a[0] * scale, a[1] * scale, a[2] * scale

    @compiled
    def edge(edges, displacement, vertex, number, start, end):
        return (
            edges[vertex, number, 0] + (displacement[end, 0] - displacement[start, 0]),
            edges[vertex, number, 1] + (displacement[end, 1] - displacement[start, 1]),
            edges[vertex, number, 2] + (displacement[end, 2] - displacement[start, 2]),
        )

    @compiled
    def spring_direction(spring, node, other, offset, displacement):
        return unit(
            (
                offset[spring, 0] + (displacement[node, 0] - displacement[other, 0]),
                offset[spring, 1] + (displacement[node, 1] - displacement[other, 1]),
                offset[spring, 2] + (displacement[node, 2] - displacement[other, 2]),
            )
        )

    @compiled
    def normal_of_sum(x, y, z):
        if x * x + y * y + z * z < SUM_MIN * SUM_MIN:
            x, y, z = _ZERO, _ZERO, _ZERO
        return unit((x, y, z))

    @compiled
    def along(components, row, T, N, B):
        t, n, b = components[row, 0], components[row, 1], components[row, 2]
        return (
            t * T[0] + n * N[0] + b * B[0],
            t * T[1] + n * N[1] + b * B[1],
            t * T[2] + n * N[2] + b * B[2],
        )

    @compiled
    def vertex_frame(v, triangle_nodes, weights, edges, curvature, offset, normal_number, node_normal, displacement):
        p1, p2, p3 = triangle_nodes[v, 0], triangle_nodes[v, 1], triangle_nodes[v, 2]
        w1, w2, w3 = weights[v, 0], weights[v, 1], weights[v, 2]
        T = unit(edge(edges, displacement, v, 0, p1, p2))
        N = unit(cross(T, edge(edges, displacement, v, 1, p1, p3)))
        B = cross(N, T)
        # Read for every vertex: numba counts the references to what a branch of a called function reads.
        n1, n2, n3 = normal_number[v, 0], normal_number[v, 1], normal_number[v, 2]
        between = (
            w1 * node_normal[n1, 0] + w2 * node_normal[n2, 0] + w3 * node_normal[n3, 0],
            w1 * node_normal[n1, 1] + w2 * node_normal[n2, 1] + w3 * node_normal[n3, 1],
            w1 * node_normal[n1, 2] + w2 * node_normal[n2, 2] + w3 * node_normal[n3, 2],
        )
        if curvature[v]:
            N = unit(between)
            B = unit(cross(N, T))
            T = cross(B, N)
        o = along(offset, v, T, N, B)
        moved = (
            (w1 * displacement[p1, 0] + w2 * displacement[p2, 0] + w3 * displacement[p3, 0]) + o[0],
            (w1 * displacement[p1, 1] + w2 * displacement[p2, 1] + w3 * displacement[p3, 1]) + o[1],
            (w1 * displacement[p1, 2] + w2 * displacement[p2, 2] + w3 * displacement[p3, 2]) + o[2],
        )
        return moved, T, N, B

    return spring_direction, normal_of_sum, vertex_frame, along


def make_surface_math(compiled: Callable[[Any], Any]) -> tuple[Any, Any]:
    """The functions that the kernels of a device call.

    Parameters
    ----------
    compiled
        Makes a function that kernels of a target can call.

    Returns
    -------
    node_normal
        ``(number, nodes, first, neighbours, offset, displacement)`` to the approximate normal of a node (eq. 9.3).
    deform_vertex
        Eq. 9.9 of one vertex: writes what its reference point has moved plus its turned offset [cells], shape
        (vertex_count, 3), its normal in grid axes, the same shape, and its basis with rows T, N, B, shape
        (vertex_count, 3, 3), or none where that is empty.
    """
    spring_direction, normal_of_sum, vertex_frame, along = make_vertex_math(compiled)

    @compiled
    def node_normal(number, nodes, first, neighbours, offset, displacement):
        node = nodes[number]
        x, y, z = _ZERO, _ZERO, _ZERO
        for spring in range(first[number], first[number + 1]):
            d = spring_direction(spring, node, neighbours[spring], offset, displacement)
            x, y, z = x + d[0], y + d[1], z + d[2]
        return normal_of_sum(x, y, z)

    @compiled
    def deform_vertex(
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
        at, T, N, B = vertex_frame(
            v, triangle_nodes, weights, edges, curvature, offset, normal_number, node_normal, displacement
        )
        n = along(normal, v, T, N, B)
        for axis in range(3):
            moved[v, axis] = at[axis]
            normals[v, axis] = n[axis]
            if len(bases):
                bases[v, 0, axis], bases[v, 1, axis], bases[v, 2, axis] = T[axis], N[axis], B[axis]

    return node_normal, deform_vertex


def make_cell_math(compiled: Callable[[Any], Any]) -> tuple[Any, Any, Any]:
    """The functions for vertices that follow all corners of a cell.

    Parameters
    ----------
    compiled
        Makes a function that kernels of a target can call.

    Returns
    -------
    cell_frame
        ``(n, corners, local, beyond, displacement)`` to how far a vertex has moved, by trilinear interpolation inside
        its cell and along the deformation gradient F at the nearest place of it beyond, and the columns of F.
    turned_normal
        ``(x, y, z, columns)`` to the unit normal that a normal at rest becomes: along F's matrix of cofactors.
    turned_tangent
        ``(x, y, z, columns, normal)`` to the unit tangent that a tangent at rest becomes, across a normal.
    """

    @compiled
    def cell_frame(n, corners, local, beyond, displacement):
        x, y, z = local[n, 0], local[n, 1], local[n, 2]
        ux, uy, uz = _ZERO, _ZERO, _ZERO
        ax, ay, az = _ONE, _ZERO, _ZERO
        bx, by, bz = _ZERO, _ONE, _ZERO
        cx, cy, cz = _ZERO, _ZERO, _ONE
        for corner in range(8):
            node = corners[n, corner]
            wx, sx = (x, _ONE) if corner & 1 else (_ONE - x, -_ONE)
            wy, sy = (y, _ONE) if corner & 2 else (_ONE - y, -_ONE)
            wz, sz = (z, _ONE) if corner & 4 else (_ONE - z, -_ONE)
            dx, dy, dz = displacement[node, 0], displacement[node, 1], displacement[node, 2]
            here, along_x, along_y, along_z = wx * wy * wz, sx * wy * wz, wx * sy * wz, wx * wy * sz
            ux, uy, uz = ux + here * dx, uy + here * dy, uz + here * dz
            ax, ay, az = ax + along_x * dx, ay + along_x * dy, az + along_x * dz
            bx, by, bz = bx + along_y * dx, by + along_y * dy, bz + along_y * dz
            cx, cy, cz = cx + along_z * dx, cy + along_z * dy, cz + along_z * dz
        i, j, k = beyond[n, 0], beyond[n, 1], beyond[n, 2]
        moved = (
            ux + ((ax - _ONE) * i + bx * j + cx * k),
            uy + (ay * i + (by - _ONE) * j + cy * k),
            uz + (az * i + bz * j + (cz - _ONE) * k),
        )
        return moved, ((ax, ay, az), (bx, by, bz), (cx, cy, cz))

    @compiled
    def unit_or(x, y, z, otherwise):
        squared = x * x + y * y + z * z
        if squared < SQUARED_MIN:
            return otherwise
        scale = _ONE / np.float32(sqrt(squared))
        return x * scale, y * scale, z * scale

    @compiled
    def turned_normal(x, y, z, columns):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = columns
        return unit_or(
            x * (by * cz - bz * cy) + y * (cy * az - cz * ay) + z * (ay * bz - az * by),
            x * (bz * cx - bx * cz) + y * (cz * ax - cx * az) + z * (az * bx - ax * bz),
            x * (bx * cy - by * cx) + y * (cx * ay - cy * ax) + z * (ax * by - ay * bx),
            (x, y, z),
        )

    @compiled
    def turned_tangent(x, y, z, columns, normal):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = columns
        i, j, k = x * ax + y * bx + z * cx, x * ay + y * by + z * cy, x * az + y * bz + z * cz
        along = i * normal[0] + j * normal[1] + k * normal[2]
        return unit_or(i - along * normal[0], j - along * normal[1], k - along * normal[2], (x, y, z))

    return cell_frame, turned_normal, turned_tangent
