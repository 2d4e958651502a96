"""Where curvature correction (eq. 9.8 of the thesis) helps: the choice per vertex that section 9.3.6 left open.

The interpolated basis follows a bent wall more closely than the flat triangle's where the approximate normals of the
nodes are well defined, and throws the vertex about where they are not. So each vertex is tried: the wall around it is
bent a little both ways and twisted, as a plate whose normals stay straight (Kirchhoff), and both bases are compared
with trilinear interpolation in the vertex's cell.
"""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.data import SimulationGrid
from heartcase.pipeline.kernels.vectors import cross
from heartcase.schemas.arrays import Float32, Float64, Int32
from heartcase.schemas.bundle.lattice import CELL_DIAGONALS, CELL_EDGES, cell_nodes, distinct_keys

__all__ = ["curvature_errors", "grid_springs", "node_neighbours"]


_AMPLITUDE = 1e-3


def grid_springs(grid: SimulationGrid) -> Int32:
    """The edges and face diagonals of all cells, each once, lower node first, shape (spring_count, 2)."""
    corners = cell_nodes(grid.cells)[1].astype(np.int64)
    pairs = np.concatenate([corners[:, pair] for pair in (*CELL_EDGES, *CELL_DIAGONALS)])
    pairs.sort(axis=1)
    keys = distinct_keys(pairs[:, 0] << 32 | pairs[:, 1])
    return np.stack((keys >> 32, keys & 0xFFFFFFFF), axis=1).astype(np.int32)


def node_neighbours(springs: Int32, node_count: int) -> Int32:
    """Nodes that springs join to each node, shape (node_count, 18), padded with -1."""
    ends = np.concatenate((springs, springs[:, ::-1]))
    ends = ends[np.lexsort((ends[:, 1], ends[:, 0]))]
    first = np.searchsorted(ends[:, 0], np.arange(node_count))
    table = np.full((node_count, 18), -1, np.int32)
    table[ends[:, 0], np.arange(len(ends)) - first[ends[:, 0]]] = ends[:, 1]
    return table


def curvature_errors(
    grid: SimulationGrid,
    neighbours: Int32,
    vertices_mm: Float64,
    normals: Float64,
    triangle_nodes: Int32,
    weights: Float32,
) -> tuple[Float64, Float64, Float64]:
    """Error of the flat and of the interpolated basis where the wall is bent and twisted.

    Parameters
    ----------
    grid
        The grid.
    neighbours
        Its nodes' neighbours, from :func:`node_neighbours`.
    vertices_mm
        Surface vertices, world mm, shape (n, 3).
    normals
        Their unit normals, world, shape (n, 3).
    triangle_nodes, weights
        The triangle of each vertex and the weights of its reference point, shape (n, 3).

    Returns
    -------
    flat, curved
        Root sum of squares over both bendings and the twist, in cells per unit of curvature (1/cell), shape (n,);
        infinite where the approximate normals are not defined.
    aligned
        Cosine between the interpolated normal and the triangle's at rest, shape (n,).
    """
    facing = normals @ grid.geometry.direction_matrix
    places = grid.geometry.world_to_index(vertices_mm) + 0.5
    nodes = grid.nodes.astype(np.float64)
    flat = np.empty(len(places))
    curved = np.empty(len(places))
    aligned = np.zeros(len(places))
    _errors(places, facing, triangle_nodes, weights.astype(np.float64), nodes, neighbours, flat, curved, aligned)
    return flat, curved, aligned


@copied
def _normalise(v):
    length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if length > 0.0:
        v[0] /= length
        v[1] /= length
        v[2] /= length
    return length


@copied
def _displace(x, normal, curvature, out):
    """Move a point as a plate through the origin with this normal and curvature tensor bends."""
    height = normal[0] * x[0] + normal[1] * x[1] + normal[2] * x[2]
    quadratic = 0.0
    for a in range(3):
        slope = curvature[a, 0] * x[0] + curvature[a, 1] * x[1] + curvature[a, 2] * x[2]
        quadratic += 0.5 * x[a] * slope
        out[a] = x[a] - height * slope
    for a in range(3):
        out[a] += quadratic * normal[a]


@copied
def _interpolated(place, normal, curvature, out):
    """Move of the origin when the displacement is interpolated between the corners of its cell."""
    out[:] = 0.0
    for a in range(3):
        part = place[a] - np.floor(place[a])
        for c in range(3):
            second = normal[c] * curvature[a, a] - 2.0 * normal[a] * curvature[c, a]
            out[c] += 0.5 * second * part * (1.0 - part)


@copied
def _plate_curvature(normal, mode, curvature):
    """Curvature tensor of a bending one way (0), the other way (1) and a twist (2) of equal size."""
    axis = np.argmin(np.abs(normal))
    first = np.zeros(3)
    second = np.empty(3)
    first[axis] = 1.0
    cross(normal, first, second)
    _normalise(second)
    cross(second, normal, first)
    for a in range(3):
        for b in range(3):
            if mode == 0:
                curvature[a, b] = _AMPLITUDE * first[a] * first[b]
            elif mode == 1:
                curvature[a, b] = _AMPLITUDE * second[a] * second[b]
            else:
                curvature[a, b] = _AMPLITUDE * np.sqrt(0.5) * (first[a] * second[b] + second[a] * first[b])


@kernel
def _bases(points, around, counts, weights, flat, curved, scratch):
    """Rows T, N, B of the triangle's basis and of the interpolated one; False where the latter is not defined."""
    for x in range(3):
        flat[0, x] = points[1, x] - points[0, x]
        scratch[x] = points[2, x] - points[0, x]
    _normalise(flat[0])
    cross(flat[0], scratch, flat[1])
    _normalise(flat[1])
    cross(flat[1], flat[0], flat[2])
    curved[1, :] = 0.0
    for c in range(3):
        sx, sy, sz = 0.0, 0.0, 0.0
        for n in range(counts[c]):
            dx = points[c, 0] - around[c, n, 0]
            dy = points[c, 1] - around[c, n, 1]
            dz = points[c, 2] - around[c, n, 2]
            inverse = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
            sx += dx * inverse
            sy += dy * inverse
            sz += dz * inverse
        length = np.sqrt(sx * sx + sy * sy + sz * sz)
        if length < 1e-6:
            return False
        curved[1, 0] += weights[c] * sx / length
        curved[1, 1] += weights[c] * sy / length
        curved[1, 2] += weights[c] * sz / length
    if _normalise(curved[1]) < 1e-6:
        return False
    cross(curved[1], flat[0], curved[2])
    if _normalise(curved[2]) < 1e-6:
        return False
    cross(curved[2], curved[1], curved[0])
    return True


@called
def _errors_at(places, facing, triangle_nodes, weights, nodes, neighbours, flat_error, curved_error, aligned, v):
    """Errors at one vertex."""
    rest = np.empty((3, 3))
    rest_around = np.empty((3, 18, 3))
    points = np.empty((3, 3))
    around = np.empty((3, 18, 3))
    counts = np.zeros(3, np.int64)
    flat, curved = np.empty((3, 3)), np.empty((3, 3))
    scratch, wanted = np.empty(3), np.empty(3)
    curvature = np.empty((3, 3))
    offset_flat, offset_curved = np.zeros(3), np.zeros(3)
    for c in range(3):
        node = triangle_nodes[v, c]
        for x in range(3):
            rest[c, x] = nodes[node, x] - places[v, x]
        for n in range(18):
            other = neighbours[node, n]
            if other < 0:
                break
            counts[c] = n + 1
            for x in range(3):
                rest_around[c, n, x] = nodes[other, x] - places[v, x]
    defined = _bases(rest, rest_around, counts, weights[v], flat, curved, scratch)
    if defined:
        aligned[v] = curved[1, 0] * flat[1, 0] + curved[1, 1] * flat[1, 1] + curved[1, 2] * flat[1, 2]
    for x in range(3):
        away = -(weights[v, 0] * rest[0, x] + weights[v, 1] * rest[1, x] + weights[v, 2] * rest[2, x])
        for b in range(3):
            offset_flat[b] += away * flat[b, x]
            offset_curved[b] += away * curved[b, x]
    total_flat, total_curved = 0.0, 0.0
    for mode in range(3):
        _plate_curvature(facing[v], mode, curvature)
        _interpolated(places[v], facing[v], curvature, wanted)
        for c in range(3):
            _displace(rest[c], facing[v], curvature, points[c])
            for n in range(counts[c]):
                _displace(rest_around[c, n], facing[v], curvature, around[c, n])
        defined = _bases(points, around, counts, weights[v], flat, curved, scratch) and defined
        for x in range(3):
            at = weights[v, 0] * points[0, x] + weights[v, 1] * points[1, x] + weights[v, 2] * points[2, x]
            at -= wanted[x]
            from_flat, from_curved = at, at
            for b in range(3):
                from_flat += offset_flat[b] * flat[b, x]
                from_curved += offset_curved[b] * curved[b, x]
            total_flat += from_flat * from_flat
            total_curved += from_curved * from_curved
    flat_error[v] = np.sqrt(total_flat) / _AMPLITUDE
    curved_error[v] = np.sqrt(total_curved) / _AMPLITUDE if defined else np.inf


@loop_kernel
def _errors(places, facing, triangle_nodes, weights, nodes, neighbours, flat_error, curved_error, aligned):
    for v in numba.prange(len(places)):
        _errors_at(places, facing, triangle_nodes, weights, nodes, neighbours, flat_error, curved_error, aligned, v)
