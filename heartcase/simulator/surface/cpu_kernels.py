"""The surface kernels: one node or vertex at a time, in float32; each gives the same bits on one thread and on more."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import get_num_threads

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Float64, Int32, UInt8
from heartcase.simulator.engine.cpu.barrier import Barrier, ThreadTeam
from heartcase.simulator.surface.formulas import make_cell_math, make_vertex_math

__all__ = [
    "EVERYTHING",
    "MOVED",
    "deform_in_cells",
    "deform_vertices",
    "mark_moved",
    "move_at_rest",
    "node_normals",
    "place_nodes",
]


EVERYTHING: UInt8 = np.zeros(0, np.uint8)
"""Marks nothing: all is worked out."""
MOVED = np.uint8(1)
"""Mark of a node of which a bit of the displacement changed."""
TURNED = np.uint8(2)
"""Mark of a node whose approximate normal was written."""


_TEAM = ThreadTeam()
"""Threads of all surfaces: their parts need not meet."""
_ZERO = np.float32(0)
_OPTIONS: dict[str, Any] = {"error_model": "numpy"}
_inlined = kernel(cached=False, forceinline=True, **_OPTIONS)
_spring_direction, _normal_of_sum, _vertex_frame, _along = make_vertex_math(_inlined)
_cell_frame, _turned_normal, _turned_tangent = make_cell_math(_inlined)


@_inlined
def _turned(vector, axes):
    x, y, z = vector
    return (
        x * axes[0, 0] + y * axes[1, 0] + z * axes[2, 0],
        x * axes[0, 1] + y * axes[1, 1] + z * axes[2, 1],
        x * axes[0, 2] + y * axes[1, 2] + z * axes[2, 2],
    )


@kernel(**_OPTIONS)
def _normals_between(start, end, springs, displacement, marks, normals):
    # Tuples are taken apart here: inside the loop their arrays would be counted again for every node.
    nodes, first, neighbours, offset = springs
    is_marked = len(marks) > 0
    for number in range(start, end):
        node = nodes[number]
        if is_marked:
            near = marks[node]
            for spring in range(first[number], first[number + 1]):
                near |= marks[neighbours[spring]]
            if not near & MOVED:
                continue
            marks[node] |= TURNED
        x, y, z = _ZERO, _ZERO, _ZERO
        for spring in range(first[number], first[number + 1]):
            d = _spring_direction(spring, node, neighbours[spring], offset, displacement)
            x, y, z = x + d[0], y + d[1], z + d[2]
        x, y, z = _normal_of_sum(x, y, z)
        normals[number, 0], normals[number, 1], normals[number, 2] = x, y, z


@kernel(**_OPTIONS)
def _deform_between(start, end, hung, drawn, axes, node_normal, displacement, marks, vertices_mm, normals, tangents):
    triangle_nodes, weights, edges, curvature, offset, normal, normal_number, rest_mm, rest_turn = hung
    first, render_vertices, tangent = drawn
    to_mm, direction = axes
    is_marked, is_drawn = len(marks) > 0, len(tangents) > 0
    for v in range(start, end):
        if is_marked:
            near = marks[triangle_nodes[v, 0]] | marks[triangle_nodes[v, 1]] | marks[triangle_nodes[v, 2]]
            if not near & (MOVED + TURNED * curvature[v]):
                continue
        moved, T, N, B = _vertex_frame(
            v, triangle_nodes, weights, edges, curvature, offset, normal_number, node_normal, displacement
        )
        way = _turned((moved[0] - rest_turn[v, 0], moved[1] - rest_turn[v, 1], moved[2] - rest_turn[v, 2]), to_mm)
        n = _turned(_along(normal, v, T, N, B), direction)
        for axis in range(3):
            vertices_mm[v, axis] = rest_mm[v, axis] + way[axis]
            normals[v, axis] = n[axis]
        if is_drawn:
            for number in range(first[v], first[v + 1]):
                r = render_vertices[number]
                t = _turned(_along(tangent, r, T, N, B), direction)
                tangents[r, 0], tangents[r, 1], tangents[r, 2], tangents[r, 3] = t[0], t[1], t[2], tangent[r, 3]


@kernel(**_OPTIONS)
def _deform_in_cells(start, end, cells, hung, drawn, axes, displacement, marks, vertices_mm, normals, tangents):
    vertices, corners, local, beyond, normal, basis = cells
    triangle_nodes, curvature, rest_mm = hung
    first, render_vertices, tangent = drawn
    to_mm, direction = axes
    is_marked, is_drawn = len(marks) > 0, len(tangents) > 0
    for n in range(start, end):
        v = vertices[n]
        if is_marked:
            # what the triangles' kernel wrote is written again
            near = marks[triangle_nodes[v, 0]] | marks[triangle_nodes[v, 1]] | marks[triangle_nodes[v, 2]]
            near &= MOVED + TURNED * curvature[v]
            for corner in range(8):
                near |= marks[corners[n, corner]] & MOVED
            if not near:
                continue
        moved, columns = _cell_frame(n, corners, local, beyond, displacement)
        way = _turned(moved, to_mm)
        across = _turned_normal(normal[n, 0], normal[n, 1], normal[n, 2], columns)
        turned = _turned(across, direction)
        for axis in range(3):
            vertices_mm[v, axis] = rest_mm[v, axis] + way[axis]
            normals[v, axis] = turned[axis]
        if is_drawn:
            T, N, B = (
                (basis[n, 0, 0], basis[n, 0, 1], basis[n, 0, 2]),
                (basis[n, 1, 0], basis[n, 1, 1], basis[n, 1, 2]),
                (basis[n, 2, 0], basis[n, 2, 1], basis[n, 2, 2]),
            )
            for number in range(first[v], first[v + 1]):
                r = render_vertices[number]
                x, y, z = _along(tangent, r, T, N, B)
                t = _turned(_turned_tangent(x, y, z, columns, across), direction)
                tangents[r, 0], tangents[r, 1], tangents[r, 2], tangents[r, 3] = t[0], t[1], t[2], tangent[r, 3]


@kernel(**_OPTIONS)
def _place_between(start, end, nodes, rest_mm, axes, node_normal, displacement, marks, vertices_mm, normals):
    to_mm, direction = axes
    is_marked = len(marks) > 0
    for v in range(start, end):
        node = nodes[v]
        # Where a node moved its normal was written too.
        if is_marked and not marks[node] & TURNED:
            continue
        way = _turned((displacement[node, 0], displacement[node, 1], displacement[node, 2]), to_mm)
        n = _turned((node_normal[v, 0], node_normal[v, 1], node_normal[v, 2]), direction)
        for axis in range(3):
            vertices_mm[v, axis] = rest_mm[v, axis] + way[axis]
            normals[v, axis] = n[axis]


def _run(way: Callable[..., None], row_count: int, arrays: tuple[Any, ...], together: bool) -> None:
    """Work on all rows, on one thread or on all."""

    def part(thread: int, thread_count: int, barrier: Barrier) -> int:
        way(thread * row_count // thread_count, (thread + 1) * row_count // thread_count, *arrays)
        return 0

    _TEAM.run(get_num_threads() if together else 1, part)


def node_normals(
    springs: tuple[Any, ...],
    displacement: Float32,
    normals: Float32,
    marks: UInt8 = EVERYTHING,
    *,
    together: bool = False,
) -> None:
    """Write approximate normals (eq. 9.3) of nodes, or only those that a moved node has a part in.

    Parameters
    ----------
    springs
        ``springs`` of :class:`heartcase.simulator.surface.deform.NodeNormals`.
    displacement
        Displacement of the nodes [cells, grid axes], float32, shape (node_count, 3).
    normals
        Written, grid axes, shape (at least normal_count, 3); rows that no moved node has a part in are left.
    marks
        ``MOVED`` for nodes that moved, shape (node_count,), to which ``TURNED`` is added for those whose normal was
        written; empty for all normals.
    together
        Whether all threads work: the same bits.
    """
    arrays = (springs, displacement, marks, normals)
    _run(_normals_between, len(springs[0]), arrays, together)


def deform_vertices(
    hung: tuple[Any, ...],
    drawn: tuple[Any, ...],
    axes: tuple[Float32, Float32],
    node_normal: Float32,
    displacement: Float32,
    written: tuple[Float32, Float32, Float32],
    marks: UInt8 = EVERYTHING,
    *,
    together: bool = False,
) -> None:
    """Deform all vertices (eq. 9.9), or only those of which a node or a normal changed.

    Parameters
    ----------
    hung, drawn
        ``hung`` and ``drawn`` of :class:`heartcase.simulator.surface.deform.SurfaceModel`.
    axes
        What turns grid axes into LPS mm, and into LPS, from the right, float32, shape (3, 3) each.
    node_normal, displacement
        The nodes' approximate normals and displacement [cells], grid axes.
    written
        Positions [LPS mm], normals and tangents [LPS], shape (vertex_count, 3) twice and (render_vertex_count, 4), or
        empty; rows of which nothing changed are left.
    marks
        As :func:`node_normals` leaves them; empty for all vertices.
    together
        Whether all threads work: the same bits.
    """
    arrays = (hung, drawn, axes, node_normal, displacement, marks, *written)
    _run(_deform_between, len(written[0]), arrays, together)


def deform_in_cells(
    cells: tuple[Any, ...],
    hung: tuple[Any, ...],
    drawn: tuple[Any, ...],
    axes: tuple[Float32, Float32],
    displacement: Float32,
    written: tuple[Float32, Float32, Float32],
    marks: UInt8 = EVERYTHING,
    *,
    together: bool = False,
) -> None:
    """Deform the vertices that follow the corners of cells, after :func:`deform_vertices` and over what it wrote.

    Parameters
    ----------
    cells
        ``arrays`` of :class:`heartcase.simulator.surface.cell_vertices.CellVertices`.
    hung
        Triangle's nodes, curvature and rest positions [LPS mm] of all vertices.
    drawn, axes, displacement, written, marks, together
        As of :func:`deform_vertices`.
    """
    arrays = (cells, hung, drawn, axes, displacement, marks, *written)
    _run(_deform_in_cells, len(cells[0]), arrays, together)


def place_nodes(
    nodes: Int32,
    rest_mm: Float64,
    axes: tuple[Float64, Float64],
    node_normal: Float32,
    displacement: Float32,
    written: tuple[Float32, Float32],
    marks: UInt8 = EVERYTHING,
    *,
    together: bool = False,
) -> None:
    """Place all vertices of the one-to-one surface (thesis 9.3.2), or only those whose normal was written.

    Parameters
    ----------
    nodes, rest_mm
        Node of each vertex, shape (vertex_count,), and where it is at rest [LPS mm], float64, shape (vertex_count, 3).
    axes, node_normal, displacement, marks, together
        As of :func:`deform_vertices`, the axes in float64; one normal for each vertex.
    written
        Positions [LPS mm] and normals [LPS], shape (vertex_count, 3) each.
    """
    arrays = (nodes, rest_mm, axes, node_normal, displacement, marks, *written)
    _run(_place_between, len(nodes), arrays, together)


@kernel(**_OPTIONS)
def move_at_rest(triangle_nodes, weights, edges, curvature, offset, normal_number, node_normal, displacement, moved):
    """Write the turned offset at rest [cells], with the bits that a vertex at rest finds; shape (vertex_count, 3)."""
    for v in range(len(weights)):
        x, y, z = _vertex_frame(
            v, triangle_nodes, weights, edges, curvature, offset, normal_number, node_normal, displacement
        )[0]
        moved[v, 0], moved[v, 1], moved[v, 2] = x, y, z


@kernel(**_OPTIONS)
def mark_moved(now, before, marks):
    """Mark the nodes of which a bit changed, take over their displacement, and count them.

    Parameters
    ----------
    now, before
        Bits of the displacement, int32, shape (3 node_count,); ``before`` becomes ``now``.
    marks
        Written: ``MOVED`` where a node moved, else 0, uint8, shape (node_count,).
    """
    count = 0
    for n in range(len(marks)):
        x, y, z = now[3 * n], now[3 * n + 1], now[3 * n + 2]
        is_other = ((x ^ before[3 * n]) | (y ^ before[3 * n + 1]) | (z ^ before[3 * n + 2])) != 0
        before[3 * n], before[3 * n + 1], before[3 * n + 2] = x, y, z
        marks[n] = is_other
        count += is_other
    return count
