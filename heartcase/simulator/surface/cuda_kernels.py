"""The surface kernels of a CUDA device: a thread per node, vertex or render vertex."""

from __future__ import annotations

from numba import cuda

from heartcase.simulator.surface.formulas import make_cell_math, make_surface_math

__all__ = ["deform_in_cells", "deform_vertices", "node_normals", "turn_tangents"]

_node_normal, _deform_vertex = make_surface_math(cuda.jit(device=True))
_cell_frame, _turned_normal, _turned_tangent = make_cell_math(cuda.jit(device=True))


@cuda.jit
def node_normals(nodes, first, neighbours, offset, displacement, normals):
    """Write the approximate normals of some nodes (eq. 9.3), shape (normal_count, 3)."""
    number = cuda.grid(1)
    if number < nodes.shape[0]:
        x, y, z = _node_normal(number, nodes, first, neighbours, offset, displacement)
        normals[number, 0], normals[number, 1], normals[number, 2] = x, y, z


@cuda.jit
def deform_vertices(
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
    bases,
    rest_mm,
    rest_turn,
    to_mm,
    direction,
    vertices_mm,
    normals,
):
    """Write positions [LPS mm] and unit normals [LPS], shape (vertex_count, 3), and bases where there is room.

    ``moved`` is room for what the vertices have moved in the grid; ``normals`` hold those in the grid in between. The
    rows of ``to_mm`` and ``direction`` turn grid axes into LPS mm and LPS; the rest as in
    :class:`heartcase.simulator.surface.deform.SurfaceModel`.
    """
    v = cuda.grid(1)
    if v < weights.shape[0]:
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
            vertices_mm,
            bases,
        )
        x, y, z = moved[v, 0] - rest_turn[v, 0], moved[v, 1] - rest_turn[v, 1], moved[v, 2] - rest_turn[v, 2]
        i, j, k = vertices_mm[v, 0], vertices_mm[v, 1], vertices_mm[v, 2]
        for axis in range(3):
            vertices_mm[v, axis] = rest_mm[v, axis] + (x * to_mm[0, axis] + y * to_mm[1, axis] + z * to_mm[2, axis])
            normals[v, axis] = i * direction[0, axis] + j * direction[1, axis] + k * direction[2, axis]


@cuda.jit
def turn_tangents(bases, render_to_welded, tangent, direction, turned):
    """Write unit tangents [LPS] and handedness, shape (render_vertex_count, 4)."""
    r = cuda.grid(1)
    if r < render_to_welded.shape[0]:
        basis = bases[render_to_welded[r]]
        for axis in range(3):
            total = tangent[r, 3] - tangent[r, 3]
            for row in range(3):
                along = basis[row, 0] * direction[0, axis]
                along += basis[row, 1] * direction[1, axis]
                along += basis[row, 2] * direction[2, axis]
                total += tangent[r, row] * along
            turned[r, axis] = total
        turned[r, 3] = tangent[r, 3]


@cuda.jit
def deform_in_cells(
    vertices,
    corners,
    local,
    beyond,
    normal,
    basis,
    displacement,
    rest_mm,
    to_mm,
    direction,
    render_first,
    render_vertices,
    tangent,
    vertices_mm,
    normals,
    turned,
):
    """Write the vertices that follow the corners of cells, over what the other kernels wrote.

    The first six are ``arrays`` of :class:`heartcase.simulator.surface.cell_vertices.CellVertices`; the rest as in
    :func:`deform_vertices` and :func:`turn_tangents`, ``tangent`` empty where none is wanted.
    """
    n = cuda.grid(1)
    if n < vertices.shape[0]:
        v = vertices[n]
        moved, columns = _cell_frame(n, corners, local, beyond, displacement)
        across = _turned_normal(normal[n, 0], normal[n, 1], normal[n, 2], columns)
        i, j, k = across
        for axis in range(3):
            way = moved[0] * to_mm[0, axis] + moved[1] * to_mm[1, axis] + moved[2] * to_mm[2, axis]
            vertices_mm[v, axis] = rest_mm[v, axis] + way
            normals[v, axis] = i * direction[0, axis] + j * direction[1, axis] + k * direction[2, axis]
        if tangent.shape[0] > 0:
            for number in range(render_first[v], render_first[v + 1]):
                r = render_vertices[number]
                a, b, c = tangent[r, 0], tangent[r, 1], tangent[r, 2]
                x = a * basis[n, 0, 0] + b * basis[n, 1, 0] + c * basis[n, 2, 0]
                y = a * basis[n, 0, 1] + b * basis[n, 1, 1] + c * basis[n, 2, 1]
                z = a * basis[n, 0, 2] + b * basis[n, 1, 2] + c * basis[n, 2, 2]
                i, j, k = _turned_tangent(x, y, z, columns, across)
                for axis in range(3):
                    turned[r, axis] = i * direction[0, axis] + j * direction[1, axis] + k * direction[2, axis]
                turned[r, 3] = tangent[r, 3]
